"""The statistics and the figure of a sweep, on tables that were made up."""

import json
import re

import numpy as np
import pytest
import scipy.stats
import xarray as xr

from mckibben import report
from mckibben.scenario import Scenario
from mckibben.simulation import Metrics
from mckibben.simulation.metrics import METRICS
from mckibben.simulation.outcome import OUTCOMES, Outcome
from mckibben.storage.files import to_json
from mckibben.study.sweep import SweepResult
from mckibben.units import deg

INPUTS = {
    "load.mass2": ("kg", "kg", "load.mass2=0.2 kg..1 kg"),
    "controller.position.kp": ("Pa/rad", "bar/rad", "controller.position.kp=1 bar/rad..100 bar/rad log"),
    "reference.stiffness.after": ("N*m/rad", "N*m/rad", "reference.stiffness.after=15 N*m/rad, 17 N*m/rad"),
    "start.angle": ("rad", "deg", "start.angle=-5 deg..5 deg"),
    "valve.time_constant": ("s", "ms", "valve.time_constant=1 ms..9 ms"),
}


def made_up(count=400, lost=0.1, inputs=5, seed=0, metrics=Metrics._fields):
    """A sweep in which mass makes the angle's error, and the gain that of the stiffness."""
    random = np.random.default_rng(seed)
    columns = {
        "load.mass2": random.uniform(0.2, 1.0, count),
        "controller.position.kp": 1e5 * 10 ** random.uniform(0, 2, count),
        "reference.stiffness.after": random.choice([15.0, 17.0], count),
        "start.angle": random.uniform(-5, 5, count) * deg,
        "valve.time_constant": random.uniform(1e-3, 9e-3, count),
    }
    codes = np.where(random.random(count) < lost, OUTCOMES.index(Outcome.DIVERGED), 0).astype(np.int8)
    codes[random.random(count) < lost / 3] = OUTCOMES.index(Outcome.NO_START)
    answers = {name: random.random(count) for name in metrics}
    if "angle_rmse" in answers:
        answers["angle_rmse"] = columns["load.mass2"] ** 3 * deg
    if "stiffness_rmse" in answers:
        answers["stiffness_rmse"] = 100 / (columns["controller.position.kp"] / 1e5) + 0.01 * random.random(count)
    for values in answers.values():
        values[codes != 0] = np.nan
    if "stiffness_settling" in answers:
        answers["stiffness_settling"][random.random(count) < 0.3] = np.nan
    table = {}
    for name in list(columns)[:inputs]:
        unit, shown, text = INPUTS[name]
        table[name] = (
            "run",
            columns[name],
            {"units": unit, "shown_units": shown, "over": text, "role": "input"},
        )
    table |= {name: ("run", values) for name, values in answers.items()}
    table |= {
        "outcome": ("run", codes),
        "substeps": ("run", np.full(count, 2)),
        "error_estimate": ("run", np.full(count, 1e-9)),
        "chaotic": ("run", np.zeros(count, np.int8)),
    }
    scenario = Scenario.read("examples/pre-contracted-step-pid.yaml")
    return SweepResult(xr.Dataset(table, attrs={"title": "made up"}), scenario)


def tables(swept):
    return {listing.title.split(",")[0]: listing for listing in swept.listings()}


@pytest.mark.slow
def test_the_statistics_are_those_of_numpy():
    swept = made_up()
    codes = swept["outcome"]
    outcomes = tables(swept)["Outcomes"].columns
    assert list(outcomes["runs"][1]) == [np.sum(codes == 0), np.sum(codes == 4), np.sum(codes == 5)]
    rows = {row[0]: row for row in swept.statistics()}
    assert len(rows) == len(METRICS)
    for metric, unit, scale in METRICS.values():
        values = swept[metric] / scale
        _, shown, median, low, high, worst, run, count = rows[metric.replace("_", " ")]
        assert shown == unit
        assert (median, low, high) == pytest.approx(np.nanpercentile(values, (50, 5, 95)))
        assert (worst, run, count) == (np.nanmax(values), np.nanargmax(values), np.isfinite(values).sum())
    assert json.loads(to_json(swept.to_dict()))["verdict"] == swept.verdict()


def test_numbers_of_failed_runs_count_for_nothing():
    swept = made_up()
    lively = swept.table.copy()
    for name in Metrics._fields:
        lively[name] = ("run", np.where(swept.failed, 1e9, swept[name]))
    assert SweepResult(lively, swept.nominal).to_dict() == swept.to_dict()


def test_what_matters_comes_first():
    """With mean ranks for ties, as SciPy has them."""
    swept = made_up()
    ranks = swept.correlations()
    assert ranks.shape == (5, 1 + 3)
    good = ~swept.failed
    for name in INPUTS:
        expected = scipy.stats.spearmanr(swept[name][good], swept["angle_rmse"][good]).statistic
        assert ranks.loc[name, "angle_rmse"] == pytest.approx(expected, abs=1e-12)
    assert ranks.loc["load.mass2", "angle_rmse"] == pytest.approx(1)
    assert ranks.loc["controller.position.kp", "stiffness_rmse"] == pytest.approx(-1, abs=1e-3)
    rows = tables(swept)["Rank correlations"].columns
    sizes = [abs(rank) for rank in rows["Spearman"][1]]
    assert sizes == sorted(sizes, reverse=True) and len(sizes) == 10


@pytest.mark.parametrize("count", [1, 2, 40])
def test_all_runs_failed(count):
    swept = made_up(count, lost=1.1)
    assert swept.statistics() == [] and swept.main_metrics == ()
    assert sum(tables(swept)["Outcomes"].columns["runs"][1]) == count
    assert f"{count} of them failed" in swept.verdict()
    swept.to_text(), to_json(swept.to_dict())


@pytest.mark.parametrize(
    ("made", "panels"),
    [
        ({"count": 400}, 4 * 4),
        ({"count": 1, "inputs": 1, "lost": 0.0}, 3),
        ({"count": 1, "inputs": 1, "lost": 1.1}, 1),
        ({"count": 50, "metrics": ("force_max", "angle_max")}, 3 * 4),
    ],
)
@pytest.mark.slow
def test_the_figure(made, panels, tmp_path):
    figure = report.sweep(made_up(**made))
    png, svg = report.save(figure, tmp_path, "sweep")
    assert png.stat().st_size > 3000
    assert svg.stat().st_size < 3_000_000
    assert len(figure.axes) == panels
    for axes in figure.axes:
        assert axes.lines or axes.collections, "an empty panel"
        low, high = axes.get_ylim()
        assert np.isfinite([low, high]).all()
        assert low < high
    labels = [label for axes in figure.axes for label in (axes.get_xlabel(), axes.get_ylabel()) if label]
    assert labels
    assert all(re.search(r"\[.+\]$", label) for label in labels), labels


@pytest.mark.slow
def test_the_figure_shows_the_four_inputs_that_matter_most():
    figure = report.sweep(made_up(count=2000))
    shown = " ".join(axes.get_xlabel().replace("\n", "") for axes in figure.axes)
    assert "load.mass2 [kg]" in shown
    assert "controller.position.kp [bar/rad]" in shown
    assert "1 input with weaker correlation" in figure._suptitle.get_text()
