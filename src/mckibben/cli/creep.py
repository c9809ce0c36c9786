"""`mckibben identify-creep`: creep of a muscle after steps of the pressure, from isometric tests."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from typer import Argument

from mckibben.cli.options import (
    Column,
    Decimal,
    Displacement,
    FixedContraction,
    Force,
    ForceSign,
    InitialLength,
    Json,
    Out,
    RecipeFile,
    SampleRate,
    SkipCorrupt,
    ZeroLength,
    echo,
    keeping,
    notify,
    recipe_of,
    report_reading,
    results_folder,
)
from mckibben.storage.files import to_json, write_json


def identify_creep(
    recordings: Annotated[
        list[Path], Argument(metavar="RECORDING...", help="Files of pressure and force over time, at fixed lengths.")
    ],
    contraction: FixedContraction = "",
    sample_rate: SampleRate = "",
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
    """Identify the creep after steps of the pressure at fixed lengths, and test its significance."""
    results_folder(out, ("results.json",), force)
    from mckibben.identification import identify_pressure_creep

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
    read = [how.recording(path, on_corrupt="report" if skip_corrupt else "raise") for path in recordings]
    found = identify_pressure_creep(read)
    if out:
        with keeping(out):
            write_json(out / "results.json", found.records())
    for one in read:
        report_reading(one.table.attrs)
    echo(to_json(found.records()) if json else found.report())
    if out:
        notify(f"wrote results.json to {out}", json)
