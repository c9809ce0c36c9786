"""The kinds of field in a protocol file that scenarios do not have; wide ranges, they catch slips of the unit."""

from __future__ import annotations

import re
from typing import Annotated, Any

from pydantic import BeforeValidator, PlainSerializer, SerializationInfo, ValidationInfo

from mckibben.study.scenario.part import quoted, refuse
from mckibben.study.scenario.quantity import Quantity
from mckibben.study.scenario.words import read_path, write_path
from mckibben.units import quantity, show

_BARE = re.compile(r"[-+]?\d{1,9}(\.\d{0,9})?")
_ADDRESS = re.compile(r"[A-Za-z0-9_.:/-]{1,80}")


class Percent(Quantity):
    """Marks a ratio that is written in percent."""

    def read(self, value: Any) -> float:
        """The ratio, checked; one without a unit is a ratio."""
        if isinstance(value, str) and _BARE.fullmatch(value.strip()) and not self.holds(float(value)):
            refuse(f"{quoted(value)} has no unit, and as a ratio is outside {self.range}", f"write '{value.strip()} %'")
        return super().read(value)

    def write(self, value: float) -> str:
        """Text that `read` takes back to the same float, in percent wherever that is possible."""
        texts = (show(value, "%", digits) for digits in (15, 16, 17))
        return next((text for text in texts if quantity(text, "1") == value), super().write(value))

    @property
    def example(self) -> str:
        """How a value may look."""
        return "'10 %'"

    @property
    def range(self) -> str:
        """The range, in words."""
        return f"{self.lower:g} to {'below ' if self.open_upper else ''}{self.upper:g} %"


Contraction = Annotated[float, Percent("1", "%", -50, 80)]
Share = Annotated[float, Percent("1", "%", 0, 100, open_upper=True)]
Speed = Annotated[float, Quantity("m/s", "mm/s", 0, 1e3, open_lower=True)]
Way = Annotated[float, Quantity("m", "mm", 0, 1e4, open_lower=True)]
Wait = Annotated[float, Quantity("s", "s", 0, 1e6)]
Tension = Annotated[float, Quantity("N", "N", 0, 1e5, open_lower=True)]
SampleRate = Annotated[float, Quantity("1/s", "Hz", 0.001, 1e6)]
Factor = Annotated[float, Quantity("1", "1", 0, 1e6, open_lower=True)]


def _read_address(value: object) -> str:
    if not isinstance(value, str) or not _ADDRESS.fullmatch(value):
        refuse(f"{quoted(value)} is no address", "write it as the driver calls it, such as Dev1, ai0 or port0/line1")
    return value


Address = Annotated[str, BeforeValidator(_read_address)]


def _read(value: object, info: ValidationInfo) -> object:
    return read_path(value, info, ".json")


def _write(value: object, info: SerializationInfo) -> str:
    return write_path(value, info)  # type: ignore[arg-type]


JsonPath = Annotated[object, BeforeValidator(_read), PlainSerializer(_write, when_used="json")]
