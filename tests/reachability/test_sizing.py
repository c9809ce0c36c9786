"""Sizing: against an exhaustive grid of lengths, and results of infeasible targets."""

import itertools

import numpy as np
import pytest

from mckibben.errors import McKibbenError, ParameterError, UnitError
from mckibben.joint import AntagonisticJoint, Cam, PairedPaths, Pulley, SeriesSpring, TabulatedPath, TwoBonePath
from mckibben.muscle import return_spring
from mckibben.numerics.compiled import jit, numeric
from mckibben.plant import FirstOrderValve, JointPlant
from mckibben.reachability import DesignTarget, DesignVariable, design, parse_target, parse_variable
from mckibben.reachability.lengths import design_lengths, length_of, with_lengths
from mckibben.reachability.sizing import CONSTRAINTS, margins_and_jacobian
from mckibben.units import bar, deg

VARIABLES = (DesignVariable("connector_length", 0.19, 0.24), DesignVariable("joint_radius", 0.02, 0.05))
HARD = DesignTarget((25.0, 30.0), (-20 * deg, 20 * deg))
EASY = DesignTarget((14.0, 18.0), (-15 * deg, 15 * deg))


@pytest.fixture(scope="module")
def plant(as_printed, load):
    return numeric(JointPlant(as_printed, load, FirstOrderValve(0.02)))


@jit
def band(joint, angle, torque, tension):
    return joint.attainable_stiffness(angle, torque, minimum_tension=tension)


def margins(plant, target, lengths, tension=0.0):
    return margins_and_jacobian(
        plant, lengths, np.linspace(*target.angles, 25), np.asarray(target.stiffness), target.torque_reserve, tension
    )


@pytest.mark.slow
@pytest.mark.parametrize("target", [EASY, HARD], ids=["possible", "impossible"])
def test_no_lengths_tried_are_better(plant, target):
    found = design(plant, target, VARIABLES)
    tried = [
        (float(np.min(margins(plant, target, {"connector_length": c, "joint_radius": r})[0])), c, r)
        for c, r in itertools.product(np.linspace(0.19, 0.24, 26), np.linspace(0.02, 0.05, 16))
    ]
    best = max(tried)
    assert found.margin >= best[0] - 1e-6
    for dc, dr in itertools.product((-2e-5, 0.0, 2e-5), (-2e-5, 0.0, 2e-5)):
        c, r = found.lengths["connector_length"] + dc, found.lengths["joint_radius"] + dr
        near = float(np.min(margins(plant, target, {"connector_length": c, "joint_radius": r})[0]))
        assert near <= found.margin + 1e-6, "nor are its neighbours"
    assert found.attained == (target is EASY) == (found.margin >= 0)
    torque = -np.asarray(plant.load.gravity_torque(found.angles))
    attained = band(with_lengths(plant, found.lengths).joint, found.angles, torque, 0.0)
    np.testing.assert_allclose(np.stack(attained), np.stack(found.stiffness), rtol=1e-9)
    if target is EASY:
        assert found.stiffness.lowest.max() < 14 and found.stiffness.highest.min() > 18
        assert "attained with connector_length 209.4 mm, joint_radius 31." in found.describe()
        assert {limit.split(" at ")[0] for limit in found.active} == {
            "lowest attainable stiffness",
            "highest attainable stiffness",
        }
    else:
        assert f"infeasible within these bounds; nearest is {'connector_length'}" in found.describe()
        assert found.shortfall == pytest.approx(-found.margin * 0.05 * 30, abs=0.05)
        assert (
            f"misses the target by up to {found.shortfall:.3g} N*m/rad; violated constraints: lowest"
            in found.describe()
        )
    assert found.initial == {"connector_length": pytest.approx(0.19), "joint_radius": pytest.approx(0.03)}


@pytest.mark.slow
def test_a_design_knows_the_supply_of_the_valves(plant, as_printed, load):
    at = {"connector_length": 0.207, "joint_radius": 0.033}
    rated = margins(plant, EASY, at)[0]
    for supply, same in ((10 * bar, True), (3 * bar, False)):
        supplied = numeric(JointPlant(as_printed, load, FirstOrderValve(0.02, supply=supply)))
        found = margins(supplied, EASY, at)[0]
        assert np.allclose(found, rated, rtol=1e-12) == same
    assert np.min(found) < np.min(rated)


@pytest.mark.slow
def test_derivatives_are_those_of_differences(plant):
    at, h = {"connector_length": 0.207, "joint_radius": 0.033}, 1e-7
    values, jacobian = margins(plant, EASY, at)
    assert values.shape == (len(CONSTRAINTS), 2, 25)
    for name in at:
        ahead, behind = (margins(plant, EASY, {**at, name: at[name] + s})[0] for s in (h, -h))
        np.testing.assert_allclose(jacobian[name], (ahead - behind) / (2 * h), rtol=1e-4, atol=1e-3)


