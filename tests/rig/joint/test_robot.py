"""A robot on a rig: the run of a simulation, the limits of each joint and muscle, and a fault of one channel."""

import json
import math

import numpy as np
import pytest

from mckibben.errors import RigError, ScenarioError, SimulationError, StoppedError
from mckibben.rig import JointRig, prepare
from mckibben.rig.backend import Channel
from mckibben.rig.channels import Channels
from mckibben.rig.compiled import probing_torques, vented_state
from mckibben.rig.control_loop import ChannelProbe, control
from mckibben.rig.record import read_record
from mckibben.robot import RobotScenario
from mckibben.units import bar, deg
from tests.rig.faults import FaultyJoint, disconnected, samples_stopped
from tests.robot.test_control import ONE, TORQUE, TWO

from .conftest import Kept

QUICK = "rig: simulated\napproach: {raising: 200 ms, settling: 100 ms}\n"


def one(**changes):
    return RobotScenario.parse(ONE + TORQUE).replace(duration=0.3, **changes)


@pytest.fixture(scope="module")
def session():
    return prepare(one(), JointRig.parse(QUICK), paced=False)


@pytest.mark.slow
def test_unpaced_and_ideal_it_is_the_simulation(tmp_path):
    read = RobotScenario.parse(TWO).replace(duration=0.3, command_delay=4e-3, sensors={"class": "perfect"})
    ran = prepare(read, paced=False, ideal=True).run(tmp_path)
    simulated = read.run_once()
    assert ran.outcome.completed and ran.outcome.vented_after < 0.2
    for name in ("angle", "pressure", "command", "stiffness", "desired_angle", "force", "stiffness_estimate"):
        np.testing.assert_allclose(ran.result[name], simulated[name], rtol=1e-7, atol=1e-9, err_msg=name)
    unknown = {"coupling", "air"}  # a rig has no second run without the last step; noise
    for name, value in simulated.metrics.items():
        assert name not in unknown or np.isnan(ran.result.metrics[name]).all()
        if name in unknown:
            continue
        np.testing.assert_allclose(ran.result.metrics[name], value, rtol=1e-5, atol=1e-9, err_msg=name)
    columns = read_record(tmp_path).columns
    assert {f"command.{muscle}" for muscle in read.muscle_names} < columns.keys()
    assert json.loads(json.dumps(ran.to_dict()))["scalars"]["ended"]["value"] == "completed"


@pytest.fixture(scope="module")
def leg_session():
    return prepare(RobotScenario.parse(TWO).replace(duration=0.5), JointRig.parse(QUICK), paced=False)


@pytest.mark.slow
@pytest.mark.parametrize("fault", ["pressure.hip2", "angle.knee", "silent"])
def test_a_fault_of_one_channel_vents_all_muscles_of_the_leg(leg_session, fault):
    session = leg_session
    happen = samples_stopped(0.5) if fault == "silent" else disconnected(0.5, fault)
    settings = {"period": session.plan.period, "channels": session.plan.channels, "program": session.backend.program}
    leg = FaultyJoint(session.plant, start=vented_state(session.plant, session.start), faults=[happen], **settings)
    kept = Kept()
    kept.telemetry = session.program.telemetry
    outcome = control(leg, session.program, session.plan, session.limits, kept)
    assert outcome.kind == ("silent" if fault == "silent" else "stopped")
    assert fault == "silent" or outcome.error.field.startswith(fault)
    rows = np.array(kept.rows)
    names = [column.name for column in session.columns]
    before = rows[rows[:, 0] < 0.5][:, [names.index(f"pressure.{muscle}") for muscle in session.scenario.muscle_names]]
    assert before[-1].min() > 0.5 * bar
    leg.pass_time(1.0)
    assert max(leg.truth[2:]) < 0.05 * bar


