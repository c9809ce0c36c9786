"""The statistics and the figure of a sweep, on tables that were made up."""

import json
import re
import tracemalloc

import numpy as np
import pytest
import xarray as xr

from mckibben import report
from mckibben.simulation import Metrics
from mckibben.simulation.metrics import METRICS
from mckibben.simulation.outcome import OUTCOMES, Outcome
from mckibben.storage.files import to_json
from mckibben.study.sweep import SweepResult, ranks, summary
from mckibben.study.sweep.result import (
    MAIN,
    correlation_rows,
    feasibility_sentence,
    main_metrics,
    metric_rows,
    outcome_rows,
)
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
    short = np.maximum(random.random(count) - 0.8, 0)
    short[3:4] = np.nan
    table |= {
        "outcome": ("run", codes),
        "shortfall_max": ("run", short),
        "infeasible_time": ("run", np.where(np.arange(count) % 50 == 3, 0.5, 0.0)),
        "substeps": ("run", np.full(count, 2)),
        "error_estimate": ("run", np.full(count, 1e-9)),
        "chaotic": ("run", np.zeros(count, np.int8)),
    }
    return SweepResult(xr.Dataset(table, attrs={"title": "made up", "kind": "mckibben sweep"}))


@pytest.mark.slow
def test_the_statistics_are_those_of_numpy():
    swept = made_up()
    numbers = summary(swept)
    codes = swept.table["outcome"].to_numpy()
    assert numbers["outcomes"] == {
        "completed": np.sum(codes == 0),
        "diverged": np.sum(codes == 4),
        "no_start": np.sum(codes == 5),
    }
    assert (numbers["runs"], numbers["failed"]) == (400, np.sum(codes != 0))
    for name, (metric, _, unit) in METRICS.items():
        values = swept.table[metric].to_numpy() / unit
        spread = numbers["metrics"][name]
        assert spread["median"] == pytest.approx(np.nanmedian(values))
        assert spread["percentile_5"] == pytest.approx(np.nanpercentile(values, 5))
        assert spread["percentile_95"] == pytest.approx(np.nanpercentile(values, 95))
        assert (spread["worst"], spread["worst_run"]) == (np.nanmax(values), np.nanargmax(values))
        assert spread["runs"] == np.isfinite(values).sum()
    assert json.loads(to_json(numbers))["metrics"] == numbers["metrics"]


def test_numbers_of_lost_runs_count_for_nothing():
    swept = made_up()
    lost = swept.failed
    lively = swept.table.copy()
    for name in Metrics._fields:
        lively[name] = ("run", np.where(lost, 1e9, swept.table[name].to_numpy()))
    assert summary(SweepResult(lively)) == summary(swept)


@pytest.mark.slow
def test_the_statistics_need_the_same_memory_for_more_runs(tmp_path, monkeypatch):
    monkeypatch.setattr(ranks, "_BUCKET", 1 << 14)
    monkeypatch.setattr(ranks, "_IN_MEMORY", 1 << 10)
    peaks = []
    for count in (100_000, 400_000):
        made_up(count, inputs=2, metrics=MAIN).to_netcdf(tmp_path / f"{count}.nc")
        swept = SweepResult.from_netcdf(tmp_path / f"{count}.nc", lazy=True)
        tracemalloc.start()
        summary(swept)
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
        swept.table.close()
    assert peaks[1] < 1.5 * peaks[0]


def test_what_matters_comes_first():
    correlations = summary(made_up())["correlations"]
    assert correlations[0]["with"] in ("angle_rmse_deg", "stiffness_rmse")
    found = {(each["input"], each["with"]): each["spearman"] for each in correlations}
    assert found["load.mass2", "angle_rmse_deg"] == pytest.approx(1)
    assert found["controller.position.kp", "stiffness_rmse"] == pytest.approx(-1, abs=1e-3)
    assert abs(found["load.mass2", "failed"]) < 0.2
    sizes = [abs(each["spearman"]) for each in correlations]
    assert sizes == sorted(sizes, reverse=True)
    assert len(correlations) == 5 * 4


def test_infeasible_references_are_counted():
    swept = made_up()
    found = summary(swept)["feasibility"]
    short = swept.table["shortfall_max"].to_numpy()
    assert found["runs_stiffness_infeasible"] == np.sum(short > 0)
    assert (found["shortfall_max"], found["shortfall_max_run"]) == (np.nanmax(short), np.nanargmax(short))
    assert found["runs_angle_infeasible"] == 8
    stiffness, angle = feasibility_sentence(summary(swept)).split("; ")
    assert stiffness.startswith(f"{np.sum(short > 0)} of 400 runs")
    assert angle.startswith("8 of 400 runs")


@pytest.mark.parametrize("count", [1, 2, 40])
def test_all_runs_lost(count):
    swept = made_up(count, lost=1.1)
    numbers = summary(swept)
    assert numbers["failed"] == count
    assert all(spread["runs"] == 0 and spread["median"] is None for spread in numbers["metrics"].values())
    assert metric_rows(numbers) == correlation_rows(numbers) == []
    assert sum(int(row[0]) for row in outcome_rows(numbers)) == count
    assert main_metrics(swept) == ()
    to_json(numbers)


def test_rows_for_people():
    numbers = summary(made_up())
    rows = {row[0]: row for row in metric_rows(numbers)}
    assert len(rows) == len(METRICS)
    assert rows["angle rmse"][1] == "deg"
    assert rows["angle rmse"][2] == f"{numbers['metrics']['angle_rmse_deg']['median']:.4g}"
    assert re.fullmatch(r"\d+ never", rows["stiffness settling"][-1])
    assert rows["angle rmse"][-1] == ""
    first = correlation_rows(numbers)[0]
    assert first in [("load.mass2", "angle rmse", "+1.00"), ("controller.position.kp", "stiffness rmse", "-1.00")]
    assert len(correlation_rows(numbers)) <= 10


@pytest.mark.parametrize(
    ("made", "panels"),
    [
        ({"count": 400}, 4 * 4),
        ({"count": 6000, "inputs": 3}, 4 * 3),
        ({"count": 1, "inputs": 1, "lost": 0.0}, 3),
        ({"count": 2, "inputs": 2, "lost": 0.0}, 3 * 2),
        ({"count": 40, "lost": 1.1}, 4),
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
    assert "load.mass2[kg]" in shown
    assert "controller.position.kp[bar/rad]" in shown
    assert "1 input with weaker correlation" in figure._suptitle.get_text()


def test_it_shows_itself_in_short():
    swept = made_up(lost=0.0, inputs=2)
    assert repr(swept) == "<SweepResult: 400 runs, over load.mass2, controller.position.kp>"
    assert "failed" in repr(made_up())
    html = swept._repr_html_()
    assert html.count("<tr>") == 1 + len(METRICS) and len(html) < 5000
