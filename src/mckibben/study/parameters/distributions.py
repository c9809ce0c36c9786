"""Distributions of parameters."""

from __future__ import annotations

import abc
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mckibben.errors import ParameterError

MAX_ROWS = 10_000_000
"""Largest number of values on one axis, and of rows of a table."""


class Distribution(abc.ABC):
    """Distribution of a parameter [SI].

    >>> Uniform(0.2, 1.0).ppf([0.0, 0.5])
    array([0.2, 0.6])
    """

    @property
    @abc.abstractmethod
    def bounds(self) -> tuple[float, float]:
        """Lowest and highest value."""

    @abc.abstractmethod
    def ppf(self, quantile: ArrayLike) -> NDArray:
        """Value at each quantile, 0 to 1 (percent point function): float64, or int64 for integers."""

    @abc.abstractmethod
    def grid(self) -> NDArray:
        """Values on a grid; raises ParameterError where the distribution does not determine them."""


@dataclass(frozen=True)
class Range(Distribution):
    """Range of values [SI], with so many `points` on a grid, bounds included."""

    low: float
    high: float
    points: int | None = None

    def __post_init__(self) -> None:
        if not (math.isfinite(self.low) and math.isfinite(self.high)):
            raise ParameterError(f"{self.low:g} to {self.high:g} is no range", remedy="give two finite numbers")
        if not self.low < self.high:
            raise ParameterError(
                "the range is empty", value=self.high, lower=self.low, remedy="write the lower end first"
            )
        if self.points is not None and not 2 <= self.points <= MAX_ROWS:
            raise ParameterError(f"a grid cannot have {self.points} points", remedy=f"choose 2 to {MAX_ROWS} points")

    @property
    def bounds(self) -> tuple[float, float]:
        return self.low, self.high

    def grid(self) -> NDArray[np.float64]:
        if self.points is None:
            raise ParameterError("the range has no number of grid points", remedy="write it like `... in 9`")
        return self.ppf(np.linspace(0.0, 1.0, self.points))

    @abc.abstractmethod
    def quantile(self, value: ArrayLike) -> NDArray[np.float64]:
        """Quantile of each value, 0 to 1, the inverse of `ppf`."""


@dataclass(frozen=True)
class Uniform(Range):
    """Uniform distribution between bounds [SI], with so many `points` on a grid, bounds included.

    Raises `ParameterError` if the bounds are not finite or not in order, or there are fewer than 2 points.

    >>> Uniform(0.0, 1.0, points=3).grid()
    array([0. , 0.5, 1. ])
    """

    def ppf(self, quantile: ArrayLike) -> NDArray[np.float64]:
        u = np.clip(np.asarray(quantile, float), 0.0, 1.0)
        return np.clip(self.low + u * (self.high - self.low), self.low, self.high)

    def quantile(self, value: ArrayLike) -> NDArray[np.float64]:
        return np.clip((np.asarray(value, float) - self.low) / (self.high - self.low), 0.0, 1.0)


@dataclass(frozen=True)
class LogUniform(Range):
    """Log-uniform distribution between bounds [SI] of one sign, with so many `points` on a grid, bounds included.

    >>> LogUniform(1.0, 100.0, points=3).grid()
    array([  1.,  10., 100.])
    """

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.low <= 0 <= self.high:
            remedy = "give two ends of one sign, neither of them zero, or leave `log` out"
            raise ParameterError("a range that contains zero has no logarithm", value=self.low, remedy=remedy)

    def ppf(self, quantile: ArrayLike) -> NDArray[np.float64]:
        u = np.clip(np.asarray(quantile, float), 0.0, 1.0)
        size = np.exp((1 - u) * math.log(abs(self.low)) + u * math.log(abs(self.high)))
        inside = np.clip(math.copysign(1, self.low) * size, self.low, self.high)
        return np.where(u == 0, self.low, np.where(u == 1, self.high, inside))

    def quantile(self, value: ArrayLike) -> NDArray[np.float64]:
        inside = np.clip(np.asarray(value, float), self.low, self.high)
        low, high = math.log(abs(self.low)), math.log(abs(self.high))
        return np.clip((np.log(np.abs(inside)) - low) / (high - low), 0.0, 1.0)


@dataclass(frozen=True)
class Normal(Distribution):
    """Normal distribution [SI] truncated at bounds, by default those of the parameter.

    Raises `ParameterError` if the deviation is not above 0, or the mean is outside the bounds.

    >>> Normal(0.5, 0.05).ppf([0.1, 0.5, 0.9]).round(4)
    array([0.4359, 0.5   , 0.5641])
    """

    mean: float
    deviation: float
    lower: float = -math.inf
    upper: float = math.inf

    def __post_init__(self) -> None:
        if not (math.isfinite(self.mean) and math.isfinite(self.deviation) and self.deviation > 0):
            raise ParameterError(
                f"mean {self.mean:g} and standard deviation {self.deviation:g} do not make a normal distribution",
                remedy="give finite numbers, the deviation above zero",
            )
        if not (self.lower <= self.mean <= self.upper and self.lower < self.upper):
            raise ParameterError(
                f"the mean {self.mean:g} is outside {self.lower:g} to {self.upper:g}", remedy="choose a mean inside"
            )

    @property
    def bounds(self) -> tuple[float, float]:
        return self.lower, self.upper

    def ppf(self, quantile: ArrayLike) -> NDArray[np.float64]:
        from scipy.special import ndtr, ndtri

        low, high = (float(ndtr((end - self.mean) / self.deviation)) for end in self.bounds)
        inside = 2.0**-54  # quantiles of 0 and 1 stand for this far inside: a normal distribution has no ends
        u = low + np.clip(np.asarray(quantile, float), 0.0, 1.0) * (high - low)
        value = self.mean + self.deviation * ndtri(np.clip(u, inside, 1 - 2 * inside))
        return np.clip(value, self.lower, self.upper)

    def grid(self) -> NDArray[np.float64]:
        raise ParameterError("a normal distribution has no grid", remedy="list values, or give a range `in 9`")


@dataclass(frozen=True)
class Values(Distribution):
    """Discrete values of equal probability; a grid has all of them in the order given.

    Raises `ParameterError` if there is none, one is not finite, or one is listed twice.

    >>> Values((1.0, 2.0, 4.0)).ppf([0.0, 0.5, 0.9])
    array([1., 2., 4.])
    """

    values: tuple[float, ...] | tuple[int, ...]

    def __post_init__(self) -> None:
        if not self.values or not all(math.isfinite(value) for value in self.values):
            raise ParameterError(f"{self.values} are no values", remedy="give finite numbers, at least one")
        if len(set(self.values)) < len(self.values):
            twice = next(value for i, value in enumerate(self.values) if value in self.values[:i])
            raise ParameterError(f"{twice:g} is listed twice", remedy="keep one of them")

    @property
    def bounds(self) -> tuple[float, float]:
        return min(self.values), max(self.values)

    def ppf(self, quantile: ArrayLike) -> NDArray:
        u, count = np.clip(np.asarray(quantile, float), 0.0, 1.0), len(self.values)
        return self.grid()[np.minimum((u * count).astype(np.int64), count - 1)]

    def grid(self) -> NDArray:
        return np.asarray(self.values, np.int64 if all(isinstance(value, int) for value in self.values) else float)
