"""Signal handling during a long job."""

from __future__ import annotations

import errno
import json
import math
import os
import signal
import socket
import threading
import time
import uuid
import warnings
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from mckibben.errors import FileError, McKibbenWarning, Problem

SIGNALS = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name))
"""Signals that stop a job: Ctrl-C, termination and a closed terminal."""

_REPEAT_INTERVAL = 1.0  # s


@contextmanager
def handle_signals(callback: Callable[[int], None]) -> Iterator[None]:
    """Call a function on each of `SIGNALS` unless ignored before; one repeated after 1 s also interrupts."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    first: dict[int, float] = {}

    def handle(number: int, _: object) -> None:
        callback(number)
        if time.monotonic() - first.setdefault(number, time.monotonic()) > _REPEAT_INTERVAL:
            raise KeyboardInterrupt

    previous = {}
    try:
        for number in SIGNALS:
            if signal.getsignal(number) not in (signal.SIG_IGN, None):
                previous[number] = signal.signal(number, handle)
        yield
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)


try:
    import fcntl
except ImportError:  # Windows
    fcntl = None

_NO_FOLLOW = getattr(os, "O_NOFOLLOW", 0)
_NO_LOCKS = (errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP)  # errors of file systems without locks


@contextmanager
def atomic_write(path: str | os.PathLike[str], *, overwrite: bool = False) -> Iterator[Path]:
    """Write a file that appears complete and synced at the end of the block, or not at all; yields a temporary file."""
    path = Path(path)
    temporary = path.with_name(f".{uuid.uuid4().hex}.part")
    os.close(os.open(temporary, os.O_CREAT | os.O_EXCL | os.O_WRONLY | _NO_FOLLOW, 0o666))
    try:
        yield temporary
        _sync(temporary, os.O_RDWR | _NO_FOLLOW)
        if overwrite:
            temporary.replace(path)
        else:
            _rename_new(temporary, path)
        sync_folder(path.parent)
    finally:
        temporary.unlink(missing_ok=True)


def _rename_new(temporary: Path, path: Path) -> None:
    """Rename a file unless its new name is taken."""
    try:
        os.link(temporary, path)
    except FileExistsError:
        check_free(path.parent, [path.name])
    except OSError:  # no hard links here
        check_free(path.parent, [path.name])
        temporary.replace(path)


def sync_folder(path: Path) -> None:
    """Make new names in a folder durable, where the system can."""
    if hasattr(os, "O_DIRECTORY"):
        _sync(path, os.O_RDONLY | os.O_DIRECTORY)


def _sync(path: Path, flags: int) -> None:
    file = os.open(path, flags)
    try:
        os.fsync(file)
    finally:
        os.close(file)


def make_folder(path: str | os.PathLike[str]) -> Path:
    """Create a folder and its parents unless they exist; `FileError` if it cannot be created."""
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


def check_free(folder: Path, names: Iterable[str]) -> None:
    """Raise `FileError` with all of some files that exist in a folder, which need not exist itself."""
    existing = [name for name in names if os.path.lexists(folder / name)]
    if existing:
        remedy = "choose another folder, or move what is there out of the way"
        raise FileError(str(folder), [Problem("it is there already", field=name, remedy=remedy) for name in existing])


@contextmanager
def file_lock(path: Path, task: str) -> Iterator[None]:
    """Hold a lock on a file, removed at the end and void when its holder dies; `task` is for the error of others."""
    try:
        file = _lock(path, task)
    except OSError as error:
        problem = Problem(f"it cannot be written: {error.strerror}", remedy="choose another folder")
        raise FileError(str(path), [problem]) from None
    try:
        yield
    finally:
        if fcntl is not None:
            path.unlink(missing_ok=True)
        os.close(file)
        if fcntl is None:  # an open file cannot be removed there
            path.unlink(missing_ok=True)


def _lock(path: Path, task: str) -> int:
    """Descriptor of the locked file, which then holds our process id."""
    while True:
        file = os.open(path, os.O_RDWR | os.O_CREAT | _NO_FOLLOW, 0o644)
        try:
            if not _try_flock(file, path, task):
                message = f"the file system of {path.parent} has no locks: take care that one process alone is {task}"
                warnings.warn(message, McKibbenWarning, stacklevel=4)
            if not _is_same(path, file):  # its last holder removed it meanwhile
                os.close(file)
                continue
            os.ftruncate(file, 0)
            os.write(file, f"pid {os.getpid()} on {socket.gethostname()}\n".encode())
            return file
        except BaseException:
            os.close(file)
            raise


def _try_flock(file: int, path: Path, task: str) -> bool:
    """Lock an open file; False where locks are not supported."""
    if fcntl is None:
        return False
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        holder = os.read(file, 200).decode("utf-8", "replace").strip() or "just started"
        problem = Problem(f"another process ({holder}) is {task}", remedy="wait for its end")
        raise FileError(str(path.parent), [problem]) from None
    except OSError as error:
        if error.errno not in _NO_LOCKS:
            raise
        return False
    return True


def _is_same(path: Path, file: int) -> bool:
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
    if type(value).__module__ == "numpy" and getattr(value, "ndim", 1) == 0:  # a scalar, without importing NumPy
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
    with atomic_write(path, overwrite=True) as part:
        part.write_text(text + "\n", encoding="utf-8")
