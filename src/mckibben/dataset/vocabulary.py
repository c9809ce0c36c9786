"""Names and units of columns in five languages: one declared table, and the forms in which headers combine them."""

from __future__ import annotations

import functools
import re
import tomllib
import unicodedata
from collections.abc import Mapping, Sequence
from importlib import resources
from typing import NamedTuple

from mckibben.units import factor

UNITS: Mapping[str, str] = {
    "pressure": "bar kPa MPa Pa hPa mbar psi mmHg atm kgf/cm^2",
    "contraction": "percent ratio permille",
    "force": "N kN daN cN mN kgf gf lbf",
    "length": "mm m cm um in",
    "time": "s ms us ns min h",
    "angle": "deg rad mrad",
    "torque": "N*m N*mm N*cm mN*m kN*m kgf*cm kgf*m lbf*in",
}
"""Units in which each quantity is read, the usual one first."""
OF_MUSCLES = ("pressure1", "pressure2"), ("command1", "command2"), ("tension1", "tension2")
"""Quantities of the muscles of a joint: pressures, their commands, and forces."""


class _Quantities(dict[str, tuple[str, ...]]):
    """Units by quantity, also by that of a named joint or muscle, such as ``angle.hip``."""

    def __missing__(self, name: str) -> tuple[str, ...]:
        quantity = name.partition(".")[0]
        return self[quantity if quantity in self or quantity == name else f"{quantity}1"]


QUANTITIES: Mapping[str, tuple[str, ...]] = _Quantities(
    {
        **{name: tuple(units.split()) for name, units in UNITS.items()},
        **dict.fromkeys(("set_pressure", *OF_MUSCLES[0], *OF_MUSCLES[1]), tuple(UNITS["pressure"].split())),
        **dict.fromkeys(OF_MUSCLES[2], tuple(UNITS["force"].split())),
        "set_force": tuple(UNITS["force"].split()),
        **dict.fromkeys(("displacement", "shortening"), tuple(UNITS["length"].split())),
        "lengthening": (*UNITS["length"].split(), *UNITS["contraction"].split()),
        "relative_length": tuple(UNITS["contraction"].split()),
        **dict.fromkeys(("direction", "phase", "repeat"), ()),
    }
)
"""Units of each quantity of a column.

`shortening` and `lengthening` are displacements with a known direction, the latter also relative to the initial length,
as `relative_length` is.
"""

VOCABULARY = tomllib.loads((resources.files("mckibben.dataset") / "vocabulary.toml").read_text(encoding="utf-8"))
"""Names, spellings, synonyms and patterns of vocabulary.toml."""
_QUANTITY = {name.strip(): quantity for quantity, names in VOCABULARY["names"].items() for name in names.split(",")}
_MODIFIERS = re.compile(
    r"\b(actual|measured|ist|istwert|value|wert|gauge|relative|rel|mean|average|avg|mittel|mittelwert|last|"
    r"sensor|muscle|muskel|pam|mckibben|actuator|raw|(?:ch|channel|kanal|ai|sensor|signal) ?\d+|\d+|feedback)\b"
)
_HARMLESS = re.compile(VOCABULARY["patterns"]["harmless"], re.VERBOSE)
ABSOLUTE = re.compile(
    r"\b(?:absolute?[rsn]?|absolue?|abs|absolutdruck)\b|绝对|絶対|(?<=bar|psi|kpa)a\b|\(a\)", re.IGNORECASE
)
_GAUGE = re.compile(r"\s*\(?\b(?:gauge|rel|relative|überdruck|g)\b\)?|(?<=bar|psi)g\b", re.IGNORECASE)
AMBIGUOUS = re.compile(VOCABULARY["patterns"]["ambiguous"], re.IGNORECASE | re.VERBOSE)
"""Words in a name after which a column is not what the rest of its name says."""
_MEASURED = re.compile("force|kraft|press|druck|length|länge|contract|kontrak")
_SPELLED = {text: unit for unit, spellings in VOCABULARY["spellings"].items() for text in spellings}
_TIME_UNITS = {"millis": "ms", "micros": "us", "tout": "s", "x value": "s"}
"""Names of clocks that say their unit: of Arduino, Simulink and LabVIEW."""
_BRACKETS = re.compile(
    r"(.*?)\s*(?:\[(.*)\]|\((.*)\)|<(.*)>|\{(.*)\})\s*(?:(?:-\s*(?:ch|channel|kanal) ?)?\d{0,2}|Ave)$",
    re.DOTALL | re.IGNORECASE,
)
_REFERENCE = re.compile(r"(.*)\s+(\w+)\s*\((?:(g|gauge)|a|abs)\)", re.IGNORECASE)
_TAIL = re.compile(r"(.+?)(?:\s*[/,;:]\s*|\s+in\s+|\s+[-–]\s+|[_ .])([^\s_/,;:]+)$", re.DOTALL)
_CATMAN = re.compile(r"(?:\s+\d+)?\s*-\s*[\w ]*(?:messrate|sample rate)\b|\s+(?:last|actual|ave)$|_+$", re.IGNORECASE)
_ROLES = {
    **{(name, role): name for name in ("pressure", "force") for role in ("ist", "actual")},
    ("pressure", "soll"): "set_pressure",
}
"""Quantity by the dimension of a unit and a name that only says whether the value is set or measured."""
_LETTERS = {"T": "", "P": "pressure", "f": ""}  # temperature, pressure, frequency
_LONGEST = 300  # characters of a header
_LINE = re.compile(
    r"(-)?(?:(#)\s*\*\s*(?:x|\(\s*x\s*([+-]\s*#)\s*\))\s*([+-]\s*#)?\s+)?(\S+)".replace(
        "#", r"\d+\.?\d*(?:[eE][+-]?\d+)?"
    )
)


