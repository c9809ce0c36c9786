"""Columns of a file by quantity."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from mckibben.dataset.headers import (
    ABSOLUTE,
    ACCEPTED,
    LONGEST_NAME,
    OTHER_PLACE,
    Header,
    bare_unit,
    is_absolute,
    is_contradiction,
    name_and_unit,
    named_quantity,
    names,
    parse_header,
    same_unit,
    unit_error,
)
from mckibben.dataset.sheet import RawColumn, RawTable
from mckibben.errors import Problem, closest, quoted
from mckibben.units import factor

_SAME = 2e-3  # of a value and of the range: difference of equal values that are rounded in two units
_PATTERNS = {"pressure": "{pressure_bar}bar", "contraction": "L{length_mm}"}  # of file names
_BY_NAME = "columns={...} (command line: --column 'HEADER=NAME')"
SUBTRACT = "subtract the ambient pressure in the file, and state a gauge pressure in its header"
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
    misspelled: set[str] = set()  # quantities
    units: dict[str, set[str]] = {}  # of the names before
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
            spelled = {f"{one}_{unit}" if unit else one: one for one in ACCEPTED for unit in ACCEPTED[one] or [""]}
            meant = "" if name in ACCEPTED else closest(name, [*spelled])
            misspelled |= {spelled.get(meant, name)}
            remedy = f"did you mean {meant!r}?" if meant else f"accepted are {_accepted(name)}"
            problem(f"the unknown name {name!r} is assigned to {given!r}", remedy=remedy)
        else:
            asked.add(column.quantity)
    columns = [
        parse_header(assigned[index]) if index in assigned else parse_header(channel.label, channel.unit)
        for index, channel in enumerate(sheet.channels)
    ]
    exact = asked | {*unread} | {column.quantity for column in columns if column}
    for index, channel in enumerate(sheet.channels):
        if columns[index] is None and (loose := parse_header(channel.label, channel.unit, loose=True)):
            columns[index] = loose if loose.quantity not in exact else None
    _leave_out_constant_length(sheet, layout, columns, assigned)
    chosen = {header[index] for index in positions}
    lengths = {"contraction", "length"} & {column.quantity for column in columns if column}
    known = asked | {*unread} | ({"displacement"} if lengths else set())  # not to be read from another column
    for index, (channel, column) in enumerate(zip(sheet.channels, columns, strict=True)):
        text = channel.name
        mapped = index in assigned
        before, units[text] = units.get(text), {*units.get(text, ()), channel.unit}
        if text and before and index not in positions and (column is None or before & {channel.unit, ""}):
            if text in chosen or column is None or _is_copy(sheet, index):
                layout.ignored.append(text)
            else:
                by_position = f"columns={{'{index + 1}': ...}} (command line: --column {index + 1}=NAME)"
                problem("appears twice in the header", text, f"choose one by its position: {by_position}")
        elif column is None or (column.quantity in known and not mapped):
            if column is None and not mapped and (reason := unit_error(channel.label, channel.unit)):
                remedy = SUBTRACT if "absolute" in reason else f"accepted are {_accepted(channel.label)}"
                problem(reason, text, remedy)
            layout.ignored += [text] if text else []
        elif column.quantity in layout.places and _agree(sheet, layout.places[column.quantity], (index, column)):
            layout.ignored.append(text)  # the same in another unit
        elif column.quantity in layout.places:
            first = header[layout.places[column.quantity][0]]
            remedy = f"keep one of them, or assign it by {_BY_NAME}"
            problem(f"duplicates {column.quantity}, after {first!r}", text, remedy)
        else:
            layout.places[column.quantity] = index, column
            _compare_units(channel, column, layout, problem, mapped=mapped)
    for name in needed:
        kinds = {"contraction", "length", "displacement"} if name == "contraction" else {name}
        if kinds & ({*layout.places} | misspelled):
            continue
        without = [
            (channel.name, found)
            for channel in sheet.channels
            if not channel.unit
            and channel.name in layout.ignored
            and channel.name not in mapping
            and (found := named_quantity(channel.label)) in kinds
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
        and name != header[layout.places[quantity][0]]
    ]
    layout.suspect += [
        f"{channel.name!r} has a unit of {quantity}; read is {header[layout.places[quantity][0]]!r}"
        for channel in sheet.channels
        for quantity in ("pressure", "force")
        if channel.name in layout.ignored
        and not (_candidate(channel.label) or OTHER_PLACE.search(channel.label))
        and quantity in {*layout.places} - asked
        and any(same_unit(_stated_unit(channel), known, quantity) for known in ACCEPTED[quantity])
    ]
    _same_length(sheet, layout)
    _same_clock(sheet, layout)
    return layout


def _stated_unit(channel: RawColumn) -> str:
    """Unit of a column as spelled; empty if there is none."""
    return channel.unit or name_and_unit(channel.label[:LONGEST_NAME])[1] or ""


def _unit_of(quantity: str, sheet: RawTable, ignored: Collection[str]) -> tuple[str, str] | None:
    """The only unread column with a unit of a quantity, and its name with that unit; None if there is none."""
    found = []
    for channel in sheet.channels:
        unit = _stated_unit(channel) or "".join(channel.label[:LONGEST_NAME].split()[1:][-1:])
        known = next((one for one in ACCEPTED[quantity] if unit and same_unit(unit, one, quantity)), "")
        if channel.name in ignored and known:
            found.append((channel.name, f"{quantity}_{known}"))
    return found[0] if len(found) == 1 else None


def _compare_units(
    channel: RawColumn, column: Header, layout: Layout, problem: Callable[..., None], *, mapped: bool
) -> None:
    """Compare the unit of a column with the one that the file states in addition: in a row of units, or in its name."""
    named = ""
    if mapped:
        inside = name_and_unit(channel.label)[1]
        named = bare_unit("_".join(channel.label.split("_")[1:])) if inside is None else inside
        named = named if is_contradiction(named) else ""
    if column.quantity.endswith("pressure"):
        if any(map(is_absolute, (bare_unit(channel.unit), named))):
            problem("is an absolute pressure; a gauge pressure is needed", channel.name, SUBTRACT)
            return
        if mapped and ABSOLUTE.search(channel.label):
            layout.suspect.append(f"{channel.name!r} is read as a gauge pressure; if it is absolute, {SUBTRACT}")
    for stated, where in ((bare_unit(channel.unit), "the file has"), (named, "its name says")):
        if not stated or not column.unit or same_unit(stated, column.unit, column.quantity):
            continue
        if mapped or not is_contradiction(stated):
            layout.suspect.append(f"{channel.name!r} is read in {column.unit}, but {where} {stated!r}")
        else:
            remedy = f"correct one of them, or assign it by {_BY_NAME}"
            problem(f"is in {column.unit} by its name, but in {stated} by its unit", channel.name, remedy)


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


def _agree(sheet: RawTable, *places: tuple[int, Header]) -> bool:
    """True if two columns have the same values in different units."""
    try:
        one, other = (
            np.array([str(cell).replace(",", ".") for cell in sheet.channels[index].cells], float) * factor(column.unit)
            for index, column in places
        )
    except ValueError:
        return False
    units = {column.unit for _, column in places}
    return len(units) > 1 and one.shape == other.shape and np.allclose(one, other, rtol=_SAME, atol=_SAME * np.ptp(one))


def _is_constant(channel: RawColumn) -> bool:
    cells = channel.cells
    return len(cells) > 1 and all(cell == cells[0] for cell in cells)


def _candidate(header: str) -> str:
    """Quantity that an unknown header may be, such as "Force filtered [N]"; empty if there is none."""
    if len(header) > LONGEST_NAME:
        return ""
    name, inside = name_and_unit(" ".join(header.split()))
    unit, words = inside or "", re.split(r"[\s_.\-]+", name.lower())
    found = next((name for name in ("pressure", "force", "contraction", "length") if name in words), "")
    known = not is_contradiction(unit) or any(same_unit(unit, one, found) for one in ACCEPTED.get(found, ()))
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
