"""The backend on `nidaqmx`, the real package, that talks to a card in this process; see `device_server`."""

import ast
import importlib
import importlib.util
import sys
from pathlib import Path

import numpy as np
import pytest

from mckibben import catalog
from mckibben.errors import RangeError, RigError, ScenarioError, SilentError
from mckibben.muscle import Muscle
from mckibben.rig import ni
from mckibben.rig.ni import Card, NiBackend
from mckibben.rig.simulated import SimulatedRig
from mckibben.units import bar
from tests.rig.faults import FaultyRig, disconnected, host_delayed, samples_stopped

pytest.importorskip("nidaqmx", reason="needs the extra daq")
pytest.importorskip("grpc", reason="needs the extra daq")

device = importlib.import_module("device_server")

MUSCLE = Muscle(catalog.specimen("MAS-10-180N-AA-MC-O"), catalog.law("lei-mas-10-180n"))
SAFE = 0.2 * bar


def at(channel, terminal):
    return device.BENCH[channel].model_copy(update={"terminal": terminal})


class Bench:
    """A card with a twin, and its address."""

    def __init__(self, **settings):
        self.twin = FaultyRig(MUSCLE, **settings)
        self.card = device.Card(self.twin)
        self.server, self.address = device.serve(self.card)
        self.rigs = []

    def rig(self, **settings):
        rig = NiBackend(device.wired(self.address, **settings))
        self.rigs.append(rig)
        rig.open()
        return rig

    def end(self):
        for rig in self.rigs:
            rig.close()
        self.server.stop(None)


@pytest.fixture
def bench():
    made = []

    def make(**settings):
        made.append(Bench(**settings))
        return made[-1]

    yield make
    for one in made:
        one.end()


def read(rig, duration, count=100):
    kept = []
    for _ in range(round(duration * rig.rate / count)):
        kept.append(rig.read(count))
        rig.heartbeat()
    return kept


def press(rig, twin, pressure):
    rig.set_valves([pressure])


def test_nidaqmx_is_not_imported_until_a_rig_is_opened():
    """No module imports it, or `grpc`, when it is imported itself."""
    for path in Path(importlib.util.find_spec("mckibben.rig").submodule_search_locations[0]).rglob("*.py"):
        for node in ast.parse(path.read_text(encoding="utf-8")).body:
            names = [name.name for name in node.names] if isinstance(node, ast.Import) else []
            names += [node.module] if isinstance(node, ast.ImportFrom) else []
            assert not {name.split(".")[0] for name in names} & {"nidaqmx", "grpc"}, path


def test_it_reads_the_samples_of_the_card(bench):
    """The very samples that the twin gives when nothing stands between."""
    there = bench(seed=3, patience=100.0)  # of a host on a busy machine
    rig = there.rig(patience=100.0)
    alone = SimulatedRig(MUSCLE, seed=3)
    alone.open()
    for one, twin in ((rig, alone), (alone, alone)):
        press(one, twin, 3 * bar)
    for _ in range(10):
        block, expected = rig.read(100), alone.read(100)
        assert block.first == expected.first
        np.testing.assert_array_equal(block.time, expected.time)
        np.testing.assert_allclose(block.values, expected.values, rtol=1e-12, atol=1e-9)
        rig.heartbeat()
        alone.heartbeat()
    assert rig.clock() == pytest.approx(1.0)
    assert there.twin.truth.pressure > 2.5 * bar and there.card.beats == 10


def test_vented_muscle_has_its_valve_without_current_and_no_signal(bench):
    there = bench()
    rig = there.rig()
    press(rig, there.twin, 6 * bar)
    read(rig, 2.0)
    assert there.card.lines[device.HOLD] and there.twin.truth.pressure > 5.5 * bar
    rig.vent()
    assert not there.card.lines[device.HOLD] and there.card.valves[0] == 0
    read(rig, 1.0)
    assert there.twin.truth.pressure < SAFE
    rig.set_valves([0.0])
    assert not there.card.lines[device.HOLD]
    press(rig, there.twin, 1 * bar)
    assert there.card.lines[device.HOLD]


def test_closed_rig_is_vented_and_lets_go_of_the_card(bench):
    there = bench()
    rig = there.rig()
    press(rig, there.twin, 6 * bar)
    read(rig, 1.0)
    rig.close()
    rig.close()
    assert there.card.valves[0] == 0 and not any(there.card.lines.values())
    there.twin.pass_time(1.0)
    assert there.twin.truth.pressure < SAFE
    assert {task.kind for task in there.card.tasks.values()} == {"cleared"}
    with pytest.raises(RigError, match="not open"):
        rig.read(1)
    rig.open()
    assert rig.read(10).first == 0


