r"""Intervals and bands: from the scatter of the parameters to that of whatever depends on them.

By the delta method: a quantity :math:`f(\theta)` has the variance of its gradient :math:`c = \partial f/\partial\theta`
at the estimate, exact where f is linear in the parameters, as the force is in all but the shape. Gradients come from
forward differentiation through the law.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mckibben.errors import RangeError
from mckibben.identification.design import design_matrix
from mckibben.identification.evidence import Evidence
from mckibben.identification.groups import Grouping
from mckibben.identification.robust import ErrorModel
from mckibben.muscle import ForceLaw, forces


class Interval(NamedTuple):
    """From lowest to highest, in SI; NaN where none is known."""

    lower: float
    upper: float


@dataclass(frozen=True, eq=False)
class Band:
    """A quantity and how sure it is, pointwise.

    Attributes
    ----------
    level
        The share of data sets for which the interval at a point holds the truth.
    value
        The estimate; its shape is that of all else, its unit too.
    standard_error
        Of the estimate.
    degrees_of_freedom
        Of the t interval.
    lower, upper
        Its ends.
    """

    level: float
    value: NDArray[np.float64]
    standard_error: NDArray[np.float64]
    degrees_of_freedom: NDArray[np.float64]
    lower: NDArray[np.float64]
    upper: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class ForceBand:
    """The force [N] of a fitted law, and that of a further measurement.

    Attributes
    ----------
    mean
        Where the law would lie if it were fitted to ever more such points. That is where the force of the muscle lies
        if the law is of the right kind; by how much a wrong one misses it is not in here, see
        `mckibben.identification.evidence.Evidence.doubts` and the residuals.
    measurement
        Where one more plateau mean of the same muscle on the same rig would lie: wider by the residuals' spread.
    """

    mean: Band
    measurement: Band


def check_level(level: float) -> float:
    """The level if it is one.

    Raises
    ------
    RangeError
        If it is not between 0 and 1.
    """
    if not 0 < level < 1:
        remedy = "write 0.95 for 95 %" if level >= 1 else ""
        raise RangeError(f"a level of {level:g} is no probability", value=level, lower=0.0, upper=1.0, remedy=remedy)
    return level


def quantile(level: float, freedom: ArrayLike) -> NDArray[np.float64]:
    """How many standard errors a two-sided t interval reaches to each side.

    >>> quantile(0.95, [4.0, 1e9]).round(3)
    array([2.776, 1.96 ])
    """
    from scipy.special import stdtrit

    return np.asarray(stdtrit(np.minimum(freedom, 1e12), (1 + check_level(level)) / 2))


def band(
    level: float,
    value: ArrayLike,
    variances: Sequence[tuple[NDArray[np.float64], NDArray[np.float64]]],
) -> Band:
    """A band from independent contributions to its variance, each with its degrees of freedom.

    Their sum has the degrees of freedom of Satterthwaite, (sum V)^2 / sum(V^2/nu).
    """
    value = np.asarray(value, np.float64)
    total = np.sum([variance for variance, _ in variances], axis=0).reshape(value.shape)
    parts = np.sum([variance**2 / freedom for variance, freedom in variances], axis=0).reshape(value.shape)
    with np.errstate(divide="ignore", invalid="ignore"):
        freedom = np.where(parts > 0, total**2 / parts, np.inf)
    error = np.sqrt(total)
    reach = quantile(level, freedom) * error
    return Band(level, value, error, freedom, value - reach, value + reach)


def force_gradients(law: ForceLaw, free: Sequence[str], contraction: ArrayLike, pressure: ArrayLike) -> NDArray:
    """The derivative of the force with respect to the named parameters, shape (points, parameters).

    Points are padded to a power of two, so that bands of different sizes share what is compiled.
    """
    contraction, pressure = np.broadcast_arrays(np.asarray(contraction, float), np.asarray(pressure, float))
    count = contraction.size
    if not count:
        return np.empty((0, len(free)))
    pad = (0, max(128, 1 << (count - 1).bit_length()) - count)
    padded = (np.pad(column.ravel(), pad, mode="edge") for column in (contraction, pressure))
    return design_matrix(law, free, *padded)[:count]


def force_band(
    law: ForceLaw,
    evidence: Evidence,
    contraction: ArrayLike,
    pressure: ArrayLike,
    *,
    level: float = 0.95,
    by: Grouping | None = None,
) -> ForceBand:
    """The force of a fitted law with its uncertainty.

    Parameters
    ----------
    law
        As fitted.
    evidence
        What it was fitted to.
    contraction, pressure
        Where [-], [Pa]; they broadcast.
    level
        Of the intervals, pointwise.
    by
        How errors are grouped; by the rule of the fit unless said.
    """
    check_level(level)
    contraction, pressure = np.asarray(contraction, float), np.asarray(pressure, float)
    value = forces(law, contraction, pressure)
    free = [evidence.problem.names[i] for i in evidence.free]
    gradients = force_gradients(law, free, contraction, pressure)
    model = evidence.error_model(by)
    variance, freedom = model.variance(gradients)
    square, left = model.scatter
    scatter = np.full_like(variance, square), np.full_like(freedom, left)
    mean = band(level, value, [(variance, freedom)])
    return ForceBand(mean, band(level, value, [(variance, freedom), scatter]))


def parameter_interval(estimate: float, error: float, freedom: float, level: float) -> Interval:
    """The t interval of one parameter."""
    if math.isnan(error):
        return Interval(math.nan, math.nan)
    reach = float(quantile(level, freedom)) * error
    return Interval(estimate - reach, estimate + reach)


def variance_of(model: ErrorModel, gradients: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Variance and degrees of freedom for gradients of shape (..., parameters), in the shape (...)."""
    variance, freedom = model.variance(gradients.reshape(-1, gradients.shape[-1]))
    return variance.reshape(gradients.shape[:-1]), freedom.reshape(gradients.shape[:-1])
