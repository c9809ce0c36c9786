"""The bytes of a file to text."""

from __future__ import annotations

from pathlib import Path

from mckibben.errors import DatasetError, Problem

_MARKS = (
    (b"\xef\xbb\xbf", "utf-8-sig"),
    (b"\xff\xfe\x00\x00", "utf-32"),
    (b"\x00\x00\xfe\xff", "utf-32"),
    (b"\xff\xfe", "utf-16"),
    (b"\xfe\xff", "utf-16"),
)
_BINARY = 0.01  # parts of zero bytes above which a file is no text
_PROBED = 4096  # bytes


def read_bytes(path: Path) -> bytes:
    """The content of a file.

    Raises
    ------
    DatasetError
        If the system has none.
    """
    try:
        return path.read_bytes()
    except FileNotFoundError:
        raise DatasetError(str(path), [Problem("there is no such file")]) from None
    except IsADirectoryError:
        raise DatasetError(str(path), [Problem("is a directory", remedy="name a file in it")]) from None
    except (OSError, ValueError) as error:
        raise DatasetError(str(path), [Problem(f"cannot be read: {error}")]) from None


def decode(data: bytes, source: str) -> tuple[str, int]:
    r"""The text of a file, and how many zero bytes were cut from its end.

    A mark at the beginning says what the encoding is. Without one it is UTF-16 if every other byte is zero, else UTF-8
    if it is valid, and else Windows-1252. For numbers it makes no difference; what goes wrong is a header in
    another alphabet, and the header is then shown as it was read.

    Zero bytes at the end are what a logger leaves that lost its power. Single ones elsewhere stay in the text.

    Raises
    ------
    DatasetError
        If it is no text.

    Examples
    --------
    >>> decode("p / bar".encode("utf-16-le"), "rig.csv"), decode(b"1,2\n3\0\0", "rig.csv"), decode(b"K\xfcrzung", "")
    (('p / bar', 0), ('1,2\n3', 2), ('Kürzung', 0))
    """
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
    except UnicodeDecodeError:
        return _decoded(whole, "cp1252", source), len(data) - len(whole)


def _decoded(data: bytes, encoding: str, source: str) -> str:
    try:
        return data.decode(encoding)
    except UnicodeDecodeError as error:
        at, name = error.start, {"cp1252": "UTF-8 nor Windows-1252 text"}.get(encoding, f"{encoding[:6].upper()} text")
        message = f"byte 0x{error.object[at]:02x} at {at} is {'neither' if encoding == 'cp1252' else 'no'} {name}"
        line = error.object.count(b"\n", 0, at) + 1
        raise DatasetError(source, [Problem(message, line=line, remedy="save the file as UTF-8")]) from None
