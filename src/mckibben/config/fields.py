"""Field types of configuration files: quantities with unit and range, integers, choices, text and paths."""

from __future__ import annotations

import functools
import math
import os
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from pydantic import BeforeValidator, GetCoreSchemaHandler, PlainSerializer, SerializationInfo, ValidationInfo
from pydantic_core import core_schema

from mckibben.config.model import fail_validation
from mckibben.errors import LONGEST_VALUE, UnitError, quoted, suggest
from mckibben.units import factor, quantity, show

_NUMBER = re.compile(r"[+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?")


@dataclass(frozen=True)
class Quantity:
    """Marks a float in SI that is a number and a unit in text.

    Parameters
    ----------
    unit
        The SI unit inside; "1" for a plain number.
    shown
        The unit that it is written in.
    lower, upper
        The range it may have, in the unit shown.
    open_lower, open_upper
        Whether that end is left out.
    """

    unit: str
    shown: str
    lower: float = -1e12
    upper: float = 1e12
    open_lower: bool = False
    open_upper: bool = False

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> core_schema.CoreSchema:
        return core_schema.no_info_before_validator_function(
            self.read,
            handler(source),
            serialization=core_schema.plain_serializer_function_ser_schema(self.write, when_used="json"),
        )

    def read(self, value: Any) -> float:
        """The value in SI, checked."""
        if isinstance(value, str):
            number = self._from_text(value)
        elif isinstance(value, int | float) and not isinstance(value, bool):
            number = float(value)
        else:
            fail_validation(f"{quoted(value)} is not a quantity", f"write it like {self.example}")
        if not self.holds(number):
            lower, upper = self.limits
            fail_validation(
                f"{quoted(value)} is outside {self.range}",
                "choose a value inside",
                value=number,
                lower=lower,
                upper=upper,
                unit=self.unit,
            )
        return number

    def write(self, value: float) -> str:
        """Text that `read` takes back to the same float, in the unit shown wherever that is possible."""
        if self.unit == "1":
            return f"{value:.16g}" if float(f"{value:.16g}") == value else repr(value)
        for digits in (15, 16, 17):
            text = show(value, self.shown, digits)
            if quantity(text, self.unit) == value:
                return text
        return show(value, self.unit, 17)  # some floats are no float times a factor; in SI the factor is 1

    @functools.cached_property
    def limits(self) -> tuple[float, float]:
        """Both ends of the range in SI, whether they belong to it or not."""
        scale = factor(self.shown, self.unit)
        return self.lower * scale, self.upper * scale

    def holds(self, number: Any) -> Any:
        """Whether a number in SI, or each of an array, is in the range."""
        lower, upper = self.limits
        above = number > lower if self.open_lower else number >= lower
        return above & (number < upper if self.open_upper else number <= upper)

    @property
    def example(self) -> str:
        """How a value may look."""
        return f"'12.5 {self.shown}'" if self.unit != "1" else "0.5"

    @property
    def range(self) -> str:
        """The range, in words."""
        unit = f" {self.shown}" if self.unit != "1" else ""
        lower = f"above {self.lower:g}" if self.open_lower else f"{self.lower:g}"
        upper = f"below {self.upper:g}" if self.open_upper else f"{self.upper:g}"
        return f"{lower} to {upper}{unit}"

    def _from_text(self, text: str) -> float:
        stripped = text.strip()
        if not stripped:
            fail_validation("has no value", f"write it like {self.example}, or leave the key out")
        if len(stripped) > LONGEST_VALUE:  # the unit parser is for units, not for attacks
            fail_validation(f"{quoted(text)} is not a quantity", f"write it like {self.example}")
        if self.unit != "1" and _NUMBER.fullmatch(stripped):
            fail_validation(f"{quoted(text)} has no unit", f"write it like '{stripped} {self.shown}'")
        try:
            return quantity(stripped, self.unit)
        except UnitError:
            pass
        except ArithmeticError:  # a product of units beyond the floats
            fail_validation(f"{quoted(text)} is not a finite number", f"write it like {self.example}")
        try:  # the same complaint, but about the unit shown
            return quantity(stripped, self.shown) * factor(self.shown, self.unit)
        except UnitError as error:
            fail_validation(error.message, error.remedy, value=text, unit=self.shown)


_NOT_FINITE = {".nan": math.nan, ".inf": math.inf, "+.inf": math.inf, "-.inf": -math.inf}


