"""Which kind of file it is, by its first bytes: names lie more often."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from mckibben.dataset.decoding import decode, read_bytes
from mckibben.dataset.headers import recognise
from mckibben.dataset.lvm import SIGNATURE, read_lvm
from mckibben.dataset.sheet import Sheet
from mckibben.dataset.text import read_text
from mckibben.errors import DatasetError, Problem

_OLD_WORKBOOK = b"\xd0\xcf\x11\xe0"
_HDF5 = b"\x89HDF\r\n\x1a\n"


def read_sheet(path: Path, mapping: Mapping[str, str]) -> Sheet:
    """The columns of a file of any kind that is read.

    Parameters
    ----------
    path
        A text, .xlsx, .mat, .tdms, .lvm or HDF5 file.
    mapping
        Names of the file that the user has given a meaning.

    Raises
    ------
    DatasetError
        If it is none of these, or damaged so that nothing of it can be read.
    """
    data = read_bytes(path)

    def known(header: str, unit: str) -> bool:
        return header in mapping or recognise(header, unit) is not None

    if data.startswith(b"TDSm"):
        from mckibben.dataset.tdms import read_tdms

        return read_tdms(path, data)
    if data.startswith(b"PK\x03\x04"):
        from mckibben.dataset.excel import read_excel

        return read_excel(path, data, known)
    if data.startswith(_HDF5) or data[512:520] == _HDF5:
        from mckibben.dataset.matlab import read_hdf5

        return read_hdf5(path, data)
    if data.startswith(b"MATLAB 5.0") or (path.suffix.lower() == ".mat" and data):
        from mckibben.dataset.matlab import read_matlab

        return read_matlab(path, data)
    if data.startswith(_OLD_WORKBOOK):
        raise DatasetError(str(path), [Problem("is a workbook of before 2007", remedy="save it as .xlsx or CSV")])
    text, zeros = decode(data, str(path))
    if text.startswith(SIGNATURE):
        return read_lvm(text, str(path), known, zeros=zeros)
    return read_text(text, str(path), known, zeros=zeros)
