"""Cost of a parameter vector, and its ranges."""

from __future__ import annotations

import difflib
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from mckibben.config.fields import quoted
from mckibben.errors import ParameterError, UnitError
from mckibben.simulation import Metrics
from mckibben.simulation.result import attributes
from mckibben.study.parameters import (
    LogUniform,
    ScenarioParameter,
    SweptParameter,
    find_parameter,
    list_parameters,
    parse_sweep,
)
from mckibben.study.scenario import Scenario
from mckibben.units import quantity

Numbers = NDArray[np.float64]

_DIGITS = 6  # of numbers that are written down
_AT_BOUND = 0.01  # of the range


def values_at(over: Sequence[SweptParameter], points: Numbers) -> Numbers:
    """The numbers [SI] at points, both of shape (n, numbers)."""
    return np.stack([each.distribution.at(points[:, i]) for i, each in enumerate(over)], axis=1)


def point_of(over: Sequence[SweptParameter], values: Numbers) -> Numbers:
    """The point of numbers [SI] of shape (numbers,), moved into the ranges."""
    return np.array([float(each.distribution.quantile(value)) for each, value in zip(over, values, strict=True)])


def nominal_of(over: Sequence[SweptParameter], nominal: Sequence[float | int | None]) -> Numbers:
    """Numbers [SI] as they stand in a file; where one does not, the middle of its range."""
    middle = values_at(over, np.full((1, len(over)), 0.5))[0]
    return np.array([m if n is None else float(n) for n, m in zip(nominal, middle, strict=True)])


def as_written(over: Sequence[SweptParameter], values: Numbers) -> Numbers:
    """Numbers [SI] with as many digits as are written down, in the unit in which they are, within the ranges."""
    written = [
        round(value) if each.parameter.whole else quantity(each.parameter.show(value, _DIGITS), each.parameter.unit)
        for each, value in zip(over, values, strict=True)
    ]
    return np.array(written).clip(*np.array([each.distribution.ends for each in over]).T)


def at_bound(over: Sequence[SweptParameter], point: Sequence[float] | Numbers) -> tuple[str, ...]:
    """The names of numbers within 1 % of an end of their range."""
    return tuple(each.name for each, at in zip(over, point, strict=True) if min(at, 1 - at) < _AT_BOUND)


_GAINS = ("kp", "ki", "kd", "bandwidth", "stiffness_bandwidth", "slope", "reach")


def is_gain(name: str) -> bool:
    """Whether a number of a scenario is a gain of its controller.

    >>> is_gain("controller.position.kp"), is_gain("controller.position.filter_time")
    (True, False)
    """
    *above, last = name.split(".")
    return above[:1] == ["controller"] and "adaptation" not in above and last in _GAINS


def gain_ranges(scenario: Scenario, decades: float = 2.0) -> dict[str, LogUniform]:
    """Ranges for all gains of a scenario that are not zero: from each, so many powers of ten down and up.

    >>> scenario = Scenario.read("examples/pre-contracted-step-pid.yaml")
    >>> gain_ranges(scenario, 1.0)["controller.position.kp"]
    LogUniform(low=20000.0, high=2000000.0, points=None)
    """
    return {a.name: _around(a, decades) for a in list_parameters(scenario) if is_gain(a.name) and a.nominal}


def parse_ranges(texts: Sequence[str], scenario: Scenario) -> tuple[SweptParameter, ...]:
    """Numbers and their ranges from text: ``NAME=LOW..HIGH``, with ``log`` behind it for an even logarithm.

    A name alone is searched from a hundredth to a hundredfold of what it is; without any text, all gains are.

    Raises
    ------
    ParameterError
        If a name is unknown or there twice, a range is none, or there is nothing to be around.

    Examples
    --------
    >>> scenario = Scenario.read("examples/pre-contracted-step-pid.yaml")
    >>> [each.text for each in parse_ranges(["controller.position.kp", "valve.time_constant=5..50 ms"], scenario)]
    ['controller.position.kp=0.02 bar/rad..200 bar/rad log', 'valve.time_constant=5 ms..50 ms']
    """
    if not texts:
        gains = gain_ranges(scenario)
        if not gains:
            raise ParameterError("all gains are zero", remedy="say what to search with --parameters 'NAME=LOW..HIGH'")
        return tuple(SweptParameter(find_parameter(scenario, name), spread) for name, spread in gains.items())
    several = []
    for text in texts:
        if "=" in text:
            several.append(parse_sweep(text, scenario))
            continue
        address = find_parameter(scenario, text)
        if not address.nominal or address.whole:
            what = "a whole number" if address.whole else "zero, or not given"
            raise ParameterError(
                f"{address.name} is {what}: there is no range around it",
                value=text,
                remedy=f"write {address.name}=LOW..HIGH",
            )
        several.append(SweptParameter(address, _around(address, 2.0)))
    said: dict[str, str] = {}
    for text, each in zip(texts, several, strict=True):
        if each.name in said:
            both = f"{quoted(said[each.name])} and {quoted(text)} are about the same number"
            raise ParameterError(both, value=text, remedy="keep one of them")
        said[each.name] = text
    return tuple(several)


def _around(address: ScenarioParameter, decades: float) -> LogUniform:
    nominal, factor = float(address.nominal or 0.0), 10.0**decades
    return LogUniform(*sorted((nominal / factor, nominal * factor)))


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
        """What `parse_cost` reads back to the last bit."""
        return " + ".join(_written(term) for term in self.terms)


def parse_cost(text: str, *, gain_margin: float = 1.0, worst: bool = False) -> Cost:
    """A cost from text such as ``angle_rmse/0.1 deg + 2*stiffness_rmse/0.5 N*m/rad``.

    A metric alone needs no scale; of several each needs one, else radians would be added to newton metres.

    Raises
    ------
    ParameterError
        If a term is none, or its unit is of another kind than its metric.

    Examples
    --------
    >>> parse_cost("angle_rmse/0.1 deg + 2*stiffness_rmse/0.5 N*m/rad").terms[1]
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
