"""Hardware of one's own in the file of a joint rig."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import pytest

from mckibben.errors import ScenarioError
from mckibben.rig import PERFECT, JointHardware, JointRig, SimulatedJoint, prepare
from mckibben.rig.record import read_record
from mckibben.scenario import Scenario
from mckibben.units import BoundedInt

from .conftest import Borrowed

EXAMPLE = Path(__file__).parents[3] / "examples" / "pre-contracted-step-pid.yaml"
TEXT = "rig: {class: BorrowedJoint, port: 3}\n"


@dataclass(frozen=True)
class BorrowedJoint(JointHardware):
    """A joint behind a port."""

    port: Annotated[int, BoundedInt(0, 9)] = 0

    def backend(self, plant, run):
        type(self).digest = run.digest
        joint = SimulatedJoint(plant, period=run.period, patience=run.patience, sensing=PERFECT)
        return Borrowed(joint, self.port)


@pytest.fixture
def scenario():
    return Scenario.read(EXAMPLE).model_copy(update={"duration": 0.02})


@pytest.mark.slow
def test_hardware_of_ones_own_runs_a_scenario(scenario, tmp_path):
    rig = JointRig.parse(TEXT)
    assert rig.rig == BorrowedJoint(3) and rig.physical
    session = prepare(scenario, rig, firmware=Scenario.read(EXAMPLE))
    assert BorrowedJoint.digest == Scenario.read(EXAMPLE).digest != scenario.digest
    ran = session.run(tmp_path / "run")
    assert ran.outcome.completed and ran.outcome.vented_after < 0.1
    header = read_record(tmp_path / "run").header
    assert header["backend"] == {"kind": "borrowed", "port": "3"}
    assert header["rig"]["rig"] == {"BorrowedJoint": {"port": 3}}


def test_ideal_is_for_simulated_hardware(scenario):
    with pytest.raises(ScenarioError, match="not a simulated joint"):
        prepare(scenario, JointRig.parse(TEXT), ideal=True)


def test_the_muscle_bench_is_no_hardware_of_a_joint():
    with pytest.raises(ScenarioError) as error:
        JointRig.parse("rig: {simulated: {parts: ideal}}\n")
    assert [problem.field for problem in error.value.problems] == ["rig.simulated.parts"]
