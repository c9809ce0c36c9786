"""Samples that say where a channel ends, not what was measured: its floor and its ceiling."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

_LEAST = 10  # samples in a row
_LONGER = 10  # times what is usual in the channel
_JITTER = 0.25  # of the bends change sign: 0.73 do in white noise
_ROUNDING = 1e-9  # of the range
_SHARE = 0.2  # of the samples of a stretch, at an end that was found


def glued(values: NDArray[np.float64]) -> dict[str, NDArray[np.bool_]]:
    """Which samples stick to the lowest or the highest value of a channel.

    An end of the channel is an extreme value that comes at least 10 times in a row, and 10 times longer than the run in
    which a usual sample stands: a converter of few bits repeats its values everywhere. And there must be noise between
    the ends, as a record without any may well have been held at its extremes.
    Where such an end was found, a stretch of which a fifth is at it counts whole: noise around the end lifts samples
    off it, and a mean over them would lie inside.

    Parameters
    ----------
    values
        Shape (n,), finite.

    Returns
    -------
    dict
        "floor" and "ceiling", where there is one: shape (n,).

    Examples
    --------
    >>> noise = np.random.default_rng(0).normal(size=1000)
    >>> clipped = np.maximum(np.where(np.arange(1000) < 300, noise - 5, noise + 3), 0)
    >>> {end: int(where.sum()) for end, where in glued(clipped).items()}
    {'floor': 308}
    >>> glued(noise)
    {}
    """
    count = len(values)
    if count < _LEAST:
        return {}
    starts = np.concatenate([[0], np.flatnonzero(values[1:] != values[:-1]) + 1])
    lengths = np.diff(starts, append=count)
    heights = values[starts]
    found: dict[str, NDArray[np.bool_]] = {}
    low, high = heights.min(), heights.max()
    if low == high:
        return {}
    inside = (heights != low) & (heights != high)
    if not _noisy(heights, inside):
        return {}
    usual = _usual(lengths[inside])
    for end, value in (("floor", low), ("ceiling", high)):
        longest = int(lengths[heights == value].max())
        if longest >= max(_LEAST, _LONGER * usual):
            found[end] = _stretches(values == value)
    return found


def _noisy(heights: NDArray[np.float64], inside: NDArray[np.bool_]) -> bool:
    """Whether values jitter: the bend of noise changes its sign from one to the next, that of a motion does not."""
    bend = np.diff(heights, 2)
    bend[np.abs(bend) <= _ROUNDING * np.ptp(heights)] = 0
    within = inside[:-3] & inside[1:-2] & inside[2:-1] & inside[3:]
    if not within.any():
        return False
    return bool(np.mean((bend[:-1] * bend[1:] < 0)[within]) > _JITTER)


def _usual(lengths: NDArray[np.int64]) -> int:
    """The length of the run in which the middle one of all samples stands."""
    counts = np.bincount(lengths)
    samples = np.cumsum(counts * np.arange(len(counts)))
    return int(np.searchsorted(samples, samples[-1] / 2))


def _stretches(at_end: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """The samples at an end, and those around which at least a fifth is."""
    window = 2 * _LEAST + 1
    if len(at_end) < window:
        return at_end
    total = np.concatenate([[0], np.cumsum(at_end, dtype=np.int32)])
    share = (total[window:] - total[:-window]) / window
    dense = np.zeros(len(at_end), bool)
    dense[_LEAST : _LEAST + len(share)] = share >= _SHARE
    return at_end | dense