@pytest.mark.slow
def test_margins_are_those_of_the_attainable_set(plant, paper):
    lengths = {"connector_length": 0.208, "joint_radius": 0.03}
    values = np.asarray(margins(plant, EASY, lengths)[0])
    angles = np.linspace(*EASY.angles, 25)
    changed = with_lengths(plant, lengths)
    torque = -np.asarray(plant.load.gravity_torque(angles))
    low, high = band(changed.joint, angles, torque, 0.0)
    np.testing.assert_allclose(values[5, 0], (14 - np.asarray(low)) / 0.9, atol=1e-5)
    np.testing.assert_allclose(values[6, 1], (np.asarray(high) - 18) / 0.9, atol=1e-5)
    ends = [np.sqrt((0.37 + s * 0.03 * np.sin(angles)) ** 2 + (0.03 - 0.03 * np.cos(angles)) ** 2) for s in (1, -1)]
    contraction = 1 - (np.array(ends) - 0.208) / 0.18
    np.testing.assert_allclose(values[:2, 0] / 100, contraction + 0.03, atol=1e-9)
    np.testing.assert_allclose(values[2:4, 0] / 100, 0.25 - contraction, atol=1e-9)
    reserve = DesignTarget(EASY.stiffness, EASY.angles, 2.0)
    for k, sign in ((0, -1), (1, 1)):
        more = band(changed.joint, angles, torque + 2.0 * sign, 0.0)
        given = np.asarray(margins(plant, reserve, lengths)[0])
        np.testing.assert_allclose(given[6, k], (np.asarray(more[1]) - 18) / 0.9, atol=1e-5)
    taut = np.asarray(margins(plant, EASY, lengths, 60.0)[0])
    stiffer = band(changed.joint, angles, torque, 60.0)[0]
    np.testing.assert_allclose(taut[5, 0], (14 - np.asarray(stiffer)) / 0.9, atol=1e-5)
    assert taut[5].min() < values[5].min() - 0.1


def test_with_lengths_replaces_the_named_ones(plant):
    changed = with_lengths(plant, {"muscle2_length": 0.25, "joint_length": 0.4})
    assert length_of(changed, "muscle2_length") == 0.25 and length_of(changed, "muscle1_length") == 0.18
    assert length_of(changed, "joint_length") == 0.4 and length_of(plant, "joint_length") == 0.37
    both = with_lengths(plant, {"muscle_length": 0.3})
    assert [length_of(both, f"muscle{i}_length") for i in (1, 2)] == [0.3, 0.3]
    assert float(changed.joint.contractions(0.0, (0.0, 0.0))[1]) == pytest.approx(1 - 0.21 / 0.25)


def with_paths(plant, path1, path2):
    joint = AntagonisticJoint(PairedPaths(path1, path2), plant.joint.muscle1, plant.joint.muscle2)
    return JointPlant(joint, plant.load, plant.valve)


