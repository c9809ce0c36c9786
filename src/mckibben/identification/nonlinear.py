"""Non-linear least squares for laws that are linear in nothing, by optimistix."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mckibben.identification.problem import FitProblem, Solution
from mckibben.identification.ranges import UnitCube
from mckibben.muscle import ForceLaw

_TOLERANCE = 1e-11  # of the position in the unit cube, and of the residuals in parts of the measured forces
_MAX_STEPS = 256


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
    solver = optimistix.LevenbergMarquardt(rtol=_TOLERANCE, atol=_TOLERANCE)

    def residuals(position: Any, points: Any) -> Any:
        contraction, pressure, force, weights = points
        values = cube.values(jnp.clip(position, 0.0, 1.0))
        return weights * (force - law_type(**dict(zip(names, values, strict=True))).force(contraction, pressure))

    @jax.jit
    def solve(start: Any, *points: Any) -> tuple[Any, Any]:
        solution = optimistix.least_squares(
            residuals, solver, start, args=points, options={"jac": "fwd"}, max_steps=_MAX_STEPS, throw=False
        )
        return solution.value, solution.result == optimistix.RESULTS.successful

    return solve
