"""Constraints of a sized joint against the attainable set, lengths of any geometry, and joints that are sized."""

import dataclasses
import itertools

import numpy as np
import pytest

import mckibben as mk
from mckibben.actuator import FirstOrderValve
from mckibben.errors import ParameterError, UnreachableError
from mckibben.joint import AntagonisticJoint, Cam, PairedPaths, Pulley, SeriesSpring, TabulatedPath, TwoBonePath
from mckibben.muscle import return_spring
from mckibben.numerics.compiled import jit, numeric
from mckibben.plant import JointPlant
from mckibben.reachability import LengthRange, Requirement, size
from mckibben.reachability.lengths import design_lengths, with_lengths
from mckibben.reachability.margins import CONSTRAINTS, constraint_margins
from mckibben.units import bar, deg

ANGLES = np.linspace(-15, 15, 25) * deg
STIFFNESS = np.array([14.0, 18.0])
LENGTHS = (LengthRange("connector_length", 0.19, 0.24), LengthRange("joint_radius", 0.02, 0.05))


@pytest.fixture(scope="module")
def plant(as_printed, load):
    return numeric(JointPlant(as_printed, load, FirstOrderValve(0.02)))


@jit
def band(joint, angle, torque, tension):
    return joint.attainable_stiffness(angle, torque, minimum_tension=tension)


@jit
def margins(plant, lengths, reserve, tension):
    return constraint_margins(with_lengths(plant, lengths), ANGLES, STIFFNESS, reserve, tension)


@pytest.fixture
def need(as_printed, load):
    return Requirement(
        load, (-15 * deg, 15 * deg), 4.0, 6 * bar, (14.0, 16.0), spread=0.0, joint=as_printed, lengths=LENGTHS
    )


@pytest.mark.slow
def test_margins_are_those_of_the_attainable_set(plant):
    lengths = {"connector_length": 0.208, "joint_radius": 0.03}
    values = np.asarray(margins(plant, lengths, 0.0, 0.0))
    assert values.shape == (len(CONSTRAINTS), 2, 25)
    changed = with_lengths(plant, lengths)
    torque = -np.asarray(plant.load.gravity_torque(ANGLES))
    low, high = band(changed.joint, ANGLES, torque, 0.0)
    np.testing.assert_allclose(values[5, 0], (14 - np.asarray(low)) / 0.9, atol=1e-5)
    np.testing.assert_allclose(values[6, 1], (np.asarray(high) - 18) / 0.9, atol=1e-5)
    ends = [np.sqrt((0.37 + s * 0.03 * np.sin(ANGLES)) ** 2 + (0.03 - 0.03 * np.cos(ANGLES)) ** 2) for s in (1, -1)]
    contraction = 1 - (np.array(ends) - 0.208) / 0.18
    np.testing.assert_allclose(values[:2, 0] / 100, contraction + 0.03, atol=1e-9)
    np.testing.assert_allclose(values[2:4, 0] / 100, 0.25 - contraction, atol=1e-9)
    reserved, taut = margins(plant, lengths, 2.0, 0.0), margins(plant, lengths, 0.0, 60.0)
    for k, sign in ((0, -1), (1, 1)):
        more = band(changed.joint, ANGLES, torque + 2.0 * sign, 0.0)
        np.testing.assert_allclose(reserved[6, k], (np.asarray(more[1]) - 18) / 0.9, atol=1e-5)
    stiffer = band(changed.joint, ANGLES, torque, 60.0)[0]
    np.testing.assert_allclose(taut[5, 0], (14 - np.asarray(stiffer)) / 0.9, atol=1e-5)


@pytest.mark.slow
def test_a_joint_gets_the_lengths_of_an_exhaustive_grid(plant, need):
    """The margins of 1,681 joints, and of the neighbours of the best one."""
    best = size(need).best
    supplied = dataclasses.replace(plant, valve=FirstOrderValve(0.02, supply=0.9 * need.supply))

    def least(connector, radius):
        lengths = {"connector_length": connector, "joint_radius": radius}
        stiffness = np.array(need.stiffness)
        sized = with_lengths(supplied, lengths)
        return float(np.min(compiled_margins(sized, stiffness, need.reserve)))

    found = least(best.lengths["connector_length"], best.lengths["joint_radius"])
    assert found >= 0
    grid = itertools.product(np.linspace(0.19, 0.24, 26), np.linspace(0.02, 0.05, 16))
    assert found >= max(least(*lengths) for lengths in grid) - 1e-4
    for dc, dr in itertools.product((-2e-5, 0.0, 2e-5), (-2e-5, 0.0, 2e-5)):
        assert least(best.lengths["connector_length"] + dc, best.lengths["joint_radius"] + dr) <= found + 1e-3
    assert best.stiffness[1][0] <= 14.0 and best.stiffness[1][1] >= 16.0
    assert best.plant.joint.geometry.connector_length == best.lengths["connector_length"]


