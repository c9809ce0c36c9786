"""Checks of numbers at the construction of an object; traced numbers pass."""

from __future__ import annotations

from contextlib import suppress
from numbers import Real
from types import NoneType
from typing import Any, get_args

import numpy as np
from numpy.typing import NDArray

from mckibben.errors import RangeError, UnitError, described, quoted, with_article
from mckibben.units import SYMBOLS, Quantity, dimensions, factor, number_and_unit


def check_positive(owner: str, unit: str = "", *, zero: bool = False, **values: object) -> None:
    """Check that numbers, or arrays of any shape, are finite and above 0 (or 0, where `zero` is allowed).

    Raises `RangeError` with the first other value, in the `unit` of the values; traced values pass.

        >>> check_positive("Joint", "m", radius=-0.02)
        Traceback (most recent call last):
            ...
        mckibben.errors.RangeError: Joint: radius is -0.02 m; give a finite number above 0
    """
    remedy = f"give a finite number {'0 or above' if zero else 'above 0'}"
    for name, value in values.items():
        numbers = known_numbers(owner, name, value, unit)
        right = np.isfinite(numbers) & ((numbers > 0) | (zero & (numbers == 0)))
        _refuse(owner, name, numbers[~right], f" {unit}".rstrip(), lower=0.0, unit=unit, remedy=remedy)


def whole_periods(duration: float, period: float) -> int | None:
    """Number of periods [s] in a duration [s]; None if it is not a multiple (to 1e-9).

    >>> whole_periods(0.3, 0.1), whole_periods(0.35, 0.1)
    (3, None)
    """
    count = round(duration / period)
    return count if count >= 1 and abs(count * period - duration) <= 1e-9 * duration else None


def check_within(owner: str, lower: float, upper: float, unit: str = "", *, remedy: str = "", **values: object) -> None:
    """Check that numbers, or arrays of any shape, lie in a closed range.

    `lower` and `upper` have the `unit` of the values. Raises `RangeError` with the first value outside, the limits and
    the remedy; traced values pass.

        >>> check_within("Joint", 0, 1, "m", radius=0.02)
        >>> check_within("Joint", 0, 1, "m", radius=2.0)
        Traceback (most recent call last):
            ...
        mckibben.errors.RangeError: Joint: radius is 2, outside 0..1 m
    """
    limits = f", outside {lower:g}..{upper:g} {unit}".rstrip()
    for name, value in values.items():
        numbers = known_numbers(owner, name, value, unit)
        wrong = numbers[~((numbers >= lower) & (numbers <= upper))]
        _refuse(owner, name, wrong, limits, lower=lower, upper=upper, unit=unit, remedy=remedy)


def _refuse(owner: str, name: str, wrong: NDArray[np.float64], text: str, **details: Any) -> None:
    """Raise `RangeError` with the first of the wrong values of a field, if there is one."""
    if wrong.size:
        raise RangeError(f"{owner}: {name} is {wrong[0]:g}{text}", field=name, value=float(wrong[0]), **details)


def check_count(field: str, given: int, count: int, each: str) -> None:
    """Raise `RangeError` unless a field has one value for each of a number of things, named in words.

    >>> check_count("springs", 1, 2, "muscle")
    Traceback (most recent call last):
        ...
    mckibben.errors.RangeError: 1 springs for 2; give one for each muscle
    """
    if given != count:
        raise RangeError(f"{given} {field} for {count}", field=field, value=given, remedy=f"give one for each {each}")


def check_kind(owner: str, name: str, value: object, kind: Any) -> None:
    """Check that a field is of its type, a class or a union: arguments are easily swapped.

    Raises `RangeError`; its remedy names a method or attribute of the value that has the type, if there is one.
    """
    if not isinstance(value, kind):
        kinds = [option.__name__ for option in get_args(kind) or (kind,) if option is not NoneType]
        hint, method = "" if isinstance(value, str) else "; are arguments swapped?", kinds[0].lower()
        if callable(getattr(type(value), method, None)):
            hint = f": {type(value).__name__}.{method}() returns one"
        elif meant := getattr(type(value), "suggestions", {}).get(method):
            hint = f": {meant}"
        remedy = f"give {with_article(' or '.join(kinds))}{hint}"
        raise RangeError(f"{owner}: {name} is {described(value)}", field=name, value=value, remedy=remedy)


def as_number(value: object, unit: str = "") -> str:
    """Remedy for a value in place of a number in a unit: the number that a text such as '250 mm' means, or another.

    >>> as_number("250 mm", "m")
    'give a number in SI units, such as 0.25 or 250 * mm with mckibben.units'
    """
    example = f"3 * {unit}" if unit not in ("", "1") else ""
    number, written = number_and_unit(value) if isinstance(value, str) else ("", "")
    if written:
        with suppress(UnitError):
            if dimensions(written) == dimensions(unit or written):
                example = f"{float(number) * factor(written):g} or {number} * {written}"
    example = example.replace("^", "**").replace("%", "percent")
    remedy = "give a number" if unit == "1" else "give a number in SI units"
    return f"{remedy}, such as {example} with mckibben.units" if example else remedy


def in_si(owner: str, name: str, value: object, mark: object) -> object:
    """Return a text with a unit as a number in SI, also within a list; other values as they are.

    `mark` is the `Quantity` of the field or argument `name`; without one, a text stays a text. Where its unit is
    symbolic, that of the text counts: a sine may be of an angle or of a pressure. Raises `UnitError` and `RangeError`,
    as for a file.

        >>> from mckibben.units import Quantity
        >>> in_si("Pulley", "radius", "35 mm", Quantity("m", "mm")), in_si("PID", "kp", "2 bar/rad", Quantity("gain"))
        (0.035, 200000.0)
    """
    if not isinstance(mark, Quantity):
        return value
    if isinstance(value, list | tuple) and any(isinstance(item, str) for item in value):
        return tuple(in_si(owner, name, item, mark) for item in value)
    if not isinstance(value, str):
        return value
    number, written = number_and_unit(value)
    if mark.unit in SYMBOLS and not written:
        return value
    try:
        return float(number) * factor(written) if mark.unit in SYMBOLS else mark.read(value)
    except (UnitError, RangeError) as error:
        error.field, error.message = name, f"{owner}: {name}: {error.message}"
        raise


def known_numbers(owner: str, name: str, value: object, unit: str = "") -> NDArray[np.float64]:
    """Numbers of a value or nested tuple, shape (numbers,); none of None, a tracer or a placeholder.

    Parameters
    ----------
    owner, name
        Class and field, for errors.
    value
        Number, array of any shape, or tuple of these.
    unit
        Unit of the example in the remedy.

    Raises
    ------
    RangeError
        For a text or a flag.
    """
    if isinstance(value, str | bool | np.bool_) or (isinstance(value, np.ndarray) and value.dtype == bool):
        text = quoted(value) if isinstance(value, str) else value
        raise RangeError(f"{owner}: {name} is {text}", field=name, value=value, remedy=as_number(value, unit))
    if isinstance(value, Real | np.ndarray):
        return np.asarray(value, float).ravel()
    if isinstance(value, tuple | list) and all(type(item) is float for item in value):
        return np.asarray(value, float)
    if isinstance(value, tuple | list):
        return np.concatenate([np.empty(0), *(known_numbers(owner, name, item, unit) for item in value)])
    if value is None:
        return np.empty(0)
    import jax  # slow; not needed for plain numbers
    import jax.core

    concrete = isinstance(value, jax.Array) and not isinstance(value, jax.core.Tracer)
    return known_numbers(owner, name, np.asarray(value), unit) if concrete else np.empty(0)
