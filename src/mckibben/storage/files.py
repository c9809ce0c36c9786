"""Files and folders that survive interruption: atomic writes, exclusive locks, results that are never overwritten."""

from __future__ import annotations

import errno
import fcntl
import json
import math
import os
import socket
import uuid
import warnings
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from mckibben.errors import FileError, McKibbenWarning, Problem


@contextmanager
def whole(path: str | os.PathLike[str]) -> Iterator[Path]:
    """A sibling to write to, which takes the place of `path` when the block ends, and goes if it fails."""
    path = Path(path)
    sibling = path.with_name(f".{uuid.uuid4().hex}.part")
    try:
        yield sibling
        sibling.replace(path)
    finally:
        sibling.unlink(missing_ok=True)


def folder(path: str | os.PathLike[str]) -> Path:
    """A folder to write to, made if need be.

    Raises
    ------
    FileError
        If it cannot be: a file is in the way, or may not be written.
    """
    path = Path(path)
    try:
        path.mkdir(parents=True, exist_ok=True)
    except FileExistsError as error:
        raise FileError(str(path), [Problem("it is a file", remedy="give a folder")]) from error
    except OSError as error:
        raise FileError(
            str(path), [Problem(f"it cannot be made: {error.strerror}", remedy="choose another")]
        ) from error
    return path


_UNKNOWN = (errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP)
"""What file systems say that have no locks."""


def check_free(folder: Path, names: Iterable[str]) -> None:
    """Raise if files that are about to be written are there already.

    Parameters
    ----------
    folder
        To write to; it need not exist.
    names
        Of files in it.

    Raises
    ------
    FileError
        Which names all of them.
    """
    there = [name for name in names if os.path.lexists(folder / name)]
    if there:
        remedy = "choose another folder, or move what is there out of the way"
        raise FileError(str(folder), [Problem("it is there already", field=name, remedy=remedy) for name in there])


@contextmanager
def alone(path: Path, what: str) -> Iterator[None]:
    """Hold a lock file, which goes when the block ends; a process that was killed holds it no longer.

    Parameters
    ----------
    path
        The file, in a folder that exists.
    what
        Is done meanwhile, such as "computing this sweep".

    Raises
    ------
    FileError
        If another process holds it, or the file cannot be written.

    Warns
    -----
    McKibbenWarning
        If the file system knows no locks.
    """
    try:
        file = _locked(path, what)
    except OSError as error:
        problem = Problem(f"it cannot be written: {error.strerror}", remedy="choose another folder")
        raise FileError(str(path), [problem]) from None
    try:
        yield
    finally:
        path.unlink(missing_ok=True)
        os.close(file)


def _locked(path: Path, what: str) -> int:
    """The open file, locked and with our name in it."""
    while True:
        file = os.open(path, os.O_RDWR | os.O_CREAT, 0o644)
        try:
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                holder = os.read(file, 200).decode("utf-8", "replace").strip() or "just started"
                problem = Problem(f"another process ({holder}) is {what}", remedy="wait for its end")
                raise FileError(str(path.parent), [problem]) from None
            except OSError as error:
                if error.errno not in _UNKNOWN:
                    raise
                message = f"the file system of {path.parent} has no locks: take care that one process alone is {what}"
                warnings.warn(message, McKibbenWarning, stacklevel=4)
            if not _is(path, file):  # who held it before has removed it: ours is one that nobody else sees
                os.close(file)
                continue
            os.ftruncate(file, 0)
            os.write(file, f"pid {os.getpid()} on {socket.gethostname()}\n".encode())
            return file
        except BaseException:
            os.close(file)
            raise


def _is(path: Path, file: int) -> bool:
    try:
        return os.path.samestat(path.stat(), os.fstat(file))
    except FileNotFoundError:
        return False


def json_ready(value: Any) -> Any:
    """The value with NaN and infinities as None, and tuples as lists."""
    if isinstance(value, dict):
        return {key: json_ready(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [json_ready(item) for item in value]
    if isinstance(value, np.generic):
        return json_ready(value.item())
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value


def to_json(value: Any) -> str:
    """Indented JSON."""
    return json.dumps(json_ready(value), indent=2, allow_nan=False)


def write_json(path: Path, value: Any) -> None:
    """Write JSON atomically."""
    text = to_json(value)
    with whole(path) as part:
        part.write_text(text + "\n", encoding="utf-8")
