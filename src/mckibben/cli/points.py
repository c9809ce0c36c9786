"""`mckibben points`: a raw recording to points that can be identified from."""

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
    quantity_of,
    quantity_or_none,
    renamed,
    said,
    say_ignored,
    table,
)
from mckibben.errors import DatasetError, Problem, UnitError

if TYPE_CHECKING:
    from mckibben.dataset import ExtractedPoints, Recording

_SHOWN = 40  # points in the table
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
        typer.Option(metavar="FILE", help="Keep the points here: .csv, or .nc with the spread of the force."),
    ] = None,
    isometric: Annotated[
        bool,
        typer.Option("--isometric", help="Filled and vented at a fixed length: points at pressures, not plateaus."),
    ] = False,
    levels: Annotated[
        str, typer.Option(metavar="'1, 2, 3 bar'", help="The pressures of --isometric; evenly spaced unless given.")
    ] = "",
    count: Annotated[
        int, typer.Option(metavar="N", help="How many pressures --isometric has unless they are given.")
    ] = 12,
    contraction: Annotated[
        str, typer.Option(metavar="RATIO", help="At which the muscle was held, such as '10 %', if no column says it.")
    ] = "",
    pressure_tolerance: Annotated[str, typer.Option(metavar="PRESSURE", help="Of a plateau.")] = "2 kPa",
    contraction_tolerance: Annotated[
        str, typer.Option(metavar="RATIO", help="Of a plateau, or of a fixed length; 0.1 % or 0.5 % unless given.")
    ] = "",
    force_tolerance: Annotated[
        str, typer.Option(metavar="FORCE", help="Of a plateau; the force may creep unless given.")
    ] = "",
    dwell: Annotated[str, typer.Option(metavar="TIME", help="A plateau is steady for at least so long.")] = "1 s",
    settle: Annotated[str, typer.Option(metavar="TIME", help="Its beginning that is left out.")] = "0 s",
    gap: Annotated[
        str, typer.Option(metavar="TIME", help="Samples further apart are not joined; 10 intervals unless given.")
    ] = "",
    sample_rate: Annotated[str, typer.Option(metavar="RATE", help="Such as '1000 Hz', of a file without times.")] = "",
    initial_length: InitialLength = "",
    slack_force: SlackForce = "",
    specimen: Annotated[str, typer.Option(metavar="NAME", help="The make of the muscle.")] = "",
    column: Column = None,
    skip_corrupt: SkipCorrupt = False,
    json: Json = False,
) -> None:
    """Find the points in a raw recording: steady plateaus, or pressures passed at a fixed length."""
    if out is not None:
        _check_new(out)
    wanted = _levels(levels)
    from mckibben.dataset import read_recording

    read = read_recording(
        recording,
        columns=renamed(column),
        initial_length=quantity_or_none("--initial-length", initial_length, "m"),
        contraction=None if isometric else quantity_or_none("--contraction", contraction, "1"),
        sample_rate=quantity_or_none("--sample-rate", sample_rate, "Hz"),
        specimen=specimen,
        slack_force=quantity_or_none("--slack-force", slack_force, "N"),
        on_corrupt="report" if skip_corrupt else "raise",
    )
    between = quantity_or_none("--gap", gap, "s")
    tolerance = quantity_or_none("--contraction-tolerance", contraction_tolerance, "1")
    if isometric:
        found = read.isometric(
            wanted,
            count=count,
            contraction=quantity_or_none("--contraction", contraction, "1"),
            contraction_tolerance=0.005 if tolerance is None else tolerance,
            gap=between,
        )
    else:
        found = read.plateaus(
            pressure_tolerance=quantity_of("--pressure-tolerance", pressure_tolerance, "Pa"),
            contraction_tolerance=0.001 if tolerance is None else tolerance,
            force_tolerance=quantity_or_none("--force-tolerance", force_tolerance, "N"),
            dwell=quantity_of("--dwell", dwell, "s"),
            settle=quantity_of("--settle", settle, "s"),
            gap=between,
        )
    if out is not None:
        write = found.dataset.to_netcdf if out.suffix.lower() == ".nc" else found.dataset.to_csv
        write(out)
    _show(read, found, recording, json)
    if out is not None:
        said(f"kept {len(found.dataset)} points in {out}; fit a law with: mckibben identify {out}", json)


def _show(read: Recording, found: ExtractedPoints, path: Path, json: bool) -> None:
    from mckibben.study.reporting import to_json

    say_ignored(read.table.attrs)
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
        (f"{t:.5g}", f"{p:.5g}", f"{c:.4g}", f"{f:.5g}", f"{d:.2g}", str(n), way) for t, p, c, f, d, n, way in rows
    ]
    more = f" (the first {_SHOWN} are shown)" if len(shown) > _SHOWN else ""
    table(
        f"{path.name}: {len(rows)} points of {len(read)} samples{more}",
        ("time s", "pressure bar", "contraction %", "force N", "spread N", "samples", "reached by"),
        shown[:_SHOWN],
    )
    typer.echo(found.describe())


def _rows(found: ExtractedPoints) -> list[tuple[float, float, float, float, float, int, str]]:
    from mckibben.units import bar, percent

    data = found.dataset.table
    empty = [""] * len(found.dataset)
    ways = zip(
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
    return [(*row, way[0] or way[1] or "-") for row, way in zip(zip(*columns, strict=True), ways, strict=True)]


def _check_new(out: Path) -> None:
    """Refuse, before the work, a file that could not be written after it, or is there already."""
    if out.suffix.lower() not in (".csv", ".nc"):
        raise DatasetError(str(out), [Problem("is neither .csv nor .nc", remedy="name it points.csv")])
    if not out.parent.is_dir():
        raise DatasetError(str(out), [Problem(f"there is no folder {out.parent}", remedy="make it, or name another")])
    if out.exists():
        raise DatasetError(str(out), [Problem("is there already", remedy="name another file, or delete it")])


def _levels(text: str) -> list[float] | None:
    """Pressures with a unit for all, such as "1, 2.5, 4 bar", or one each, such as "100 kPa, 2 bar"."""
    if not text:
        return None
    parts = [part.strip() for part in text.split(",")]
    units = [_LEADING_NUMBER.sub("", part).strip() for part in parts]
    if not any(units):
        raise UnitError(f"--levels {text!r} has no unit", value=text, remedy="write --levels '1, 2, 3 bar'")
    if not all(units):
        if any(units[:-1]) or not all(parts):
            raise UnitError(
                f"--levels {text!r} is no list of pressures",
                value=text,
                remedy="write one unit for all, '1, 2, 3 bar', or one each, '1 bar, 200 kPa'",
            )
        parts[:-1] = [f"{part} {units[-1]}" for part in parts[:-1]]
    return [quantity_of("--levels", part, "Pa") for part in parts]
