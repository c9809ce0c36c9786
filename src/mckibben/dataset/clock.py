"""Clocks of loggers: elapsed time with a unit, seconds or nanoseconds of an epoch, and stamps of date and time."""

from __future__ import annotations

import re
from collections.abc import Sequence
from contextlib import suppress

import numpy as np

from mckibben.dataset.raw import Floats
from mckibben.dataset.segmentation import runs, usual_interval
from mckibben.dataset.vocabulary import Header

_EPOCH = 0.9e9, 4.2e9  # s since 1970: from 1998 to 2103
_UNITS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
"""Units [s] in which loggers count an epoch."""
_TIME_OF_DAY = re.compile(r"\d{1,2}:\d\d:\d\d(?:\.\d{1,9})?")
_FRACTION = re.compile(r"(:\d\d:\d\d)[,:](\d{1,9})")  # of a second, behind a comma or a colon
_DATE = re.compile(r"(\d{1,2})[./-](\d{1,2})[./-](\d{4})[T,\s]+")
_FORMATS = (
    "ISO8601",
    *(f"{date} {time}" for date in ("%d/%m/%Y", "%m/%d/%Y") for time in ("%H:%M:%S.%f", "%H:%M:%S", "%I:%M:%S %p")),
)


def seconds_of(header: Header, cells: Floats | Sequence[str]) -> Floats | None:
    """Time [s] from the first sample; None where the clock is not plain.

    Parameters
    ----------
    header
        Header of the column, with its unit if it states one.
    cells
        Shape (samples,): numbers, or texts such as ``2024-03-12T14:02:00.5Z`` or ``12.03.2024 14:02:00,5``.

    Returns
    -------
    ndarray or None
        Shape (samples,). A number with a unit is the time since a start of its own; one of the size of an epoch counts
        from 1970 in s, ms, us or ns. A time of day passes midnight where it falls by more than half a day. A date is
        understood if both orders of day and month give the same times, or only one of them is possible.

    Examples
    --------
    >>> seconds_of(Header("time", ""), ["31.01.2024 23:59:59", "01.02.2024 00:00:01"]).tolist()
    [0.0, 2.0]
    >>> seconds_of(Header("time", ""), ["01.02.2024 23:59:59", "02.02.2024 00:00:01"]) is None
    True
    >>> seconds_of(Header("time", ""), np.array([1710252120500.0, 1710252121000.0])).tolist()
    [0.0, 0.5]
    """
    if isinstance(cells, np.ndarray):
        if not len(cells) or not np.isfinite(cells).all():
            return None
        low, high = _EPOCH
        unit = next((unit for unit in _UNITS.values() if low < cells.min() * unit and cells.max() * unit < high), None)
        if unit is not None and header.unit in ("", *_UNITS):
            return (cells - cells[0]) * unit
        scale = {**_UNITS, "min": 60.0, "h": 3600.0}.get(header.unit)
        return None if scale is None else cells * scale
    return _of_stamps(cells)


def _of_stamps(cells: Sequence[str]) -> Floats | None:
    """Time [s] of stamps; None if one is not understood, or the order of day and month matters and is not plain."""
    import pandas as pd

    texts = [_FRACTION.sub(r"\1.\2", cell.strip()) for cell in cells]
    if all(map(_TIME_OF_DAY.fullmatch, texts)):
        seconds = pd.to_timedelta(texts).total_seconds().to_numpy(np.float64)
        days = np.cumsum(np.diff(seconds, prepend=seconds[:1]) < -43200)  # midnights
        return seconds - seconds[:1] + 86400.0 * days
    texts = [_DATE.sub(r"\1/\2/\3 ", text) for text in texts]
    readings: list[Floats] = []
    for form in _FORMATS if all(":" in text for text in texts) else ():
        with suppress(ValueError):
            stamps = pd.to_datetime(texts, format=form)
            readings.append((stamps - stamps[0]).total_seconds().to_numpy())
    return readings[0] if readings and all(np.array_equal(readings[0], other) for other in readings) else None


def continuous(
    time: Floats, counters: Sequence[float] = (65.536, 4294.967296, 4294967.296)
) -> tuple[Floats, list[str]]:
    """Times of a counter that goes on where it rolled over, and in which samples of one stamp follow each other evenly.

    A counter rolled over if it falls by its range, less an interval or a few. Samples that share a stamp are spread up
    to the next stamp, but not into a gap.

    Parameters
    ----------
    time
        Shape (samples,) [s].
    counters
        Ranges [s] of counters: 16 bits of ms, 32 bits of us and of ms.

    Returns
    -------
    Times [s], shape (samples,), and what was done, as text.

    Examples
    --------
    >>> continuous(np.array([65.53, 65.53, 0.004, 0.014]))
    (array([65.53 , 65.535, 65.54 , 65.55 ]), ['1 overflow of its counter continued', '1 repeated stamp spread evenly'])
    """
    remarks, steps = [], np.diff(time)
    interval = usual_interval(steps)[0]
    for span in counters if (steps < 0).any() else ():
        over = (steps < 0) & (np.abs(steps + span - interval) <= 2 * interval)
        if count := int(np.count_nonzero(over)):
            time = time + span * np.cumsum(np.append(False, over))
            remarks.append(f"{count} overflow{'s' * (count > 1)} of its counter continued")
    first, counts = runs(time)
    if (repeats := len(time) - len(first)) and len(first) > 1:
        steps = np.diff(time[first])
        interval, gaps = usual_interval(steps)
        steps = np.append(np.where(gaps | (steps < 0), interval, steps), interval)
        time = time + (np.arange(len(time)) - np.repeat(first, counts)) * np.repeat(steps / counts, counts)
        remarks.append(f"{repeats} repeated stamp{'s' * (repeats > 1)} spread evenly")
    return time, remarks
