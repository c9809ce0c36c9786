"""Units at the edge of the code (SI floats inside), and unit and range as metadata of fields.

In Python, multiply by a unit to get SI and divide by it to leave SI:

>>> pressure = 6 * bar
>>> pressure, pressure / kPa
(600000.0, 600.0)

In text (scenario files, the command line, catalog files) a quantity is one number and one unit:

>>> quantity("6 bar", "Pa")
600000.0
"""

from __future__ import annotations

import functools
import math
import re
from dataclasses import dataclass
from decimal import Decimal
from fractions import Fraction
from typing import Annotated, Any, NoReturn

from mckibben.errors import LONGEST_VALUE, RangeError, UnitError, quoted

# Sizes in SI, and kinds by their powers of metre, kilogram, second, radian and kelvin. An angle is a dimension of its
# own, so that N*m/rad (a stiffness) and N*m (a torque) are not interchangeable.
_KINDS: dict[str, tuple[int, ...]] = {
    "length": (1, 0, 0, 0, 0),
    "volume": (3, 0, 0, 0, 0),
    "mass": (0, 1, 0, 0, 0),
    "time": (0, 0, 1, 0, 0),
    "frequency": (0, 0, -1, 0, 0),
    "angle": (0, 0, 0, 1, 0),
    "temperature": (0, 0, 0, 0, 1),
    "force": (1, 1, -2, 0, 0),
    "pressure": (-1, 1, -2, 0, 0),
    "energy": (2, 1, -2, 0, 0),
    "power": (2, 1, -3, 0, 0),
    "ratio": (0, 0, 0, 0, 0),
}
_SIZES: dict[str, dict[str, float]] = {
    "length": {"m": 1.0, "dm": 0.1, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "in": 0.0254},
    "volume": {"L": 1e-3, "mL": 1e-6, "ml": 1e-6},
    "mass": {"kg": 1.0, "g": 1e-3},
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0},
    "frequency": {"Hz": 1.0},
    "force": {
        **{"N": 1.0, "kN": 1e3, "daN": 10.0, "cN": 0.01, "mN": 1e-3},
        **{"kgf": 9.80665, "gf": 9.80665e-3, "lbf": 4.4482216152605},
    },
    "pressure": {
        **{"Pa": 1.0, "kPa": 1e3, "MPa": 1e6, "bar": 1e5, "mbar": 100.0, "hPa": 100.0},
        **{"atm": 101325.0, "mmHg": 133.322387415, "psi": 6894.757293168361},
    },
    "angle": {"rad": 1.0, "mrad": 1e-3, "deg": math.pi / 180},
    "energy": {"J": 1.0},
    "power": {"W": 1.0},
    "temperature": {"K": 1.0},
    "ratio": {"percent": 1e-2, "permille": 1e-3, "ratio": 1.0},
}
_VOCABULARY = {name: (size, _KINDS[kind]) for kind, sizes in _SIZES.items() for name, size in sizes.items()}
UNITS = list(_VOCABULARY)

Pa, kPa, MPa, bar, atm = (_SIZES["pressure"][name] for name in ("Pa", "kPa", "MPa", "bar", "atm"))  # noqa: N816
m, cm, mm = (_SIZES["length"][name] for name in ("m", "cm", "mm"))
rad, mrad, deg = _SIZES["angle"].values()
kg, g = _SIZES["mass"].values()
s, ms = (_SIZES["time"][name] for name in ("s", "ms"))
N, Hz, litre, percent = (_VOCABULARY[name][0] for name in ("N", "Hz", "L", "percent"))

GRAVITY = 9.81
"""Acceleration of gravity [m/s^2], as in the paper."""

_NAME = r"(?:[A-Za-z]+(?:\^-?(?:[1-9](?:\.[0-9]+)?|0\.[0-9]+))?)"
_PRODUCT = rf"{_NAME}(?:[*/]{_NAME})*"
_FACTOR = rf"(?:{_NAME}|\({_PRODUCT}\))"
_UNIT = re.compile(rf"{_FACTOR}(?:[*/]{_FACTOR})*")
NUMBER = re.compile(r"[+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?")
_WHOLE = re.compile(r"[+-]?[0-9]{1,15}")
_REST = re.compile(r"(?:(?:1?/|[A-Za-z%°(]).*)?", re.DOTALL)


