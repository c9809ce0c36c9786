"""Results of the reproduction: tracking runs, files, JSON, and verdicts recomputed from its numbers."""

import dataclasses
import itertools
import json
import math
from pathlib import Path

import numpy as np
import pytest

from mckibben import control, paper
from mckibben.dataset import IsobaricDataset
from mckibben.identification import Fit
from mckibben.paper.settings import AS_PRINTED, PRE_CONTRACTED, SETTINGS, StiffnessReference, bp_scenario, pid_scenario
from mckibben.paper.tracking import BP, CONTROLLERS, FREE_TUNED_BP, PID, TUNED_BP, TUNED_PID, ControllerRun
from mckibben.scenario import Scenario, run_scenario
from mckibben.scenario.robot import RobotScenario
from mckibben.simulation import Metrics, SimulationResult, check_reference
from tests.paper.test_claims import CHOU_CLAIM, COUPLED_CLAIM, MODERATE, SIMILAR_CLAIM, angle_claim, settling_claim

pytestmark = pytest.mark.slow

RUN_KEYS = list(itertools.product([s.key for s in SETTINGS], StiffnessReference))


class KnownResult(dict):
    """Columns of a result with metrics that are given."""

    metrics: dict


def moved_by(amplitude: float, **metrics) -> KnownResult:
    """A result with a sine for reference."""
    found = KnownResult(desired_angle=amplitude * np.sin(np.linspace(0, 2 * np.pi, 1000, endpoint=False)))
    found.metrics = {"angle_rmse": 0.5, **metrics}
    return found


def seeded(**columns) -> ControllerRun:
    """A run of which the metrics over the seeds are known; zeros where they are not given."""
    size = len(next(iter(columns.values())))
    return ControllerRun(
        None, moved_by(1.0), Metrics(**{n: np.asarray(columns.get(n, np.zeros(size)), float) for n in Metrics._fields})
    )


@pytest.mark.parametrize(("key", "reference"), RUN_KEYS)
def test_both_methods_have_the_same_plant_reference_start_and_base_gains(tracking, key, reference):
    for pid, learned in ((PID, (BP,)), (TUNED_PID, (TUNED_BP, FREE_TUNED_BP))):
        base = tracking.runs[key, reference, pid].scenario
        for name in learned:
            other = tracking.runs[key, reference, name].scenario
            assert other.joint == base.joint
            assert (other.load, other.valve, other.signals, other.start) == (
                base.load,
                base.valve,
                base.signals,
                base.start,
            )
            for loop in ("position", "stiffness"):
                one, two = getattr(base.control(), loop), getattr(other.control(), loop)
                assert isinstance(two, control.BackpropPID)
                assert (two.base.kp, two.base.ki, two.base.kd) == (one.kp, one.ki, one.kd)
    assert tracking.runs[key, reference, BP].scenario.control().position.gain_ratio == 2.0
    assert tracking.runs[key, reference, TUNED_BP].scenario.control().position.gain_ratio == 1.1
    assert tracking.runs[key, reference, FREE_TUNED_BP].scenario.control().position.gain_ratio == 2.0


@pytest.mark.parametrize("setting", SETTINGS, ids=lambda s: s.key)
def test_the_tuned_gains_are_those_of_the_tuning_to_the_last_bit(tracking, setting):
    tuned = tracking.tuned[setting.key]
    for reference in StiffnessReference:
        given = tracking.runs[setting.key, reference, TUNED_PID].scenario.control()
        for loop in ("position", "stiffness"):
            for gain in ("kp", "ki", "kd"):
                used = getattr(getattr(given, loop), gain)
                assert used == tuned.values.get(f"controller.{loop}.{gain}", 0.0)
    assert tuned.cost <= tuned.cost_before


@pytest.mark.parametrize(("key", "reference"), RUN_KEYS)
def test_the_run_in_the_figures_is_that_of_the_first_seed(tracking, key, reference):
    run = tracking.runs[key, reference, BP]
    own = run.result.metrics
    for name in ("angle_rmse", "angle_max", "stiffness_rmse", "stiffness_settling"):
        assert float(getattr(run.seeds, name)[0]) == pytest.approx(own[name], rel=1e-6), name
    assert run.seeds.angle_rmse.shape == (2,)
    assert float(run.seeds.angle_rmse[0]) != float(run.seeds.angle_rmse[1])
    assert tracking.runs[key, reference, PID].seeds is None


