r"""Variable projection: the linear parameters are eliminated, only the shape is searched.

Given the shape, the best linear parameters are an ordinary linear least-squares problem. What is left,
:math:`r(s) = (I - Q Q^T)\,y` with :math:`Q R` the factors of the design matrix at the shape :math:`s`, is
minimised by Gauss-Newton with Kaufman's approximation of its derivative, :math:`-(I - Q Q^T)\,\partial
F/\partial s`. What that leaves out of the second derivative, much where the law describes the data badly, is learned
from step to step.

References
----------
G. Golub and V. Pereyra, "Separable nonlinear least squares: the variable projection method and its
applications", Inverse Problems 19 (2003) R1-R26; L. Kaufman, BIT 15 (1975) 49-57; J. Dennis, D. Gay and R. Welsch,
"An adaptive nonlinear least-squares algorithm", ACM Trans. Math. Software 7 (1981) 348-368.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mckibben.identification.factors import triangle
from mckibben.identification.problem import FitProblem, Solution

_MAX_STEPS = 100
_MAX_HALVINGS = 30
_SMALL_STEP = 1e-11  # in the unit cube: a step below this is not worth taking
_ROUNDING = 1e-13  # of the measured forces: below this an expected gain is rounding
_COST_ROUNDING = 1e-14  # of the sum of squares: it cannot tell two positions that differ by less


@dataclass(frozen=True, eq=False)
class Projected:
    """The best that the linear parameters can do at one shape, and how that changes with the shape.

    Attributes
    ----------
    position, values
        Of the shape in the unit cube; all parameters, the linear ones at their best.
    cost
        The sum of squared residuals [N^2].
    derivative, residuals
        Shape (shape, shape) and (shape,): that of the force with respect to the position, the linear parameters
        following it, as a triangle, and what of the residuals is along it.
    following
        Shape (linear, shape): how the best linear parameters change with the position.
    """

    position: NDArray[np.float64]
    values: NDArray[np.float64]
    cost: float
    derivative: NDArray[np.float64]
    residuals: NDArray[np.float64]
    following: NDArray[np.float64]

    @property
    def push(self) -> NDArray[np.float64]:
        """Minus half the derivative of the cost, shape (shape,)."""
        return self.derivative.T @ self.residuals


def project(problem: FitProblem, position: NDArray[np.float64], guess: NDArray[np.float64] | None = None) -> Projected:
    """Solve for the linear parameters; the cost is infinite where the law has no force at one of the points.

    All is read from the triangle of linear columns, columns of the shape, and residuals, side by side: below the linear
    columns stands what is left of the others after what the linear parameters undo. The guess of the linear parameters,
    shape (linear,), is of use to the derivative alone, which is that of the force at the guess.
    """
    linear = problem.linear
    values = np.concatenate([np.zeros(linear) if guess is None else guess, problem.cube.values(position)])
    rows = problem.rows(values)
    if not np.isfinite(rows).all():  # the law has no force at some point for this shape
        shape = len(position)
        return Projected(position, values, np.inf, np.zeros((shape, shape)), np.zeros(shape), np.zeros((linear, shape)))
    factor = triangle(rows.T)
    factor[:, linear:-1] *= problem.cube.rates(position)
    lengths = np.linalg.norm(factor[:, :linear], axis=0)  # of the columns: pressures are in Pa
    lengths[lengths == 0] = 1.0
    undone = np.linalg.lstsq(factor[:linear, :linear] / lengths, factor[:linear, linear:], rcond=None)[0]
    undone /= lengths[:, None]
    values[:linear] += undone[:, -1]
    rest = factor[linear:, -1]
    return Projected(
        position, values, float(rest @ rest), factor[linear:-1, linear:-1], rest[:-1], following=-undone[:, :-1]
    )


def search(problem: FitProblem) -> NDArray[np.float64]:
    """The best position of a grid over the range of the shape."""
    return min((project(problem, position) for position in problem.cube.grid()), key=lambda p: p.cost).position


def solve_by_projection(problem: FitProblem, start: NDArray[np.float64]) -> Solution:
    """Refine a position by Gauss-Newton with step halving, inside the unit cube."""
    linear = problem.linear
    best = project(problem, start, project(problem, start).values[:linear])
    curvature, drift = np.zeros((len(start), len(start))), np.zeros((linear, len(start)))
    size = float(np.linalg.norm(problem.measured))
    converged = False
    for _ in range(_MAX_STEPS):
        step = _step(best, curvature)
        longest = float(np.abs(step).max(initial=0.0))
        if longest < _SMALL_STEP or float(np.linalg.norm(best.derivative @ step)) <= _ROUNDING * size:
            converged = True
            break
        trial = _descend(problem, best, step, drift)
        if trial is None:
            converged = longest < 1e-6
            break
        moved = trial.position - best.position
        curvature = curvature + _curvature_missed(curvature, trial, trial.push - best.push, moved)
        followed = trial.values[:linear] - best.values[:linear]
        if moved.any():
            drift = drift + np.outer(followed - (trial.following + drift) @ moved, moved) / (moved @ moved)
        best = trial
    residuals, jacobian = problem.response(best.values)
    return Solution(best.values, best.position, residuals, jacobian, converged)


def _step(at: Projected, curvature: NDArray[np.float64]) -> NDArray[np.float64]:
    """Newton's step with the curvature, or that of Gauss and Newton where it makes no minimum."""
    free = ~(((at.position <= 0) & (at.push < 0)) | ((at.position >= 1) & (at.push > 0)))  # not pressed against a face
    derivative = at.derivative[:, free]
    second = derivative.T @ derivative + curvature[np.ix_(free, free)]
    step = np.zeros_like(at.position)
    if curvature.any() and np.linalg.eigvalsh(second).min(initial=np.inf) > 0:
        step[free] = np.linalg.solve(second, at.push[free])
    else:
        step[free] = np.linalg.lstsq(derivative, at.residuals, rcond=None)[0]
    return step


def _curvature_missed(
    curvature: NDArray[np.float64], at: Projected, change: NDArray[np.float64], moved: NDArray[np.float64]
) -> NDArray[np.float64]:
    """What is still left out of the second derivative of the cost, from how the push changed over a step.

    An update of rank one; with a single shape parameter it is the secant.
    """
    missing = -change - at.derivative.T @ (at.derivative @ moved) - curvature @ moved
    scale = float(missing @ moved)
    if abs(scale) <= 1e-8 * float(np.linalg.norm(missing) * np.linalg.norm(moved)):
        return np.zeros_like(curvature)
    return np.outer(missing, missing) / scale


def _descend(
    problem: FitProblem, at: Projected, step: NDArray[np.float64], drift: NDArray[np.float64]
) -> Projected | None:
    """The first of the step, its half, its quarter ... that does not raise the cost."""
    for _ in range(_MAX_HALVINGS):
        position = np.clip(at.position + step, 0.0, 1.0)
        guess = at.values[: problem.linear] + (at.following + drift) @ (position - at.position)
        trial = project(problem, position, guess)
        if trial.cost <= (1 + _COST_ROUNDING) * at.cost:
            return trial
        step = step / 2
    return None
