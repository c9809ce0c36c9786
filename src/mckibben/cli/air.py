"""`mckibben identify-air`: heat to the wall, leak and dead volume of a muscle from tests with a shut valve."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from typer import Argument, Option

from mckibben.cli.options import (
    Column,
    Decimal,
    Displacement,
    Force,
    ForceSign,
    InitialLength,
    Json,
    Out,
    RecipeFile,
    SkipCorrupt,
    ZeroLength,
    echo,
    keeping,
    notify,
    parse_quantity,
    recipe_of,
    report_reading,
    results_folder,
)
from mckibben.storage.files import to_json, write_json


def identify_air(
    recordings: Annotated[list[Path], Argument(metavar="RECORDING...", help="Files of pressure over time.")],
    specimen: Annotated[str, Option(help="Specimen, or its file, whose braid gives the volume.")],
    contraction: Annotated[
        str, Option(metavar="RATIO", help="Contraction, such as '10 %', if no column gives it.")
    ] = "",
    dead_volume: Annotated[
        str, Option(metavar="VOLUME", help="Volume of tube and fittings up to the valve, if tests are at one length.")
    ] = "0 cm^3",
    sample_rate: Annotated[str, Option(metavar="RATE", help="For a file without times, such as '1000 Hz'.")] = "",
    initial_length: InitialLength = "",
    displacement: Displacement = "",
    zero_length: ZeroLength = "",
    force_sign: ForceSign = None,
    column: Column = None,
    skip_corrupt: SkipCorrupt = False,
    decimal: Decimal = "",
    recipe: RecipeFile = None,
    json: Json = False,
    out: Out = None,
    force: Force = False,
) -> None:
    """Identify heat to the wall, leak and dead volume: fill a muscle fast, shut the valve, watch; vent, shut, watch."""
    results_folder(out, ("results.json",), force)
    from mckibben.calibration import identify_air as run
    from mckibben.study.inputs import specimen_named

    how = recipe_of(
        recipe,
        column,
        initial_length,
        displacement,
        zero_length,
        "",
        force_sign,
        decimal,
        contraction=contraction,
        sample_rate=sample_rate,
    )
    dead = parse_quantity("--dead-volume", dead_volume, "m^3")
    muscle = specimen_named(specimen)
    read = [how.recording(path, on_corrupt="report" if skip_corrupt else "raise") for path in recordings]
    found = run(read, muscle, dead_volume=dead)
    if out:
        with keeping(out):
            write_json(out / "results.json", found.records())
    for one in read:
        report_reading(one.table.attrs)
    echo(to_json(found.records()) if json else found.report())
    if out:
        notify(f"wrote results.json to {out}", json)
