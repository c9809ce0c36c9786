"""Check of NetCDF files in the child process, before this process opens them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from mckibben.dataset.child import call_in_child, limit_factor
from mckibben.errors import DatasetError, Problem

_DECODED = 2**28  # bytes of all variables together that a small file may have
_BLOCK = 2**26  # bytes read at a time
_DEEPEST = 20  # groups in groups
_REMEDY = "save the file again, with its values in it"


def check_netcdf(path: Path) -> None:
    """Raise a `DatasetError` if a file loops, grows, crashes the HDF5 library or refers to other files."""
    call_in_child(path, _check, _DECODED * limit_factor())


def _check(path: Path, most: float) -> None:
    """Read everything that can loop or grow: attributes, texts, references, chunks."""
    import h5netcdf
    import h5py

    found: list[tuple[str, str]] = []
    try:
        status = path.stat()
        stored = min(status.st_size, 512 * getattr(status, "st_blocks", status.st_size))  # without holes
        with h5py.File(path, "r") as file:
            found = _problems(file, max(4 * stored, most))
        if not found:
            with h5netcdf.File(path, "r") as file:
                dict(file.attrs)
                for variable in file.variables.values():
                    dict(variable.attrs)
                    _ = variable.dimensions, variable.dtype, variable.shape
    except MemoryError:
        raise
    except Exception as error:  # h5py and h5netcdf raise almost any exception on a damaged file
        text = (str(error) or type(error).__name__).splitlines()[0][:1000]
        raise DatasetError(str(path), [Problem(f"cannot be read as NetCDF: {text}")]) from None
    if found:
        raise DatasetError(str(path), [Problem(text, field=name, remedy=_REMEDY) for name, text in found])


def _problems(file: Any, most: float) -> list[tuple[str, str]]:
    """Fields and problems of a file whose variables may have so many bytes together."""
    import h5py

    found: list[tuple[str, str]] = []
    decoded = 0
    visited: set[Any] = set()
    groups: list[tuple[str, Any, int]] = [("", file, 0)]
    while groups:
        prefix, group, depth = groups.pop()
        address = h5py.h5o.get_info(group.id).addr  # type: ignore[attr-defined]
        if depth > _DEEPEST or address in visited:
            found.append((prefix, "is a group in itself" if address in visited else "has groups nested too deep"))
            continue
        visited.add(address)
        dict(group.attrs)
        for key in group:
            name = f"{prefix}/{key}" if prefix else key
            if not isinstance(group.get(key, getlink=True), h5py.HardLink):
                found.append((name, "is a link"))
                continue
            node = group[key]
            dict(node.attrs)
            if isinstance(node, h5py.Group):
                groups.append((name, node, depth + 1))
            elif isinstance(node, h5py.Dataset) and node.shape is not None:
                if node.external or node.is_virtual:
                    found.append((name, "refers to other files"))
                    continue
                decoded += node.nbytes
                if decoded > most:
                    return [*found, (name, f"claims {node.size} values, which the file does not hold")]
                _read(file, node)
    return found


def _read(file: Any, node: Any) -> None:
    """Read a dataset by blocks, except for contiguous plain values."""
    import h5py
    import numpy as np

    if not node.size:
        return
    plain = node.id.get_create_plist().get_layout() == h5py.h5d.CONTIGUOUS and node.dtype.kind in "biufc"
    if plain:
        return
    axis = int(np.argmax(node.shape)) if node.shape else None
    if axis is None:
        blocks = [()]
    else:
        step = max(1, _BLOCK * node.shape[axis] // max(node.nbytes, 1))
        if node.chunks:
            step = -(-step // node.chunks[axis]) * node.chunks[axis]
        blocks = [(slice(None),) * axis + (slice(at, at + step),) for at in range(0, node.shape[axis], step)]
    for block in blocks:
        values = node[block]
        if h5py.check_ref_dtype(node.dtype):
            for reference in np.ravel(values):
                if reference:
                    file[reference][()]
