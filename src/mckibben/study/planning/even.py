"""Evenly spaced points, which a plan has to beat."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mckibben.study.planning.candidates import States


def even_layouts(states: States, count: int, directions: int) -> list[NDArray[np.int64]]:
    """Ways to spread points evenly: over so many pressures, and at each from one end of the taut stroke to the other.

    Parameters
    ----------
    states
        From which to choose.
    count
        How many points.
    directions
        How many directions there are; they alternate from point to point and from pressure to pressure.

    Returns
    -------
    list of ndarray
        Of shape (count, 3) each: pressure and contraction by number, and direction; one layout for each number of
        pressures from one to half of the points. Empty if there are fewer states than points.

    Examples
    --------
    >>> axis = np.arange(5.0)
    >>> layouts = even_layouts(States(axis, axis, np.ones((5, 5)), np.ones((5, 5), bool)), 4, 2)
    >>> [layout.tolist() for layout in layouts]
    [[[2, 0, 0], [2, 1, 1], [2, 3, 0], [2, 4, 1]], [[0, 0, 0], [0, 4, 1], [4, 0, 1], [4, 4, 0]]]
    """
    usable = np.flatnonzero(states.allowed.any(axis=1))
    layouts = []
    for levels in range(1, max(count // 2, 1) + 1):
        rows = usable[_spread(len(usable), levels)]
        sizes = np.full(levels, count // levels)
        sizes[levels - count % levels :] += 1  # more at high pressure, where the taut stroke is long
        if len(np.unique(rows)) < levels:
            break
        layout = []
        for i, (row, size) in enumerate(zip(rows, sizes, strict=True)):
            there = np.flatnonzero(states.allowed[row])
            columns = there[_spread(len(there), int(size))]
            layout += [(row, column, (i + j) % directions) for j, column in enumerate(columns)]
        if len(set(layout)) == count:
            layouts.append(np.array(layout))
    return layouts


def _spread(size: int, count: int) -> NDArray[np.int64]:
    """So many of `size` places from the first to the last; of one, the middle."""
    if count == 1:
        return np.array([(size - 1) // 2])
    return np.round(np.linspace(0, size - 1, count)).astype(np.int64)