@dataclass(frozen=True)
class Number:
    """Marks a plain number, whose unit stands elsewhere.

    Parameters
    ----------
    infinite, nan
        Whether it may be these.
    """

    infinite: bool = False
    nan: bool = False

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> core_schema.CoreSchema:
        return core_schema.no_info_before_validator_function(self.read, handler(source))

    def read(self, value: Any) -> float:
        """The number, checked."""
        number = value
        if isinstance(value, str):
            text = value.strip().lower()
            number = float(text) if _NUMBER.fullmatch(text) else _NOT_FINITE.get(text)
        if not isinstance(number, int | float) or isinstance(number, bool):
            fail_validation(f"{quoted(value)} is not a number", "write it like 12.5", value=value)
        if not (math.isfinite(number) or (self.nan if math.isnan(number) else self.infinite)):
            fail_validation(f"{quoted(value)} is not finite", "give a finite number", value=number)
        return float(number)


_WHOLE = re.compile(r"[+-]?[0-9]{1,15}")


@dataclass(frozen=True)
class BoundedInt:
    """Marks an integer within a range."""

    lower: int
    upper: int

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> core_schema.CoreSchema:
        return core_schema.no_info_before_validator_function(self.read, handler(source))

    def read(self, value: Any) -> int:
        """The number, checked."""
        if isinstance(value, str):
            if not _WHOLE.fullmatch(value.strip()):
                fail_validation(
                    f"{quoted(value)} is not a whole number", f"choose one from {self.lower} to {self.upper}"
                )
            value = int(value)
        if not isinstance(value, int) or isinstance(value, bool) or not self.lower <= value <= self.upper:
            fail_validation(
                f"{quoted(value)} is outside {self.lower} to {self.upper}",
                "choose a whole number inside",
                value=value,
                lower=self.lower,
                upper=self.upper,
            )
        return value


def read_flag(value: Any) -> bool:
    """True or false."""
    if not isinstance(value, bool) and value not in ("true", "false"):
        fail_validation(f"{quoted(value)} is neither true nor false", "write true or false")
    return value is True or value == "true"


@dataclass(frozen=True)
class OneOf:
    """Marks one of a few words."""

    words: tuple[str, ...]

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> core_schema.CoreSchema:
        return core_schema.no_info_before_validator_function(self.read, handler(source))

    def read(self, value: Any) -> str:
        """The word, checked."""
        if value not in self.words:
            fail_validation(f"{quoted(value)} is none of {', '.join(self.words)}", suggest(str(value), self.words))
        return value


def read_path(value: Any, info: ValidationInfo, ending: str) -> Path:
    """The absolute path of a file that exists; text is relative to the scenario's folder."""
    folder = (info.context or {}).get("folder") or Path()
    if not isinstance(value, str | Path) or not str(value):
        fail_validation(f"{quoted(value)} is not a path", f"name a file, such as 'some{ending}'")
    path = Path(os.path.abspath(folder / value))  # noqa: PTH100 (resolve() would follow links)
    try:
        found = path.is_file()
    except (OSError, ValueError):
        found = False
    if not found:
        where = folder.absolute()
        fail_validation(f"there is no file {quoted(str(value))}", f"paths are relative to the scenario, here {where}")
    return path


def write_path(path: Path, info: SerializationInfo) -> str:
    """A path relative to the scenario's folder where it lies below it, else absolute."""
    folder = (info.context or {}).get("folder") or Path()
    folder = Path(os.path.abspath(folder))  # noqa: PTH100
    return (path.relative_to(folder) if path.is_relative_to(folder) else path).as_posix()


def read_table(value: Any, info: ValidationInfo) -> Path:
    """The path of a CSV file."""
    return read_path(value, info, ".csv")


def read_title(value: Any) -> str:
    """One line of text."""
    if not isinstance(value, str) or not value.strip():
        fail_validation(f"{quoted(value)} is not a name", "name the scenario in a few words")
    if len(value.strip()) > 200 or not value.strip().isprintable():
        fail_validation(f"{quoted(value)} is not one line of at most 200 characters", "shorten it")
    return value.strip()


Title = Annotated[str, BeforeValidator(read_title)]
Flag = Annotated[bool, BeforeValidator(read_flag)]
TablePath = Annotated[Path, BeforeValidator(read_table), PlainSerializer(write_path, when_used="json")]

