"""In what ranges numbers are searched: as said, or around what they are."""

from __future__ import annotations

from collections.abc import Sequence

from mckibben.errors import ParameterError
from mckibben.study.parameters import Address, LogUniform, Over, addresses, find, read_over
from mckibben.study.scenario import Scenario
from mckibben.study.scenario.part import quoted

_GAINS = ("kp", "ki", "kd", "bandwidth", "stiffness_bandwidth", "slope", "reach")


def is_gain(name: str) -> bool:
    """Whether a number of a scenario is a gain of its controller.

    >>> is_gain("controller.position.kp"), is_gain("controller.position.filter_time")
    (True, False)
    """
    *above, last = name.split(".")
    return above[:1] == ["controller"] and "adaptation" not in above and last in _GAINS


def around_gains(scenario: Scenario, decades: float = 2.0) -> dict[str, LogUniform]:
    """Ranges for all gains of a scenario that are not zero: from each, so many powers of ten down and up.

    >>> scenario = Scenario.read("examples/pre-contracted-step-pid.yaml")
    >>> around_gains(scenario, 1.0)["controller.position.kp"]
    LogUniform(low=20000.0, high=2000000.0, points=None)
    """
    return {a.name: _around(a, decades) for a in addresses(scenario) if is_gain(a.name) and a.nominal}


def read_ranges(texts: Sequence[str], scenario: Scenario) -> tuple[Over, ...]:
    """Numbers and their ranges from text: ``NAME=LOW..HIGH``, with ``log`` behind it for an even logarithm.

    A name alone is searched from a hundredth to a hundredfold of what it is; without any text, all gains are.

    Raises
    ------
    ParameterError
        If a name is unknown or there twice, a range is none, or there is nothing to be around.

    Examples
    --------
    >>> scenario = Scenario.read("examples/pre-contracted-step-pid.yaml")
    >>> [each.text for each in read_ranges(["controller.position.kp", "valve.time_constant=5..50 ms"], scenario)]
    ['controller.position.kp=0.02 bar/rad..200 bar/rad log', 'valve.time_constant=5 ms..50 ms']
    """
    if not texts:
        gains = around_gains(scenario)
        if not gains:
            raise ParameterError("all gains are zero", remedy="say what to search with --parameters 'NAME=LOW..HIGH'")
        return tuple(Over(find(scenario, name), spread) for name, spread in gains.items())
    several = []
    for text in texts:
        if "=" in text:
            several.append(read_over(text, scenario))
            continue
        address = find(scenario, text)
        if not address.nominal or address.whole:
            what = "a whole number" if address.whole else "zero, or not given"
            raise ParameterError(
                f"{address.name} is {what}: there is no range around it",
                value=text,
                remedy=f"write {address.name}=LOW..HIGH",
            )
        several.append(Over(address, _around(address, 2.0)))
    said: dict[str, str] = {}
    for text, each in zip(texts, several, strict=True):
        if each.name in said:
            both = f"{quoted(said[each.name])} and {quoted(text)} are about the same number"
            raise ParameterError(both, value=text, remedy="keep one of them")
        said[each.name] = text
    return tuple(several)


def _around(address: Address, decades: float) -> LogUniform:
    nominal, factor = float(address.nominal or 0.0), 10.0**decades
    return LogUniform(*sorted((nominal / factor, nominal * factor)))
