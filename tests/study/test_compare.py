"""Controllers are tuned alike and evaluate on the same runs: each of which is, alone, what `simulate` gives."""

import sqlite3
from dataclasses import replace
from pathlib import Path

import jax
import numpy as np
import pytest

from mckibben import binding
from mckibben.errors import FileError, ParameterError
from mckibben.scenario import Scenario, run_scenario, with_values
from mckibben.simulation import Metrics
from mckibben.storage.store import STUDY
from mckibben.study.compare import CompareResult, Suite, compare, draw, evaluate
from mckibben.study.compare.runs import controller_of, started
from mckibben.study.compare.tuning import ControllerTuning, error_at_air
from mckibben.study.tune import Trial, read_trials
from mckibben.study.tune.objective import FAILED_COST, UNSTABLE_COST
from mckibben.study.tune.space import SearchSpace
from mckibben.units import deg

TEXT = (Path(__file__).parents[1] / "small-suite.yaml").read_text(encoding="utf-8")
KP = "controller.position.kp"
OF_AIR = (
    TEXT[TEXT.index("other_joints:") : TEXT.index("load: knee")],
    "other_joints: {air: {valve: {class: FlowValve, conductance: 0.4 L/(s*bar), supply: 5 bar}}}\n",
)
"""Valves that let air in, in place of another joint."""
ONE_KIND = (
    (TEXT[TEXT.index("joint_share:") : TEXT.index("load: knee")], ""),
    (TEXT[TEXT.index("  angle step:") : TEXT.index("max_angular")], ""),
)
"""Runs of one joint and one reference: a program."""


def changed(*pairs):
    text = TEXT
    for old, new in pairs:
        assert text.count(old) == 1, old
        text = text.replace(old, new)
    return Suite.parse(text)


@pytest.fixture(scope="module")
def suite():
    return changed()


@pytest.fixture(scope="module")
def simulated(suite):
    """The evaluation runs of one controller, simulated."""
    runs, values = draw(suite, 16, 1), {KP: 2e5}
    return CompareResult(suite, runs, {"PID 3": values}, {}, {"PID 3": ()}, {"PID 3": evaluate(runs, "PID 3", values)})


class TestRuns:
    @pytest.mark.slow
    def test_a_run_of_the_batch_is_that_run_alone(self, simulated):
        """With both joints, with its noise and delay: as `mckibben simulate` runs its scenario.

        Every reference has a program of its own to compile; that the draws are used is seen without running them.
        """
        batch, runs = simulated.batches["PID 3"], simulated.runs
        kinds = {
            (runs.reference_name[i], runs.joint[i]): i
            for i in range(runs.count)
            if runs.reference_name[i] != "angle step"
        }
        assert len(kinds) == 4
        delays = runs.conditions["sensors.delay"][list(kinds.values())]
        assert set(delays.tolist()) == {0.0, 1.0}
        for run in kinds.values():
            scenario = Scenario.parse(simulated.scenario("PID 3", run).dumps())
            alone = run_scenario(scenario).metrics
            for name in Metrics._fields:
                value = batch.metrics[name][run]
                assert value == pytest.approx(alone[name], rel=1e-7, abs=1e-12, nan_ok=True), (run, name)
            assert scenario.control().position.kp == simulated.tuned["PID 3"][KP]


def mean_cost(runs, kp):
    """Of `invented`, by hand, run by run: those that cannot begin do not count, a lost one costs 1e6."""
    lags, heights = runs.conditions["valve.time_constant"], runs.conditions["disturbance.height"]
    costs = []
    for mass, lag, height in zip(runs.conditions["load.mass2"], lags, heights, strict=True):
        if lag <= 0.048:
            lost = height > 0 and kp > 8e5
            costs.append(FAILED_COST if lost else (1 + abs(np.log10(kp / 3e5))) * mass / 0.5 / 0.1 + lag / 0.02 / 0.5)
    return np.mean(costs)


def trials(folder, name="PID 3"):
    return read_trials(folder / STUDY, name)


OTHERS = TEXT[TEXT.index("  decoupling:\n") : TEXT.index("tuning:")]
ALONE = (OTHERS, ""), ("untuned: [as it is]", "over: {PID 3: [controller.position.kp=0.1..20 bar/rad log]}")
"""One controller, and one number to tune."""


@pytest.fixture(scope="class")
def kept(simulating_nothing, tmp_path_factory):
    return tmp_path_factory.mktemp("kept")


@pytest.fixture(scope="class")
def contest(suite, kept):
    """All three controllers, compared without a simulation."""
    return compare(suite, out=kept)


