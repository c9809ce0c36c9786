"""Field types of scenario files."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from pydantic import BeforeValidator, GetCoreSchemaHandler, PlainSerializer, SerializationInfo, ValidationInfo
from pydantic_core import core_schema

from mckibben.config.fields import Quantity, quoted, refuse, suggest

_WHOLE = re.compile(r"[+-]?[0-9]{1,15}")


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


def read_flag(value: Any) -> bool:
    """True or false."""
    if not isinstance(value, bool) and value not in ("true", "false"):
        refuse(f"{quoted(value)} is neither true nor false", "write true or false")
    return value is True or value == "true"


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


def read_table(value: Any, info: ValidationInfo) -> Path:
    """The path of a CSV file."""
    return read_path(value, info, ".csv")


def read_law(value: Any, info: ValidationInfo) -> str | Path:
    """A law of the catalog, ``chou``, or the path of a fit."""
    if str(value).endswith((".yaml", ".yml")):
        return read_path(value, info, ".yaml")
    return Entry("laws").read(value, others=("chou",))


def write_law(value: str | Path, info: SerializationInfo) -> str:
    """What `read_law` reads."""
    return write_path(value, info) if isinstance(value, Path) else value


def read_title(value: Any) -> str:
    """One line of text."""
    if not isinstance(value, str) or not value.strip():
        refuse(f"{quoted(value)} is not a name", "name the scenario in a few words")
    if len(value.strip()) > 200 or not value.strip().isprintable():
        refuse(f"{quoted(value)} is not one line of at most 200 characters", "shorten it")
    return value.strip()


Title = Annotated[str, BeforeValidator(read_title)]
Flag = Annotated[bool, BeforeValidator(read_flag)]
Law = Annotated[str | Path, BeforeValidator(read_law), PlainSerializer(write_law, when_used="json")]
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
