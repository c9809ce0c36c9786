"""Units, at the edge of the code only: inside there are SI floats.

In Python, multiply by a unit to get SI and divide by it to leave SI:

>>> pressure = 6 * bar
>>> pressure, pressure / kPa
(600000.0, 600.0)

In text (scenario files, the command line, catalog files) a quantity is one number and one unit:

>>> quantity("6 bar", "Pa")
600000.0
>>> quantity("13 N*m/rad", "N*m/rad")
13.0
"""

from __future__ import annotations

import functools
import math
import re
from typing import Any

from mckibben.errors import UnitError

Pa = 1.0
kPa = 1e3  # noqa: N816
MPa = 1e6
bar = 1e5
m = 1.0
cm = 1e-2
mm = 1e-3
N = 1.0
kg = 1.0
g = 1e-3
s = 1.0
ms = 1e-3
Hz = 1.0
rad = 1.0
deg = math.pi / 180
percent = 1e-2

# The whole vocabulary: a text with any other unit is refused. An angle is a dimension of its own here, so that
# N*m/rad (a stiffness) and N*m (a torque) do not pass for each other.
_DEFINITIONS = (
    "meter = [length] = m",
    "centimeter = 0.01 * meter = cm",
    "millimeter = 0.001 * meter = mm",
    "kilogram = [mass] = kg",
    "gram = 0.001 * kilogram = g",
    "second = [time] = s",
    "millisecond = 0.001 * second = ms",
    "minute = 60 * second = min",
    "hertz = 1 / second = Hz",
    "newton = kilogram * meter / second ** 2 = N",
    "kilonewton = 1000 * newton = kN",
    "pascal = newton / meter ** 2 = Pa",
    "kilopascal = 1000 * pascal = kPa",
    "megapascal = 1e6 * pascal = MPa",
    "bar = 1e5 * pascal",
    "millibar = 100 * pascal = mbar",
    "psi = 6894.757293168361 * pascal",
    "radian = [angle] = rad",
    f"degree = {deg!r} * radian = deg",
    "percent = 0.01",
    "ratio = 1.0",
)
UNITS = ("m cm mm kg g s ms min Hz N kN Pa kPa MPa bar mbar psi rad deg percent ratio").split()

_NAME = r"(?:[A-Za-z]+(?:\^-?[1-9])?)"
_PRODUCT = rf"{_NAME}(?:[*/]{_NAME})*"
_FACTOR = rf"(?:{_NAME}|\({_PRODUCT}\))"
_UNIT = re.compile(rf"{_FACTOR}(?:[*/]{_FACTOR})*")
_NUMBER = re.compile(r"[+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?")
_LONGEST = 80  # characters in a unit
_REST = re.compile(r"(?:(?:1?/|[A-Za-z%°(]).*)?", re.DOTALL)


@functools.cache
def _registry() -> Any:
    import pint  # 0.2 s: only where text is read

    registry: Any = pint.UnitRegistry(None)  # type: ignore[arg-type]  # none of pint's own units
    for definition in _DEFINITIONS:
        registry.define(definition)
    return registry


@functools.cache
def _parse(unit: str) -> Any:
    """A pint unit from text of our grammar."""
    if len(unit) > _LONGEST:
        raise UnitError(f"{unit[:20]!r}... is not a unit", value=unit, remedy="a unit is a few names joined by * and /")
    text = unit.strip().replace("%", "percent").replace("°", "deg").replace("·", "*").replace("**", "^")
    text = re.sub(r"\s*([*/()^])\s*", r"\1", text)
    if text == "1" or text.startswith("1/"):
        text = f"ratio{text[1:]}"
    if not _UNIT.fullmatch(text):
        raise UnitError(
            f"{unit!r} is not a unit",
            value=unit,
            remedy="write units joined by * and /, such as bar, N*m/rad or kg*m^2",
        )
    for name in re.findall(r"[A-Za-z]+", text):
        if name not in UNITS:
            raise UnitError(
                f"unknown unit {name!r} in {unit!r}", value=unit, remedy=f"known are {', '.join(UNITS)} and %"
            )
    return _registry().parse_units(text.replace("^", "**"))


def factor(unit: str, to: str = "") -> float:
    """What to multiply a number in `unit` by to have it in `to` (by default in SI).

    >>> factor("N/bar")
    1e-05
    >>> factor("1/percent", "1/ratio")
    100.0
    """
    source = _parse(unit)
    if not to:
        return float(_registry().Quantity(1.0, source).to_base_units().magnitude)
    target = _parse(to)
    if source.dimensionality != target.dimensionality:
        raise UnitError(
            f"{unit!r} is not a unit of the kind {to!r}",
            value=unit,
            unit=to,
            remedy=f"give it in a unit like {to}",
        )
    return float(_registry().Quantity(1.0, source).to(target).magnitude)


def quantity(text: str, unit: str) -> float:
    """Read a quantity: one number with a decimal point, and one unit; nothing else.

    Parameters
    ----------
    text
        Such as ``"6 bar"``, ``"208 mm"``, ``"-3 %"``, ``"5e4 Pa/rad"``. A bare number is read only where
        `unit` is ``"1"``.
    unit
        The unit of the answer, which also says what kind of quantity is expected.

    Raises
    ------
    UnitError
        If the text is anything else, the number is not finite, or the unit is of another kind.

    Examples
    --------
    >>> quantity("25 %", "1")
    0.25
    >>> quantity("4,5 bar", "Pa")
    Traceback (most recent call last):
        ...
    mckibben.errors.UnitError: '4,5 bar' is not a number and a unit; write it like '4.5 bar'
    """
    if not isinstance(text, str):  # type: ignore[unnecessary-isinstance]  # YAML hands over numbers too
        raise UnitError(f"{text!r} has no unit", value=text, unit=unit, remedy=f"write it like '{text} {unit}'")
    stripped = text.strip()
    number = _NUMBER.match(stripped)
    rest = stripped[number.end() :].strip() if number else ""
    if not number or not (rest or unit == "1") or not _REST.fullmatch(rest):
        example = stripped.replace(",", ".") if re.fullmatch(r"\d+,\d+ \S+", stripped) else f"12.5 {unit}"
        raise UnitError(
            f"{text!r} is not a number and a unit", value=text, unit=unit, remedy=f"write it like {example!r}"
        )
    rest = f"1{rest}" if rest.startswith("/") else rest
    value = float(number.group()) * factor(rest or "1", unit)
    if not math.isfinite(value):
        raise UnitError(f"{text!r} is not a finite number", value=text, unit=unit)
    return value


def show(value: float, unit: str, digits: int = 6) -> str:
    """An SI value as text in `unit`; `quantity` reads it back.

    >>> show(0.208, "mm")
    '208 mm'
    """
    number = f"{value / factor(unit):.{digits}g}"
    return number if unit == "1" else f"{number} {unit}"
