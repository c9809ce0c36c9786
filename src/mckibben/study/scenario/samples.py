"""Sampled wishes from a CSV file whose header names quantities and units: ``time_s,angle_deg``."""

from __future__ import annotations

import csv
import math
from pathlib import Path

from mckibben.errors import Problem, ScenarioError, UnitError
from mckibben.units import factor

_LARGEST = 64 * 2**20


def read_samples(path: Path, name: str, unit: str) -> tuple[list[float], list[float]]:
    """The times [s] and the values of a quantity, in `unit`.

    Parameters
    ----------
    path
        Of the file.
    name
        What the column's title begins with, such as "angle"; its unit follows after "_".
    unit
        Of the answer.

    Raises
    ------
    ScenarioError
        With every problem of the file and its line.
    """
    try:
        if path.stat().st_size > _LARGEST:
            raise ScenarioError(str(path), [Problem(f"is larger than {_LARGEST // 2**20} MiB")])
        rows = list(csv.reader(path.read_text(encoding="utf-8-sig").splitlines()))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise ScenarioError(str(path), [Problem(f"cannot be read: {error}", remedy="give a CSV file")]) from None
    problems: list[Problem] = []
    header = [title.strip() for title in rows[0]] if rows else []
    columns = [_column(header, title, kind, problems) for title, kind in (("time", "s"), (name, unit))]
    if problems:
        raise ScenarioError(str(path), problems)

    times: list[float] = []
    values: list[float] = []
    for line, row in enumerate(rows[1:], start=2):
        if not any(cell.strip() for cell in row):
            continue
        time, value = (_number(row, place, scale) for place, scale in columns)
        if not (math.isfinite(time) and math.isfinite(value)):
            problems.append(Problem(f"{','.join(row)[:60]!r} holds no two finite numbers", line))
        elif times and time <= times[-1]:
            problems.append(Problem(f"the time {time:g} s does not rise", line, remedy="sort the rows"))
        else:
            times.append(time)
            values.append(value)
    if not times and not problems:
        problems.append(Problem("holds no samples"))
    if problems:
        raise ScenarioError(str(path), problems)
    return times, values


def _column(header: list[str], name: str, unit: str, problems: list[Problem]) -> tuple[int, float]:
    """Where a quantity stands, and what to multiply it by."""
    found = [i for i, title in enumerate(header) if title.startswith(f"{name}_")]
    if len(found) != 1:
        what = "has several columns" if found else "has no column"
        problems.append(Problem(f"{what} {name}_...", 1, remedy=f"title one column {name}_{unit}"))
        return 0, 1.0
    try:
        return found[0], factor(header[found[0]][len(name) + 1 : len(name) + 41], unit)
    except UnitError as error:
        problems.append(Problem(str(error), 1, header[found[0]]))
        return 0, 1.0


def _number(row: list[str], place: int, scale: float) -> float:
    try:
        return float(row[place]) * scale
    except (ValueError, IndexError):
        return math.nan
