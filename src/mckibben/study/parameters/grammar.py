"""What is varied as people write it: ``load.mass2=0.2 kg..1.0 kg``."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Iterable
from typing import Any, NoReturn

from pydantic_core import PydanticCustomError

from mckibben.errors import ParameterError
from mckibben.study.parameters.address import Address, find
from mckibben.study.parameters.over import Over
from mckibben.study.parameters.spread import LogUniform, Normal, Spread, Uniform, Values, Wholes
from mckibben.study.scenario import Scenario
from mckibben.study.scenario.part import quoted
from mckibben.study.scenario.quantity import Quantity

LONGEST = 10_000
"""Characters of what is said about one number."""

_NUMBER = r"[+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?"
_PLAIN = re.compile(_NUMBER)
_UNIT = re.compile(rf"\s*{_NUMBER}\s*(.*)", re.DOTALL)
_POINTS = re.compile(r"(.*\S)\s+in\s+(\S+)", re.DOTALL)
_LOG = re.compile(r"(.*\S)\s+log", re.DOTALL)
_RELATIVE = re.compile(rf"({_NUMBER})\s*(?:%|percent)")
_ONE = re.compile(rf"{_NUMBER}\s*(?:[A-Za-z(/1][^%\s]*(?:\s+[^0-9+.\s-]\S*)*)?")
_FORMS = "a range (0.2 kg..1.0 kg), values (1 kg, 2 kg), `+-10 %` or `normal 10 %`"


def read_over(text: str, scenario: Scenario) -> Over:
    """Read what one number is varied over.

    Parameters
    ----------
    text
        A name, "=", and one of

        ============================  ============================================================================
        ``0.2 kg..1.0 kg``            a range, even; the unit of its end will do for both: ``0.2..1.0 kg``
        ``1..100 bar/rad log``        a range, even in the logarithm
        ``0.2..1.0 kg in 9``          a range of which a grid has 9 points
        ``1 kg, 2 kg, 4 kg``          these values
        ``0..19``                     all of these numbers, where only whole ones make sense
        ``+-10 %``, ``+-0.1 kg``      evenly around the nominal value; a percentage is always one of it
        ``normal 10 %``               a normal distribution around the nominal value with this standard deviation
                                      (or ``normal 0.05 kg``), cut off at the ends of what the number may be
        ============================  ============================================================================
    scenario
        Whose numbers are meant; nominal values are its own.

    Raises
    ------
    ParameterError
        With the text, what is wrong with it, and what to do.

    Examples
    --------
    >>> scenario = Scenario.read("examples/pre-contracted-step-pid.yaml")
    >>> read_over("load.mass2=+-10 %", scenario).spread
    Uniform(low=0.45, high=0.55, points=None)
    >>> read_over("load.mass2=1 kg..0.2 kg", scenario)
    Traceback (most recent call last):
        ...
    mckibben.errors.ParameterError: 'load.mass2=1 kg..0.2 kg': the range is empty: 1 kg is not below
    0.2 kg; write the lower end first
    """
    name, equals, said = text.partition("=")
    try:
        if len(text) > LONGEST:
            _fail(f"is longer than {LONGEST} characters", "say less")
        if not equals:
            _fail("is no name and what it is varied over", "write it like 'load.mass2=0.2 kg..1.0 kg'")
        address = find(scenario, name)
        return Over(address, _spread(said.strip().replace("±", "+-"), address))
    except ParameterError as error:
        raise _about(text, error) from None


def read_overs(texts: Iterable[str], scenario: Scenario) -> tuple[Over, ...]:
    """Read what several numbers are varied over.

    Raises
    ------
    ParameterError
        As for `read_over`, and if two texts are about the same number, however it is spelt.
    """
    found: dict[str, str] = {}
    several = []
    for text in texts:
        one = read_over(text, scenario)
        if one.name in found:
            _fail(f"{quoted(found[one.name])} and {quoted(text)} are about the same number", "keep one of them")
        found[one.name] = text
        several.append(one)
    return tuple(several)


def _spread(said: str, address: Address) -> Spread:
    if not said:
        _fail("says nothing after '='", f"give {_FORMS}")
    if said.startswith("+-"):
        amount, nominal = _amount(said[2:], address), address.nominal
        assert nominal is not None  # an amount has looked at it
        return Uniform(nominal - amount, nominal + amount)
    if re.match(r"normal\b", said):
        amount, nominal = _amount(said[len("normal") :], address), address.nominal
        assert nominal is not None
        return Normal(nominal, amount)
    return _range(said, address) if ".." in said else _values(said, address)


def _range(said: str, address: Address) -> Spread:
    said, points = _without(_POINTS, said)
    said, log = _without(_LOG, said)
    low_text, _, high_text = said.partition("..")
    high = _number(high_text, address)
    low = _number(_with_unit_of(low_text, high_text), address)
    if not low < high:
        _fail(f"the range is empty: {address.show(low)} is not below {address.show(high)}", "write the lower end first")
    if address.whole:
        if log is not None or points is not None:
            _fail("a range of whole numbers is all of them", "leave `log` and `in ...` out, or list values")
        return Wholes(int(low), int(high))
    if points is not None and not re.fullmatch(r"[0-9]{1,9}", points):
        _fail(f"{quoted(points)} is no number of points", "write it like `in 9`")
    count = None if points is None else int(points)
    if log is None:
        return Uniform(low, high, count)
    if low <= 0 <= high:
        _fail(
            f"a range from {address.show(low)} to {address.show(high)} has no even logarithm",
            "give two ends of one sign, neither of them zero, or leave `log` out",
        )
    return LogUniform(low, high, count)


def _values(said: str, address: Address) -> Values:
    if not address.whole and re.search(r"[0-9],[0-9]", said):
        _fail(f"{quoted(said)} has a comma between digits", "write decimals with a point, and lists like `1 kg, 2 kg`")
    return Values(tuple(_number(each, address) for each in said.split(",")))


def _amount(said: str, address: Address) -> float:
    """How far from the nominal value, in SI."""
    said = said.strip()
    if address.whole or not isinstance(address.mark, Quantity):
        _fail(f"{address.name} is a whole number", "give whole numbers, like `0..19` or `0, 1, 5`")
    if address.nominal is None:
        _fail(f"{address.name} has no nominal value in the scenario", "give a range, like `12..18 N*m/rad`")
    relative = _RELATIVE.fullmatch(said)
    if not relative:
        amount = _read(
            dataclasses.replace(address.mark, lower=0.0, upper=1e12, open_lower=True, open_upper=False), said
        )
    elif address.nominal == 0:
        _fail(
            f"{said} of a nominal value of {address.show(0.0)} is nothing",
            f"give an amount in {address.shown}" if address.unit != "1" else "give an amount",
        )
    else:
        amount = float(relative[1]) / 100 * abs(address.nominal)
    if not amount > 0 or amount > 1e300:
        _fail(f"{quoted(said)} is no amount", "give one above zero")
    return amount


def _number(said: str, address: Address) -> Any:
    """A number of the field, in SI, with all that the field itself says of it."""
    return _read(address.mark, said.strip())


def _read(mark: Any, said: str) -> Any:
    if not said:
        _fail("a value is missing", f"give {_FORMS}")
    try:
        return mark.read(said)
    except PydanticCustomError as error:
        context = error.context or {}
        message, remedy = str(context.get("message", error)), str(context.get("remedy", ""))
        if not _ONE.fullmatch(said):  # more, or less, than a number and a unit: a range that is written otherwise?
            remedy = f"give {_FORMS}"
        _fail(message, remedy or "give a finite one")


def _with_unit_of(low: str, high: str) -> str:
    """The lower end, with the unit of the upper one if it has none."""
    unit = _UNIT.fullmatch(high)
    return f"{low.strip()} {unit[1]}" if unit and _PLAIN.fullmatch(low.strip()) else low


def _without(ending: re.Pattern[str], said: str) -> tuple[str, str | None]:
    """A text without an ending, and what the ending says."""
    found = ending.fullmatch(said)
    return (found[1], found[found.lastindex or 1]) if found else (said, None)


def _fail(message: str, remedy: str) -> NoReturn:
    raise ParameterError(message, remedy=remedy)


def _about(text: str, error: ParameterError) -> ParameterError:
    """The same error, with the text that it is about."""
    message = str(error).removesuffix(f"; {error.remedy}") if error.remedy else str(error)
    about = {"value": error.value, "lower": error.lower, "upper": error.upper, "unit": error.unit}
    return ParameterError(f"{quoted(text)}: {message}", remedy=error.remedy, **about)  # type: ignore[arg-type]
