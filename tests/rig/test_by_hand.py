"""Benches without a motor: an operator turns a screw, or hangs weights on the muscle."""

import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.constants import g

from mckibben import catalog
from mckibben.errors import ParameterError
from mckibben.muscle import Muscle, forces
from mckibben.rig.bench import Bench, RigLimits
from mckibben.rig.by_hand import HandBench
from mckibben.rig.document import MountedMuscle, RigTest
from mckibben.rig.modbus import RegisterMap
from mckibben.rig.record import Recorder, assemble
from mckibben.rig.runner import Runner, columns_of
from mckibben.rig.running import simulate_operator
from mckibben.rig.simulated import SimulatedRig
from mckibben.rig.steps import Acquire, HoldForce, Move, Pressurise
from mckibben.units import bar, mm, percent
from tests.rig.joint.conftest import Borrowed

EXAMPLES = Path(__file__).parents[2] / "examples" / "rig"
MUSCLE = Muscle(catalog.specimen("MAS-10-180N-AA-MC-O"), catalog.law("lei-mas-10-180n"))
LIMITS = RigLimits(pressure=6.5 * bar, force=630.0, stretch=8 * mm, shorten=50 * mm)
ACQUIRE = Acquire(samples=20, duration=0.02)


class PressureAlone(Borrowed):
    """A rig of which only the pressure is measured."""

    physical = False
    inputs = property(lambda self: self.other.inputs[1:])

    def read(self, count, *, timeout=1.0):
        block = self.other.read(count, timeout=timeout)
        return block._replace(values=block.values[:, 1:])


def run(folder, inner, steps, answers, *, weights, simulated=None):
    asked = []

    def ask(text):
        asked.append(text)
        return answers.pop(0)

    rig = HandBench(inner, weights=weights, ask=ask)
    rig.simulated = simulated
    bench = Bench(of=MUSCLE, limits=LIMITS, steady=0.3)
    with Recorder(folder, {}, columns_of(rig.inputs)) as recorder:
        Runner(rig, bench, recorder).run(steps)
    return asked, assemble(folder, bench)


def test_weights_are_hung_and_lengths_are_asked_for(tmp_path):
    steps = [HoldForce(force=100.0)]
    for pressure in (1 * bar, 2 * bar):
        steps += [Pressurise(pressure=pressure), HoldForce(force=100.0), ACQUIRE]
    steps += [HoldForce(force=50.0), ACQUIRE]
    answers = ["", "171 mm", "what?", "160.2 mm", "", "15.3 cm"]
    inner = PressureAlone(SimulatedRig(MUSCLE, seed=1, patience=100.0), 1)
    asked, data = run(tmp_path, inner, steps, answers, weights=True)
    assert [f"{100 / g:.4g} kg" in text or f"{50 / g:.4g} kg" in text for text in asked] == [
        True, False, False, False, True, False,
    ]  # fmt: skip
    np.testing.assert_allclose(data.force, [100, 100, 50])
    np.testing.assert_allclose(data.contraction, 1 - np.array([171, 160.2, 153]) / 180, atol=2e-5)
    np.testing.assert_allclose(data.pressure, [1 * bar, 2 * bar, 2 * bar], rtol=0.06)


def test_a_simulated_operator_gives_the_lengths_of_its_muscle(tmp_path):
    steps = [Pressurise(pressure=2 * bar), HoldForce(force=100.0), ACQUIRE, HoldForce(force=50.0), ACQUIRE]
    inner = PressureAlone(SimulatedRig(MUSCLE, seed=1, patience=100.0), 1)
    asked, data = run(tmp_path, inner, steps, [], weights=True, simulated=MUSCLE)
    assert asked == []
    np.testing.assert_allclose(forces(MUSCLE, data.contraction, data.pressure), data.force, atol=2)


@pytest.mark.parametrize(("weights", "law"), [(False, MUSCLE.law), (True, None)])
def test_a_simulated_operator_needs_weights_and_a_law(weights, law):
    bench = HandBench(SimulatedRig(MUSCLE, seed=1), weights=weights)
    checked = SimpleNamespace(backend=bench, test=SimpleNamespace(muscle=MountedMuscle(MUSCLE.specimen, law)))
    with pytest.raises(ParameterError) as error:
        simulate_operator(checked)
    assert error.value.field == "operator" and bench.simulated is None


def test_a_screw_is_turned_to_each_contraction(tmp_path):
    steps = [Move(to=5 * percent), Pressurise(pressure=1 * bar), ACQUIRE, Move(to=2 * percent), ACQUIRE]
    asked, data = run(tmp_path, SimulatedRig(MUSCLE, seed=1, patience=100.0), steps, ["", ""], weights=False)
    assert ["5 %" in asked[0], "2 %" in asked[1]] == [True, True]
    np.testing.assert_allclose(data.contraction, [0.05, 0.02], atol=1e-5)


ASKED = """
import sys, time
from mckibben.rig.by_hand import HandBench
class Inner:
    rate, patience, paced, inputs = 1.0, 1.0, True, ()
answer = HandBench(Inner()).ask("length")
{then}
"""


@pytest.mark.slow
def test_a_stop_while_the_operator_is_asked_ends_the_program_as_it_should():
    """Python aborted with -6 at its end, as a thread held the lock of the buffer of standard input."""
    script = ASKED.format(then="time.sleep(0.3); sys.exit(130)")
    pipes = dict.fromkeys(("stdin", "stdout", "stderr"), subprocess.PIPE)
    child = subprocess.Popen([sys.executable, "-c", script], **pipes)
    assert (child.wait(60), b"Fatal" in child.stderr.read()) == (130, False)
    child.communicate()


@pytest.mark.slow
def test_answers_are_read_one_by_one_until_the_input_ends():
    then = "print(answer.result()); print(HandBench(Inner()).ask('x').result())"
    script = ASKED.format(then=f"{then}; print(HandBench(Inner()).ask('x').result())")
    done = subprocess.run([sys.executable, "-c", script], input=b"16.3 cm\n\n", capture_output=True)
    assert done.stdout == b"length: 16.3 cm\nx: \nx: " and b"RigError" in done.stderr


CARD = "nidaqmx: {card: card.yaml, moved_by: weights}"
BOARD, TERMINAL = "serial: {port: /dev/ttyACM0, moved_by: weights}", "modbus: {registers: terminal.yaml}"


@pytest.mark.parametrize("rig", [BOARD, TERMINAL, CARD])
def test_such_benches_are_named_in_a_protocol(rig, tmp_path):
    for name in ("terminal.yaml", "card.yaml"):
        (tmp_path / name).write_text((EXAMPLES / name).read_text())
    text = f"""name: by hand
muscle: {{specimen: MAS-10-180N-AA-MC-O}}
rig: {{{rig}}}
limits: {{pressure: 6.5 bar, stretch: 8 mm, shorten: 50 mm}}
protocol: {{steps: [vent]}}
"""
    test = RigTest.parse(text, folder=tmp_path)
    assert RegisterMap.read(tmp_path / "terminal.yaml").outputs["valve2"].high == 9 * bar
    assert RigTest.parse(test.dumps(folder=tmp_path), folder=tmp_path) == test
    if rig == CARD:  # the status is the card's: without driver it is a problem, not an error
        assert next(test.rig.backend().status()).name in ("rig", "driver")
