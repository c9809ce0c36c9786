"""Results: what every computation returns, declared once and shown everywhere.

A result declares its numbers as fields with a `column` (unit and title), its verdict, its remarks, and the figures that
show it. The table on the terminal, JSON, the view of a notebook, the page, NetCDF and the files of `--out` follow:

>>> import numpy as np
>>> class Resonance(Result):
...     "Resonance of a joint over its stiffness."
...     stiffness: np.ndarray = column("N*m/rad", "stiffness")
...     frequency: np.ndarray = column("Hz", "natural frequency")
...     inertia: float = column("kg*m^2", "moment of inertia")
...
...     def verdict(self):
...         return f"resonance up to {self.frequency.max():.2g} Hz"
>>> stiffness = np.array([10.0, 40.0])
>>> resonance = Resonance(stiffness, np.sqrt(stiffness / 0.1) / (2 * np.pi), 0.1)
>>> print(resonance.to_text())
resonance up to 3.2 Hz
<BLANKLINE>
moment of inertia   0.1 kg*m^2
<BLANKLINE>
stiffness  natural frequency
[N*m/rad]               [Hz]
       10              1.592
       40              3.183
>>> resonance.to_dict()["scalars"]["inertia"]
{'title': 'moment of inertia', 'unit': 'kg*m^2', 'value': 0.1}
"""

from __future__ import annotations

import copy
import dataclasses
import itertools
import math
import os
import re
import textwrap
from base64 import b64encode
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum
from functools import partial
from html import escape
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, ClassVar, Self, TypeAlias, TypeVar, dataclass_transform

from mckibben.binding import call
from mckibben.errors import McKibbenError, ParameterError, Suggesting, printable
from mckibben.storage.files import check_free, json_ready, make_folder, remove_results, write_json
from mckibben.units import HINGE, JointType, factor

if TYPE_CHECKING:
    import numpy as np
    import xarray
    from matplotlib.figure import Figure

Values: TypeAlias = "np.ndarray | Sequence[object]"
"""Values of a column, numbers in SI or texts."""
TableColumns: TypeAlias = "dict[str, tuple[Column, Any]]"
"""Columns with their values, by name: arrays or sequences, and of scalars numbers or texts."""
F = TypeVar("F", bound=Callable[..., object])

_LONGEST_CELL = 500  # characters
_MOST_ROWS = 30  # of samples in a text


@dataclass(frozen=True)
class Column:
    """Unit and title of the numbers of a result.

    Parameters
    ----------
    unit
        Unit of the values, in SI ("1" for a ratio, "" for texts and counts).
    title
        Heading, a noun phrase.
    shown
        Unit in tables and figures (default: `unit`).
    digits
        Significant digits in tables.
    dims
        Names of the axes of an array of more than one dimension, for NetCDF; such an array is in no table.
    detail
        Whether it is shown with details only.
    phase
        Whether it is an angle of any joint, also of a slide.
    """

    unit: str = ""
    title: str = ""
    shown: str = ""
    digits: int = 4
    dims: tuple[str, ...] = ()
    detail: bool = False
    phase: bool = False

    @property
    def shown_unit(self) -> str:
        """Unit in tables."""
        return self.shown or self.unit

    @property
    def size(self) -> float:
        """Factor of the unit in tables to the unit of the values."""
        return factor(self.shown_unit, self.unit) if self.shown_unit else 1.0

    def for_joint(self, joint_type: JointType) -> Self:
        """Return the column for a joint of a type, from that of a hinge.

        >>> from mckibben.units import SLIDE
        >>> column = Column("N*m/rad", "stiffness at the angle").for_joint(SLIDE)
        >>> column.unit, column.title, column.shown
        ('N/m', 'stiffness at the position', 'N/mm')
        """
        if joint_type is HINGE or self.phase:
            return self
        unit, shown = joint_type.unit(self.unit), joint_type.shown(self.shown_unit)
        return dataclasses.replace(self, unit=unit, title=joint_type.words(self.title), shown=shown)

    def cell(self, value: object) -> str:
        """Return a value [SI] as text in the shown unit, without the unit.

        >>> Column("rad", shown="deg").cell(0.5), Column("N").cell(float("nan")), Column().cell(True)
        ('28.65', '-', 'yes')
        """
        value = value.item() if hasattr(value, "item") else value  # a NumPy scalar
        if isinstance(value, bool):
            return "yes" if value else "no"
        if isinstance(value, float):
            return "-" if math.isnan(value) else f"{value / self.size + 0.0:.{self.digits}g}"
        return "-" if value is None else str(value)


