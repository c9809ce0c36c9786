"""A contest in numbers, against NumPy and SciPy on runs whose numbers are made by hand."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import scipy.stats
import xarray as xr

from mckibben.result import Severity
from mckibben.simulation import Batch, Margins, Metrics, Outcome
from mckibben.simulation.outcome import OUTCOMES
from mckibben.study.compare import CompareResult, Suite, draw
from mckibben.study.compare.result import PooledResult
from mckibben.study.compare.statistics import best_trial, front, median, ratio_of_medians, trial_at_air
from mckibben.study.tune import Trial
from mckibben.study.tune.objective import FAILED_COST
from mckibben.units import deg, litre

TEXT = (Path(__file__).parents[1] / "small-suite.yaml").read_text(encoding="utf-8")
RUNS = 40
FIRST, SECOND, THIRD = "PID 3", "decoupling", "as it is"
NOT_BEGUN, LOST_RUN = 5, 11


def batch(columns, lost=()):
    codes = np.zeros(RUNS, int)
    codes[list(lost)] = OUTCOMES.index(Outcome.DIVERGED)
    codes[NOT_BEGUN] = OUTCOMES.index(Outcome.NO_START)
    flags = {"flag_values": np.arange(len(OUTCOMES)), "flag_meanings": " ".join(each.name for each in OUTCOMES)}
    table = {name: ("run", np.array(columns[name], float)) for name in Metrics._fields}
    return Batch(xr.Dataset({**table, "outcome": ("run", codes, flags)}))


@pytest.fixture(scope="module")
def runs():
    return draw(Suite.parse(TEXT), RUNS, 1)


@pytest.fixture(scope="module")
def columns(runs):
    """Errors of which the second controller has half, and the third loses all runs."""
    rng = np.random.default_rng(5)
    made = {}
    for name, scale in ((FIRST, 1.0), (SECOND, 0.5), (THIRD, 2.0)):
        made[name] = {metric: rng.lognormal(size=RUNS) for metric in Metrics._fields}
        made[name]["angle_rmse"] = scale * runs.conditions["load.mass2"] ** 2 * deg
        made[name]["stiffness_rmse"] = scale * np.exp(rng.normal(size=RUNS))
        made[name]["air"] *= litre
    return made


@pytest.fixture(scope="module")
def contest(runs, columns):
    lost = {FIRST: (), SECOND: [LOST_RUN], THIRD: range(RUNS)}
    batches = {name: batch(columns[name], runs_lost) for name, runs_lost in lost.items()}
    tuned = {FIRST: {"controller.position.kp": 2e5}, SECOND: {}, THIRD: {}}
    none, margins = {FIRST: (), SECOND: (), THIRD: ()}, dict.fromkeys(batches, loop(0.5))
    return CompareResult(runs.suite, runs, tuned, {FIRST: (3.0, 4.0)}, none, batches, margins=margins)


def loop(disk):
    """Margins at one point."""
    none = np.zeros((1, 1))
    names = dict.fromkeys(("time", "radius", "gain", "phase", "delay", "peak"), np.array([0.5]))
    return Margins(
        **names, disk=np.array([disk]), loop=np.array(["angle"]), frequency=none, sensitivity=none, loci=none
    )


def begun(values, *without):
    return np.delete(np.asarray(values), [NOT_BEGUN, *without])


def rows_of(listing):
    names, *cells = (list(values) for _, values in listing.columns.values())
    return dict(zip(names, zip(*cells, strict=True), strict=True))


def trial(cost, error, air, stiffness=1.0, failed=0.0):
    numbers = {"angle_rmse": error * deg, "stiffness_rmse": stiffness, "air": air * litre, "failed": failed}
    return Trial((cost,), cost, metrics=numbers)


@pytest.mark.slow
def test_the_table_has_medians_percentiles_and_failed_runs_of_those_that_began(contest, columns):
    table = rows_of(next(iter(contest.listings())))
    assert list(table) == contest.order == [SECOND, FIRST, THIRD], "by their median cost"
    for name, lost in ((FIRST, ()), (SECOND, (LOST_RUN,))):
        angle, late, _, _, _, stiffness, late_stiffness, air, *failed = table[name]
        for metric, found in (("angle_rmse", (angle, late)), ("stiffness_rmse", (stiffness, late_stiffness))):
            expected = np.percentile(begun(columns[name][metric], *lost), [50, 95])
            assert found == pytest.approx(expected, rel=1e-12)
        assert air == pytest.approx(np.median(begun(columns[name]["air"], *lost)))
        assert failed == [len(lost), 0]
    assert np.isnan(table[THIRD][0]) and table[THIRD][-2:] == (RUNS - 1, 0)
    assert "decoupling is best" in contest.verdict()
    assert [remark.field for remark in contest.remarks()] == ["runs"]
    cost = columns[SECOND]["angle_rmse"] / (0.1 * deg) + columns[SECOND]["stiffness_rmse"] / 0.5
    cost[LOST_RUN] = FAILED_COST
    assert contest.cost(SECOND) == pytest.approx(begun(cost))


def test_ratios_of_medians(columns):
    """A lost run counts as an endless error; intervals hold the ratio, and are as SciPy has them."""
    own, first = begun(columns[SECOND]["stiffness_rmse"]), begun(columns[FIRST]["stiffness_rmse"])
    own[3] = np.inf
    ratio, low, high = ratio_of_medians(np.where(np.isinf(own), np.nan, own), first, 2000)
    assert low <= ratio <= high and ratio == pytest.approx(np.median(own) / np.median(first))
    expected = scipy.stats.bootstrap(
        (own, first),
        lambda a, b: np.median(a) / np.median(b),
        paired=True,
        vectorized=False,
        n_resamples=2000,
        method="percentile",
        rng=np.random.default_rng(1),
    ).confidence_interval
    # Medians of 39 runs move in steps, and an end of 2000 resamplings by some of them.
    assert [low, high] == pytest.approx([expected.low, expected.high], rel=0.15)
    lost = np.full_like(first, np.nan)
    assert ratio_of_medians(lost, first, 100) == (np.inf,) * 3
    assert ratio_of_medians(first, lost, 100).ratio == 0.0 and np.isnan(ratio_of_medians(lost, lost, 100).low)
    assert ratio_of_medians(first / 2, first, 100) == (0.5,) * 3, "resampled in pairs"


def test_at_equal_air_ratios_are_to_the_first_as_tuned_and_others_are_named(contest):
    at_air = replace(contest, batches={FIRST: contest.batches[SECOND]}, tuned={FIRST: {}})
    trials = {FIRST: (trial(0.5, 1, 0.2),), SECOND: (trial(0.5, 2, 0.5), trial(0.6, 3, 0.3))}
    whole = replace(
        contest, at_air=at_air, trials=trials, tuned={**contest.tuned, SECOND: {"controller.feedback.bandwidth": 40.0}}
    )
    tuned, equal, _ = whole.listings()
    assert equal.title.endswith("(0.2 L in the training runs)")
    assert rows_of(equal)[FIRST] == rows_of(tuned)[SECOND]
    (text,) = [remark.text for remark in whole.remarks() if remark.field == "at_air"]
    assert "decoupling (at least 0.3 L)" in text and THIRD not in text


@pytest.mark.slow
def test_setups_are_pooled_and_a_controller_that_one_lacks_at_equal_air_is_left_out(contest):
    """In the second setup no trial of one controller takes as little air."""
    others = {FIRST: contest.batches[FIRST]}
    setups = {"a": replace(contest, at_air=contest), "b": replace(contest, at_air=replace(contest, batches=others))}
    pooled = PooledResult("both", setups)
    as_tuned, at_air, *_ = listings = list(pooled.listings())
    assert pooled.verdict().startswith("both, 2 setups: decoupling has 0.") and len(listings) == 8
    assert list(rows_of(as_tuned)) == list(contest.batches) and list(rows_of(at_air)) == [FIRST]
    alone, both = (rows_of(table)[SECOND] for table in (next(iter(contest.listings())), as_tuned))
    assert both[0] == alone[0] and both[-2:] == (2, 0)


def test_the_best_is_a_loop_with_a_margin_and_a_low_margin_is_severe_where_none_has_it(contest):
    low, (best, *others) = loop(0.12), contest.order
    risky = replace(contest, margins=contest.margins | {best: low})
    (remark, _) = risky.remarks()
    assert (remark.severity, remark.field) == (Severity.WARNING, "disk_margin") and best in remark.text
    assert risky.order == [*others, best] and f"{others[0]} is best" in risky.verdict()
    none = replace(contest, margins=dict.fromkeys(contest.order, low))
    severities = [remark.severity for remark in none.remarks() if remark.field == "disk_margin"]
    assert severities.count(Severity.SEVERE) == 1 and f"{best} is best" not in none.verdict()


def test_the_headline_of_setups_is_of_a_loop_with_a_margin_in_each(contest):
    low = replace(contest, margins=contest.margins | {SECOND: loop(0.12)})
    pooled = PooledResult("both", {"a": contest, "b": low})
    assert pooled.ok and SECOND not in pooled.verdict()
    (remark,) = pooled.remarks()
    assert (remark.field, remark.severity) == ("disk_margin", Severity.WARNING) and SECOND in remark.text
    none = replace(contest, margins=dict.fromkeys(contest.order, loop(0.12)))
    assert not PooledResult("both", {"a": contest, "b": none}).ok


def test_a_front_has_the_trials_with_the_least_error_for_their_air():
    best, stiff, diverged = trial(1.0, 0.2, 0.3), trial(6.0, 0.1, 0.05, stiffness=1.2), Trial((7.0,), FAILED_COST)
    others = [trial(2.0, 0.4, 0.2), trial(3.0, 0.9, 0.1), trial(4.0, 0.3, 0.4), trial(5.0, 0.5, 0.25)]
    assert front([diverged, *others, best, stiff]) == [others[1], others[0], best]
    assert front([diverged]) == []


def test_the_air_of_a_controller_that_fails_in_every_trial_is_that_of_the_runs_that_it_survives():
    """Only trials with the fewest failed runs count, whatever others would do with less air."""
    least, other = trial(2.0, 1.0, 0.2, failed=1.0), trial(3.0, 0.5, 0.3, failed=1.0)
    worse, unknown = trial(1.0, 0.1, 0.1, failed=2.0), Trial((9.0,), FAILED_COST)
    assert best_trial([worse, unknown, other, least]) == least
    assert front([worse, other, least, unknown]) == [least, other]
    assert trial_at_air([worse, other, least], 0.25 * litre) == least
    assert np.isinf(median(best_trial([unknown]), "air"))


def test_all_runs_are_kept(contest, columns, tmp_path):
    contest.write(tmp_path)
    with xr.open_dataset(tmp_path / "runs.nc") as kept:
        assert kept.sizes == {"controller": 3, "run": RUNS}
        assert np.array_equal(kept["air"].sel(controller=SECOND), columns[SECOND]["air"])
        assert kept["reference"].to_numpy().tolist() == list(contest.runs.reference_name)
        assert np.array_equal(kept["load.mass2"], contest.runs.conditions["load.mass2"])
        assert kept["outcome"].attrs["flag_meanings"].split()[int(kept["outcome"][1, LOST_RUN])] == "DIVERGED"
        drawn = contest.runs.reference_values["angle step"]["reference.stiffness"]
        of_reference = np.array(contest.runs.reference_name) == "angle step"
        assert np.array_equal(kept["reference.stiffness"][of_reference], drawn)
        assert np.isfinite(kept["reference.stiffness"]).sum() == of_reference.sum()
        assert json.loads(kept.attrs["tuned"]) == contest.tuned
