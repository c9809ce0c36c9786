"""What the knee can hold, in both geometries, against plain NumPy."""

import numpy as np
import pytest

from mckibben.units import deg


def held_in(paper, angle: float) -> tuple[float, float]:
    """The stiffness band by trying very many pressures, 0..6 bar, both muscles taut and within -3..25 %."""
    eps = paper.contractions(angle)
    if not all(-0.03 <= e <= 0.25 for e in eps):
        return np.nan, np.nan
    arm1, arm2 = paper.eq5(angle)
    p1 = np.linspace(0, 6e5, 60_001)
    force2 = (-paper.G * np.sin(np.pi / 6 - angle) + paper.eq3(eps[0], p1) * arm1) / arm2
    at0, at1 = paper.eq3(eps[1], 0.0), paper.eq3(eps[1], 1e5)
    p2 = (force2 - at0) / (at1 - at0) * 1e5
    held = (paper.eq3(eps[0], p1) >= 0) & (force2 >= 0) & (p2 >= 0) & (p2 <= 6e5)
    if not held.any():
        return np.nan, np.nan
    stiffness = paper.stiffness(angle, (p1[held], p2[held]))
    return float(stiffness.min()), float(stiffness.max())


@pytest.fixture
def references(paper, paper_precontracted):
    return {"as_printed": paper, "pre_contracted": paper_precontracted}


@pytest.mark.parametrize(
    ("key", "band", "angles"),
    [("as_printed", (70.5, 73.4), (-10.3, 10.3)), ("pre_contracted", (10.0, 19.5), (-36.3, 38.3))],
)
def test_the_numbers_of_the_documentation(joint_maps, references, key, band, angles):
    found = joint_maps[key]
    assert found.at(0.0) == pytest.approx(band, abs=0.05)
    assert found.at(0.0) == pytest.approx(held_in(references[key], 0.0), abs=2e-3)
    step = 80 / 120
    assert np.array(found.static_range) / deg == pytest.approx(angles, abs=step)


@pytest.mark.parametrize("key", ["as_printed", "pre_contracted"])
def test_the_band_is_that_of_trying_all_pressures(joint_maps, references, key):
    found = joint_maps[key]
    for k in range(0, 121, 6):
        np.testing.assert_allclose(
            [found.lowest[k], found.highest[k]], held_in(references[key], found.angles[k]), rtol=0, atol=5e-3
        )


def test_as_printed_it_is_held_up_to_3_percent_of_stretch(joint_maps, paper):
    low, high = joint_maps["as_printed"].static_range
    assert min(paper.contractions(low)) > -0.03
    assert min(paper.contractions(low - 80 / 120 * deg)) < -0.03
    assert min(paper.contractions(high + 80 / 120 * deg)) < -0.03


def test_as_printed_the_bands_of_0_and_5_deg_do_not_overlap(joint_maps):
    found = joint_maps["as_printed"]
    assert found.at(5 * deg)[0] > found.at(0.0)[1]


@pytest.mark.parametrize("key", ["as_printed", "pre_contracted"])
def test_the_map_over_torque_meets_the_curve_at_the_torque_of_gravity(joint_maps, references, key):
    found = joint_maps[key]
    np.testing.assert_allclose(found.gravity_torque, -references[key].G * np.sin(np.pi / 6 - found.angles), rtol=1e-9)
    assert found.lowest_at.shape == found.highest_at.shape == (121, 121)
    k = 60
    assert found.angles[k] == pytest.approx(0.0, abs=1e-12)
    for bounds, curve in ((found.lowest_at, found.lowest), (found.highest_at, found.highest)):
        between = np.interp(found.gravity_torque[k], found.torques, bounds[:, k])
        assert between == pytest.approx(curve[k], abs=0.02)
