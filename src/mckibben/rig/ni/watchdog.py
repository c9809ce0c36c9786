"""Watchdog on the host: a second process that vents a card when the process of the test dies or hangs; if it dies
itself, the test stops. Each has to answer the other.
"""

from __future__ import annotations

import contextlib
import json
import os
import queue
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from typing import IO

from mckibben.errors import RigError
from mckibben.rig.ni.backend import NiBackend
from mckibben.rig.ni.driver import Driver, Terminals

try:
    import resource
except ImportError:  # Windows
    resource = None

_READY, _DONE, _BEAT, _REST = b"ready\n", b"done\n", b"beat\n", b"rest\n"
_ATTEMPTS, _PAUSE = 50, 0.1  # of venting; s between them
_LONGEST, _MEMORY = 60, 4 << 30  # s and bytes after which it is ended: nobody else watches it
_BEATS = 5  # in the timeout of the relay
_GRACE = 5e-3  # s for the thread that reads answers, which may wait for this one
_END = 2.0  # s until a process that does not end by itself is killed


class WatchdogLink:
    """The second process, seen from the process of the test.

    Parameters
    ----------
    process
        The second process.
    patience
        Timeout of the relay [s].
    """

    def __init__(self, process: subprocess.Popen[bytes], patience: float) -> None:
        self._process, self._interval = process, patience / _BEATS
        self._sent = self._answered = 0
        self._sent_at, self._armed, self._ended = -self._interval, False, False
        self._changed = threading.Condition()
        threading.Thread(target=self._listen, name="answers of the watchdog process", daemon=True).start()

    def beat(self, now: float) -> None:
        """Send a heartbeat, at most five in the timeout of the relay.

        Parameters
        ----------
        now
            Time [s].

        Raises
        ------
        RigError
            If the process has died, or has not answered the previous heartbeat.
        """
        if not self._ended and now - self._sent_at < self._interval:
            return
        with self._changed:
            self._changed.wait_for(lambda: self._ended or self._answered == self._sent, _GRACE)
            ended, answered = self._ended, self._answered == self._sent
        if not ended and answered:
            self._sent, self._sent_at, self._armed = self._sent + 1, now, True
            _tell(self._process.stdin, _BEAT)
            return
        state = "has died" if ended else f"has not answered for {now - self._sent_at:.3g} s"
        raise RigError(
            f"the watchdog process {self._process.pid}, which vents the card if this process dies, {state}",
            remedy="see its messages, find what stopped it, and start again",
        )

    def rest(self) -> None:
        """Report that the muscle is vented: without heartbeats the process then waits."""
        if self._armed and not self._ended:
            self._armed = False
            _tell(self._process.stdin, _REST)

    def _listen(self) -> None:
        assert self._process.stdout is not None
        for _ in iter(self._process.stdout.readline, b""):
            with self._changed:
                self._answered += 1
                self._changed.notify_all()
        with self._changed:
            self._ended = True
            self._changed.notify_all()


@contextlib.contextmanager
def host_watchdog(backend: NiBackend) -> Iterator[None]:
    """Vent the card of a backend if this process dies or hangs within the block; its heartbeat fails if that one does.

    The process has its own session: Ctrl-C and a closed terminal affect only the test. It imports nothing from
    the current folder.
    """
    command = [sys.executable, "-P", "-m", "mckibben.rig.ni.watchdog"]
    found = [str(Path(one).absolute()) for one in os.environ.get("PYTHONPATH", "").split(os.pathsep) if one]
    settings = {"wiring": asdict(backend.wiring), "server": backend.server, "patience": backend.patience}
    with subprocess.Popen(
        command,
        bufsize=0,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        start_new_session=True,
        cwd=Path.cwd().anchor,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(found)},
    ) as process:
        assert process.stdout is not None
        _tell(process.stdin, json.dumps(settings).encode() + b"\n")
        if process.stdout.readline() != _READY:
            raise RigError("the process that vents when this one dies does not start", remedy="see its messages")
        backend.watchdog_link = WatchdogLink(process, backend.patience)
        try:
            yield
        finally:
            backend.watchdog_link = None
            _tell(process.stdin, _DONE)
            try:
                process.wait(_END)
            except subprocess.TimeoutExpired:
                process.kill()


def _tell(pipe: IO[bytes] | None, text: bytes) -> None:
    assert pipe is not None
    with contextlib.suppress(BrokenPipeError):
        pipe.write(text)


def main() -> None:
    """Answer heartbeats; vent at the end of the standard input, which the test's process leaves, or when they stop."""
    if resource is not None:
        most = resource.getrlimit(resource.RLIMIT_AS)[1]
        if most == resource.RLIM_INFINITY or most > _MEMORY:
            resource.setrlimit(resource.RLIMIT_AS, (_MEMORY, most))
    answer = sys.stdout.buffer
    settings = json.loads(sys.stdin.buffer.readline())
    wiring = Terminals(**settings["wiring"])
    lines: queue.SimpleQueue[bytes] = queue.SimpleQueue()
    threading.Thread(target=_read, args=(lines,), daemon=True).start()
    answer.write(_READY)
    answer.flush()
    if not _watch(lines, answer, settings["patience"] * (1 + 1 / _BEATS)):
        return
    if resource is not None:
        signal.alarm(_LONGEST)
    for _ in range(_ATTEMPTS):
        with contextlib.suppress(Exception):
            _vent(wiring, settings["server"])
            break
        time.sleep(_PAUSE)
    sys.stdout.flush()
    os._exit(0)  # the thread may still wait for a process that hangs


def _read(lines: queue.SimpleQueue[bytes]) -> None:
    """Pass the messages on; an empty one at the end."""
    try:
        while line := sys.stdin.buffer.readline():
            lines.put(line)
    finally:
        lines.put(b"")  # also after an exception


def _watch(lines: queue.SimpleQueue[bytes], answer: IO[bytes], patience: float) -> bool:
    """Answer heartbeats until the test's process ends normally (False), or the rig has to be vented (True)."""
    armed = False
    while True:
        try:
            line = lines.get(timeout=patience if armed else None)
        except queue.Empty:
            return True
        if line in (_DONE, b""):
            return line != _DONE
        armed = line == _BEAT
        if armed:
            with contextlib.suppress(BrokenPipeError):  # the end of the input follows
                answer.write(_BEAT)
                answer.flush()


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
