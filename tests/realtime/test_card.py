"""The joint on a card: the real `nidaqmx`, which talks to a card in this process with a simulated joint behind it."""

import importlib

import numpy as np
import pytest

from mckibben.rig.ni import NiBackend, Terminals
from mckibben.rig.simulated.faults import SamplesStopped
from mckibben.units import bar, ms

from .conftest import PERIOD

pytest.importorskip("nidaqmx", reason="needs the extra daq")
pytest.importorskip("grpc", reason="needs the extra daq")

device = importlib.import_module("device_server")

SENSORS = {"Dev1/ai0": 0, "Dev1/ai1": 1, "Dev1/ai2": 2}
VALVES = ["Dev1/ao0", "Dev1/ao1"]


class JointCard(device.Card):
    """Three inputs, two outputs."""

    def __init__(self, joint):
        super().__init__(joint)
        self.valves = [0.0, 0.0]

    def CreateAIVoltageChan(self, request, context):  # noqa: N802
        self._add(request, "ai", request.physical_channel, SENSORS)
        return device.messages.CreateAIVoltageChanResponse()

    def CreateAOVoltageChan(self, request, context):  # noqa: N802
        self._add(request, "ao", request.physical_channel, VALVES)
        return device.messages.CreateAOVoltageChanResponse()

    def ReadAnalogF64(self, request, context):  # noqa: N802
        task, count = self._task(request), request.num_samps_per_chan
        try:
            block = self.twin.read(count, timeout=request.timeout - count / self.twin.rate)
        except device.SilentError as error:
            raise device.RefusedError(device.TIMEOUT, "Some samples have not yet been acquired.") from error
        columns = [block.volts[:, SENSORS[channel]] for channel in task.channels]
        return device.messages.ReadAnalogF64Response(read_array=np.concatenate(columns), samps_per_chan_read=count)

    def WriteAnalogF64(self, request, context):  # noqa: N802
        self.valves = list(request.write_array)
        self._wired()
        return device.messages.WriteAnalogF64Response(samps_per_chan_written=1)

    def _wired(self):
        if self.lines[device.HOLD] and self.twin.is_open:
            self.twin.set_valves(self.valves)
        else:
            self.twin.vent()


@pytest.fixture
def on_card():
    servers = []

    def make(joint):
        server, address = device.serve(JointCard(joint))
        servers.append(server)
        terminals = Terminals(
            inputs={"angle": "Dev1/ai0", "pressure1": "Dev1/ai1", "pressure2": "Dev1/ai2"},
            outputs={"valve1": "Dev1/ao0", "valve2": "Dev1/ao1"},
            counter="",
        )
        given = {"rate": 1 / PERIOD, "patience": 5.0, "server": address}
        return NiBackend(terminals, calibrations=joint.calibrations, **given)

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
    for name in ("volts_angle", "volts_pressure1", "volts_pressure2", "command1", "command2"):
        mine, other = kept.columns[name][:69], expected.columns[name][:69]
        np.testing.assert_allclose(mine, other, rtol=1e-9, atol=1e-9)
    assert outcome.vented_after < 0.1
    joint.pass_time(200 * ms)
    assert max(joint.truth[2:]) < 0.05 * bar


def test_a_card_that_falls_silent_is_vented(stiff, on_card):
    joint = stiff.joint(patience=1.0, faults=[SamplesStopped(20 * PERIOD)])
    outcome, kept = stiff.run(on_card(joint), plan=stiff.plan(60))
    assert outcome.kind == "silent"
    assert kept.columns["sample"].size >= 20
    joint.pass_time(200 * ms)
    assert max(joint.truth[2:]) < 0.05 * bar
