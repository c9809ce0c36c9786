"""Column headers: quantity and unit of each column of a file."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from mckibben import units
from mckibben.dataset.sheet import RawColumn, RawTable
from mckibben.errors import Problem, closest, quoted

_PRESSURE = ("bar", "kPa", "MPa", "Pa", "mbar", "psi")

ACCEPTED: Mapping[str, tuple[str, ...]] = {
    "pressure": _PRESSURE,
    "contraction": ("percent", "ratio"),
    "length": ("mm", "m", "cm", "in"),
    "displacement": ("mm", "m", "cm", "in"),
    "force": ("N", "kN", "daN", "kgf", "lbf"),
    "direction": (),
    "repeat": (),
    "time": ("s", "ms", "min"),
    "set_pressure": _PRESSURE,
    "phase": (),
}

# Other names, accepted only with a unit, also in five more European and two Asian languages. A strain, whose sign and
# base are ambiguous, is excluded; sign and zero of a displacement are given when it is read. Letters are
# case-sensitive: f is a frequency and T a temperature.
_NAMES: Mapping[str, str] = {
    name: quantity
    for quantity, others in (
        ("pressure", ("p", "P", "gauge pressure", "muscle pressure", "measured pressure", "pressure actual")),
        ("force", ("F", "tension", "axial force", "muscle force", "measured force", "standard force", "pull", "load")),
        ("contraction", ("relative contraction", "contraction ratio", "epsilon", "eps", "ε")),
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
        ("force", ("kracht", "siła", "引張力")),
        ("force", ("kraft", "zugkraft", "standardkraft", "forza", "fuerza", "força", "力", "拉力", "張力")),
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
        ("displacement", ("stroke", "travel", "weg", "hub", "verschiebung", "déplacement", "spostamento", "corsa")),
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

_PATTERNS = {"pressure": "{pressure_bar}bar", "contraction": "L{length_mm}"}  # of file names

_SPELLED: Mapping[str, str] = {
    "%": "percent",
    **dict.fromkeys(("-", "1"), "ratio"),
    **dict.fromkeys(("sec", "second", "seconds"), "s"),
    "milliseconds": "ms",
    "pct": "percent",
    "hpa": "mbar",
    "kp": "kgf",
    **dict.fromkeys(("n/mm2", "n/mm^2"), "MPa"),
    **dict.fromkeys(("n/m2", "n/m^2"), "Pa"),
    **dict.fromkeys(("kilopascal", "kilopascals"), "kPa"),
    "minutes": "min",
    **dict.fromkeys(("newton", "newtons"), "N"),
    **dict.fromkeys(("inch", "inches"), "in"),
    "pascal": "Pa",
    **dict.fromkeys(("millimeters", "millimetres"), "mm"),
}

_CLASSIC = re.compile(rf"({'|'.join(ACCEPTED)})(?:[_ ](.+))?", re.IGNORECASE | re.ASCII)
_WITH_UNIT = re.compile(r"(?P<name>.+?)\s*(?:\((?P<a>.+)\)|\[(?P<b>.+)\]|[/,]\s*(?P<c>[^\s/,]+)|\sin\s+(?P<d>\S+))")
_NUMBER_AND_UNIT = re.compile(r"([+\-\u2212]?[0-9.,'’\s]+?(?:[eE][+-]?[0-9]+)?)\s*([A-Za-z%]+)")
_GAUGE = re.compile(r"(.*?)(?:\s*\((?:g|gauge|rel)\)| ?gauge| rel| g|(?<=bar|psi)g)", re.IGNORECASE)
_ABSOLUTE = re.compile(r"(.*?)(?:\s*\((?:a|abs|absolute)\)|[ _]?abs(?:olute)?| a|(?<=bar|psi)a)", re.IGNORECASE)
_SUFFIX = re.compile(r":[0-9]+$|(?<=[\])])\s*(?:ave|avg|mean)\.?$", re.IGNORECASE)  # Simulink's port, PicoLog's average
_AVERAGE = re.compile(r"(?:mean|average|avg) (?=.)|(?<=.) (?:mean|average|avg|ave|last)", re.IGNORECASE)
_SCANNED = re.compile(r"[0-9]+ <([^<>]+)>")  # channel and name of a Keysight scanner: 101 <Force> (N)
_OTHER_PLACE = re.compile(r"set|soll|target|ref|demand|command|desired|goal|supply|tank|reservoir", re.IGNORECASE)
ABSOLUTE = re.compile(r"(?<![a-z])abs(?![a-z])|absolut", re.IGNORECASE)
"""Words of names and comments that may mean an absolute pressure."""
_UNITS = frozenset(name.lower() for name in units.UNITS)
_FOREIGN = frozenset("at atm torr mmhg mh2o v mv g kg cn dn mn hpa mbar lb volts".split())
"""Units, in small letters, that contradict any other, in addition to those of `units`."""


class Header(NamedTuple):
    """Meaning of a header: a key of `ACCEPTED`, and its unit; `direction`, `repeat` and `phase` have no unit."""

    quantity: str
    unit: str


def names(quantity: str) -> str:
    """Accepted headers of a quantity, as text.

    >>> names("contraction")
    'contraction_percent or contraction_ratio'
    """
    spelled = [f"{quantity}_{unit}" for unit in ACCEPTED[quantity]] or [quantity]
    return " or ".join(filter(None, [", ".join(spelled[:-1]), spelled[-1]]))


def parse_header(header: str, unit: str = "") -> Header | None:
    """Quantity and unit of a header, None if unknown; only a leading m is case-sensitive: MPa is not mPa."""
    for quantity, spelled in _readings(header, unit):
        for known in ACCEPTED[quantity] or ("",):
            if _same_unit(spelled, known, quantity):
                return Header(quantity, known)
    return None


def unit_error(header: str, unit: str = "") -> str:
    """Error of a header that names a quantity with a wrong unit; empty if there is none."""
    if parse_header(header, unit):
        return ""
    for quantity, spelled in _readings(header, unit):
        if quantity.endswith("pressure") and _is_absolute(spelled):
            return f"{spelled!r} is absolute; a gauge pressure is needed"
        if spelled.lower() in _UNITS and _name(header) not in _SYMBOLS:
            return f"{spelled!r} is not a unit of {quantity} here"
    return ""


def _is_absolute(unit: str) -> bool:
    """True for a unit of absolute pressure, such as psia or "bar abs"."""
    absolute = _ABSOLUTE.fullmatch(unit)
    return absolute is not None and absolute[1].lower() in _UNITS


def is_unit(text: str) -> bool:
    """True if a cell is a unit, as in a row of units under the header."""
    bare = _bare(text)
    known = {unit for accepted in ACCEPTED.values() for unit in accepted}
    return bare != "1" and bare != "" and any(_same_unit(bare, unit, "pressure") for unit in known)


def without_units(column: RawColumn) -> RawColumn:
    """A column whose cells all have the same unit (3.5 bar), with numbers alone in its cells and its unit."""
    if isinstance(column.cells, np.ndarray):
        return column
    filled = (_NUMBER_AND_UNIT.fullmatch(text[:_LONGEST]) for text in map(str.strip, column.cells) if text)
    first = next(filled, None)
    if first is None or not is_unit(first[2]) or any(one is None or one[2] != first[2] for one in filled):
        return column
    if column.unit and not _same_unit(_bare(column.unit), first[2], "pressure"):
        return column
    ends = [cell.strip().removesuffix(first[2]).rstrip() for cell in column.cells]
    return replace(column, cells=ends, unit=first[2])


def _readings(header: str, unit: str) -> list[tuple[str, str]]:
    """Candidate readings of a header: pairs of quantity and unit as spelled."""
    if len(header) > _LONGEST:
        return []
    text = unicodedata.normalize("NFKC", " ".join(header.split()).rstrip("_"))  # MATLAB writes Pressure_bar_
    found: list[tuple[str, str]] = []
    text = _SCANNED.sub(r"\1", _SUFFIX.sub("", text))
    path, _, last = text.rpartition("/")
    if (path.count("/") or _CLASSIC.fullmatch(last)) and not _OTHER_PLACE.search(path):  # rig/pressure_bar
        text = last.strip()
    if match := _CLASSIC.fullmatch(text):
        quantity = match[1].lower()
        found.append((quantity, match[2] or (_bare(unit) if ACCEPTED[quantity] else "")))
    name, spelled = _name(text), _bare(unit)
    if match := _WITH_UNIT.fullmatch(text):
        spelled = _bare(next(filter(None, (match["a"], match["b"], match["c"], match["d"]))))
    elif not spelled and is_unit(text.rpartition("_")[2]):  # F_N
        name, _, spelled = text.rpartition("_")
    if (quantity := _named(name)) and spelled:
        found.append((quantity, spelled))
    return found


def _named(name: str) -> str:
    """Quantity of a name without a unit; empty if there is none."""
    name = _AVERAGE.sub("", name)
    key = name.lower().replace(" ", "_")
    return key if key in ACCEPTED else _NAMES.get(name) or _NAMES.get(name.lower() if len(name) > 1 else "", "")


def _name(header: str) -> str:
    match = _WITH_UNIT.fullmatch(header)
    return match["name"].strip() if match else header


def _bare(unit: str) -> str:
    """Unit without brackets."""
    text = unicodedata.normalize("NFKC", unit).strip()
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


_BY_NAME = "columns={...} (command line: --column 'HEADER=NAME')"
SUBTRACT = "subtract the ambient pressure in the file, and state a gauge pressure in its header"
_LONGEST = 200  # characters of a name; matching takes quadratic time
_SHOWN = 40  # names of the file's columns in a message


@dataclass
class Layout:
    """Columns of a file by quantity (index and header), ignored headers, problems and doubts about the header."""

    places: dict[str, tuple[int, Header]] = field(default_factory=dict)
    ignored: list[str] = field(default_factory=list)
    problems: list[Problem] = field(default_factory=list)
    suspect: list[str] = field(default_factory=list)


def find_columns(
    sheet: RawTable, mapping: Mapping[str, str], needed: Sequence[str], unread: Collection[str] = ()
) -> Layout:
    """Find the columns of known quantities; `mapping` (name in the file to header) has priority.

    The quantities of `unread` are read only from mapped columns.
    """
    layout = Layout(ignored=list(sheet.ignored))
    header = sheet.names
    shown = ", ".join(map(quoted, header[:_SHOWN])) + (f" ... ({len(header)} in all)" if len(header) > _SHOWN else "")

    def problem(message: str, field: str = "", remedy: str = "") -> None:
        layout.problems.append(sheet.kind(message, line=sheet.header_line, field=field, remedy=remedy))

    if not (sheet.has_header or mapping):
        by_position = "columns={'1': 'pressure_bar', ...} (command line: --column 1=pressure_bar)"
        problem("the file has no header", remedy=f"name the columns by position: {by_position}")
        return layout
    mapping = {  # the reverse order is equally clear
        **{k: v for k, v in mapping.items() if not _swapped(k, v, header)},
        **{v: k for k, v in mapping.items() if _swapped(k, v, header)},
    }
    asked: set[str] = set()
    seen: set[str] = set()
    assigned: dict[int, str] = {}
    positions: set[int] = set()
    for given, name in mapping.items():
        column = parse_header(name)
        by_position = int(given) - 1 if given.isdecimal() and given not in header else -1
        if given in header:
            assigned |= {index: name for index, one in enumerate(header) if one == given}
        elif 0 <= by_position < len(header):
            assigned[by_position] = name
            positions.add(by_position)
        else:
            meant = closest(given, header)
            problem(f"columns has {given!r}, the file {shown}", remedy=f"did you mean {meant!r}?" if meant else "")
        if column is None:
            problem(f"columns assigns the unknown name {name!r} to {given!r}", remedy=f"accepted are {_accepted()}")
        else:
            asked.add(column.quantity)
    columns = [
        parse_header(assigned[index]) if index in assigned else parse_header(channel.label, channel.unit)
        for index, channel in enumerate(sheet.channels)
    ]
    _leave_out_constant_length(sheet, layout, columns, assigned)
    chosen = {header[index] for index in positions}
    lengths = {"contraction", "length"} & {column.quantity for column in columns if column}
    known = asked | {*unread} | ({"displacement"} if lengths else set())  # not to be read from another column
    for index, (channel, column) in enumerate(zip(sheet.channels, columns, strict=True)):
        text = channel.name
        mapped = index in assigned
        seen.add(header[index - 1] if index else "")
        if text and text in seen and index not in positions:
            if text in chosen or _is_copy(sheet, index):
                layout.ignored.append(text)
            else:
                by_position = f"columns={{'{index + 1}': ...}} (command line: --column {index + 1}=NAME)"
                problem("appears twice in the header", text, f"choose one by its position: {by_position}")
        elif column is None or (column.quantity in known and not mapped):
            if column is None and not mapped and (reason := unit_error(channel.label, channel.unit)):
                remedy = SUBTRACT if "absolute" in reason else f"accepted are {_accepted(channel.label)}"
                problem(reason, text, remedy)
            layout.ignored += [text] if text else []
        elif column.quantity in layout.places:
            first = header[layout.places[column.quantity][0]]
            remedy = f"keep one of them, or assign it by {_BY_NAME}"
            problem(f"duplicates {column.quantity}, after {first!r}", text, remedy)
        else:
            layout.places[column.quantity] = index, column
            _compare_units(channel, column, layout, problem, mapped=mapped)
    for name in needed:
        kinds = {"contraction", "length", "displacement"} if name == "contraction" else {name}
        if kinds & {*layout.places}:
            continue
        without = [
            (channel.name, found)
            for channel in sheet.channels
            if not channel.unit
            and channel.name in layout.ignored
            and channel.name not in mapping
            and (found := _named(channel.label)) in kinds
        ]
        for text, found in without:
            unit = ACCEPTED[found][0]
            named = f"columns={{{text!r}: '{found}_{unit}'}} (command line: --column '{text}={found}_{unit}')"
            problem("has no unit", text, f"write it in the header, such as '{text} [{unit}]', or give {named}")
        if not without:
            others = f" (or {names('length')}), or displacement_mm"
            wanted = names(name) + (others if name == "contraction" else "")
            remedy = f"name it {wanted}, or assign it by {_BY_NAME}"
            if (unit := _unit_of(name, sheet, layout.ignored)) is not None:
                remedy = f"if {unit[0]!r} is it, assign it: columns={{{unit[0]!r}: {unit[1]!r}}} (command line: "
                remedy += f"--column '{unit[0]}={unit[1]}'); otherwise name it {wanted}"
            if pattern := _PATTERNS.get(name):
                remedy += f"; if file names give it, read it with from_name (command line: --from-name '{pattern}')"
            problem(f"no column for {name}; the file has {shown}", remedy=remedy)
    layout.suspect += [
        f"{name!r} may be the {quantity} as well; read is {header[layout.places[quantity][0]]!r}"
        for channel in sheet.channels
        if (name := channel.name) in layout.ignored
        and (quantity := _candidate(channel.label)) in layout.places
        and quantity not in asked
    ]
    _same_length(sheet, layout)
    _same_clock(sheet, layout)
    return layout


def _unit_of(quantity: str, sheet: RawTable, ignored: Collection[str]) -> tuple[str, str] | None:
    """The only unread column with a unit of a quantity, and its name with that unit; None if there is none."""
    found = []
    for channel in sheet.channels:
        spelled = _WITH_UNIT.fullmatch(channel.label)
        unit = channel.unit or (next(filter(None, spelled.group(*"abcd"))) if spelled else "")
        known = next((one for one in ACCEPTED[quantity] if unit and _same_unit(unit, one, quantity)), "")
        if channel.name in ignored and known:
            found.append((channel.name, f"{quantity}_{known}"))
    return found[0] if len(found) == 1 else None


def _compare_units(
    channel: RawColumn, column: Header, layout: Layout, problem: Callable[..., None], *, mapped: bool
) -> None:
    """Compare the unit of a column with the one that the file states in addition: in a row of units, or in its name."""
    named = ""
    if mapped:
        match = _WITH_UNIT.fullmatch(channel.label)
        named = next(filter(None, match.groups()[1:])) if match else "_".join(channel.label.split("_")[1:])
        named = _bare(named) if _is_contradiction(_bare(named)) else ""
    if column.quantity.endswith("pressure"):
        if any(map(_is_absolute, (_bare(channel.unit), named))):
            problem("is an absolute pressure; a gauge pressure is needed", channel.name, SUBTRACT)
            return
        if mapped and ABSOLUTE.search(channel.label):
            layout.suspect.append(f"{channel.name!r} is read as a gauge pressure; if it is absolute, {SUBTRACT}")
    for stated, where in ((_bare(channel.unit), "the file has"), (named, "its name says")):
        if not stated or not column.unit or _same_unit(stated, column.unit, column.quantity):
            continue
        if mapped or not _is_contradiction(stated):
            layout.suspect.append(f"{channel.name!r} is read in {column.unit}, but {where} {stated!r}")
        else:
            remedy = f"correct one of them, or assign it by {_BY_NAME}"
            problem(f"is in {column.unit} by its name, but in {stated} by its unit", channel.name, remedy)


def _is_contradiction(text: str) -> bool:
    """True for a text with a unit in it, such as "10 N" or kgf/cm2."""
    words = re.split(r"[^a-z%]+", text.lower())
    return is_unit(text) or _is_absolute(text) or not (_UNITS | _FOREIGN).isdisjoint(words)


def _leave_out_constant_length(
    sheet: RawTable, layout: Layout, columns: list[Header | None], assigned: Collection[int]
) -> None:
    """Leave out a constant length, which is the initial one, where a displacement varies."""
    places = {column.quantity: index for index, column in enumerate(columns) if column}
    if not {"length", "displacement"} <= places.keys():
        return
    length, displacement = (places[name] for name in ("length", "displacement"))
    if length in assigned or not _is_constant(sheet.channels[length]) or _is_constant(sheet.channels[displacement]):
        return
    columns[length] = None
    names = [sheet.channels[index].name for index in (length, displacement)]
    layout.suspect.append(f"{names[0]!r} is constant and is left out; {names[1]!r} is read")


def _is_copy(sheet: RawTable, index: int) -> bool:
    """True if the first column of the same name has the same cells."""
    cells, first = sheet.channels[index].cells, sheet.channels[sheet.names.index(sheet.channels[index].name)].cells
    return type(first) is type(cells) and np.array_equal(first, cells)


def _is_constant(channel: RawColumn) -> bool:
    cells = channel.cells
    return len(cells) > 1 and all(cell == cells[0] for cell in cells)


def _candidate(header: str) -> str:
    """Quantity that an unknown header may be, such as "Force filtered [N]"; empty if there is none."""
    if len(header) > _LONGEST:
        return ""
    match = _WITH_UNIT.fullmatch(" ".join(header.split()))
    unit = _bare(next(filter(None, match.groups()[1:]))) if match else ""
    words = re.split(r"[\s_.\-]+", match["name"].lower() if match else header.lower())
    found = next((name for name in ("pressure", "force", "contraction", "length") if name in words), "")
    known = not unit or any(_same_unit(unit, one, found) for one in ACCEPTED.get(found, ()))
    return found if known else ""


def _swapped(given: str, name: str, header: Sequence[str]) -> bool:
    """True if a pair of the mapping is reversed: a known name and a header."""
    return given not in header and name in header and parse_header(given) is not None


def _same_length(sheet: RawTable, layout: Layout) -> None:
    """Check that all columns read have equal length."""
    read = [sheet.channels[index] for index, _ in layout.places.values()]
    for channel in read[1:]:
        if len(channel.cells) != len(read[0].cells):
            message = f"has {len(channel.cells)} values, {read[0].name!r} {len(read[0].cells)}"
            remedy = "read columns of equal length"
            layout.problems.append(sheet.kind(message, field=channel.name, remedy=remedy))


def _same_clock(sheet: RawTable, layout: Layout) -> None:
    """Refuse columns of several sheets or groups that have times of their own; warn of several without."""

    def part(channel: RawColumn) -> str:
        return channel.name.rpartition("/")[0] if channel.short else ""

    used = dict.fromkeys(part(sheet.channels[index]) for index, _ in layout.places.values())
    if len(used) < 2:
        return
    clocks = {
        part(one) for one in sheet.channels if (found := parse_header(one.label, one.unit)) and found.quantity == "time"
    }
    shown = " and ".join(map(repr, used))
    if len(clocks & {*used}) > 1:
        remedy = "write them at common times to one sheet, or read one sheet alone"
        layout.problems.append(sheet.kind(f"columns are from {shown}, which have their own times", remedy=remedy))
    else:
        layout.suspect.append(f"columns are from {shown}: their rows are taken to belong together")


def _accepted(header: str = "") -> str:
    quantities = [name for name in ACCEPTED if header.lower().startswith(name)] or list(ACCEPTED)
    return ", ".join(names(name) for name in quantities)
