"""Names of columns: their quantity and unit."""

from __future__ import annotations

import itertools
import re
import unicodedata
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from mckibben import units
from mckibben.dataset.sheet import RawColumn

_PRESSURE = ("bar", "kPa", "MPa", "Pa", "mbar", "psi", "kgf/cm^2")

ACCEPTED: Mapping[str, tuple[str, ...]] = {
    "pressure": _PRESSURE,
    "contraction": ("percent", "ratio", "permille"),
    "length": ("mm", "m", "cm", "in", "um"),
    "displacement": ("mm", "m", "cm", "in", "um"),
    "force": ("N", "kN", "daN", "cN", "kgf", "lbf"),
    "direction": (),
    "repeat": (),
    "time": ("s", "ms", "min"),
    "set_pressure": _PRESSURE,
    "phase": (),
}

# Other names, accepted only with a unit, also in other European and Asian languages. A strain, whose sign and
# base are ambiguous, is excluded; sign and zero of a displacement are given when it is read. Letters are
# case-sensitive: f is a frequency and T a temperature.
_NAMES: Mapping[str, str] = {
    name: quantity
    for quantity, others in (
        ("pressure", ("p", "P", "gauge pressure", "muscle pressure", "measured pressure", "pressure actual")),
        ("force", ("F", "tension", "axial force", "muscle force", "measured force", "standard force", "pull", "load")),
        ("contraction", ("relative contraction", "contraction ratio", "shortening", "epsilon", "eps", "ε")),
        ("length", ("muscle length",)),
        ("time", ("t", "elapsed time")),
        ("set_pressure", ("set pressure", "pressure setpoint", "pressure set", "nominal pressure", "p_set")),
        (
            "pressure",
            (
                "druck",
                "überdruck",
                "druk",
                "tryck",
                "ciśnienie",
                "druck ist",
                "istdruck",
                "pression",
                "pression relative",
                "pressione",
                "presión",
                "presion",
                "pressão",
                "压力",
                "压强",
                "圧力",
            ),
        ),
        ("force", ("kracht", "siła", "引張力", "усилие", "сила", "힘", "하중", "kuvvet", "síla")),
        ("pressure", ("давление", "избыточное давление", "압력", "basınç", "tlak", "trykk", "paine")),
        (
            "contraction",
            ("сокращение", "укорочение", "относительное сокращение", "수축률", "kontraksjon", "zkrácení", "kısalma"),
        ),
        ("length", ("длина", "길이")),
        ("displacement", ("перемещение", "변위")),
        ("time", ("время", "시간")),
        ("force", ("kraft", "zugkraft", "standardkraft", "forza", "fuerza", "força", "effort", "力", "拉力", "張力")),
        (
            "contraction",
            (
                "kontraktion",
                "contractie",
                "raccourcissement",
                "skrócenie",
                "verkürzung",
                "verkuerzung",
                "kürzung",
                "contrazione",
                "contracción",
                "contração",
                "收缩率",
                "収縮率",
            ),
        ),
        (
            "displacement",
            ("stroke", "travel", "weg", "hub", "verschiebung", "déplacement", "course", "spostamento", "corsa"),
        ),
        ("displacement", ("desplazamiento", "deslocamento", "位移", "変位")),
        (
            "length",
            ("länge", "laenge", "muskellänge", "longueur", "lunghezza", "longitud", "comprimento", "长度", "長さ"),
        ),
        ("time", ("zeit", "temps", "tempo", "tiempo", "时间", "時間")),
        ("set_pressure", ("solldruck", "druck soll", "pression de consigne")),
    )
    for name in others
}
_SYMBOLS = frozenset(name for name in _NAMES if len(name) == 1)

