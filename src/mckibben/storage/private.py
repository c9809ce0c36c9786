"""Programs in the user's cache folder that only this user can have written."""

from __future__ import annotations

import hashlib
import os
import stat
from collections.abc import Callable
from pathlib import Path

from mckibben.storage.files import atomic_write


def write_private(path: Path, content: bytes, *, most: int = 200) -> None:
    """Write a program with a checksum, as damaged native code crashes the process, readable for this user only.

    Of all programs in its folder, the newest `most` remain.
    """
    with atomic_write(path, overwrite=True) as temporary:
        temporary.touch(mode=0o600)
        temporary.write_bytes(_checksum(path, content) + content)
        temporary.chmod(0o600)
    files = sorted(path.parent.glob("*.program"), key=lambda file: file.stat().st_mtime, reverse=True)
    for old in files[most:]:
        old.unlink(missing_ok=True)


def read_private(path: Path) -> bytes:
    """Return the content of a file that `write_private` wrote.

    Raises `PermissionError` if others may have written it, `ValueError` if it is damaged, `OSError` if there is none.
    """
    with os.fdopen(os.open(path, os.O_RDONLY | getattr(os, "O_NOFOLLOW", 0)), "rb") as file:
        if not is_private(os.fstat(file.fileno()), stat.S_ISREG):
            raise PermissionError(f"{path} may have been written by others")
        checksum, content = file.read(32), file.read()
    if _checksum(path, content) != checksum:
        raise ValueError(f"{path} is damaged")
    return content


def _checksum(path: Path, content: bytes) -> bytes:
    """Digest of this content of this program."""
    return hashlib.sha256(path.name.encode() + content).digest()


def is_private(status: os.stat_result, is_kind: Callable[[int], bool]) -> bool:
    """Whether it has the expected type, belongs to this user, and is not writable by others; False on Windows."""
    if not hasattr(os, "getuid"):
        return False
    return is_kind(status.st_mode) and status.st_uid == os.getuid() and not status.st_mode & 0o022


def source_files(folder: str = str(Path(__file__).parents[1])) -> tuple[tuple[str, int, int], ...]:
    """Path, size and time of change [ns] of our source files, of headers of C and of the catalog.

    A cached program is valid for the files from which it was made.
    """
    files: list[tuple[str, int, int]] = []
    with os.scandir(folder) as entries:
        for entry in sorted(entries, key=lambda entry: entry.name):
            if entry.is_dir(follow_symlinks=False):
                files += source_files(entry.path)
            elif entry.name.endswith((".py", ".yaml", ".h", ".cu")):
                files.append((entry.path, entry.stat().st_size, entry.stat().st_mtime_ns))
    return tuple(files)


SOURCES = source_files()  # at import
