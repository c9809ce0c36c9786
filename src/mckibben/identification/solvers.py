"""Solvers of least-squares problems: variable projection, Gauss-Newton and bounded trust region."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mckibben.identification.problem import FitProblem, Solution, UnitCube
from mckibben.identification.uncertainty import tsqr_r
from mckibben.muscle import ForceLaw

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
    factor = tsqr_r(rows.T)
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


_NONLINEAR_TOLERANCE = 1e-11  # of the position in the unit cube, and of the residuals in parts of the measured forces
_MAX_NONLINEAR_STEPS = 256


def solve_by_optimistix(problem: FitProblem, start: NDArray[np.float64]) -> Solution:
    """Refine a position in the unit cube by Levenberg-Marquardt; it stays in the cube."""
    solve = _compiled(problem.law_type)
    scale = float(np.sqrt(np.mean(problem.measured**2)))
    weights = problem.factors / scale
    found, converged = solve(start, problem.contraction, problem.pressure, problem.force, weights)
    position = np.clip(np.asarray(found), 0.0, 1.0)
    values = np.array(problem.cube.values(position))
    residuals, jacobian = problem.response(values)
    push = (jacobian * problem.cube.rates(position)).T @ residuals
    held_wrongly = ((position <= 0) & (push > 0)) | ((position >= 1) & (push < 0))
    return Solution(values, position, residuals, jacobian, bool(converged) and not held_wrongly.any())


@functools.cache
def _compiled(law_type: type[ForceLaw]) -> Callable[..., tuple[Any, Any]]:
    import jax
    import jax.numpy as jnp
    import optimistix  # 0.1 s, and only some laws need it

    names = [p.name for p in law_type.shape_parameters]
    cube = UnitCube(law_type.shape_parameters)
    solver = optimistix.LevenbergMarquardt(rtol=_NONLINEAR_TOLERANCE, atol=_NONLINEAR_TOLERANCE)

    def residuals(position: Any, points: Any) -> Any:
        contraction, pressure, force, weights = points
        values = cube.values(jnp.clip(position, 0.0, 1.0))
        return weights * (force - law_type(**dict(zip(names, values, strict=True))).force(contraction, pressure))

    @jax.jit
    def solve(start: Any, *points: Any) -> tuple[Any, Any]:
        solution = optimistix.least_squares(
            residuals, solver, start, args=points, options={"jac": "fwd"}, max_steps=_MAX_NONLINEAR_STEPS, throw=False
        )
        return solution.value, solution.result == optimistix.RESULTS.successful

    return solve


_BOUNDED_TOLERANCE = 1e-12
_MAX_EVALUATIONS = 300
_FACE = 1e-4  # the trust region keeps inside the cube: this near to a face it means the face


def solve_between_bounds(problem: FitProblem, start: NDArray[np.float64]) -> Solution:
    """Refine all parameters at once by a trust region in the space of the unit cube.

    Parameters
    ----------
    problem
        What to solve.
    start
        Shape (parameters,): values to start from; the law has a force there.

    References
    ----------
    M. Branch, T. Coleman and Y. Li, "A subspace, interior, and conjugate gradient method for large-scale
    bound-constrained minimization problems", SIAM J. Sci. Comput. 21 (1999) 1-23; `scipy.optimize.least_squares`.
    """
    from scipy.optimize import least_squares  # 0.3 s, and few fits need it

    linear = problem.linear
    jacobian = problem.response(start)[1]
    lengths = np.linalg.norm(jacobian[:, :linear], axis=0)
    lengths[lengths == 0] = 1.0

    def values(x: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.concatenate([x[:linear] / lengths, problem.cube.values(np.clip(x[linear:], 0.0, 1.0))])

    def residuals(x: NDArray[np.float64]) -> NDArray[np.float64]:
        return problem.response(values(x))[0]

    def derivative(x: NDArray[np.float64]) -> NDArray[np.float64]:
        columns = problem.response(values(x))[1].copy()
        columns[:, :linear] /= lengths
        columns[:, linear:] *= problem.cube.rates(x[linear:])
        return -columns

    inside = np.clip(problem.cube.position(start[linear:]), 1e-9, 1 - 1e-9)
    found = least_squares(
        residuals,
        np.concatenate([start[:linear] * lengths, inside]),
        jac=derivative,  # type: ignore[arg-type]  # the stubs know its name only
        bounds=([-np.inf] * linear + [0.0] * len(inside), [np.inf] * linear + [1.0] * len(inside)),
        x_scale="jac",
        ftol=_BOUNDED_TOLERANCE,
        xtol=_BOUNDED_TOLERANCE,
        gtol=_BOUNDED_TOLERANCE,
        max_nfev=_MAX_EVALUATIONS,
    )
    position = np.clip(found.x[linear:], 0.0, 1.0)
    faces = np.where(position < _FACE, 0.0, np.where(position > 1 - _FACE, 1.0, position))
    best = min(
        (project(problem, position), project(problem, faces)), key=lambda p: p.cost * (1 - 1e-9 * (p.position is faces))
    )
    remaining, columns = problem.response(best.values)
    return Solution(best.values, best.position, remaining, columns, bool(found.success))


def solve(problem: FitProblem, start: NDArray[np.float64]) -> Solution:
    """Refine a position in the unit cube of the shape, shape (shape parameters,).

    By variable projection for a law that is linear in other parameters and by Levenberg-Marquardt for one that is not.
    Where these come to a halt on the way, SciPy's trust region goes on from the better of start and halt.
    """
    quick = solve_by_projection if problem.linear else solve_by_optimistix
    solution = quick(problem, start)
    if solution.converged:
        return solution

    begun = project(problem, start)
    if not np.isfinite(begun.cost):
        return solution
    reached = _cost(solution.residuals)
    values = solution.values if reached <= begun.cost else begun.values
    return min((solution, solve_between_bounds(problem, values)), key=lambda s: (not s.converged, _cost(s.residuals)))


def _cost(residuals: NDArray[np.float64]) -> float:
    return float(residuals @ residuals) if np.isfinite(residuals).all() else np.inf


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
