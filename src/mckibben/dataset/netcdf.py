"""Tables to and from NetCDF-4 files, each of which appears complete or not at all."""

from __future__ import annotations

import mmap
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import xarray as xr

from mckibben.dataset.heap import heaps_are_sound
from mckibben.errors import DatasetError, Problem
from mckibben.files import whole


def write_netcdf(table: xr.Dataset, path: Path) -> None:
    """Write a table, samples included."""
    # Not compressed: the low bits of samples are noise, so that gzip and lzf make the file smaller by a quarter to a
    # half, but 5 to 10 times slower to read and 10 times slower to write (5.85 million samples: 47 MB in 20 ms).
    encoding = {str(name): {"_FillValue": None} for name, values in table.variables.items() if values.dtype.kind == "f"}
    with whole(path) as sibling:
        table.to_netcdf(sibling, engine="h5netcdf", encoding=encoding)


def load_netcdf(path: Path) -> xr.Dataset:
    """The content of a NetCDF file.

    Raises
    ------
    DatasetError
        If the file is not there, or is no NetCDF file.
    """
    try:
        with path.open("rb") as file:  # so that what the system objects to is told from what is wrong with the content
            if file.seek(0, 2) > 0:
                with mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content:
                    if not heaps_are_sound(content):
                        raise ValueError("a heap of texts is damaged")
        return xr.load_dataset(path, engine="h5netcdf", decode_times=False).drop_encoding()
    except ImportError:
        raise
    except Exception as error:  # h5py and h5netcdf raise nearly every kind on a damaged file
        raise DatasetError(str(path), [Problem(f"cannot be read as NetCDF: {_reason(error)}")]) from error


Held = TypeVar("Held")


def held_in(path: Path, make: Callable[[xr.Dataset], Held]) -> Held:
    """What a NetCDF file holds, made of its table; an error names the file.

    Raises
    ------
    DatasetError
        As `load_netcdf`, or with the problems that `make` finds.
    """
    table = load_netcdf(path)
    try:
        return make(table)
    except DatasetError as error:
        raise DatasetError(str(path), error.problems) from None


def _reason(error: Exception) -> str:
    text = getattr(error, "strerror", None) or str(error) or type(error).__name__
    return text.splitlines()[0]
