"""Samples over time in CSV files with a header of names and units, such as ``time_s,angle_deg``."""

from __future__ import annotations

import csv
import math
from collections.abc import Callable, Mapping
from pathlib import Path

from mckibben.errors import Problem, ScenarioError, UnitError
from mckibben.units import NUMBER, factor

_LARGEST = 64 * 2**20


def read_samples(path: Path, name: str, unit: str) -> tuple[list[float], list[float]]:
    """Return the times [s] and the values, in `unit`, of the column of a CSV file that is titled NAME_UNIT."""
    times, values = read_columns(path, lambda _: {name: unit})
    return times, values[name]


def read_columns(
    path: Path, wanted: Callable[[list[str]], Mapping[str, str]]
) -> tuple[list[float], dict[str, list[float]]]:
    """The times [s] and the values, by name, of columns titled NAME_UNIT: names and units wanted of a header."""
    try:
        if path.stat().st_size > _LARGEST:
            raise ScenarioError(str(path), [Problem(f"is larger than {_LARGEST // 2**20} MiB")])
        rows = list(csv.reader(path.read_text(encoding="utf-8-sig").splitlines()))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise ScenarioError(str(path), [Problem(f"cannot be read: {error}", remedy="give a CSV file")]) from None
    problems: list[Problem] = []
    header = [title.strip() for title in rows[0]] if rows else []
    units = wanted(header)
    columns = [_column(header, name, unit, problems) for name, unit in (("time", "s"), *units.items())]
    if problems:
        raise ScenarioError(str(path), problems)

    samples: list[list[float]] = []
    for line, row in enumerate(rows[1:], start=2):
        if not any(cell.strip() for cell in row):
            continue
        sample = [_number(row, place, scale) for place, scale in columns]
        if not all(map(math.isfinite, sample)):
            problems.append(Problem(f"{','.join(row)[:60]!r} does not hold {len(sample)} finite numbers", line))
        elif samples and sample[0] <= samples[-1][0]:
            problems.append(Problem(f"the time {sample[0]:g} s does not rise", line, remedy="sort the rows"))
        else:
            samples.append(sample)
    if not samples and not problems:
        problems.append(Problem("holds no samples"))
    if problems:
        raise ScenarioError(str(path), problems)
    times, *values = (list(column) for column in zip(*samples, strict=True))
    return times, dict(zip(units, values, strict=True))


def _column(header: list[str], name: str, unit: str, problems: list[Problem]) -> tuple[int, float]:
    """Index and scale of the column of a quantity."""
    places = [i for i, title in enumerate(header) if title.startswith(f"{name}_")]
    if len(places) != 1:
        what = "has several columns" if places else "has no column"
        problems.append(Problem(f"{what} {name}_...", 1, remedy=f"title one column {name}_{unit}"))
        return 0, 1.0
    try:
        return places[0], factor(header[places[0]][len(name) + 1 : len(name) + 41], unit)
    except UnitError as error:
        problems.append(Problem.of(error, 1, header[places[0]]))
        return 0, 1.0


def _number(row: list[str], place: int, scale: float) -> float:
    text = row[place].strip() if place < len(row) else ""
    return float(text) * scale if NUMBER.fullmatch(text) else math.nan  # not 1_0, nor digits of other scripts
