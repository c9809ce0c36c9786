"""How points scatter about a law, by what a fit left over: each on its own, and the points of a stroke together."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mckibben.study.planning.information import Spread


def estimated_spread(
    rows: NDArray[np.float64], residuals: NDArray[np.float64], strokes: NDArray[np.int64] | None
) -> Spread:
    r"""Both standard deviations, from two quadratic forms of the residuals whose expectations are known.

    With Q the projection onto what the rows leave over and Z the indicator of strokes,
    :math:`E[e^T e] = \sigma^2 \mathrm{tr} Q + \tau^2 \mathrm{tr} Z^T Q Z` and
    :math:`E[|Z^T e|^2] = \sigma^2 \mathrm{tr} Z^T Q Z + \tau^2 \mathrm{tr} (Z^T Q Z)^2`: two equations, unbiased.

    Parameters
    ----------
    rows
        Shape (points, parameters): the design matrix; its columns may depend on each other.
    residuals
        Shape (points,) [N]; what the rows explain of them is taken out.
    strokes
        Shape (points,): the stroke of each point, from 0 without gaps; None where strokes have nothing in common.

    Returns
    -------
    Spread
        tau is 0 where the estimate of its square is negative.

    Examples
    --------
    >>> found = estimated_spread(np.ones((4, 1)), np.array([1.0, -1.0, 2.0, -2.0]), None)
    >>> round(found.point, 4)
    1.8257
    """
    lengths = np.linalg.norm(rows, axis=0)
    basis, singular, _ = np.linalg.svd(rows / np.where(lengths > 0, lengths, 1.0), full_matrices=False)
    basis = basis[:, singular > 1e-10 * singular[0]]
    left = residuals - basis @ (basis.T @ residuals)
    count, rank = basis.shape
    if count <= rank:
        return Spread(0.0)
    square = float(left @ left)
    alone = Spread(float(np.sqrt(square / (count - rank))))
    if strokes is None:
        return alone
    groups = np.eye(int(strokes.max()) + 1)[strokes]
    onto = basis.T @ groups
    between = groups.T @ groups - onto.T @ onto
    trace, trace2 = float(np.trace(between)), float(np.sum(between**2))
    sums = groups.T @ left
    equations = np.array([[count - rank, trace], [trace, trace2]])
    if np.linalg.cond(equations) > 1e8:
        return alone
    point, stroke = np.linalg.solve(equations, [square, float(sums @ sums)])
    if stroke <= 0 or point <= 0:
        return alone
    return Spread(float(np.sqrt(point)), float(np.sqrt(stroke)))
