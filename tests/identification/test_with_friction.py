"""A law is fitted with friction where, and only where, loading and unloading differ."""

from pathlib import Path

import pytest

import mckibben as mk
from mckibben import catalog
from mckibben.errors import IdentificationError
from mckibben.identification import identify_with_friction, shows_hysteresis
from mckibben.muscle import ExponentialLaw, ReynoldsLaw
from mckibben.units import bar, mm

RIG = Path(__file__).parents[2] / "examples" / "rig.csv"


@pytest.fixture(scope="module")
def rig():
    return mk.read_dataset(RIG)


def test_friction_is_fitted_where_loading_and_unloading_differ(rig):
    """The rig's friction is 12 N over 0.5 mm (`mckibben.rig.SimulatedIsobaricTest`)."""
    found = identify_with_friction(ExponentialLaw, rig)
    assert float(found.friction.half_width) == pytest.approx(12.0, rel=0.01)
    assert float(found.friction.presliding_length) == pytest.approx(0.5 * mm, rel=0.02)
    assert found.fit.rmse < 0.03 < 10 < mk.identify(ExponentialLaw, rig).rmse
    assert found.fit.law == mk.identify(ExponentialLaw, found.hysteresis.corrected(rig)).law
    assert found.note


def test_without_friction_the_fit_is_that_of_identify(rig):
    found = identify_with_friction(ExponentialLaw, rig, friction=False)
    assert found.fit.law == mk.identify(ExponentialLaw, rig).law
    assert found.hysteresis is found.friction is None and not found.note


def test_data_of_one_direction_are_fitted_as_before():
    data = catalog.dataset("dmsp-10-250-martens2017")
    found = identify_with_friction(ExponentialLaw, data)
    assert found.fit.law == mk.identify(ExponentialLaw, data).law and not found.note
    with pytest.raises(IdentificationError):
        identify_with_friction(ExponentialLaw, data, friction=True)


@pytest.mark.slow
def test_directions_that_do_not_differ_show_no_friction():
    muscle = mk.Muscle(catalog.specimen("MAS-10-180N-AA-MC-O"), catalog.law("lei-mas-10-180n"))
    protocol = mk.IsobaricProtocol(pressures=[2 * bar, 4 * bar, 6 * bar], repeats=1, samples=20)
    data = mk.SimulatedIsobaricTest(muscle, hysteresis=0.0).run(protocol, seed=2)
    assert len(data.directions) == 2 and not shows_hysteresis(data)
    found = identify_with_friction(ExponentialLaw, data)
    assert found.hysteresis is None and not found.note


def test_a_law_that_fits_worse_than_the_loops_are_wide_gets_no_friction(rig):
    """Its misfit would be taken for friction: 22 N in place of 12 N."""
    found = identify_with_friction(ReynoldsLaw, rig)
    assert found.hysteresis is None and found.note
    assert found.fit.law == mk.identify(ReynoldsLaw, rig).law
    assert float(identify_with_friction(ReynoldsLaw, rig, friction=True).friction.half_width) > 15.0


def test_reversed_directions_are_named(rig):
    other = {"loading": "unloading", "unloading": "loading"}
    directions = [other[str(one)] for one in rig.table["direction"].to_numpy()]
    found = identify_with_friction(
        ExponentialLaw, mk.IsobaricDataset(rig.table.assign(direction=("point", directions)))
    )
    assert found.hysteresis is None and "below" in found.note


def test_the_muscle_has_law_and_friction_of_the_fit(rig):
    found = identify_with_friction(ExponentialLaw, rig)
    muscle = found.muscle(mk.Specimen("mine", 0.2))
    assert (muscle.law, muscle.friction) == (found.fit.law, found.friction)
    assert float(found.predict(0.1, 3 * bar)) == pytest.approx(float(muscle.force(0.1, 3 * bar)))
    assert repr(found.fit) in repr(found) and repr(found.hysteresis) in repr(found)
    assert found.plot().axes
    unknown = identify_with_friction(ExponentialLaw, catalog.dataset("dmsp-10-250-martens2017"))
    del unknown.points.table.attrs["initial_length"]
    with pytest.raises(IdentificationError):
        unknown.muscle()
