"""Tests with hanging weights: paths at constant loads, with a dry friction that is not that of the package."""

import subprocess

import numpy as np
import pytest
from scipy.optimize import brentq, least_squares

from mckibben.dataset import IsobaricDataset, Recording, read_dataset
from mckibben.errors import DomainWarning, IdentificationError
from mckibben.identification import fit_law, identify_with_friction, inverse_table, shows_hysteresis
from mckibben.identification.least_squares import FitProblem, grid_search, solve
from mckibben.muscle import ExponentialLaw, forces
from mckibben.report.identification import loops
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
@pytest.mark.slow
def test_law_and_friction_of_a_test_with_weights(friction):
    data = hanging_weights(friction)
    found = identify_with_friction(ExponentialLaw, data)
    assert found.hysteresis.friction.half_width == pytest.approx(friction, abs=0.3)
    assert found.robust.groups == 8  # ways of four loads, also without friction in the forces
    points = np.array([0.24, 0.23, 0.2]), np.array([5, 4, 3]) * bar
    np.testing.assert_allclose(forces(found.law, *points), force_at(*points), atol=1.0)
    figure = loops(data, found.hysteresis)
    assert [axes.get_title(loc="left").split()[1:3] for axes in figure.axes[1:]] == [
        [f"{n}", "N,"] for n in (30, 60, 90, 120)
    ]


@pytest.mark.slow
def test_measured_loads_are_recognised_by_their_levels_or_by_the_set_ones(tmp_path):
    """A load cell in series with the weights is noisy."""
    typed = hanging_weights(6.0)
    noisy = typed.table.assign(force=typed.table["force"] + np.random.default_rng(1).normal(0, 0.3, len(typed)))
    assert identify_with_friction(ExponentialLaw, IsobaricDataset(noisy)).friction.half_width == pytest.approx(
        6, abs=0.3
    )
    columns = {name: np.repeat(noisy[name].to_numpy(), 40) for name in ("pressure", "contraction", "force")}
    recording = Recording.of(time=np.arange(40 * len(typed)) / 20, **columns, initial_length=260 * mm)
    points = recording.plateaus().dataset  # whose lightest load is no offset of the load cell
    assert points.force.min() > 29 and identify_with_friction(ExponentialLaw, points).friction.half_width > 5.7
    IsobaricDataset(noisy.assign(set_force=("point", typed.force))).to_csv(tmp_path / "weights.csv")
    held = read_dataset(tmp_path / "weights.csv")
    found = identify_with_friction(ExponentialLaw, held)
    assert found.hysteresis.friction.half_width == pytest.approx(6.0, abs=0.3)


def test_off_the_points_a_prediction_is_flagged_and_its_interval_grows_with_the_distance():
    """The points at loads of 30 to 120 N leave most of the box of pressures and contractions unmeasured."""
    fit = fit_law(ExponentialLaw, hanging_weights(0.0))
    contraction, pressure = np.array([0.24, 0.2, 0.15, 0.1, 0.05]), np.full(5, 5 * bar)
    assert fit.law.domain.contains(contraction, pressure).tolist() == [True, False, False, False, False]
    with pytest.warns(DomainWarning, match="4 of 5 points"):
        fit.predict(contraction, pressure)
    band = fit.force_intervals(contraction, pressure).prediction
    assert (np.diff(band.upper - band.lower) > 0).all()
    assert band.contains(force_at(contraction, pressure)).all()


def test_weights_without_friction_show_none():
    assert not shows_hysteresis(hanging_weights(0.0))


def test_directions_follow_from_the_order_of_the_rows_at_each_load(tmp_path):
    known = hanging_weights(6.0)
    rows = zip(known.pressure / bar, 260 * (1 - known.contraction), known.force, strict=True)
    path = tmp_path / "weights.csv"
    path.write_text("\n".join(["pressure_bar,length_mm,hung", *(",".join(map(str, row)) for row in rows)]))
    read = read_dataset(path, columns={"hung": "set_force_N"}, initial_length=260 * mm)
    assert "set_pressure" not in read.table  # a sweep has no levels
    same = read.table["direction"].to_numpy() == known.table["direction"].to_numpy()
    assert np.count_nonzero(~same) <= 4  # the first row after each reversal, where the muscle still shortens


