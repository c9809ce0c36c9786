"""The joint on a card: the real `nidaqmx`, which talks to a card in this process with a simulated joint behind it."""

import importlib

import numpy as np
import pytest

from mckibben.rig.ni import NiBackend
from mckibben.units import bar, ms
from tests.rig.faults import samples_stopped

from .conftest import PERIOD

pytest.importorskip("nidaqmx", reason="needs the extra daq")
pytest.importorskip("grpc", reason="needs the extra daq")

device = importlib.import_module("device_server")

SENSORS, VALVES = ["Dev1/ai0", "Dev1/ai1", "Dev1/ai2"], ["Dev1/ao0", "Dev1/ao1"]


@pytest.fixture
def on_card():
    servers = []

    def make(joint):
        server, address = device.serve(device.Card(joint, SENSORS, VALVES, device.KNEE))
        servers.append(server)
        return NiBackend(device.wired(address, device.KNEE, patience=5.0), rate=1 / PERIOD)

    yield make
    for server in servers:
        server.stop(None)


@pytest.mark.slow
def test_on_a_card_a_run_is_the_one_without(stiff, on_card):
    plan = stiff.plan(30, raising=30, settling=10)
    joint = stiff.joint(vented=True, patience=1.0)
    outcome, kept = stiff.run(on_card(joint), plan=plan)
    alone, expected = stiff.run(stiff.joint(vented=True), plan=plan)
    assert outcome.completed and alone.completed
    for name in ("angle", "pressure1", "pressure2", "command1", "command2"):
        mine, other = kept.columns[name][:69], expected.columns[name][:69]
        np.testing.assert_allclose(mine, other, rtol=1e-9, atol=1e-9)
    assert outcome.vented_after < 0.1
    joint.pass_time(200 * ms)
    assert max(joint.truth[2:]) < 0.05 * bar


def test_a_card_that_falls_silent_is_vented(stiff, on_card):
    joint = stiff.joint(patience=1.0, faults=[samples_stopped(20 * PERIOD)])
    outcome, kept = stiff.run(on_card(joint), plan=stiff.plan(60))
    assert outcome.kind == "silent"
    assert kept.columns["sample"].size >= 20
    joint.pass_time(200 * ms)
    assert max(joint.truth[2:]) < 0.05 * bar