@pytest.mark.slow
def test_each_joint_and_muscle_has_its_limits(session):
    angles, pressures = session.plan.channels.by_joint("angle"), session.plan.channels.by_muscle("pressure")
    ranges = session.plan.ranges
    assert [*ranges] == [*angles, *pressures]
    references = session.plan.references[:, 0]
    assert ranges[angles[0]][0] <= references.min() - 10 * deg + 1e-9
    assert ranges[pressures[0]] == (-math.inf, pytest.approx(8.4 * bar))
    joint, muscle = session.scenario.joint_names[0], session.scenario.muscle_names[1]
    text = f"limits: {{pressure: 7 bar, highest_angle: 40 deg}}\nlimits_of:\n  {joint}: {{lowest_angle: -50 deg}}\n"
    rig = JointRig.parse(f"{QUICK}{text}  {muscle}: {{pressure: 5 bar}}\n")
    ranges = prepare(one(), rig, paced=False).plan.ranges
    assert ranges[angles[0]] == pytest.approx((-50 * deg, 40 * deg))
    assert [ranges[name][1] / bar for name in pressures[:2]] == pytest.approx([7, 5])
    for wrong in ("other: {pressure: 5 bar}", f"{joint}: {{pressure: 5 bar}}", f"{joint}: {{lowest_angle: 50 deg}}"):
        with pytest.raises(ScenarioError) as caught:
            prepare(one(), JointRig.parse(f"{QUICK}limits: {{highest_angle: 40 deg}}\nlimits_of: {{{wrong}}}"))
        assert caught.value.problems[0].field == f"limits_of.{wrong.partition(':')[0]}"


@pytest.mark.slow
def test_the_vented_robot_hangs_where_nothing_turns_it(session):
    plant = session.plant
    vented = vented_state(plant, session.start)
    (acceleration,) = plant.mechanism.by_joint(plant.rate(vented).velocity)
    assert abs(float(acceleration)) < 1e-5 and max(map(float, vented.pressures)) == 0
    torques = probing_torques(plant, vented, 0.5 * bar)
    assert torques.shape == (2, 1) and torques[0, 0] * torques[1, 0] <= 0


def test_a_base_that_can_fall_is_refused():
    scenario = RobotScenario.read("examples/robot/lei-leg.yaml")
    plant = scenario.plant()
    assert plant.robot.motions
    with pytest.raises(SimulationError) as caught:
        vented_state(plant)
    assert caught.value.field == "robot.base"


@pytest.mark.slow
def test_other_channels_are_refused(session, monkeypatch):
    monkeypatch.setattr(type(session.backend), "outputs", [Channel("valve1", "Pa"), Channel("valve2", "Pa")])
    with pytest.raises(RigError, match=r"a robot needs angle\."):
        control(session.backend, session.program, session.plan, session.limits, Kept())


@pytest.mark.parametrize(
    ("change", "field"),
    [
        ([0.02, 0.01, 0.5, 0.0, 0.0], ""),
        ([-0.03, 0.0, 0.5, 0.0, 0.0], "angle.hip"),
        ([0.0, -0.02, 0.5, 0.0, 0.0], ""),  # a joint that the muscle does not turn follows by gravity
        ([0.02, 0.0, 0.1, 0.0, 0.5], "pressure.a"),
        ([0.02, 0.0, 0.5, 0.5, 0.0], "pressure.a"),
    ],
)
def test_the_probe_compares_all_channels(change, field):
    channels = Channels((".hip", ".knee"), (".a", ".b", ".c"))
    probe = ChannelProbe(600, [[2.0, 0.0]] * 3, ((0.0, 8 * bar),) * 3, channels)
    change = np.array(change) * [1, 1, bar, bar, bar]

    def run():
        for number in range(201):
            commands = probe.commands(number, change if 100 <= number < 200 else np.zeros(5))
            assert sum(command > 0 for command in commands) == (100 <= number < 200)

    if field:
        with pytest.raises(StoppedError) as caught:
            run()
        assert caught.value.field == field and caught.value.remedy
    else:
        run()