_SPELLED: Mapping[str, str] = {
    "%": "percent",
    **dict.fromkeys(("-", "1", "mm/mm", "m/m"), "ratio"),
    **dict.fromkeys(("kgf/cm2", "kg/cm2", "kg/cm^2"), "kgf/cm^2"),
    **{"бар": "bar", "кпа": "kPa", "МПа": "MPa", "па": "Pa", "н": "N", "кн": "kN", "мм": "mm", "с": "s", "мс": "ms"},
    **dict.fromkeys(("sec", "second", "seconds"), "s"),
    "milliseconds": "ms",
    **dict.fromkeys(("‰", "mm/m"), "permille"),
    **dict.fromkeys(("μm", "micron", "microns"), "um"),
    "pct": "percent",
    "hpa": "mbar",
    **dict.fromkeys(("kp", "kg"), "kgf"),
    **dict.fromkeys(("lb", "lbs"), "lbf"),
    "at": "kgf/cm^2",
    **dict.fromkeys(("n/mm2", "n/mm^2"), "MPa"),
    **dict.fromkeys(("n/m2", "n/m^2"), "Pa"),
    **dict.fromkeys(("kilopascal", "kilopascals"), "kPa"),
    "minutes": "min",
    **dict.fromkeys(("newton", "newtons"), "N"),
    **dict.fromkeys(("inch", "inches", "in.", '"'), "in"),
    "pascal": "Pa",
    **dict.fromkeys(("millimeters", "millimetres"), "mm"),
}

_CLASSIC = re.compile(rf"({'|'.join(ACCEPTED)})(?:[_ ](.+))?", re.IGNORECASE | re.ASCII)
_WITH_UNIT = re.compile(
    r"(?P<name>.+?)\s*(?:\((?P<a>.+)\)|[\[{<](?P<b>.+)[\]}>]|(?:[/,:]|\s[-–]\s)\s*(?P<c>[^\s/,:]+)|\sin\s+(?P<d>\S+))"
)
_CHANNEL = re.compile(
    r"(?:ch|chan|channel|ai|kanal|sensor|signal) ?[0-9]+(?: ?[:._-] ?| )(?=\D)|[ _]?[1-9]$|(?<=\w)[*†‡]+$",
    re.IGNORECASE,
)
_UNIT_COLUMN = re.compile(r"(?<![a-z])(?:units?|einheit|unité|unidad|unità)(?![a-z])", re.IGNORECASE)
_NUMBER_AND_UNIT = re.compile(r"([+\-\u2212]?[0-9.,'’\s]+?(?:[eE][+-]?[0-9]+)?)\s*([A-Za-z%]+)")
_GAUGE = re.compile(r"(.*?)(?:\s*\((?:g|gauge|rel)\)| ?gauge| rel| g|(?<=bar|psi)g)", re.IGNORECASE)
_ABSOLUTE = re.compile(r"(.*?)(?:\s*\((?:a|abs|absolute)\)|[ _]?abs(?:olute)?| a|(?<=bar|psi)a)", re.IGNORECASE)
_SUFFIX = re.compile(r":[0-9]+$|(?<=[\])])\s*(?:ave|avg|mean)\.?$", re.IGNORECASE)  # Simulink's port, PicoLog's average
_AVERAGE = re.compile(r"(?:mean|average|avg) (?=.)|(?<=.) (?:mean|average|avg|ave|last)", re.IGNORECASE)
_SCANNED = re.compile(r"[0-9]+ <([^<>]+)>")  # channel and name of a Keysight scanner: 101 <Force> (N)
OTHER_PLACE = re.compile(r"set|soll|target|ref|demand|command|desired|goal|supply|tank|reservoir", re.IGNORECASE)
"""Words of a pressure that is not measured in the muscle."""
ABSOLUTE = re.compile(r"(?<![a-z])abs(?![a-z])|absolut", re.IGNORECASE)
"""Words of names and comments that may mean an absolute pressure."""
_MANY = 10_000  # cells, beyond which those in other units than the first are not read
LONGEST_NAME = 200
"""Characters of a name; matching takes quadratic time."""
_UNITS = frozenset(name.lower() for name in units.UNITS)
_FOREIGN = frozenset(
    "at atm torr mmhg mh2o v mv g kg cn dn mn hpa mbar lb volts ma counts count lsb digit digits raw ohm deg".split()
)
"""Units, in small letters, that contradict any other, in addition to those of `units`."""


class Header(NamedTuple):
    """Meaning of a header: a key of `ACCEPTED`, and its unit; `direction`, `repeat` and `phase` have no unit.

    `shortening` is true for a displacement named contraction, which is positive for a shorter muscle.
    """

    quantity: str
    unit: str
    shortening: bool = False


