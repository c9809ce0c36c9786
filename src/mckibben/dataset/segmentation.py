"""Steady segments of a recording, and the plateaus in them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

if TYPE_CHECKING:
    import xarray as xr

_GAP = 10  # usual intervals
_PARTS = 20  # of a dwell: length of the compared means


def runs(values: NDArray[np.generic]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """First index and length of each run of equal values.

    >>> [part.tolist() for part in runs(np.array([3.0, 3.0, 1.0]))]
    [[0, 2], [2, 1]]
    """
    begins = np.flatnonzero(np.append(True, values[1:] != values[:-1])[: len(values)])
    return begins, np.diff(begins, append=len(values))


def alternation(steps: NDArray[np.float64]) -> float:
    """Share of differences that change sign from one to the next, as they do in noise: 0 without any."""
    return float(np.mean(steps[:-1] * steps[1:] < 0)) if len(steps) > 1 else 0.0


def usual_interval(steps: NDArray[np.float64]) -> tuple[float, NDArray[np.bool_]]:
    """Sampling interval [s] during most of the time, 0 if the time does not advance, and the steps that are gaps.

    A gap is ten times as long as the steps around it: rates may change in a recording, as while a point is acquired.

    >>> steps = np.append(np.repeat([0.02, 0.001, 0.02], 40), 5.0)
    >>> interval, gaps = usual_interval(steps)
    >>> interval, np.flatnonzero(gaps).tolist()
    (0.02, [120])
    """
    from scipy.ndimage import median_filter  # saves 50 ms when reading points

    if not (forward := steps > 0).any():
        return 0.0, np.zeros(len(steps), bool)
    gaps = np.zeros(len(steps), bool)
    gaps[forward] = steps[forward] > _GAP * median_filter(steps[forward], 2 * _PARTS + 1, mode="mirror")
    ranked = np.sort(steps[forward & ~gaps])
    return float(ranked[np.searchsorted(np.cumsum(ranked), ranked.sum() / 2)]), gaps


def going_on(time: NDArray[np.float64]) -> NDArray[np.float64]:
    """Times in their order: those of a clock that was set back go on after the usual interval.

    >>> going_on(np.array([0.0, 1.0, 2.0, 0.5, 1.5])).tolist()
    [0.0, 1.0, 2.0, 3.0, 4.0]
    """
    steps = np.diff(time, prepend=time[:1])
    return time + np.cumsum(np.where(steps < 0, usual_interval(steps)[0] - steps, 0.0)) if (steps < 0).any() else time


class Segments(NamedTuple):
    """Steady segments: first and one past the last sample; uncertain samples at the ends."""

    first: NDArray[np.int64]
    last: NDArray[np.int64]
    edge: int


def steady_segments(
    signals: Sequence[tuple[NDArray[np.float64], float]], broken: NDArray[np.bool_], dwell: int
) -> Segments:
    """Segments of at least `dwell` samples in which the means of each signal stay within its tolerance.

    Means over a twentieth of the dwell are compared, so that noise does not count.

    Parameters
    ----------
    signals
        Values, shape (samples,), and tolerance of each signal, in one unit.
    broken
        Shape (samples,): samples at which a segment ends.
    dwell
        Number of samples.

    Examples
    --------
    >>> pressure = np.repeat([2.0, 2.5, 3.0], [60, 10, 60])
    >>> segments = steady_segments([(pressure, 0.1)], np.zeros(130, bool), 40)
    >>> segments.first.tolist(), segments.last.tolist()
    ([0, 70], [60, 130])
    """
    count = len(broken)
    none = np.empty(0, np.int64)
    size = max(1, dwell // _PARTS)
    window = -(-dwell // size)
    edges = np.arange(0, count - size + 1, size)  # the last block takes the remainder
    bounds = np.append(edges, count)
    sizes = np.diff(bounds)
    if len(edges) < window:
        return Segments(none, none, 0)
    means = [(np.add.reduceat(values, edges) / sizes, tolerance) for values, tolerance in signals]
    bad = np.logical_or.reduceat(broken, edges)

    starts = ~sliding_window_view(bad, window).any(axis=1)
    for values, tolerance in means:
        starts &= np.ptp(sliding_window_view(values, window), axis=1) <= 2 * tolerance
    opens = np.flatnonzero(np.diff(starts, prepend=False, append=False))
    first, last = opens[::2], opens[1::2] + window - 1  # blocks: the first, and the one after the last
    first = np.maximum(first, np.concatenate([[0], last[:-1]]))  # shared samples belong to the earlier one
    keep = last - first >= window
    first, last = _trimmed(means, first[keep], last[keep])
    keep = last - first >= window
    return Segments(bounds[first[keep]], bounds[last[keep]], size if window > 4 else 0)


def _trimmed(
    means: Sequence[tuple[NDArray[np.float64], float]], first: NDArray[np.int64], last: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Segments of blocks trimmed to their longest part within the tolerance around their middle half."""
    spans = []
    for begin, end in zip(first, last, strict=True):
        quarter, within = (end - begin) // 4, np.ones(end - begin, bool)
        for values, tolerance in means:
            middle = values[begin + quarter : end - quarter].mean()
            within &= np.abs(values[begin:end] - middle) <= tolerance
        ends = begin + np.flatnonzero(np.diff(within, prepend=False, append=False)).reshape(-1, 2)
        spans.append(max(ends.tolist(), key=lambda span: span[1] - span[0], default=(begin, begin)))
    longest = np.array(spans, np.int64).reshape(-1, 2)
    return longest[:, 0], longest[:, 1]