@pytest.mark.slow
@pytest.mark.usefixtures("simulating_nothing")
def test_gains_without_the_margin_cost_more_than_any_with_it_and_are_not_on_a_front(monkeypatch):
    one = changed(*ALONE)
    task = ControllerTuning(one, "PID 3", SearchSpace(one.tuned_over("PID 3")), draw(one, 8, 99))
    monkeypatch.setattr(ControllerTuning, "_least_margins", lambda _, table, count: np.array([0.3, 0.1, -0.2]))
    found = task.evaluate(np.array([[2e5], [2e5], [2e5]]))
    assert found.costs[0] < UNSTABLE_COST and found.costs[1:].tolist() == pytest.approx([1.5e5, 3e5])
    assert [metrics is None for metrics in found.metrics] == [False, True, True]


@pytest.mark.slow
def test_noise_that_moves_the_valves_costs(monkeypatch):
    """Beyond ten times the travel with ideal sensors; without noise the cost is the mean of the runs."""
    monkeypatch.setattr(ControllerTuning, "_least_margins", lambda _, table, count: np.ones(count))
    for sensors, share in (("pressure_noise: 60 kPa", 1.5), ("pressure_noise: 0.001 kPa", 1.0)):
        one = changed(*ALONE, *ONE_KIND, ("encoder: 0.022 deg, pressure_noise: 4 kPa", sensors))
        runs = draw(one, 8, 99)
        task = ControllerTuning(one, "PID 3", SearchSpace(one.tuned_over("PID 3")), runs)
        batch = evaluate(runs, "PID 3", {KP: [2e5]}, metrics=("angle_rmse", "stiffness_rmse"))
        mean = one.cost(batch.metrics)[started(batch)].mean()
        (cost,) = task.evaluate(np.array([[2e5]])).costs
        assert cost == pytest.approx(mean, rel=1e-6) if share == 1 else cost > share * mean


@pytest.mark.slow
def test_margins_of_gains_are_the_least_on_plants_of_the_training_runs():
    one = changed(*ALONE)
    task = ControllerTuning(one, "PID 3", SearchSpace(one.tuned_over("PID 3")), draw(one, 8, 99))
    least = task._least_margins({KP: np.array([1e5, 4e6])}, 2)
    alone = [with_values(one.scenario("PID 3"), {KP: 1e5}).margins(4).disk.min()]
    assert least[1] < least[0] <= alone[0] * 1.05