def names(quantity: str) -> str:
    """Accepted headers of a quantity, as text.

    >>> names("contraction")
    'contraction_percent, contraction_ratio or contraction_permille'
    """
    spelled = [f"{quantity}_{unit}" for unit in ACCEPTED[quantity]] or [quantity]
    return " or ".join(filter(None, [", ".join(spelled[:-1]), spelled[-1]]))


def parse_header(header: str, unit: str = "", *, loose: bool = False) -> Header | None:
    """Quantity and unit of a header, None if unknown; only a leading m is case-sensitive: MPa is not mPa.

    With `loose`, a name may have a channel before it, or a number or a mark of a footnote behind it: CH1 Force (N).
    """
    for quantity, spelled in _readings(header, unit, loose=loose):
        for known in ACCEPTED[quantity] or ("",):
            if same_unit(spelled, known, quantity):
                return Header(quantity, known)
        for known in ACCEPTED["displacement"] if quantity == "contraction" else ():
            if same_unit(spelled, known, "displacement"):
                return Header("displacement", known, shortening=True)
    return None


def unit_error(header: str, unit: str = "") -> str:
    """Error of a header that names a quantity with a wrong unit; empty if there is none."""
    if parse_header(header, unit):
        return ""
    for quantity, spelled in _readings(header, unit):
        if quantity.endswith("pressure") and is_absolute(spelled):
            return f"{spelled!r} is absolute; a gauge pressure is needed"
        if spelled.lower() in _UNITS and name_and_unit(header)[0] not in _SYMBOLS:
            return f"{spelled!r} is not a unit of {quantity} here"
    return ""


def is_absolute(unit: str) -> bool:
    """True for a unit of absolute pressure, such as psia or "bar abs"."""
    absolute = _ABSOLUTE.fullmatch(unit)
    return absolute is not None and absolute[1].lower() in _UNITS


def is_unit(text: str) -> bool:
    """True if a cell is a unit, as in a row of units under the header."""
    bare = bare_unit(text)
    known = {unit for accepted in ACCEPTED.values() for unit in accepted}
    return bare != "1" and bare != "" and any(same_unit(bare, unit, "pressure") for unit in known)


def without_units(column: RawColumn, mapped: str = "") -> RawColumn:
    """A column whose cells state their unit (3.5 bar), with numbers alone in its cells and its unit.

    Cells in other units than the column, by its name or the header that it is given, have a factor.
    """
    if isinstance(column.cells, np.ndarray):
        return column
    filled = (_NUMBER_AND_UNIT.fullmatch(text[:LONGEST_NAME]) for text in map(str.strip, column.cells) if text)
    first = next(filled, None)
    if first is None or not is_unit(first[2]) or any(one is None or one[2] != first[2] for one in filled):
        return _with_factors(column, mapped) if len(column.cells) <= _MANY else column
    if column.unit and not same_unit(bare_unit(column.unit), first[2], "pressure"):
        return column
    ends = [cell.strip().removesuffix(first[2]).rstrip() for cell in column.cells]
    return replace(column, cells=ends, unit=first[2])


def _with_factors(column: RawColumn, mapped: str) -> RawColumn:
    """A column with several units in its cells, with numbers alone and factors to the unit of the column.

    Cells without a unit have that of the column. At least one cell has to agree with its name.
    """
    texts = [cell.strip()[:LONGEST_NAME] for cell in map(str, column.cells)]
    found = [_NUMBER_AND_UNIT.fullmatch(text) for text in texts]
    spelled = list(dict.fromkeys(one[2] for one in found if one))
    bare = any(text and one is None for text, one in zip(texts, found, strict=True))
    header, inside = parse_header(mapped), name_and_unit(column.label[:LONGEST_NAME])[1]
    given = header.unit if header else bare_unit(column.unit) or inside or ""
    if not spelled or not all(map(is_unit, spelled)) or (bare and not given):
        return column
    several = [given or spelled[0], *spelled]
    for quantity, accepted in ACCEPTED.items():
        known = [next((unit for unit in accepted if same_unit(one, unit, quantity)), "") for one in several]
        if all(known) and (bare or known[0] in known[1:]):
            factors = {one: units.factor(unit, known[0]) for one, unit in zip(several, known, strict=True)}
            scale = np.array([factors[one[2]] if one else 1.0 for one in found])
            cells = [one[1] if one else cell for cell, one in zip(column.cells, found, strict=True)]
            return replace(column, cells=cells, unit=column.unit or ("" if given else known[0]), scale=scale)
    return column