class Header(NamedTuple):
    """Meaning of the header of a column.

    Attributes
    ----------
    quantity
        Of `QUANTITIES`; empty if the name is unknown.
    unit
        Of the quantity's units, as this program writes it; empty if there is none. Of an unknown quantity, any text.
    name
        Name in small letters, without its unit.
    absolute
        Whether a pressure is measured from vacuum.
    """

    quantity: str
    unit: str
    name: str = ""
    absolute: bool = False


def canonical_unit(text: str, quantity: str) -> str:
    """Unit of a quantity as this program writes it; empty if the text is not one of its units.

    >>> canonical_unit("kp", "force"), canonical_unit("mpa", "pressure"), canonical_unit("%", "contraction")
    ('kgf', '', 'percent')
    """
    bare = unicodedata.normalize("NFKC", text).replace("²", "2").strip(" .")
    product = re.sub(r"[·⋅*. -]", "", bare)  # N·m, N.m, N-m, Nm
    bare = next((_SPELLED[text] for text in (bare, bare.lower(), product.lower()) if text in _SPELLED), product)
    for unit in QUANTITIES[quantity]:
        same, cased = bare.lower() == unit.replace("*", "").lower(), unit[0] in "mMgG" or "*" in unit
        if bare == unit or (same and (not cased or bare[0] == unit[0] or unit == "gf")):
            return unit
    return ""


def dimension_of(text: str) -> str:
    """Quantity (pressure, force, length, contraction or time) that a unit measures; empty if it is unknown.

    >>> dimension_of("bar abs"), dimension_of("kp"), dimension_of("V")
    ('pressure', 'force', '')
    """
    bare = _GAUGE.sub("", ABSOLUTE.sub("", text)).strip() or text
    return next((name for name in UNITS if bare and canonical_unit(bare, name)), "")


@functools.lru_cache(4096)
def parse_header(text: str, unit: str = "") -> Header:
    """Understand a header such as ``Druck [bar]``, ``pressure_kPa`` or ``F / N``; `unit` stands elsewhere in the file.

    >>> parse_header("Druck ist (kPa abs)")
    Header(quantity='pressure', unit='kPa', name='druck ist', absolute=True)
    >>> parse_header("Temperature [K]").quantity
    ''
    """
    text = " ".join(unicodedata.normalize("NFKC", text[:_LONGEST]).split()).lstrip("#%").strip()
    text = re.sub(r":\d+$", "", text)  # of Simulink
    text = re.sub(r"_(m?N)_([cm]?m)$", r"_\1*\2", text)  # torque_N_m
    if dimension_of(text) == "pressure":  # a unit alone
        return Header("", canonical_unit(_GAUGE.sub("", ABSOLUTE.sub("", text)).strip(), "pressure"), _plain(text))
    if (match := _REFERENCE.fullmatch(text)) and dimension_of(match[2]) == "pressure":  # Pressure kPa(g)
        text = f"{match[1]} ({match[2]} {'gauge' if match[3] else 'abs'})"
    whole = _read_whole(text, unit)
    if not whole.quantity and len(parts := [part for part in re.split(r"[/\\.]", text) if part.strip()]) > 1:
        headers = [header for part in parts if (header := _read_whole(part.strip(), unit)).quantity]
        if len({header.quantity for header in headers}) == 1:
            return max(headers, key=lambda header: bool(header.unit))
    return whole


