"""Non-linear least squares between bounds by SciPy: slow to import and to run, and hard to lead astray.

The quick solvers take undamped steps. Where parameters trade off along a bent valley, or the best shape lies at a
bound, they may come to a halt before the end; what they found is then the start here.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mckibben.identification.problem import FitProblem, Solution
from mckibben.identification.projection import project

_TOLERANCE = 1e-12
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
        ftol=_TOLERANCE,
        xtol=_TOLERANCE,
        gtol=_TOLERANCE,
        max_nfev=_MAX_EVALUATIONS,
    )
    position = np.clip(found.x[linear:], 0.0, 1.0)
    faces = np.where(position < _FACE, 0.0, np.where(position > 1 - _FACE, 1.0, position))
    best = min(
        (project(problem, position), project(problem, faces)), key=lambda p: p.cost * (1 - 1e-9 * (p.position is faces))
    )
    remaining, columns = problem.response(best.values)
    return Solution(best.values, best.position, remaining, columns, bool(found.success))
