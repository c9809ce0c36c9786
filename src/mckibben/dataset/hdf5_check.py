"""Check of HDF5 and NetCDF files before this process opens them."""

from __future__ import annotations

import atexit
import contextlib
import json
import os
import subprocess
import sys
import threading
from pathlib import Path
from typing import Any

from mckibben.dataset import hdf5_child
from mckibben.dataset.sheet import unreadable
from mckibben.errors import DatasetError, Problem

_WAIT = 60.0, 10e6  # s: timeout of an answer, plus a second per so many bytes
_REMEDY = "save the file again, with its values in it"


class _Child:
    """Child process that is reused for the next file as long as the files are sound."""

    def __init__(self) -> None:
        self.lock = threading.Lock()
        self.process: subprocess.Popen[bytes] | None = None
        self.owner = 0

    def ask(self, request: dict[str, Any], seconds: float) -> dict[str, Any]:
        """Answer to a request; empty if the child ended first."""
        with self.lock:
            answer: dict[str, Any] = {}
            process = self._running()
            timer = threading.Timer(seconds, process.kill)
            timer.start()
            try:
                assert process.stdin is not None and process.stdout is not None
                process.stdin.write(json.dumps(request).encode() + b"\n")
                process.stdin.flush()
                answer = json.loads(process.stdout.readline() or b"{}")
            except OSError:
                pass
            finally:
                timer.cancel()
                if answer.get("problems") != []:
                    self.end(kill=True)
            return answer

    def _running(self) -> subprocess.Popen[bytes]:
        if self.process is None or self.owner != os.getpid() or self.process.poll() is not None:
            self.owner = os.getpid()
            self.process = subprocess.Popen(
                [sys.executable, "-P", hdf5_child.__file__],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},
                start_new_session=True,  # Ctrl-C should reach only this process
            )
        return self.process

    def end(self, *, kill: bool = False) -> None:
        """End the child process."""
        process, self.process = self.process, None
        if process is None or self.owner != os.getpid():
            return
        if kill:
            process.kill()
        with contextlib.suppress(OSError):
            process.communicate()


_CHILD = _Child()
atexit.register(_CHILD.end)


def check_hdf5(path: Path, what: str, *, netcdf: bool = False) -> None:
    """Raise a `DatasetError` if reading a file (`what` in messages) loops, grows, crashes or refers to other files."""
    try:
        size = path.stat().st_size
    except (OSError, ValueError) as error:
        raise unreadable(path, what, error, "") from error
    request = {"path": str(path.absolute()), "netcdf": netcdf}
    answer = _CHILD.ask(request, _WAIT[0] + size / _WAIT[1])
    if (found := answer.get("problems")) is not None:
        if found:
            raise DatasetError(str(path), [Problem(text, field=name, remedy=_REMEDY) for name, text in found])
        return
    reason = answer.get("error") or "reading it takes too long or crashes: it is damaged"
    raise unreadable(path, what, ValueError(reason))