@pytest.mark.usefixtures("simulating_nothing")
class TestTuning:
    @pytest.mark.slow
    def test_costs_are_means_and_metrics_medians_over_the_runs_that_begin(self, tmp_path):
        one = changed(*ALONE, ("generations: 2", "generations: 6"))
        contest = compare(one, out=tmp_path)
        training = draw(one, 8, 99)
        assert (training.conditions["valve.time_constant"] > 0.048).any(), "one cannot begin"
        assert (training.conditions["disturbance.height"] > 0).any(), "and some can be lost"
        tried = trials(tmp_path)
        kps = 1e4 * 200 ** np.array([trial.point[0] for trial in tried])
        assert [trial.cost for trial in tried] == pytest.approx([mean_cost(training, kp) for kp in kps], rel=1e-9)
        assert (kps > 8e5).any()
        assert contest.training_cost["PID 3"][1] == pytest.approx(mean_cost(training, 1.2e5))
        kp = contest.tuned["PID 3"][KP]
        assert contest.training_cost["PID 3"][0] == pytest.approx(mean_cost(training, kp), rel=1e-9)
        assert abs(np.log10(kp / 3e5)) < 0.1, "the search finds what is best"
        assert kp == float(f"{kp:.5e}"), "six digits, as it is written down"
        assert contest.at_bound["PID 3"] == ()
        begins = training.conditions["valve.time_constant"] <= 0.048
        mass, lag = training.conditions["load.mass2"][begins], training.conditions["valve.time_constant"][begins]
        assert list(contest.trials["PID 3"]) == trials(tmp_path)
        for trial in contest.trials["PID 3"]:
            kp = 1e4 * 200 ** trial.point[0]
            failed = 0 if trial.metrics is None else trial.metrics["failed"]
            assert (trial.metrics is None or failed > 0) == (kp > 8e5)
            if trial.metrics is not None and not failed:
                error = (1 + abs(np.log10(kp / 3e5))) * np.median(mass) / 0.5 * deg
                assert trial.metrics == pytest.approx(
                    {
                        "angle_rmse": error,
                        "stiffness_rmse": np.median(lag) / 0.02,
                        "air": kp / 3e5 * 1e-4,
                        "failed": 0.0,
                    }
                )

    @pytest.mark.slow
    def test_the_gains_are_those_that_are_best_on_the_runs_of_the_finalists(self, tmp_path):
        one = changed(*ALONE, ("starts: 2", "starts: 2, finalists: 5, finalist_runs: 40"))
        contest = compare(one, out=tmp_path)
        runs, finalists = draw(one, 40, 100), contest.finalists["PID 3"]
        *searched, _ = trials(tmp_path)  # the last are the gains with six digits
        tried = sorted(searched, key=lambda trial: trial.cost)
        points = {trial.point for trial in finalists}
        assert {trial.point for trial in tried[:5]} <= points <= {trial.point for trial in tried}
        assert len(points) == len(finalists) <= 10
        kps = 1e4 * 200 ** np.array([trial.point[0] for trial in finalists])
        assert [trial.cost for trial in finalists] == pytest.approx([mean_cost(runs, kp) for kp in kps], rel=1e-4)
        best = min(finalists, key=lambda trial: trial.cost)
        assert contest.tuned["PID 3"][KP] == pytest.approx(1e4 * 200 ** best.point[0], rel=1e-5)
        training = draw(one, 8, 99)
        assert contest.training_cost["PID 3"][0] == pytest.approx(mean_cost(training, contest.tuned["PID 3"][KP]))
        air = next(trial.metrics["air"] for trial in tried if trial.point == best.point)
        assert contest.training_air("PID 3") == air
        again = compare(one, out=tmp_path, resume=True)
        assert again.finalists == contest.finalists and again.tuned == contest.tuned

    @pytest.mark.slow
    def test_at_equal_air_each_has_its_trial_of_least_error(self, suite, contest, kept):
        """By the medians of the training runs, of trials in which no run diverged, on the evaluation runs."""
        tried = {name: trials(kept, name) for name in ("PID 3", "decoupling")}
        limit = min(tried["PID 3"], key=lambda trial: trial.cost).metrics["air"]
        for name, each in tried.items():
            best = min(each, key=lambda trial: trial.cost).metrics
            known = [t.metrics for t in each if t.metrics and t.metrics["air"] <= limit]
            known = [at for at in known if at["stiffness_rmse"] <= 1.1 * best["stiffness_rmse"]]
            assert (name in contest.at_air.batches) == (len(known) > 0)
            if known:
                alone = evaluate(contest.runs, name, contest.at_air.tuned[name])
                assert np.array_equal(contest.at_air.metric(name, "air"), alone.metrics["air"][contest.started])
        chosen = min(
            (t.metrics for t in tried["PID 3"] if t.metrics), key=lambda at: (at["air"] > limit, at["angle_rmse"])
        )
        assert contest.at_air.tuned["PID 3"][KP] == pytest.approx(chosen["air"] / 1e-4 * 3e5, rel=1e-5)
        assert "as it is" not in contest.at_air.tuned
        assert contest.training_air("PID 3") == limit

    @pytest.mark.slow
    def test_all_have_the_same_budget_and_untuned_ones_none(self, contest, kept):
        counts = {name: len(trials(kept, name)) for name in ("PID 3", "decoupling")}
        assert all(24 <= count <= 26 for count in counts.values()), counts  # two searches and that at equal air
        assert contest.tuned["as it is"] == {}
        assert "as it is" not in contest.training_cost
        batch = contest.batches["as it is"]
        assert batch.metrics["air"][~batch.failed] == pytest.approx(2 / 3 * 1e-4), "2 bar/rad, as in the file"

    @pytest.mark.slow
    def test_a_search_starts_at_the_best_of_its_candidates(self, tmp_path):
        compare(changed(*ALONE, ("starts: 2", "starts: 1, candidates: 40")), out=tmp_path)
        found = trials(tmp_path)
        best = min(found[:40], key=lambda trial: trial.cost)
        assert best.cost < found[0].cost, "better than the gains of the file"
        assert len({trial.point for trial in found[:40]}) == 40
        assert np.mean([trial.point for trial in found[40:44]]) == pytest.approx(best.point[0], abs=0.35)

    @pytest.mark.slow
    def test_runs_that_cannot_begin_are_no_fault_of_anyone(self, contest):
        lags = contest.runs.conditions["valve.time_constant"]
        assert np.array_equal(contest.started, lags <= 0.048)
        assert not contest.started.all()
        heavy = contest.runs.conditions["load.mass2"][contest.started]
        assert contest.metric("as it is", "angle_rmse") / deg == pytest.approx((1 + np.log10(1.5)) * heavy / 0.5)
        assert not contest.diverged("as it is").any()

    @pytest.mark.slow
    def test_a_search_repeats_itself_and_is_taken_up(self, suite, contest, kept, tmp_path):
        for share in (0.5, 0.9, 1.0):  # 0.9: in the search at equal air
            (tmp_path / STUDY).write_bytes((kept / STUDY).read_bytes())
            connection = sqlite3.connect(tmp_path / STUDY)
            with connection:
                connection.execute("DELETE FROM record WHERE job = 'PID 3' AND number > ?", (share * 24,))
                connection.execute("DELETE FROM record WHERE job = 'decoupling' AND ? < 1", (share,))
            connection.close()
            again = compare(suite, out=tmp_path, resume=True)
            assert again.trials == contest.trials
            assert again.tuned == contest.tuned
            assert again.training_cost == contest.training_cost

    @pytest.mark.slow
    def test_a_study_of_other_runs_is_not_continued(self, kept, contest):
        for other in (("load.mass2=+-50 %", "load.mass2=+-40 %"), ("duration: 120 ms", "duration: 140 ms")):
            with pytest.raises(FileError):
                compare(changed(other), out=kept, resume=True)

    @pytest.mark.slow
    def test_when_no_run_can_begin_it_is_said(self):
        slow = ("valve.time_constant=10..50 ms", "valve.time_constant=49..50 ms")
        with pytest.raises(ParameterError, match="none of the runs can start"):
            compare(changed(slow, *ALONE))
        with pytest.raises(ParameterError, match="none of the runs can start"):
            compare(changed(slow, ALONE[0], ("untuned: [as it is]", "untuned: [PID 3]")))