Duration = Annotated[float, Quantity("s", "s", 0, 1e6, open_lower=True)]
Instant = Annotated[float, Quantity("s", "s", -1e6, 1e6)]
ShortTime = Annotated[float, Quantity("s", "ms", 0, 1e6)]
PositiveTime = Annotated[float, Quantity("s", "ms", 0, 1e6, open_lower=True)]
Frequency = Annotated[float, Quantity("1/s", "Hz", 0, 1e6)]
Length = Annotated[float, Quantity("m", "mm", 0, 1e5, open_lower=True)]
Distance = Annotated[float, Quantity("m", "mm", 0, 1e5)]
Mass = Annotated[float, Quantity("kg", "kg", 0, 1e4)]
Inertia = Annotated[float, Quantity("kg*m^2", "kg*m^2", 0, 1e4)]
Damping = Annotated[float, Quantity("N*m*s/rad", "N*m*s/rad", 0, 1e6)]
Gravity = Annotated[float, Quantity("m/s^2", "m/s^2", 0, 1e3)]
SpringRate = Annotated[float, Quantity("N/m", "N/mm", 0, 1e6, open_lower=True)]
Force = Annotated[float, Quantity("N", "N", 0, 1e6)]
FrictionForce = Annotated[float, Quantity("N", "N", 1e-6, 1e6)]
FrictionGrowth = Annotated[float, Quantity("N/Pa", "N/bar", -1e4, 1e4)]
Presliding = Annotated[float, Quantity("m", "mm", 0, 1e3, open_lower=True)]
CreepTime = Annotated[float, Quantity("s", "s", 0.01, 1e6)]
Viscosity = Annotated[float, Quantity("N*s/m", "N*s/m", 0, 1e6)]
Tension = Annotated[float, Quantity("N", "N", 0, 1e6, open_lower=True)]
Pressure = Annotated[float, Quantity("Pa", "bar", -1e3, 1e3)]
PressureNoise = Annotated[float, Quantity("Pa", "kPa", 0, 1e5)]
AngleStep = Annotated[float, Quantity("rad", "deg", 0, 90)]
Torque = Annotated[float, Quantity("N*m", "N*m", -1e6, 1e6)]
Share = Annotated[float, Quantity("1", "1", 0, 100)]
PositiveTorque = Annotated[float, Quantity("N*m", "N*m", 0, 1e6, open_lower=True)]
Strength = Annotated[float, Quantity("1", "1", 0, 100, open_lower=True)]
StrengthSpread = Annotated[float, Quantity("1", "1", 0, 0.3, open_lower=True)]
Delay = Annotated[float, Quantity("1", "1", 0, 1)]
Angle = Annotated[float, Quantity("rad", "deg", -360, 360)]
Stiffness = Annotated[float, Quantity("N*m/rad", "N*m/rad", -1e6, 1e6)]
Phase = Annotated[float, Quantity("rad", "deg", -1e4, 1e4)]
AngleScale = Annotated[float, Quantity("rad", "deg", 0, 1e6, open_lower=True)]
StiffnessScale = Annotated[float, Quantity("N*m/rad", "N*m/rad", 0, 1e6, open_lower=True)]
PressureScale = Annotated[float, Quantity("Pa", "bar", 0, 1e3, open_lower=True)]
PressureRate = Annotated[float, Quantity("Pa/s", "bar/s", 0, 1e6, open_lower=True)]
Rate = Annotated[float, Quantity("1/s", "1/s", 0, 1e6)]
PositiveRate = Annotated[float, Quantity("1/s", "1/s", 0, 1e6, open_lower=True)]
Bandwidth = Annotated[float, Quantity("rad/s", "rad/s", 0, 1e6, open_lower=True)]
AngularAcceleration = Annotated[float, Quantity("rad/s^2", "rad/s^2", 0, 1e6, open_lower=True)]
PoleDamping = Annotated[float, Quantity("1", "1", 2, 3)]
Momentum = Annotated[float, Quantity("1", "1", 0, 1, open_upper=True)]
Ratio = Annotated[float, Quantity("1", "1", 1, 1e6, open_lower=True)]

AngleGain = Annotated[float, Quantity("Pa/rad", "bar/rad", -1e6, 1e6)]
AngleIntegralGain = Annotated[float, Quantity("Pa/(rad*s)", "bar/(rad*s)", -1e6, 1e6)]
AngleDerivativeGain = Annotated[float, Quantity("Pa*s/rad", "bar*s/rad", -1e6, 1e6)]
StiffnessGain = Annotated[float, Quantity("Pa/(N*m/rad)", "bar/(N*m/rad)", -1e6, 1e6)]
StiffnessIntegralGain = Annotated[float, Quantity("Pa/(N*m*s/rad)", "bar/(N*m*s/rad)", -1e6, 1e6)]
StiffnessDerivativeGain = Annotated[float, Quantity("Pa*s/(N*m/rad)", "bar*s/(N*m/rad)", -1e6, 1e6)]
