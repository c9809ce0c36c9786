"""Designs: against trying all lengths, and what is said of a wish that is impossible."""

import itertools

import numpy as np
import pytest

from mckibben.errors import ParameterError, UnitError
from mckibben.joint import AntagonisticJoint, SeriesSpring
from mckibben.numerics.compiled import compiled, numeric
from mckibben.plant import FirstOrderValve, JointPlant
from mckibben.reachability import Choice, Wanted, design, read_choice, read_wanted
from mckibben.reachability.design import BROKEN, margins_and_slopes
from mckibben.reachability.targets import nominal, put
from mckibben.units import deg

CHOICES = (Choice("connector_length", 0.19, 0.24), Choice("joint_radius", 0.02, 0.05))
HARD = Wanted((25.0, 30.0), (-20 * deg, 20 * deg))
EASY = Wanted((14.0, 18.0), (-15 * deg, 15 * deg))


@pytest.fixture(scope="module")
def plant(as_printed, load):
    return numeric(JointPlant(as_printed, load, FirstOrderValve(0.02)))


@compiled
def band(joint, angle, torque, tension):
    return joint.attainable_stiffness(angle, torque, minimum_tension=tension)


def margins(plant, wanted, lengths, tension=0.0):
    return margins_and_slopes(
        plant, lengths, np.linspace(*wanted.angles, 25), np.asarray(wanted.stiffness), wanted.torque, tension
    )


@pytest.mark.parametrize("wanted", [EASY, HARD], ids=["possible", "impossible"])
def test_no_lengths_tried_are_better(plant, wanted):
    found = design(plant, wanted, CHOICES)
    tried = [
        (float(np.min(margins(plant, wanted, {"connector_length": c, "joint_radius": r})[0])), c, r)
        for c, r in itertools.product(np.linspace(0.19, 0.24, 26), np.linspace(0.02, 0.05, 16))
    ]
    best = max(tried)
    assert found.margin >= best[0] - 1e-6
    for dc, dr in itertools.product((-2e-5, 0.0, 2e-5), (-2e-5, 0.0, 2e-5)):
        c, r = found.lengths["connector_length"] + dc, found.lengths["joint_radius"] + dr
        near = float(np.min(margins(plant, wanted, {"connector_length": c, "joint_radius": r})[0]))
        assert near <= found.margin + 1e-6, "nor are its neighbours"
    assert found.attained == (wanted is EASY) == (found.margin >= 0)
    holding = -np.asarray(plant.load.gravity_torque(found.angles))
    attained = band(put(plant, found.lengths).joint, found.angles, holding, 0.0)
    np.testing.assert_allclose(np.stack(attained), np.stack(found.stiffness), rtol=1e-9)
    if wanted is EASY:
        assert found.stiffness.lowest.max() < 14 and found.stiffness.highest.min() > 18
        assert "attained with connector_length 209.4 mm, joint_radius 31." in found.describe()
        assert {limit.split(" at ")[0] for limit in found.limits} == {"the lowest stiffness", "the highest stiffness"}
    else:
        assert f"impossible within these ranges; nearest is {'connector_length'}" in found.describe()
        assert found.shortfall == pytest.approx(-found.margin * 0.05 * 30, abs=0.05)
        assert f"misses it by up to {found.shortfall:.3g} N*m/rad; limited by the lowest" in found.describe()
    assert found.before == {"connector_length": pytest.approx(0.19), "joint_radius": pytest.approx(0.03)}


def test_derivatives_are_those_of_differences(plant):
    at, h = {"connector_length": 0.207, "joint_radius": 0.033}, 1e-7
    values, slopes = margins(plant, EASY, at)
    assert values.shape == (len(BROKEN), 2, 25)
    for name in at:
        ahead, behind = (margins(plant, EASY, {**at, name: at[name] + s})[0] for s in (h, -h))
        np.testing.assert_allclose(slopes[name], (ahead - behind) / (2 * h), rtol=1e-4, atol=1e-3)


