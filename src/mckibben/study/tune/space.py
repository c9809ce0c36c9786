"""Search space of a tuning: parameters, their ranges, and the unit cube that a search runs in."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mckibben.errors import ParameterError, quoted
from mckibben.study.parameters import (
    LogUniform,
    ScenarioParameter,
    SweptParameter,
    Uniform,
    find_parameter,
    list_parameters,
    parse_sweep,
)
from mckibben.study.scenario import Scenario
from mckibben.units import quantity

Vector = NDArray[np.float64]

AT_BOUND = 0.01
"""Distance from a face of the unit cube within which a parameter counts as at its bound."""

_DIGITS = 6  # of values that are written to files


@dataclass(frozen=True)
class SearchSpace:
    """Parameters with a range each; points of the unit cube map to their values [SI].

    Raises
    ------
    ParameterError
        If there is no parameter, or one has no range.
    """

    swept: tuple[SweptParameter, ...]

    def __post_init__(self) -> None:
        if not self.swept:
            raise ParameterError("nothing to tune", remedy="give at least one parameter")
        for each in self.swept:
            if not isinstance(each.distribution, Uniform | LogUniform):
                raise ParameterError(f"{each.name} has no range to search", remedy="give one, like `1..10 bar/rad log`")

    def __len__(self) -> int:
        return len(self.swept)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters."""
        return tuple(each.name for each in self.swept)

    @property
    def nominal(self) -> Vector:
        """Nominal values [SI]; the middle of the range where there is none."""
        middle = self.values(np.full((1, len(self)), 0.5))[0]
        nominal = (each.parameter.nominal for each in self.swept)
        return np.array([m if n is None else float(n) for n, m in zip(nominal, middle, strict=True)])

    def values(self, points: Vector) -> Vector:
        """Values [SI] at points, both of shape (n, parameters)."""
        return np.stack([each.distribution.ppf(points[:, i]) for i, each in enumerate(self.swept)], axis=1)

    def point(self, values: Vector) -> Vector:
        """Point of values [SI] of shape (parameters,), clipped to the ranges."""
        pairs = zip(self.swept, values, strict=True)
        return np.array([float(each.distribution.quantile(value)) for each, value in pairs])

    def rounded(self, values: Vector) -> Vector:
        """Values [SI] rounded to six digits in the unit of files, within the ranges."""
        written = [
            round(value)
            if each.parameter.is_integer
            else quantity(each.parameter.show(value, _DIGITS), each.parameter.unit)
            for each, value in zip(self.swept, values, strict=True)
        ]
        return np.array(written).clip(*np.array([each.distribution.bounds for each in self.swept]).T)

    def at_bound(self, point: Sequence[float] | Vector) -> tuple[str, ...]:
        """Names of the parameters within `AT_BOUND` of an end of their range."""
        return tuple(each.name for each, at in zip(self.swept, point, strict=True) if min(at, 1 - at) < AT_BOUND)

    def slopes(self, values: Vector) -> Vector:
        """Derivatives of values [SI], shape (n, parameters), by points of the cube."""
        slopes = np.empty_like(values)
        for i, each in enumerate(self.swept):
            low, high = each.distribution.bounds
            is_log = isinstance(each.distribution, LogUniform)
            slopes[:, i] = values[:, i] * np.log(high / low) if is_log else high - low
        return slopes


_GAINS = ("kp", "ki", "kd", "bandwidth", "stiffness_bandwidth", "slope", "reach")


def is_gain(name: str) -> bool:
    """Whether a scenario parameter is a gain of its controller.

    >>> is_gain("controller.position.kp"), is_gain("controller.position.filter_time")
    (True, False)
    """
    *above, last = name.split(".")
    return above[:1] == ["controller"] and "adaptation" not in above and last in _GAINS


def gain_ranges(scenario: Scenario, decades: float = 2.0) -> dict[str, LogUniform]:
    """Logarithmic ranges around all nonzero gains of a scenario, by so many powers of ten down and up.

    >>> scenario = Scenario.read("examples/pre-contracted-step-pid.yaml")
    >>> gain_ranges(scenario, 1.0)["controller.position.kp"]
    LogUniform(low=20000.0, high=2000000.0, points=None)
    """
    gains = (each for each in list_parameters(scenario) if is_gain(each.name) and each.nominal)
    return {each.name: _range_around(each, decades) for each in gains}


def parse_ranges(texts: Sequence[str], scenario: Scenario) -> tuple[SweptParameter, ...]:
    """Parse parameters and their ranges from texts: ``NAME=LOW..HIGH``, followed by ``log`` for a logarithmic one.

    A name alone gets a range from a hundredth to a hundredfold of its value; no text at all gives all gains.

    Raises
    ------
    ParameterError
        If a name is unknown or repeated, a range is invalid, or there is no nonzero value for a range around it.

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
        return tuple(SweptParameter(find_parameter(scenario, name), around) for name, around in gains.items())
    found: dict[str, tuple[str, SweptParameter]] = {}
    for text in texts:
        if "=" in text:
            swept = parse_sweep(text, scenario)
        else:
            parameter = find_parameter(scenario, text)
            if not parameter.nominal or parameter.is_integer:
                what = "a whole number" if parameter.is_integer else "zero, or not given"
                raise ParameterError(
                    f"{parameter.name} is {what}: there is no range around it",
                    value=text,
                    remedy=f"write {parameter.name}=LOW..HIGH",
                )
            swept = SweptParameter(parameter, _range_around(parameter, 2.0))
        if swept.name in found:
            message = f"{quoted(found[swept.name][0])} and {quoted(text)} are about the same parameter"
            raise ParameterError(message, value=text, remedy="keep one of them")
        found[swept.name] = (text, swept)
    return tuple(swept for _, swept in found.values())


def _range_around(parameter: ScenarioParameter, decades: float) -> LogUniform:
    nominal, factor = float(parameter.nominal or 0.0), 10.0**decades
    return LogUniform(*sorted((nominal / factor, nominal * factor)))
