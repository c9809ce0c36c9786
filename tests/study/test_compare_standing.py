"""A contest in numbers, against NumPy and SciPy on runs whose numbers are made by hand."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import scipy.stats
import xarray as xr

from mckibben.simulation import Batch, Metrics, Outcome
from mckibben.simulation.metrics import METRICS
from mckibben.simulation.outcome import OUTCOMES
from mckibben.storage.files import to_json
from mckibben.study.compare import CompareResult, Suite, draw
from mckibben.study.compare.result import PooledResult, left_out_at_air
from mckibben.study.compare.statistics import air_of, front, trial_at_air
from mckibben.study.compare.table import write_table
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
    """Errors that follow a condition each; of the second controller half as large."""
    rng = np.random.default_rng(5)
    made = {}
    for name, scale in ((FIRST, 1.0), (SECOND, 0.5), (THIRD, 2.0)):
        made[name] = {metric: rng.lognormal(size=RUNS) for metric in Metrics._fields}
        made[name]["angle_rmse"] = scale * runs.conditions["load.mass2"] ** 2 * deg
        made[name]["stiffness_rmse"] = scale * np.exp(rng.normal(size=RUNS))
        made[name]["coupling"][20:] = np.nan
        made[name]["stiffness_settling"][15:25] = np.nan
        made[name]["air"] *= litre
    return made


@pytest.fixture(scope="module")
def contest(runs, columns):
    batches = {
        FIRST: batch(columns[FIRST]),
        SECOND: batch(columns[SECOND], [LOST_RUN]),
        THIRD: batch(columns[THIRD], range(RUNS)),
    }
    tuned = {FIRST: {"controller.position.kp": 2e5}, SECOND: {}, THIRD: {}}
    return CompareResult(runs.suite, runs, tuned, {FIRST: (3.0, 4.0)}, {FIRST: (), SECOND: (), THIRD: ()}, batches)


@pytest.fixture(scope="module")
def numbers(contest):
    return contest.numbers


def begun(values, *without):
    return np.delete(np.asarray(values), [NOT_BEGUN, *without])


def test_who_begins_and_who_is_lost(contest, numbers):
    assert (numbers["runs"], numbers["no_start"]) == (RUNS, 1)
    assert [each["diverged"] for each in numbers["controllers"].values()] == [0, 1, RUNS - 1]
    assert contest.diverged(SECOND).sum() == 1
    assert np.isnan(contest.metric(SECOND, "air")).sum() == 1


@pytest.mark.parametrize("key", METRICS)
def test_medians_and_percentiles_are_over_the_runs_that_were_not_lost(key, numbers, columns):
    metric, _, unit = METRICS[key]
    for name, without in ((FIRST, ()), (SECOND, (LOST_RUN,))):
        values = begun(columns[name][metric], *without) / unit
        found = numbers["controllers"][name]["metrics"][key]
        assert found["median"] == pytest.approx(np.nanmedian(values), rel=1e-12)
        assert found["percentile_95"] == pytest.approx(np.nanpercentile(values, 95), rel=1e-12)
        assert found["runs"] == np.isfinite(values).sum()
    assert numbers["controllers"][THIRD]["metrics"][key] is None


def test_settling_is_counted_over_the_runs_with_a_step(numbers):
    """Steps in 20 runs, of which 5 do not settle; one of those that do has not begun, one is lost."""
    assert numbers["controllers"][FIRST]["settled"] == {"runs": 14, "of": 19}
    assert numbers["controllers"][SECOND]["settled"] == {"runs": 13, "of": 18}
    assert numbers["controllers"][THIRD]["settled"] == {"runs": 0, "of": 0}


def test_the_order_is_that_of_the_median_cost(contest, numbers, columns):
    assert numbers["order"] == [SECOND, FIRST, THIRD]
    for name in (FIRST, SECOND):
        cost = columns[name]["angle_rmse"] / (0.1 * deg) + columns[name]["stiffness_rmse"] / 0.5
        if name == SECOND:
            cost[LOST_RUN] = FAILED_COST
        assert contest.cost(name) == pytest.approx(begun(cost))
        assert numbers["controllers"][name]["median_cost"] == pytest.approx(np.median(begun(cost)))
    assert numbers["controllers"][THIRD]["median_cost"] == FAILED_COST


def test_ratios_of_medians(numbers, columns):
    """A lost run counts as an endless error; resampled intervals hold the ratio, and are as SciPy has them."""
    for key, metric in (("angle_rmse_deg", "angle_rmse"), ("stiffness_rmse", "stiffness_rmse")):
        own = columns[SECOND][metric].copy()
        own[LOST_RUN] = np.inf
        own, first = begun(own), begun(columns[FIRST][metric])
        found = numbers["controllers"][SECOND]["ratio_to_first"][key]
        assert found["ratio"] == pytest.approx(np.median(own) / np.median(first))
        assert found["low"] <= found["ratio"] <= found["high"]
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
        assert [found["low"], found["high"]] == pytest.approx([expected.low, expected.high], rel=0.15)
    same = numbers["controllers"][FIRST]["ratio_to_first"]["angle_rmse_deg"]
    assert same == {"ratio": 1.0, "low": 1.0, "high": 1.0}


def test_at_equal_air_ratios_are_to_the_first_as_tuned(contest, numbers):
    at_air = replace(contest, batches={FIRST: contest.batches[SECOND]})
    trial = Trial((0.5,), 1.0, metrics={"air": 0.2 * litre, "angle_rmse": deg, "stiffness_rmse": 1.0})
    found = replace(contest, at_air=at_air, trials={FIRST: (trial,)}).numbers["at_air_of_first"]
    assert found["air_L"] == pytest.approx(0.2)
    for key in ("metrics", "diverged", "ratio_to_first", "by_reference"):
        assert found["controllers"][FIRST][key] == numbers["controllers"][SECOND][key]
    assert numbers["at_air_of_first"] is None


def test_controllers_left_out_at_equal_air_are_named_with_the_least_air_of_their_trials(contest, numbers):
    def trial(air):
        return Trial((0.5,), 1.0, metrics={"air": air * litre, "angle_rmse": deg / air, "stiffness_rmse": 1.0})

    at_air = replace(contest, batches={FIRST: contest.batches[FIRST]})
    trials = {FIRST: (trial(0.2),), SECOND: (trial(0.5), trial(0.3))}
    tuned = {**contest.tuned, SECOND: contest.tuned[FIRST]}
    text = left_out_at_air(replace(contest, at_air=at_air, trials=trials, tuned=tuned).numbers, {SECOND: "other"})
    assert "0.2 L" in text and "other (at least 0.3 L)" in text and THIRD not in text
    assert left_out_at_air(numbers) == ""


def test_setups_are_pooled_and_a_controller_that_one_lacks_at_equal_air_is_left_out(contest, numbers):
    """In the second setup no trial of one controller takes as little air."""
    others = {FIRST: contest.batches[FIRST]}
    setups = {"a": replace(contest, at_air=contest), "b": replace(contest, at_air=replace(contest, batches=others))}
    pooled = PooledResult("both", setups)
    found = pooled.numbers
    assert pooled.verdict().startswith("both, 2 setups: decoupling has 0.") and len(list(pooled.listings())) == 6
    assert list(found["as_tuned"]) == list(contest.batches)
    assert list(found["at_air_of_first"]) == [FIRST]
    both, alone = found["as_tuned"][SECOND], numbers["controllers"][SECOND]
    assert both["diverged"] == 2 * alone["diverged"]
    assert both["metrics"]["angle_rmse_deg"]["median"] == alone["metrics"]["angle_rmse_deg"]["median"]


def test_the_air_of_a_controller_that_fails_in_every_trial_is_that_of_the_runs_that_it_survives():
    """Only trials with the fewest failed runs count, whatever others would do with less air."""

    def trial(failed, cost, error, air):
        numbers = {"angle_rmse": error * deg, "stiffness_rmse": 1.0, "air": air * litre, "failed": failed}
        return Trial((cost,), cost, metrics=numbers)

    least, other, worse = trial(1.0, 2.0, 1.0, 0.2), trial(1.0, 3.0, 0.5, 0.3), trial(2.0, 1.0, 0.1, 0.1)
    unknown = Trial((9.0,), FAILED_COST)
    assert air_of([worse, unknown, other, least]) == pytest.approx(0.2 * litre)
    assert [one for one, _ in front([worse, other, least, unknown])] == [least, other]
    assert trial_at_air([worse, other, least], 0.25 * litre) == least
    assert np.isnan(air_of([unknown])) and front([unknown]) == []


def test_runs_are_resampled_in_pairs(contest, columns):
    """The errors of the angle are in one ratio in every run: whatever is drawn, their medians are too."""
    spread = begun(columns[FIRST]["angle_rmse"])
    assert spread.max() / spread.min() > 5
    batches = {name: batch(columns[name]) for name in (FIRST, SECOND)}
    found = CompareResult(contest.suite, contest.runs, contest.tuned, {}, contest.at_bound, batches).numbers
    half = found["controllers"][SECOND]["ratio_to_first"]["angle_rmse_deg"]
    assert [half["ratio"], half["low"], half["high"]] == pytest.approx([0.5, 0.5, 0.5], rel=1e-12)


def test_a_controller_that_loses_everything(contest, numbers):
    against = numbers["controllers"][THIRD]["ratio_to_first"]["angle_rmse_deg"]
    assert against["ratio"] == against["low"] == against["high"] == np.inf
    assert json.loads(to_json(numbers))["controllers"][THIRD]["ratio_to_first"]["angle_rmse_deg"]["low"] is None
    batches = dict(reversed(contest.batches.items()))
    turned = CompareResult(contest.suite, contest.runs, contest.tuned, {}, contest.at_bound, batches).numbers
    assert turned["controllers"][FIRST]["ratio_to_first"]["angle_rmse_deg"]["ratio"] == 0.0
    assert np.isnan(turned["controllers"][THIRD]["ratio_to_first"]["angle_rmse_deg"]["low"])


def test_errors_by_reference_and_joint(contest, numbers, columns):
    for key, groups in (("by_reference", contest.runs.reference_name), ("by_joint", contest.runs.joint)):
        found = numbers["controllers"][SECOND][key]
        assert list(found) == sorted(set(groups))
        for group, errors in found.items():
            rows = [i for i, g in enumerate(groups) if g == group and i not in (NOT_BEGUN, LOST_RUN)]
            for key_of, unit in (("angle_rmse", deg), ("stiffness_rmse", 1.0)):
                values = columns[SECOND][key_of][rows] / unit
                each = errors[f"{key_of}_deg" if unit == deg else key_of]
                assert [each["median"], each["percentile_95"]] == pytest.approx(np.percentile(values, [50, 95]))
                assert each["runs"] == len(rows)
        assert set(numbers["controllers"][THIRD][key][groups[0]].values()) == {None}


def test_correlations_are_spearmans(contest, numbers, columns):
    found = numbers["controllers"][SECOND]["correlations"]
    assert "sensors.seed" not in found
    assert set(found) == set(contest.runs.conditions) - {"sensors.seed"}
    own = columns[SECOND]["stiffness_rmse"].copy()
    own[LOST_RUN] = 1e9  # behind all others
    for condition, each in found.items():
        expected = scipy.stats.spearmanr(begun(contest.runs.conditions[condition]), begun(own)).statistic
        assert each["stiffness_rmse"] == pytest.approx(expected, abs=1e-12)
    assert numbers["controllers"][FIRST]["correlations"]["load.mass2"]["angle_rmse_deg"] == pytest.approx(1.0)
    assert numbers["controllers"][THIRD]["correlations"]["load.mass2"]["angle_rmse_deg"] is None


def test_what_tuning_found_is_told(numbers):
    assert numbers["controllers"][FIRST]["tuned"] == {"controller.position.kp": 2e5}
    assert numbers["controllers"][FIRST]["training_cost"] == {"tuned": 3.0, "before": 4.0}
    assert numbers["controllers"][SECOND]["training_cost"] is None


def test_all_runs_are_kept(contest, columns, tmp_path):
    write_table(contest.suite, contest.runs, contest.batches, contest.tuned, tmp_path / "runs.nc")
    with xr.open_dataset(tmp_path / "runs.nc") as kept:
        assert kept.sizes == {"controller": 3, "run": RUNS}
        assert np.array_equal(kept["air"].sel(controller=SECOND), columns[SECOND]["air"])
        assert kept["reference"].to_numpy().tolist() == list(contest.runs.reference_name)
        assert np.array_equal(kept["load.mass2"], contest.runs.conditions["load.mass2"])
        assert kept["outcome"].attrs["flag_meanings"].split()[int(kept["outcome"][1, LOST_RUN])] == "DIVERGED"
        drawn = contest.runs.reference_values["angle step"]["reference.stiffness"]
        rows = [i for i, reference in enumerate(contest.runs.reference_name) if reference == "angle step"]
        assert np.array_equal(kept["reference.stiffness"][rows], drawn)
        assert np.isfinite(kept["reference.stiffness"]).sum() == len(rows)
        assert json.loads(kept.attrs["tuned"]) == contest.tuned


def test_its_tables_and_remarks(contest):
    (table,) = contest.listings()
    assert table.columns["controller"][1] == [SECOND, FIRST, THIRD]
    assert [row[-1] for row in table.rows()] == ["1 + 0", "0 + 0", f"{RUNS - 1} + 0"]
    assert "decoupling is best" in contest.verdict()
    assert [remark.field for remark in contest.remarks()] == ["runs"]