def column(
    unit: str = "",
    title: str = "",
    shown: str = "",
    *,
    digits: int = 4,
    dims: tuple[str, ...] = (),
    default: object = dataclasses.MISSING,
    phase: bool = False,
) -> Any:  # any type of field
    """Return a field of a `Result` that is one of its numbers, see `Column`."""
    return field(default=default, metadata={"column": Column(unit, title, shown, digits, dims, phase=phase)})


def number(unit: str = "", title: str = "", shown: str = "", *, digits: int = 4) -> Callable[[F], F]:
    """Mark the function of a property as one of the numbers of its `Result`, see `Column`; None is left out.

    >>> class Circle(Result):
    ...     "A circle."
    ...     radius: float = column("m", "radius", "mm")
    ...
    ...     @property
    ...     @number("m^2", "area", "mm^2", digits=3)
    ...     def area(self):
    ...         return math.pi * self.radius**2
    >>> print(Circle(0.001).to_text())
    radius      1 mm
    area     3.14 mm^2
    """
    return _marking("_number", Column(unit, title, shown, digits))


def table(title: str = "", *, detail: bool = False) -> Callable[[F], F]:
    """Mark a method of a `Result` as one of its further tables.

    The method returns the columns, no columns for no table, or listings, such as those of results within.
    """
    return _marking("_table", Listing(title, {}, detail))


def row_columns(kind: type, rows: Iterable[object]) -> TableColumns:
    """Return the columns of rows of one class, whose fields with a `column` and `number` properties declare them."""
    rows = list(rows)
    return {name: (mark, [getattr(row, name) for row in rows]) for name, mark in _declarations(kind).items()}


def _for_joint(columns: Mapping[str, tuple[Column, Values]], joint_type: JointType) -> TableColumns:
    return {name: (mark.for_joint(joint_type), values) for name, (mark, values) in columns.items()}


def _declarations(kind: type) -> dict[str, Column]:
    """Columns of a class by name: those of fields, then of properties."""
    fields = {item.name: item.metadata.get("column") for item in dataclasses.fields(kind)}
    return {name: mark for name, mark in fields.items() if mark is not None} | _marked(kind, "_number")


def _marking(kind: str, mark: object) -> Callable[[F], F]:
    def marking(function: F) -> F:
        setattr(function, kind, mark)
        return function

    return marking


def _marked(cls: type, kind: str) -> dict[str, Any]:
    """Marks of the methods and properties of a class, those of its bases first."""
    marks = {}
    for base in reversed(cls.__mro__):
        for name, member in vars(base).items():
            function = getattr(member, "fget", None) or getattr(member, "func", member)  # cached_property has `func`
            if (mark := getattr(function, kind, None)) is not None:
                marks[name] = mark
    return marks


class Severity(Enum):
    """Severity of a remark; its value is the word in texts."""

    SEVERE = "severe"  # the result must not be used as it is
    WARNING = "warning"  # may change what the user does
    NOTE = "note"  # good to know


@dataclass(frozen=True)
class Remark:
    """A sentence on a result, with the field that it is about and a remedy.

    >>> print(Remark.warning("angle", "few samples", remedy="take more"))
    warning: few samples; take more
    """

    severity: Severity
    field: str
    text: str
    remedy: str = ""

    @classmethod
    def severe(cls, field: str, text: str, remedy: str = "") -> Remark:
        """Return a remark on a result that must not be used as it is."""
        return cls(Severity.SEVERE, field, text, remedy)

    @classmethod
    def warning(cls, field: str, text: str, remedy: str = "") -> Remark:
        """Return a remark that may change what the user does."""
        return cls(Severity.WARNING, field, text, remedy)

    @classmethod
    def note(cls, field: str, text: str, remedy: str = "") -> Remark:
        """Return a remark that is shown with details."""
        return cls(Severity.NOTE, field, text, remedy)

    def __str__(self) -> str:
        text = f"{self.text}; {self.remedy}" if self.remedy else self.text
        return text if self.severity is Severity.NOTE else f"{self.severity.value}: {text}"


