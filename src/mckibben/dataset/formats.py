"""Raw tables of files of any format."""

from __future__ import annotations

import functools
import os
import re
import stat
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from mckibben.dataset.child import LIMIT_REMEDY, call_in_child, limit_factor
from mckibben.dataset.encodings import decode
from mckibben.dataset.headers import LONGEST_NAME, parse_header
from mckibben.dataset.large_text import read_large_text
from mckibben.dataset.lvm import SIGNATURE, read_lvm
from mckibben.dataset.sheet import RawTable
from mckibben.dataset.text import read_text
from mckibben.errors import DatasetError, Problem
from mckibben.storage.files import similar_file

_SMALL = 2**20  # bytes: smaller texts are read in this process
_LARGEST = 2**28  # bytes of a file
_CELLS = 2**24  # of all columns
_PROBED = 4096  # bytes of a text searched for lines of JSON
_SHOWN = 1000  # corrupt rows of a file with few others
_OTHER_FORMATS = {
    b"\xd0\xcf\x11\xe0": ("a workbook in the format before 2007", "save it as .xlsx or CSV"),
    b"\x1f\x8b": ("compressed by gzip", "decompress it first"),
    **dict.fromkeys(
        (b"<!doctype", b"<html", b"<?xml", b"<table"),
        ("HTML or XML, which some programs name .xls", "open it in a spreadsheet, and save it as .xlsx or CSV"),
    ),
    b"sqlite format 3": ("an SQLite database", "export the table as CSV"),
    b"par1\x15": ("Parquet", "write a table: pandas.read_parquet(...).to_csv(...)"),
    b"%pdf": ("a PDF document", "ask for the table as CSV or .xlsx"),
    **dict.fromkeys(
        (b"\x89png", b"\xff\xd8\xff", b"gif8", b"ii*\0", b"mm\0*"),
        ("an image, not a table", "give the numbers that it shows, as CSV or .xlsx"),
    ),
}
"""First bytes, in small letters, of files that are not read, what they are, and the remedy."""
_JSON = re.compile(rb"""\s*(?:\{\s*"|\[\s*(?:\{\s*"|\[\s*["0-9.-]))""")  # not a table under [[mm]], say
_LINES_OF_JSON = re.compile(rb'\s*\{"[^\n]*\}\r?\n\s*\{"')
_HDF5 = b"\x89HDF\r\n\x1a\n"


def read_table(path: Path, mapping: Mapping[str, str], decimal: str = "") -> RawTable:
    """Columns of a text, .xlsx, .mat, .tdms, .lvm or HDF5 file; `mapping` assigns quantities to its headers.

    Binary files and large texts are read in the child process.
    """
    size, start = probe(path)
    if size > (most := _LARGEST * limit_factor()):
        problem = Problem(f"has {size / 1e6:.0f} MB, more than {most / 1e6:.0f}", remedy=LIMIT_REMEDY)
        raise DatasetError(str(path), [problem])
    if _is_binary(path, start) or size > _SMALL:
        return call_in_child(path, _read_within_limits, dict(mapping), decimal)
    return _read(path, mapping, decimal)


FILES_REMEDY = "name its files, several for one test: DIR/*.csv, in Python sorted(Path('DIR').glob('*.csv'))"


def probe(path: Path) -> tuple[int, bytes]:
    """Size and first bytes of a file; raises a `DatasetError` unless it is a regular file that can be read."""
    try:
        found = path.stat()
        if stat.S_ISREG(found.st_mode):
            with path.open("rb") as file:
                return found.st_size, file.read(520)
    except FileNotFoundError:
        remedy = FILES_REMEDY if "*" in path.name else similar_file(path)
        raise DatasetError(str(path), [Problem("there is no such file", remedy=remedy)]) from None
    except (OSError, ValueError) as error:
        raise DatasetError(str(path), [Problem(f"cannot be read: {error}")]) from None
    if stat.S_ISDIR(found.st_mode):
        raise DatasetError(str(path), [Problem("is a directory", remedy=FILES_REMEDY)])
    raise DatasetError(str(path), [Problem("is a pipe or a device", remedy="save its content in a file")])


