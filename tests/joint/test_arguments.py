"""Arguments that are easily swapped, and lengths in millimetres."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import mckibben as mk
from mckibben.errors import RangeError


def test_swapped_arguments_are_refused():
    specimen, law = mk.catalog.specimen("DMSP-10-250"), mk.catalog.law("lei-mas-10-180n")
    muscle, knee = mk.Muscle(specimen, law), mk.catalog.joint("knee-table-2")
    load, valve = mk.catalog.load("knee-table-2"), mk.IdealValve()
    with pytest.raises(RangeError, match="specimen is a ExponentialLaw; give a Specimen; are arguments swapped"):
        mk.Muscle(law, specimen)
    with pytest.raises(RangeError, match="geometry is a Muscle"):
        mk.AntagonisticJoint(muscle, knee.geometry, muscle)
    with pytest.raises(RangeError, match="joint is a KneeLoad"):
        mk.JointPlant(load, knee, valve)
    with pytest.raises(RangeError, match=r"valve is 0\.02"):
        mk.JointPlant(knee, load, 0.02)


def test_numbers_in_other_units_are_refused():
    with pytest.raises(RangeError, match=r"joint_length is 370, outside 0\.\.10 m"):
        mk.KneeGeometry(370, 30, 208)
    with pytest.raises(RangeError, match=r"time_constant is 20, outside 0\.\.10 s"):
        mk.FirstOrderValve(20)
    with pytest.raises(RangeError, match="braid_angle is 25"):
        mk.ChouLaw(25, 0.01)


@pytest.mark.parametrize("kind", [np.float32, np.float64, np.int64])
def test_numpy_scalars_are_checked_as_any_number(kind):
    with pytest.raises(RangeError, match="joint_radius is -3"):
        mk.KneeGeometry(0.37, kind(-3), 0.2)
    with pytest.raises(RangeError, match=r"connector_length is 3, outside 0\.\.0\.34 m"):
        mk.KneeGeometry(np.float64(0.37), np.float64(0.03), kind(3))
    with pytest.raises(RangeError, match="mass1 is -3 kg"):
        mk.KneeLoad(kind(-3), 0.0, 0.1, 0.1, 0.01, 0.1)
    with pytest.raises(RangeError, match="contraction from 2 to 1"):
        mk.Domain(kind(2), kind(1))
    with pytest.raises(RangeError, match="valve is "):
        mk.JointPlant(mk.catalog.joint("knee-table-2"), mk.catalog.load("knee-table-2"), kind(1))


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
def test_pressures_that_are_no_pair_are_refused(method):
    knee = mk.catalog.joint("knee-table-2")
    for wrong in (PRESSURES, PRESSURES[:3], PRESSURES[:2], PRESSURES.T, 3e5, PRESSURES[:, 0], (3e5,), (3e5, 3e5, 3e5)):
        with pytest.raises(RangeError, match=r"not a pair; give \(p1, p2\)"):
            method(knee, wrong)
    expected = jax.tree.leaves(method(knee, (3e5, 4e5)))
    for right in ([3e5, 4e5], np.array([3e5, 4e5]), jnp.array([3e5, 4e5]), (np.float64(3e5), np.int64(400_000))):
        np.testing.assert_allclose(jax.tree.leaves(method(knee, right)), expected, rtol=1e-12)


def test_a_fit_can_be_validated_as_it_is():
    data = mk.catalog.dataset("dmsp-10-250-martens2017")
    fit = mk.identify(mk.ExponentialLaw, data)
    assert mk.validate(fit, data).of("ExponentialLaw").rmse == pytest.approx(fit.rmse, rel=1e-9)
    with pytest.raises(mk.McKibbenError, match="identify takes a class of law and a dataset"):
        mk.identify(data, mk.ExponentialLaw)
