"""Searches for a start from which nothing has to move: the answer is known, and each method has to find it."""

from pathlib import Path

import numpy as np
import pytest

from mckibben.errors import ParameterError
from mckibben.scenario import Scenario
from mckibben.study.parameters import LogUniform, Uniform, parse_sweep
from mckibben.study.tune import Cost, Method, gain_ranges, parse_ranges, tune
from mckibben.study.tune.objective import FAILED_COST, TuningProblem
from mckibben.units import deg

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
SMALL = {"iterations": 2, "starts": 2, "population": 8, "seed": 3}


def starting(angle, stiffness):
    return Scenario.parse(TEXT.replace("angle: 0 deg, stiffness: 12 N", f"angle: {angle}, stiffness: {stiffness} N"))


def same(one, other):
    return (one.values, one.cost, one.trials) == (other.values, other.cost, other.trials)


@pytest.fixture(scope="module", params=Method)
def method(request):
    return request.param


@pytest.fixture(scope="module")
def said():
    return {}


@pytest.fixture(scope="module")
def found(method, said):
    said[method], said[method, "steps"] = [], []

    def progress(step, part):
        said[method].append(part)
        said[method, "steps"].append(step)

    return tune(STILL, RANGES, COST, method=method, progress=progress, **SMALL)


@pytest.mark.slow
def test_each_method_finds_where_nothing_has_to_move(method):
    tuned = tune(STILL, RANGES, COST, method=method, **SMALL | {"iterations": 30})
    assert tuned.values["start.angle"] == pytest.approx(2 * deg, rel=1e-3)
    assert tuned.values["start.stiffness"] == pytest.approx(15.0, rel=1e-3)
    assert tuned.cost < 5e-3 < tuned.cost_before
    assert tuned.at_bound == ()
    (scenario,) = tuned.scenarios
    assert (scenario.start.angle, scenario.start.stiffness) == tuple(tuned.values.values())
    assert scenario.model_copy(update={"start": STILL.start}) == STILL


@pytest.mark.slow
def test_what_is_told_of_a_search(method, found, said):
    assert len({trial.point for trial in found.trials}) == found.evaluated == len(found.trials)
    assert found.cost <= found.cost_before
    assert found.cost == pytest.approx(min(trial.cost for trial in found.trials), rel=1e-3)
    assert all((trial.gradient is None) == (method is not Method.GRADIENT) for trial in found.trials)
    assert said[method][0] == 0.0
    assert said[method][-1] == 1.0
    assert said[method] == sorted(said[method])
    first, *others = said[method, "steps"]
    assert first == "compiling"  # there is no cost at the very beginning
    assert others[-1].startswith("evaluating")
    least = [float(step.split()[3]) for step in others]
    assert least == sorted(least, reverse=True)
    assert least[-1] == float(f"{min(trial.cost for trial in found.trials):.4g}")
    for name, value in found.values.items():
        assert RANGES[name].low <= value <= RANGES[name].high
        shown = value / (deg if name == "start.angle" else 1)
        assert float(f"{shown:.6g}") == pytest.approx(shown, rel=1e-14)
    if method is not Method.GRADIENT:
        assert found.evaluated == 8 * (SMALL["iterations"] + (method is Method.EVOLUTION))


@pytest.mark.slow
def test_the_same_seed_finds_the_same_and_another_something_else(method, found):
    assert same(tune(STILL, RANGES, COST, method=method, **SMALL), found)
    assert not same(tune(STILL, RANGES, COST, method=method, **SMALL | {"seed": 4}), found)


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.slow
def test_a_start_that_is_best_is_kept(method, seed):
    for angle, stiffness in (("2 deg", 15), ("2.00000123456789 deg", "14.9999987654321")):
        start = starting(angle, stiffness)
        tuned = tune(start, RANGES, COST, method=method, **SMALL | {"iterations": 1, "seed": seed})
        assert tuned.cost <= tuned.cost_before
    best = tune(starting("2 deg", 15), RANGES, COST, method=method, **SMALL | {"seed": seed})
    assert best.values == pytest.approx({"start.angle": 2 * deg, "start.stiffness": 15.0}, rel=1e-9)


def test_rounding_makes_nothing_worse(method, monkeypatch):
    start = starting("1.23456789 deg", 14.123456789)
    best = np.array([start.start.angle, start.start.stiffness])

    def cost(_, values):
        return 1 + np.abs(values - best).sum(axis=1)

    monkeypatch.setattr(TuningProblem, "costs", cost)
    monkeypatch.setattr(TuningProblem, "costs_and_gradients", lambda *said: (cost(*said), np.sign(said[1] - best)))
    tuned = tune(start, RANGES, COST, method=method, **SMALL)
    assert tuned.values == pytest.approx(dict(zip(RANGES, best, strict=True)), rel=1e-12)
    assert tuned.cost <= tuned.cost_before * (1 + 1e-12)


@pytest.mark.slow
def test_a_start_outside_its_range_is_moved_to_its_end(method):
    tuned = tune(starting("9 deg", 10.9), RANGES, COST, method=method, **SMALL)
    low, high = np.transpose([(each.low, each.high) for each in RANGES.values()])
    assert ((low <= list(tuned.values.values())) & (list(tuned.values.values()) <= high)).all()
    assert (1.0, 0.0) in [trial.point for trial in tuned.trials]
    assert tuned.cost < tuned.cost_before < FAILED_COST


