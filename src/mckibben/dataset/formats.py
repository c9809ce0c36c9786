"""Raw tables of workbooks, MATLAB, HDF5, NetCDF, TDMS, LabVIEW, MCAP and rosbag2 files, and of texts."""

from __future__ import annotations

import io
import math
import os
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from mckibben.dataset.bags import MCAP, SQLITE, read_bag
from mckibben.dataset.file_names import several
from mckibben.dataset.matlab import Value, read_variables
from mckibben.dataset.matrix import MATRIX, read_matrix
from mckibben.dataset.raw import (
    LARGEST_PLAIN,
    Budget,
    RawColumn,
    RawTable,
    check_regular,
    hdf5_nodes,
    needs,
    read_bytes,
    readable,
)
from mckibben.dataset.table import question, refusal
from mckibben.dataset.text import decode, read_lines, read_numbers, read_text
from mckibben.dataset.vocabulary import parse_header
from mckibben.dataset.workbook import read_workbook
from mckibben.errors import DatasetError, Problem

if TYPE_CHECKING:
    import h5py

ENDINGS = ("csv", "txt", "tsv", "dat", "lvm", "tdms", "xlsx", "mat", "h5", "hdf5", "nc", "mcap", "db3")
"""Usual endings of the files that `read_table` reads; first bytes tell the format, except for a MATLAB 4 file."""

_HDF5 = b"\x89HDF\r\n\x1a\n"
_OTHERS: Mapping[str, bytes] = {
    "JSON": rb'\s*(?:\{\s*"[^"\n]*"\s*:|\[\s*[\[{])',
    "Parquet": rb"PAR1",
    "a compressed file (unpack it)": rb"\x1f\x8b|BZh|7z\xbc\xaf|\xfd7zXZ|\x28\xb5\x2f\xfd",
    "an .xls of Excel 97 to 2003, or another document of Office": rb"\xd0\xcf\x11\xe0",
    "NetCDF 3": rb"CDF[\x01\x02\x05]",
    "an array of NumPy": rb"\x93NUMPY",
    "PDF": rb"%PDF",
    "XML or HTML": rb"(?i)\s*<(?:\?xml|!doctype|html|table)",
}
"""First bytes of formats that are not read, as regular expressions."""
_OTHER_REMEDY = "save its columns as CSV, .xlsx or NetCDF-4, of xarray by to_netcdf(path, engine='h5netcdf')"
_SAVE_COLUMNS = "save its columns: s = table2struct(t, 'ToScalar', true); save('rig.mat', '-struct', 's')"
_UNITS = ("units", "unit", "unit_string")
_LARGEST_ATTRIBUTE = 8  # numbers or texts
_FRAME = re.compile(r"(?i)(?:class|name|wf_|ni_|_?nc|_?netcdf|dimension|reference|pandas|field_|encoding|date|title)")
"""Attributes and properties that say nothing of numbers."""
_OBJECTS = ("table", "timetable", "string", "datetime", "duration")
_PACKING = ("scale_factor", "add_offset", "_fillvalue", "missing_value", "valid_range", "valid_min", "valid_max")


def read_table(path: Path, mapping: Mapping[str, str], decimal: str = "", part: str = "") -> RawTable:
    """Raw columns of a file of any format, which its first bytes tell.

    Parameters
    ----------
    mapping
        Headers of the recipe with their names, which are understood in any case.
    decimal
        Decimal sign of a text, if the recipe has one.
    part
        Sheet, group, struct or topic, of several.

    Raises
    ------
    DatasetError
        For a file that is missing, damaged, too large, or of a format that is not read; a known one has a remedy.
    """
    budget, is_folder, is_matrix = Budget(path), (path / "metadata.yaml").is_file(), {*MATRIX} <= {*mapping}
    plain = not (is_matrix or is_folder) and check_regular(path) <= LARGEST_PLAIN and os.access(path, os.R_OK)
    if plain and (table := read_numbers(path, mapping, decimal)) is not None:
        return table
    data = b"" if is_folder else read_bytes(path)
    if is_folder or data.startswith((MCAP, SQLITE)):
        return read_bag(path, data, part, mapping, budget)
    if data.startswith(b"PK\x03\x04"):
        return read_workbook(path, data, mapping, part, budget)
    if data.startswith(_HDF5) or data[512:520] == _HDF5:
        return _read_hdf5(path, data, part, mapping, budget)
    if data.startswith(b"MATLAB 5.0") or (path.suffix.lower() == ".mat" and data):
        return _read_matlab(path, data, part, mapping)
    if kind := next((kind for kind, begin in _OTHERS.items() if re.match(begin, data)), ""):
        raise refusal(path, f"is {kind}, which is not read", _OTHER_REMEDY)
    if data.startswith(b"TDSm"):
        return _read_tdms(path, data, part, mapping, budget)
    return read_text(decode(data, path), path, mapping, decimal, read_matrix if is_matrix else read_lines)


