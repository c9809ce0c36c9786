"""Readers of MATLAB .mat and HDF5 files."""

from __future__ import annotations

import functools
import io
import re
import warnings
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from mckibben.dataset.child import MEMORY, limit_factor
from mckibben.dataset.sheet import RawColumn, RawTable, RowProblem, as_column, at_type_limit, not_applied, unreadable
from mckibben.errors import DatasetError, Problem

_DEEPEST = 6  # nested structs
_MOST = 4096  # columns of a file
_WIDEST = 64  # columns of a matrix
_UNITS = ("units", "unit", "unit_string")
_LABELS = ("columns", "column_names", "names", "labels", "fields")
_TABLE = "is a MATLAB object (a table?), which only MATLAB can open"
_TABLE_REMEDY = "save its columns: s = table2struct(t, 'ToScalar', true); save('rig.mat', '-struct', 's')"


def read_matlab(path: Path, data: bytes) -> RawTable:
    """Columns of a file of versions 4 to 7: vectors, fields (``rig.p``), columns of matrices (``rig(:,2)``)."""
    from scipy.io import loadmat

    sheet = RawTable(kind=RowProblem)
    load = functools.partial(loadmat, squeeze_me=True, struct_as_record=False)
    try:
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("error", np.exceptions.ComplexWarning)
                found = load(io.BytesIO(data), mat_dtype=True)
        except np.exceptions.ComplexWarning:  # as saved: the types of MATLAB would lose the imaginary parts
            found = load(io.BytesIO(data), mat_dtype=False)
    except MemoryError:
        raise
    except Exception as error:  # SciPy raises almost any exception on a damaged file
        raise unreadable(path, "a MATLAB file", error) from error
    for name, value in found.items():
        if not name.startswith("__"):
            _add(sheet, name, value, 0)
    return _checked(path, sheet)


def read_hdf5(path: Path, data: bytes) -> RawTable:
    """Columns of an HDF5 file: MATLAB 7.3, named as above, or another, named ``group/name``."""
    import h5py

    sheet = RawTable(kind=RowProblem)
    matlab = data.startswith(b"MATLAB 7.3")
    try:
        with h5py.File(io.BytesIO(data), "r") as file:
            for name, node in _nodes(file, "." if matlab else "/"):
                _add_node(sheet, name, node, matlab)
    except (DatasetError, MemoryError):
        raise
    except Exception as error:  # h5py raises almost any exception on a damaged file
        raise unreadable(path, "an HDF5 file", error) from error
    return _checked(path, sheet)


def _checked(path: Path, sheet: RawTable) -> RawTable:
    if not sheet.channels and not sheet.problems:
        ignored = f"; it has {', '.join(sheet.ignored[:20])}" if sheet.ignored else ""
        raise DatasetError(str(path), [Problem(f"has no column of numbers{ignored}")])
    most = max((len(channel.cells) for channel in sheet.channels), default=0)
    short = [channel.name for channel in sheet.channels if len(channel.cells) < most]
    scales = [name for name in [*sheet.ignored, *short] if not_applied({re.split(r"[./]", name)[-1]: None})]
    sheet.suspect += [f"{name!r} is not a column, and is not applied to others" for name in scales]
    return sheet


def _add(sheet: RawTable, name: str, value: Any, depth: int, unit: object = "") -> None:
    """Add the columns of a variable; a struct in it named units has those of its fields."""
    from scipy.io.matlab import MatlabOpaque, mat_struct

    if isinstance(value, MatlabOpaque):
        text = np.ravel(value)[0]["s0"]
        sheet.problems.append(Problem(_TABLE, field=getattr(text, "decode", text.__str__)(), remedy=_TABLE_REMEDY))
    elif isinstance(value, mat_struct):
        if depth >= _DEEPEST:
            sheet.ignored.append(name)
            return
        units = next((getattr(value, each) for each in _UNITS if hasattr(value, each)), None)
        for field in value._fieldnames:  # type: ignore[attr-defined]
            _add(sheet, f"{name}.{field}", getattr(value, field), depth + 1, getattr(units, field, ""))
    elif type(value) is np.ndarray and value.dtype.kind in "biuf":
        _columns(sheet, name, value, unit=unit if isinstance(unit, str) else "")
    elif type(value) is np.ndarray and value.dtype.kind == "O" and not any(isinstance(c, mat_struct) for c in value):
        cells = as_column([_one(cell) for cell in value])
        sheet.channels.append(RawColumn(name, cells, range(1, len(cells) + 1), short=name.rpartition(".")[2]))
    else:
        sheet.ignored.append(name)


def _one(cell: Any) -> object:
    """Number or text of a cell of a cell array."""
    if isinstance(cell, np.ndarray):
        return cell.item() if cell.size == 1 else None
    return cell


def _columns(
    sheet: RawTable,
    name: str,
    array: np.ndarray,
    separator: str = ".",
    unit: str = "",
    notes: tuple[str, ...] = (),
    missing: np.ndarray | None = None,
    labels: Sequence[str] = (),
) -> None:
    """Add the columns of a matrix, labelled or numbered as in MATLAB; `missing` marks its missing values."""
    notes += at_type_limit(array)
    matrix = array.reshape(-1, 1) if array.ndim == 1 or (array.ndim == 2 and 1 in array.shape) else array
    if len(sheet.channels) >= _MOST or matrix.ndim > 2 or matrix.size <= 1 or matrix.shape[1] > _WIDEST:
        sheet.ignored.append(name)
        return
    for column, values in enumerate(np.ascontiguousarray(matrix.T, dtype=np.float64)):
        full = name if matrix.shape[1] == 1 else f"{name}(:,{column + 1})"
        short = labels[column] if len(labels) == matrix.shape[1] else full.rpartition(separator)[2]
        rows = range(1, len(values) + 1)
        marked = () if missing is None else np.flatnonzero(missing.reshape(matrix.shape)[:, column]) + 1
        lines = frozenset(map(int, marked))
        sheet.channels.append(RawColumn(full, values, rows, short, unit, notes, lines))


