"""Parser of MATLAB files of versions 4 to 7, by their published format.

`scipy.io.loadmat` reads more (sparse matrices, objects), but a corrupt file can crash the process (SciPy 1.17 reads out
of bounds).
"""

from __future__ import annotations

import math
import struct
import zlib
from collections.abc import Iterator
from typing import Final

import numpy as np
from numpy.typing import NDArray

_LARGEST = 2**26  # bytes that the compressed variables of a small file may expand to
_SQUEEZED = 20  # largest compression ratio of a large file
_DEEPEST = 20  # nested arrays
_INTEGERS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 12: "i8", 13: "u8", 16: "u1", 17: "u2"}
_KINDS = {**_INTEGERS, 7: "f4", 9: "f8"}
_INTEGER_CLASSES = dict(enumerate(("i1", "u1", "i2", "u2", "i4", "u4", "i8", "u8"), 8))
_KINDS_4 = ("f8", "f4", "i4", "i2", "u2", "u1")
_MATRIX, _COMPRESSED = 14, 15
_CELL, _STRUCT, _CHAR, _FIRST_NUMBER, _LAST_NUMBER, _OPAQUE = 1, 2, 4, 6, 15, 17
_COMPLEX = 0x0800


class MatlabObject:
    """MATLAB object of a class outside the published format: tables, strings, times."""


class Unsupported:
    """Variable that is not a column: sparse and complex matrices, functions."""


Value = NDArray[np.float64] | str | list["Value"] | dict[str, "Value"] | MatlabObject | Unsupported
"""Matrix, shape (rows, columns, ...); text; cells of a cell array; fields of a struct of one element."""


class CorruptFileError(Exception):
    """Raised where bytes violate the format."""


def variables(data: bytes) -> Iterator[tuple[str, Value]]:
    """Variables of a file, by name."""
    if not data.startswith(b"MATLAB"):
        yield from _version_4(data)
        return
    if len(data) < 136 or data[126:128] not in (b"IM", b"MI"):
        raise CorruptFileError("its header is not that of a MATLAB file")
    reader = _Reader(memoryview(data), "<" if data[126:128] == b"IM" else ">")
    reader.at = 128
    left = max(_LARGEST, _SQUEEZED * len(data))
    while reader.at < len(data):
        kind, content = reader.element(padded=True)
        if kind == _COMPRESSED:
            unpacked = _unpacked(content, left)
            left -= len(unpacked)
            kind, content = _Reader(unpacked, reader.order).element()
        if kind != _MATRIX:
            raise CorruptFileError(f"an element of kind {kind} stands where a variable should")
        name, value = _array(content, reader.order, 0)
        if name:  # variables without a name are object data
            yield name, value


class _Reader:
    """Reader of consecutive elements."""

    def __init__(self, data: memoryview, order: str) -> None:
        self.data: Final = data
        self.order: Final = order
        self.at = 0

    def element(self, *, padded: bool = False) -> tuple[int, memoryview]:
        """Kind and content of the next element; compressed ones are not padded."""
        head = self._take(8)
        kind, size = struct.unpack(f"{self.order}2I", head)
        if kind >> 16:  # small: both in the first word, the content in the second
            size, kind = kind >> 16, kind & 0xFFFF
            if size > 4:
                raise CorruptFileError(f"a small element claims {size} bytes")
            return kind, head[4 : 4 + size]
        content = self._take(size)
        if not (padded and kind == _COMPRESSED):
            self.at = min(self.at + -size % 8, len(self.data))
        return kind, content

    def numbers(self) -> np.ndarray:
        """Next element as an array of its stored type."""
        kind, content = self.element()
        if kind not in _KINDS:
            raise CorruptFileError(f"an element of kind {kind} stands where numbers should")
        dtype = np.dtype(self.order + _KINDS[kind])
        if len(content) % dtype.itemsize:
            raise CorruptFileError(f"{len(content)} bytes are not a whole number of values")
        return np.frombuffer(content, dtype)

    def text(self) -> str:
        """Next element as Latin-1 text."""
        return self.element()[1].tobytes().decode("latin-1")

    def name(self) -> str:
        """Next element as the name of a variable, which may be empty."""
        return _named(self.text().rstrip("\0"))

    def _take(self, size: int) -> memoryview:
        if size > len(self.data) - self.at:
            missing = size - (len(self.data) - self.at)
            raise CorruptFileError(f"it is truncated by {missing} bytes")
        self.at += size
        return self.data[self.at - size : self.at]


def _named(name: str) -> str:
    if name and not (name.isascii() and name.isidentifier()):
        raise CorruptFileError(f"{name[:20]!r} is not a variable name")
    return name