def _is_binary(path: Path, start: bytes) -> bool:
    binary = (b"TDSm", b"PK\x03\x04", _HDF5, b"MATLAB 5.0", b"MATLAB 7.3")
    return start.startswith(binary) or start[512:] == _HDF5 or path.suffix.lower() == ".mat"


def _read_within_limits(path: Path, mapping: Mapping[str, str], decimal: str) -> RawTable:
    """Columns of a file, read in the child process."""
    table = _read(path, mapping, decimal)
    table.channels = [replace(one, unit=one.unit[:LONGEST_NAME]) for one in table.channels]  # a text may have 30 MB
    cells, most = sum(len(channel.cells) for channel in table.channels), _CELLS * limit_factor()
    if cells > most:
        raise DatasetError(str(path), [Problem(f"has {cells} cells, more than {most:.0f}", remedy=LIMIT_REMEDY)])
    corrupt, rows = len(table.corrupt), max((len(channel.cells) for channel in table.channels), default=0)
    if corrupt > max(rows, _SHOWN):  # a list of all would take the parent process much memory
        text = f"{corrupt} of {corrupt + rows} rows are corrupt: more than half cannot be left out"
        raise DatasetError(str(path), [Problem(text), *table.corrupt[:_SHOWN]])
    return table


def _read(path: Path, mapping: Mapping[str, str], decimal: str) -> RawTable:
    """Columns of a file, read in this process."""

    @functools.cache
    def known(header: str, unit: str) -> bool:
        return header in mapping or parse_header(header, unit, loose=True) is not None

    try:
        if path.stat().st_size > _SMALL and (table := read_large_text(path, known, decimal)) is not None:
            return table
        with path.open("rb") as file:
            data = file.read(os.fstat(file.fileno()).st_size)  # not what is added meanwhile
    except OSError as error:
        raise DatasetError(str(path), [Problem(f"cannot be read: {error}")]) from None

    if data.startswith(b"TDSm"):
        from mckibben.dataset.logger_files import read_tdms

        return read_tdms(path, data)
    if data.startswith(b"PK\x03\x04") and b"[Content_Types].xml" not in data:
        remedy = "extract it, or save the sheet as .xlsx or CSV"
        raise DatasetError(
            str(path), [Problem("is a ZIP archive or an OpenDocument file, not a workbook", remedy=remedy)]
        )
    if data.startswith(b"PK\x03\x04"):
        from mckibben.dataset.logger_files import read_excel

        return read_excel(path, data, known)
    if data.startswith(_HDF5) or data[512:520] == _HDF5:
        from mckibben.dataset.matlab import read_hdf5

        return read_hdf5(path, data)
    if data.startswith(b"MATLAB 5.0") or (path.suffix.lower() == ".mat" and data):
        from mckibben.dataset.matlab import read_matlab

        return read_matlab(path, data)
    head = data[:64].lstrip().lower()
    found = next((kind for start, kind in _OTHER_FORMATS.items() if head.startswith(start)), None)
    if _JSON.match(data) and not _LINES_OF_JSON.match(data[:_PROBED]):
        found = "JSON", "write a table: pandas.DataFrame(...).to_csv(...)"
    if found:
        raise DatasetError(str(path), [Problem(f"is {found[0]}", remedy=found[1])])
    text, zeros = decode(data, str(path))
    del data  # a large text is in memory once
    if path.suffix.lower() in (".yaml", ".yml"):
        from mckibben.config.document import read_document
        from mckibben.config.model import kind_of

        if kind := kind_of(read_document(text).data):
            raise DatasetError(str(path), [Problem(f"is {kind}", remedy="give a file of measurements")])
    read = read_lvm if text.startswith(SIGNATURE) else read_text
    return read(text, str(path), known, zeros=zeros, decimal=decimal)
