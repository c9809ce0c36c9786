import dataclasses

import pytest

import mckibben as mk
from mckibben import catalog
from mckibben.mechanism.dynamics import joint_load
from mckibben.robot import Body, Foot, Joint, MusclePair, OverJoint, PathMuscle, Place, Robot, RobotScenario
from mckibben.units import deg

FILE = "examples/robot/lei-leg.yaml"


@pytest.fixture(scope="session")
def scenario():
    """The example, small."""
    read = RobotScenario.read(FILE)
    few = read.uncertainty.model_copy(update={"draws": 20})
    landing = read.landing.model_copy(update={"levels": 4, "drop": (0.05,), "duration": 0.1})
    jump = read.jump.model_copy(update={"duration": 0.25, "latest": 0.05})
    return read.model_copy(update={"uncertainty": few, "landing": landing, "jump": jump})


@pytest.fixture(scope="session")
def plant(scenario):
    return scenario.plant()


@pytest.fixture(scope="session")
def pair():
    """Two muscles of the paper, contracted by 10 % at the angle 0."""
    joint = catalog.joint("knee-table-2")
    return dataclasses.replace(joint, geometry=dataclasses.replace(joint.geometry, connector_length=0.208))


def as_joint(robot):
    """The scenario of a robot of one joint as that of a joint, in closed form."""
    (name,) = robot.joint_names
    same = ("valve", "sensors", "command_delay", "duration", "control_period", "substeps")
    return mk.Scenario(
        name="joint",
        joint=robot.robot.pair(0),
        load=joint_load(robot.robot, (0.0,), 0, 9.81),
        controller=robot.controllers[name],
        reference=robot.references()[name],
        start={"angle": 0.0, "stiffness": 14.0},
        **{name: getattr(robot, name) for name in same},
    )


def robot_of(pair, freedom, names=("hip", "knee", "ankle")):
    """A robot of up to three joints, of which the knee bends backwards as its angle increases."""
    bodies = limb("thigh", 0.5, 0.19, 0.009), limb("shank", 0.3, 0.18, 0.005), limb("foot", 0.1, 0.05, 0.001)
    joints = tuple(
        Joint(name, (0.0, 1.0 if name == "knee" else -1.0, 0.0), -5 * deg, 5 * deg, body=body.name, place=at)
        for name, body, at in zip(names, bodies, PLACES, strict=False)
    )
    bodies = bodies[: len(names)]
    trunk = Body("trunk", 1.3, Place(z=0.1), (0.02, 0.02, 0.02))
    foot = Foot(bodies[-1].name, (*PLACES, Place(z=-0.1))[len(names)])
    return Robot((trunk, *bodies), joints, tuple(pair_over(name, pair) for name in names), freedom, foot)


PLACES = (Place(), Place(z=-0.4), Place(z=-0.37))


def limb(name, mass, centre, inertia, axial=0.0):
    """A body that hangs from its hinge, with its centre of mass at a distance."""
    return Body(name, mass, Place(z=-centre), (inertia, axial))


def pair_over(name, pair):
    """The muscles of a joint, over a joint of a robot."""
    return MusclePair(name, pair.geometry, pair.muscle1, pair.muscle2, pair.tendon)


def with_unit(robot, index, **changes):
    """A robot with changes of a pair or muscle."""
    units = list(robot.muscles)
    units[index] = dataclasses.replace(units[index], **changes)
    return dataclasses.replace(robot, muscles=tuple(units))


def over_two(muscle, paths, joints, actions, name):
    """A muscle over two joints."""
    over = tuple(OverJoint(*part) for part in zip(joints, actions, paths, strict=True))
    return PathMuscle(name, muscle, over)
