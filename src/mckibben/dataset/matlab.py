"""Reader of MATLAB files of versions 5 to 7, of numbers, texts, structs and cells alone: a damaged file is an error.

SciPy's reader crashes on some damaged files. The format is that of "MAT-File Format", The MathWorks, 2023.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from mckibben.dataset.raw import Budget

_TYPES = dict(zip((1, 2, 3, 4, 5, 6, 7, 9, 12, 13, 16, 17), "i1 u1 i2 u2 i4 u4 f4 f8 i8 u8 u1 u2".split(), strict=True))
_MATRIX, _COMPRESSED = 14, 15
_CELL, _STRUCT, _OBJECT, _CHAR, _SPARSE, _NUMBERS = 1, 2, 3, 4, 5, range(6, 16)
_DEEPEST, _FIELDS = 8, 1000


class Opaque:
    """Object of MATLAB, such as a table, which only MATLAB can open."""


Value = np.ndarray | str | dict[str, "Value"] | list["Value"] | Opaque


class _Element(NamedTuple):
    kind: int
    data: memoryview
    end: int


class MatlabReader:
    """Variables of a file.

    Parameters
    ----------
    data
        Content of the file.
    budget
        Limits of bytes and time: a small file may claim or hold more.

    Raises
    ------
    ValueError, struct.error
        If the file is damaged, also while variables are read.
    """

    def __init__(self, data: bytes, budget: Budget) -> None:
        self.data, self.budget = memoryview(data), budget
        self.order = {b"IM": "<", b"MI": ">"}.get(data[126:128], "")
        if not self.order:
            raise ValueError("the header does not state the order of bytes")

    def variables(self) -> Iterator[tuple[str, Value]]:
        """Name and value of each variable.

        Numbers are arrays of float64 of the shape in MATLAB; a struct is a mapping of its fields, or a list of several.
        """
        at = 128
        while at + 8 <= len(self.data):
            element = self._element(self.data, at)
            at = element.end
            if element.kind == _COMPRESSED:
                inflate = zlib.decompressobj()
                content = inflate.decompress(element.data, max(1, 2**26))
                if inflate.unconsumed_tail:
                    self.budget.spend(size=2**40)
                self.budget.spend(size=len(content))
                element = self._element(memoryview(content), 0)
            if element.kind == _MATRIX:
                yield self._matrix(element.data, 0)

    def _element(self, data: memoryview, at: int) -> _Element:
        """Data element at a place, of the usual or the small form."""
        word, size = struct.unpack_from(f"{self.order}II", data, at)
        if word >> 16:  # small: type and size in four bytes
            return _Element(word & 0xFFFF, data[at + 4 : at + 4 + (word >> 16)], at + 8)
        end = at + 8 + size
        if end > len(data):
            raise ValueError(f"an element of {size} bytes is beyond the end: the file was truncated")
        padding = 0 if word == _COMPRESSED else -size % 8
        return _Element(word, data[at + 8 : end], end + padding)

    def _numbers(self, element: _Element) -> np.ndarray:
        return np.frombuffer(element.data, np.dtype(f"{self.order}{_TYPES[element.kind]}"))

    def _matrix(self, data: memoryview, depth: int) -> tuple[str, Value]:
        """Name and value of a matrix."""
        self.budget.spend()
        if depth > _DEEPEST:
            raise ValueError("structs are nested too deep")
        flags = self._element(data, 0)
        word = int(self._numbers(flags)[0])
        kind, complex_numbers = word & 0xFF, bool(word & 0x800)
        if kind not in (_CELL, _STRUCT, _CHAR, *_NUMBERS) or complex_numbers:
            return self._name_of_opaque(data, flags.end), Opaque()
        dims = self._element(data, flags.end)
        shape = tuple(int(size) for size in self._numbers(dims))
        name = self._element(data, dims.end)
        count = int(np.prod(shape, dtype=object)) if shape else 0
        if count * 8 > len(data) * 8 + 64 and kind != _STRUCT:
            raise ValueError(f"a matrix claims {count} values, which it does not hold")
        at, text = name.end, bytes(name.data).decode("latin-1")
        if kind == _CELL:
            return text, self._cells(data, at, count, depth)
        if kind == _STRUCT:
            return text, self._struct(data, at, count, depth)
        values = self._numbers(self._element(data, at))
        if kind == _CHAR:
            return text, "".join(map(chr, values.tolist()))
        if len(values) != count:
            raise ValueError(f"a matrix has {len(values)} values in place of {count}")
        return text, values.astype(np.float64).reshape(shape, order="F")

    def _cells(self, data: memoryview, at: int, count: int, depth: int) -> list[Value]:
        values: list[Value] = []
        for _ in range(count):
            element = self._element(data, at)
            values.append(self._matrix(element.data, depth + 1)[1] if len(element.data) else "")
            at = element.end
        return values

    def _struct(self, data: memoryview, at: int, count: int, depth: int) -> Value:
        """Fields of a struct, or a list of structs."""
        length = self._element(data, at)
        names = self._element(data, length.end)
        size, at = int(self._numbers(length)[0]), names.end
        if size <= 0 or len(names.data) // size * count > _FIELDS:
            raise ValueError("a struct has too many fields")
        texts = [
            bytes(names.data[i : i + size]).split(b"\0")[0].decode("latin-1") for i in range(0, len(names.data), size)
        ]
        structs: list[Value] = []
        for _ in range(count):
            fields: dict[str, Value] = {}
            for text in texts:
                element = self._element(data, at)
                fields[text] = self._matrix(element.data, depth + 1)[1] if len(element.data) else ""
                at = element.end
            structs.append(fields)
        return structs[0] if count == 1 else structs

    def _name_of_opaque(self, data: memoryview, at: int) -> str:
        try:
            return bytes(self._element(data, at).data).decode("latin-1")
        except (ValueError, struct.error):
            return "object"
