"""Searches for a start from which nothing has to move: the answer is known; a search that was cut off goes on."""

import re
import sqlite3
from pathlib import Path

import numpy as np
import pytest

from mckibben.errors import FileError, ParameterError, UnreachableError
from mckibben.scenario import Scenario, ScenarioParameter, Start
from mckibben.storage.store import STUDY
from mckibben.study.parameters import LogUniform, Uniform, parse_sweep
from mckibben.study.tune import Cost, gain_ranges, parse_ranges, read_trials, tune
from mckibben.study.tune.objective import TuningProblem
from mckibben.study.tune.search import SEARCHES
from mckibben.study.tune.space import is_gain
from mckibben.units import Quantity, deg

EXAMPLE = (Path(__file__).parents[2] / "examples" / "pre-contracted-step-pid.yaml").read_text(encoding="utf-8")
TEXT = EXAMPLE
for old, new in (
    ("duration: 10 s", "duration: 100 ms"),
    ("control_period: 1 ms", "control_period: 2 ms"),
    ("{class: sine, amplitude: 10 deg, frequency: 0.5 Hz}", "2 deg"),
    ("{class: step, before: 13 N*m/rad, after: 17 N*m/rad, at: 5 s}", "15 N*m/rad"),
):
    assert old in TEXT
    TEXT = TEXT.replace(old, new)
STILL = Scenario.parse(TEXT)
RANGES = {"start.angle": Uniform(-5 * deg, 8 * deg), "start.stiffness": LogUniform(11.0, 20.0)}
COST = Cost.of({"angle_rmse": deg, "stiffness_rmse": 1.0})
SMALL = {"iterations": 3, "population": 8, "seed": 3}
GOAL = np.array([0.3, 0.8])


def run(*, scenarios=STILL, ranges=RANGES, cost=COST, **changes):
    return tune(scenarios, ranges, cost, **SMALL | changes)


def numbers(tuned):
    return tuned.values, tuned.cost, tuned.evaluated, tuned.trials


def starting(angle, stiffness):
    return Scenario.parse(TEXT.replace("angle: 0 deg, stiffness: 12 N", f"angle: {angle}, stiffness: {stiffness} N"))


@pytest.fixture
def for_free(monkeypatch):
    """No runs, where they do not matter."""
    monkeypatch.setattr(TuningProblem, "costs", lambda self, values: np.sum(values**2, axis=1))


def bowl(points):
    return np.sum((points - GOAL[: points.shape[1]]) ** 2 * [1.0, 30.0][: points.shape[1]], axis=1)


@pytest.mark.parametrize("method", SEARCHES)
@pytest.mark.parametrize("first", [[0.9, 0.1], [1.0, 0.0], [0.9]])
def test_each_method_finds_the_bottom_of_a_bowl_within_the_cube(method, first):
    def searched(generations, seed=0):
        points, parts = [], []
        SEARCHES[method](
            lambda some: [points.extend(some.tolist()), bowl(some)][1],
            np.array(first),
            population=8,
            generations=generations,
            seed=seed,
            progress=parts.append,
        )
        assert parts == sorted(parts) and parts[-1] <= 1.0
        return np.array(points)

    points = searched(60)
    assert points.min() >= 0.0 and points.max() <= 1.0
    np.testing.assert_allclose(points[np.argmin(bowl(points))], GOAL[: len(first)], atol=2e-3)
    assert first in points.tolist()
    few = searched(4)
    assert searched(4).tolist() == few.tolist() == points[: len(few)].tolist()
    if method == "cma":
        assert searched(4, seed=1).tolist() != few.tolist()


