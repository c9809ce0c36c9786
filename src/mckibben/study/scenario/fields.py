"""The kinds of value that a scenario holds: each reads itself from text, checks its range, and writes itself back.

A value of Python's own type passes too, as SI: the parts of a scenario can be made in code.
"""

from __future__ import annotations

import difflib
import math
import os
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, NoReturn

from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    GetCoreSchemaHandler,
    PlainSerializer,
    SerializationInfo,
    ValidationInfo,
)
from pydantic_core import PydanticCustomError, core_schema

from mckibben.errors import UnitError
from mckibben.units import factor, quantity, show

_LONGEST = 80
_NUMBER = re.compile(r"[+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?")
_WHOLE = re.compile(r"[+-]?[0-9]{1,15}")


class Part(BaseModel):
    """A part of a scenario: frozen, without unknown keys."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)


def refuse(message: str, remedy: str = "", *, parent: bool = False) -> NoReturn:
    """Say in a validator what is wrong; with `parent` it is said of the part that the field belongs to."""
    context = {"message": message, "remedy": remedy, "parent": parent}
    raise PydanticCustomError("mckibben", "{message}; {remedy}" if remedy else "{message}", context)


def quoted(value: object) -> str:
    """A value as an error shows it, on one line and not too long."""
    text = repr(value)
    return text if len(text) <= _LONGEST else f"{text[: _LONGEST - 4]}...{text[-1]}"


def suggest(name: str, known: Sequence[str]) -> str:
    """A remedy for an unknown name.

    >>> suggest("sin", ["step", "sine"])
    "did you mean 'sine'?"
    """
    close = difflib.get_close_matches(name[:_LONGEST], known, 1, cutoff=0.6)
    return f"did you mean {close[0]!r}?" if close else f"known are {', '.join(known)}"


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
            refuse(f"{quoted(value)} is not a quantity", f"write it like {self.example}")
        if not self._holds(number):
            refuse(f"{quoted(value)} is outside {self.range}", "choose a value inside")
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

    @property
    def example(self) -> str:
        """How a value may look."""
        return f"'12.5 {self.shown}'" if self.unit != "1" else "0.5"

    @property
    def range(self) -> str:
        """The range, in words."""
        unit = f" {self.shown}" if self.unit != "1" else ""
        ends = [f"{self.lower:g} (excluded)" if self.open_lower else f"{self.lower:g}"]
        ends.append(f"{self.upper:g} (excluded)" if self.open_upper else f"{self.upper:g}")
        return f"{ends[0]} to {ends[1]}{unit}"

    def _from_text(self, text: str) -> float:
        stripped = text.strip()
        if not stripped:
            refuse("has no value", f"write it like {self.example}, or leave the key out")
        if len(stripped) > _LONGEST:  # the unit parser is for units, not for attacks
            refuse(f"{quoted(text)} is not a quantity", f"write it like {self.example}")
        if self.unit != "1" and _NUMBER.fullmatch(stripped):
            refuse(f"{quoted(text)} has no unit", f"write it like '{stripped} {self.shown}'")
        try:
            return quantity(stripped, self.unit)
        except UnitError:
            pass
        except ArithmeticError:  # a product of units beyond the floats
            refuse(f"{quoted(text)} is not a finite number", f"write it like {self.example}")
        try:
            value = quantity(stripped, self.shown) * factor(self.shown)  # the same complaint, about the unit shown
        except UnitError as error:
            message = str(error).removesuffix(f"; {error.remedy}") if error.remedy else str(error)
            refuse(message, error.remedy)
        return value

    def _holds(self, number: float) -> bool:
        scale = factor(self.shown) if self.unit != "1" else 1.0
        lower, upper = self.lower * scale, self.upper * scale
        above = number > lower if self.open_lower else number >= lower
        return above and (number < upper if self.open_upper else number <= upper)


@dataclass(frozen=True)
class Whole:
    """Marks an integer within a range."""

    lower: int
    upper: int

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> core_schema.CoreSchema:
        return core_schema.no_info_before_validator_function(self.read, handler(source))

    def read(self, value: Any) -> int:
        """The number, checked."""
        if isinstance(value, str):
            if not _WHOLE.fullmatch(value.strip()):
                refuse(f"{quoted(value)} is not a whole number", f"choose one from {self.lower} to {self.upper}")
            value = int(value)
        if not isinstance(value, int) or isinstance(value, bool) or not self.lower <= value <= self.upper:
            refuse(f"{quoted(value)} is outside {self.lower} to {self.upper}", "choose a whole number inside")
        return value


def _read_flag(value: Any) -> Any:
    if isinstance(value, bool):
        return value
    if isinstance(value, str) and value in ("true", "false"):
        return value == "true"
    refuse(f"{quoted(value)} is neither true nor false", "write true or false")


@dataclass(frozen=True)
class Choice:
    """Marks one of a few words."""

    words: tuple[str, ...]

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> core_schema.CoreSchema:
        return core_schema.no_info_before_validator_function(self.read, handler(source))

    def read(self, value: Any) -> str:
        """The word, checked."""
        if value not in self.words:
            refuse(f"{quoted(value)} is none of {', '.join(self.words)}", suggest(str(value), self.words))
        return value


@dataclass(frozen=True)
class Entry:
    """Marks the name of a catalog entry of a kind."""

    kind: str

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> core_schema.CoreSchema:
        return core_schema.no_info_before_validator_function(self.read, handler(source))

    def read(self, value: Any, others: Sequence[str] = ()) -> str:
        """The name, if the catalog has it or it is one of the others."""
        from mckibben import catalog

        known = [*catalog.names(self.kind), *others]
        if value not in known:
            what = {"geometries": "geometry"}.get(self.kind, self.kind.removesuffix("s"))
            refuse(f"the catalog has no {what} {quoted(value)}", suggest(str(value), known))
        return value


def read_path(value: Any, info: ValidationInfo, ending: str) -> Path:
    """The absolute path of a file that exists; text is relative to the scenario's folder."""
    folder = (info.context or {}).get("folder") or Path()
    if not isinstance(value, str | Path) or not str(value):
        refuse(f"{quoted(value)} is not a path", f"name a file, such as 'some{ending}'")
    path = Path(os.path.abspath(folder / value))  # noqa: PTH100 (resolve() would follow links)
    try:
        found = path.is_file()
    except (OSError, ValueError):
        found = False
    if not found:
        where = folder.absolute()
        refuse(f"there is no file {quoted(str(value))}", f"paths are relative to the scenario, here {where}")
    return path


