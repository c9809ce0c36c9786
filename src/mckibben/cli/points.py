"""`mckibben points`: steady-state points of a raw recording."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from mckibben.cli.options import (
    Column,
    InitialLength,
    Json,
    SkipCorrupt,
    SlackForce,
    notify,
    parse_columns,
    parse_optional_quantity,
    parse_quantity,
    report_ignored_columns,
    table,
)
from mckibben.errors import DatasetError, Problem, UnitError

if TYPE_CHECKING:
    from mckibben.dataset import ExtractedPoints, Recording

_SHOWN = 40  # rows of the table
_LEADING_NUMBER = re.compile(r"^[+-]?[0-9.]+([eE][+-]?[0-9]+)?")


def points(
    recording: Annotated[
        Path,
        typer.Argument(
            metavar="RECORDING", help="Pressure and force against time: CSV, .xlsx, .mat, .tdms, .lvm, .nc."
        ),
    ],
    out: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Output file: .csv, or .nc with the spread of the force."),
    ] = None,
    isometric: Annotated[
        bool,
        typer.Option("--isometric", help="Isometric test: points at pressure levels at a fixed length."),
    ] = False,
    levels: Annotated[
        str, typer.Option(metavar="'1, 2, 3 bar'", help="Pressure levels of --isometric (default: evenly spaced).")
    ] = "",
    count: Annotated[int, typer.Option(metavar="N", help="Number of evenly spaced levels of --isometric.")] = 12,
    contraction: Annotated[
        str,
        typer.Option(metavar="RATIO", help="Contraction of the recording, such as '10 %', if no column gives it."),
    ] = "",
    pressure_tolerance: Annotated[str, typer.Option(metavar="PRESSURE", help="Tolerance of a plateau.")] = "2 kPa",
    contraction_tolerance: Annotated[
        str,
        typer.Option(
            metavar="RATIO",
            help="Tolerance of a plateau (default 0.1 %) or of --isometric (0.5 %).",
        ),
    ] = "",
    force_tolerance: Annotated[str, typer.Option(metavar="FORCE", help="Tolerance of a plateau (default: none).")] = "",
    dwell: Annotated[str, typer.Option(metavar="TIME", help="Shortest duration of a plateau.")] = "1 s",
    settle: Annotated[str, typer.Option(metavar="TIME", help="Excluded start of a plateau.")] = "0 s",
    gap: Annotated[
        str,
        typer.Option(metavar="TIME", help="Gap that ends a plateau (default: 10 sampling intervals)."),
    ] = "",
    sample_rate: Annotated[str, typer.Option(metavar="RATE", help="Of a file without times, such as '1000 Hz'.")] = "",
    initial_length: InitialLength = "",
    slack_force: SlackForce = "",
    specimen: Annotated[str, typer.Option(metavar="NAME", help="Name of the specimen.")] = "",
    column: Column = None,
    skip_corrupt: SkipCorrupt = False,
    json: Json = False,
) -> None:
    """Extract points from a raw recording: steady plateaus, or pressure levels at a fixed length."""
    if out is not None:
        _check_new(out)
    pressures = _levels(levels)
    from mckibben.dataset import read_recording

    read = read_recording(
        recording,
        columns=parse_columns(column),
        initial_length=parse_optional_quantity("--initial-length", initial_length, "m"),
        contraction=None if isometric else parse_optional_quantity("--contraction", contraction, "1"),
        sample_rate=parse_optional_quantity("--sample-rate", sample_rate, "Hz"),
        specimen=specimen,
        slack_force=parse_optional_quantity("--slack-force", slack_force, "N"),
        on_corrupt="report" if skip_corrupt else "raise",
    )
    between = parse_optional_quantity("--gap", gap, "s")
    tolerance = parse_optional_quantity("--contraction-tolerance", contraction_tolerance, "1")
    if isometric:
        found = read.isometric(
            pressures,
            count=count,
            contraction=parse_optional_quantity("--contraction", contraction, "1"),
            contraction_tolerance=0.005 if tolerance is None else tolerance,
            gap=between,
        )
    else:
        found = read.plateaus(
            pressure_tolerance=parse_quantity("--pressure-tolerance", pressure_tolerance, "Pa"),
            contraction_tolerance=0.001 if tolerance is None else tolerance,
            force_tolerance=parse_optional_quantity("--force-tolerance", force_tolerance, "N"),
            dwell=parse_quantity("--dwell", dwell, "s"),
            settle=parse_quantity("--settle", settle, "s"),
            gap=between,
        )
    if out is not None:
        write = found.dataset.to_netcdf if out.suffix.lower() == ".nc" else found.dataset.to_csv
        write(out)
    _show(read, found, recording, json)
    if out is not None:
        notify(f"wrote {len(found.dataset)} points to {out}; fit a law with: mckibben identify {out}", json)


def _show(read: Recording, found: ExtractedPoints, path: Path, json: bool) -> None:
    from mckibben.storage.files import to_json

    report_ignored_columns(read.table.attrs)
    rows = _rows(found)
    if json:
        names = ("time_s", "pressure_bar", "contraction_percent", "force_N", "spread_N", "samples", "came_by")
        numbers = {
            "points": [dict(zip(names, row, strict=True)) for row in rows],
            "samples": dict(found.counts),
            "notes": list(found.notes),
            "repairs": read.table.attrs.get("repairs", "").splitlines(),
        }
        typer.echo(to_json(numbers))
        return
    shown = [
        (f"{t:.5g}", f"{p:.5g}", f"{c:.4g}", f"{f:.5g}", f"{d:.2g}", str(n), direction)
        for t, p, c, f, d, n, direction in rows
    ]
    more = f" (first {_SHOWN} shown)" if len(shown) > _SHOWN else ""
    table(
        f"{path.name}: {len(rows)} points of {len(read)} samples{more}",
        ("time s", "pressure bar", "contraction %", "force N", "spread N", "samples", "direction"),
        shown[:_SHOWN],
    )
    typer.echo(found.describe())


def _rows(found: ExtractedPoints) -> list[tuple[float, float, float, float, float, int, str]]:
    from mckibben.units import bar, percent

    data = found.dataset.table
    empty = [""] * len(found.dataset)
    directions = zip(
        *(data[name].to_numpy().tolist() if name in data else empty for name in ("direction", "phase")), strict=True
    )
    columns = (
        data["time"].to_numpy().tolist(),
        (found.dataset.pressure / bar).tolist(),
        (found.dataset.contraction / percent).tolist(),
        found.dataset.force.tolist(),
        data["force_spread"].to_numpy().tolist(),
        found.samples.tolist(),
    )
    return [
        (*row, direction or phase or "-")
        for row, (direction, phase) in zip(zip(*columns, strict=True), directions, strict=True)
    ]


def _check_new(out: Path) -> None:
    """Check, before the computation, that the output file is new and can be written."""
    if out.suffix.lower() not in (".csv", ".nc"):
        raise DatasetError(str(out), [Problem("is neither .csv nor .nc", remedy="use the ending .csv or .nc")])
    if not out.parent.is_dir():
        raise DatasetError(str(out), [Problem(f"there is no folder {out.parent}", remedy="create it")])
    if out.exists():
        raise DatasetError(str(out), [Problem("exists already", remedy="choose another file, or delete it")])


def _levels(text: str) -> list[float] | None:
    """Parse pressures with one unit for all ("1, 2.5, 4 bar") or one each ("100 kPa, 2 bar")."""
    if not text:
        return None
    parts = [part.strip() for part in text.split(",")]
    units = [_LEADING_NUMBER.sub("", part).strip() for part in parts]
    if not any(units):
        raise UnitError(f"--levels {text!r} has no unit", value=text, remedy="write --levels '1, 2, 3 bar'")
    if not all(units):
        if any(units[:-1]) or not all(parts):
            raise UnitError(
                f"--levels {text!r} is not a list of pressures",
                value=text,
                remedy="write one unit for all, '1, 2, 3 bar', or one for each, '1 bar, 200 kPa'",
            )
        parts[:-1] = [f"{part} {units[-1]}" for part in parts[:-1]]
    return [parse_quantity("--levels", part, "Pa") for part in parts]
