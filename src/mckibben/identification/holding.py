"""Least squares with one shape parameter held and all others fitted again, as a profile asks for it.

Far from the best fit Gauss and Newton's method with step halving may stop short. Here a trust region inside the unit
cube takes its place (`scipy.optimize.least_squares`); the linear parameters are eliminated as in
`mckibben.identification.projection`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mckibben.identification.problem import FitProblem
from mckibben.identification.projection import project

_INSIDE = 1e-9  # the trust region starts off the faces of the cube
_MOST_STEPS = 300


@dataclass(frozen=True, eq=False)
class Refit:
    """The answer.

    Attributes
    ----------
    values, position
        All parameters in SI; the shape in the unit cube.
    cost
        The sum of squared residuals [N^2].
    converged
        Whether the solver says so.
    """

    values: NDArray[np.float64]
    position: NDArray[np.float64]
    cost: float
    converged: bool


def solve_holding(problem: FitProblem, start: NDArray[np.float64], index: int, u: float) -> Refit:
    """Refine a position in the unit cube, one coordinate of which stays.

    Parameters
    ----------
    problem
        What to fit.
    start
        Shape (shape,), in the unit cube.
    index, u
        The number of the shape parameter that is held, and its coordinate.
    """
    from scipy.optimize import least_squares  # 0.1 s, which no import of the package should wait for

    position = np.clip(start, 0.0, 1.0)
    position[index] = u
    free = np.delete(np.arange(len(position)), index)
    if not len(free):
        best = project(problem, position)
        return Refit(best.values, position, best.cost, True)

    def at(part: NDArray[np.float64]) -> NDArray[np.float64]:
        whole = position.copy()
        whole[free] = part
        return whole

    def response(part: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        return problem.response(project(problem, at(part)).values)

    def derivative(part: NDArray[np.float64]) -> NDArray[np.float64]:
        _, columns = response(part)
        linear, rates = columns[:, : problem.linear], problem.cube.rates(at(part))
        shape = (columns[:, problem.linear :] * rates)[:, free]
        lengths = np.linalg.norm(linear, axis=0)
        q, _ = np.linalg.qr(linear / np.where(lengths > 0, lengths, 1.0))
        return q @ (q.T @ shape) - shape  # Kaufman's: what the linear parameters do not undo

    found = least_squares(
        lambda part: response(part)[0],
        np.clip(position[free], _INSIDE, 1 - _INSIDE),
        derivative,  # type: ignore[arg-type]
        bounds=(0.0, 1.0),
        xtol=1e-10,
        ftol=1e-12,
        gtol=1e-12,
        max_nfev=_MOST_STEPS,
    )
    best = project(problem, at(found.x))
    return Refit(best.values, best.position, best.cost, found.status > 0)
