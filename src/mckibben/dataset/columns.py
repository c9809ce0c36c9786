"""The columns of a CSV file: a quantity and, after an underscore, its unit."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

from mckibben import units
from mckibben.errors import Problem

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


@dataclass
class Layout:
    """Where the columns of a file are.

    Attributes
    ----------
    places
        Index and meaning of each column of ours, by quantity.
    ignored
        The other headers.
    problems
        What is wrong with the header.
    """

    places: dict[str, tuple[int, Column]] = field(default_factory=dict)
    ignored: list[str] = field(default_factory=list)
    problems: list[Problem] = field(default_factory=list)


def lay_out(header: Sequence[str], line: int, mapping: Mapping[str, str]) -> Layout:
    """Find the columns of ours in a header.

    Parameters
    ----------
    header, line
        The names in the file, and the number of their line.
    mapping
        From names in the file to names of ours.

    Examples
    --------
    >>> layout = lay_out(["p [bar]", "contraction_percent", "note"], 1, {"p [bar]": "pressure_bar"})
    >>> layout.places["pressure"], layout.ignored
    ((0, Column(quantity='pressure', unit='bar')), ['note'])
    >>> print(*layout.problems)
    line 1: no column for force; the file has 'p [bar]', 'contraction_percent', 'note'; name it force_N ...
    """
    layout = Layout()
    shown = ", ".join(map(repr, header))

    def problem(message: str, field: str = "", remedy: str = "") -> None:
        layout.problems.append(Problem(message, line=line, field=field, remedy=remedy))

    for given, name in mapping.items():
        if given not in header:
            problem(f"columns has {given!r}, the file {shown}")
        if recognise(name) is None:
            problem(f"columns gives {given!r} the unknown name {name!r}", remedy=f"accepted are {_accepted()}")
    for index, text in enumerate(header):
        column = recognise(mapping.get(text, text))
        if text and text in header[:index]:
            problem("stands twice in the header", text)
        elif column is None:
            if reason := foreign_unit(text):
                problem(reason, text, f"accepted are {_accepted(text)}")
            layout.ignored += [text] if text else []
        elif column.quantity in layout.places:
            first = header[layout.places[column.quantity][0]]
            problem(f"gives {column.quantity} again, after {first!r}", text, "keep one of them")
        else:
            layout.places[column.quantity] = index, column
    for name in ("pressure", "contraction", "force"):
        if name not in layout.places and not (name == "contraction" and "length" in layout.places):
            wanted = names(name) + (f" (or {names('length')})" if name == "contraction" else "")
            remedy = f"name it {wanted}, or tell by columns={{...}} which it is"
            problem(f"no column for {name}; the file has {shown}", remedy=remedy)
    return layout


def _accepted(header: str = "") -> str:
    quantities = [name for name in ACCEPTED if header.lower().startswith(name)] or list(ACCEPTED)
    return ", ".join(names(name) for name in quantities)