@dataclass(frozen=True)
class Listing:
    """A table of a result.

    Parameters
    ----------
    title
        Heading; empty for the declared scalars and columns of a result.
    columns
        Column and values of equal length, by name; values are in SI.
    detail
        Whether it is shown with details only.
    vertical
        Whether its one row is shown as a list of titles and values.
    """

    title: str
    columns: Mapping[str, tuple[Column, Values]]
    detail: bool = False
    vertical: bool = False

    @classmethod
    def of(cls, title: str, headings: Sequence[str], rows: Iterable[Sequence[object]], digits: int = 4) -> Listing:
        """Return a table from its rows; all columns have the same digits.

        >>> print(Listing.of("Masses", ("load", "kg"), [("first", 0.5), ("second", 0.25)]).to_text())
        Masses
        load    kg
        first   0.5
        second  0.25
        """
        cells, column = list(rows), Column(digits=digits)
        columns = zip(*cells, strict=True) if cells else ((),) * len(headings)
        return cls(title, {name: (column, list(values)) for name, values in zip(headings, columns, strict=True)})

    def for_joint(self, joint_type: JointType) -> Listing:
        """Return the table for a joint of a type, from that of a hinge."""
        return dataclasses.replace(self, columns=_for_joint(self.columns, joint_type))

    def header(self) -> list[tuple[str, str]]:
        """Title and shown unit of each column."""
        return [
            (column.title or name.replace("_", " "), column.shown_unit) for name, (column, _) in self.columns.items()
        ]

    def rows(self) -> list[list[str]]:
        """Cells as text, in shown units."""
        cells = [
            [printable(column.cell(value), _LONGEST_CELL) for value in values]
            for column, values in self.columns.values()
        ]
        return [list(row) for row in zip(*cells, strict=True)]

    def to_dict(self) -> dict[str, object]:
        """Return title, and the columns with units, as plain data in SI."""
        columns = {
            name: {"title": column.title or name.replace("_", " "), "unit": column.unit, "values": _plain(values)}
            for name, (column, values) in self.columns.items()
        }
        return {"title": self.title, "columns": columns}

    def to_html(self) -> str:
        """Return an HTML table."""
        header = [f"{title} [{unit}]" if unit not in ("", "1") else title for title, unit in self.header()]
        rows = (
            [[title, *cells] for title, cells in zip(header, zip(*self.rows(), strict=True), strict=True)]
            if self.vertical
            else self.rows()
        )
        caption = f"<caption>{escape(self.title)}</caption>" if self.title else ""
        head = "" if self.vertical else _html_row(header, "th")
        return f"<table>{caption}{head}{''.join(_html_row(row, 'td') for row in rows)}</table>"

    def to_text(self, width: int = 80) -> str:
        """Return the table as text of at most `width` characters; a wider one continues below, with its first column.

        Of more than 30 rows of samples, those in the middle are left out, which is said below.

            >>> print(Listing("Fits", {"law": (Column(), ["Chou"]), "rmse": (Column("N", "error"), [1.25])}).to_text())
            Fits
            law   error
                    [N]
            Chou   1.25
        """
        lines = [self.title] if self.title else []
        rows = self.rows()
        if self.vertical:
            return "\n".join(lines + _pairs(self.header(), [cell for row in rows for cell in row], width))
        samples = bool(rows) and _NUMBER.fullmatch(rows[0][0])
        omitted = max(len(rows) - _MOST_ROWS, 0) if samples else 0  # a list of names is shown whole
        displayed = rows[: _MOST_ROWS // 2] + rows[-(_MOST_ROWS // 2) :] if omitted else rows
        cells = list(zip(*displayed, strict=True)) if displayed else [()] * len(self.columns)
        columns = [_TextColumn(*title, column, width) for title, column in zip(self.header(), cells, strict=True)]
        for block in _blocks(columns, width):
            lines += _lines(block, width)
        return "\n".join([*lines, f"({omitted} rows in the middle are left out)"] if omitted else lines)


class _TextColumn:
    """A column of a text table: its cells, the words of its heading, and its narrowest width.

    Words are not broken unless they are longer than half of the table.
    """

    def __init__(self, title: str, unit: str, cells: Sequence[str], table: int) -> None:
        self.unit = f"[{unit}]" if unit not in ("", "1") else ""
        self.cells = cells
        self.title = title
        self.numeric = all(_NUMBER.fullmatch(cell) for cell in cells)
        words = max(map(len, title.split()), default=0)
        longest = max((len(word) for cell in cells for word in cell.split()), default=0)
        self.width = max(longest if self.numeric else min(longest, table // 2), words, len(self.unit))

    def wrapped(self, text: str) -> list[str]:
        """Lines of a cell."""
        return textwrap.wrap(text, self.width) or [""]

    def aligned(self, text: str) -> str:
        """A line of a cell, numbers to the right."""
        return text.rjust(self.width) if self.numeric else text.ljust(self.width)


_NUMBER = re.compile(r"-|[-+]?(\d+(\.\d*)?(e[-+]?\d+)?|inf)", re.IGNORECASE)


def _blocks(columns: Sequence[_TextColumn], width: int) -> Iterator[list[_TextColumn]]:
    """Groups of columns that fit side by side, each with the first column."""
    block: list[_TextColumn] = []
    for column in columns:
        if len(block) > 1 and sum(c.width + 2 for c in block) + column.width > width:
            yield block
            block = [columns[0]]
        block.append(column)
    if block:
        yield block


def _lines(block: Sequence[_TextColumn], width: int) -> list[str]:
    """Lines of columns side by side; what is left of the width goes to headings and sentences that need it."""
    needs = {c: max(map(len, (c.title, *c.cells))) - c.width for c in block}
    spare = width - sum(c.width + 2 for c in block) + 2
    for remaining, (column, need) in enumerate(sorted(needs.items(), key=lambda item: item[1]), start=-len(block)):
        share = max(min(need, spare // -remaining), 0)
        column.width, spare = column.width + share, spare - share
    headings = [column.wrapped(column.title) for column in block]
    deepest = max(map(len, headings))
    rows = [[[""] * (deepest - len(heading)) + heading for heading in headings]]
    if any(column.unit for column in block):
        rows.append([[column.unit] for column in block])
    rows += [
        [column.wrapped(cell) for column, cell in zip(block, row, strict=True)]
        for row in zip(*(c.cells for c in block), strict=True)
    ]
    lines = []
    for row in rows:
        cells = itertools.zip_longest(*row, fillvalue="")
        lines += ["  ".join(map(_TextColumn.aligned, block, line)).rstrip() for line in cells]
    return lines


def _pairs(header: Sequence[tuple[str, str]], values: Sequence[str], width: int) -> list[str]:
    """Lines of title, value and unit, one below the other; a value of less than half of the width is in one line."""
    texts = [
        f"{value} {unit}" if unit not in ("", "1") else value for (_, unit), value in zip(header, values, strict=True)
    ]
    room = width - 3 - max((min(len(text), width // 2) for text in texts), default=0)
    widest = min(max((len(title) for title, _ in header), default=0), room)
    lines = []
    for (title, _), text in zip(header, texts, strict=True):
        columns = textwrap.wrap(title, widest), textwrap.wrap(text, width - widest - 3)
        lines += [
            f"{left:{widest}}   {right}".rstrip() for left, right in itertools.zip_longest(*columns, fillvalue="")
        ]
    return lines


def _html_row(cells: Iterable[str], tag: str) -> str:
    return f"<tr>{''.join(f'<{tag}>{escape(cell)}</{tag}>' for cell in cells)}</tr>"


def _dimensions(value: object) -> int:
    """Axes of a value, 0 of a number or a text."""
    return getattr(value, "ndim", int(isinstance(value, list | tuple)))


def _plain(values: object) -> object:
    """Arrays as lists, numbers as numbers, all else as text."""
    if hasattr(values, "tolist"):
        values = values.tolist()
    if isinstance(values, complex):
        return [values.real, values.imag]
    if isinstance(values, list | tuple):
        return [_plain(value) for value in values]
    return json_ready(values) if isinstance(values, str | int | float | None) else str(values)


def _modified(path: Path) -> int | None:
    """Time of the last change of a file [ns], None without one."""
    return path.lstat().st_mtime_ns if os.path.lexists(path) else None


def figure_files(*figures: str) -> list[str]:
    """Names of the files of figures.

    >>> figure_files("fit")
    ['fit.png', 'fit.svg']
    """
    return [f"{name}.{end}" for name in figures for end in ("png", "svg")]


def draw(figure: str, *results: object) -> Figure:
    """Return a figure of `mckibben.report`."""
    return call("draw", figure, *results)


@dataclass_transform(frozen_default=True, field_specifiers=(column, field))
class Result(Suggesting):
    """Base of results: a frozen dataclass whose fields with a `column` are its numbers.

    Subclasses declare fields as ``gain: np.ndarray = column("1", "gain margin")``: a number or text is a
    scalar, an array of one dimension a column of the table, an array of more dimensions only in NetCDF and JSON. Other
    fields are not shown. Properties may be a `number`, methods a further `table`; numbers whose names are known to the
    object alone are added by overriding `declared`. Subclasses override `verdict` and `remarks`, and name `figures`.
    """

    figures: ClassVar[tuple[str, ...]] = ()
    """Functions of `mckibben.report` that draw the result; the names of their files, too."""
    heading: ClassVar[str] = ""
    """Title of the table of the declared columns."""
    files: ClassVar[tuple[str, ...]] = ()
    """Names of further files that `write` may write."""

    writers: ClassVar[Mapping[str, Callable[[Path], None]]] = MappingProxyType({})
    """Functions that write further files of this object alone, by their path in the folder; see `with_files`."""
    drawings: ClassVar[Mapping[str, Callable[[], Figure]]] = MappingProxyType({})
    """Functions that draw further figures of this object alone, by name."""

    def __init_subclass__(cls) -> None:
        super().__init_subclass__()
        dataclass(frozen=True, eq=False, repr=False)(cls)

    @property
    def joint_type(self) -> JointType:
        """Joint type of its numbers, which are declared for a hinge."""
        return HINGE

    def verdict(self) -> str:
        """Return the one sentence that the user needs first."""
        return ""

    def remarks(self) -> Iterable[Remark]:
        """Return remarks, the most severe ones first or not."""
        return ()

    @property
    def ok(self) -> bool:
        """Whether no remark is severe; the exit code of a command is 1 otherwise."""
        return all(remark.severity is not Severity.SEVERE for remark in self.remarks())

    def listings(self) -> Iterable[Listing]:
        """Return the tables: the declared scalars and columns, each with its details apart, then each `table`."""
        scalars, columns = {}, {}
        for name, (column, value) in self.converted().items():
            if _dimensions(value) == 0:
                scalars[name] = column, [value]
            elif not column.dims:
                columns[name] = column, value
        for listing in (Listing("", scalars, vertical=True), Listing(self.heading, columns)):
            for detail in (False, True):
                chosen = {name: entry for name, entry in listing.columns.items() if entry[0].detail == detail}
                if chosen and detail and not listing.vertical:
                    chosen = dict(itertools.islice(columns.items(), 1)) | chosen
                yield from [dataclasses.replace(listing, columns=chosen, detail=detail)] if chosen else []
        yield from self._tables()

    def _tables(self) -> Iterator[Listing]:
        for name, listing in _marked(type(self), "_table").items():
            content = getattr(self, name)()
            if isinstance(content, Mapping):
                content = [dataclasses.replace(listing, columns=content)] if content else []
            yield from (each.for_joint(self.joint_type) for each in content)

    def declared(self) -> TableColumns:
        """Columns and values of the fields that declare one, then of the properties that are a `number`."""
        values = {name: (mark, getattr(self, name)) for name, mark in _declarations(type(self)).items()}
        missing = [name for name, (_, value) in values.items() if value is None and name not in vars(self)]
        return {name: value for name, value in values.items() if name not in missing}

    def converted(self) -> TableColumns:
        """Return what is `declared`, in the units of the joint."""
        return _for_joint(self.declared(), self.joint_type)

    def plot(self) -> Figure:
        """Return the first of the `figures`; `ParameterError` if there is none."""
        if not self.figures:
            raise ParameterError(f"a {type(self).__name__} has no figure", remedy="use its columns")
        return draw(self.figures[0], self)

    def with_files(
        self, writers: Mapping[str, Callable[[Path], None]], drawings: Mapping[str, Callable[[], Figure]] | None = None
    ) -> Self:
        """Return the result with functions that write and draw further files of this object alone.

        Parameters
        ----------
        writers
            Functions that write a file, by its path in the folder.
        drawings
            Functions that draw a figure, by its name.
        """
        result = copy.copy(self)
        vars(result).update(writers=writers, drawings=drawings or {})
        return result

    def write(self, folder: Path) -> None:
        """Write further files, named in `files`, to a folder."""

    # What follows from the above -------------------------------------------------------------------------------------

    def __repr__(self) -> str:
        return f"<{type(self).__name__}: {self.verdict()}>"

    def _repr_html_(self) -> str:
        remarks = "".join(f"<li>{escape(str(remark))}</li>" for remark in self._sorted_remarks(details=False))
        tables = "".join(listing.to_html() for listing in self.listings() if not listing.detail)
        text = f"<p>{escape(self.verdict())}</p>{f'<ul>{remarks}</ul>' if remarks else ''}{tables}"
        try:
            image = call("png_of", self.plot())
        except McKibbenError:  # without a figure, or without what it shows
            return text
        return (
            f'<img alt="{escape(type(self).__name__)}" src="data:image/png;base64,{b64encode(image).decode()}">{text}'
        )

    def to_text(self, *, width: int = 80, details: bool = False) -> str:
        """Return verdict, remarks and tables as text; with `details` notes and further tables, too."""
        lines = textwrap.wrap(self.verdict(), width)
        for remark in self._sorted_remarks(details=details):
            lines += textwrap.wrap(printable(str(remark)), width, subsequent_indent="  ")
        blocks = ["\n".join(lines)] if lines else []
        listings = list(self.listings())
        blocks += [listing.to_text(width) for listing in listings if details or not listing.detail]
        notes = sum(remark.severity is Severity.NOTE for remark in self.remarks())
        tables = sum(listing.detail for listing in listings)
        if not details and notes + tables:
            counts = [f"{n} {noun}{'s' * (n > 1)}" for n, noun in ((notes, "note"), (tables, "table")) if n]
            blocks.append(f"({' and '.join(counts)} more with --details)")
        return "\n\n".join(blocks)

    def to_dict(self) -> dict[str, object]:
        """Return verdict, remarks, scalars, columns and tables as plain data in SI; NaN and infinities are None.

        It is what `--json` prints; `results.json` has the names of all files, `files`, too.
        """
        scalars, columns = {}, {}
        for name, (column, value) in self.converted().items():
            entry = {"title": column.title or name.replace("_", " "), "unit": column.unit}
            if _dimensions(value) == 0:
                scalars[name] = {**entry, "value": json_ready(_plain(value))}
            else:
                columns[name] = {**entry, "values": json_ready(_plain(value))}
        return {
            "result": type(self).__name__,
            "ok": self.ok,
            "verdict": self.verdict(),
            "remarks": [
                {"severity": r.severity.value, "field": r.field, "text": r.text, "remedy": r.remedy}
                for r in self._sorted_remarks(details=True)
            ],
            "scalars": scalars,
            "columns": columns,
            "tables": [listing.to_dict() for listing in self._tables()],
        }

    def to_dataset(self) -> xarray.Dataset:
        """Return the declared scalars and arrays as an xarray dataset in SI, with units and titles as attributes.

        Arrays of one axis have the dimension "row", those of several the `dims` of their column.
        """
        import numpy as np
        import xarray as xr

        variables = {}
        for name, (column, value) in self.converted().items():
            values = np.asarray(value)
            dims = column.dims or ("row",) * values.ndim
            if values.dtype.kind != "O":
                variables[name] = dims, values, {"units": column.unit, "long_name": column.title}
        return xr.Dataset(variables, attrs={"result": type(self).__name__, "verdict": self.verdict()})

    def save(self, folder: str | Path, *, force: bool = False) -> list[str]:
        """Write results.json, the figures as PNG and SVG, and further files to a folder; return their names.

        Raises `FileError` if a file exists and `force` is not set; otherwise the files of an earlier result, which its
        results.json lists, are removed.
        """
        folder, names = make_folder(folder), self.saved_names()
        drawings = figure_files(*self.figures, *self.drawings)
        if force:
            remove_results(folder)
        else:
            check_free(folder, names)
        before = {name: _modified(folder / name) for name in names}
        self.write(folder)
        for name, write in self.writers.items():
            make_folder((folder / name).parent)
            write(folder / name)
        certain = "results.json", *drawings
        names = [name for name in names if name in certain or _modified(folder / name) != before[name]]
        write_json(folder / "results.json", self.saved(names))
        figures = {name: partial(draw, name, self) for name in self.figures} | dict(self.drawings)
        for name, figure in figures.items():  # last: they need the most time
            call("save_figure", figure(), folder, name)
        return names

    def saved(self, names: Sequence[str]) -> dict[str, object]:
        """Return the content of results.json beside files of these names."""
        return {**self.to_dict(), "files": list(names)}

    def saved_names(self) -> list[str]:
        """Names of the files that `save` may write for this object."""
        return list(dict.fromkeys([*self.file_names(), *self.writers, *figure_files(*self.drawings)]))

    @classmethod
    def file_names(cls) -> list[str]:
        """Names of the files that `save` may write."""
        return ["results.json", *cls.files, *figure_files(*cls.figures)]

    def _sorted_remarks(self, *, details: bool) -> list[Remark]:
        """Remarks by severity, without notes unless details are shown."""
        order = list(Severity)
        remarks = [r for r in self.remarks() if details or r.severity is not Severity.NOTE]
        return sorted(remarks, key=lambda remark: order.index(remark.severity))
