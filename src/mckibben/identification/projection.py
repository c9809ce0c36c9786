r"""Variable projection: the linear parameters are eliminated, only the shape is searched.

Given the shape, the best linear parameters are an ordinary linear least-squares problem. What is left,
:math:`r(s) = (I - Q Q^T)\,y` with :math:`Q R` the factors of the design matrix at the shape :math:`s`, is
minimised by Gauss-Newton with Kaufman's approximation of its derivative, :math:`-(I - Q Q^T)\,\partial
F/\partial s`.

References
----------
G. Golub and V. Pereyra, "Separable nonlinear least squares: the variable projection method and its
applications", Inverse Problems 19 (2003) R1-R26; L. Kaufman, BIT 15 (1975) 49-57.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mckibben.identification.factors import tall_qr
from mckibben.identification.problem import FitProblem, Solution

_MAX_STEPS = 100
_MAX_HALVINGS = 30
_SMALL_STEP = 1e-11  # in the unit cube
_ROUNDING = 1e-13  # of the measured forces: below this an expected gain is rounding


@dataclass(frozen=True, eq=False)
class Projected:
    """The best that the linear parameters can do at one shape: `values` has them with the shape."""

    position: NDArray[np.float64]
    values: NDArray[np.float64]
    basis: NDArray[np.float64]  # orthonormal columns that span the linear part
    residuals: NDArray[np.float64]

    @property
    def cost(self) -> float:
        """The sum of squared residuals [N^2]."""
        return float(self.residuals @ self.residuals)


def project(problem: FitProblem, position: NDArray[np.float64]) -> Projected:
    """Solve for the linear parameters, columns scaled to length one (pressures are in Pa)."""
    values = np.concatenate([np.zeros(problem.linear), problem.cube.values(position)])
    offset, design = problem.response(values)
    columns = design[:, : problem.linear]
    lengths = np.linalg.norm(columns, axis=0)
    lengths[lengths == 0] = 1.0
    basis, triangle = tall_qr(columns / lengths)
    rest = problem.measured - offset
    coefficients = np.linalg.lstsq(triangle, basis.T @ rest, rcond=None)[0]
    values[: problem.linear] = coefficients / lengths
    return Projected(position, values, basis, rest - columns @ values[: problem.linear])


def search(problem: FitProblem) -> NDArray[np.float64]:
    """The best position of a grid over the range of the shape."""
    return min((project(problem, position) for position in problem.cube.grid()), key=lambda p: p.cost).position


def solve_by_projection(problem: FitProblem, start: NDArray[np.float64]) -> Solution:
    """Refine a position by Gauss-Newton with step halving, inside the unit cube."""
    best = project(problem, start)
    size = float(np.linalg.norm(problem.measured))
    converged = False
    for _ in range(_MAX_STEPS):
        derivative = _projected_derivative(problem, best)
        free = _free(best, derivative)
        step = np.zeros_like(start)
        step[free] = np.linalg.lstsq(derivative[:, free], best.residuals, rcond=None)[0]
        gain = float(np.linalg.norm(derivative @ step))
        trial = _descend(problem, best, step)
        negligible = gain <= _ROUNDING * size
        if trial is None:
            converged = negligible or float(np.abs(step).max(initial=0.0)) < 1e-6
            break
        moved = float(np.abs(trial.position - best.position).max(initial=0.0))
        best = trial
        if negligible or moved < _SMALL_STEP:
            converged = True
            break
    _, jacobian = problem.response(best.values)
    return Solution(best.values, best.position, best.residuals, jacobian, converged)


def _projected_derivative(problem: FitProblem, at: Projected) -> NDArray[np.float64]:
    """The derivative of the force with respect to the position, less what the linear parameters undo."""
    _, design = problem.response(at.values)
    columns = design[:, problem.linear :] * problem.cube.rates(at.position)
    return columns - at.basis @ (at.basis.T @ columns)


def _free(at: Projected, derivative: NDArray[np.float64]) -> NDArray[np.bool_]:
    """The coordinates that are not pressed against a face of the cube."""
    push = derivative.T @ at.residuals
    return ~(((at.position <= 0) & (push < 0)) | ((at.position >= 1) & (push > 0)))


def _descend(problem: FitProblem, at: Projected, step: NDArray[np.float64]) -> Projected | None:
    """The first of the step, its half, its quarter ... that does not raise the cost."""
    for _ in range(_MAX_HALVINGS):
        trial = project(problem, np.clip(at.position + step, 0.0, 1.0))
        if trial.cost <= at.cost:
            return trial
        step = step / 2
    return None
