import dataclasses

import pytest

from mckibben import catalog
from mckibben.robot import Joint, Link, Robot, RobotScenario, Trunk
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


def robot_of(pair, freedom, names=("hip", "knee", "ankle")):
    """A robot of up to three joints, of which the knee bends backwards as its angle increases."""
    links = (Link(0.4, 0.5, 0.19, 0.009), Link(0.37, 0.3, 0.18, 0.005), Link(0.1, 0.1, 0.05, 0.001))
    joints = tuple(Joint(-5 * deg, 5 * deg, pair, name=name, forward=name != "knee") for name in names)
    return Robot(Trunk(1.3, inertia=0.02, centre=0.1, freedom=freedom), links[: len(names)], joints)