def _nodes(group: Any, separator: str, prefix: str = "", depth: int = 0) -> Iterator[tuple[str, Any]]:
    """Datasets of a group and its subgroups. External links are not followed."""
    import h5py

    for key in group:
        if key.startswith("#") or not isinstance(group.get(key, getlink=True), h5py.HardLink):
            continue
        node = group[key]
        name = f"{prefix}{separator}{key}" if prefix else key
        if isinstance(node, h5py.Group) and depth < _DEEPEST:
            yield from _nodes(node, separator, name, depth + 1)
        elif isinstance(node, h5py.Dataset):
            yield name, node


def _add_node(sheet: RawTable, name: str, node: Any, matlab: bool) -> None:
    if node.shape is not None and node.nbytes > MEMORY // 4 * limit_factor():
        sheet.problems.append(Problem(f"claims {node.size} values, more than can be read", field=name))
        return
    kind = _text(node.attrs, "MATLAB_class") if matlab else ""
    if node.is_virtual or node.external or node.ndim > 2 or node.shape is None:
        sheet.ignored.append(name)
        return
    if kind in ("table", "timetable", "string", "datetime", "duration"):
        sheet.problems.append(Problem(_TABLE, field=name, remedy=_TABLE_REMEDY))
    elif kind == "cell":
        words = [_referred(node.file, reference) for reference in np.ravel(node[()])[:]]
        sheet.channels.append(RawColumn(name, words, range(1, len(words) + 1), short=name.rpartition(".")[2]))
    elif node.dtype.names and not matlab and node.ndim == 1:  # records, as pandas and PyTables write them
        records = node[()]
        for field in records.dtype.names:
            if records[field].dtype.kind in "biuf":
                _columns(sheet, f"{name}/{field}", records[field], "/")
    elif kind == "char" or node.dtype.kind not in "biuf":
        sheet.ignored.append(name)
    else:
        try:
            values, notes, missing = (node[()], (), None) if matlab else _unpacked(node)
        except (TypeError, ValueError) as error:
            sheet.problems.append(Problem(f"its packing is not numeric: {error}", field=name))
            return
        units = [] if matlab else [name for name in node.attrs if name.lower() in _UNITS]
        unit = _text(node.attrs, units[0]) if units else ""
        labels = [] if matlab else [_labels(node.attrs[name]) for name in node.attrs if name.lower() in _LABELS]
        values = values.T if matlab else values
        _columns(sheet, name, values, "." if matlab else "/", unit, notes, missing, labels[0] if labels else ())


_APPLIED = ("scale_factor", "add_offset")


def _unpacked(node: Any) -> tuple[np.ndarray, tuple[str, ...], np.ndarray]:
    """Values by the conventions of NetCDF (scale and offset are applied), notes on them, and which are missing."""
    raw = np.asarray(node[()])
    attributes = {name.lower(): value for name, value in node.attrs.items()}

    def numbers(name: str) -> np.ndarray:
        return np.ravel(np.asarray(attributes[name], np.float64)) if name in attributes else np.empty(0)

    if _text(node.attrs, "_Unsigned").lower() == "true" and raw.dtype.kind == "i":
        raw = raw.view(f"u{raw.dtype.itemsize}")
    missing = np.isin(raw, np.concatenate([numbers("_fillvalue"), numbers("missing_value")]).astype(raw.dtype))
    lower, upper = numbers("valid_min"), numbers("valid_max")
    if len(limits := numbers("valid_range")) == 2:
        lower, upper = limits[:1], limits[1:]
    missing |= (raw < lower.max(initial=-np.inf)) | (raw > upper.min(initial=np.inf))
    scale, offset = numbers("scale_factor"), numbers("add_offset")
    if len(scale) > 1 or len(offset) > 1:
        raise ValueError("scale_factor and add_offset are single numbers")
    values = raw * (scale[0] if len(scale) else 1) + (offset[0] if len(offset) else 0)
    if missing.any():
        values = np.where(missing, np.nan, values)
    group = {name: value for name, value in node.parent.attrs.items() if name.lower() not in attributes}
    notes = not_applied({name: value for name, value in (attributes | group).items() if name not in _APPLIED})
    return values, notes if values.dtype == raw.dtype else at_type_limit(raw[~missing]) + notes, missing


def _referred(file: Any, reference: Any) -> str:
    """Text that a cell of a cell array refers to."""
    node = file[reference]
    codes = np.ravel(node[()])
    if codes.dtype.kind != "u" or codes.size > 1000:
        return ""
    return "".join(map(chr, codes.tolist()))


def _labels(attribute: Any) -> list[str]:
    """Names of the columns of a matrix: texts, or one text with commas."""
    texts = [one.decode("utf-8", "replace") if isinstance(one, bytes) else str(one) for one in np.ravel(attribute)]
    return [one.strip() for one in (texts[0].split(",") if len(texts) == 1 else texts)]


def _text(attrs: Mapping[str, Any], name: str) -> str:
    value = attrs.get(name, "")
    return value.decode("utf-8", "replace") if isinstance(value, bytes) else str(value)
