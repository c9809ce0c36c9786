"""Schema of an isobaric dataset, validation, and NetCDF and CSV files."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Callable, Hashable, Iterator, Mapping
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple, Self, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mckibben.dataset.raw import Budget, check_regular, hdf5_nodes, readable
from mckibben.dataset.table import refusal
from mckibben.errors import DatasetError, Problem, Suggesting
from mckibben.storage.files import atomic_write
from mckibben.units import atm

if TYPE_CHECKING:
    import xarray as xr

    from mckibben.dataset.table import Table

VACUUM = -atm
"""Lowest possible gauge pressure [Pa]: vacuum at a standard atmosphere."""

WORDS: Mapping[str, tuple[str, ...]] = {"direction": ("loading", "unloading"), "phase": ("filling", "venting")}
"""Categorical variables and their values; an empty text is unknown."""


class Variable(NamedTuple):
    """Variable of the table."""

    unit: str
    long_name: str
    required: bool = False
    dims: tuple[str, ...] = ("point",)


VARIABLES: Mapping[str, Variable] = {
    "pressure": Variable("Pa", "gauge pressure", required=True),
    "contraction": Variable("1", "contraction, positive when shorter", required=True),
    "force": Variable("N", "axial pull", required=True),
    "direction": Variable("1", "loading (being stretched) or unloading (shortening)"),
    "phase": Variable("1", "filling or venting at a fixed length"),
    "repeat": Variable("1", "number of the repeat"),
    "time": Variable("s", "time since the start of the test"),
    "set_pressure": Variable("Pa", "nominal gauge pressure"),
    "set_force": Variable("N", "nominal load, held while the pressure changes"),
    "force_spread": Variable("N", "standard deviation of the force over the samples of a point"),
}
"""Variables of a dataset; the first gives the number of points."""

RECORDED: Mapping[str, Variable] = {
    name: VARIABLES[name]._replace(required=required, dims=("sample",))
    for required, names in ((True, ("time", "pressure", "force")), (False, ("contraction", "set_pressure")))
    for name in names
}
"""Variables of a recording; the first gives the number of samples."""


def normalize(table: xr.Dataset, schema: Mapping[str, Variable]) -> tuple[xr.Dataset, list[Problem]]:
    """Normalised read-only table, and all problems found; samples are not copied.

    Parameters
    ----------
    table
        Variables of the schema; others are kept as they are.
    schema
        `VARIABLES` of points, or `RECORDED` samples.
    """
    problems = list(_structure(table, schema))
    if problems:
        return table, problems
    columns: dict[str, tuple[tuple[str, ...], np.ndarray, dict[str, str]]] = {}
    for name, variable in schema.items():
        if name in table:
            values = _settled(name, table[name].to_numpy(), variable.dims)
            problems += _value_problems(name, values, variable.dims[0])
            columns[name] = (variable.dims, values, {"units": variable.unit, "long_name": variable.long_name})
    attrs, wrong = _normalize_attributes(table.attrs)
    problems += wrong
    if not problems:
        table = table.assign(columns)
        table.attrs = attrs
    return table, problems


def _normalize_attributes(attrs: Mapping[Hashable, Any]) -> tuple[dict[Hashable, Any], list[Problem]]:
    """Attributes with defaults, and all problems found."""
    attrs, problems = dict(attrs), []
    for name in ("specimen", "source"):
        attrs[name] = str(attrs.get(name, ""))
    for name, default in (("slack_force", 0.0), ("initial_length", None)):
        value = attrs.pop(name, None)
        if (value := default if value is None else value) is None:
            continue
        try:
            attrs[name] = number = math.nan if isinstance(value, bool | np.bool_) else float(value)
        except (TypeError, ValueError, OverflowError):
            number = math.nan
        if not math.isfinite(number):
            problems.append(Problem(f"{value!r} is not a finite number", field=name))
        elif name == "initial_length" and number <= 0:
            problems.append(Problem(f"{number:g} m is not above 0", field=name))
    return attrs, problems


def assemble(variables: Mapping[str, ArrayLike | None], schema: Mapping[str, Variable], word: str) -> xr.Dataset:
    """Table of the array-likes that are not None.

    Raises a `DatasetError` of `word` with all problems of their shapes.

    >>> assemble({"pressure": [1e5, 2e5], "force": [3.0]}, VARIABLES, "dataset")
    Traceback (most recent call last):
    mckibben.errors.DatasetError: dataset: 1 problem
      force: has 1 values for 2 points
    """
    import xarray as xr

    arrays: dict[str, np.ndarray] = {}
    problems: list[Problem | None] = []
    for name, values in variables.items():
        try:
            arrays |= {name: np.asarray(values)} if values is not None else {}
        except ValueError:
            problems.append(Problem("has rows of unequal length", field=name))
    first = next(iter(schema))
    count = arrays[first].size if first in arrays else 0
    problems += [_shape_problem(name, array.shape, count, schema[name].dims) for name, array in arrays.items()]
    if wrong := [problem for problem in problems if problem]:
        raise DatasetError(word, wrong)
    return xr.Dataset({name: (schema[name].dims, array) for name, array in arrays.items()})


def _shape_problem(name: str, shape: tuple[int, ...], count: int, dims: tuple[str, ...]) -> Problem | None:
    if len(shape) != len(dims):
        return Problem(f"has {len(shape)} dimensions instead of {len(dims)} ({', '.join(dims)})", field=name)
    if shape[0] != count:
        return Problem(f"has {shape[0]} values for {count} {dims[0]}s", field=name)
    return None


def _structure(table: xr.Dataset, schema: Mapping[str, Variable]) -> Iterator[Problem]:
    for name, variable in schema.items():
        if name not in table:
            if variable.required:
                yield Problem("is missing", field=name)
            continue
        array = table[name]
        if array.dims != variable.dims:
            yield Problem(f"has dimensions {array.dims} instead of {variable.dims}", field=name)
        elif array.size and array.dtype.kind not in ("UOT" if name in WORDS else "fiu"):
            what = " and ".join(WORDS.get(name, ("numbers",)))
            yield Problem(f"contains values other than {what}", field=name)
        unit = array.attrs.get("units", variable.unit)
        if not (isinstance(unit, str) and unit == variable.unit):  # an array is possible in a damaged file
            yield Problem(f"is in {str(unit)!r:.60}", field=name, remedy=f"give it in {variable.unit!r}")


def _settled(name: str, values: np.ndarray, dims: tuple[str, ...]) -> np.ndarray:
    if "sample" in dims:
        as_column = np.asarray(values, np.float64).view()
    elif name in WORDS:
        as_column = np.array(values, "<U9")
    elif name == "repeat" and np.all(np.isfinite(values) & (values == np.round(values))):
        as_column = np.array(values, np.int64)
    else:
        as_column = np.array(values, np.float64)
    as_column.setflags(write=False)
    return as_column


def _value_problems(name: str, values: np.ndarray, place: str) -> Iterator[Problem]:
    """Problems of the values of a variable."""
    if name in WORDS:
        if (bad := ~np.isin(values, [*WORDS[name], ""])).any():
            yield _first(bad, values, name, "is neither " + " nor ".join(map(repr, WORDS[name])), "", place)
        return
    finite = np.isfinite(values)
    if name in ("set_pressure", "set_force"):
        finite |= np.isnan(values)  # unknown
    if not finite.all():
        yield _first(~finite, values, name, "is not finite", "", place)
    if "pressure" in name and (bad := values < VACUUM).any():
        yield _first(bad, values, name, f"is below {VACUUM:g} Pa, the gauge pressure of a vacuum", "", place)
    if name == "contraction" and (bad := finite & (np.abs(values) >= 1)).any():
        remedy = "contraction is a ratio: divide percent by 100, or name the column contraction_percent"
        yield _first(bad, values, name, "is not between -1 and 1", remedy, place)
    if name == "repeat" and (bad := finite & ((values < 0) | (values != np.round(values)))).any():
        yield _first(bad, values, name, "is not an integer from 0 up", "", place)


def _first(bad: np.ndarray, values: np.ndarray, name: str, what: str, remedy: str, place: str) -> Problem:
    at = tuple(int(index) for index in np.argwhere(bad)[0])
    count = int(bad.sum())
    more = f" (and {count - 1} more)" if count > 1 else ""
    value = values[at].item()
    shown = f"{value:g}" if isinstance(value, float) else repr(value)
    return Problem(f"{shown} at {place} {at[0]} {what}{more}", field=name, remedy=remedy)


def format_range(values: np.ndarray) -> str:
    """Range of values as text.

    >>> format_range(np.array([2.5, 1.0]))
    '1..2.5'
    """
    low, high = f"{values.min():.4g}", f"{values.max():.4g}"
    return low if low == high else f"{low}..{high}"


def write_netcdf(table: xr.Dataset, path: Path) -> None:
    """Write a table atomically.

    It is encoded in memory, as HDF5 crashes on a full disk. Raises an `OSError` if it cannot be written.
    """
    encoding = {str(name): {"_FillValue": None} for name, values in table.variables.items() if values.dtype.kind == "f"}
    content = table.to_netcdf(engine="h5netcdf", encoding=encoding)
    with atomic_write(path, overwrite=True) as sibling:
        sibling.write_bytes(content)


def load_netcdf(path: Path, *, lazy: bool = False) -> xr.Dataset:
    """Read a NetCDF file, or open it (`lazy`).

    Raises
    ------
    DatasetError
        If the file is missing or damaged, refers to other files, or claims more values than it may have.
    """
    import xarray as xr

    with readable(path, "NetCDF"):
        _check_netcdf(path, check_regular(path))
        if lazy:
            return xr.open_dataset(path, engine="h5netcdf", decode_times=False, cache=False)
        return xr.load_dataset(path, engine="h5netcdf", decode_times=False).drop_encoding()


def _check_netcdf(path: Path, size: int) -> None:
    """Check sizes and links of a file before its values are read."""
    import h5py

    budget = Budget(path, most=max(2**28, 4 * size))
    with h5py.File(path, "r") as file:
        links: list[str] = []
        file.visititems_links(lambda name, link: None if isinstance(link, h5py.HardLink) else links.append(name))
        for name, node in hdf5_nodes(file, budget).items():
            if node is None or links:
                raise refusal(path, "refers to other data", field=(links or [name])[0])
            if isinstance(node, h5py.Dataset) and node.shape is not None:
                budget.spend(size=node.nbytes)


def holds_own_table(path: Path) -> bool:
    """Whether a file is NetCDF that this program wrote, as its attributes say."""
    if path.suffix.lower() != ".nc" or not path.is_file():
        return False
    import h5py

    try:
        with h5py.File(path, "r") as file:
            return "slack_force" in file.attrs and "force" in file
    except Exception:  # h5py raises nearly every kind on a damaged file; the reader names the mistake
        with path.open("rb") as file:
            return file.read(3) != b"CDF"


Held = TypeVar("Held")


def load_validated(path: Path, make: Callable[[xr.Dataset], Held]) -> Held:
    """Object made from the table of a NetCDF file.

    Raises a `DatasetError` that names the file, also for problems that `make` finds.
    """
    table = load_netcdf(path)
    try:
        return make(table)
    except DatasetError as error:
        raise DatasetError(str(path), error.problems) from None


@dataclass(frozen=True, eq=False, repr=False)
class MeasuredTable(Suggesting):
    """Base of datasets: a table of measured points or samples that fits its schema.

    Attributes
    ----------
    table
        Variables of `schema` with ``units`` and ``long_name``, read-only, and attributes of the test.
    lines
        What was understood of each file, with its lines; empty for a dataset of arrays, or of selected points.
    """

    suggestions: ClassVar[Mapping[str, str]] = {
        "fit": "mk.identify(data, 'exponential')",
        "identify": "mk.identify(data, 'exponential')",
        "save": "to_netcdf(path)",
    }
    schema: ClassVar[Mapping[str, Variable]]
    """Variables; the first gives the length."""
    word: ClassVar[str] = "dataset"
    """Name in errors."""

    table: xr.Dataset
    lines: tuple[Table, ...] = ()

    def __post_init__(self) -> None:
        table, problems = normalize(self.table, self.schema)
        if problems:
            raise DatasetError(self.word, problems)
        object.__setattr__(self, "table", table)

    @property
    def pressure(self) -> NDArray[np.float64]:
        """Gauge pressure [Pa], read-only."""
        return self.table["pressure"].to_numpy()

    @property
    def force(self) -> NDArray[np.float64]:
        """Axial pull [N], read-only."""
        return self.table["force"].to_numpy()

    def __len__(self) -> int:
        return self.pressure.size

    def place(self, row: int) -> str:
        """Line of a point in its file, or its row from 1, as text; `row` is counted from 0."""
        at = row
        for part in self.lines:
            if at < len(part.lines):
                return f"{part.place} {part.lines[at]}{f' of {part.path}' if len(self.lines) > 1 else ''}"
            at -= len(part.lines)
        return f"row {row + 1}"

    def _repr_html_(self) -> str:
        read = str(self.table.attrs.get("columns_read", ""))
        return f"<p>{escape(repr(self))}</p>{f'<pre>{escape(read)}</pre>' if read else ''}{self.table._repr_html_()}"

    def to_netcdf(self, path: str | os.PathLike[str]) -> None:
        """Write everything to a NetCDF-4 file atomically; `from_netcdf` reads it back."""
        write_netcdf(self.table, Path(path))

    @classmethod
    def from_netcdf(cls, path: str | os.PathLike[str]) -> Self:
        """Read a file of `to_netcdf`; raises a `DatasetError` if it is missing or does not fit."""
        return load_validated(Path(path), cls)


_CSV_HEADERS = "pressure_Pa contraction_ratio force_N direction phase repeat time_s set_pressure_Pa set_force_N"
CSV_COLUMNS = dict(zip(VARIABLES, _CSV_HEADERS.split(), strict=False))


def write_csv(table: xr.Dataset, path: Path) -> None:
    """Write points as CSV: comments, header, and a row per point with nine digits.

    Raises an `OSError` if the file cannot be written; an earlier one then stays.
    """
    attrs = table.attrs
    comments = [f"# specimen: {quote(attrs['specimen'])}", f"# source: {quote(attrs['source'])}"]
    if "initial_length" in attrs:
        comments.append(f"# initial_length: {attrs['initial_length']:.9g} m")
    comments.append(f"# slack_force: {attrs['slack_force']:.9g} N")
    comments.append(f"# preprocessing: {quote(attrs.get('preprocessing', 'none'))}")  # not to be repeated
    if "repairs" in attrs:
        comments.append(f"# repairs: {quote(attrs['repairs'])}")
    rows = table[[name for name in CSV_COLUMNS if name in table]].to_dataframe().rename(columns=CSV_COLUMNS)
    rows = rows.replace("", "unknown")  # directions and phases
    text = rows.to_csv(index=False, lineterminator="\n", float_format="%.9g")
    with atomic_write(path, overwrite=True) as sibling:
        sibling.write_text("\n".join([*comments, text]), encoding="utf-8", newline="\n")


OF_FILE = ("repairs", "ignored_columns", "columns_read")
"""Attributes that describe the reading of a file."""


def quote(text: str) -> str:
    """Text for the rest of a line, as JSON if it would not be read back unchanged.

    >>> quote("DMSP-10"), quote(" x")
    ('DMSP-10', '" x"')
    """
    return text if text.isprintable() and text == text.strip() and not text.startswith('"') else json.dumps(text)


def unquote(text: str) -> str:
    """Inverse of `quote`; text that only looks quoted is left unchanged."""
    try:
        value = json.loads(text) if text.startswith('"') else text
    except ValueError:
        return text
    return value if isinstance(value, str) else text
