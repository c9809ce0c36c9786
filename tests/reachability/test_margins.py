"""Constraints of a sized joint against the attainable set, lengths of any geometry, and joints that are sized."""

import dataclasses

import numpy as np
import pytest

import mckibben as mk
from mckibben.actuator import FirstOrderValve
from mckibben.errors import ParameterError
from mckibben.numerics.compiled import jit, numeric
from mckibben.plant import JointPlant
from mckibben.reachability import Requirement
from mckibben.reachability.margins import CONSTRAINTS, constraint_margins
from mckibben.units import bar, deg

ANGLES = np.linspace(-15, 15, 25) * deg
STIFFNESS = np.array([14.0, 18.0])


@pytest.fixture(scope="module")
def plant(as_printed, load):
    return numeric(JointPlant(as_printed, load, FirstOrderValve(0.02)))


@jit
def band(joint, angle, torque, tension):
    return joint.attainable_stiffness(angle, torque, minimum_tension=tension)


@jit
def margins(plant, reserve, tension):
    return constraint_margins(plant, ANGLES, STIFFNESS, reserve, tension)


@pytest.fixture
def need(load):
    return Requirement(load, (-15 * deg, 15 * deg), 4.0, 6 * bar, (14.0, 16.0), spread=0.0)


@pytest.mark.slow
def test_margins_are_those_of_the_attainable_set(plant):
    geometry = dataclasses.replace(plant.joint.geometry, connector_length=0.208, joint_radius=0.03)
    changed = dataclasses.replace(plant, joint=dataclasses.replace(plant.joint, geometry=geometry))
    values = np.asarray(margins(changed, 0.0, 0.0))
    assert values.shape == (len(CONSTRAINTS), 2, 25)
    torque = -np.asarray(plant.load.gravity_torque(ANGLES))
    low, high = band(changed.joint, ANGLES, torque, 0.0)
    np.testing.assert_allclose(values[5, 0], (14 - np.asarray(low)) / 0.9, atol=1e-5)
    np.testing.assert_allclose(values[6, 1], (np.asarray(high) - 18) / 0.9, atol=1e-5)
    ends = [np.sqrt((0.37 + s * 0.03 * np.sin(ANGLES)) ** 2 + (0.03 - 0.03 * np.cos(ANGLES)) ** 2) for s in (1, -1)]
    contraction = 1 - (np.array(ends) - 0.208) / 0.18
    np.testing.assert_allclose(values[:2, 0] / 100, contraction + 0.03, atol=1e-9)
    np.testing.assert_allclose(values[2:4, 0] / 100, 0.25 - contraction, atol=1e-9)
    reserved, taut = margins(changed, 2.0, 0.0), margins(changed, 0.0, 60.0)
    for k, sign in ((0, -1), (1, 1)):
        more = band(changed.joint, ANGLES, torque + 2.0 * sign, 0.0)
        np.testing.assert_allclose(reserved[6, k], (np.asarray(more[1]) - 18) / 0.9, atol=1e-5)
    stiffer = band(changed.joint, ANGLES, torque, 60.0)[0]
    np.testing.assert_allclose(taut[5, 0], (14 - np.asarray(stiffer)) / 0.9, atol=1e-5)


def test_a_requirement_is_read_from_a_file_with_all_its_mistakes(tmp_path):
    found = Requirement.read("examples/sizing/pulleys.yaml")
    assert found.load == mk.PendulumLoad(2.0, 0.25) and found.stiffness == (15.0, 18.0)
    assert found.angles == pytest.approx((-30 * deg, 30 * deg))
    text = "load: {class: pendulum, mass: -2 kg, length: 250 mm}\nangles: [-30 deg, 30 deg]\ncycle: 2 m\nsupply: 6 bar"
    (tmp_path / "need.yaml").write_text(text, encoding="utf-8")
    with pytest.raises(mk.errors.ScenarioError) as caught:
        Requirement.read(tmp_path / "need.yaml")
    assert {problem.field for problem in caught.value.problems} == {"load.mass", "cycle"}


@pytest.mark.parametrize(
    ("change", "field"),
    [
        ({"angles": (0.5, 0.5)}, "angles"),
        ({"cycle": 0.0}, "cycle"),
        ({"stiffness": (20.0, 10.0)}, "stiffness"),
        ({"stiffness": (20.0,)}, "stiffness"),
        ({"torque": -1.0}, "torque"),
        ({"supply": float("nan")}, "supply"),
        ({"widest": -1.0}, "widest"),
    ],
)
def test_a_wrong_requirement_names_the_field(need, change, field):
    with pytest.raises((ParameterError, mk.errors.RangeError)) as caught:
        dataclasses.replace(need, **change)
    assert caught.value.field == field
