"""The raw samples of plateaus to their means."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

_BLOCK = 32768  # samples worked on at a time: 256 KiB of floats stay in a core's cache


def mean_and_spread(samples: np.ndarray) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Mean and standard deviation of each row, in one pass through memory and without a copy of the whole.

    Parameters
    ----------
    samples
        Shape (points, samples), of any float type; the sums are of float64.

    Returns
    -------
    mean, spread
        Shape (points,), in the unit of the samples.

    Examples
    --------
    >>> mean_and_spread(np.array([[1.0, 3.0], [5.0, 5.0]]))
    (array([2., 5.]), array([1., 0.]))
    """
    points, count = samples.shape
    mean, spread = np.empty(points), np.empty(points)
    rows = max(1, _BLOCK // count)
    deviation = np.empty((rows, count))
    for start in range(0, points, rows):
        block = samples[start : start + rows]
        here = slice(start, start + len(block))
        mean[here] = block.mean(axis=1, dtype=np.float64)
        part = np.subtract(block, mean[here, None], out=deviation[: len(block)])
        spread[here] = np.sqrt(np.einsum("ij,ij->i", part, part) / count)
    return mean, spread
