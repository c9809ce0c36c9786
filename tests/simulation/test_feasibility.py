"""Is a reference within reach: against plain NumPy on the paper's equations, and in words."""

import re

import equinox as eqx
import numpy as np
import pytest

from mckibben.actuator import IdealValve
from mckibben.control import Constant, Reference, Sine, Step
from mckibben.plant import JointPlant
from mckibben.simulation import check_reference
from mckibben.units import deg

GRID = {"duration": 2.0, "control_period": 0.05}  # all of so many periods share a program


def reference(amplitude: float, stiffness: float) -> Reference:
    return Reference(angle=Sine(amplitude * deg, 0.5), stiffness=Constant(stiffness))


@pytest.fixture(scope="module")
def printed_plant(as_printed, load):
    return JointPlant(as_printed, load, IdealValve())


@pytest.mark.parametrize("geometry", ["as printed", "pre-contracted"])
def test_the_band_is_that_of_trying_all_pressures(geometry, printed_plant, plant, paper, paper_precontracted):
    chosen, knee = (printed_plant, paper) if geometry == "as printed" else (plant, paper_precontracted)
    reach = check_reference(chosen, reference(20.0, 15.0), **GRID)
    assert reach.times.shape == (40,)
    for k in range(40):
        angle = 20 * deg * np.sin(np.pi * 0.05 * k)
        assert reach.desired_angle[k] == pytest.approx(angle, abs=1e-12)
        low, high = knee.attainable(angle)
        np.testing.assert_allclose([reach.lowest[k], reach.highest[k]], [low, high], rtol=0, atol=2e-3)


def test_as_printed_20_deg_cannot_be_held_and_it_says_when_and_by_how_much(printed_plant, paper):
    reach = check_reference(printed_plant, reference(20.0, 72.5))
    assert not reach.feasible
    beyond = 10.4 * deg  # where one muscle is stretched past 3 %
    np.testing.assert_array_equal(np.isnan(reach.shortfall), np.isnan(reach.lowest))
    lost = np.isnan(reach.shortfall)
    assert lost[np.abs(reach.desired_angle) > beyond].all()
    assert not lost[np.abs(reach.desired_angle) < 10.3 * deg].any()

    text = reach.verdict()
    first = np.arcsin(10.38 / 20) / np.pi
    assert re.search(r"the joint cannot hold the desired angle for 65% of the run", text)
    assert "contraction -3.01 % is outside -3..25 % of" in reach.cause and reach.cause in text
    assert float(re.search(r"first at ([\d.]+) s", text)[1]) == pytest.approx(first, abs=2e-3)
    assert float(re.search(r"first at [\d.]+ s \(([\d.]+) deg\)", text)[1]) == pytest.approx(10.4, abs=0.05)

    short = np.nan_to_num(reach.shortfall)
    worst = int(short.argmax())
    low, high = paper.attainable(float(reach.desired_angle[worst]))
    assert short[worst] == pytest.approx(max(low - 72.5, 72.5 - high), abs=2e-3)
    assert f"{short[worst]:.3g} N*m/rad at {reach.times[worst]:.3g} s" in text
    assert "72.5" in text


def test_a_load_that_is_too_heavy_is_no_muscle_outside_its_domain(plant):
    reach = check_reference(eqx.tree_at(lambda p: p.load.mass2, plant, 50.0), reference(10.0, 15.0), **GRID)
    assert np.isnan(reach.lowest).all() and not reach.cause
    assert reach.verdict().startswith("no pressures within limits hold the desired angle for 100% of the run")


def test_what_is_out_of_reach_for_a_part_is_so_just_there(plant):
    stepping = Reference(angle=Constant(0.0), stiffness=Step(before=15.0, after=25.0, at=3.0))
    reach = check_reference(plant, stepping, duration=4.0, control_period=4e-4)  # as many periods as in 10 s
    np.testing.assert_array_equal(reach.shortfall > 0, reach.times >= 3.0)
    assert reach.shortfall[-1] == pytest.approx(25.0 - reach.highest[-1])
    assert "for 25% of the run, between 3 s and 4 s" in reach.verdict()