@functools.cache
def _parse(unit: str) -> dict[str, float]:
    """Exponent of each name in a unit expression."""
    if len(unit) > LONGEST_VALUE:
        raise UnitError(f"{unit[:20]!r}... is not a unit", value=unit, remedy="a unit is a few names joined by * and /")
    text = unit.strip().replace("%", "percent").replace("°", "deg").replace("·", "*").replace("**", "^")
    text = re.sub(r"\s*([*/()^])\s*", r"\1", text)
    if text == "1" or text.startswith("1/"):
        text = f"ratio{text[1:]}"
    if not _UNIT.fullmatch(text):
        remedy = "write units joined by * and /, such as bar, N*m/rad or kg*m^2"
        raise UnitError(f"{quoted(unit)} is not a unit", value=unit, remedy=remedy)
    text = re.sub(r"/\((.*?)\)", lambda group: f"/{group[1].translate({42: '/', 47: '*'})}", text)
    powers: dict[str, float] = {}
    for sign, name, power in re.findall(r"([*/]?)\(?([A-Za-z]+)\^?([-.0-9]*)", text):
        if name not in _VOCABULARY:
            remedy = f"known are {', '.join(UNITS)} and %"
            raise UnitError(f"unknown unit {name!r} in {unit!r}", value=unit, remedy=remedy)
        exponent = float(power or 1) * (-1 if sign == "/" else 1)
        powers[name] = powers.get(name, 0) + (int(exponent) if exponent.is_integer() else exponent)
    return powers


def dimensions(unit: str) -> tuple[float, ...]:
    """Exponents of metre, kilogram, second, radian and kelvin in a unit; `UnitError` for another text.

    >>> dimensions("N*m/rad")
    (2, 1, -2, -1, 0)
    """
    powers = _parse(unit)
    return tuple(sum(_VOCABULARY[name][1][base] * power for name, power in powers.items()) for base in range(5))


def factor(unit: str, to: str = "") -> float:
    """Conversion factor from `unit` to `to` (default: SI).

    >>> factor("N/bar")
    1e-05
    >>> factor("1/percent", "1/ratio")
    100.0
    """
    source, target = _parse(unit), _parse(to) if to else {}
    if to and dimensions(unit) != dimensions(to):
        remedy = "give a number without unit" if to == "1" else f"use a unit such as {to}"
        raise UnitError(f"unit {unit!r} does not have the dimensions of {to!r}", value=unit, unit=to, remedy=remedy)
    powers = {name: source.get(name, 0) - target.get(name, 0) for name in [*source, *target]}
    return math.prod(_VOCABULARY[name][0] ** power for name, power in powers.items())


def number_and_unit(text: str) -> tuple[str, str]:
    """Number at the start of a text, and the unit behind it; "" for what is missing.

    >>> number_and_unit("12.5 mm"), number_and_unit("fast")
    (('12.5', 'mm'), ('', ''))
    """
    number = NUMBER.match(text.strip())
    return (number.group(), text.strip()[number.end() :].strip()) if number else ("", "")


def _split(text: object, unit: str, unit_in_files: str) -> tuple[str, str]:
    """Number and unit of a quantity as texts; `UnitError` where it is not both."""
    stripped, asked = str(text).strip(), unit_in_files or {"m": "mm", "Pa": "bar"}.get(unit, unit)
    number, unit_text = number_and_unit(stripped)
    wrong, example = "", f"12.5 {asked}"
    if not isinstance(text, str) or (number and not unit_text and unit != "1"):  # YAML gives numbers, too
        wrong, example = "has no unit", f"{stripped:.{LONGEST_VALUE}} {asked}"
    elif not number or not _REST.fullmatch(unit_text) or len(stripped) > LONGEST_VALUE:
        wrong = "is not a number and a unit"
        example = stripped.replace(",", ".") if re.fullmatch(r"\d{1,9},\d{1,9} \S{1,9}", stripped) else example
    if wrong:
        raise UnitError(
            f"{quoted(text)} {wrong}", value=text, unit=unit_in_files or unit, remedy=f"write it like {example!r}"
        )
    return number, f"1{unit_text}" if unit_text.startswith("/") else unit_text or "1"