def _read_hdf5(path: Path, data: bytes, part: str, mapping: Mapping[str, str], budget: Budget) -> RawTable:
    """Columns of HDF5, NetCDF-4 and MATLAB 7.3 files, with scale, offset and fill values applied."""
    import h5py

    table = RawTable()
    matlab = data.startswith(b"MATLAB 7.3")
    with readable(path, "an HDF5 file"), h5py.File(io.BytesIO(data), "r") as file:
        table.words += _words("", _attributes(file))
        for place, node in hdf5_nodes(file, budget).items():
            if node is None:
                continue
            name = place.replace("/", ".") if matlab else place
            table.words += _words(name, _attributes(node))
            if isinstance(node, h5py.Dataset):
                _add_node(table, name, node, matlab, budget)
    return _one_group(path, table, part, mapping)


def _attributes(node: h5py.Group | h5py.Dataset) -> dict[str, Any]:
    """Attributes of at most 8 numbers or texts; larger ones are not read."""
    shapes = {key: node.attrs.get_id(key).shape for key in list(node.attrs)[:200]}
    small = [key for key, shape in shapes.items() if shape is not None and math.prod(shape) <= _LARGEST_ATTRIBUTE]
    return {key: node.attrs[key] for key in small}


def _words(name: str, attributes: Mapping[str, object]) -> list[tuple[None, str]]:
    """Attributes or properties that may say something of the numbers, of a channel with a name."""
    said = [key for key in attributes if key.lower() not in (*_UNITS, *_PACKING) and not _FRAME.match(key)]
    return [(None, f"{name} {key}: {_decoded(attributes[key])}".lstrip()) for key in said]


def _decoded(value: object) -> str:
    if isinstance(value, np.ndarray):
        return " ".join(map(_decoded, value.ravel().tolist()))
    return value.decode("utf-8", "replace") if isinstance(value, bytes) else str(value)


def _is_bare_dimension(node: h5py.Dataset, attributes: Mapping[str, object], name: str) -> bool:
    """Whether a scale of NetCDF is a dimension without a variable, or counts rows and has no quantity."""
    if node.ndim != 1 or not node.is_scale:
        return False
    bare = _decoded(attributes.get("NAME", "")).startswith("This is a netCDF dimension but not a netCDF variable")
    has_quantity = bool(parse_header(name, _unit(attributes)).quantity)
    return bare or (not has_quantity and np.array_equal(node[()], np.arange(node.size)))


def _add_node(table: RawTable, name: str, node: h5py.Dataset, matlab: bool, budget: Budget) -> None:
    """Add the columns of a dataset, or its single number or text as words."""
    attributes = _attributes(node)
    kind = _decoded(attributes.get("MATLAB_class", ""))
    if node.shape is None or node.ndim > 2 or (node.dtype.kind in "OS" and kind not in ("", *_OBJECTS)):
        return
    budget.spend(size=node.nbytes)
    if _is_bare_dimension(node, attributes, name):
        return
    value: Value = None
    if kind == "char":
        value = "".join(map(chr, np.ravel(node[()]).tolist()))[:1000]
    elif kind not in _OBJECTS:
        content = np.asarray(node[()])
        if node.dtype.kind in "OSV":
            value = _texts_or_records(content)
        else:
            value = content.T if matlab else _unpacked(content, attributes)
    _add_variable(table, name, value, _unit(attributes))


