"""A host that crashes: the second process vents the card, though the relay would wait for a minute."""

import contextlib
import importlib
import io
import os
import queue
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from mckibben import catalog
from mckibben.errors import RigError
from mckibben.muscle import Muscle
from mckibben.rig.ni import NiRig
from mckibben.rig.ni.watchdog import WatchdogLink, _read, _watch, host_watchdog
from mckibben.rig.simulated import SimulatedRig

pytest.importorskip("nidaqmx", reason="needs the extra daq")
pytest.importorskip("grpc", reason="needs the extra daq")

device = importlib.import_module("device_server")

MUSCLE = Muscle(catalog.specimen("MAS-10-180N-AA-MC-O"), catalog.law("lei-mas-10-180n"))


@pytest.fixture
def card():
    card = device.Card(SimulatedRig(MUSCLE, patience=60.0))
    server, card.address = device.serve(card)
    yield card
    server.stop(None)


LIVING = """
import os, sys, threading, time
from mckibben.errors import RigError
from mckibben.rig.ni import NiRig
from mckibben.rig.ni.watchdog import host_watchdog

def fail():
    raise ZeroDivisionError

ways = {"exception": fail, "os._exit": lambda: os._exit(1), "hang": lambda: time.sleep(1000)}
rig = NiRig(server=sys.argv[1], patience=float(sys.argv[3]))
with host_watchdog(rig):
    with rig.opened():
        rig.set_valves([4.0])
        begun, error = time.monotonic(), None
        while True:
            rig.read(50)
            try:
                rig.heartbeat()
            except RigError as error:
                rig.vent()
                print("stopped:", error, flush=True)
                break
            if time.monotonic() - begun > 0.5 and begun:
                begun = 0
                print(rig.watchdog_link._process.pid, flush=True)
                sys.stdin.readline()
                ways.get(sys.argv[2], lambda: None)()
            time.sleep(0.05)
"""
PATIENCE = 5.0  # s; heartbeats of the processes are 1 s apart, far longer than a busy machine needs to vent
TWO_CYCLES = 2 * PATIENCE / 5
LATE = 1.5  # s for the reset over the connection, or to begin the vent, on a busy machine


def dies(card, way, pid_of):
    """A host that runs until something dies; the time until the card is at rest [s], and what the host printed."""
    host = [sys.executable, "-c", LIVING, card.address, way, str(PATIENCE)]
    with subprocess.Popen(host, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, cwd="/") as process:
        try:
            watchdog = int(process.stdout.readline())
            assert card.lines[device.HOLD]
            print(file=process.stdin, flush=True)
            pid = {"host": process.pid, "watchdog": watchdog}[pid_of]
            if way.startswith("SIG"):
                os.kill(pid, signal.Signals[way])
            begin = time.monotonic()
            while (card.lines[device.HOLD] or card.valves[0]) and time.monotonic() < begin + 10.0:
                time.sleep(1e-3)
            taken = time.monotonic() - begin
            assert not card.lines[device.HOLD] and card.valves[0] == 0.0
            if pid_of == "watchdog":
                out = process.communicate(timeout=20)[0]
            else:
                process.kill()
                out = process.communicate()[0]
        finally:
            with contextlib.suppress(ProcessLookupError):
                os.kill(watchdog, signal.SIGKILL)
            process.kill()
    return taken, out, watchdog


@pytest.mark.slow
@pytest.mark.parametrize("way", ["SIGKILL", "SIGTERM", "SIGINT", "SIGSEGV", "SIGABRT", "exception", "os._exit"])
def test_a_host_that_dies_is_vented_within_two_cycles(card, way):
    taken, _, _ = dies(card, way, "host")
    assert taken < TWO_CYCLES + LATE


@pytest.mark.slow
@pytest.mark.parametrize("way", ["SIGSTOP", "hang"])
def test_a_host_that_hangs_is_vented_after_the_timeout_of_the_relay(card, way):
    taken, _, _ = dies(card, way, "host")
    assert 0.8 * PATIENCE < taken < 1.2 * PATIENCE + LATE