@pytest.mark.parametrize("setting", SETTINGS, ids=lambda s: s.key)
@pytest.mark.parametrize("reference", StiffnessReference)
def test_the_references_are_within_reach(setting, reference):
    scenario = pid_scenario(setting, reference)
    reach = check_reference(scenario.plant(), scenario.reference(), control_period=1e-2)
    assert reach.feasible, reach.verdict()


@pytest.mark.parametrize("setting", SETTINGS, ids=lambda s: s.key)
def test_coupling_is_what_the_runs_show(tracking, setting):
    found = tracking.coupling[setting.key]
    table = tracking.runs[setting.key, StiffnessReference.CONSTANT, PID].result
    late = table["time"] >= 5.0 - 1e-9
    error = (table["stiffness"] - table["desired_stiffness"])[late]
    assert found.stiffness_by_motion == pytest.approx(np.sqrt(np.mean(error**2)), rel=1e-6)
    assert found.stiffness_at_rest < 1e-3 * found.stiffness_by_motion

    scenario = tracking.runs[setting.key, StiffnessReference.STEP, PID].scenario
    level = pid_scenario(dataclasses.replace(setting, after=setting.before), StiffnessReference.STEP)
    assert level.start == scenario.start
    with_step = tracking.runs[setting.key, StiffnessReference.STEP, PID].result["angle"]
    without = run_scenario(level)
    assert np.ptp(without["desired_stiffness"]) == 0
    assert found.angle_by_step == pytest.approx(np.abs(with_step - without["angle"])[late].max(), rel=1e-6)


def test_medians_and_worsts_over_seeds():
    values = np.arange(20, dtype=float) ** 2
    assert seeded(angle_rmse=values).median("angle_rmse") == np.median(values)
    run = seeded(angle_rmse=[3.0, 1.0, 2.0], stiffness_settling=[0.5, np.nan, 0.1])
    assert run.median("angle_rmse") == 2.0
    assert run.worst("angle_rmse") == 3.0
    assert run.median("stiffness_settling") == 0.5  # one that never settles is the longest
    assert math.isnan(run.worst("stiffness_settling"))
    assert math.isnan(seeded(stiffness_settling=[np.nan, np.nan, 0.1]).median("stiffness_settling"))


def test_a_run_that_is_worse_than_not_moving_or_not_finite_is_unstable():
    still = math.sqrt(0.5)  # the RMS of a sine of 1 rad
    assert seeded(angle_rmse=[0.1, still * 1.001, np.nan, np.inf, still * 0.999]).unstable == 3
    assert ControllerRun(None, moved_by(1.0), None).unstable == 0
    single = ControllerRun(None, moved_by(0.1), None)
    assert single.unstable == 1
    assert single.median("angle_rmse") == single.worst("angle_rmse") == 0.5


NAMES = {
    f"{s.key.replace('_', '-')}-{w.value}-{c.lower().replace(',', '').replace(' ', '-')}"
    for s in SETTINGS
    for w in StiffnessReference
    for c in CONTROLLERS
}


@pytest.fixture(scope="module")
def results(reproduction):
    return reproduction.numbers()


@pytest.fixture(scope="module")
def folder(reproduction, tmp_path_factory):
    folder = tmp_path_factory.mktemp("report") / "new" / "folder"
    reproduction.save(folder)
    return folder


def test_the_results_are_json_without_nan(results):
    assert json.loads(json.dumps(results, allow_nan=False)) == results


def test_saved_files_read_back(folder, results, reproduction):
    assert json.loads((folder / "results.json").read_text(encoding="utf-8")) == results
    for name, fit in reproduction.identification.fits.items():
        back = Fit.from_yaml(folder / "fits" / f"{name}.yaml")
        assert back.estimates == pytest.approx(fit.estimates, rel=0.01)
        assert back.rmse == pytest.approx(fit.rmse, rel=1e-5)
    rig = reproduction.identification.rig
    for name, data in (("test", rig.test), ("retest", rig.retest)):
        back = IsobaricDataset.from_netcdf(folder / "data" / f"virtual-rig-{name}.nc")
        assert back.table.identical(data.table)
    assert {p.stem for p in (folder / "scenarios").iterdir()} == NAMES | {"leg"}
    assert {p.stem for p in (folder / "trajectories").iterdir()} == NAMES | {"leg"}
    assert not list(folder.rglob(".*.part"))


