"""The columns of a CSV file: a quantity and, after an underscore, its unit."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import NamedTuple

from mckibben import units

_PRESSURE = ("bar", "kPa", "MPa", "Pa", "mbar", "psi")

ACCEPTED: Mapping[str, tuple[str, ...]] = {
    "pressure": _PRESSURE,
    "contraction": ("percent", "ratio"),
    "length": ("mm", "m", "cm"),
    "force": ("N", "kN"),
    "direction": (),
    "repeat": (),
    "time": ("s", "ms"),
    "set_pressure": _PRESSURE,
}

_HEADER = re.compile(rf"({'|'.join(ACCEPTED)})(?:_(.+))?", re.IGNORECASE | re.ASCII)


class Column(NamedTuple):
    """What a header says: a key of `ACCEPTED`, and its unit; `direction` and `repeat` have none."""

    quantity: str
    unit: str


def names(quantity: str) -> str:
    """The accepted headers of a quantity, as text.

    >>> names("contraction")
    'contraction_percent or contraction_ratio'
    """
    spelled = [f"{quantity}_{unit}" for unit in ACCEPTED[quantity]] or [quantity]
    return " or ".join(filter(None, [", ".join(spelled[:-1]), spelled[-1]]))


def recognise(header: str) -> Column | None:
    """What a header says, or None where it is not one of ours.

    The case of letters is free, except that of a leading m in a unit: MPa is not mPa, mbar is not Mbar.

    >>> recognise("Pressure_KPA")
    Column(quantity='pressure', unit='kPa')
    >>> recognise("pressure_mPa") is None
    True
    """
    if not (match := _HEADER.fullmatch(header.strip())):
        return None
    quantity, spelled = match[1].lower(), match[2] or ""
    for unit in ACCEPTED[quantity] or ("",):
        if spelled == unit or (spelled.lower() == unit.lower() and unit[0] not in "mM"):
            return Column(quantity, unit)
    return None


def foreign_unit(header: str) -> str:
    """Why a header names a quantity of ours in a unit that it cannot have; empty where it does not.

    >>> foreign_unit("pressure_mPa")
    "'mPa' is not a unit of pressure here"
    >>> foreign_unit("pressure_sensor"), foreign_unit("pressure_bar")
    ('', '')
    """
    match = _HEADER.fullmatch(header.strip())
    known = {unit.lower() for unit in units.UNITS}
    if not match or not match[2] or match[2].lower() not in known or recognise(header):
        return ""
    return f"{match[2]!r} is not a unit of {match[1].lower()} here"
