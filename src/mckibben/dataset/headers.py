"""What a header says: a quantity and its unit."""

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
    "time": ("s", "ms", "min"),
    "set_pressure": _PRESSURE,
    "phase": (),
}

# Other names, read only where a unit of theirs follows. No word of which the sign or the zero is open: a strain may be
# positive when longer, a displacement may begin anywhere. Of letters, those that are capitals alone are so on purpose:
# f is a frequency and T a temperature.
_NAMES: Mapping[str, str] = {
    "p": "pressure",
    "P": "pressure",
    "gauge pressure": "pressure",
    "muscle pressure": "pressure",
    "measured pressure": "pressure",
    "F": "force",
    "tension": "force",
    "axial force": "force",
    "muscle force": "force",
    "measured force": "force",
    "pull": "force",
    "relative contraction": "contraction",
    "contraction ratio": "contraction",
    "epsilon": "contraction",
    "ε": "contraction",
    "muscle length": "length",
    "t": "time",
    "elapsed time": "time",
    "set pressure": "set_pressure",
    "pressure setpoint": "set_pressure",
    "nominal pressure": "set_pressure",
    "p_set": "set_pressure",
}
_SYMBOLS = frozenset(name for name in _NAMES if len(name) == 1)

_SPELLED: Mapping[str, str] = {
    "%": "percent",
    "-": "ratio",
    "1": "ratio",
    "sec": "s",
    "second": "s",
    "seconds": "s",
    "milliseconds": "ms",
    "newton": "N",
    "newtons": "N",
    "pascal": "Pa",
    "minutes": "min",
    "millimeters": "mm",
    "millimetres": "mm",
}

_CLASSIC = re.compile(rf"({'|'.join(ACCEPTED)})(?:[_ ](.+))?", re.IGNORECASE | re.ASCII)
_WITH_UNIT = re.compile(r"(?P<name>.+?)\s*(?:\((?P<a>.+)\)|\[(?P<b>.+)\]|[/,]\s*(?P<c>[^\s/,]+)|\sin\s+(?P<d>\S+))")
_GAUGE = re.compile(r"(.*?)(?:\s*\((?:g|gauge|rel)\)| ?gauge| rel| g|(?<=bar|psi)g)", re.IGNORECASE)
_ABSOLUTE = re.compile(r"(.*?)(?:\s*\((?:a|abs|absolute)\)|[ _]?abs(?:olute)?| a|(?<=bar|psi)a)", re.IGNORECASE)


class Column(NamedTuple):
    """What a header says: a key of `ACCEPTED`, and its unit; `direction`, `repeat` and `phase` have none."""

    quantity: str
    unit: str


def names(quantity: str) -> str:
    """The accepted headers of a quantity, as text.

    >>> names("contraction")
    'contraction_percent or contraction_ratio'
    """
    spelled = [f"{quantity}_{unit}" for unit in ACCEPTED[quantity]] or [quantity]
    return " or ".join(filter(None, [", ".join(spelled[:-1]), spelled[-1]]))


def recognise(header: str, unit: str = "") -> Column | None:
    """What a header says, or None where it is not one of ours.

    The case of letters is free, except that of a leading m in a unit: MPa is not mPa, mbar is not Mbar.

    Parameters
    ----------
    header
        The name of a column.
    unit
        Its unit, where the file has it elsewhere; what the name says goes before.

    Examples
    --------
    >>> recognise("Pressure_KPA"), recognise("p / kPa"), recognise("Force", "N")
    (Column(quantity='pressure', unit='kPa'), Column(quantity='pressure', unit='kPa'),
     Column(quantity='force', unit='N'))
    >>> recognise("pressure_mPa"), recognise("Pressure"), recognise("Pressure (bar abs)"), recognise("T / s")
    (None, None, None, None)
    """
    for quantity, spelled in _readings(header, unit):
        for known in ACCEPTED[quantity] or ("",):
            if _same_unit(spelled, known, quantity):
                return Column(quantity, known)
    return None


def foreign_unit(header: str, unit: str = "") -> str:
    """Why a header names a quantity of ours in a unit that it cannot have; empty where it does not.

    >>> foreign_unit("pressure_mPa"), foreign_unit("Pressure [psia]")
    ("'mPa' is not a unit of pressure here", "'psia' is absolute; a gauge pressure is needed")
    >>> foreign_unit("pressure_sensor"), foreign_unit("pressure_bar"), foreign_unit("p / W")
    ('', '', '')
    """
    if recognise(header, unit):
        return ""
    known = {name.lower() for name in units.UNITS}
    for quantity, spelled in _readings(header, unit):
        absolute = _ABSOLUTE.fullmatch(spelled)
        if quantity.endswith("pressure") and absolute and absolute[1].lower() in known:
            return f"{spelled!r} is absolute; a gauge pressure is needed"
        if spelled.lower() in known and _name(header) not in _SYMBOLS:
            return f"{spelled!r} is not a unit of {quantity} here"
    return ""


def is_unit(text: str) -> bool:
    """Whether a cell is a unit and no number, as in a row of units under the header.

    >>> [is_unit(text) for text in ("[bar]", "%", "N", "-", "1", "loading", "")]
    [True, True, True, True, False, False, False]
    """
    bare = _bare(text)
    known = {unit for accepted in ACCEPTED.values() for unit in accepted}
    return bare != "1" and bare != "" and any(_same_unit(bare, unit, "pressure") for unit in known)


def _readings(header: str, unit: str) -> list[tuple[str, str]]:
    """What a header may say: pairs of a quantity and a unit as it is spelled."""
    text = " ".join(header.split())
    found: list[tuple[str, str]] = []
    if match := _CLASSIC.fullmatch(text):
        quantity = match[1].lower()
        found.append((quantity, match[2] or (_bare(unit) if ACCEPTED[quantity] else "")))
    name, spelled = _name(text), _bare(unit)
    if match := _WITH_UNIT.fullmatch(text):
        spelled = _bare(next(filter(None, (match["a"], match["b"], match["c"], match["d"]))))
    quantity = _NAMES.get(name) or _NAMES.get(name.lower() if len(name) > 1 else "")
    if (plain := name.lower().replace(" ", "_")) in ACCEPTED:
        quantity = plain
    if quantity and spelled:
        found.append((quantity, spelled))
    return found


def _name(header: str) -> str:
    match = _WITH_UNIT.fullmatch(header)
    return match["name"].strip() if match else header


def _bare(unit: str) -> str:
    """A unit without its brackets."""
    text = unit.strip()
    for left, right in ("()", "[]"):
        if text.startswith(left) and text.endswith(right):
            text = text[1:-1].strip()
    return text


def _same_unit(spelled: str, known: str, quantity: str) -> bool:
    if not known:
        return not spelled
    text = _SPELLED.get(spelled.lower(), spelled)
    if quantity.endswith("pressure") and (gauge := _GAUGE.fullmatch(text)):
        text = gauge[1]
    return text == known or (text.lower() == known.lower() and known[0] not in "mM")
