"""MuJoCo judges the robot: the same motion from its own dynamics, in flight, on the ground, and in space."""

import dataclasses
import shutil

import jax
import mujoco
import numpy as np
import pytest

import mckibben as mk
from mckibben import robot as robots
from mckibben.errors import ExportError, ParameterError
from mckibben.export import export
from mckibben.export.compliance import compliance
from mckibben.export.drives import Transmission, path_transmission
from mckibben.export.mjcf import mujoco_model
from mckibben.export.mujoco import load_mujoco
from mckibben.export.muscle_plugin import plugin_files
from mckibben.joint import Cam, PairedPaths, Pulley, TwoBonePath
from mckibben.muscle import MaxwellCreep, MaxwellSlip
from mckibben.units import bar, deg
from tests.robot.conftest import limb, over_two, pair_over
from tests.robot.test_control import ONE

pytestmark = [pytest.mark.slow, pytest.mark.skipif(shutil.which("cc") is None, reason="the plugin needs a C compiler")]
PERIOD, SUBSTEPS = 1e-3, 4
MUSCLE = mk.Muscle(mk.catalog.specimen("MAS-10-180N-AA-MC-O"), mk.catalog.law("lei-mas-10-180n"))
KNEE = mk.KneeGeometry(joint_length=0.37, joint_radius=0.03, connector_length=0.208)
PULLEYS = PairedPaths(Pulley(0.025, 0.165), Pulley(0.03, 0.165))
LEVEL, SLOPE = robots.Ground(), robots.Ground(slope=8 * deg, side_slope=-5 * deg)
BONES = (
    TwoBonePath(-0.025, 0.03, -0.02, -0.20, 0.0),
    TwoBonePath(0.02, 0.20, 0.02, -0.005, 0.27),  # x is where the angle turns: backwards
)
HAMSTRING = over_two(MUSCLE, BONES, ("hip", "knee"), ("lengthens", "shortens"), "hamstring")


def pair(geometry):
    return mk.AntagonisticJoint(geometry, MUSCLE, MUSCLE)


def plant_of(freedom, *, side=False, valve=None, ground=LEVEL):
    """Robot with hip, knee and pulleys at the ankle, whose angles grow backwards at the knee; and a hamstring.

    In space a side swing above the hip, and a turn about an oblique axis in place of the ankle's.
    """
    forwards, backwards = (0.0, -1.0, 0.0), (0.0, 1.0, 0.0)
    joints = (
        robots.Joint("hip", forwards, -15 * deg, 15 * deg, "thigh", damping=0.05, offset=20 * deg),
        robots.Joint(
            "knee", backwards, -25 * deg, 30 * deg, "shank", place=robots.Place(z=-0.4), damping=0.05, offset=40 * deg
        ),
        robots.Joint(
            "ankle", forwards, -20 * deg, 20 * deg, "sole", place=robots.Place(z=-0.37), damping=0.03, offset=50 * deg
        ),
    )
    pairs = tuple(map(pair_over, ("hip", "knee", "ankle"), map(pair, (KNEE, KNEE, PULLEYS))))
    if side:
        swing = robots.Joint("side", (1.0, 0.0, 0.0), -15 * deg, 15 * deg, damping=0.05)
        joints = swing, *joints[:2], dataclasses.replace(joints[2], axis=(0.3, -0.8, 0.2))
        pairs = pair_over("side", pair(KNEE)), *pairs
    axial = 0.001 if side else 0.0
    bodies = (
        robots.Body("trunk", 1.3, robots.Place(z=0.1), (0.02, 0.02, 0.02)),
        limb("thigh", 0.5, 0.19, 0.009, axial),
        limb("shank", 0.3, 0.15, 0.005, axial),
        limb("sole", 0.2, 0.05, 0.002, axial),
    )
    robot = robots.Robot(bodies, joints, (*pairs, HAMSTRING), freedom, robots.Foot("sole", robots.Place(z=-0.12), 0.02))
    return robots.RobotPlant(robot, valve or mk.FirstOrderValve(0.02), ground)


ANGLES = (3 * deg, -4 * deg, 2 * deg)
PRESSURES = tuple(one * bar for one in (3.0, 2.5, 3.0, 3.2, 2.0, 2.0, 1.0))
COMMANDS = tuple(one * bar for one in (2.6, 3.0, 3.4, 2.9, 2.1, 2.0, 1.5))
SIDE = 2 * deg, (2.5 * bar, 3.0 * bar), (3.5 * bar, 2.0 * bar)
"""Angle, pressures and commands of the side swing."""


def start_of(plant, clearance, speed):
    """A start in the posture, and the commands."""
    if plant.robot.is_planar:
        return robots.RobotStart(ANGLES, PRESSURES, clearance, speed), COMMANDS
    angle, pressures, commands = SIDE
    return robots.RobotStart((angle, *ANGLES), (*pressures, *PRESSURES), clearance, speed), (*commands, *COMMANDS)


