"""Arguments that are easily swapped, and lengths in millimetres."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import mckibben as mk
from mckibben import catalog, rig
from mckibben.control import Sum
from mckibben.errors import McKibbenWarning, RangeError
from mckibben.muscle import ReynoldsLaw
from mckibben.rig.bench import RigLimits

EQ3 = -245.8, 109, 3.216, -3.442, 255.6, -13.18  # of the paper, in bar and percent


@pytest.mark.parametrize(
    ("make", "field", "value", "in_si"),
    [
        (lambda: mk.KneeGeometry(370, 30, 208), "joint_length", 370, "370 mm is 0.37 m"),
        (lambda: mk.Specimen("mine", 180), "initial_length", 180, "180 mm is 0.18 m"),
        (lambda: mk.Domain(0.0, 25), "contraction_max", 25, "25 % is 0.25"),
        (lambda: mk.FirstOrderValve(20), "time_constant", 20, "20 ms is 0.02 s"),
        (lambda: mk.PendulumLoad(1.0, 0.3, hanging_angle=90), "hanging_angle", 90, "90 deg is 1.5708 rad"),
        (lambda: mk.ChouLaw(25, 0.01), "braid_angle", 25, "25 deg is 0.436332 rad"),
        (lambda: mk.ExponentialLaw(*EQ3, decay=30), "a2 + c2", 109 - 13.18, "1 N/bar is 1e-05 N/Pa"),
        (lambda: ReynoldsLaw(f0=179.2, f1=139, k0=1427, k1=7.7e-3), "f1", 139, "139 N/bar is 0.00139 N/Pa"),
        (lambda: mk.MaxwellSlip(5.0, 0.5), "presliding_length", 0.5, "0.5 mm is 0.0005 m"),
        (lambda: mk.FirstOrderValve(0.02, rate=20), "rate", 20, "20 bar/s is 2e+06 Pa/s"),
        (lambda: mk.Reference(Sum((Sum((mk.Sine(20, 0.5),)),)), 15.0), "amplitude", 20, "20 deg is 0.349066 rad"),
        (lambda: rig.IsobaricProtocol(pressures=[0, 1, 2]), "pressures", 1, "1 bar is 100000 Pa"),
        (lambda: RigLimits(pressure=6e5, force=600.0, stretch=10, shorten=0.05), "stretch", 10, "10 mm is 0.01 m"),
        (lambda: mk.ExponentialLaw(*np.divide(EQ3, [1, 1e5] * 3), decay=0.3), "decay", 0.3, "0.3 1/percent is 30"),
    ],
)
def test_numbers_in_other_units_are_refused_and_given_in_si(make, field, value, in_si):
    with pytest.raises(RangeError) as refused:
        make()
    assert (refused.value.field, refused.value.value) == (field, value)
    assert in_si in str(refused.value)


def test_pressures_in_bar_are_warned_of():
    knee = mk.catalog.joint("knee-table-2")
    for at in (lambda: knee.muscle1.force(0.1, 3.0), lambda: knee.torque(0.1, (2.0, 3.0))):
        with pytest.warns(mk.errors.McKibbenWarning, match="3 Pa"):
            at()


PRESSURES = np.full((4, 2), 3e5)
METHODS = {
    "contractions": lambda knee, p: knee.contractions(0.0, p),
    "tensions": lambda knee, p: knee.tensions(0.0, p),
    "torque": lambda knee, p: knee.torque(0.0, p),
    "stiffness": lambda knee, p: knee.stiffness(0.0, p),
    "torque_and_stiffness": lambda knee, p: knee.torque_and_stiffness(0.0, p),
    "closed_valve_stiffness": lambda knee, p: knee.closed_valve_stiffness(0.0, p),
    "affine_map": lambda knee, p: knee.affine_map(0.0).torque(p),
    "init_state": lambda knee, p: mk.JointPlant(knee, mk.catalog.load("knee-table-2"), mk.IdealValve()).init_state(
        0.0, p
    ),
}


@pytest.mark.parametrize("method", METHODS.values(), ids=METHODS)
@pytest.mark.slow
def test_pressures_that_are_no_pair_are_refused(method):
    knee = mk.catalog.joint("knee-table-2")
    for wrong in (PRESSURES, PRESSURES[:3], PRESSURES[:2], PRESSURES.T, 3e5, PRESSURES[:, 0], (3e5,), (3e5, 3e5, 3e5)):
        with pytest.raises(RangeError, match=r"not a pair; give \(p1, p2\)"):
            method(knee, wrong)
    expected = jax.tree.leaves(method(knee, (3e5, 4e5)))
    for right in ([3e5, 4e5], np.array([3e5, 4e5]), jnp.array([3e5, 4e5]), (np.float64(3e5), np.int64(400_000))):
        np.testing.assert_allclose(jax.tree.leaves(method(knee, right)), expected, rtol=1e-12, atol=1e-15)


@pytest.mark.slow
@pytest.mark.parametrize(
    "call",
    [
        lambda joint: joint.attainable_stiffness(np.array([0.1, 10]), 0.0),
        lambda joint: joint.attainable_torque(np.array([0.1, -10.0])),
    ],
)
def test_an_angle_in_degrees_is_noticed(call):
    with pytest.warns(McKibbenWarning, match="10 rad"):
        call(catalog.joint("knee-table-2"))
