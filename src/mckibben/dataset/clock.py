"""Clocks of loggers: elapsed time with a unit, seconds or nanoseconds of an epoch, and stamps of date and time."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np

from mckibben.dataset.raw import Floats
from mckibben.dataset.vocabulary import Header

_EPOCH = 0.9e9, 4.2e9  # s since 1970: from 1998 to 2103
_UNITS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
"""Units [s] in which loggers count an epoch."""
_TIME = re.compile(r"(\d{1,2}):(\d\d):(\d\d)(?:[.,:](\d{1,9}))?(?:\s*([AaPp])[Mm])?")
_DATE = re.compile(r"(\d{1,4})[-./](\d{1,2})[-./](\d{1,4})")


def seconds_of(header: Header, cells: Floats | Sequence[str]) -> Floats | None:
    """Time [s] from the first sample; None where the clock is not plain.

    Parameters
    ----------
    header
        Header of the column, with its unit if it states one.
    cells
        Shape (samples,): numbers, or texts such as ``2024-03-12T14:02:00.5Z`` or ``12.03.2024 14:02:00,5``.
    """
    if isinstance(cells, np.ndarray):
        if not len(cells) or not np.isfinite(cells).all():
            return None
        low, high = _EPOCH
        unit = next((unit for unit in _UNITS.values() if low < cells.min() * unit and cells.max() * unit < high), None)
        if unit is not None and header.unit in ("", *_UNITS):
            return (cells - cells[0]) * unit
        scale = {**_UNITS, "min": 60.0}.get(header.unit)
        return None if scale is None else cells * scale
    return _of_stamps(cells)


def _of_stamps(cells: Sequence[str]) -> Floats | None:
    """Time [s] of stamps; None if one is not understood, or the order of day and month matters and is not plain."""
    times, dates = [], []
    for cell in cells:
        time, date = _TIME.search(cell), _DATE.search(cell)
        if time is None:
            return None
        hour = int(time[1]) % 12 + 12 * (time[5].lower() == "p") if time[5] else int(time[1])
        fraction = int(time[4]) / 10 ** len(time[4]) if time[4] else 0.0
        times.append(3600 * hour + 60 * int(time[2]) + int(time[3]) + fraction)
        dates.append(date.groups() if date else ())
    seconds = np.array(times)
    days = _days(dates)
    if days is None:
        return None
    if not any(dates):  # a clock that passes midnight
        days = np.cumsum(np.diff(seconds, prepend=seconds[:1]) < -43200)
    return seconds - seconds[0] + 86400.0 * (days - days[0])


def _days(dates: Sequence[tuple[str, ...]]) -> Floats | None:
    """Number of the day of each date; None if day and month may be exchanged."""
    if len(set(dates)) == 1:
        return np.zeros(len(dates))
    readings = []
    for order in ((0, 1, 2), (2, 1, 0), (2, 0, 1)):  # ISO, day first, month first
        try:
            text = [f"{int(date[order[0]]):04d}-{int(date[order[1]]):02d}-{int(date[order[2]]):02d}" for date in dates]
            days = np.array(text, "datetime64[D]").astype(np.float64)
        except (ValueError, IndexError):
            continue
        if all(len(date[order[0]]) == 4 for date in dates):
            readings.append(days - days[0])
    same = readings and all(np.array_equal(readings[0], other) for other in readings)
    return readings[0] if same else None
