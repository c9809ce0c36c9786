"""`mckibben points`: points from raw recordings."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from typer import Argument, Option

from mckibben.cli.options import (
    Json,
    Reading,
    check_new,
    echo,
    notify,
    on_command_line,
    parse_optional_quantity,
    parse_quantity,
    reads_files,
    report_reading,
    table,
)
from mckibben.errors import ParameterError, UnitError
from mckibben.storage.files import to_json
from mckibben.units import bar, percent

if TYPE_CHECKING:
    from mckibben.dataset import ExtractedPoints, Recording


_SHOWN = 40  # rows of the table of points; below their columns, and the format of each
_COLUMNS = {
    "time_s": ".5g",
    "pressure_bar": ".5g",
    "contraction_percent": ".4g",
    "force_N": ".5g",
    "spread_N": ".2g",
    "samples": "",
    "came_by": "",
}
_LEADING_NUMBER = re.compile(r"^[+-]?[0-9.]+([eE][+-]?[0-9]+)?")


@reads_files()
def points(
    recording: Annotated[
        list[Path], Argument(metavar="RECORDING...", help="CSV, .xlsx, .mat, .tdms, .lvm or .nc, over time.")
    ],
    out: Annotated[
        Path | None, Option(metavar="FILE", help="New file: .csv, or .nc with the spread of the force.")
    ] = None,
    isometric: Annotated[bool, Option("--isometric", help="Points at pressure levels at a fixed length.")] = False,
    strokes: Annotated[
        bool, Option("--strokes", help="Points along strokes at constant pressures, also fast ones.")
    ] = False,
    levels: Annotated[
        str, Option(metavar="'1, 2, 3 bar'", help="Levels of --isometric (default: evenly spaced).")
    ] = "",
    count: Annotated[int, Option(metavar="N", help="Number of evenly spaced levels of --isometric.")] = 12,
    pressure_tolerance: Annotated[
        str, Option(metavar="PRESSURE", help="Tolerance of a plateau (default 2 kPa), or of --strokes (10 kPa).")
    ] = "",
    contraction_tolerance: Annotated[
        str,
        Option(
            metavar="RATIO",
            help="Tolerance of a plateau (default 0.1 %), of --isometric (0.5 %), or step of --strokes.",
        ),
    ] = "",
    force_tolerance: Annotated[str, Option(metavar="FORCE", help="Tolerance of a plateau (default: none).")] = "",
    dwell: Annotated[str, Option(metavar="TIME", help="Shortest duration of a plateau.")] = "1 s",
    settle: Annotated[str, Option(metavar="TIME", help="Excluded start of a plateau.")] = "0 s",
    gap: Annotated[str, Option(metavar="TIME", help="Gap that ends a plateau (default: 10 sampling intervals).")] = "",
    *,
    reading: Reading,
    save_recipe: Annotated[
        Path | None, Option(metavar="FILE", help="New file: the options by which the recording was read.")
    ] = None,
    json: Json = False,
) -> None:
    """Extract points from a raw recording: steady plateaus, strokes, or pressure levels at a fixed length."""
    if isometric and strokes:
        raise ParameterError("--isometric and --strokes are different tests", remedy="give one of them")
    for file, endings in ((out, (".csv", ".nc")), (save_recipe, (".yaml", ".yml"))):
        if file is not None:
            check_new(file, *endings)
    pressures = _levels(levels)
    recipe = reading.recipe
    held = recipe.contraction if isometric else None
    limits = {
        "gap": parse_optional_quantity("--gap", gap, "s"),
        "contraction_tolerance": parse_optional_quantity("--contraction-tolerance", contraction_tolerance, "1"),
        "pressure_tolerance": parse_optional_quantity("--pressure-tolerance", pressure_tolerance, "Pa"),
    }
    tolerances = {name: limit for name, limit in limits.items() if limit is not None}
    steady = {
        "force_tolerance": parse_optional_quantity("--force-tolerance", force_tolerance, "N"),
        "dwell": parse_quantity("--dwell", dwell, "s"),
        "settle": parse_quantity("--settle", settle, "s"),
    }
    from mckibben.dataset import read_recording

    read = read_recording(recording, recipe.model_copy(update={"contraction": None}) if isometric else recipe)
    if isometric:
        tolerances.pop("pressure_tolerance", None)
        found = read.isometric(pressures, count=count, contraction=held, **tolerances)
    elif strokes:
        step = tolerances.pop("contraction_tolerance", None)
        found = read.strokes(**({} if step is None else {"step": step}), **tolerances)
    else:
        found = read.plateaus(**tolerances, **steady)
    if out is not None:
        write = found.dataset.to_netcdf if out.suffix.lower() == ".nc" else found.dataset.to_csv
        write(out)
    _show_points(read, found, recording, json)
    if out is not None:
        notify(f"wrote {len(found.dataset)} points to {out}; fit a law with: mckibben identify {out}", json)
    if save_recipe is not None:
        recipe.to_yaml(save_recipe)
        notify(f"wrote {save_recipe}; read the next file with: --read {save_recipe}", json)


def _show_points(read: Recording, found: ExtractedPoints, paths: list[Path], json: bool) -> None:
    report_reading(read.table.attrs)
    rows = _rows(found)
    if json:
        numbers = {
            "points": [dict(zip(_COLUMNS, row, strict=True)) for row in rows],
            "samples": dict(found.counts),
            "notes": list(found.notes),
            "repairs": read.table.attrs.get("repairs", "").splitlines(),
        }
        echo(to_json(numbers))
        return
    formats = _COLUMNS.values()
    shown = [tuple(map(format, row, formats)) for row in rows[:_SHOWN]]
    more = f" (first {_SHOWN} shown)" if len(rows) > _SHOWN else ""
    table(
        f"{', '.join(path.name for path in paths)}: {len(rows)} points from {len(read)} samples{more}",
        ("time s", "pressure bar", "contraction %", "force N", "spread N", "samples", "direction"),
        shown,
    )
    echo(on_command_line(found.describe()))


def _rows(found: ExtractedPoints) -> list[tuple[float | str, ...]]:
    data = found.dataset.table
    empty = [""] * len(found.dataset)
    direction, phase = (data[name].to_numpy() if name in data else empty for name in ("direction", "phase"))
    numbers = (
        data["time"].to_numpy(),
        found.dataset.pressure / bar,
        found.dataset.contraction / percent,
        found.dataset.force,
        data["force_spread"].to_numpy(),
        found.samples,
    )
    came_by = [str(one or other or "-") for one, other in zip(direction, phase, strict=True)]
    return list(zip(*(column.tolist() for column in numbers), came_by, strict=True))


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
            remedy = "write one unit for all, '1, 2, 3 bar', or one for each, '1 bar, 200 kPa'"
            raise UnitError(f"--levels {text!r} is not a list of pressures", value=text, remedy=remedy)
        parts[:-1] = [f"{part} {units[-1]}" for part in parts[:-1]]
    return [parse_quantity("--levels", part, "Pa") for part in parts]
