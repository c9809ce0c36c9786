"""A float in SI that is a number and a unit in text, and comes back from it to the last bit.

A Python number passes too, as SI: the parts of a scenario can be made in code.
"""

from __future__ import annotations

import functools
import re
from dataclasses import dataclass
from typing import Any

from pydantic import GetCoreSchemaHandler
from pydantic_core import core_schema

from mckibben.errors import UnitError
from mckibben.study.scenario.part import LONGEST, quoted, refuse
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
            refuse(f"{quoted(value)} is not a quantity", f"write it like {self.example}")
        if not self.holds(number):
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
            refuse("has no value", f"write it like {self.example}, or leave the key out")
        if len(stripped) > LONGEST:  # the unit parser is for units, not for attacks
            refuse(f"{quoted(text)} is not a quantity", f"write it like {self.example}")
        if self.unit != "1" and _NUMBER.fullmatch(stripped):
            refuse(f"{quoted(text)} has no unit", f"write it like '{stripped} {self.shown}'")
        try:
            return quantity(stripped, self.unit)
        except UnitError:
            pass
        except ArithmeticError:  # a product of units beyond the floats
            refuse(f"{quoted(text)} is not a finite number", f"write it like {self.example}")
        try:  # the same complaint, but about the unit shown
            return quantity(stripped, self.shown) * factor(self.shown, self.unit)
        except UnitError as error:
            message = str(error).removesuffix(f"; {error.remedy}") if error.remedy else str(error)
            refuse(message, error.remedy)