def write_path(path: Path, info: SerializationInfo) -> str:
    """A path relative to the scenario's folder where it lies below it, else absolute."""
    folder = (info.context or {}).get("folder") or Path()
    folder = Path(os.path.abspath(folder))  # noqa: PTH100
    return (path.relative_to(folder) if path.is_relative_to(folder) else path).as_posix()


def _read_table(value: Any, info: ValidationInfo) -> Path:
    return read_path(value, info, ".csv")


def _read_law(value: Any, info: ValidationInfo) -> Any:
    if str(value).endswith((".yaml", ".yml")):
        return read_path(value, info, ".yaml")
    return Entry("laws").read(value, others=("chou",))


def _write_law(value: str | Path, info: SerializationInfo) -> str:
    return write_path(value, info) if isinstance(value, Path) else value


def _read_title(value: Any) -> Any:
    if not isinstance(value, str) or not value.strip():
        refuse(f"{quoted(value)} is not a name", "name the scenario in a few words")
    if len(value.strip()) > 200 or not value.strip().isprintable():
        refuse(f"{quoted(value)} is not one line of at most 200 characters", "shorten it")
    return value.strip()


Title = Annotated[str, BeforeValidator(_read_title)]
Flag = Annotated[bool, BeforeValidator(_read_flag)]
Law = Annotated[str | Path, BeforeValidator(_read_law), PlainSerializer(_write_law, when_used="json")]
TablePath = Annotated[Path, BeforeValidator(_read_table), PlainSerializer(write_path, when_used="json")]

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
Angle = Annotated[float, Quantity("rad", "deg", -360, 360)]
Stiffness = Annotated[float, Quantity("N*m/rad", "N*m/rad", -1e6, 1e6)]
Phase = Annotated[float, Quantity("rad", "deg", -1e4, 1e4)]
AngleScale = Annotated[float, Quantity("rad", "deg", 0, 1e6, open_lower=True)]
StiffnessScale = Annotated[float, Quantity("N*m/rad", "N*m/rad", 0, 1e6, open_lower=True)]
PressureRate = Annotated[float, Quantity("Pa/s", "bar/s", 0, 1e6, open_lower=True)]
Rate = Annotated[float, Quantity("1/s", "1/s", 0, 1e6)]
Momentum = Annotated[float, Quantity("1", "1", 0, 1, open_upper=True)]
Ratio = Annotated[float, Quantity("1", "1", 1, 1e6, open_lower=True)]

AngleGain = Annotated[float, Quantity("Pa/rad", "bar/rad", -1e6, 1e6)]
AngleIntegralGain = Annotated[float, Quantity("Pa/(rad*s)", "bar/(rad*s)", -1e6, 1e6)]
AngleDerivativeGain = Annotated[float, Quantity("Pa*s/rad", "bar*s/rad", -1e6, 1e6)]
StiffnessGain = Annotated[float, Quantity("Pa/(N*m/rad)", "bar/(N*m/rad)", -1e6, 1e6)]
StiffnessIntegralGain = Annotated[float, Quantity("Pa/(N*m*s/rad)", "bar/(N*m*s/rad)", -1e6, 1e6)]
StiffnessDerivativeGain = Annotated[float, Quantity("Pa*s/(N*m/rad)", "bar*s/(N*m/rad)", -1e6, 1e6)]