def _unpacked(content: memoryview, most: int) -> memoryview:
    machine = zlib.decompressobj()
    try:
        data = machine.decompress(content, most + 1)
    except zlib.error as error:
        raise CorruptFileError(f"a compressed variable is damaged ({error})") from None
    if not machine.eof or len(data) > most:
        raise CorruptFileError("a compressed variable is cut off, or far larger than the file")
    return memoryview(data)


def _array(content: memoryview, order: str, depth: int) -> tuple[str, Value]:
    """Name and value of a matrix element."""
    if depth > _DEEPEST:
        raise CorruptFileError(f"arrays are nested more than {_DEEPEST} deep")
    if not len(content):
        return "", np.empty((0, 0))
    reader = _Reader(content, order)
    flags = reader.numbers()
    if len(flags) != 2:
        raise CorruptFileError("a variable has no flags")
    kind, is_complex = int(flags[0]) & 0xFF, bool(int(flags[0]) & _COMPLEX)
    if kind == _OPAQUE:
        return reader.name(), MatlabObject()
    dims = [int(size) for size in reader.numbers()]
    if len(dims) < 2 or min(dims) < 0:
        raise CorruptFileError(f"a variable has dimensions {dims}")
    name, count = reader.name(), math.prod(dims)
    if kind == _CELL:
        return name, [_array(_matrix(reader), order, depth + 1)[1] for _ in range(_possible(count, reader))]
    if kind == _STRUCT:
        return name, _struct(reader, count, order, depth)
    if kind == _CHAR:
        codes = reader.numbers()
        return name, _letters(codes) if dims[0] <= 1 else Unsupported()
    if not _FIRST_NUMBER <= kind <= _LAST_NUMBER or is_complex:
        return name, Unsupported()
    values = reader.numbers()
    if len(values) != count:
        raise CorruptFileError(f"{name or 'a variable'} has {len(values)} values for dimensions {dims}")
    return name, values.astype(_INTEGER_CLASSES.get(kind, "f8")).reshape(dims, order="F")


def _struct(reader: _Reader, count: int, order: str, depth: int) -> Value:
    lengths, names = reader.numbers(), reader.text()
    length = int(lengths[0]) if len(lengths) else 0
    if not 1 <= length <= 256:
        raise CorruptFileError(f"names of {length} letters")
    fields = [_named(names[at : at + length].split("\0")[0]) for at in range(0, len(names), length)]
    elements = [
        {field: _array(_matrix(reader), order, depth + 1)[1] for field in fields}
        for _ in range(_possible(count * max(1, len(fields)), reader) // max(1, len(fields)))
    ]
    return elements[0] if len(elements) == 1 else Unsupported()


def _matrix(reader: _Reader) -> memoryview:
    kind, content = reader.element()
    if kind != _MATRIX:
        raise CorruptFileError(f"an element of kind {kind} stands where an array should")
    return content


def _possible(count: int, reader: _Reader) -> int:
    """Check a number of elements: each has at least 8 bytes."""
    if count > len(reader.data) // 8:
        raise CorruptFileError(f"{count} elements are declared, more than the file contains")
    return count


def _letters(codes: np.ndarray) -> str:
    if codes.dtype.kind == "f":
        raise CorruptFileError("a text has character codes that are not integers")
    if codes.dtype.itemsize == 1:
        return codes.tobytes().decode("utf-8", "replace")
    return "".join(chr(code) if 0 <= code < 0xD800 else "\ufffd" for code in codes.tolist())


def _version_4(data: bytes) -> Iterator[tuple[str, Value]]:
    at = 0
    while at < len(data):
        if len(data) - at < 20:
            raise CorruptFileError("it is truncated in the header of a variable")
        order = "<" if 0 <= struct.unpack_from("<i", data, at)[0] < 1000 else ">"
        code, rows, columns, imaginary, letters = struct.unpack_from(f"{order}5i", data, at)
        number_type, kind = code // 10 % 10, code % 10
        if code // 1000 not in (0, 1) or code // 100 % 10 or number_type > 5 or min(rows, columns, letters) < 0:
            raise CorruptFileError("it is not a MATLAB file, or its header is damaged")
        dtype = np.dtype(order + _KINDS_4[number_type])
        size = rows * columns * dtype.itemsize * (2 if imaginary else 1)
        start = at + 20 + letters
        if start + size > len(data):
            raise CorruptFileError(f"it is truncated by {start + size - len(data)} bytes")
        name = data[at + 20 : start].split(b"\0")[0].decode("latin-1")
        values = np.frombuffer(data, dtype, rows * columns, start).astype(np.float64)
        yield _named(name), Unsupported() if kind or imaginary else values.reshape((rows, columns), order="F")
        at = start + size
