"""The heaps of an HDF5 file, which hold its texts: looked at before the library does.

A damaged heap can send the HDF5 library (1.14) round in circles for ever: where a part of free space claims no size, it
goes on by nothing at all. No time limit helps against that from inside the process.
"""

from __future__ import annotations

import mmap

_SIGNATURE, _HEADER, _PART = b"GCOL\x01\x00\x00\x00", 16, 16


def heaps_are_sound(content: bytes | mmap.mmap) -> bool:
    """Whether the parts of all global heap collections of a file follow one another to the end of each.

    HDF5 File Format Specification 3.0, III.E. Files whose lengths are not of 8 bytes, which no program of today
    writes, are not looked at.

    Parameters
    ----------
    content
        Of the file.

    Examples
    --------
    >>> heap = b"GCOL" + bytes([1, 0, 0, 0]) + (56).to_bytes(8, "little")
    >>> text = (1).to_bytes(8, "little") + (3).to_bytes(8, "little") + b"bar" + bytes(5)
    >>> heaps_are_sound(heap + text + bytes(8) + (16).to_bytes(8, "little"))
    True
    >>> heaps_are_sound(heap + text + bytes(8) + (0).to_bytes(8, "little"))
    False
    """
    at = content.find(_SIGNATURE)
    while at >= 0:
        size = int.from_bytes(content[at + 8 : at + _HEADER], "little")
        if not _HEADER <= size <= len(content) - at or not _follow(content, at + _HEADER, at + size):
            return False
        at = content.find(_SIGNATURE, at + 1)
    return True


def _follow(content: bytes | mmap.mmap, at: int, end: int) -> bool:
    """Whether parts of a heap lie one behind the other from a place to the end."""
    while at + _PART <= end:
        index = int.from_bytes(content[at : at + 2], "little")
        size = int.from_bytes(content[at + 8 : at + _PART], "little")
        # Free space counts its own head; what is used does not, and is filled up to whole words.
        taken = size if index == 0 else _PART + -(-size // 8) * 8
        if taken < _PART or at + taken > end:
            return False
        at += taken
    return True
