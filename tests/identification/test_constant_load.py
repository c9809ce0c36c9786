"""Tests with hanging weights: paths at constant loads, with a dry friction that is not that of the package."""

import numpy as np
import pytest
from scipy.optimize import brentq

from mckibben.dataset import IsobaricDataset, read_dataset
from mckibben.identification import identify_with_friction, shows_hysteresis
from mckibben.muscle import ExponentialLaw, forces
from mckibben.units import bar, deg, mm


def force_at(contraction, pressure):
    """Eq. 1 by hand [N]."""
    slope, intercept = 3 / np.tan(24 * deg) ** 2, 1 / np.sin(24 * deg) ** 2
    return pressure * np.pi * (12 * mm) ** 2 / 4 * (slope * (1 - contraction) ** 2 - intercept)


def hanging_weights(friction, *, loads=(30, 60, 90, 120), noise=5e-4, seed=0):
    """Pressure up and down at each load: shortening, friction holds the muscle longer; lengthening, shorter."""
    up = np.linspace(1.5, 6, 15) * bar
    columns = []
    for load in loads:
        for direction, sign, pressures in (("unloading", 1, up), ("loading", -1, up[::-1])):
            for pressure in pressures:
                at = load + sign * friction
                columns.append(
                    (pressure, brentq(lambda e, at=at, p=pressure: force_at(e, p) - at, -0.2, 0.4), load, direction)
                )
    pressure, contraction, force, direction = (np.array(values) for values in zip(*columns, strict=True))
    rng = np.random.default_rng(seed)
    return IsobaricDataset.of(
        pressure=pressure + 500 * rng.standard_normal(len(pressure)),
        contraction=contraction + noise * rng.standard_normal(len(pressure)),
        force=force.astype(float),
        direction=direction,
        set_pressure=pressure,
        initial_length=260 * mm,
        slack_force=0.0,
    )


@pytest.mark.parametrize("friction", [3.0, 8.0])
def test_law_and_friction_of_a_test_with_weights(friction):
    found = identify_with_friction(ExponentialLaw, hanging_weights(friction))
    assert found.hysteresis.friction.half_width == pytest.approx(friction, abs=0.3)
    points = np.array([0.20, 0.25, 0.15]), np.array([5, 3, 4]) * bar
    np.testing.assert_allclose(forces(found.fit.law, *points), force_at(*points), atol=2.0)


def test_weights_without_friction_show_none():
    assert not shows_hysteresis(hanging_weights(0.0))


def test_directions_follow_from_the_order_of_the_rows_at_each_load(tmp_path):
    known = hanging_weights(6.0)
    rows = zip(known.pressure / bar, 260 * (1 - known.contraction), known.force, strict=True)
    path = tmp_path / "weights.csv"
    path.write_text("\n".join(["pressure_bar,length_mm,load_N", *(",".join(map(str, row)) for row in rows)]))
    read = read_dataset(path, initial_length=260 * mm)
    same = read.table["direction"].to_numpy() == known.table["direction"].to_numpy()
    assert np.count_nonzero(~same) <= 4  # the first row after each reversal, where the muscle still shortens
