"""Child process that reads HDF5 and NetCDF files within limits of time and memory; run as a script by `hdf5_check`.

Each line of standard input is a request, each line of output its answer, in JSON. A damaged file can make the HDF5
library loop, exhaust the memory or crash: only this process ends.
"""

import json
import math
import sys
import time
from pathlib import Path
from typing import Any

_MEMORY = 2**29  # bytes in excess of the idle process
_SECONDS = 3, 50e6  # of processor time: minimum, plus a second per so many bytes
_CLAIMED = 2**26  # bytes that the datasets of a file may claim without having them
_SQUEEZED = 1100  # largest compression ratio: deflate's limit is 1032
_BLOCK = 2**26  # bytes read at a time
_DEEPEST = 20  # groups in groups


def _limit(size: int) -> None:
    try:
        import resource
    except ImportError:  # Windows: the time limit of the parent remains
        return
    seconds = math.ceil(time.process_time() + _SECONDS[0] + size / _SECONDS[1])
    limits = [(resource.RLIMIT_CPU, seconds), (resource.RLIMIT_CORE, 0)]
    if (memory := Path("/proc/self/statm")).exists():
        limits.append((resource.RLIMIT_AS, int(memory.read_text().split()[0]) * resource.getpagesize() + _MEMORY))
    for kind, most in limits:
        hard = resource.getrlimit(kind)[1]
        resource.setrlimit(kind, (most if hard < 0 else min(most, hard), hard))


def problems(path: str, *, netcdf: bool) -> list[tuple[str, str]]:
    """Fields and problems of a file; reads everything that can loop or grow: attributes, texts, references, chunks."""
    import h5py

    found: list[tuple[str, str]] = []
    unsupported = 0
    visited: set[Any] = set()
    groups: list[tuple[str, Any, int]] = []
    with h5py.File(path, "r") as file:
        groups.append(("", file, 0))
        while groups:
            prefix, group, depth = groups.pop()
            address = h5py.h5o.get_info(group.id).addr  # pyright: ignore[reportAttributeAccessIssue]
            if depth > _DEEPEST or address in visited:
                found.append((prefix, "is a group in itself" if address in visited else "has groups nested too deep"))
                continue
            visited.add(address)
            dict(group.attrs)
            for key in group:
                name = f"{prefix}/{key}" if prefix else key
                if not isinstance(group.get(key, getlink=True), h5py.HardLink):
                    found += [(name, "is a link")] if netcdf else []
                    continue
                node = group[key]
                dict(node.attrs)
                if isinstance(node, h5py.Group):
                    groups.append((name, node, depth + 1))
                elif isinstance(node, h5py.Dataset) and node.shape is not None:
                    if node.external or node.is_virtual:
                        found += [(name, "refers to other files")] if netcdf else []
                        continue
                    missing = node.nbytes - _SQUEEZED * node.id.get_storage_size()
                    unsupported += max(missing, 0)
                    if unsupported > _CLAIMED:
                        found.append((name, f"claims {node.size} values, which the file does not hold"))
                        return found
                    _read(file, node)
    if netcdf and not found:
        _read_netcdf(path)
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


def _read_netcdf(path: str) -> None:
    import h5netcdf

    with h5netcdf.File(path, "r") as file:
        dict(file.attrs)
        for variable in file.variables.values():
            dict(variable.attrs)
            _ = variable.dimensions, variable.dtype, variable.shape


def _serve() -> None:
    import h5netcdf  # noqa: F401  before the memory is limited

    for line in sys.stdin:
        request = json.loads(line)
        try:
            _limit(Path(request["path"]).stat().st_size)
            answer: dict[str, Any] = {"problems": problems(request["path"], netcdf=request["netcdf"])}
        except MemoryError:
            answer = {"error": f"takes more than {_MEMORY >> 20} MiB of memory"}
        except Exception as error:  # h5py and h5netcdf raise almost any exception on a damaged file
            answer = {"error": (str(error) or type(error).__name__)[:1000]}
        sys.stdout.write(json.dumps(answer) + "\n")
        sys.stdout.flush()


if __name__ == "__main__":
    _serve()