def test_margins_are_what_they_say(plant, paper):
    lengths = {"connector_length": 0.208, "joint_radius": 0.03}
    values = np.asarray(margins(plant, EASY, lengths)[0])
    angles = np.linspace(*EASY.angles, 25)
    changed = put(plant, lengths)
    holding = -np.asarray(plant.load.gravity_torque(angles))
    low, high = band(changed.joint, angles, holding, 0.0)
    np.testing.assert_allclose(values[5, 0], (14 - np.asarray(low)) / 0.9, atol=1e-5)
    np.testing.assert_allclose(values[6, 1], (np.asarray(high) - 18) / 0.9, atol=1e-5)
    ends = [np.sqrt((0.37 + s * 0.03 * np.sin(angles)) ** 2 + (0.03 - 0.03 * np.cos(angles)) ** 2) for s in (1, -1)]
    contraction = 1 - (np.array(ends) - 0.208) / 0.18
    np.testing.assert_allclose(values[:2, 0] / 100, contraction + 0.03, atol=1e-9)
    np.testing.assert_allclose(values[2:4, 0] / 100, 0.25 - contraction, atol=1e-9)
    spare = Wanted(EASY.stiffness, EASY.angles, 2.0)
    for k, sign in ((0, -1), (1, 1)):
        more = band(changed.joint, angles, holding + 2.0 * sign, 0.0)
        given = np.asarray(margins(plant, spare, lengths)[0])
        np.testing.assert_allclose(given[6, k], (np.asarray(more[1]) - 18) / 0.9, atol=1e-5)
    taut = np.asarray(margins(plant, EASY, lengths, 60.0)[0])
    stiffer = band(changed.joint, angles, holding, 60.0)[0]
    np.testing.assert_allclose(taut[5, 0], (14 - np.asarray(stiffer)) / 0.9, atol=1e-5)
    assert taut[5].min() < values[5].min() - 0.1


def test_lengths_are_put_where_they_belong(plant):
    changed = put(plant, {"muscle2_length": 0.25, "joint_length": 0.4})
    assert nominal(changed, "muscle2_length") == 0.25 and nominal(changed, "muscle1_length") == 0.18
    assert nominal(changed, "joint_length") == 0.4 and nominal(plant, "joint_length") == 0.37
    both = put(plant, {"muscle_length": 0.3})
    assert [nominal(both, f"muscle{i}_length") for i in (1, 2)] == [0.3, 0.3]
    assert float(changed.joint.contractions(0.0, (0.0, 0.0))[1]) == pytest.approx(1 - 0.21 / 0.25)


def test_wishes_as_text():
    found = read_wanted("stiffness 12..18 N*m/rad over -20..20 deg", torque=1.5)
    assert (found.stiffness, found.torque) == ((12.0, 18.0), 1.5)
    assert found.angles == pytest.approx((-20 * deg, 20 * deg))
    assert found.describe() == "stiffness 12..18 N*m/rad over -20..20 deg, 1.5 N*m to spare"
    assert read_wanted("15 N*m/rad over 5 deg").angles == (5 * deg, 5 * deg)
    assert read_choice("joint.connector_length = 15 cm..260 mm") == Choice("connector_length", 0.15, 0.26)


@pytest.mark.parametrize(
    ("text", "kind", "said"),
    [
        ("stiffness 12..18", ParameterError, "nothing to design for"),
        ("12..18 N over -20..20 deg", UnitError, "not a unit of the kind"),
        ("12..18 N*m/rad over -90..20 deg", ParameterError, "angles reach 90 deg"),
    ],
)
def test_wishes_that_are_none(text, kind, said):
    with pytest.raises(kind, match=said):
        read_wanted(text)


@pytest.mark.parametrize(
    ("text", "kind", "said"),
    [
        ("connector_length", ParameterError, "no length and its range"),
        ("connector_length=150 mm", ParameterError, "no length and its range"),
        ("mass=1..2 mm", ParameterError, "cannot be varied in a design; known are connector_length"),
        ("connector_length=260..150 mm", UnitError, "reversed range"),
        ("connector_length=1..2 N", UnitError, "not a unit of the kind"),
        ("connector_length=1..2 parsec", UnitError, "unknown unit"),
    ],
)
def test_ranges_that_are_none(text, kind, said):
    with pytest.raises(kind, match=said):
        read_choice(text)


def test_what_cannot_be_designed(plant, as_printed, load):
    with pytest.raises(ParameterError, match="varies nothing"):
        design(plant, EASY, [])
    with pytest.raises(ParameterError, match="give each length once"):
        design(plant, EASY, [Choice("muscle_length", 0.1, 0.2), Choice("muscle1_length", 0.1, 0.2)])
    with pytest.raises(ParameterError, match="from 0 starts"):
        design(plant, EASY, CHOICES, starts=0)
    spring = SeriesSpring(stiffness=2e4, preload=50.0, travel=0.018)
    joint = AntagonisticJoint(as_printed.geometry, as_printed.muscle1, as_printed.muscle2, spring)
    with pytest.raises(ParameterError, match="leave out the spring"):
        design(JointPlant(joint, load, FirstOrderValve(0.02)), EASY, CHOICES)


def test_a_torque_to_spare_is_a_number():
    with pytest.raises(ParameterError, match="the torque to spare is -1"):
        Wanted((1.0, 2.0), (0.0, 0.1), -1.0)
    with pytest.raises(ParameterError, match="stiffness from 3 to 2"):
        Wanted((3.0, 2.0), (0.0, 0.1))