def _unit(attributes: Mapping[str, object]) -> str:
    return next((_decoded(attributes[key]) for key in attributes if key.lower() in _UNITS), "")


def _texts_or_records(cells: np.ndarray) -> Value:
    """Texts, a single one by itself, or the columns of numbers of records."""
    if cells.dtype.names:
        numbers = [key for key in cells.dtype.names if cells[key].dtype.kind in "iuf"]
        return {key: cells[key].astype(np.float64) for key in numbers}
    texts: list[Value] = [_decoded(text) for text in np.ravel(cells).tolist()]
    return texts[0] if len(texts) == 1 else texts


def _unpacked(raw: np.ndarray, attributes: Mapping[str, Any]) -> np.ndarray:
    """Values by the conventions of NetCDF: scale and offset applied; missing and invalid ones, and overflows, NaN."""
    attributes = {key.lower(): np.ravel(value) for key, value in attributes.items()}
    values = raw.astype(np.float64)
    if raw.dtype.kind in "iu":
        values[raw == np.iinfo(raw.dtype).max] = np.nan  # at the end of the range of its type
    for key in ("_fillvalue", "missing_value"):
        values[np.isin(raw, attributes.get(key, []))] = np.nan
    low, high = attributes.get(
        "valid_range", [*attributes.get("valid_min", [-np.inf]), *attributes.get("valid_max", [np.inf])]
    )
    values[(values < low) | (values > high)] = np.nan
    return values * attributes.get("scale_factor", [1.0])[0] + attributes.get("add_offset", [0.0])[0]


def _read_matlab(path: Path, data: bytes, part: str, mapping: Mapping[str, str]) -> RawTable:
    """Columns of versions 5 to 7: vectors, fields (``rig.p``), columns of matrices (``rig(:,2)``)."""
    if not data.startswith(b"MATLAB 5.0"):
        raise refusal(path, "is no MATLAB file of version 5 to 7.3", "save it in MATLAB with -v7")
    table = RawTable()
    with readable(path, "a MATLAB file"):
        variables = read_variables(data)
    for name, value in variables.items():
        _add_variable(table, name, value)
    return _one_group(path, table, part, mapping)


def _add_variable(table: RawTable, name: str, value: Value, unit: str = "") -> None:
    """Add the columns of a variable: vectors, matrices as numbered in MATLAB; single numbers and texts as words."""
    if value is None:
        text = "is an object of MATLAB (a table?), which only MATLAB can open"
        table.questions.append(question(text, field=name, remedy=_SAVE_COLUMNS))
    elif isinstance(value, str):
        table.words.append((None, f"{name}: {value}"))
    elif isinstance(value, dict):
        _add_struct(table, name, value)
    elif isinstance(value, list) and value and all(isinstance(cell, str) for cell in value):
        table.columns.append(RawColumn(name, [str(cell) for cell in value], label=re.split(r"[./]", name)[-1]))
    elif isinstance(value, list):
        for number, cell in enumerate(value, 1):
            if isinstance(cell, dict):
                _add_struct(table, f"{name}({number})", cell)
    elif value.size == 1:
        table.words.append((None, f"{name}: {value.item():g}"))
    elif (
        value.ndim < 3 and (matrix := value.reshape(-1, 1) if 1 in (value.ndim, *value.shape) else value).shape[1] < 65
    ):
        for at, cells in enumerate(matrix.T.astype(np.float64)):
            full = name if matrix.shape[1] == 1 else f"{name}(:,{at + 1})"
            table.columns.append(RawColumn(full, np.ascontiguousarray(cells), re.split(r"[./]", full)[-1], unit))


