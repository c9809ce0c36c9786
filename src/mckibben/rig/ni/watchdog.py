"""Watchdog on the host: a second process that vents a card when the process of the test dies."""

from __future__ import annotations

import contextlib
import json
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import asdict
from typing import IO

from mckibben.errors import RigError
from mckibben.rig.ni.backend import NiBackend
from mckibben.rig.ni.driver import Driver, Terminals

try:
    import resource
except ImportError:  # Windows
    resource = None

_READY, _DONE = b"ready\n", b"done\n"
_ATTEMPTS, _PAUSE = 50, 0.1  # of venting; s between them
_LONGEST, _MEMORY = 60, 4 << 30  # s and bytes after which it is ended: nobody else watches it


@contextlib.contextmanager
def host_watchdog(backend: NiBackend) -> Iterator[None]:
    """Vent the card of a backend if this process dies within the block, by a crash or SIGKILL."""
    command = [sys.executable, "-m", "mckibben.rig.ni.watchdog"]
    settings = {"wiring": asdict(backend.wiring), "server": backend.server}
    # in a session of its own: Ctrl-C and a closed terminal are for the test alone
    with subprocess.Popen(command, bufsize=0, stdin=-1, stdout=-1, start_new_session=True) as process:
        assert process.stdin is not None
        assert process.stdout is not None
        _tell(process.stdin, json.dumps(settings).encode() + b"\n")
        if process.stdout.readline() != _READY:
            raise RigError("the process that vents when this one dies does not start", remedy="see its messages")
        try:
            yield
        finally:
            _tell(process.stdin, _DONE)


def _tell(pipe: IO[bytes], text: bytes) -> None:
    with contextlib.suppress(BrokenPipeError):
        pipe.write(text)


def main() -> None:
    """Wait for the end of the standard input, which comes with the end of the test's process, and vent."""
    if resource is not None:
        most = resource.getrlimit(resource.RLIMIT_AS)[1]
        if most == resource.RLIM_INFINITY or most > _MEMORY:
            resource.setrlimit(resource.RLIMIT_AS, (_MEMORY, most))
    told, answer = sys.stdin.buffer, sys.stdout.buffer
    settings = json.loads(told.readline())
    wiring = Terminals(**settings["wiring"])
    answer.write(_READY)
    answer.flush()
    if told.readline() == _DONE:
        return
    if resource is not None:
        signal.alarm(_LONGEST)
    for _ in range(_ATTEMPTS):
        with contextlib.suppress(Exception):
            _vent(wiring, settings["server"])
            return
        time.sleep(_PAUSE)


def _vent(wiring: Terminals, server: str) -> None:
    """Reset the devices, which aborts the tasks that were left, and set valves and lines to rest."""
    driver = Driver(server)
    for device in {where.split("/")[0] for where in [*wiring.outputs.values(), *wiring.lines.values()]}:
        driver.reset(device)
    driver.close()
    backend = NiBackend(wiring, server=server)
    backend.open()
    backend.close()


if __name__ == "__main__":
    main()