def name_of(plant):
    return "plane" if plant.robot.is_planar else "space"


@pytest.fixture(scope="module")
def library(tmp_path_factory):
    """Folder with the plugins of the robots in the plane and in space."""
    folder = tmp_path_factory.mktemp("robot")
    for side in (False, True):
        plant = plant_of("vertical", side=side)
        plugin_files(mujoco_model(plant, name_of(plant)), "a robot").save(folder, force=True)
        load_mujoco(folder, name_of(plant))
    return folder


def model_of(plant, start, commands, library):
    """Model and data at a start, under the commands."""
    assert library.exists()
    state = plant.begin(start)
    model = mujoco.MjModel.from_xml_string(mujoco_model(plant, name_of(plant), PERIOD / SUBSTEPS, state).xml)
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    data.ctrl[:] = commands
    return model, data


def moved(plant, start, commands):
    """Positions in MuJoCo's order, and the run, by our own dynamics."""
    schedule = robots.PressureSchedule(tuple((one,) for one in commands))
    run = robots.simulate_robot(plant, schedule, start, duration=0.1, control_period=PERIOD, substeps=SUBSTEPS)
    return np.stack([*(run[name] for name in plant.robot.motions), *run["angle"]], -1), run


def stepped(model, data, seen=lambda: None):
    """Positions by MuJoCo at the start of each period, where `seen` is called."""
    found = []
    for _ in range(100):
        seen()
        found.append(data.qpos.copy())
        mujoco.mj_step(model, data, nstep=SUBSTEPS)
    return np.array(found)


def own_contact(plant):
    """Contact and stops of the plant in plain NumPy, as passive forces of MuJoCo at each stage of its integration."""
    ground, joints = plant.ground, plant.robot.joints
    slopes = [one or 0.0 for one in (ground.slope, ground.side_slope)]
    normal = np.cross([1, 0, np.tan(slopes[0])], [0, 1, np.tan(slopes[1])]) if ground.facing is None else ground.facing
    normal = np.array(normal) / np.linalg.norm(normal)

    def pressed(depth, rate, stiffness, damping):
        return stiffness * max(depth, 0.0) * max(1 + damping * rate, 0.0)

    def passive(model, data):
        for number, sphere in enumerate(plant.robot.spheres):
            foot = model.geom(f"foot {number + 1}" if number else "foot").id
            point = data.geom_xpos[foot] - sphere.radius * normal
            jacobian = np.empty((3, model.nv))
            mujoco.mj_jac(model, data, jacobian, None, point, model.geom_bodyid[foot])
            speed, height = jacobian @ data.qvel, point @ normal + (ground.distance or 0.0)
            push = pressed(-height, -speed @ normal, ground.stiffness, ground.damping)
            along = speed - (speed @ normal) * normal
            slip = np.hypot(np.linalg.norm(along), ground.slip_speed)
            data.qfrc_passive += jacobian.T @ (push * normal - ground.friction * push * along / slip)
        for joint in joints:
            at, given = model.joint(joint.name).dofadr[0], (joint.stop_stiffness, joint.stop_damping)
            angle, rate = data.qpos[at], data.qvel[at]
            data.qfrc_passive[at] += pressed(joint.lower - angle, -rate, *given)
            data.qfrc_passive[at] -= pressed(angle - joint.upper, rate, *given)

    return passive


@pytest.fixture
def passive():
    """Sets a function for passive forces, which is removed again."""
    yield mujoco.set_mjcb_passive
    mujoco.set_mjcb_passive(None)


@pytest.mark.parametrize(("freedom", "side"), [("free", False), ("vertical", True), ("floating", True)])
def test_a_landing_with_the_same_contact_and_stops_is_the_same(freedom, side, library, passive):
    plant = plant_of(freedom, side=side, ground=SLOPE if side else LEVEL)
    if freedom == "floating":
        plant = dataclasses.replace(plant, robot=dataclasses.replace(plant.robot, contacts=SPHERES))
    start, commands = start_of(plant, 0.0, -1.5)
    model, data = model_of(plant, start, commands, library)
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT | mujoco.mjtDisableBit.mjDSBL_LIMIT
    passive(own_contact(plant))
    ours, run = moved(plant, start, commands)
    assert run["stop_torque"].any() and np.ptp(ours, axis=0).min() > 1e-4
    assert run["ground_up"].max() > 100
    assert np.abs(run["ground_left"]).max() > 10 or not side
    np.testing.assert_allclose(stepped(model, data), ours, rtol=0, atol=1e-9)


