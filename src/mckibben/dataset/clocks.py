"""Recordings of one test by two devices with separate clocks, as by a testing machine and a microcontroller."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import compress
from pathlib import Path
from typing import NamedTuple

import numpy as np

from mckibben.dataset.cells import to_numbers
from mckibben.dataset.clock import continuous, seconds_of
from mckibben.dataset.raw import Floats, RawColumn, RawTable
from mckibben.dataset.segmentation import usual_interval
from mckibben.dataset.table import refusal
from mckibben.units import quantity

ESTIMATED, PAIRED = "estimated", "paired"
_STATED = "state when the second clock starts on the first: --read 'clocks=12.5 s' or, with its drift, '12.5 s, 0.01 %'"


class Clock(NamedTuple):
    """Clock with the times ``offset + (1 + drift) t`` of another [s]."""

    offset: float
    drift: float = 0.0

    @classmethod
    def parse(cls, text: str) -> Clock:
        """Read a stated clock; raises `UnitError` for anything but a time, and perhaps a ratio.

        >>> Clock.parse("-1.5 s, 0.01 %")
        Clock(offset=-1.5, drift=0.0001)
        """
        offset, _, drift = text.partition(",")
        return cls(quantity(offset.strip(), "s"), quantity(drift.strip(), "1") if drift else 0.0)

    def of(self, time: Floats) -> Floats:
        """Times of the other clock [s]."""
        return self.offset + (1 + self.drift) * time


def join_clocks(
    path: Path, first: RawTable, second: RawTable, mapping: Mapping[str, str], clocks: str
) -> tuple[RawTable, list[str]]:
    """Table at the times of the first one with the columns of the second, linear in between, where both recorded.

    Also returns the columns of the second table to be ignored: its time, and quantities of the first.

    Parameters
    ----------
    path
        Second file, named in the error.
    clocks
        The second clock, stated, or `ESTIMATED` from a quantity that both recorded.

    Raises
    ------
    DatasetError
        If the second clock is not determined.
    """
    taken = {column.name for column in first.columns}
    renamed = [
        replace(column, name=f"{column.name} (2)", label=column.title) if column.name in taken else column
        for column in second.columns
    ]
    second = replace(second, columns=renamed)
    (time1, own, _), (time2, others, remarks) = (_timed(table, mapping) for table in (first, second))
    if time1 is None or time2 is None:
        text = f"the {'second' if time1 is not None else 'first'} file has no column of the time that is understood"
        raise refusal(path, text, "name it: --column 'HEADER=time_ms'", "clocks")
    for name, time in (("first", time1), ("second", time2)):
        if np.any(np.diff(time) <= 0):
            text = f"the clock of the {name} file does not advance, or goes back"
            raise refusal(path, text, "leave out the rows before", "clocks")
    shared = [name for name in own if name in others]
    clock, doubt = None, "no quantity is in both files, from which the second clock could be estimated"
    if clocks != ESTIMATED:
        clock = Clock.parse(clocks)
    elif shared:
        clock, doubt = estimate_clock(time1, own[shared[0]], time2, others[shared[0]])
    if clock is None:
        raise refusal(path, doubt, _STATED, "clocks")
    said = f"second clock: starts at {clock.offset:.6g} s of the first and runs {1e6 * clock.drift:.3g} ppm slow"
    said = ", ".join([said, *remarks])
    joined = _at_times(first, time1, second, clock.of(time2))
    needless = [column.name for column in second.columns if column.header(mapping).quantity in ("time", *shared)]
    return replace(joined, comments=first.comments | {"clocks": said}), needless


def _at_times(first: RawTable, time: Floats, second: RawTable, times: Floats) -> RawTable:
    """Rows of the first table, at its times, to which the second has samples on both sides, without a gap."""
    before = np.searchsorted(times, time, side="right") - 1
    inside = (time >= times[0]) & (time <= times[-1])
    inside &= ~np.append(usual_interval(np.diff(times))[1], False)[before] | (time == times[before])
    parts = [
        cells[inside] if isinstance(cells := column.cells, np.ndarray) else [*compress(cells, inside)]
        for column in first.columns
    ]
    columns = [replace(column, cells=cells) for column, cells in zip(first.columns, parts, strict=True)]
    columns += [
        replace(column, cells=np.interp(time[inside], times, column.cells))
        for column in second.columns
        if isinstance(column.cells, np.ndarray)
    ]
    return replace(
        first,
        columns=columns,
        lines=np.asarray(first.lines)[inside],
        words=[*first.words, *second.words],
        questions=[*first.questions, *second.questions],
    )


def join_pairs(path: Path, table: RawTable, mapping: Mapping[str, str]) -> tuple[RawTable, list[str]]:
    """Table of signals that each follow a time of their own, as plot tools write them, at the times of the first.

    Also returns the columns of the other times, to be ignored. Raises a `DatasetError` if there are not several times.
    """
    clocks = [at for at, column in enumerate(table.columns) if column.header(mapping).quantity == "time"]
    parts = [table.columns[at:end] for at, end in zip(clocks, [*clocks[1:], None], strict=True)]
    parts = [_filled(table, part) for part in parts if len(part) > 1]
    timed = [_timed(part, mapping)[0] for part in parts]
    if len(parts) < 2 or any(time is None or np.any(np.diff(time) <= 0) for time in timed):
        raise refusal(path, "has no columns of rising times before its signals", "leave clocks out", "clocks")
    joined = replace(parts[0], columns=[*table.columns[: clocks[0]], *parts[0].columns])
    for part, times in zip(parts[1:], timed[1:], strict=True):
        part = replace(part, words=[], questions=[])
        joined = _at_times(joined, np.asarray(_timed(joined, mapping)[0]), part, np.asarray(times))
    return joined, [part.columns[0].name for part in parts[1:]]


def _filled(table: RawTable, columns: Sequence[RawColumn]) -> RawTable:
    """Table of some columns, up to the last row that is not empty in all of them."""
    rows = range(len(table.lines))
    filled = (rows if isinstance(column.cells, np.ndarray) else map(str.strip, column.cells) for column in columns)
    count = 1 + max((row for cells in filled for row, cell in enumerate(cells) if cell != ""), default=-1)
    cut = [replace(column, cells=to_numbers(column.cells, table.decimal)[:count]) for column in columns]
    return replace(table, columns=cut, lines=np.asarray(table.lines)[:count])


def _timed(table: RawTable, mapping: Mapping[str, str]) -> tuple[Floats | None, dict[str, Floats], list[str]]:
    """Time [s] of a table, None if none is understood, its columns of numbers by quantity, and remarks on the time."""
    time, signals, remarks = None, dict[str, Floats](), list[str]()
    for column in table.columns:
        header = column.header(mapping)
        if header.quantity == "time":
            if (clock := seconds_of(header, column.cells)) is not None:
                time, remarks = continuous(clock)
        elif header.quantity and isinstance(column.cells, np.ndarray):
            signals[header.quantity] = column.cells
    return time, signals, remarks


def estimate_clock(time1: Floats, signal1: Floats, time2: Floats, signal2: Floats) -> tuple[Clock | None, str]:
    """Clock of the second of two signals of one quantity, in any units; None with the reason if it is not determined.

    The offset with the largest correlation over half of the shorter signal or more; from there, offset and drift by
    least squares, with a line of the second signal over the first. Another offset explains the signals as well if it
    leaves less than twice as large a share of their variance.

    Examples
    --------
    >>> time = np.arange(0, 60, 0.02)
    >>> def moved(t):
    ...     return np.sin(0.1 * t**1.5)
    >>> clock, _ = estimate_clock(time, moved(time), time[:2000], 3 * moved(5 + 1.001 * time[:2000]) + 1)
    >>> round(clock.offset, 3), round(clock.drift, 5)
    (5.0, 0.001)
    """
    from scipy.optimize import least_squares
    from scipy.signal import correlate, find_peaks

    step = max(float(np.median(np.diff(time))) for time in (time1, time2))
    grids = [np.arange(time[0], time[-1], step) for time in (time1, time2)]
    x, y = np.interp(grids[0], time1, signal1), np.interp(grids[1], time2, signal2)
    if not (np.std(x) and np.std(y)):
        return None, "a signal that both files have does not move"
    x, y = (x - x.mean()) / np.std(x), (y - y.mean()) / np.std(y)
    ones = np.ones(len(x)), np.ones(len(y))
    count = np.maximum(np.rint(correlate(*ones)), 1.0)
    sums = [correlate(a, b) for a, b in ((x, ones[1]), (ones[0], y), (x * x, ones[1]), (ones[0], y * y), (x, y))]
    spread = (sums[2] - sums[0] ** 2 / count) * (sums[3] - sums[1] ** 2 / count)
    usable = (count >= min(len(x), len(y)) / 2) & (spread > 1e-9 * count**2)
    agreement = np.where(usable, (sums[4] - sums[0] * sums[1] / count) / np.sqrt(np.where(usable, spread, 1.0)), 0.0)
    peaks = find_peaks(np.concatenate([[-1.0], agreement, [-1.0]]))[0] - 1
    order = peaks[np.argsort(-agreement[peaks])]
    rest = 1 - agreement[order[:2]] ** 2
    if rest[0] > 0.5:
        return None, "the signals that both files have do not follow each other"
    if len(rest) > 1 and rest[1] < 2 * rest[0]:
        return None, "the signals that both files have fit each other at several offsets: they repeat"
    begin = grids[0][0] - grids[1][0] + (int(order[0]) - (len(y) - 1)) * step

    def misfit(values: Floats) -> Floats:
        at = Clock(*values).of(time2)
        inside = (at >= time1[0]) & (at <= time1[-1])
        design = np.column_stack([np.interp(at, time1, signal1), np.ones(len(at))])
        line = np.linalg.lstsq(design[inside], signal2[inside], rcond=None)[0]
        return np.where(inside, signal2 - design @ line, 0.0)

    fit = least_squares(misfit, [begin, 0.0], x_scale=[step, step / max(np.ptp(time2), step)], diff_step=1e-6)
    ends = np.array([[1.0, time2[0]], [1.0, time2[-1]]])
    inverse = np.linalg.pinv(fit.jac / np.linalg.norm(fit.jac, axis=0)) / np.linalg.norm(fit.jac, axis=0)[:, None]
    error = np.sqrt(2 * fit.cost / len(time2)) * float(np.linalg.norm(ends @ inverse, axis=1).max())
    if not error <= step:
        return None, f"the signals that both files have determine the second clock to {error:.2g} s only"
    return Clock(*map(float, fit.x)), ""