def parse_named(text: str, unit: str, names: Sequence[str]) -> Header | None:
    """Understand a header with one of the names of joints and muscles; None of another.

    >>> parse_named("Angle.left hip [deg]", "", ["angle.knee", "angle.left hip"])
    Header(quantity='angle.left hip', unit='deg', name='angle left hip', absolute=False)
    """
    whole = _read_whole(text, unit)
    name = next((name for name in names if _plain(name) == whole.name), None)
    return whole._replace(quantity=name, unit=canonical_unit(whole.unit, name)) if name else None


def _read_whole(text: str, unit: str) -> Header:
    """Header of a text without a path; of an unknown name it has no quantity."""
    name, spelled = text, unit
    if match := _BRACKETS.fullmatch(text):
        name, spelled = match[1], next(filter(None, match.groups()[1:]), "") or unit
    elif (match := _TAIL.fullmatch(text)) and dimension_of(match[2]) and ("_" in text or _named(match[1])):
        name, spelled = match[1], match[2]
    elif (match := _TAIL.fullmatch(text.rpartition("_")[0])) and ABSOLUTE.fullmatch(text.rpartition("_")[2]):
        name, spelled = match[1], f"{match[2]} abs"
    plain, quantity = _plain(_CATMAN.sub("", name)), _named(name, spelled)
    absolute = bool(ABSOLUTE.search(spelled) or ABSOLUTE.search(plain)) and "pressure" in quantity
    bare = _GAUGE.sub("", ABSOLUTE.sub("", spelled)).strip(" ()") if "pressure" in quantity else spelled.strip()
    if not quantity or (quantity == "pressure" and AMBIGUOUS.search(name)):
        return _in_other_unit("", bare, plain)
    known = canonical_unit(bare, quantity) if bare else _TIME_UNITS.get(plain, "") if quantity == "time" else ""
    if bare and not known:
        return _in_other_unit(quantity, bare, plain)
    return Header(quantity, known, plain, absolute)


def _in_other_unit(quantity: str, unit: str, name: str) -> Header:
    """Header of a name with the unit of another quantity: a contraction in a length is a displacement."""
    if quantity == "contraction" and (length := canonical_unit(unit, "length")):
        return Header("shortening", length, name)
    if quantity == "shortening" and (ratio := canonical_unit(unit, "contraction")):
        return Header("contraction", ratio, name)
    dimension = dimension_of(unit)
    return Header("", canonical_unit(unit, dimension) if dimension else unit, name)


def _named(name: str, unit: str = "") -> str:
    """Quantity of a name, which may only say whether a value in a unit is set or measured; empty if it is unknown."""
    plain = _plain(_CATMAN.sub("", name))
    if (letter := _LETTERS.get(name.strip())) is not None:
        return letter
    if quantity := _QUANTITY.get(plain):
        return quantity
    if AMBIGUOUS.search(plain):
        return ""
    bare = " ".join(_MODIFIERS.sub(" ", ABSOLUTE.sub(" ", plain)).split())
    if len(parts := {_QUANTITY.get(word) for word in bare.split()}) == 1 and (said := parts.pop()):  # Kraft F
        return said
    return _QUANTITY.get(bare) or _ROLES.get((dimension_of(unit), plain.removesuffix("wert")), "")


def _plain(text: str) -> str:
    return " ".join(re.sub(r"[_\-<>|.()]+", " ", text.strip(" \"'")).lower().split())


def parse_line(text: str) -> tuple[float, float, str]:
    """Gain, offset and name of a column by the line of its sensor, in the name's unit; ``-force_N`` has the gain -1.

    >>> parse_line("2.5*(x - 0.5) pressure_bar"), parse_line("-98.1*x+3 force_N"), parse_line("-force_N")
    ((2.5, -1.25, 'pressure_bar'), (-98.1, 3.0, 'force_N'), (-1.0, 0.0, 'force_N'))
    """
    if (match := _LINE.fullmatch(text.strip())) is None:
        return 1.0, 0.0, text
    gain, zero, offset = (float((part or "0").replace(" ", "")) for part in match.group(2, 3, 4))
    gain = -(gain or 1.0) if match[1] else gain or 1.0
    return gain, gain * zero + offset, match[5]


def is_harmless(text: str) -> bool:
    """Whether a column that is not read says by its name that no force, pressure or length is in it.

    >>> is_harmless("Temperature [°C]"), is_harmless("Force sample"), is_harmless("valid")
    (True, False, False)
    """
    name = _plain(re.split(r"[/\\.]", _BRACKETS.sub(r"\1", text))[-1])
    return bool(_HARMLESS.match(name)) and not _MEASURED.search(_plain(text))


def si_factor(header: Header) -> float:
    """Factor from the unit of a header to SI; 1 without a unit.

    >>> si_factor(parse_header("Druck [bar]"))
    100000.0
    """
    return factor(header.unit) if header.unit else 1.0