TABLE = np.linspace(-40, 40, 9) * deg
OWN = {
    "pulley and bone": (Pulley(30e-3, 0.16), TwoBonePath(30e-3, 162e-3, 35e-3, 0.0, connector_length=1e-3)),
    "table and cam": (TabulatedPath(TABLE, arms=0.03 + 0 * TABLE, rest_length=0.16), Cam(25e-3, 0.16)),
}
LENGTHS = {
    "pulley and bone": ("path1.radius", "path2.distal_x", "connector_length"),
    "table and cam": ("path1.rest_length", "path2.arm", "rest_length"),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", OWN)
def test_lengths_of_any_geometry_have_exact_derivatives(plant, name):
    own, h = with_paths(plant, *OWN[name]), 1e-7
    *chosen, shared = LENGTHS[name]
    at = {length: length_of(own, length) for length in chosen}
    _, jacobian = margins(numeric(own), EASY, at)
    for length in chosen:
        ahead, behind = (margins(numeric(own), EASY, at | {length: at[length] + s})[0] for s in (h, -h))
        assert np.abs(ahead - behind).max() > 0
        np.testing.assert_allclose(jacobian[length], (ahead - behind) / (2 * h), rtol=1e-4, atol=1e-3)
    known = design_lengths(own)
    assert known[shared] == [places[0] for given, places in known.items() if given.endswith(f".{shared}")]
    geometry = with_lengths(own, {shared: 0.02}).joint.geometry
    assert all(getattr(getattr(geometry, path), last) == 0.02 for _, path, last in known[shared])


@pytest.mark.slow
def test_pulleys_are_sized_as_the_best_of_a_grid(plant):
    own = numeric(with_paths(plant, Pulley(25e-3, 0.162), Pulley(25e-3, 0.162)))
    ranges = {"radius": (0.02, 0.05), "rest_length": (0.15, 0.18)}
    found = design(own, EASY, [DesignVariable(name, *ends) for name, ends in ranges.items()], starts=2)
    tried = [
        float(np.min(margins(own, EASY, dict(zip(ranges, lengths, strict=True)))[0]))
        for lengths in itertools.product(*(np.linspace(*ends, 16) for ends in ranges.values()))
    ]
    assert found.attained and found.margin >= max(tried) - 1e-6
    sized = found.plant.joint.geometry
    assert sized.path1.radius == sized.path2.radius == found.lengths["radius"]


def test_targets_and_variables_as_text():
    found = parse_target("stiffness 12..18 N*m/rad over -20..20 deg", torque_reserve=1.5)
    assert (found.stiffness, found.torque_reserve) == ((12.0, 18.0), 1.5)
    assert found.angles == pytest.approx((-20 * deg, 20 * deg))
    assert found.describe() == "stiffness 12..18 N*m/rad over -20..20 deg, torque reserve 1.5 N*m"
    assert parse_target("15 N*m/rad over 5 deg").angles == (5 * deg, 5 * deg)
    assert parse_variable("joint.geometry.connector_length = 15 cm..260 mm") == DesignVariable(
        "connector_length", 0.15, 0.26
    )


@pytest.mark.parametrize(
    ("text", "kind", "said"),
    [
        ("stiffness 12..18", ParameterError, "not a design target"),
        ("12..18 N over -20..20 deg", UnitError, "does not have the dimensions of"),
        ("12..18 N*m/rad over -90..20 deg", ParameterError, "angles reach 90 deg"),
    ],
)
def test_other_texts_are_no_target(text, kind, said):
    with pytest.raises(kind, match=said):
        parse_target(text)


@pytest.mark.parametrize(
    ("text", "kind", "said"),
    [
        ("connector_length", ParameterError, "not a length with its range"),
        ("connector_length=150 mm", ParameterError, "not a length with its range"),
        ("connector_length=100..200 m", ParameterError, "up to 200 m"),
        ("connector_length=260..150 mm", McKibbenError, "260"),
        ("connector_length=1..2 N", UnitError, "does not have the dimensions of"),
        ("connector_length=1..2 parsec", UnitError, "unknown unit"),
    ],
)
def test_other_texts_are_no_variable(text, kind, said):
    with pytest.raises(kind, match=said):
        parse_variable(text)


def test_what_cannot_be_designed(plant, as_printed, load):
    with pytest.raises(ParameterError, match="varies nothing"):
        design(plant, EASY, [])
    with pytest.raises(ParameterError, match="give each length once"):
        design(plant, EASY, [DesignVariable("muscle_length", 0.1, 0.2), DesignVariable("muscle1_length", 0.1, 0.2)])
    for variable in (DesignVariable("mass", 0.1, 0.2), DesignVariable("connector_length", -0.1, 0.2)):
        with pytest.raises(ParameterError) as caught:
            design(plant, EASY, [variable])
        assert caught.value.value in ("mass", -0.1) and caught.value.remedy
    with pytest.raises(ParameterError) as caught:
        design(plant, EASY, [DesignVariable("conector_lenght", 0.1, 0.2)])
    assert "'connector_length'" in caught.value.remedy
    with pytest.raises(ParameterError) as caught:
        DesignVariable("radius", 20.0, 40.0)
    assert (caught.value.upper, caught.value.unit) == (10.0, "m")
    sprung = AntagonisticJoint(as_printed.geometry, return_spring(4e3, 0.13), as_printed.muscle2)
    with pytest.raises(ParameterError) as caught:
        design(JointPlant(sprung, load, FirstOrderValve(0.02)), EASY, VARIABLES)
    assert caught.value.field == "return_spring"
    with pytest.raises(ParameterError, match="has 0 starts"):
        design(plant, EASY, VARIABLES, starts=0)
    spring = SeriesSpring(stiffness=2e4, preload=50.0, travel=0.018)
    joint = AntagonisticJoint(as_printed.geometry, as_printed.muscle1, as_printed.muscle2, spring)
    with pytest.raises(ParameterError, match="leave out the spring"):
        design(JointPlant(joint, load, FirstOrderValve(0.02)), EASY, VARIABLES)


def test_a_torque_reserve_is_not_negative():
    with pytest.raises(ParameterError, match="the torque reserve is -1"):
        DesignTarget((1.0, 2.0), (0.0, 0.1), -1.0)
    with pytest.raises(ParameterError, match="stiffness from 3 to 2"):
        DesignTarget((3.0, 2.0), (0.0, 0.1))