@pytest.mark.parametrize("name", [f"as-printed-constant-{BP.lower()}", f"pre-contracted-step-{PID.lower()}"])
def test_a_scenario_run_alone_gives_its_trajectory_to_the_last_bit(folder, name):
    kept = SimulationResult.from_netcdf(folder / "trajectories" / f"{name}.nc")
    scenario = Scenario.read(folder / "scenarios" / f"{name}.yaml")
    again = run_scenario(scenario)
    assert set(again.columns) == set(kept.columns)
    for column in kept.columns:
        np.testing.assert_array_equal(again[column], kept[column])
    assert Scenario.parse(kept.scenario) == scenario  # the trajectory carries what made it


def test_the_command_keeps_the_numbers_and_calls_the_report(monkeypatch, capsys, tmp_path, reproduction):
    import mckibben.paper.page
    from mckibben.cli import app

    calls = []

    def write_report(done, out):
        assert (out / "results.json").exists()  # the numbers are safe before anything is drawn
        calls.append(done)
        return out / "report.html"

    monkeypatch.setattr(paper, "reproduce", lambda *, quick, progress: reproduction)
    monkeypatch.setattr(mckibben.paper.page, "write_report", write_report)
    monkeypatch.setattr(SimulationResult, "to_netcdf", lambda *_: None)  # `folder` has the trajectories
    monkeypatch.setenv("COLUMNS", "160")
    out = tmp_path / "deep" / "report"
    app(["reproduce", "--quick", "--out", str(out)], standalone_mode=False)
    printed = capsys.readouterr()
    assert calls == [reproduction]
    assert json.loads((out / "results.json").read_text(encoding="utf-8")) == reproduction.numbers()
    assert " ".join(printed.out.split()).count("the paper's muscle") == 2
    assert "4 of the paper's claims can be tested here and hold; 2 rest on a muscle that was not published" in " ".join(
        printed.out.split()
    )
    assert "results.json" in printed.out.replace("\n", "")


def test_only_what_the_paper_says_counts_as_its_claim(reproduction):
    own = {CHOU_CLAIM, SIMILAR_CLAIM, COUPLED_CLAIM, settling_claim(MODERATE)}
    own |= {angle_claim(reference, MODERATE) for reference in StiffnessReference}
    papers = reproduction.paper_claims
    assert len(papers) == len(own) == 6
    assert {claim.claim for claim in papers if claim.needs_muscle} == {CHOU_CLAIM, SIMILAR_CLAIM}
    assert all(any(claim.claim.startswith(start) for start in own) for claim in papers)
    assert all(claim.words for claim in papers)
    assert len(reproduction.questions) == 6
    assert not any(claim.words or claim.of_paper for claim in reproduction.questions)


EXAMPLES = Path(__file__).parents[2] / "examples"
RUNS = {
    "as-printed-constant-pid": pid_scenario(AS_PRINTED, StiffnessReference.CONSTANT),
    "pre-contracted-step-pid": pid_scenario(PRE_CONTRACTED, StiffnessReference.STEP),
    "pre-contracted-step-backprop": bp_scenario(PRE_CONTRACTED, StiffnessReference.STEP),
}


def test_the_leg_follows_angles_and_stiffness_of_all_joints_as_its_example(reproduction):
    example = RobotScenario.read(EXAMPLES / "robot" / "lei-leg-control.yaml")
    ideal = RobotScenario.parse(reproduction.leg.scenario)  # as the paper is; the example has friction
    assert (ideal.reference, ideal.sensors, ideal.valve) == (example.reference, example.sensors, example.valve)
    errors = reproduction.numbers()["leg"]
    assert set(errors) == {"side", "hip", "knee"}
    for error in errors.values():  # steps of 1.5 N*m/rad, sines of 3 to 8 deg
        assert error["angle_rmse_deg"] < 0.2
        assert error["stiffness_rmse"] < 0.1


@pytest.mark.parametrize("name", RUNS)
def test_an_example_is_built_as_the_run_of_the_report(name):
    example, run = Scenario.read(EXAMPLES / f"{name}.yaml"), RUNS[name]
    assert repr(example.plant()) == repr(run.plant())
    assert repr(example.control()) == repr(run.control())
    assert repr(example.reference()) == repr(run.reference())
    assert example.start == run.start
    assert (example.duration, example.control_period, example.accuracy) == (10.0, 1e-3, 1e-6)
