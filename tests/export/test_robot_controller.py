"""Controllers of all joints of a robot as C99: they repeat the recorded run."""

import dataclasses
import shutil
import subprocess
from typing import Any

import pytest

from mckibben.actuator import FirstOrderValve
from mckibben.codegen.native import compiler
from mckibben.control import DecouplingControl, PolePlacement, Reference, Sine, Step
from mckibben.errors import ExportError, SimulationError
from mckibben.export import export_robot_controller
from mckibben.joint import GeneralLoad
from mckibben.plant import SampledSensors
from mckibben.robot import (
    ComputedTorque,
    JointwiseControl,
    PressureSchedule,
    RobotPlant,
    RobotStart,
    TimedReference,
    read_robot,
)
from mckibben.units import deg, kPa, ms

DURATION, PERIOD = 0.4, 2 * ms


@pytest.fixture(scope="module")
def plant():
    robot = read_robot("lei-leg")
    held = dataclasses.replace(robot, base="fixed")
    return RobotPlant(held, FirstOrderValve(20 * ms), sensors=SampledSensors(0.022 * deg, 2 * kPa, seed=1))


@pytest.fixture(scope="module")
def start(plant):
    zero = (0.0,) * len(plant.robot.joints)
    return RobotStart(zero, plant.robot.pressures_for(zero, zero, [14.5] * len(zero)), clearance=0.5)


@pytest.mark.parametrize("single", [False, True])
@pytest.mark.skipif(compiler() is None or shutil.which("make") is None, reason="there is no cc or make")
@pytest.mark.slow
def test_it_repeats_the_recorded_run_of_three_joints(plant, start, single, tmp_path):
    reference = TimedReference((Reference(Sine(4 * deg, 1.0), Step(14.5, 15.5, 0.2)),) * 3)
    controller = ComputedTorque(PolePlacement(30.0), robot=plant.robot, valve=plant.valve, reference=reference)
    export_robot_controller(
        plant, controller, start, tmp_path, duration=DURATION, control_period=PERIOD, name="robot", single=single
    )
    subprocess.run(["make", "-s", "replay"], cwd=tmp_path, check=True)
    done = subprocess.run(["./replay", "replay.csv", "0"], cwd=tmp_path, capture_output=True, text=True, check=True)
    assert done.stdout.startswith("200 steps")
    assert float(done.stdout.split(",")[1].split()[0]) < (1e-4 if single else 1e-11)


@pytest.mark.parametrize("duration", [0.0005, 0.0, 0.401])
def test_a_duration_of_no_whole_periods_is_refused(plant, start, duration, tmp_path):
    each = tuple(
        DecouplingControl(plant.robot.pair(i), GeneralLoad(0.05, 0.0, 0.3), PolePlacement(30.0), valve=plant.valve)
        for i in range(3)
    )
    controller = JointwiseControl(each, reference=TimedReference((Reference(0.0, 14.5),) * len(each)))
    with pytest.raises(SimulationError) as refused:
        export_robot_controller(plant, controller, start, tmp_path, duration=duration, control_period=PERIOD)
    assert refused.value.value == duration
    assert not list(tmp_path.iterdir())


def test_a_controller_without_setpoints_is_refused(plant, start, tmp_path):
    schedule: Any = PressureSchedule(tuple((one,) for one in start.pressures))
    with pytest.raises(ExportError) as refused:
        export_robot_controller(plant, schedule, start, tmp_path, duration=DURATION, control_period=PERIOD)
    assert (refused.value.field, refused.value.value) == ("controller", "PressureSchedule")
    assert not list(tmp_path.iterdir())
