"""Calls of readers in a child process, within limits of time and memory.

A damaged or hostile file can make a library loop, exhaust the memory or crash: then only the child process ends.
"""

from __future__ import annotations

import atexit
import contextlib
import math
import os
import pickle
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar, cast

from mckibben.errors import DatasetError, Problem

SECONDS = 10.0
"""Processor time of the child process for a file [s]; not limited on Windows."""
MEMORY = 448 * 2**20
"""Memory [bytes] of the child process for a file, in excess of the idle process."""
_VARIABLE = "MCKIBBEN_READ_LIMITS"
LIMIT_REMEDY = f"give fewer rows or columns, or, if you trust the file, set {_VARIABLE}=4 for four times the limits"
_LARGE = 2**28  # bytes: a child process with more is replaced after the file
_WALL = 6.0  # times the processor time: other programs may use the processors, or a disk be slow
_STARTED = 60.0  # s: until the child process has imported its modules
_ENDED = 5.0  # s: until the child process has ended by itself
_OUT_OF_MEMORY = 99  # exit status
_SIGXCPU = 24  # signal of the limit of processor time

Result = TypeVar("Result")


def limit_factor() -> float:
    """Factor of the limits, from the environment variable ``MCKIBBEN_READ_LIMITS``."""
    text = os.environ.get(_VARIABLE, "1")
    with contextlib.suppress(ValueError):
        if 0 < (factor := float(text)) < math.inf:
            return factor
    raise DatasetError(_VARIABLE, [Problem(f"{text!r} is not a positive number", remedy="give a factor, such as 4")])


class _Child:
    """Child process that is reused for the next file, except after a damaged HDF5 file or a large one."""

    def __init__(self) -> None:
        self.lock = threading.Lock()
        self.process: subprocess.Popen[bytes] | None = None
        self.owner = 0

    def call(self, path: Path, function: Callable[..., Result], args: tuple[Any, ...]) -> Result:
        """Result of a call; raises the `DatasetError` of the function, or one for `path` if a limit is reached."""
        factor = limit_factor()
        seconds, size = SECONDS * factor, MEMORY * factor
        with self.lock:
            process = self._running()
            start, wall = time.monotonic(), (_WALL if os.name == "posix" else 1.3) * seconds
            timer = threading.Timer(wall, process.kill)
            timer.start()
            done, replace, answer = False, True, None
            try:
                assert process.stdin is not None and process.stdout is not None
                pickle.dump((function, (path.absolute(), *args), seconds, size), process.stdin)
                process.stdin.flush()
                done, replace, answer = pickle.load(process.stdout)
            except (OSError, EOFError, pickle.UnpicklingError):
                pass
            finally:
                timer.cancel()
                status = self.end(kill=answer is not None) if replace else None
        if done:
            return cast(Result, answer)
        if isinstance(answer, DatasetError):
            raise DatasetError(str(path), answer.problems)
        limit, remedy = "", LIMIT_REMEDY
        if status == _OUT_OF_MEMORY:
            limit = f"{size / 1e6:.0f} MB of memory"
        elif status == -_SIGXCPU:
            limit = f"{seconds:g} s of processor time"
        elif time.monotonic() - start >= wall:
            limit, remedy = (
                f"{wall:g} s",
                f"close programs that keep the processors or the disk busy, or {LIMIT_REMEDY}",
            )
        if limit:
            raise DatasetError(str(path), [Problem(f"cannot be read: it takes more than {limit}", remedy=remedy)])
        problem = Problem("cannot be read: it crashes the library that reads it", remedy="save the file again")
        raise DatasetError(str(path), [problem])

    def _running(self) -> subprocess.Popen[bytes]:
        if self.process is None or self.owner != os.getpid() or self.process.poll() is not None:
            self.owner = os.getpid()
            package = str(Path(__file__).parents[2])
            code = f"import sys; sys.path.append({package!r}); from mckibben.dataset.child import serve; serve()"
            self.process = subprocess.Popen(
                [sys.executable, "-P", "-c", code],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},
                start_new_session=True,  # Ctrl-C should reach only this process
            )
            timer = threading.Timer(_STARTED, self.process.kill)
            timer.start()
            assert self.process.stdout is not None
            self.process.stdout.read(1)
            timer.cancel()
        return self.process

    def end(self, *, kill: bool = False) -> int | None:
        """End the child process; returns its exit status."""
        process, self.process = self.process, None
        if process is None or self.owner != os.getpid():
            return None
        if kill:
            process.kill()
        with contextlib.suppress(OSError):
            try:
                process.communicate(timeout=_ENDED)
            except subprocess.TimeoutExpired:
                process.kill()
                process.communicate()
        return process.returncode


_CHILD = _Child()
atexit.register(_CHILD.end)


def call_in_child(path: Path, function: Callable[..., Result], *args: object) -> Result:
    """Result of a module's function of a path and other arguments, called in the child process.

    Raises the `DatasetError` of the function, and one for `path` if a limit is reached or the process crashes.
    """
    return _CHILD.call(path, function, args)


def serve() -> None:
    """Answer calls from standard input; run by the child process."""
    calls, answers = sys.stdin.buffer, os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what a library prints
    answers.write(b"\n")
    answers.flush()
    while True:
        try:
            function, args, seconds, size = pickle.load(calls)
            _limit(seconds, size)
            try:
                done, answer = True, function(*args)
            except DatasetError as error:
                done, answer = False, error
            unsure = not done and "h5py" in sys.modules  # of the state in which a damaged file leaves its library
            pickle.dump((done, unsure or _memory(1) > _LARGE, answer), answers, protocol=5)
            answers.flush()
            del args, answer
        except MemoryError:
            os._exit(_OUT_OF_MEMORY)
        except EOFError:
            return


def _limit(seconds: float, size: float) -> None:
    """Limit the time and memory of this process from now on."""
    try:
        import resource
    except ImportError:  # Windows: the time limit of the parent remains
        return
    limits = [(resource.RLIMIT_CPU, math.ceil(time.process_time() + seconds)), (resource.RLIMIT_CORE, 0)]
    if idle := _memory(0):
        limits.append((resource.RLIMIT_AS, idle + int(size)))
    for kind, most in limits:
        hard = resource.getrlimit(kind)[1]
        resource.setrlimit(kind, (most if hard < 0 else min(most, hard), hard))


def _memory(column: int) -> int:
    """Memory of this process [bytes]: addresses (column 0) or resident (1); 0 where it is unknown."""
    found = Path("/proc/self/statm")
    return int(found.read_text().split()[column]) * os.sysconf("SC_PAGESIZE") if found.exists() else 0
