"""Metrics of a run that follow from sums and maxima over its control periods."""

from __future__ import annotations

import abc
import functools
import operator
from collections.abc import Iterable
from dataclasses import KW_ONLY, dataclass
from typing import Any, NamedTuple, TypeVar, cast

import jax
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike

from mckibben.component.columns import Label, labels_of

M = TypeVar("M")


class Totals(NamedTuple):
    """Sums and maxima by name; of one control period, of some, or of all."""

    sums: dict[str, Any]
    maxima: dict[str, Any]

    @classmethod
    def of(cls, metrics: Iterable[Metric], sample: Any) -> Totals:
        """Totals of single control periods, elementwise: of scalars, or of arrays of shape (periods,)."""
        found = cls({}, {})
        for metric in metrics:
            terms = metric.terms(sample)
            found.sums.update(terms.sums)
            found.maxima.update(terms.maxima)
        return found

    def empty(self) -> Totals:
        """Totals of no control period."""
        return jax.tree.map(jnp.zeros_like, self)

    def merge(self, other: Totals) -> Totals:
        """Totals of the periods of both."""
        return Totals(
            jax.tree.map(operator.add, self.sums, other.sums), jax.tree.map(larger, self.maxima, other.maxima)
        )


class Run(NamedTuple):
    """A whole run: number of control periods, their length [s], and what has been tracked from each to the next."""

    periods: int
    period: ArrayLike
    tracked: Any = None


@dataclass(frozen=True)
class Metric(Label, abc.ABC):
    """Number to which a run is reduced, the annotation of a field of a class of metrics."""

    _: KW_ONLY
    of: str  # name of the quantity of a sample that it is made of

    def terms(self, sample: Any) -> Totals:
        """Return the terms of single control periods, by names that metrics may share."""
        return Totals({}, {})

    @abc.abstractmethod
    def value(self, totals: Totals, run: Any) -> Any:
        """Return the metric of a whole run."""


class RootMeanSquare(Metric):
    """Root mean square of an error; its derivative at 0 is 0."""

    def terms(self, sample: Any) -> Totals:
        return Totals({f"{self.of}^2": jnp.square(getattr(sample, self.of))}, {})

    def value(self, totals: Totals, run: Any) -> Any:
        return root(totals.sums[f"{self.of}^2"] / run.periods)


class StandardDeviation(Metric):
    """Root mean square of an error about its mean over the run."""

    def terms(self, sample: Any) -> Totals:
        error = getattr(sample, self.of)
        return Totals({f"{self.of}^2": jnp.square(error), self.of: error}, {})

    def value(self, totals: Totals, run: Any) -> Any:
        variance = totals.sums[f"{self.of}^2"] / run.periods - jnp.square(totals.sums[self.of] / run.periods)
        return root(jnp.where(variance < 0, 0.0, variance))  # rounding may take it below


class Largest(Metric):
    """Largest value of a quantity, 0 if all are below."""

    def terms(self, sample: Any) -> Totals:
        return Totals({}, {self.of: getattr(sample, self.of)})

    def value(self, totals: Totals, run: Any) -> Any:
        return totals.maxima[self.of]


class LargestError(Metric):
    """Largest absolute value of a quantity."""

    def terms(self, sample: Any) -> Totals:
        return Totals({}, {f"|{self.of}|": jax.tree.map(jnp.abs, getattr(sample, self.of))})

    def value(self, totals: Totals, run: Any) -> Any:
        return totals.maxima[f"|{self.of}|"]


class Total(Metric):
    """Sum of a quantity over the control periods."""

    def terms(self, sample: Any) -> Totals:
        return Totals({self.of: getattr(sample, self.of)}, {})

    def value(self, totals: Totals, run: Any) -> Any:
        return totals.sums[self.of]


class Duration(Total):
    """Time [s] with a flag, which is 0 or 1."""

    def value(self, totals: Totals, run: Any) -> Any:
        return totals.sums[self.of] * run.period


class Tracked(Metric):
    """Quantity of the state that is tracked from each control period to the next, at the end of a run."""

    def value(self, totals: Totals, run: Any) -> Any:
        return getattr(run.tracked, self.of)


@functools.cache
def metrics_of(kind: type) -> dict[str, Metric]:
    """Return the metrics of a class by name."""
    return cast(dict[str, Metric], labels_of(kind))


def values_of(kind: type[M], totals: Totals, run: Any) -> M:
    """Return the metrics of a class, of a whole run."""
    return kind(**{name: metric.value(totals, run) for name, metric in metrics_of(kind).items()})


def root(mean: Array) -> Array:
    """The square root; its derivative at 0 is 0."""
    return jnp.where(mean > 0, jnp.sqrt(jnp.where(mean > 0, mean, 1.0)), mean)


def larger(one: ArrayLike, other: ArrayLike) -> Array:
    """The larger of two, NaN if one of them is: XLA's own maximum does not always propagate it."""
    one, other = jnp.asarray(one), jnp.asarray(other)
    return jnp.where((one >= other) | jnp.isnan(one), one, other)
