"""What a set of numbers costs: metrics of its runs, each by its scale, summed."""

from __future__ import annotations

import difflib
import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from mckibben.errors import ParameterError, UnitError
from mckibben.simulation import Metrics
from mckibben.simulation.result import attributes
from mckibben.units import quantity

SMOOTH = (
    "angle_rmse",
    "angle_max",
    "stiffness_rmse",
    "stiffness_max",
    "stiffness_ripple",
    "coupling",
    "estimate_rmse",
    "excursion_max",
    "force_max",
    "air",
)
"""Metrics that change smoothly with the numbers of a run, all but everywhere; the others count periods."""

_PLUS = re.compile(r"(?<![0-9.][eE])\+")  # not that of 1e+3
_TERM = re.compile(r"(?:(?P<weight>[0-9.eE+-]+)\s*\*\s*)?(?P<metric>[a-z_]+)\s*(?:/\s*(?P<scale>.+))?")


@dataclass(frozen=True)
class Term:
    """A metric, what of it costs 1 [SI], and a weight."""

    metric: str
    scale: float
    weight: float = 1.0

    def __post_init__(self) -> None:
        if self.metric not in Metrics._fields:
            close = difflib.get_close_matches(self.metric, Metrics._fields, 1, cutoff=0.5)
            remedy = f"did you mean {close[0]!r}?" if close else f"choose of {', '.join(Metrics._fields)}"
            raise ParameterError(f"{self.metric!r} is no metric", value=self.metric, remedy=remedy)
        for name, value in (("scale", self.scale), ("weight", self.weight)):
            if not (np.isfinite(value) and value > 0):
                raise ParameterError(
                    f"the {name} of {self.metric} is {value:g}", value=value, remedy="give one above 0"
                )


@dataclass(frozen=True)
class Cost:
    """The weighted sum of metrics over their scales, and how runs are put together.

    Errors alone would drive gains to the brink of instability. With a gain margin the cost is the larger of that of the
    numbers as they are, and of those with all controller gains among them multiplied by the margin.

    Parameters
    ----------
    terms
        What is summed.
    gain_margin
        The factor by which the gains (kp, ki, kd) may rise without harm; at 1 there is no margin.
    worst
        Whether, of several scenarios, the worst counts; else their mean.

    Examples
    --------
    >>> from mckibben.units import deg
    >>> cost = Cost.of({"angle_rmse": 0.1 * deg, "stiffness_rmse": 0.5})
    >>> round(float(cost({"angle_rmse": 0.2 * deg, "stiffness_rmse": 1.0})), 9)
    4.0
    """

    terms: tuple[Term, ...]
    gain_margin: float = 1.0
    worst: bool = False

    def __post_init__(self) -> None:
        names = [term.metric for term in self.terms]
        twice = [name for name in names if names.count(name) > 1]
        if not names or twice:
            raise ParameterError(
                f"{twice[0]} is there twice" if twice else "the cost has no term", remedy="name each metric once"
            )
        if not (np.isfinite(self.gain_margin) and self.gain_margin >= 1):
            raise ParameterError(
                f"the gain margin is {self.gain_margin:g}", value=self.gain_margin, remedy="give 1 (none) or more"
            )

    @classmethod
    def of(cls, scales: Mapping[str, float], *, gain_margin: float = 1.0, worst: bool = False) -> Self:
        """From the metrics and what of each costs 1 [SI]."""
        return cls(tuple(Term(name, scale) for name, scale in scales.items()), gain_margin, worst)

    @property
    def metrics(self) -> tuple[str, ...]:
        """What has to be measured."""
        return tuple(term.metric for term in self.terms)

    def __call__(self, values: Mapping[str, Any]) -> NDArray[np.float64]:
        """The cost of metrics [SI], elementwise."""
        return np.asarray(sum(term.weight * np.asarray(values[term.metric]) / term.scale for term in self.terms))

    @property
    def text(self) -> str:
        """What `read_cost` reads back to the last bit."""
        return " + ".join(_written(term) for term in self.terms)


def read_cost(text: str, *, gain_margin: float = 1.0, worst: bool = False) -> Cost:
    """A cost from text such as ``angle_rmse/0.1 deg + 2*stiffness_rmse/0.5 N*m/rad``.

    A metric alone needs no scale; of several each needs one, else radians would be added to newton metres.

    Raises
    ------
    ParameterError
        If a term is none, or its unit is of another kind than its metric.

    Examples
    --------
    >>> read_cost("angle_rmse/0.1 deg + 2*stiffness_rmse/0.5 N*m/rad").terms[1]
    Term(metric='stiffness_rmse', scale=0.5, weight=2.0)
    """
    parts = [part.strip() for part in _PLUS.split(text)]
    terms = []
    for part in parts:
        found = _TERM.fullmatch(part)
        if found is None:
            raise ParameterError(
                f"{part!r} is no term of a cost", value=part, remedy="write it like angle_rmse/0.1 deg"
            )
        metric, scale = found["metric"], found["scale"]
        Term(metric, 1.0)  # is it a metric at all?
        if scale is None and len(parts) > 1:
            unit = _unit(metric).replace("ratio", "%")
            unit = "deg" if unit == "rad" else unit
            raise ParameterError(
                f"{metric} has no scale, and cannot be added to other metrics",
                remedy=f"write it like {metric}/0.1 {unit}",
            )
        try:
            weight = float(found["weight"] or 1.0)
            size = 1.0 if scale is None else quantity(scale, _unit(metric))
        except UnitError as error:
            raise ParameterError(f"{part!r}: {error}", value=part) from None
        except ValueError:
            raise ParameterError(f"{found['weight']!r} is no number", value=part, remedy="write 2*metric") from None
        terms.append(Term(metric, size, weight))
    return Cost(tuple(terms), gain_margin, worst)


def _written(term: Term) -> str:
    weight = "" if term.weight == 1 else f"{term.weight!r}*"
    return f"{weight}{term.metric}/{term.scale!r} {_unit(term.metric)}".replace("+", "")


def _unit(metric: str) -> str:
    """In SI, as a quantity has it: a bare number would be no scale that one can read."""
    unit = attributes(metric)["units"]
    return "ratio" if unit == "1" else unit