@pytest.mark.slow
def test_a_search_reports_its_steps_and_rounds_its_values():
    steps = []
    tuned = run(progress=lambda *step: steps.append(step))
    assert len({trial.point for trial in tuned.trials}) == tuned.evaluated == 8 * SMALL["iterations"]
    assert tuned.cost == pytest.approx(min(trial.cost for trial in tuned.trials), rel=1e-3)
    assert tuned.cost <= tuned.cost_before
    parts = [part for _, part in steps]
    assert parts == sorted(parts) and (parts[0], parts[-1]) == (0.0, 1.0)
    assert steps[1][0].startswith("searching 3 x 8 points") and steps[-1][0] == "evaluating"
    lowest = [float(step.split()[3]) for step, _ in steps[2:-1]]
    assert lowest == sorted(lowest, reverse=True)
    for name, value in tuned.values.items():
        assert RANGES[name].low <= value <= RANGES[name].high
        shown = value / (deg if name == "start.angle" else 1)
        assert float(f"{shown:.6g}") == pytest.approx(shown, rel=1e-14)
    assert tuned.verdict().endswith(f"{tuned.evaluated} points") and repr(tuned).startswith("<TuneResult: cost")
    assert [listing.title for listing in tuned.listings()][1:3] == ["Parameters", STILL.name]


@pytest.mark.slow
def test_rounding_makes_nothing_worse(monkeypatch):
    start = starting("1.23456789 deg", 14.123456789)
    best = np.array([start.start.angle, start.start.stiffness])
    monkeypatch.setattr(TuningProblem, "run_costs", lambda _, values: 1 + np.abs(values - best).sum(axis=1))
    tuned = run(scenarios=start)
    assert tuned.values == pytest.approx(dict(zip(RANGES, best, strict=True)), rel=1e-12)
    assert tuned.cost <= tuned.cost_before * (1 + 1e-12)


@pytest.mark.slow
def test_a_number_at_an_end_of_its_range_is_named():
    tuned = run(ranges=RANGES | {"start.angle": Uniform(-1.23456789 * deg, 1.23456789 * deg)}, iterations=15)
    assert tuned.at_bound == ("start.angle",)
    assert any("start.angle" in remark.text for remark in tuned.remarks() if remark.field == "at_bound")
    assert 1.2 * deg < tuned.values["start.angle"] <= 1.23456789 * deg