def quantity(text: object, unit: str, *, shown: str = "") -> float:
    """Read a quantity such as ``6 bar`` or ``-3 %`` in SI: one number with a decimal point and one unit.

    `unit` gives the expected dimensions; a bare number is accepted only if it is "1". Raises `UnitError`, with a remedy
    in the unit `shown`, for any other text and for numbers that are not finite.

        >>> quantity("25 %", "1")
        0.25
        >>> quantity("4,5 bar", "Pa")
        Traceback (most recent call last):
            ...
        mckibben.errors.UnitError: '4,5 bar' is not a number and a unit; write it like '4.5 bar'
    """
    number, unit_text = _split(text, unit, shown)
    factor(unit_text, shown or unit)  # its error names the unit shown
    try:
        value = float(number) * factor(unit_text, unit)
    except OverflowError:
        value = math.inf
    mantissa = number.lower().partition("e")[0]
    if len(mantissa.replace(".", "").lstrip("+-0")) > 17 and 1e-290 < abs(value) < 1e290:  # by `Quantity.write`
        value = float(Fraction(number) * Fraction(factor(unit_text, unit)))
    if not math.isfinite(value):
        raise UnitError(f"{quoted(text)} is not a finite number", value=text, unit=shown or unit)
    return value


def split_range(text: str) -> tuple[str, str]:
    """Split ``LOW..HIGH`` into its ends as text; LOW may omit the unit.

    >>> split_range("3..6 bar")
    ('3 bar', '6 bar')
    """
    low, _, high = (end.strip() for end in text.partition(".."))
    number = NUMBER.match(high)
    if number and NUMBER.fullmatch(low):
        low = f"{low} {high[number.end() :].strip()}".strip()
    return low, high


