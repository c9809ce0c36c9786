"""Base model and quantities of configuration files."""

from __future__ import annotations

import difflib
import functools
import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NoReturn

from pydantic import BaseModel, ConfigDict, GetCoreSchemaHandler
from pydantic_core import PydanticCustomError, core_schema

from mckibben.errors import UnitError
from mckibben.units import factor, quantity, show

LONGEST_VALUE = 80
"""Characters of a value that are shown, and that a quantity may have."""


class Part(BaseModel):
    """A part of a scenario: frozen, without unknown keys."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)


def given_fields(part: Part | None, *without: str) -> dict[str, Any]:
    """The fields that were given, by name; what was not takes the default of the class that is built."""
    if part is None:
        return {}
    return {
        name: getattr(part, name)
        for name in type(part).model_fields
        if name not in without and getattr(part, name) is not None
    }


def refuse(message: str, remedy: str = "", *, parent: bool = False) -> NoReturn:
    """Say in a validator what is wrong; with `parent` it is said of the part that the field belongs to."""
    context = {"message": message, "remedy": remedy, "parent": parent}
    raise PydanticCustomError("mckibben", "{message}; {remedy}" if remedy else "{message}", context)


def quoted(value: object) -> str:
    """A value as an error shows it, on one line and not too long."""
    text = repr(value)
    return text if len(text) <= LONGEST_VALUE else f"{text[: LONGEST_VALUE - 4]}...{text[-1]}"


def suggest(name: str, known: Sequence[str]) -> str:
    """A remedy for an unknown name.

    >>> suggest("sin", ["step", "sine"])
    "did you mean 'sine'?"
    """
    close = difflib.get_close_matches(name[:LONGEST_VALUE], known, 1, cutoff=0.6)
    return f"did you mean {close[0]!r}?" if close else f"known are {', '.join(known)}"


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
        if len(stripped) > LONGEST_VALUE:  # the unit parser is for units, not for attacks
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