@pytest.mark.slow
def test_several_scenarios_are_tuned_at_once():
    """With a second reference of 4 deg the worst of both is least in the middle."""
    other = Scenario.parse(TEXT.replace("angle: 2 deg", "angle: 4 deg"))
    cost = Cost.of({"angle_rmse": deg, "stiffness_rmse": 1.0}, percentile=100.0)
    tuned = run(scenarios=[STILL, other], cost=cost, iterations=25)
    assert tuned.values["start.angle"] / deg == pytest.approx(3.0, abs=0.1)
    assert [scenario.signals.angle.value / deg for scenario in tuned.scenarios] == pytest.approx([2.0, 4.0])


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A search from beginning to end, and its folder."""
    folder = tmp_path_factory.mktemp("whole")
    return run(out=folder), folder


@pytest.mark.parametrize("kept", [0, 4, 13, 24])
def test_a_search_goes_on_wherever_it_was_cut_off(whole, tmp_path, kept):
    undisturbed, complete = whole
    (tmp_path / STUDY).write_bytes((complete / STUDY).read_bytes())
    connection = sqlite3.connect(tmp_path / STUDY)
    with connection:
        connection.execute("DELETE FROM record WHERE number >= ?", (kept,))
    connection.close()
    assert numbers(run(out=tmp_path, resume=True)) == numbers(undisturbed)
    assert tuple(read_trials(tmp_path / STUDY)) == undisturbed.trials


@pytest.mark.parametrize(
    ("changed", "field", "message"),
    [
        ({"method": "local"}, "method", "started with cma, not local"),
        ({"cost": Cost(COST.terms, gain_margin=1.5)}, "gain_margin", "started with 1.0, not 1.5"),
        ({"ranges": RANGES | {"start.stiffness": LogUniform(11.0, 20.000000001)}}, "parameters", "20.000000001"),
    ],
)
def test_another_search_is_refused_by_name(for_free, tmp_path, changed, field, message):
    run(out=tmp_path, iterations=1)
    with pytest.raises(FileError) as caught:
        run(out=tmp_path, resume=True, **changed)
    assert any(problem.field == field and message in problem.message for problem in caught.value.problems)


def test_a_file_that_the_scenario_names_is_a_part_of_the_search(for_free, tmp_path, monkeypatch):
    samples, text = (
        tmp_path / "reference.csv",
        TEXT.replace("angle: 2 deg", "angle: {class: samples_file, file: reference.csv}"),
    )
    samples.write_text("time_s,angle_deg\n0,2\n1,2\n", encoding="utf-8")
    first = run(out=tmp_path, iterations=1, scenarios=Scenario.parse(text, folder=tmp_path))
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")  # from where it goes on does not matter
    again = run(out=Path(".."), iterations=1, scenarios=Scenario.parse(text, folder=".."), resume=True)
    assert numbers(again) == numbers(first)
    samples.write_text("time_s,angle_deg\n0,2\n1,3\n", encoding="utf-8")
    with pytest.raises(FileError, match="models: it has changed"):
        run(out=tmp_path, iterations=1, scenarios=Scenario.parse(text, folder=tmp_path), resume=True)


def test_a_trial_is_on_disk_before_the_search_goes_on(for_free, tmp_path):
    known = []

    def search(costs, first, **options):
        for place in (0.2, 0.4, 0.9):
            costs(np.array([[place, place]]))
            known.append(len(read_trials(tmp_path / STUDY)))

    run(out=tmp_path, method=search)
    assert known == [2, 3, 4]  # the first one has the values of the file


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"population": 3}, "population is 3"),
        ({"seed": -1}, "seed is -1"),
        ({"iterations": 0}, "iterations is 0"),
        ({"method": "evolution"}, "method is 'evolution'"),
        ({"ranges": RANGES | {"start.stiffness": Uniform(60.0, 70.0)}}, r"none of the \d+ evaluated points has a cost"),
    ],
)
def test_a_search_that_cannot_be_done_says_so(tmp_path, changed, message):
    with pytest.raises(ParameterError, match=message):
        run(out=tmp_path / "out", **changed)
    if "ranges" not in changed:
        assert not (tmp_path / "out" / STUDY).exists()  # nothing is in the way of the next try


def test_a_start_that_no_gains_can_mend_is_refused_before_the_search(tmp_path):
    gain = {"controller.position.kp": Uniform(1e5, 3e5)}
    with pytest.raises(UnreachableError):
        run(out=tmp_path, scenarios=STILL.replace(start=Start(stiffness=1e4)), ranges=gain)
    assert not list(tmp_path.iterdir())


def test_ranges_around_the_gains():
    gains = gain_ranges(STILL)
    names = ["position.kp", "position.ki", "position.kd", "stiffness.kp", "stiffness.ki"]  # one is zero
    assert list(gains) == [f"controller.{name}" for name in names]
    for name, gain in gains.items():
        assert gain.high / gain.low == pytest.approx(1e2)
        assert {swept.name: swept.distribution for swept in parse_ranges([], STILL)}[name] == gain
    reverse = Scenario.parse(TEXT.replace("kp: 0.08 bar", "kp: -0.08 bar").replace("ki: 5 bar", "ki: -5 bar"))
    gain = gain_ranges(reverse)["controller.stiffness.kp"]
    assert (gain.low, gain.high) == pytest.approx((-8e4, -800.0))
    zero = Scenario.parse(re.sub(r"(k[pid]): [0-9.]+ ", r"\1: 0 ", TEXT))
    assert gain_ranges(zero) == {}
    with pytest.raises(ParameterError) as caught:
        parse_ranges([], zero)
    assert "--parameters" in caught.value.remedy


@pytest.mark.parametrize(
    ("place", "unit", "gains"),
    [("controller", "Pa/rad", True), ("controller", "Pa/s", False), ("valve", "Pa/m", False)],
)
def test_a_field_of_a_user_defined_controller_is_a_gain_by_its_unit(place, unit, gains):
    assert is_gain(ScenarioParameter(f"{place}.push", ((place, "push"),), Quantity(unit), 2e5)) is gains


def test_a_whole_number_has_no_range_to_search():
    learning = Scenario.read(Path(__file__).parents[2] / "examples" / "pre-contracted-step-backprop.yaml")
    with pytest.raises(ParameterError, match="no range to search"):
        tune(learning, [parse_sweep("controller.position.seed=0..9", learning)], COST)
    with pytest.raises(ParameterError, match=r"controller\.position\.seed is a whole number"):
        parse_ranges(["controller.position.seed"], learning)
