"""A host that crashes: the second process vents the card, though the relay would wait for a minute.

More ways, and whole tests: `python benchmarks/crash.py`.
"""

import importlib
import subprocess
import sys
import time

import pytest

from mckibben import catalog
from mckibben.errors import RigError
from mckibben.muscle import Muscle
from mckibben.rig.ni import NiRig
from mckibben.rig.ni.watchdog import host_watchdog
from mckibben.rig.simulated import SimulatedRig
from mckibben.units import bar

pytest.importorskip("nidaqmx", reason="needs the extra daq")
pytest.importorskip("grpc", reason="needs the extra daq")

device = importlib.import_module("device_server")

MUSCLE = Muscle(catalog.specimen("MAS-10-180N-AA-MC-O"), catalog.law("lei-mas-10-180n"))
HOST = """
import ctypes, os, sys
from mckibben.rig.ni import NiRig
from mckibben.rig.ni.watchdog import host_watchdog
rig = NiRig(server=sys.argv[1], patience=60.0)
with host_watchdog(rig):
    rig.open()
    rig.set_valves([4.0])
    rig.move(400, 80.0)
    for _ in range(20):
        rig.read(100)
        rig.heartbeat()
    print("under pressure", flush=True)
    {ways}[sys.argv[2]]()
"""
WAYS = {
    "segfault": "lambda: ctypes.string_at(0)",
    "exit": "lambda: os._exit(0)",
}


@pytest.fixture
def card():
    card = device.Card(SimulatedRig(MUSCLE, patience=60.0))
    server, card.address = device.serve(card)
    yield card
    server.stop(None)


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.slow
def test_a_host_that_crashes_is_vented_by_the_second_process(card, way):
    ways = "{" + ", ".join(f"{name!r}: {code}" for name, code in WAYS.items()) + "}"
    host = [sys.executable, "-c", HOST.format(ways=ways), card.address, way]
    with subprocess.Popen(host, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout.readline() == "under pressure\n"
        assert card.twin.truth.pressure > 3 * bar
        process.wait()
    deadline = time.monotonic() + 20.0
    while card.lines[device.HOLD] and time.monotonic() < deadline:
        time.sleep(0.01)
    assert not card.lines[device.HOLD] and card.valve == 0.0
    while card.twin.is_open and time.monotonic() < deadline:
        time.sleep(0.01)
    card.twin.pass_time(1.0)
    assert card.twin.truth.pressure < 0.2 * bar and not card.twin.moving


def test_a_test_that_ends_lets_the_second_process_end_without_a_reset(card):
    card.valve = 3.0  # V, which a reset would take away
    with pytest.raises(ZeroDivisionError), host_watchdog(NiRig(server=card.address)):
        raise ZeroDivisionError
    assert card.valve == 3.0


def test_a_second_process_that_does_not_start_is_told_before_anything_moves(card, monkeypatch):
    monkeypatch.setattr(sys, "executable", "/bin/true")
    with pytest.raises(RigError, match="does not start"), host_watchdog(NiRig(server=card.address)):
        pytest.fail("it went on")
