"""Least squares with a force that falls with contraction and rises with pressure.

The linear parameters of a fitted law are changed as little as the points allow, so that the force has the right slopes
on a grid over the domain, wherever the muscle pulls. With the shape held, this is a least-distance problem, which is
solved by non-negative least squares. Constraints are added where the last solution violates them.

References
----------
C. Lawson and R. Hanson, "Solving Least Squares Problems", SIAM 1995, chapter 23.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mckibben.identification.least_squares import Solution, design_matrix
from mckibben.identification.summary import slope_grid, wrong_slopes
from mckibben.muscle import Domain

_ROUNDS = 50
_MARGIN = 1e-6  # of the largest force, between neighbours on the grid
_ROUNDING = 1e-14


def monotone(solution: Solution, domain: Domain) -> Solution | None:
    """Solution with the right slopes in a domain; None if there is none."""
    from scipy.optimize import nnls

    problem, linear = solution.problem, solution.problem.linear
    contraction, pressure = np.broadcast_arrays(*slope_grid(domain))
    law, names = problem.law(solution.values), problem.names[:linear]
    grid = design_matrix(law, names, contraction.ravel(), pressure.ravel()).reshape(*contraction.shape, linear)
    residuals, jacobian = solution.augmented
    columns, first = jacobian[:, :linear], solution.values[:linear]
    lengths = np.linalg.norm(columns, axis=0)
    q, triangle = np.linalg.qr(columns / lengths)
    if not np.isfinite(grid).all() or np.abs(np.diag(triangle)).min() < _ROUNDING:
        return None
    target, margin = q.T @ residuals, _MARGIN * float(problem.force[problem.selected].max())
    wrong = [np.zeros(np.subtract(contraction.shape, less), bool) for less in ((1, 0), (0, 1))]
    step = np.zeros(linear)
    for _ in range(_ROUNDS):
        slopes = wrong_slopes(grid @ (first + step))
        if not any(rises.any() for rises in slopes):
            values = np.concatenate([first + step, solution.values[linear:]])
            errors = residuals - columns @ step
            return replace(solution, values=values, cost=float(errors @ errors))
        wrong = [old | new for old, new in zip(wrong, slopes, strict=True)]
        rising = np.concatenate([-np.diff(grid, axis=0)[wrong[0]], np.diff(grid, axis=1)[wrong[1]]])
        # Least distance: with u = R s - Q^T r, minimise |u| such that the force rises by the margin.
        rows = np.linalg.solve(triangle.T, (rising / lengths).T)
        rows = np.vstack([rows, margin - rising @ first - target @ rows])
        scaled = rows / np.linalg.norm(rows[:-1], axis=0)
        rest = scaled @ nnls(scaled, np.eye(linear + 1)[-1])[0] - np.eye(linear + 1)[-1]
        if not rest[-1] < -_ROUNDING:
            return None
        step = np.linalg.solve(triangle, target - rest[:-1] / rest[-1]) / lengths
    return None