SPHERES = (
    robots.Foot("sole", robots.Place(0.05, 0.03, -0.13), 0.015),
    robots.Foot("shank", robots.Place(x=0.1, z=-0.4), 0.02),
)


def test_a_wall_pushes_as_in_mujoco(library, passive):
    """A robot whose base is held, with two spheres; the wall leans towards it."""
    plant = plant_of("fixed", ground=robots.Ground(facing=(-1.0, 0.0, -0.2), distance=0.04))
    plant = dataclasses.replace(plant, robot=dataclasses.replace(plant.robot, contacts=SPHERES[1:]))
    start, commands = start_of(plant, 0.0, 0.0)
    commands = (1.0 * bar, 5.0 * bar, *commands[2:])  # forwards
    model, data = model_of(plant, start, commands, library)
    ours, run = moved(plant, start, commands)
    assert run["ground_forward"].min() < -20
    theirs = stepped(model, data)
    assert np.ptp(ours, axis=0).max() > 1 * deg and np.abs(theirs - ours).max() < 0.5 * deg  # by MuJoCo's contact
    mujoco.mj_resetDataKeyframe(model, data, 0)
    data.ctrl[:] = commands
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT | mujoco.mjtDisableBit.mjDSBL_LIMIT
    passive(own_contact(plant))
    np.testing.assert_allclose(stepped(model, data), ours, rtol=0, atol=1e-9)


@pytest.mark.parametrize(("freedom", "slope"), [("free", None), ("vertical", 3 * deg)])
def test_a_landing_by_the_contact_of_mujoco_is_much_the_same(freedom, slope, library):
    plant = plant_of(freedom, ground=robots.Ground(slope=slope))
    start, commands = start_of(plant, 0.0, -1.0)
    model, data = model_of(plant, start, commands, library)
    ours, run = moved(plant, start, commands)
    foot, forces = np.zeros(6), []

    def upward():
        mujoco.mj_forward(model, data)
        foot[:] = 0
        if data.ncon:
            mujoco.mj_contactForce(model, data, 0, foot)
        forces.append(foot[0])

    theirs = stepped(model, data, upward)
    z = {"vertical": 0, "free": 1}[freedom]
    normal = np.sin(slope or 0.0) * -run["ground_forward"] + np.cos(slope or 0.0) * run["ground_up"]
    assert max(forces) == pytest.approx(float(normal.max()), rel=0.025)  # as the documentation says
    assert np.ptp(theirs[:, z]) == pytest.approx(np.ptp(ours[:, z]), rel=0.04)
    assert np.abs(theirs - ours)[:, -3:].max() < 2.1 * deg


@pytest.mark.parametrize("freedom", ["vertical", "floating"])
def test_ground_and_stops_are_by_the_mobilities_of_mujoco(freedom, library):
    plant = plant_of(freedom, side=True)
    start, commands = start_of(plant, 0.0, 0.0)
    model, _ = model_of(plant, start, commands, library)
    found = compliance(plant, plant.begin(start))
    assert found["ground 0"].stiffness / plant.ground.stiffness == pytest.approx(
        model.body_invweight0[model.geom("foot").bodyid[0], 0], rel=2e-3
    )
    for joint in plant.robot.joints:
        mobility = model.dof_invweight0[model.joint(joint.name).dofadr[0]]
        assert found[joint.name].stiffness / joint.stop_stiffness == pytest.approx(mobility, rel=2e-3)


def test_friction_creep_and_spools_are_those_of_each_muscle(tmp_path):
    """A robot whose muscles differ, on its start in the air, with a plugin of its own."""
    valve = mk.PressureRegulator(conductance=0.5e-8, supply=7 * bar, time_constant=0.01, dead_volume=5e-6)
    plant, widths = plant_of("fixed", valve=valve), iter(range(5, 20))

    def rough(part):
        friction = MaxwellSlip(next(widths), 5e-4, viscous=30.0, elements=2)
        return dataclasses.replace(part, friction=friction, creep=MaxwellCreep(900.0, 0.5))

    is_muscle = lambda part: isinstance(part, mk.Muscle)  # noqa: E731
    plant = jax.tree.map(lambda part: rough(part) if is_muscle(part) else part, plant, is_leaf=is_muscle)
    start, commands = start_of(plant, 0.5, 0.0)
    state = plant.begin(start)
    plugin_files(mujoco_model(plant, "rough", PERIOD / SUBSTEPS, state), "a robot").save(tmp_path)
    model = load_mujoco(tmp_path)
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    data.ctrl[:] = commands
    ours, _ = moved(plant, start, commands)
    assert np.ptp(ours, axis=0).min() > 1e-3 and model.na == 3 * model.nu
    np.testing.assert_allclose(stepped(model, data), ours, rtol=0, atol=1e-9)