def test_missed_beat_holds_until_it_is_opened_anew(bench, monkeypatch):
    there = bench()
    rig = there.rig()
    press(rig, there.twin, 3 * bar)
    read(rig, 1.0)
    now = ni.time.monotonic()
    monkeypatch.setattr(ni.time, "monotonic", lambda: now + 1.5)
    beats = there.card.beats
    rig.heartbeat()
    assert there.card.beats == beats and not there.card.lines[device.HOLD]
    with pytest.raises(RigError, match="no heartbeat"):
        rig.set_valves([1.0])


def test_silent_and_overrun_cards_are_told(bench):
    rig = bench(faults=[samples_stopped(0.25)]).rig()
    rig.read(100)
    with pytest.raises(SilentError):
        rig.read(200, timeout=0.1)
    rig = bench(faults=[host_delayed(0.05, 12.0)], patience=100.0).rig(patience=100.0)
    with pytest.raises(RigError, match="overwritten"):
        rig.read(100)


def test_card_that_is_gone_is_told_and_closes_without_an_error(bench):
    there = bench()
    rig = there.rig()
    there.card.unplugged = True
    for what in (lambda: rig.read(10), rig.clock, rig.heartbeat, lambda: rig.set_valves([1.0])):
        with pytest.raises(RigError, match="the device is disconnected"):
            what()
    rig.vent()
    rig.close()
    there.card.unplugged = False


@pytest.mark.parametrize(
    ("settings", "text"),
    [
        ({"device": "Dev2"}, "heartbeat at Dev2/port0/line0: .*connected are: Dev1"),
        ({"inputs": {"force": at("force", "ai40")}}, "force at Dev1/ai40: Physical channel"),
        ({"heartbeat": "port7/line0"}, "heartbeat at Dev1/port7/line0"),
        ({"outputs": {"valve": at("valve", "ao3")}}, "valve at Dev1/ao3"),
        ({"rate": 1003.0}, r"nearest is 1002\.99645 Hz"),
    ],
)
def test_what_is_missing_is_told_and_the_card_let_go(bench, settings, text):
    there = bench()
    with pytest.raises(RigError, match=text):
        there.rig(**settings)
    assert {task.kind for task in there.card.tasks.values()} == {"cleared"}
    there.rig().read(10)


def test_card_in_use_is_told(bench):
    there = bench()
    there.rig()
    with pytest.raises(RigError, match="the other program"):
        there.rig()


def test_missing_server_driver_and_package_are_told(monkeypatch):
    with pytest.raises(RigError, match=r"127\.0\.0\.1:9.*check that it runs"):
        NiBackend(device.wired("127.0.0.1:9")).open()
    import nidaqmx.errors
    import nidaqmx.task._task as module

    def none(*_):
        raise nidaqmx.errors.DaqNotFoundError("Could not find an installation of NI-DAQmx.")

    monkeypatch.setattr(module.utils, "_select_interpreter", none)  # so too on a machine that has a driver
    with pytest.raises(RigError, match="driver NI-DAQmx is not installed"):
        NiBackend(device.wired("")).open()
    monkeypatch.setitem(sys.modules, "nidaqmx", None)
    with pytest.raises(RigError, match=r"pip install 'mckibben\[daq\]'"):
        NiBackend(device.wired("")).open()
    (only,) = NiBackend(device.wired("")).status()
    assert "mckibben[daq]" in only.problem


def test_what_is_present_is_shown_with_readings(bench):
    there = bench(faults=[disconnected(0.0, "pressure")])
    rows = {row.name: row for row in NiBackend(device.wired(there.address)).status()}
    assert rows["driver"].reading == "NI-DAQmx 24.5.0" and rows["device"].reading == "PCI-6281, serial 1234ABC"
    assert " N (noise" in rows["force"].reading and not rows["force"].problem
    assert "lost" in rows["pressure"].problem
    assert there.card.beats == 0 and there.twin.truth.vented  # nothing was touched
    assert not {task.kind for task in there.card.tasks.values()} - {"cleared"}
    *_, last = NiBackend(device.wired(there.address, inputs={"force": at("force", "ai77")})).status()
    assert "Dev1/ai77" in last.problem


def test_wiring_that_cannot_be_safe_is_refused():
    text = device.wired("").dumps()
    assert Card.parse(text) == device.wired("")
    with pytest.raises(ScenarioError) as caught:
        Card.parse(text.replace("port0/line0", "''").replace("gain: 200", "gain: 0"))
    assert {problem.field for problem in caught.value.problems} == {"heartbeat", "inputs.force.gain"}
    with pytest.raises(RangeError, match="force at ai1 and pressure at ai1"):
        NiBackend(Card.parse(text.replace("ai0", "ai1")))


@pytest.mark.parametrize("signals", [[9.1e5], [-1e4], [float("nan")], [], [1e5, 1e5]])
def test_signal_that_cannot_be_given_is_refused(bench, signals):
    there = bench()
    with pytest.raises(RigError, match="cannot be given"):
        there.rig().set_valves(signals)
    assert there.card.valves[0] == 0