def parse_range(text: str, unit: str) -> tuple[float, float]:
    """Read a range ``LOW..HIGH`` of quantities, or a single quantity as both ends.

    >>> parse_range("3..6 bar", "Pa")
    (300000.0, 600000.0)
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


@dataclass(frozen=True)
class JointType:
    """How a joint moves, on which the units of its quantities depend: they are declared for a hinge.

    >>> SLIDE.unit("N*m/rad"), SLIDE.shown("N*m/rad"), SLIDE.words("torque at the angle")
    ('N/m', 'N/mm', 'force at the position')
    """

    name: str
    replacements: tuple[tuple[str, str], ...] = ()  # of parts of units
    nouns: tuple[tuple[str, str], ...] = ()
    scale: float = 1.0
    """Displacement [m, rad] of the joint that corresponds to one radian of a hinge, for thresholds."""

    def unit(self, unit: str) -> str:
        """Return the SI unit of a quantity, from that of a hinge."""
        return functools.reduce(lambda text, pair: text.replace(*pair), self.replacements, unit)

    def shown(self, unit: str) -> str:
        """Return the unit in files and tables, from that of a hinge."""
        return self.unit(unit.replace("rad", "deg") if self.replacements else unit)

    def words(self, text: str) -> str:
        """Return a text without numbers, from that on a hinge."""
        return functools.reduce(lambda text, pair: re.sub(rf"\b{pair[0]}", pair[1], text), self.nouns, text)

    def size(self, unit: str) -> float:
        """Return the size in SI of the unit of files, tables and figures, from that of a hinge."""
        return factor(self.shown(unit))

    def label(self, text: str, unit: str) -> str:
        """Return the label of an axis, from that of a hinge.

        >>> SLIDE.label("stiffness", "N*m/rad"), HINGE.label("torque", "N*m")
        ('stiffness [N/mm]', 'torque [N·m]')
        """
        return f"{self.words(text)} [{self.shown(unit)}]".replace("*", "·")

    def show(self, value: float, unit: str, digits: int = 6) -> str:
        """Return an SI value as text; `unit` is the one in which that of a hinge is shown."""
        return show(value, self.shown(unit), digits)

    def span(self, ends: tuple[float, float], unit: str, digits: int = 4) -> str:
        """Return two SI values as a range, as for `show`.

        >>> SLIDE.span((-0.004, 0.01), "deg")
        '-4..10 mm'
        """
        low, high = (f"{end / self.size(unit):.{digits}g}" for end in ends)
        return f"{low}..{high} {self.shown(unit)}"


HINGE = JointType("hinge")
SLIDE = JointType(
    "slide",
    (("kg*m^2", "kg"), ("N*m", "N"), ("deg", "mm"), ("rad", "m")),
    (("angular ", ""), ("an angle", "a position"), ("angle", "position"), ("torque", "force")),
    mm / deg,
)
JOINT_TYPES = {kind.name: kind for kind in (HINGE, SLIDE)}


def justified(text: str, error: float = math.nan) -> str:
    """A quantity to two digits of its standard error [SI], but at least two of its own; to six without an error.

    Two digits move it by at most 5 % of the error.

    >>> justified("12.001437258969247 N", 0.2847), justified("0.500686814 mm", 1.5e-6), justified("3.14159265 bar")
    ('12 N', '0.5007 mm', '3.14159 bar')
    """
    number, _, unit = text.partition(" ")
    value = float(number)
    least = min(error / factor(unit or "1"), abs(value))
    rounded = round(value, 1 - math.floor(math.log10(least))) if least > 0 else float(f"{value:.6g}")
    return f"{rounded:.15g} {unit}".rstrip()


SYMBOLS = ("signal", "gain", "integral_gain", "derivative_gain", "scale")
"""Units that depend on where a component is: of a signal, of the gains of a loop, and of its controlled quantity."""


@dataclass(frozen=True)
class Quantity:
    """Unit and range of an SI float, as metadata of a field: ``mass: Annotated[float, Quantity("kg", lower=0)]``.

    `lower` and `upper` are in the unit `shown` (default: `unit`); open ends are excluded. Configuration files, study
    parameters and error messages derive unit and range from it.

        >>> time = Quantity("s", "ms", 0, 1e6, open_lower=True)
        >>> time.read("20 ms"), time.write(0.02), time.range
        (0.02, '20 ms', 'above 0, up to 1e+06 ms')
    """

    unit: str
    shown: str = ""
    lower: float = -1e12
    upper: float = 1e12
    open_lower: bool = False
    open_upper: bool = False

    def __post_init__(self) -> None:
        if not self.shown:
            object.__setattr__(self, "shown", self.unit)
        if self.unit not in SYMBOLS:
            factor(self.shown, self.unit)  # raises an error for an unknown unit, or one of other dimensions

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> Any:
        from pydantic_core import core_schema

        return core_schema.no_info_before_validator_function(
            self.read,
            core_schema.float_schema(),
            serialization=core_schema.plain_serializer_function_ser_schema(self.write, when_used="json"),
        )

    def read(self, value: Any) -> float:
        """Read text with a unit, or a number in SI, as a value in SI.

        Raises
        ------
        UnitError
            For a text without unit, with one of other dimensions, or that is no quantity; the remedy is an example.
        RangeError
            For a value outside the range, whose limits are in SI.
        """
        if isinstance(value, str) and not value.strip():
            self._fail("has no value", value, f"write it like {self.example}, or leave the key out")
        elif isinstance(value, str):
            number = quantity(value, self.unit, shown=self.shown)
        elif isinstance(value, int | float) and not isinstance(value, bool):
            number = float(value)
        else:
            self._fail(f"{quoted(value)} is not a quantity", value)
        if not self.holds(number):
            lower, upper = self.limits
            message = f"{quoted(value)} is out of range ({self.range})"
            remedy = "choose a value inside"
            raise RangeError(message, value=number, lower=lower, upper=upper, unit=self.unit, remedy=remedy)
        return number

    def write(self, value: float) -> str:
        """Text in the shown unit that `read` converts back to the same float.

        Some floats are not a float times the factor: they get 20 digits, and `quantity` rounds the product once.
        """
        if self.shown == "1":
            return f"{value:.16g}" if float(f"{value:.16g}") == value else repr(value)
        for digits in (15, 16, 17):
            text = show(value, self.shown, digits)
            if quantity(text, self.unit) == value:
                return text
        text = f"{Decimal(value) / Decimal(factor(self.shown, self.unit)):.20g} {self.shown}"
        return text if quantity(text, self.unit) == value else show(value, self.unit, 17)

    def for_joint(self, joint_type: JointType) -> Quantity:
        """Return the quantity for a joint of a type."""
        return self

    @functools.cached_property
    def limits(self) -> tuple[float, float]:
        """Both ends of the range in SI, included or not."""
        scale = factor(self.shown, self.unit)
        return self.lower * scale, self.upper * scale

    def holds(self, number: Any) -> Any:
        """Test whether a number in SI, or each of an array, is in the range."""
        lower, upper = self.limits
        above = number > lower if self.open_lower else number >= lower
        return above & (number < upper if self.open_upper else number <= upper)

    @property
    def example(self) -> str:
        """A value as it is written."""
        return f"'12.5 {self.shown}'" if self.shown != "1" else "0.5"

    @property
    def range(self) -> str:
        """The range as text."""
        unit = f" {self.shown}" if self.shown != "1" else ""
        lower = f"above {self.lower:g}" if self.open_lower else f"{self.lower:g}"
        upper = f"below {self.upper:g}" if self.open_upper else f"{self.upper:g}"
        return f"{lower}{', up to' if self.open_lower else ' to'} {upper}{unit}"

    def _fail(self, message: str, value: object, remedy: str = "") -> NoReturn:
        raise UnitError(message, value=value, unit=self.shown, remedy=remedy or f"write it like {self.example}")


class JointQuantity(Quantity):
    """Quantity of the motion of a joint: unit and range of a hinge, from which those of a slide follow.

    A document reads and writes it in the units of the `joint_type` in its context.

    >>> angle = JointQuantity("rad", "deg", -90, 90)
    >>> angle.for_joint(HINGE).read("10 deg") == 10 * deg, angle.for_joint(SLIDE).read("10 mm")
    (True, 0.01)
    """

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> Any:
        from pydantic_core import core_schema

        def of(info: Any) -> Quantity:
            return self.for_joint((info.context or {}).get("joint_type", HINGE))

        return core_schema.with_info_before_validator_function(
            lambda value, info: of(info).read(value),
            core_schema.float_schema(),
            serialization=core_schema.plain_serializer_function_ser_schema(
                lambda value, info: of(info).write(value), info_arg=True, when_used="json"
            ),
        )

    def for_joint(self, joint_type: JointType) -> Quantity:
        if joint_type is HINGE:
            return self
        unit, shown = joint_type.unit(self.unit), joint_type.shown(self.shown)
        lower, upper = (limit / factor(shown, unit) for limit in self.limits)
        return Quantity(unit, shown, lower, upper, self.open_lower, self.open_upper)


@dataclass(frozen=True)
class BoundedInt:
    """Range of an integer, as metadata of a field.

    >>> BoundedInt(1, 9).read("3"), BoundedInt(1, 9).range
    (3, '1 to 9')
    """

    lower: int
    upper: int
    unit = shown = "1"

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> Any:
        from pydantic_core import core_schema

        return core_schema.no_info_before_validator_function(self.read, core_schema.int_schema())

    def read(self, value: Any) -> int:
        """Check the number; RangeError unless it is an integer within the range."""
        written = value
        if isinstance(value, str):
            value = int(value) if _WHOLE.fullmatch(value.strip()) else None
        kind = isinstance(value, int) and not isinstance(value, bool)
        if not kind or not self.lower <= value <= self.upper:
            message = "is not a whole number" if value is None else f"is out of range ({self.range})"
            raise RangeError(
                f"{quoted(written if value is None else value)} {message}",
                value=value,
                lower=self.lower,
                upper=self.upper,
                remedy=f"choose a whole number from {self.range}",
            )
        return value

    @property
    def limits(self) -> tuple[float, float]:
        """Both ends of the range."""
        return self.lower, self.upper

    def holds(self, number: Any) -> Any:
        """Test whether a number, or each of an array, is whole and in the range."""
        return (number >= self.lower) & (number <= self.upper) & (number % 1 == 0)

    @property
    def range(self) -> str:
        """The range as text."""
        return f"{self.lower} to {self.upper}"


class Percent(Quantity):
    """Range of a ratio written in percent.

    >>> Percent("1", "%", -50, 80).read("10 %")
    0.1
    """

    def read(self, value: Any) -> float:
        """Check the ratio; a number without a unit is a ratio."""
        if isinstance(value, str) and NUMBER.fullmatch(value.strip()) and not self.holds(float(value)):
            message = f"{quoted(value)} has no unit, and as a ratio is out of range ({self.range})"
            self._fail(message, value, f"write '{value.strip()} %'")
        return super().read(value)

    @property
    def example(self) -> str:
        """A value as it is written."""
        return "'10 %'"


# Types of fields, for runtime classes and configuration files.
Duration = Annotated[float, Quantity("s", "s", 0, 1e6, open_lower=True)]
Instant = Annotated[float, Quantity("s", "s", -1e6, 1e6)]
ShortTime = Annotated[float, Quantity("s", "ms", 0, 1e6)]
PositiveTime = Annotated[float, Quantity("s", "ms", 0, 1e6, open_lower=True)]
ValveTime = Annotated[float, Quantity("s", "ms", 0, 1e4, open_lower=True)]
CommandDelay = Annotated[float, Quantity("s", "ms", 0, 1e3)]
Frequency = Annotated[float, Quantity("1/s", "Hz", 0, 1e6)]
Length = Annotated[float, Quantity("m", "mm", 0, 1e4, open_lower=True)]  # a larger number is in millimetres
Diameter = Annotated[float, Quantity("m", "mm", 0, 500, open_lower=True)]
MomentArm = Annotated[float, Quantity("m", "mm", 0, 2e3, open_lower=True)]  # a linear axis has a pulley of 1 m
Distance = Annotated[float, Quantity("m", "mm", 0, 1e4)]
Coordinate = Annotated[float, Quantity("m", "mm", -1e4, 1e4)]
BraidAngle = Annotated[float, Quantity("rad", "deg", 0.6, 54.7)]  # above this, a muscle extends
Mass = Annotated[float, Quantity("kg", "kg", 0, 1e4)]
PositiveMass = Annotated[float, Quantity("kg", "kg", 0, 1e4, open_lower=True)]
Inertia = Annotated[float, Quantity("kg*m^2", "kg*m^2", 0, 1e4)]
Damping = Annotated[float, Quantity("N*m*s/rad", "N*m*s/rad", 0, 1e6)]
Gravity = Annotated[float, Quantity("m/s^2", "m/s^2", 0, 1e3)]
SpringRate = Annotated[float, Quantity("N/m", "N/mm", 0, 1e6, open_lower=True)]
Force = Annotated[float, Quantity("N", "N", 0, 1e6)]
SignedForce = Annotated[float, Quantity("N", "N", -1e6, 1e6)]
ForcePerPressure = Annotated[float, Quantity("N/Pa", "N/bar", -1e5, 1e5)]  # an area: a larger number is in N/bar
ForceTerm = Annotated[float, Quantity("N", "N", -1e40, 1e40)]  # terms of a law may cancel: `check_gain`
GainTerm = Annotated[float, Quantity("N/Pa", "N/bar", -1e40, 1e40)]
Tension = Annotated[float, Quantity("N", "N", 0, 1e6, open_lower=True)]
Pressure = Annotated[float, Quantity("Pa", "bar", -1e3, 1e3)]
PositivePressure = Annotated[float, Quantity("Pa", "bar", 0.01, 1e3)]
SupplyPressure = Annotated[float, Quantity("Pa", "bar", 0.01, 30)]
Conductance = Annotated[float, Quantity("m^3/(s*Pa)", "L/(s*bar)", 0, 1e4, open_lower=True)]
Volume = Annotated[float, Quantity("m^3", "cm^3", 0, 1e6, open_lower=True)]
HeatConductance = Annotated[float, Quantity("W/K", "W/K", 0, 1e3)]
PressureNoise = Annotated[float, Quantity("Pa", "kPa", 0, 1e5)]
AngleStep = Annotated[float, JointQuantity("rad", "deg", 0, 10)]
Torque = Annotated[float, JointQuantity("N*m", "N*m", -1e6, 1e6)]
Share = Annotated[float, Quantity("1", "1", 0, 100)]
Strength = Annotated[float, Quantity("1", "1", 0, 100, open_lower=True)]
Delay = Annotated[float, Quantity("1", "1", 0, 1)]
Angle = Annotated[float, JointQuantity("rad", "deg", -360, 360)]
Accuracy = Annotated[float, JointQuantity("rad", "rad", 1e-12, 1.0)]
Stiffness = Annotated[float, JointQuantity("N*m/rad", "N*m/rad", -1e6, 1e6)]
Phase = Annotated[float, Quantity("rad", "deg", -720, 720)]
AngleScale = Annotated[float, JointQuantity("rad", "deg", 0, 1e6, open_lower=True)]
StiffnessScale = Annotated[float, JointQuantity("N*m/rad", "N*m/rad", 0, 1e6, open_lower=True)]
PressureScale = Annotated[float, Quantity("Pa", "bar", 1e-3, 1e3)]
PressureRate = Annotated[float, Quantity("Pa/s", "bar/s", 1e-3, 1e6)]
Rate = Annotated[float, Quantity("1/s", "1/s", 0, 1e6)]
Bandwidth = Annotated[float, Quantity("rad/s", "rad/s", 0, 1e6, open_lower=True)]
AngularVelocity = Annotated[float, JointQuantity("rad/s", "deg/s", 0, 1e6, open_lower=True)]
AngularAcceleration = Annotated[float, JointQuantity("rad/s^2", "rad/s^2", 0, 1e6, open_lower=True)]
PoleDamping = Annotated[float, Quantity("1", "1", 2, 3)]
Seed = Annotated[int, BoundedInt(0, 2**31 - 1)]
Count = Annotated[int, BoundedInt(1, 1000)]
Ratio = Annotated[float, Quantity("1", "1", 1, 1e6, open_lower=True)]

AngleGain = Annotated[float, JointQuantity("Pa/rad", "bar/rad", -1e6, 1e6)]
SignalValue = Annotated[float, Quantity("signal")]
Gain = Annotated[float, Quantity("gain")]
IntegralGain = Annotated[float, Quantity("integral_gain")]
DerivativeGain = Annotated[float, Quantity("derivative_gain")]
Contraction = Annotated[float, Percent("1", "%", -50, 80)]
Speed = Annotated[float, Quantity("m/s", "mm/s", 0, 1e3, open_lower=True)]
Travel = Annotated[float, Quantity("m", "mm", 0, 2e3, open_lower=True)]
WaitTime = Annotated[float, Quantity("s", "s", 0, 1e6)]
SampleRate = Annotated[float, Quantity("1/s", "Hz", 0.001, 1e6)]
Factor = Annotated[float, Quantity("1", "1", 0, 1e6, open_lower=True)]
Samples = Annotated[int, BoundedInt(1, 1_000_000)]
Repeats = Annotated[int, BoundedInt(1, 10_000)]
