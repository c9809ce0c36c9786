import dataclasses

import numpy as np
import pytest

from mckibben import catalog
from mckibben.leg import Leg, LegJoint, LegScenario, Link, Trunk, simulate_leg, simulate_legs
from mckibben.units import deg

FILE = "examples/leg/lei-leg.yaml"


@pytest.fixture(scope="session")
def scenario():
    """The example, small."""
    read = LegScenario.read(FILE)
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


def leg_of(pair, freedom, names=("hip", "knee", "ankle")):
    """A leg of up to three joints, of which the knee bends backwards as its angle increases."""
    links = (Link(0.4, 0.5, 0.19, 0.009), Link(0.37, 0.3, 0.18, 0.005), Link(0.1, 0.1, 0.05, 0.001))
    joints = tuple(LegJoint(-5 * deg, 5 * deg, pair, name=name, forward=name != "knee") for name in names)
    return Leg(Trunk(1.3, inertia=0.02, centre=0.1, freedom=freedom), links[: len(names)], joints)


@pytest.fixture(scope="session")
def single_run_like_batches():
    """Runs a start in both engines, as a batch with another one, and alone; returns the single run."""

    def run(plant, schedule, start, **given):
        over = {"start.upward_speed": [-0.5, start.upward_speed]}
        native, xla = (
            simulate_legs(plant, schedule, start, over=over, engine=one, **given) for one in ("native", "xla")
        )
        for name in native.table:
            np.testing.assert_allclose(native[name], xla[name], rtol=1e-9, atol=1e-12, err_msg=name)
        alone = simulate_leg(plant, schedule, start, **given)
        assert float(native["peak_force"][1]) == pytest.approx(float(alone["ground_up"].max()), rel=1e-9)
        return alone

    return run
