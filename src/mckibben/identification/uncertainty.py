r"""Standard errors and correlations of fitted parameters, from the Jacobian at the solution.

The covariance is :math:`s^2 (J^T J)^{-1}` with :math:`s^2 = RSS/(n - k)`, over linear and shape parameters
together. It assumes that the errors of the plateau means are independent, of zero mean and of equal size,
and that the force is nearly linear in the parameters over a standard error. Hysteresis is no such error:
where loading and unloading are fitted by one curve, the standard errors are only as good as that curve.

References
----------
G. Seber and C. Wild, "Nonlinear Regression", Wiley 1989, sections 2.1.2 and 2.8.3.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mckibben.identification.factors import triangle

CONDITION_LIMIT = 1e10
"""Of the Jacobian with columns of length one: above it, about six digits of the sixteen are left."""


@dataclass(frozen=True, eq=False)
class Uncertainty:
    """What the data say about how well they determine the parameters.

    Attributes
    ----------
    standard_errors
        Shape (parameters,), in the unit of each; NaN where the parameter was held at a bound.
    correlations
        Shape (parameters, parameters); NaN in the rows and columns of these.
    spread
        s [N], the standard deviation of a plateau mean about the law.
    """

    standard_errors: NDArray[np.float64]
    correlations: NDArray[np.float64]
    spread: float


def uncertainty(jacobian: NDArray[np.float64], residuals: NDArray[np.float64], held: NDArray[np.bool_]) -> Uncertainty:
    """Standard errors and correlations of the parameters that are not held.

    Parameters
    ----------
    jacobian
        Shape (points, parameters): derivative of the force [N] with respect to the parameters.
    residuals
        Shape (points,) [N]; more points than free parameters.
    held
        Shape (parameters,): those at a bound, whose value the data did not choose.

    Examples
    --------
    The mean of four numbers: s is their standard deviation, and the standard error is s/2.

    >>> u = uncertainty(np.ones((4, 1)), np.array([1.0, -1.0, 2.0, -2.0]), np.array([False]))
    >>> round(u.spread, 4), u.standard_errors.round(4)
    (1.8257, array([0.9129]))
    """
    count = jacobian.shape[1]
    free = np.flatnonzero(~held)
    lengths, singular, directions = _decompose(jacobian[:, free])
    inverse = directions.T / singular
    scaled = inverse @ inverse.T
    spread = float(np.sqrt(residuals @ residuals / (len(residuals) - len(free))))
    widths = np.sqrt(np.diag(scaled))
    errors = np.full(count, np.nan)
    errors[free] = spread * widths / lengths
    correlations = np.full((count, count), np.nan)
    correlations[np.ix_(free, free)] = np.clip(scaled / np.outer(widths, widths), -1.0, 1.0)
    correlations[free, free] = 1.0
    return Uncertainty(errors, correlations, spread)


def condition(jacobian: NDArray[np.float64]) -> float:
    """The condition number of a Jacobian with columns scaled to length one; infinite where singular."""
    _, singular, _ = _decompose(jacobian)
    if not len(singular):
        return 1.0
    return float(singular[0] / singular[-1]) if singular[-1] > 0 else np.inf


def undetermined(jacobian: NDArray[np.float64], names: Sequence[str]) -> list[str]:
    """The parameters that can change together and leave all forces nearly as they are."""
    _, _, directions = _decompose(jacobian)
    share = np.abs(directions[-1])
    return [name for name, part in zip(names, share, strict=True) if part > 0.05 * share.max()]


def _decompose(jacobian: NDArray[np.float64]) -> tuple[NDArray[np.float64], ...]:
    """Lengths of the columns; singular values and right singular vectors, as rows, of them at length one."""
    factor = triangle(jacobian)
    lengths = np.linalg.norm(factor, axis=0)
    lengths[lengths == 0] = 1.0
    _, singular, directions = np.linalg.svd(factor / lengths)
    return lengths, singular, directions
