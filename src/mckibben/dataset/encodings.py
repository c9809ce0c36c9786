"""Encodings of texts."""

from __future__ import annotations

import re

from mckibben.errors import DatasetError, Problem

_MARKS = (
    (b"\xef\xbb\xbf", "utf-8-sig"),
    (b"\xff\xfe\x00\x00", "utf-32"),
    (b"\x00\x00\xfe\xff", "utf-32"),
    (b"\xff\xfe", "utf-16"),
    (b"\xfe\xff", "utf-16"),
)
_REGIONAL = {
    "gb18030": ("压力", "拉力", "收缩"),
    "shift_jis": ("圧力", "収縮", "張力"),
    "cp1251": ("авление", "окращение", "усилие"),
    "cp949": ("압력", "수축"),
    **dict.fromkeys(("cp850", "mac_roman"), ("erkürzung", "Kürzung", "länge", "Länge", "Überdruck")),
}
"""Encodings tried for texts that are not UTF-8, and words of headers that settle them."""
_BINARY = 0.01  # share of zero bytes above which a file is not text
_PROBED = 4096  # bytes
_MINUS = re.compile(r"(?<![^\s;,|\"])[\u2212\u2013\uff0d](?=[0-9.,])")  # before a number
_FULL_DIGIT = re.compile(r"[\uff10-\uff19]")
_FULL_WIDTH = str.maketrans("\uff0b\uff0c\uff0e" + "".join(map(chr, range(0xFF10, 0xFF1A))), "+,.0123456789")
_HEAD = 2**16  # bytes searched for words of a header


def decode(data: bytes, source: str) -> tuple[str, int]:
    """Text by byte order mark, else UTF-16, UTF-8, a regional encoding or Windows-1252; number of zero bytes cut."""
    text, zeros = _decode(data, source)
    return (text if text.isascii() else _plain(text)), zeros


def _plain(text: str) -> str:
    """Text without byte order marks between joined files, and with common minus signs and digits."""
    text = text.replace("\ufeff", "")
    text = text.translate(_FULL_WIDTH) if _FULL_DIGIT.search(text) else text
    return _MINUS.sub("-", text) if any(sign in text for sign in "\u2212\u2013\uff0d") else text


def _decode(data: bytes, source: str) -> tuple[str, int]:
    for mark, encoding in _MARKS:
        if data.startswith(mark):
            return _decoded(data, encoding, source), 0
    probe = data[:_PROBED]
    for encoding, zeros, letters in (("utf-16-le", probe[1::2], probe[::2]), ("utf-16-be", probe[::2], probe[1::2])):
        if len(zeros) > 1 and zeros.count(0) > 0.9 * len(zeros) and letters.count(0) < 0.1 * len(letters):
            return _decoded(data, encoding, source), 0
    whole = data.rstrip(b"\0")
    if whole.count(0) > _BINARY * len(whole) or (data and not whole):
        line = data.count(b"\n", 0, data.find(b"\0")) + 1
        raise DatasetError(
            str(source), [Problem("is a binary file", line=line, remedy="give text, .nc, .mat, .tdms ...")]
        )
    try:
        return whole.decode("utf-8"), len(data) - len(whole)
    except UnicodeDecodeError as error:
        if error.end == len(whole) and error.reason == "unexpected end of data":  # truncated within a character
            return whole.decode("utf-8", "replace"), len(data) - len(whole)
        found = (e for e, words in _REGIONAL.items() if any(word.encode(e) in whole[:_HEAD] for word in words))
        return _decoded(whole, next(found, "cp1252"), source), len(data) - len(whole)


def _decoded(data: bytes, encoding: str, source: str) -> str:
    try:
        return data.decode(encoding)
    except UnicodeDecodeError as error:
        at, name = error.start, {"cp1252": "UTF-8 nor Windows-1252 text"}.get(encoding, f"{encoding[:6].upper()} text")
        message = f"byte 0x{error.object[at]:02x} at {at} is {'neither' if encoding == 'cp1252' else 'no'} {name}"
        line = error.object.count(b"\n", 0, at) + 1
        raise DatasetError(source, [Problem(message, line=line, remedy="save the file as UTF-8")]) from None
