"""Where several signals hold still at once."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

_PARTS = 20  # of a dwell: the means that are compared


class Segments(NamedTuple):
    """Steady segments, in the order of the samples.

    Attributes
    ----------
    first, last
        Shape (segments,): of each the first sample, and the one after the last.
    drifting
        Shape (samples,): steady for a dwell at a time, and yet not part of a segment.
    edge
        Samples at either end of each segment in which motion may already have begun, or not quite have ended: those of
        one mean.
    """

    first: NDArray[np.int64]
    last: NDArray[np.int64]
    drifting: NDArray[np.bool_]
    edge: int


def steady_segments(
    signals: Sequence[tuple[NDArray[np.float64], float]], broken: NDArray[np.bool_], dwell: int
) -> Segments:
    """Find the segments in which every signal stays within its tolerance.

    Means over a twentieth of the dwell are compared, so that noise counts little. A dwell is steady where the means of
    each signal lie within twice its tolerance of each other; steady dwells that overlap make a segment; and of
    a segment its ends are cut off up to where every mean is within the tolerance of the segment's middle half.

    Parameters
    ----------
    signals
        Pairs of samples, shape (n,), and tolerance.
    broken
        Shape (n,): samples that no segment may contain.
    dwell
        Samples that a segment has at least.

    Examples
    --------
    >>> stairs = np.repeat([0.0, 1.0, 5.0], [40, 3, 57])
    >>> found = steady_segments([(stairs, 0.1)], np.zeros(100, bool), 20)
    >>> found.first, found.last
    (array([ 0, 43]), array([ 40, 100]))
    """
    count = len(broken)
    none = np.empty(0, np.int64)
    if count < dwell:
        return Segments(none, none, np.zeros(count, bool), 0)
    size = max(1, dwell // _PARTS)
    window = -(-dwell // size)
    edges = np.arange(0, count - size + 1, size)  # the last block takes what is left over
    bounds = np.append(edges, count)
    sizes = np.diff(bounds)
    if len(edges) < window:
        return Segments(none, none, np.zeros(count, bool), 0)
    means = [(np.add.reduceat(values, edges) / sizes, tolerance) for values, tolerance in signals]
    bad = np.logical_or.reduceat(broken, edges)

    starts = ~_sliding(bad.view(np.uint8), window)[0].astype(bool)
    for values, tolerance in means:
        high, low = _sliding(values, window)
        starts &= high - low <= 2 * tolerance
    opens = np.flatnonzero(np.diff(starts, prepend=False, append=False))
    first, last = opens[::2], opens[1::2] + window - 1  # blocks: the first, and the one after the last
    first = np.maximum(first, np.concatenate([[0], last[:-1]]))  # what two share is the earlier one's
    member = np.zeros(len(edges) + 1, np.int8)
    np.add.at(member, first[last > first], 1)
    np.add.at(member, last[last > first], -1)
    member = np.cumsum(member[:-1]) > 0
    keep = last - first >= window
    first, last = _trimmed(means, first[keep], last[keep])
    keep = last - first >= window
    first, last = first[keep], last[keep]
    inside = np.zeros(len(edges) + 1, np.int8)
    inside[first] += 1
    inside[last] -= 1
    drifting = member & ~(np.cumsum(inside[:-1]) > 0)
    return Segments(bounds[first], bounds[last], np.repeat(drifting, sizes), size if window > 4 else 0)


def _sliding(values: np.ndarray, window: int) -> tuple[np.ndarray, np.ndarray]:
    """Highest and lowest of each window of that many values, shape (n - window + 1,)."""
    from scipy.ndimage import maximum_filter1d, minimum_filter1d  # 50 ms that reading points does not need

    shift = -(window // 2)
    count = len(values) - window + 1
    high = maximum_filter1d(values, window, origin=shift, mode="nearest")[:count]
    low = minimum_filter1d(values, window, origin=shift, mode="nearest")[:count]
    return high, low


def _trimmed(
    means: Sequence[tuple[NDArray[np.float64], float]], first: NDArray[np.int64], last: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Segments of blocks cut to where all is within the tolerance of their middle half."""
    if not len(first):
        return first, last
    lengths = last - first
    offsets = np.concatenate([[0], np.cumsum(lengths)[:-1]])
    blocks = np.arange(lengths.sum()) - np.repeat(offsets - first, lengths)
    within = np.ones(len(blocks), bool)
    quarter = lengths // 4
    for values, tolerance in means:
        total = np.concatenate([[0.0], np.cumsum(values - values.mean())])
        middle = (total[last - quarter] - total[first + quarter]) / (lengths - 2 * quarter) + values.mean()
        within &= np.abs(values[blocks] - np.repeat(middle, lengths)) <= tolerance
    # of each segment the longest stretch that is within
    apart = np.ones(len(blocks), bool)
    apart[1:] = (within[1:] != within[:-1]) | (blocks[1:] != blocks[:-1] + 1)
    apart[offsets] = True
    begins = np.flatnonzero(apart)
    spans = np.diff(begins, append=len(blocks)) * within[begins]
    owner = np.repeat(np.arange(len(first)), lengths)[begins]
    order = np.lexsort((spans, owner))
    best = order[np.searchsorted(owner[order], np.arange(len(first)), side="right") - 1]
    return blocks[begins[best]], blocks[begins[best]] + spans[best]
