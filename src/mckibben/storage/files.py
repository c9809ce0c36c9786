"""Files that survive interruptions: atomic writes, locks and JSON; signal handling for long jobs."""

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
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from mckibben.errors import FileError, McKibbenWarning, Problem, closest, quoted

_SIGNAL_NAMES = ("SIGINT", "SIGTERM", "SIGHUP", "SIGQUIT")
SIGNALS = tuple(getattr(signal, name) for name in _SIGNAL_NAMES if hasattr(signal, name))
"""Signals that stop a job: Ctrl-C, termination, a closed terminal and Ctrl-\\."""


@contextmanager
def handle_signals(callback: Callable[[int], None], *, repeat: float = 1.0) -> Iterator[None]:
    """Call a function on each of `SIGNALS` that is not already ignored; one after `repeat` [s] also interrupts.

    Parameters
    ----------
    callback
        Called with the number of the signal, within the signal handler; it sets a flag that the job looks at.
    repeat
        Time [s] after the first signal from which another raises `KeyboardInterrupt`: the job does not end by itself.

    In other threads than the main one nothing is handled. The former handlers are back at the end of the block.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    first: dict[int, float] = {}

    def handle(number: int, _: object) -> None:
        callback(number)
        now = time.monotonic()
        if now - first.setdefault(number, now) > repeat:
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
    """Yield a temporary file that replaces the target, complete and synced, at the end of the block, or not at all.

    A killed process or a full disk leaves the target as it was. Raises `FileError` for an existing target unless
    `overwrite`, and `OSError` as the file system does.
    """
    path = Path(path)
    temporary = path.with_name(f".{uuid.uuid4().hex}.part")
    try:
        os.close(os.open(temporary, os.O_CREAT | os.O_EXCL | os.O_WRONLY | _NO_FOLLOW, 0o666))
    except FileNotFoundError as error:  # which does not name the temporary file
        raise FileNotFoundError(error.errno, error.strerror, str(path.parent)) from None
    try:
        yield temporary
        _sync(temporary, os.O_RDWR | _NO_FOLLOW)
        if not overwrite:
            check_free(path.parent, [path.name])
        temporary.replace(path)
        sync_folder(path.parent)
    finally:
        temporary.unlink(missing_ok=True)


def sync_folder(path: Path) -> None:
    """Sync the entries of a folder to disk, where the system supports it."""
    if hasattr(os, "O_DIRECTORY"):
        _sync(path, os.O_RDONLY | os.O_DIRECTORY)


def _sync(path: Path, flags: int) -> None:
    file = os.open(path, flags)
    try:
        os.fsync(file)
    finally:
        os.close(file)


def make_folder(path: str | os.PathLike[str]) -> Path:
    """Create a folder and its parents unless they exist, synced; return its path.

    Raises `FileError` if it is a file, or cannot be created.
    """
    path = Path(path)
    new = [folder for folder in (path, *path.parents) if not folder.exists()]
    try:
        path.mkdir(parents=True, exist_ok=True)
        for folder in new:
            sync_folder(folder.parent)
    except OSError as error:
        text = "it is a file" if isinstance(error, FileExistsError) else f"it cannot be made: {error.strerror}"
        raise FileError(str(path), [Problem(text, remedy="choose another folder")]) from error
    return path


_MOST_NAMES = 5  # of files in a message
_ELSEWHERE = "choose another folder, or move the existing file"


def similar_file(path: Path) -> str:
    """Return the remedy for a missing file: the file of its folder with a close name, or those of its kind; or nothing.

    >>> similar_file(Path("examples/pre_contracted_step_pid.yml"))
    "did you mean 'pre-contracted-step-pid.yaml'?"
    >>> similar_file(Path("examples/setups/x.yaml"))
    "is it 'card.yaml' or 'regulators.yaml' or 'spring.yaml'?"
    """
    with suppress(OSError):
        names = {file.stem: file.name for file in sorted(path.parent.iterdir()) if file.is_file()}
        if close := closest(path.stem, list(names)):
            return f"did you mean {quoted(names[close])}?"
        alike = [quoted(name) for name in names.values() if path.suffix and name.endswith(path.suffix)]
        return f"is it {' or '.join(alike)}?" if 0 < len(alike) <= _MOST_NAMES else ""
    return ""


def check_free(folder: Path, names: Iterable[str], remedy: str = _ELSEWHERE) -> None:
    """Raise `FileError` with one problem if named files exist in a folder; the folder need not exist."""
    existing = [name for name in names if os.path.lexists(folder / name)]
    if existing:
        message = "it already exists" if len(existing) == 1 else "they already exist"
        raise FileError(str(folder), [Problem(message, field=", ".join(existing), remedy=remedy)])


@contextmanager
def file_lock(path: Path, task: str) -> Iterator[None]:
    """Hold a lock on a file, released at the end or if the process dies; the file is removed.

    Parameters
    ----------
    path
        File of the lock, which holds the number and the host of the process.
    task
        What is done meanwhile, for the error of another process: "another process (pid 17 on host) is ...".

    Raises
    ------
    FileError
        If another process holds it. A file system without locks is a warning.
    """
    file = _lock(path, task)
    try:
        yield
    finally:
        path.unlink(missing_ok=True)
        os.close(file)


def _lock(path: Path, task: str) -> int:
    """Lock the file, write our process id, and return its descriptor."""
    while True:
        file = os.open(path, os.O_RDWR | os.O_CREAT | _NO_FOLLOW, 0o644)
        try:
            if not _try_flock(file, path, task):
                message = f"the file system of {path.parent} has no locks: make sure that only one process is {task}"
                warnings.warn(message, McKibbenWarning, stacklevel=4)
            if not is_same_file(path, file):  # its last holder removed it meanwhile
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
    except (BlockingIOError, PermissionError):
        holder = os.read(file, 200).decode("utf-8", "replace").strip() or "just started"
        problem = Problem(f"another process ({holder}) is {task}", remedy="wait for it to finish")
        raise FileError(str(path.parent), [problem]) from None
    except OSError as error:
        if error.errno not in _NO_LOCKS:
            raise
        return False
    return True


def is_same_file(path: Path, file: int) -> bool:
    """Whether a path still refers to an open file (its descriptor), which may have been removed or moved."""
    try:
        return os.path.samestat(path.stat(), os.fstat(file))
    except OSError:
        return False


def json_ready(value: Any) -> Any:
    """Convert NaN and infinities to None, NumPy scalars to numbers, and tuples to lists.

    >>> json_ready({"error": float("nan"), "levels": (1.0, 2)})
    {'error': None, 'levels': [1.0, 2]}
    """
    if isinstance(value, dict):
        return {key: json_ready(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [json_ready(item) for item in value]
    if type(value).__module__ == "numpy" and getattr(value, "ndim", 1) == 0:  # a scalar, without importing NumPy
        return json_ready(value.item())
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value


def to_json(value: object) -> str:
    """Return indented JSON; NaN and infinities are null, as JSON has neither."""
    return json.dumps(json_ready(value), indent=2, allow_nan=False)


def write_json(path: Path, value: object) -> None:
    """Write a file of JSON, complete or not at all; values as for `to_json`."""
    text = to_json(value)
    with atomic_write(path, overwrite=True) as temporary:
        temporary.write_text(text + "\n", encoding="utf-8")


def remove_results(folder: Path) -> None:
    """Remove the files of an earlier result in a folder: those that its results.json lists as `files`."""
    listed = folder / "results.json"
    names: list[str] = []
    with suppress(ValueError, TypeError, KeyError):  # another program's
        if listed.is_file() and not listed.is_symlink():
            names = [str(name) for name in json.loads(listed.read_bytes())["files"]]
    remove_files(folder, names)


def remove_files(folder: Path, names: Iterable[str]) -> None:
    """Remove files below a folder by their paths there, and folders that are empty then; others stay."""
    for path in map(folder.joinpath, names):
        if (path.is_file() or path.is_symlink()) and path.parent.resolve().is_relative_to(folder.resolve()):
            path.unlink()
            if path.parent != folder and not any(path.parent.iterdir()):
                path.parent.rmdir()