_OVERSHOOT = 1.0  # of a step, that of an undamped second-order system: a larger excursion is a deliberate move


def approaches(
    table: xr.Dataset,
    broken: NDArray[np.bool_],
    first: NDArray[np.int64],
    last: NDArray[np.int64],
    levels: Mapping[str, tuple[NDArray[np.float64], float]],
) -> tuple[NDArray[np.str_], NDArray[np.str_]]:
    """Direction and phase of each plateau, never across a gap.

    The direction is that of the last motion, unless the pressure was stepped after it. The phase follows from the step
    from the level before, or from the start of the recording, which exceeds any overshoot; without a step, from the
    last motion.

    Parameters
    ----------
    table
        Recording, along ``sample``.
    broken
        Shape (samples,): samples after a gap.
    first, last
        Shape (plateaus,): first and one past the last sample.
    levels
        Means, shape (plateaus,), and tolerance of contraction [-] and pressure [Pa].

    Returns
    -------
    tuple
        "loading", "unloading" or "", and "filling", "venting" or "", each of shape (plateaus,).
    """
    before = np.concatenate([[0], last[:-1]])
    breaks = np.append(0, np.flatnonzero(broken))
    parted = breaks[np.searchsorted(breaks, first, side="right") - 1]  # start of the part that contains a plateau
    anew = parted >= before
    before = np.maximum(before, parted)
    sides, changes = [], []
    for name, (level, tolerance) in levels.items():  # of contraction, then of pressure
        values = table[name].to_numpy()
        side, beyond, change = np.zeros(len(first), int), np.zeros(len(first)), np.zeros(len(first), int)
        for i, (a, b) in enumerate(zip(before, first, strict=True)):
            away = values[a:b] - level[i]
            out = np.flatnonzero(np.abs(away) > 2 * tolerance)
            if len(out):
                change[i], side[i] = a + out[-1], 1 if away[out[-1]] > 0 else -1
                beyond[i] = np.max(side[i] * away)
        start = np.where(before < first, values[before], level)
        jump = np.where(anew, level - start, np.diff(level, prepend=level[0]))
        stepped = np.abs(jump) > 2 * tolerance
        by_step = stepped & ((side == 0) | ((name == "pressure") & (beyond < _OVERSHOOT * np.abs(jump))))
        sides.append(np.where(by_step, -np.sign(jump), side).astype(int))
        changes.append(np.where(stepped, change, 0) if name == "pressure" else change)
    moved, pressed = sides
    moved = np.where(changes[1] > changes[0], 0, moved)
    direction = np.array(["", "loading", "unloading"], dtype="<U9")[moved]  # from above: it was stretched
    phase = np.where(moved != 0, "", np.array(["", "venting", "filling"], dtype="<U9")[pressed])
    for i in range(1, len(first)):
        if moved[i] == pressed[i] == 0 and not anew[i]:  # the same plateau, interrupted by a disturbance
            direction[i], phase[i] = direction[i - 1], phase[i - 1]
    return direction, phase.astype("<U9")
