"""`mckibben points`: points from raw recordings."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from typer import Argument, Option

from mckibben.cli.command import command
from mckibben.cli.options import (
    Reading,
    on_command_line,
    parse_optional_quantity,
    parse_quantity,
    reads_files,
    report_reading,
)

if TYPE_CHECKING:
    from mckibben.dataset import ExtractedPoints


@reads_files()
@command
def points(
    recording: Annotated[
        list[Path], Argument(metavar="RECORDING...", help="CSV, .xlsx, .mat, .tdms, .lvm or .nc, over time.")
    ],
    dwell: Annotated[str, Option(metavar="TIME", help="Shortest duration of a plateau.")] = "1 s",
    settle: Annotated[str, Option(metavar="TIME", help="Excluded start of a plateau.")] = "0 s",
    pressure_tolerance: Annotated[
        str, Option(metavar="PRESSURE", help="Tolerance of a plateau (default: 2 kPa).")
    ] = "",
    contraction_tolerance: Annotated[
        str, Option(metavar="RATIO", help="Tolerance of a plateau (default: 0.1 %).")
    ] = "",
    *,
    reading: Reading,
) -> ExtractedPoints:
    """Extract points from a raw recording: means over the plateaus, where pressure and length are steady.

    With --out, points.csv and points.nc are files for `mckibben identify`, and recipe.yaml reads the next recording.
    """
    from mckibben.dataset import read_recording

    limits = {
        "pressure_tolerance": parse_optional_quantity("--pressure-tolerance", pressure_tolerance, "Pa"),
        "contraction_tolerance": parse_optional_quantity("--contraction-tolerance", contraction_tolerance, "1"),
    }
    tolerances = {name: limit for name, limit in limits.items() if limit is not None}
    durations = {"dwell": parse_quantity("--dwell", dwell, "s"), "settle": parse_quantity("--settle", settle, "s")}
    samples = read_recording(recording, reading.recipe)
    report_reading(samples.table.attrs)
    plateaus = samples.plateaus(**tolerances, **durations)
    repairs = samples.table.attrs.get("repairs", "").splitlines()
    notes = [*plateaus.notes, *(f"left out: {repair}" for repair in repairs)]
    return replace(plateaus, notes=tuple(map(on_command_line, notes)), recipe=reading.recipe)