FRICTION = ", friction: {half_width: 6 N, presliding_length: 0.5 mm}}"
RUBBING = (
    ("strength: 1}", f"strength: 1{FRICTION}"),
    ("strength: 1.05}", f"strength: 1.05{FRICTION}"),
    ("feedback: {bandwidth: 40 rad/s}", "feedback: {bandwidth: 40 rad/s}\n    friction_compensation: true"),
)


@pytest.mark.parametrize("plants", [(), RUBBING, (OF_AIR, ("substeps: 1", "substeps: 8"))])
@pytest.mark.slow
def test_a_true_model_is_the_plant_of_each_run(plants):
    runs = draw(changed(("tuning: {", "true_model: [decoupling]\ntuning: {"), *plants), 8, 1)
    assert len(runs.groups) == 2
    bandwidths = {"controller.feedback.bandwidth": [30.0, 50.0]}
    for group in runs.groups:
        control = controller_of(runs, group, "decoupling", bandwidths, 2)
        for row in range(2 * group.count):
            values = {name: column[row // group.count] for name, column in bandwidths.items()}
            alone = runs.scenario("decoupling", int(group.rows[row % group.count]), values).control()
            for own, single in zip(jax.tree.leaves(control), jax.tree.leaves(alone), strict=True):
                np.testing.assert_allclose(np.asarray(own)[row] if np.ndim(own) else own, single, rtol=1e-12)


def test_too_much_air_or_stiffness_error_raises_the_error_that_is_searched():
    def error(air, stiffness, failed=0.0):
        metrics = {"air": air, "angle_rmse": 0.01, "stiffness_rmse": stiffness, "failed": failed}
        return error_at_air(Trial((0.5,), 1.0, metrics=metrics), air=2e-4, stiffness=0.5, failed=1.0)

    assert error(2e-4, 0.5) == error(1e-4, 0.1) == 0.01
    assert error(2.2e-4, 0.5) == error(2e-4, 0.55) == pytest.approx(0.02)
    assert error(2e-4, 0.5, failed=1.0) == 0.01
    assert error(2e-4, 0.5, failed=2.0) == FAILED_COST
    assert error_at_air(Trial((0.5,), FAILED_COST), air=2e-4, stiffness=0.5, failed=1.0) == FAILED_COST


@pytest.mark.slow
@pytest.mark.parametrize("mass", [1.0, 1.5])
def test_models_are_those_of_a_calibration_on_each_plant(monkeypatch, mass):
    """One that finds the model of the file, or another load, but for two plants on which it is not possible."""
    last = TEXT[TEXT.index("evaluation:") : TEXT.index("duration:")]
    suite = changed(*ONE_KIND, (last, last + "calibration: {weight: 0.5 kg, runs: 6}\n"))
    asked, load = [], replace(suite.load, mass2=mass * suite.load.mass2)

    def calibrated(scenario, settings):
        asked.append(settings.weight)
        return None if len(asked) in (2, 5) else {"model": suite.joint, "load": load}

    monkeypatch.setitem(binding._BOUND, "calibrated_models", calibrated)
    runs = draw(suite, 8, 1)
    kept, possible = runs.calibrated(lambda _: None)
    assert asked == [0.5] * 6 and possible.tolist() == [True, False, True, True, False, True]
    before, after = evaluate(runs, "decoupling", {}), evaluate(kept, "decoupling", {})
    same = np.isclose(after.metrics["angle_rmse"], before.metrics["angle_rmse"][:6][possible], rtol=1e-9)
    assert same.all() == (mass == 1.0) and same.any() == (mass == 1.0)
    tables = {"batches": {"decoupling": before}, "calibrated": {"decoupling": after}, "calibrated_runs": possible}
    columns = CompareResult(suite, runs, {"decoupling": {}}, {}, {}, **tables).after_calibration()
    assert columns["runs"][1] == [4] and columns["angle_after"][1].size == 1
