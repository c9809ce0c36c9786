"""What every export must hold: joints with every law and every geometry, and their torque from JAX."""

from pathlib import Path
from runpy import run_path
from typing import NamedTuple

import jax
import numpy as np
import pytest

from mckibben import AntagonisticJoint, KneeGeometry, Muscle, Specimen
from mckibben.joint import ScaledArms

TESTS = Path(__file__).parents[1]
LAWS = run_path(str(TESTS / "muscle" / "test_law_contract.py"))["EXAMPLES"]
PATHS = run_path(str(TESTS / "joint" / "test_paths.py"))
KNEE = KneeGeometry(0.37, 0.03, 0.208)
GEOMETRIES = {**PATHS["GEOMETRIES"], "scaled arms": ScaledArms(KNEE, 1.05)}


def law_joint(name: str) -> AntagonisticJoint:
    """The knee with two muscles of a law."""
    law = LAWS[name]()
    muscle = Muscle(Specimen("any", 0.18, 0.01, np.radians(25), domain=law.domain), law)
    return AntagonisticJoint(KNEE, muscle, muscle)


JOINTS = {
    **{name: lambda name=name: law_joint(name) for name in LAWS},
    **{
        name: lambda one=one: AntagonisticJoint(one, PATHS["MUSCLE"], PATHS["MUSCLE"])
        for name, one in GEOMETRIES.items()
    },
}


@pytest.fixture(scope="session")
def joints():
    """Functions that make the joints, by name."""
    return JOINTS


class Known(NamedTuple):
    """A joint, angles [rad] and pressures [Pa], and there torque, stiffness and tensions by JAX."""

    joint: AntagonisticJoint
    angles: np.ndarray
    pressures: np.ndarray
    torque: np.ndarray
    stiffness: np.ndarray
    tensions: np.ndarray


@jax.jit
def _asked(joint, angle, pressures):
    return *joint.evaluate(angle, pressures), jax.numpy.stack(joint.tensions(angle, pressures), -1)


@pytest.fixture(scope="session", params=JOINTS)
def known(request) -> Known:
    """Every law in the knee, and every geometry with Eq. 3; some muscles slack."""
    joint = JOINTS[request.param]()
    draw = np.random.default_rng(0)
    domain = joint.muscle1.domain
    angles = draw.uniform(-0.3, 0.3, 40)
    pressures = draw.uniform(domain.pressure_min, min(domain.pressure_max, 6e5), (40, 2))
    torque, stiffness, tensions = map(np.asarray, _asked(joint, angles, tuple(pressures.T)))
    return Known(joint, angles, pressures, torque, stiffness, tensions)