def with_units_beside(columns: Sequence[RawColumn]) -> tuple[list[RawColumn], list[str]]:
    """Columns with the unit in the column behind, named unit; and warnings of such columns with several units."""
    found, several = [*columns], []
    for at, (one, after) in enumerate(itertools.pairwise(columns)):
        if isinstance(after.cells, np.ndarray) or _UNIT_COLUMN.search(after.label) is None:
            continue
        if len(units := {cell.strip() for cell in {*after.cells}} - {""}) == 1 and is_unit(*units) and not one.unit:
            found[at] = replace(one, unit=next(iter(units)))
        elif len(units) > 1 and all(map(is_unit, units)):
            several.append(f"{after.name!r} is not read, and has several units: {', '.join(sorted(units))}")
    return found, several


def _readings(header: str, unit: str, *, loose: bool = False) -> list[tuple[str, str]]:
    """Candidate readings of a header: pairs of quantity and unit as spelled."""
    if len(header) > LONGEST_NAME:
        return []
    text = unicodedata.normalize("NFKC", " ".join(header.split()).rstrip("_"))  # MATLAB writes Pressure_bar_
    found: list[tuple[str, str]] = []
    text = _SCANNED.sub(r"\1", _SUFFIX.sub("", text))
    path, _, last = text.rpartition("/")
    if (path.count("/") or _CLASSIC.fullmatch(last)) and not OTHER_PLACE.search(path):  # rig/pressure_bar
        text = last.strip()
    if match := _CLASSIC.fullmatch(text):
        quantity = match[1].lower()
        found.append((quantity, match[2] or (bare_unit(unit) if ACCEPTED[quantity] else "")))
    name, inside = name_and_unit(text)
    spelled = bare_unit(unit) if inside is None else inside
    if inside is None and not spelled and is_unit(text.rpartition("_")[2]):  # F_N
        name, _, spelled = text.rpartition("_")
    if (quantity := named_quantity(_CHANNEL.sub("", name) if loose else name)) and spelled:
        found.append((quantity, spelled))
    return found


def named_quantity(name: str) -> str:
    """Quantity of a name without a unit; empty if there is none."""
    name = _AVERAGE.sub("", name)
    key = name.lower().replace(" ", "_")
    return key if key in ACCEPTED else _NAMES.get(name) or _NAMES.get(name.lower() if len(name) > 1 else "", "")


def name_and_unit(header: str) -> tuple[str, str | None]:
    """Name and unit of a header such as "Force (N)"; the unit is None if there is none."""
    match = _WITH_UNIT.fullmatch(header)
    return (match["name"].strip(), bare_unit(next(filter(None, match.group(*"abcd"))))) if match else (header, None)


def bare_unit(unit: str) -> str:
    """Unit without brackets."""
    text = unicodedata.normalize("NFKC", unit).strip()
    for left, right in ("()", "[]"):
        if text.startswith(left) and text.endswith(right):
            text = text[1:-1].strip()
    return text


def same_unit(spelled: str, known: str, quantity: str) -> bool:
    """True if a unit of a quantity, as spelled in a file, is the known one; of pressures also with the word gauge."""
    if not known:
        return not spelled
    text = _SPELLED.get(spelled) or _SPELLED.get(spelled.lower(), spelled)
    if quantity.endswith("pressure") and (gauge := _GAUGE.fullmatch(text)):
        text = gauge[1]
    return text.lower() == known.lower() and (known[0] not in "mM" or text[0] == known[0])


def is_contradiction(text: str) -> bool:
    """True for a text with a unit in it, such as "10 N" or kgf/cm2."""
    words = re.split(r"[^a-z%]+", text.lower())
    return is_unit(text) or is_absolute(text) or not (_UNITS | _FOREIGN).isdisjoint(words)
