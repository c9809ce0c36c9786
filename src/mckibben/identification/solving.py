"""Which solver a problem gets, and what is tried where it fails."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mckibben.identification.nonlinear import solve_by_optimistix
from mckibben.identification.problem import FitProblem, Solution
from mckibben.identification.projection import project, solve_by_projection


def solve(problem: FitProblem, start: NDArray[np.float64]) -> Solution:
    """Refine a position in the unit cube of the shape, shape (shape parameters,).

    By variable projection for a law that is linear in other parameters and by Levenberg-Marquardt for one that is not.
    Where these come to a halt on the way, SciPy's trust region goes on from the better of start and halt.
    """
    quick = solve_by_projection if problem.linear else solve_by_optimistix
    solution = quick(problem, start)
    if solution.converged:
        return solution
    from mckibben.identification.bounded import solve_between_bounds

    begun = project(problem, start)
    if not np.isfinite(begun.cost):
        return solution
    reached = _cost(solution.residuals)
    values = solution.values if reached <= begun.cost else begun.values
    return min((solution, solve_between_bounds(problem, values)), key=lambda s: (not s.converged, _cost(s.residuals)))


def _cost(residuals: NDArray[np.float64]) -> float:
    return float(residuals @ residuals) if np.isfinite(residuals).all() else np.inf
