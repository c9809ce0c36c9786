"""`mckibben identify-air` and `mckibben identify-creep`: parameters of a muscle from recordings over time."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from typer import Argument, Option

from mckibben.cli.command import command
from mckibben.cli.options import (
    Reading,
    parse_quantity,
    reads_files,
    report_reading,
)

if TYPE_CHECKING:
    from mckibben.calibration import AirFit
    from mckibben.dataset import Recording
    from mckibben.result import Result


@reads_files("slack_force", "specimen")
@command
def identify_air(
    recordings: Annotated[list[Path], Argument(metavar="RECORDING...", help="Files of pressure over time.")],
    specimen: Annotated[str, Option(help="Specimen, or its file, whose braid gives the volume.")],
    dead_volume: Annotated[
        str, Option(metavar="VOLUME", help="Volume of tube and fittings up to the valve, if tests are at one length.")
    ] = "0 cm^3",
    *,
    reading: Reading,
) -> AirFit:
    """Identify heat to the wall, leak and dead volume: fill a muscle fast, shut the valve, watch; vent, shut, watch."""
    from mckibben.calibration import identify_air as run
    from mckibben.study.inputs import specimen_named

    dead = parse_quantity("--dead-volume", dead_volume, "m^3")
    muscle = specimen_named(specimen)
    read = _read(recordings, reading)
    return run(read, muscle, dead_volume=dead)


@reads_files("slack_force", "specimen")
@command
def identify_creep(
    recordings: Annotated[
        list[Path], Argument(metavar="RECORDING...", help="Files of pressure and force over time, at fixed lengths.")
    ],
    *,
    reading: Reading,
) -> Result:
    """Identify the creep after steps of the pressure at fixed lengths, and test its significance."""
    from mckibben.identification import identify_pressure_creep

    return identify_pressure_creep(_read(recordings, reading))


def _read(paths: list[Path], reading: Reading) -> list[Recording]:
    """Read recordings, and report how on standard error."""
    from mckibben.dataset import read_recording

    recordings = [read_recording(path, reading.recipe) for path in paths]
    for recording in recordings:
        report_reading(recording.table.attrs)
    return recordings
