"""Numbers that make no sense are refused where an object is made from them; traced numbers cannot be looked at."""

from __future__ import annotations

import math

from mckibben.errors import RangeError


def check_positive(owner: str, unit: str = "", *, zero: bool = False, **values: object) -> None:
    """Raise unless every plain number is finite and positive (or zero, where allowed).

    Raises
    ------
    RangeError
        It names the owner, the field and the value.
    """
    for name, value in values.items():
        if not isinstance(value, int | float):
            continue
        if not (math.isfinite(value) and (value > 0 or (zero and value == 0))):
            kind = "0 or above" if zero else "above 0"
            raise RangeError(
                f"{owner}: {name} is {value:g} {unit}".rstrip(),
                value=value,
                lower=0.0,
                unit=unit,
                remedy=f"it has to be finite and {kind}",
            )


def whole_periods(duration: float, period: float) -> int | None:
    """How many periods make a duration; None where it is no whole number of them (to a part in a billion)."""
    count = round(duration / period)
    return count if count >= 1 and abs(count * period - duration) <= 1e-9 * duration else None


def check_within(owner: str, lower: float, upper: float, unit: str = "", **values: object) -> None:
    """Raise unless every plain number lies in a range, the edges included.

    Raises
    ------
    RangeError
        It names the owner, the field, the value and the range.
    """
    for name, value in values.items():
        if isinstance(value, int | float) and not lower <= value <= upper:
            raise RangeError(
                f"{owner}: {name} is {value:g}, outside {lower:g}..{upper:g} {unit}".rstrip(),
                value=value,
                lower=lower,
                upper=upper,
                unit=unit,
            )


def check_kind(owner: str, **fields: tuple[object, type]) -> None:
    """Raise unless each field is of its kind: arguments are easily swapped.

    Raises
    ------
    RangeError
        It names the owner, the field, and what was given.
    """
    for name, (value, kind) in fields.items():
        if isinstance(value, int | float | str):
            given = repr(value)
        elif type(value).__module__.startswith("mckibben"):
            given = f"a {type(value).__name__}"
        else:
            continue  # a placeholder of a transformation
        if not isinstance(value, kind):
            raise RangeError(f"{owner}: {name} is {given}", remedy=f"give a {kind.__name__}; are arguments swapped?")
