"""Numbers that make no sense are refused where an object is made from them; traced numbers cannot be looked at."""

from __future__ import annotations

from numbers import Real

import numpy as np
from numpy.typing import NDArray

from mckibben.errors import RangeError


def check_positive(owner: str, unit: str = "", *, zero: bool = False, **values: object) -> None:
    """Raise unless every number is finite and positive (or zero, where allowed); of an array, each.

    Raises
    ------
    RangeError
        It names the owner, the field and the value.
    """
    for name, value in values.items():
        numbers = _known(value)
        right = np.isfinite(numbers) & ((numbers > 0) | (zero & (numbers == 0)))
        if not right.all():
            kind = "0 or above" if zero else "above 0"
            wrong = float(numbers[~right][0])
            raise RangeError(
                f"{owner}: {name} is {wrong:g} {unit}".rstrip(),
                value=wrong,
                lower=0.0,
                unit=unit,
                remedy=f"it has to be finite and {kind}",
            )


def whole_periods(duration: float, period: float) -> int | None:
    """How many periods make a duration; None where it is no whole number of them (to a part in a billion)."""
    count = round(duration / period)
    return count if count >= 1 and abs(count * period - duration) <= 1e-9 * duration else None


def check_within(owner: str, lower: float, upper: float, unit: str = "", **values: object) -> None:
    """Raise unless every number lies in a range, the edges included; of an array, each.

    Raises
    ------
    RangeError
        It names the owner, the field, the value and the range.
    """
    for name, value in values.items():
        numbers = _known(value)
        right = (numbers >= lower) & (numbers <= upper)
        if not right.all():
            wrong = float(numbers[~right][0])
            raise RangeError(
                f"{owner}: {name} is {wrong:g}, outside {lower:g}..{upper:g} {unit}".rstrip(),
                value=wrong,
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
        if isinstance(value, Real | str):
            given = repr(value)
        elif type(value).__module__.startswith("mckibben"):
            given = f"a {type(value).__name__}"
        else:
            continue  # a placeholder of a transformation
        if not isinstance(value, kind):
            raise RangeError(f"{owner}: {name} is {given}", remedy=f"give a {kind.__name__}; are arguments swapped?")


def _known(value: object) -> NDArray[np.float64]:
    """The numbers of a value, flat; none where it is traced, or a placeholder of a transformation."""
    if isinstance(value, Real | np.ndarray):
        return np.asarray(value, float).ravel()
    import jax  # those who check plain numbers only need not wait for it
    import jax.core

    concrete = isinstance(value, jax.Array) and not isinstance(value, jax.core.Tracer)
    return np.asarray(value, float).ravel() if concrete else np.empty(0)