ROPES = Pulley(0.02, 0.1), Pulley(0.015, 0.072)
OTHER = over_two(MUSCLE, ROPES, ("hip", "knee"), ("shortens", "lengthens"), "rope")


def test_cams_pulleys_locked_joints_and_air(tmp_path):
    """Torques as those of the robot, with a plugin of its own; a muscle that MuJoCo cannot move is left out."""
    plant = plant_of("free", valve=mk.FlowValve(conductance=1e-9, supply=6e5))
    cams = PairedPaths(Cam(0.025, 0.165, arm_slope=0.004), Pulley(0.03, 0.165))
    hip, knee, ankle = plant.robot.joints
    joints = (hip, dataclasses.replace(knee, locked=5 * deg), dataclasses.replace(ankle, locked=0.0))
    muscles = pair_over("hip", pair(cams)), *plant.robot.muscles[1:3], OTHER
    plant = dataclasses.replace(plant, robot=dataclasses.replace(plant.robot, joints=joints, muscles=muscles))
    start = plant.init_state(ANGLES, PRESSURES)
    made = plugin_files(mujoco_model(plant, "other", start=start), "another")
    assert sum("hip1" in one for one in made.left_out) == 1
    assert sum("ankle" in one for one in made.left_out) == 2
    made.save(tmp_path)
    model = load_mujoco(tmp_path)  # the only model of the folder
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    assert [model.actuator(i).name for i in range(model.nu)] == ["hip1", "hip2", "knee1", "knee2", "rope"]
    assert model.na == 10  # pressures and spools
    place = model.joint("hip").dofadr[0]
    for angle in (-0.2, 0.1):
        data.qpos[place] = angle
        mujoco.mj_forward(model, data)
        wanted = plant.robot.torques(plant.robot.held((angle, 0.0, 0.0)), PRESSURES)[0]
        assert data.qfrc_actuator[place] == pytest.approx(float(wanted), abs=1e-12)


def test_what_mujoco_cannot_hold_is_refused():
    plant = plant_of("free")
    above = TwoBonePath(-0.025, 0.03, -0.02, -0.20, 0.1)
    mixed = over_two(MUSCLE, (above, Pulley(0.02, 0.04)), ("hip", "knee"), ("lengthens", "shortens"), "mixed")
    for robot, valve, field in (
        (dataclasses.replace(plant.robot, muscles=(*plant.robot.muscles[:3], mixed)), plant.valve, "over"),
        (plant.robot, mk.SwitchingValves(conductance=1e-9, supply=7e5, period=0.01), "valve"),
    ):
        with pytest.raises(ExportError) as caught:
            mujoco_model(robots.RobotPlant(robot, valve))
        assert caught.value.field == field
        assert caught.value.remedy


def test_a_robot_of_a_file_is_written_under_a_name_of_c(tmp_path):
    scenario = robots.RobotScenario.read("examples/robot/lei-leg.yaml")
    with pytest.raises(ParameterError) as caught:
        export(scenario, "mjcf", tmp_path, name="two legs")
    assert (caught.value.field, list(tmp_path.iterdir())) == ("name", [])


BLOCK = """    - name: on a block
      class: halved
      connector_length: 46 mm
      through: [{body: thigh, place: [30 mm, 0 mm, 185 mm]}, {body: shank, place: [30 mm, 0 mm, -185 mm]}]
      muscle: {specimen: MAS-10-180N-AA-MC-O, law: lei-mas-10-180n}
"""


class HalvedPath(robots.PathMuscle):
    """A muscle on a block: it moves half as far as its path."""

    short_name = "halved"

    def routed(self, skeleton):
        (whole,) = super().routed(skeleton)
        slopes = {joint: slope / 2 for joint, slope in whole.slopes.items()}
        bends = lambda: {joints: bend / 2 for joints, bend in whole.bends().items()}  # noqa: E731
        return [whole._replace(path=whole.path / 2, slopes=slopes, bends=bends)]


class LooserPulley(Pulley):
    """A pulley whose arm grows with the angle."""

    short_name = "looser"

    def length(self, angle, side):
        return super().length(angle, side) + 0.01 * angle**2


def test_a_class_with_its_own_path_is_not_exported_as_that_of_its_base(tmp_path):
    """What MuJoCo cannot have is an error that names it, or a torque of the joint."""
    robot = robots.RobotScenario.parse(ONE.replace("valve:", BLOCK + "valve:").split("reference:")[0])
    assert list(robot.robot.pairs) == [0]
    with pytest.raises(ExportError) as caught:
        export(robot, "mjcf", tmp_path / "out")
    assert caught.value.field == "muscles" and "on a block" in caught.value.message
    plain, looser = (path_transmission(kind(radius=0.03, rest_length=0.16), 1) for kind in (Pulley, LooserPulley))
    assert plain == Transmission(0.16, coefficient=0.03) and not looser.has_tendon
