"""Search spaces: parameters with ranges, mapped to the unit cube."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mckibben.errors import ParameterError
from mckibben.scenario import ScenarioParameter, StudiedScenario, find_parameter, list_parameters
from mckibben.study.parameters import LogUniform, Range, SweptParameter, parse_sweep, sweep_parameters
from mckibben.study.parameters.sampling import distinct
from mckibben.study.tune.search import Vector
from mckibben.units import quantity


@dataclass(frozen=True)
class SearchSpace:
    """Parameters with ranges; points of the unit cube map to their values [SI].

    Raises `ParameterError` if there is no parameter, or one has no range.

    Examples
    --------
    >>> from mckibben.scenario import Scenario
    >>> scenario = Scenario.read("examples/pre-contracted-step-pid.yaml")
    >>> space = SearchSpace(parse_ranges(["valve.time_constant=5..50 ms"], scenario))
    >>> space.values(np.array([[0.0], [1.0]])).tolist()
    [[0.005], [0.05]]
    >>> space.point(np.array([0.0275])).round(12).tolist()
    [0.5]
    """

    swept: tuple[SweptParameter, ...]

    def __post_init__(self) -> None:
        if not self.swept:
            raise ParameterError("nothing to tune", remedy="give at least one parameter")
        for swept in self.swept:
            if not isinstance(swept.distribution, Range):
                raise ParameterError(
                    f"{swept.name} has no range to search", remedy="give one, such as `1..10 bar/rad log`"
                )

    def __len__(self) -> int:
        return len(self.swept)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters."""
        return tuple(swept.name for swept in self.swept)

    @property
    def nominal(self) -> Vector:
        """Nominal values [SI], shape (parameters,); the middle of the range if there is none."""
        middle = self.values(np.full((1, len(self)), 0.5))[0]
        nominal = (swept.parameter.nominal for swept in self.swept)
        return np.array([m if n is None else float(n) for n, m in zip(nominal, middle, strict=True)])

    def values(self, points: Vector) -> Vector:
        """Values [SI] at points, both of shape (n, parameters)."""
        return np.stack([swept.distribution.ppf(points[:, i]) for i, swept in enumerate(self.swept)], axis=1)

    def point(self, values: Vector) -> Vector:
        """Point of values [SI], both of shape (parameters,), clipped to the ranges; the inverse of `values`."""
        ranges = (swept.distribution for swept in self.swept if isinstance(swept.distribution, Range))
        return np.array([float(swept_range.quantile(value)) for swept_range, value in zip(ranges, values, strict=True)])

    def rounded(self, values: Vector, digits: int = 6) -> Vector:
        """Values [SI] rounded to significant digits in the unit of files, within the ranges."""
        written = [
            round(value)
            if swept.parameter.is_integer
            else quantity(swept.parameter.show(value, digits), swept.parameter.unit)
            for swept, value in zip(self.swept, values, strict=True)
        ]
        return np.array(written).clip(*np.array([swept.distribution.bounds for swept in self.swept]).T)

    def at_bound(self, point: Sequence[float] | Vector, within: float = 0.01) -> tuple[str, ...]:
        """Names of the parameters within a share of their range from one of its ends."""
        return tuple(swept.name for swept, at in zip(self.swept, point, strict=True) if min(at, 1 - at) < within)


_GAINS = ("kp", "ki", "kd", "bandwidth", "stiffness_bandwidth", "slope", "reach")


def is_gain(parameter: ScenarioParameter) -> bool:
    """Whether a parameter is a gain of the controller: by its name, or a pressure per other quantity than time.

    >>> from mckibben.scenario import Scenario
    >>> parameters = list_parameters(Scenario.read("examples/pre-contracted-step-pid.yaml"))
    >>> [parameter.name for parameter in parameters if is_gain(parameter)][:2]
    ['controller.position.kp', 'controller.position.ki']
    """
    per_state = parameter.unit.startswith("Pa") and parameter.unit not in ("Pa", "Pa/s")
    return parameter.part in ("controller", "controllers") and (parameter.name.split(".")[-1] in _GAINS or per_state)


def gain_ranges(scenario: StudiedScenario, decades: float = 1.0) -> dict[str, LogUniform]:
    """Logarithmic ranges around all nonzero gains of a scenario, a number of decades down and up.

    A bandwidth [rad/s] is at most the Nyquist frequency, or the given one.

    >>> from mckibben.scenario import Scenario
    >>> scenario = Scenario.read("examples/pre-contracted-step-pid.yaml")
    >>> gain_ranges(scenario)["controller.position.kp"]
    LogUniform(low=20000.0, high=2000000.0, points=None)
    """
    gains = (swept for swept in list_parameters(scenario) if is_gain(swept) and swept.nominal)
    return {swept.name: _range_around(swept, decades, scenario) for swept in gains}


def parse_ranges(texts: Sequence[str], scenario: StudiedScenario) -> tuple[SweptParameter, ...]:
    """Parse parameters and their ranges from texts: ``NAME=LOW..HIGH``, followed by ``log`` for a logarithmic one.

    A name alone gets a range from a tenth to ten times its value; without texts, all gains are used.

    Raises `ParameterError` if a name is unknown or repeated, a range is invalid, or there is no nonzero value for a
    range around it.

    Examples
    --------
    >>> from mckibben.scenario import Scenario
    >>> scenario = Scenario.read("examples/pre-contracted-step-pid.yaml")
    >>> [swept.text for swept in parse_ranges(["controller.position.kp", "valve.time_constant=5..50 ms"], scenario)]
    ['controller.position.kp=0.2 bar/rad..20 bar/rad log', 'valve.time_constant=5 ms..50 ms']
    """
    if not texts:
        if not (gains := gain_ranges(scenario)):
            remedy = "give parameters with --parameters 'NAME=LOW..HIGH'"
            raise ParameterError("the controller has no gain that is not zero", remedy=remedy)
        return sweep_parameters(scenario, gains)

    def parse(text: str) -> SweptParameter:
        if "=" in text:
            return parse_sweep(text, scenario)
        parameter = find_parameter(scenario, text)
        if not parameter.nominal or parameter.is_integer:
            what = "a whole number" if parameter.is_integer else "zero, or not given"
            remedy = f"write {parameter.name}=LOW..HIGH"
            raise ParameterError(f"{parameter.name} is {what}: there is no range around it", value=text, remedy=remedy)
        return SweptParameter(parameter, _range_around(parameter, 1.0, scenario))

    return distinct(map(parse, texts))


def _range_around(parameter: ScenarioParameter, decades: float, scenario: StudiedScenario) -> LogUniform:
    nominal, factor = float(parameter.nominal or 0.0), 10.0**decades
    low, high = sorted((nominal / factor, nominal * factor))
    if parameter.unit == "rad/s":
        high = min(high, max(math.pi / scenario.control_period, nominal))
    return LogUniform(low, high)
