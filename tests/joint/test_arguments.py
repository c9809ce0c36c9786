"""Arguments that are easily swapped, and lengths in millimetres."""

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
    with pytest.raises(RangeError, match="joint is a Load"):
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


def test_a_fit_can_be_validated_as_it_is():
    data = mk.catalog.dataset("dmsp-10-250-martens2017")
    fit = mk.identify(mk.ExponentialLaw, data)
    assert mk.validate(fit, data).of("ExponentialLaw").rmse == pytest.approx(fit.rmse, rel=1e-9)
    with pytest.raises(mk.McKibbenError, match="identify takes a kind of law and a dataset"):
        mk.identify(data, mk.ExponentialLaw)