@jit
def compiled_margins(plant, stiffness, reserve):
    return constraint_margins(plant, ANGLES, stiffness, reserve, 5.0)


@pytest.mark.slow
def test_a_joint_that_cannot_be_sized_names_the_limits_and_the_closest_lengths(need):
    with pytest.raises(UnreachableError) as caught:
        size(dataclasses.replace(need, stiffness=(25.0, 30.0)))
    assert "attainable stiffness" in str(caught.value) and "connector_length 2" in str(caught.value)


def test_new_lengths_replace_the_named_ones_and_scale_the_volume(plant):
    changed = with_lengths(plant, {"muscle2_length": 0.25, "joint_length": 0.4}).joint
    lengths = [float(muscle.specimen.initial_length) for muscle in (changed.muscle1, changed.muscle2)]
    assert lengths == [0.18, 0.25] and float(changed.geometry.joint_length) == 0.4
    assert float(plant.joint.geometry.joint_length) == 0.37
    assert float(changed.contractions(0.0, (0.0, 0.0))[1]) == pytest.approx(1 - 0.21 / 0.25)
    volumes = [float(muscle.specimen.volume(0.1)) for muscle in (changed.muscle1, changed.muscle2)]
    assert volumes[1] / volumes[0] == pytest.approx(0.25 / 0.18)


TABLE = np.linspace(-40, 40, 9) * deg


@pytest.mark.parametrize(
    ("paths", "shared"),
    [
        ((Pulley(30e-3, 0.16), TwoBonePath(30e-3, 162e-3, 35e-3, 0.0, connector_length=1e-3)), "connector_length"),
        ((TabulatedPath(TABLE, arms=0.03 + 0 * TABLE, rest_length=0.16), Cam(25e-3, 0.16)), "rest_length"),
    ],
    ids=["pulley and bone", "table and cam"],
)
def test_lengths_of_any_geometry_have_names(plant, paths, shared):
    joint = AntagonisticJoint(PairedPaths(*paths), plant.joint.muscle1, plant.joint.muscle2)
    known = design_lengths(joint)
    assert known[shared] == [places[0] for name, places in known.items() if name.endswith(f".{shared}")]
    geometry = with_lengths(JointPlant(joint, plant.load, plant.valve), {shared: 0.02}).joint.geometry
    assert all(getattr(getattr(geometry, path), last) == 0.02 for _, path, last in known[shared])


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
        ({"lengths": ()}, "lengths"),
    ],
)
def test_a_wrong_requirement_names_the_field(need, change, field):
    with pytest.raises((ParameterError, mk.errors.RangeError)) as caught:
        dataclasses.replace(need, **change)
    assert caught.value.field == field


@pytest.mark.parametrize(
    "lengths",
    [
        (LengthRange("conector_lenght", 0.1, 0.2),),
        (LengthRange("connector_length", -0.1, 0.2),),
        (LengthRange("muscle_length", 0.1, 0.2), LengthRange("muscle1_length", 0.1, 0.2)),
    ],
    ids=["unknown", "negative", "twice"],
)
def test_lengths_that_a_joint_lacks_are_refused(need, lengths):
    with pytest.raises(ParameterError) as caught:
        size(dataclasses.replace(need, lengths=lengths))
    assert caught.value.field == "lengths"


def test_a_length_has_a_range_in_metres():
    with pytest.raises(ParameterError):
        LengthRange("radius", 0.2, 0.1)
    with pytest.raises(mk.errors.RangeError):
        LengthRange("radius", 20.0, 40.0e3)


def test_joints_with_springs_are_not_sized(need, as_printed):
    spring = SeriesSpring(stiffness=2e4, preload=50.0, travel=0.018)
    for joint in (
        AntagonisticJoint(as_printed.geometry, return_spring(4e3, 0.13), as_printed.muscle2),
        dataclasses.replace(as_printed, tendon=spring),
    ):
        with pytest.raises(ParameterError) as caught:
            size(dataclasses.replace(need, joint=joint))
        assert caught.value.field == "joint"
