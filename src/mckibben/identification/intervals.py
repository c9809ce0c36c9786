"""Confidence and prediction intervals of parameters and dependent quantities."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mckibben.errors import RangeError
from mckibben.identification.least_squares import design_matrix
from mckibben.identification.uncertainty import ErrorModel, Floats, Grouping
from mckibben.muscle import ForceLaw


@dataclass(frozen=True)
class RobustErrors:
    """Cluster-robust standard errors [SI] and degrees of freedom by parameter; NaN at a bound."""

    by: Grouping
    groups: int
    standard_errors: Mapping[str, float] = field(repr=False)
    degrees_of_freedom: Mapping[str, float] = field(repr=False)


class Interval(NamedTuple):
    """Interval in SI units; NaN if unknown."""

    lower: float
    upper: float


@dataclass(frozen=True, eq=False)
class IntervalEstimate:
    """Estimate of a quantity with its pointwise interval; all arrays have the shape of `value`."""

    level: float
    value: Floats
    standard_error: Floats
    degrees_of_freedom: Floats
    lower: Floats
    upper: Floats


@dataclass(frozen=True, eq=False)
class ForceIntervals:
    """Intervals of the force at new pressures and contractions (confidence), and of a plateau mean there (prediction).

    In N, for the same muscle and rig. Systematic errors of the rig are in neither.
    """

    confidence: IntervalEstimate
    prediction: IntervalEstimate


def check_level(level: float) -> float:
    """Return the confidence level, or raise a `RangeError` if it is not between 0 and 1."""
    if not 0 < level < 1:
        remedy = "write 0.95 for 95 %" if level >= 1 else ""
        raise RangeError(f"a level of {level:g} is not a probability", value=level, lower=0.0, upper=1.0, remedy=remedy)
    return level


def t_quantile(level: float, freedom: ArrayLike) -> Floats:
    """Half-width of a two-sided t interval in standard errors."""
    from scipy.special import stdtrit

    return np.asarray(stdtrit(np.minimum(freedom, 1e12), (1 + check_level(level)) / 2))


def profile_interval(grid: Floats, roots: Floats, limit: float, place: int, unbounded: float) -> tuple[float, float]:
    """Where roots of the increase of the cost reach a limit beside a place; `unbounded` and infinity if nowhere."""
    below = np.flatnonzero(roots[:place] > limit)
    above = np.flatnonzero(roots[place:] > limit) + place

    def crossing(outside: int, inside: int) -> float:
        part = (roots[outside] - limit) / (roots[outside] - roots[inside])
        return float(grid[outside] + part * (grid[inside] - grid[outside]))

    return (
        crossing(int(below[-1]), int(below[-1]) + 1) if len(below) else unbounded,
        crossing(int(above[0]), int(above[0]) - 1) if len(above) else np.inf,
    )


def minimum_near(cost: Callable[[float], float], grid: Sequence[float], costs: Sequence[float], xatol: float) -> float:
    """Minimum of a cost between the neighbours of the lowest one of an ascending grid."""
    from scipy.optimize import minimize_scalar  # takes 0.1 s to import

    at = int(np.argmin(costs))
    bounds = (grid[max(at - 1, 0)], grid[min(at + 1, len(grid) - 1)])
    return float(minimize_scalar(cost, bounds=bounds, method="bounded", options={"xatol": xatol}).x)  # type: ignore


def t_interval(level: float, value: ArrayLike, variances: Sequence[tuple[Floats, Floats]]) -> IntervalEstimate:
    """T interval of a sum of independent variances V, with Satterthwaite's (sum V)^2 / sum(V^2/nu)."""
    value = np.asarray(value, np.float64)
    total = np.sum([variance for variance, _ in variances], axis=0).reshape(value.shape)
    parts = np.sum([variance**2 / freedom for variance, freedom in variances], axis=0).reshape(value.shape)
    with np.errstate(divide="ignore", invalid="ignore"):
        freedom = np.where(parts > 0, total**2 / parts, np.inf)
    error = np.sqrt(total)
    half_width = t_quantile(level, freedom) * error
    return IntervalEstimate(level, value, error, freedom, value - half_width, value + half_width)


def parameter_interval(estimate: float, error: float, freedom: float, level: float) -> Interval:
    """T interval of one parameter."""
    if math.isnan(error):
        return Interval(math.nan, math.nan)
    half_width = float(t_quantile(level, freedom)) * error
    return Interval(estimate - half_width, estimate + half_width)


def variance_of(model: ErrorModel, gradients: Floats) -> tuple[Floats, Floats]:
    """Variance and degrees of freedom, shape (...), for gradients of shape (..., parameters)."""
    variance, freedom = model.variance(gradients.reshape(-1, gradients.shape[-1]))
    return variance.reshape(gradients.shape[:-1]), freedom.reshape(gradients.shape[:-1])


def force_gradients(law: ForceLaw, free: Sequence[str], contraction: ArrayLike, pressure: ArrayLike) -> NDArray:
    """Derivative of the force by the named parameters, (points, parameters); padded to a power of two."""
    contraction, pressure = np.broadcast_arrays(np.asarray(contraction, float), np.asarray(pressure, float))
    count = contraction.size
    if not count:
        return np.empty((0, len(free)))
    pad = (0, max(128, 1 << (count - 1).bit_length()) - count)
    padded = (np.pad(column.ravel(), pad, mode="edge") for column in (contraction, pressure))
    return design_matrix(law, free, *padded)[:count]