@pytest.mark.slow
def test_a_start_that_cannot_be_held_costs_nothing_that_is_known(method):
    tuned = tune(starting("0 deg", 99), RANGES, COST, method=method, **SMALL | {"starts": 6})
    assert np.isnan(tuned.cost_before) and "margin" not in tuned.invalid_before != ""
    assert tuned.cost < FAILED_COST


@pytest.mark.slow
def test_a_number_at_an_end_of_its_range_is_named(method):
    """The best angle is 2 deg, above the range; the best stiffness lies within it."""
    ranges = RANGES | {"start.angle": Uniform(-1.23456789 * deg, 1.23456789 * deg)}
    tuned = tune(STILL, ranges, COST, method=method, **SMALL | {"iterations": 15})
    assert "start.angle" in tuned.at_bound
    assert "start.stiffness" not in tuned.at_bound
    assert 1.2 * deg < tuned.values["start.angle"] <= 1.23456789 * deg


def test_where_nothing_can_be_run_it_says_so(method):
    ranges = RANGES | {"start.stiffness": Uniform(60.0, 70.0)}
    with pytest.raises(ParameterError, match=r"none of the \d+ evaluated points has a cost.*search other ranges"):
        tune(STILL, ranges, COST, method=method, **SMALL | {"iterations": 1})


@pytest.mark.slow
def test_several_scenarios_are_tuned_at_once():
    """With a second reference of 4 deg the worst of both is least in the middle."""
    other = Scenario.parse(TEXT.replace("angle: 2 deg", "angle: 4 deg"))
    cost = Cost.of({"angle_rmse": deg, "stiffness_rmse": 1.0}, worst=True)
    tuned = tune([STILL, other], RANGES, cost, method=Method.CMA, **SMALL | {"iterations": 25})
    assert tuned.values["start.angle"] / deg == pytest.approx(3.0, abs=0.1)
    assert [each.signals.angle.value / deg for each in tuned.scenarios] == pytest.approx([2.0, 4.0])
    assert len({each.start.angle for each in tuned.scenarios}) == 1


@pytest.mark.parametrize("name", ["starts", "iterations", "population"])
@pytest.mark.parametrize("count", [0, -1, 2.5, True])
def test_counts_are_whole_numbers_from_one(name, count):
    with pytest.raises(ParameterError, match=f"{name} is {count}"):
        tune(STILL, RANGES, COST, **SMALL | {name: count})


@pytest.mark.parametrize("seed", [-1, 2**32, 0.5, True])
def test_a_seed_is_one_that_all_methods_take(seed):
    with pytest.raises(ParameterError, match=f"seed is {seed}"):
        tune(STILL, RANGES, COST, **SMALL | {"seed": seed})


def test_a_whole_number_has_no_range_to_search():
    learning = Scenario.read(Path(__file__).parents[2] / "examples" / "pre-contracted-step-backprop.yaml")
    with pytest.raises(ParameterError, match="no range to search"):
        tune(learning, [parse_sweep("controller.position.seed=0..9", learning)], COST)
    with pytest.raises(ParameterError, match=r"controller\.position\.seed is a whole number"):
        parse_ranges(["controller.position.seed"], learning)


def test_ranges_around_what_numbers_are():
    gains = gain_ranges(STILL)
    assert list(gains) == [f"controller.{k}" for k in ("position.kp", "position.ki", "position.kd")] + [
        f"controller.stiffness.{k}" for k in ("kp", "ki")
    ]  # one is zero
    for name, spread in gains.items():
        assert spread.high / spread.low == pytest.approx(1e4)
        assert {each.name: each.distribution for each in parse_ranges([], STILL)}[name] == spread
    reverse = Scenario.parse(TEXT.replace("kp: 0.08 bar", "kp: -0.08 bar").replace("ki: 5 bar", "ki: -5 bar"))
    spread = gain_ranges(reverse)["controller.stiffness.kp"]
    assert (spread.low, spread.high) == pytest.approx((-8e5, -80.0))


@pytest.mark.parametrize(
    ("texts", "named"),
    [
        (["controller.stiffness.kd"], "controller.stiffness.kd is zero, or not given: there is no range"),
        (["load.mass2", "load.mass2=1..2 kg"], "are about the same parameter"),
        (["load.mass9"], "no parameter 'mass9'"),
        (["load.mass2=2..1 kg"], "the range is empty"),
        (["load.mass2=1..2 N"], "does not have the dimensions of"),
        (["load.mass2=-1..2 kg"], "load.mass2"),
    ],
)
def test_ranges_that_are_none(texts, named):
    with pytest.raises(ParameterError, match=named):
        parse_ranges(texts, STILL)


def test_gains_that_are_all_zero_are_nothing_to_tune():
    import re

    zero = Scenario.parse(re.sub(r"(k[pid]): [0-9.]+ ", r"\1: 0 ", TEXT))
    assert gain_ranges(zero) == {}
    with pytest.raises(ParameterError, match="all gains are zero; give parameters"):
        parse_ranges([], zero)
