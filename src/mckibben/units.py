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

from mckibben.errors import UnitError

Pa = 1.0
kPa = 1e3  # noqa: N816
MPa = 1e6
bar = 1e5
atm = 101325.0
m = 1.0
cm = 1e-2
mm = 1e-3
N = 1.0
kg = 1.0
g = 1e-3
litre = 1e-3
s = 1.0
ms = 1e-3
Hz = 1.0
rad = 1.0
deg = math.pi / 180
percent = 1e-2

# The whole vocabulary: a text with any other unit is refused. Each has its size in SI and its dimensions as powers of
# metre, kilogram, second and radian. An angle is a dimension of its own here, so that N*m/rad (a stiffness) and N*m (a
# torque) do not pass for each other.
_LENGTH, _MASS, _TIME, _ANGLE, _NOTHING = (1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), (0, 0, 0, 1), (0, 0, 0, 0)
_FORCE, _PRESSURE = (1, 1, -2, 0), (-1, 1, -2, 0)
_VOCABULARY: dict[str, tuple[float, tuple[int, ...]]] = {
    "m": (1.0, _LENGTH),
    "cm": (cm, _LENGTH),
    "mm": (mm, _LENGTH),
    "L": (litre, (3, 0, 0, 0)),
    "kg": (1.0, _MASS),
    "g": (g, _MASS),
    "s": (1.0, _TIME),
    "ms": (ms, _TIME),
    "min": (60.0, _TIME),
    "Hz": (1.0, (0, 0, -1, 0)),
    "N": (1.0, _FORCE),
    "kN": (1e3, _FORCE),
    "Pa": (1.0, _PRESSURE),
    "kPa": (kPa, _PRESSURE),
    "MPa": (MPa, _PRESSURE),
    "bar": (bar, _PRESSURE),
    "mbar": (100.0, _PRESSURE),
    "psi": (6894.757293168361, _PRESSURE),
    "rad": (1.0, _ANGLE),
    "deg": (deg, _ANGLE),
    "percent": (percent, _NOTHING),
    "ratio": (1.0, _NOTHING),
}
UNITS = list(_VOCABULARY)

_NAME = r"(?:[A-Za-z]+(?:\^-?[1-9])?)"
_PRODUCT = rf"{_NAME}(?:[*/]{_NAME})*"
_FACTOR = rf"(?:{_NAME}|\({_PRODUCT}\))"
_UNIT = re.compile(rf"{_FACTOR}(?:[*/]{_FACTOR})*")
_NUMBER = re.compile(r"[+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?")
_TOKEN = re.compile(rf"{_NAME}|[*/()]")
_LONGEST = 80  # characters in a unit
_REST = re.compile(r"(?:(?:1?/|[A-Za-z%°(]).*)?", re.DOTALL)


@functools.cache
def _parse(unit: str) -> dict[str, int]:
    """The power of each name in a unit of our grammar."""
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
    powers: dict[str, int] = {}
    outside, inside = 1, 1  # the sign that * or / gave the powers, before and in parentheses
    in_parentheses = False
    for token in _TOKEN.findall(text):
        if token in "()":
            in_parentheses, inside = token == "(", 1
        elif token in "*/":
            sign = 1 if token == "*" else -1
            outside, inside = (outside, sign) if in_parentheses else (sign, 1)
        else:
            name, _, power = token.partition("^")
            if name not in _VOCABULARY:
                raise UnitError(
                    f"unknown unit {name!r} in {unit!r}", value=unit, remedy=f"known are {', '.join(UNITS)} and %"
                )
            powers[name] = powers.get(name, 0) + outside * inside * int(power or 1)
    return powers


def _size(powers: dict[str, int]) -> float:
    """How much of SI a unit is."""
    size = 1.0
    for name, power in powers.items():
        size *= _VOCABULARY[name][0] ** power
    return size


def _dimensions(powers: dict[str, int]) -> list[int]:
    """The powers of metre, kilogram, second and radian."""
    return [sum(_VOCABULARY[name][1][base] * power for name, power in powers.items()) for base in range(4)]


def factor(unit: str, to: str = "") -> float:
    """What to multiply a number in `unit` by to have it in `to` (by default in SI).

    >>> factor("N/bar")
    1e-05
    >>> factor("1/percent", "1/ratio")
    100.0
    """
    source = _parse(unit)
    if not to:
        return _size(source)
    target = _parse(to)
    if _dimensions(source) != _dimensions(target):
        raise UnitError(
            f"{unit!r} is not a unit of the kind {to!r}",
            value=unit,
            unit=to,
            remedy=f"give it in a unit like {to}",
        )
    return _size({name: source.get(name, 0) - target.get(name, 0) for name in [*source, *target]})


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


def split_range(text: str) -> tuple[str, str]:
    """Split a range ``LOW..HIGH`` into the texts of its ends; the unit of HIGH does for both.

    >>> split_range("1.5e2..2.6e2 mm")
    ('1.5e2 mm', '2.6e2 mm')
    """
    low, _, high = (part.strip() for part in text.partition(".."))
    number = _NUMBER.match(high)
    if number and _NUMBER.fullmatch(low):
        low = f"{low} {high[number.end() :].strip()}".strip()
    return low, high


def parse_range(text: str, unit: str) -> tuple[float, float]:
    """Read a range ``LOW..HIGH`` of quantities, or one quantity, which is both its ends.

    Parameters
    ----------
    text
        Such as ``"150..260 mm"``, ``"-3 %..25 %"`` or ``"6 bar"``.
    unit
        The unit of the answer, as for `quantity`.

    Raises
    ------
    UnitError
        If an end is no such quantity, or the range is reversed.

    Examples
    --------
    >>> parse_range("3..6 bar", "Pa")
    (300000.0, 600000.0)
    >>> parse_range("260..150 mm", "m")
    Traceback (most recent call last):
        ...
    mckibben.errors.UnitError: '260..150 mm' is a reversed range; write the lower end first
    """
    if ".." not in text:
        value = quantity(text, unit)
        return value, value
    low, high = (quantity(end, unit) for end in split_range(text))
    if low > high:
        raise UnitError(f"{text!r} is a reversed range", value=text, unit=unit, remedy="write the lower end first")
    return low, high


def show(value: float, unit: str, digits: int = 6) -> str:
    """An SI value as text in `unit`; `quantity` reads it back.

    >>> show(0.208, "mm")
    '208 mm'
    """
    number = f"{value / factor(unit):.{digits}g}"
    return number if unit == "1" else f"{number} {unit}"