def test_residuals_are_those_of_the_measured_contraction():
    """As by least squares of the contractions, where the law gives the set load, and not as those of the force."""
    data = hanging_weights(0.0, noise=1e-3)
    fit, names = fit_law(ExponentialLaw, data, robust=False), ("a1", "a2", "b1", "b2", "c1", "c2")
    start = np.array([fit.estimates[name] for name in names])

    def law(values):
        return ExponentialLaw(*(values * start), decay=fit.law.decay)

    def residuals(values):
        contraction, step = data.contraction, 1e-6
        for _ in range(5):
            left, at, right = (forces(law(values), contraction + side, data.pressure) for side in (-step, 0.0, step))
            contraction = contraction - (at - data.force) * 2 * step / (right - left)
        return 1e3 * (data.contraction - contraction)

    best = law(least_squares(residuals, np.ones(6), x_scale="jac").x)
    places = np.array([0.24, 0.23, 0.2]), np.array([5, 4, 3]) * bar
    plain = FitProblem.of(ExponentialLaw, data)
    plain = plain.law(solve(plain, grid_search(plain)).values)
    ours, theirs = (np.abs(forces(other, *places) - forces(best, *places)).max() for other in (fit.law, plain))
    assert ours < 0.1 and ours < 0.7 * theirs


FRICTION = 6.0
PROGRAM = """
#include <stdio.h>
#include "inverse.h"
int main(void)
{
    double contraction, load;
    int lengthening;
    while (scanf("%lf %lf %d", &contraction, &load, &lengthening) == 3) {
        printf("%.17g\\n", inverse_pressure_for(contraction, load, lengthening));
    }
    return 0;
}
"""


@pytest.fixture(scope="module")
def table():
    return inverse_table(hanging_weights(FRICTION))


@pytest.mark.parametrize(("direction", "sign"), [("unloading", 1), ("loading", -1)])
def test_a_pressure_of_the_table_holds_the_load(table, direction, sign):
    contraction, load = np.array([0.25, 0.25, 0.24]), np.array([60.0, 75.0, 100.0])
    pressure = table.pressure_for(contraction, load, direction)
    np.testing.assert_allclose(force_at(contraction, pressure), load + sign * FRICTION, atol=3.0)
    assert 0 < table.rmse < 0.1 * bar and 0 < table.load_rmse < 0.1 * bar


def test_off_the_measured_curves_there_is_no_pressure(table):
    assert np.isnan(table.pressure_for([0.05, 0.2, 0.2], [60.0, 20.0, 130.0], "loading")).all()


def test_one_load_gives_a_table_though_no_law(table):
    data = hanging_weights(FRICTION)
    one = data.select(data.force == 60)
    with pytest.raises(IdentificationError, match="--of inverse"):
        fit_law(ExponentialLaw, one)
    alone = inverse_table(one)
    assert alone.pressure_for(0.25, 60.0, "loading") == table.pressure_for(0.25, 60.0, "loading")
    assert np.isnan(alone.load_rmse) and alone.directed
    undirected = inverse_table(IsobaricDataset(one.table.drop_vars("direction")))
    both = [undirected.pressure_for(0.25, 60.0, word) for word in ("loading", "unloading")]
    ends = [table.pressure_for(0.25, 60.0, word) for word in ("loading", "unloading")]
    assert not undirected.directed and both[0] == both[1] and min(ends) < both[0] < max(ends)


def test_loads_that_are_not_held_are_refused():
    data = hanging_weights(FRICTION)
    with pytest.raises(IdentificationError, match="loads"):
        inverse_table(type(data)(data.table.assign(force=data.table["force"] + np.arange(len(data)) * 0.3)))


def test_the_files_hold_the_same_table(table, tmp_path):
    table.write(tmp_path)
    rows = (tmp_path / "inverse.csv").read_text().splitlines()
    assert rows[0] == "load_N,direction,contraction_ratio,pressure_Pa" and len(rows) == len(table.load) + 1
    (tmp_path / "main.c").write_text(PROGRAM)
    strict = ("-std=c99", "-Wall", "-Wextra", "-Wconversion", "-Werror")
    subprocess.run(["cc", *strict, "-o", "table", "main.c", "-lm"], check=True, cwd=tmp_path)
    rng = np.random.default_rng(0)
    places = zip(rng.uniform(0, 0.32, 200), rng.choice([30.0, 45.0, 120.0, 130.0], 200), [0, 1] * 100, strict=True)
    places = [(float(contraction), float(load), way) for contraction, load, way in places]
    answers = subprocess.run(
        [tmp_path / "table"],
        input="\n".join(" ".join(map(repr, place)) for place in places),
        text=True,
        capture_output=True,
    ).stdout.split()
    ours = [float(table.pressure_for(eps, load, ("unloading", "loading")[way])) for eps, load, way in places]
    assert 0.1 < np.mean(np.isnan(ours)) < 0.9
    np.testing.assert_allclose(np.array(answers, float), ours, rtol=1e-12)