@pytest.mark.slow
@pytest.mark.parametrize("way", ["SIGKILL", "SIGSTOP", "SIGTERM", "SIGINT", "SIGSEGV", "SIGABRT", "SIGUSR1"])
def test_a_watchdog_process_that_dies_stops_the_test_within_two_cycles(card, way, tmp_path, monkeypatch):
    """SIGUSR1 raises an exception in it."""
    handler = "import signal\ndef fail(*_):\n    raise ZeroDivisionError\nsignal.signal(signal.SIGUSR1, fail)\n"
    (tmp_path / "sitecustomize.py").write_text(handler)
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(tmp_path), os.environ.get("PYTHONPATH", "")]))
    taken, out, watchdog = dies(card, way, "watchdog")
    assert taken < TWO_CYCLES + LATE / 2
    assert out.startswith(f"stopped: the watchdog process {watchdog}")


class Broken(io.BytesIO):
    """Standard input that fails after its first message."""

    def readline(self, *size):
        if line := super().readline(*size):
            return line
        raise OSError


def test_an_exception_in_the_thread_that_reads_the_heartbeats_vents(monkeypatch):
    lines, answers = queue.SimpleQueue(), io.BytesIO()
    monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(Broken(b"beat\n")))
    with pytest.raises(OSError):
        _read(lines)
    assert _watch(lines, answers, patience=60.0)
    assert answers.getvalue() == b"beat\n"


class Silent:
    """A process whose answers are a pipe that nobody fills, or that is closed."""

    pid = 7

    def __init__(self, *, closed):
        reading, writing = os.pipe()
        self.stdout, self.stdin, self._writing = os.fdopen(reading, "rb"), io.BytesIO(), writing
        if closed:
            self.end()

    def end(self):
        os.close(self._writing)


@pytest.mark.parametrize(("closed", "raises_at"), [(False, 2), (True, 1)])
def test_a_second_process_that_does_not_answer_fails_the_heartbeat_within_two_cycles(closed, raises_at):
    process = Silent(closed=closed)
    link = WatchdogLink(process, patience=1.0)
    beats = 0
    with pytest.raises(RigError, match="process 7"):
        for beats in range(1, 5):
            time.sleep(0.01)  # for the thread that notices the closed pipe
            link.beat(0.2 * beats)
    assert beats == raises_at
    for _ in range(100):
        link.rest()  # venting never blocks, whatever the process does
    assert len(process.stdin.getvalue()) < 20
    if not closed:
        process.end()


def test_the_second_process_imports_nothing_from_the_current_folder(card, tmp_path, monkeypatch):
    (tmp_path / "json.py").write_text(f"open({str(tmp_path / 'imported')!r}, 'w')\nfrom _json import *\n")
    monkeypatch.chdir(tmp_path)
    rig = NiRig(server=card.address)
    with host_watchdog(rig):
        pid = rig.watchdog_link._process.pid
        assert os.getsid(pid) == pid != os.getsid(0)
        if Path("/proc").is_dir():
            assert Path(f"/proc/{pid}/cwd").readlink() == Path("/")
    assert not (tmp_path / "imported").exists()


def test_a_test_that_ends_lets_the_second_process_end_without_a_reset(card):
    card.valves[0] = 3.0  # V, which a reset would take away
    with pytest.raises(ZeroDivisionError), host_watchdog(NiRig(server=card.address)):
        raise ZeroDivisionError
    assert card.valves[0] == 3.0


def test_a_second_process_that_does_not_start_is_told_before_anything_moves(card, monkeypatch):
    monkeypatch.setattr(sys, "executable", "/bin/true")
    with pytest.raises(RigError, match="does not start"), host_watchdog(NiRig(server=card.address)):
        pytest.fail("it went on")
