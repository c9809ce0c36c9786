"""`mckibben identify-air` and `mckibben identify-creep`: parameters of a muscle from recordings over time."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from typer import Argument, Option

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
    parse_quantity,
    recipe_of,
    report_reading,
    results_folder,
    show_results,
)

if TYPE_CHECKING:
    from mckibben.dataset import Recipe, Recording


def identify_air(
    recordings: Annotated[list[Path], Argument(metavar="RECORDING...", help="Files of pressure over time.")],
    specimen: Annotated[str, Option(help="Specimen, or its file, whose braid gives the volume.")],
    contraction: FixedContraction = "",
    dead_volume: Annotated[
        str, Option(metavar="VOLUME", help="Volume of tube and fittings up to the valve, if tests are at one length.")
    ] = "0 cm^3",
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
    read = _read(recordings, how, skip_corrupt)
    found = run(read, muscle, dead_volume=dead)
    show_results(out, found.records(), found.report(), json)


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
    read = _read(recordings, how, skip_corrupt)
    found = identify_pressure_creep(read)
    show_results(out, found.records(), found.report(), json)


def _read(paths: list[Path], recipe: Recipe, skip_corrupt: bool) -> list[Recording]:
    """Read recordings, and report how on standard error."""
    found = [recipe.recording(path, on_corrupt="report" if skip_corrupt else "raise") for path in paths]
    for one in found:
        report_reading(one.table.attrs)
    return found