def _add_struct(table: RawTable, name: str, value: dict[str, Value]) -> None:
    """Add the fields of a struct.

    Those of Simulink have a time and signals with label and values, those of dSPACE Name, Data and Unit.
    """
    texts = {key.lower(): text for key, text in value.items() if isinstance(text, str)}
    label = texts.get("label", texts.get("name", ""))
    content = next((value[key] for key in ("values", "Data") if isinstance(value.get(key), np.ndarray)), None)
    if content is not None and label:
        _add_variable(table, f"{name}.{label}", content, texts.get("unit", texts.get("units", "")))
        return
    units = next((units for key in _UNITS if isinstance(units := value.get(key), dict)), {})
    for key, field in value.items():
        said = "s" if key == "time" and "signals" in value else units.get(key, "")  # of Simulink
        _add_variable(table, f"{name}.{key}", field, said if isinstance(said, str) else "")


def _read_tdms(path: Path, data: bytes, part: str, mapping: Mapping[str, str], budget: Budget) -> RawTable:
    """Columns of the channels of a TDMS file, with units and sampling interval of their properties."""
    with needs(path, "npTDMS", "tdms"):
        from nptdms import TdmsFile
    table = RawTable()
    intervals, starts = set(), set()
    with readable(path, "a TDMS file"), TdmsFile.open(io.BytesIO(data)) as file:
        table.words += _words("", file.properties)
        for group in file.groups():
            table.words += _words(group.name, group.properties)
            for channel in group.channels():
                budget.spend(size=8 * len(channel), rows=len(channel), columns=len(table.columns))
                name, said = f"{group.name}/{channel.name}", channel.properties
                table.words += _words(name, said)
                if channel.dtype is not None and channel.dtype.kind in "iuf":
                    values = np.asarray(channel[:], np.float64)
                    table.columns.append(RawColumn(name, values, channel.name, _unit(said)))
                elif channel.dtype is not None and len(channel):
                    table.columns.append(RawColumn(name, [str(cell) for cell in channel[:]], channel.name))
                intervals.add(said.get("wf_increment"))
                starts.add((said.get("wf_start_time"), said.get("wf_start_offset")))
    if len(intervals) == 1 and isinstance(step := intervals.pop(), float) and step > 0:
        table.interval = step
    if len(starts) > 1:
        text = "channels begin at different times: their rows do not belong together"
        table.questions.append(question(text, "layout", field="layout"))
    return _one_group(path, table, part, mapping)


def _one_group(path: Path, table: RawTable, part: str, mapping: Mapping[str, str]) -> RawTable:
    """Table of the columns of one length, of one group of measurements."""
    if part:
        chosen = re.compile(rf"{re.escape(part)}(?:[/.(]|$)")
        table.columns = [column for column in table.columns if chosen.match(column.name)]
    if not table.columns:
        none = Problem(f"has no column in {part!r}" if part else "has no column of numbers", remedy="give another file")
        raise DatasetError(str(path), [asked.problem for asked in table.questions] or [none])
    length = _common_length(path, table.columns, mapping)
    table.words += [
        (None, f"{column.name}: {column.cells[:8]}") for column in table.columns if len(column.cells) != length
    ]
    table.columns = [column for column in table.columns if len(column.cells) == length]
    table.lines = range(1, length + 1)
    return table


def _common_length(path: Path, columns: Sequence[RawColumn], mapping: Mapping[str, str]) -> int:
    """Length of all columns that are understood, or of the longest one if there are none.

    Raises a `DatasetError` if they differ: a question for the group of columns that is meant, if there are several.
    """
    read = [column for column in columns if column.header(mapping).quantity]
    lengths = {len(column.cells) for column in read} or {max(len(column.cells) for column in columns)}
    if len(lengths) > 1:
        grouped = [column.name for column in read if re.search(r"[/.(]", column.name)]
        names = sorted({re.split(r"[/.(][^/.(]*$", name)[0] for name in grouped})
        sizes = ", ".join(f"{column.name} ({len(column.cells)})" for column in read[:12])
        unequal = refusal(path, f"has columns of unequal length: {sizes}", "ignore the columns of another length")
        raise several(path, "groups", names) if len(names) > 1 else unequal
    return lengths.pop()
