"""What is summed, and what numbers cost: as by hand from single runs."""

import functools
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mckibben.errors import ParameterError, RangeError, SimulationError
from mckibben.result import Severity
from mckibben.scenario import Scenario, run_scenario, with_values
from mckibben.simulation import LEAST_DISK_MARGIN, Metrics, Outcome, margins
from mckibben.study.parameters import LogUniform, Uniform, sweep_parameters
from mckibben.study.parameters.uncertainty import extremes, uncertainty
from mckibben.study.tune import Cost, Term, parse_cost, tune
from mckibben.study.tune.objective import FAILED_COST, UNSTABLE_COST, USE, TuningProblem
from mckibben.units import bar, deg, mm

SIZES = st.floats(1e-30, 1e30)
COSTS = st.lists(st.sampled_from(Metrics._fields), min_size=1, unique=True).flatmap(
    lambda names: st.tuples(*(st.builds(Term, st.just(name), SIZES, SIZES) for name in names))
)


@given(COSTS)
def test_what_is_written_reads_back_to_the_last_bit(terms):
    assert parse_cost(Cost(terms).text).terms == terms


@pytest.mark.parametrize("plus", [" + ", "+", " +", "+ ", "\n  + "])
def test_terms_with_units_weights_and_any_plus(plus):
    cost = parse_cost(f"angle_rmse/0.1 deg{plus}2*stiffness_rmse/50 N*cm/rad{plus}1e+1 * coupling / 1e+3 deg")
    assert [term.metric for term in cost.terms] == ["angle_rmse", "stiffness_rmse", "coupling"]
    assert [term.weight for term in cost.terms] == [1.0, 2.0, 10.0]
    np.testing.assert_allclose([term.scale for term in cost.terms], [0.1 * deg, 0.5, 1000 * deg], rtol=1e-15)
    assert cost.metrics == ("angle_rmse", "stiffness_rmse", "coupling")


def test_a_metric_alone_needs_no_scale():
    assert parse_cost(" angle_rmse ") == Cost((Term("angle_rmse", 1.0),))
    assert parse_cost("3*force_max").terms == (Term("force_max", 1.0, 3.0),)


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("", "not a term"),
        ("angle_rms/1 deg", "did you mean 'angle_rmse'"),
        ("angle_rmse/1 N", "does not have the dimensions of 'rad'"),
        ("angle_rmse/1 deg + angle_rmse/2 deg", "angle_rmse appears twice"),
        ("angle_rmse + stiffness_rmse/1 N*m/rad", "angle_rmse has no scale.*write it like angle_rmse/0.1 deg"),
        ("angle_rmse/-1 deg", "scale is -0.01"),
        ("0*angle_rmse", "weight is 0"),
        ("angle_rmse - coupling", "not a term"),
    ],
)
def test_what_is_wrong_is_named(text, named):
    with pytest.raises((ParameterError, RangeError), match=named):
        parse_cost(text)


# What numbers cost ----------------------------------------------------------------------------------------------------

EXAMPLE = (Path(__file__).parents[2] / "examples" / "pre-contracted-step-pid.yaml").read_text(encoding="utf-8")
TEXT = EXAMPLE
for old, new in (
    ("duration: 10 s", "duration: 100 ms"),
    ("control_period: 1 ms", "control_period: 2 ms"),
    ("at: 5 s", "at: 50 ms"),
    ("0.5 Hz", "3 Hz"),
):
    assert old in TEXT
    TEXT = TEXT.replace(old, new)
LIGHT = Scenario.parse(TEXT.replace("accuracy: 1e-6 rad ", "substeps: 4 "))  # the same in tuning and in single runs
HEAVY = with_values(LIGHT, {"load.mass2": 0.8, "controller.position.kp": 7 * bar})
RANGES = {
    "controller.position.kp": LogUniform(0.1 * bar, 40 * bar),
    "controller.stiffness.ki": LogUniform(0.05 * bar, 500 * bar),
    "load.damping": Uniform(0.0, 0.5),
    "joint.geometry.connector_length": Uniform(200 * mm, 212 * mm),  # in the plant, and in the controller's model
    "start.stiffness": Uniform(11.5, 14.0),
}
GAINS = np.array([True, True, False, False, False])
ROWS = np.array(
    [
        [2 * bar, 5 * bar, 0.015, 0.208, 12.0],
        [20 * bar, 200 * bar, 0.4, 0.207, 12.5],  # the gains that the margin makes worse
        [0.3 * bar, 1 * bar, 0.1, 0.21, 13.5],
    ]
)
TERMS = (
    Term("angle_rmse", 0.1 * deg),
    Term("stiffness_rmse", 0.2, 3.0),
    Term("angle_max", 1 * deg),
    Term("stiffness_max", 1.0),
    Term("force_max", 50.0),
)
SCALES = {"angle_rmse": 0.1 * deg, "stiffness_rmse": 0.2 / 3, "angle_max": deg, "stiffness_max": 1.0, "force_max": 50.0}
"""Another way to say it."""


free = functools.partial(Cost, disk_margin=0.0)


def asked(cost, scenarios=(LIGHT, HEAVY)):
    return TuningProblem.of(scenarios, sweep_parameters(LIGHT, RANGES), cost, model_follows="all")


@pytest.fixture(scope="module")
def by_hand():
    """Sums of metrics of single runs, of shape (plain or raised, scenario, row), for a margin of 1.5."""

    def one(scenario, row):
        metrics = run_scenario(with_values(scenario, dict(zip(RANGES, row, strict=True)))).metrics
        return sum(metrics[name] / scale for name, scale in SCALES.items())

    raised = np.where(GAINS, 1.5 * ROWS, ROWS)
    return np.array([[[one(s, row) for row in rows] for s in (LIGHT, HEAVY)] for rows in (ROWS, raised)])


@pytest.mark.slow
def test_the_cost_is_that_of_single_runs(by_hand):
    for margin in (1.0, 1.5):
        sums = by_hand if margin == 1.5 else by_hand[:1]
        for percentile, together in ((None, np.mean), (100.0, np.max)):
            expected = np.max(together(sums, axis=1), axis=0)
            cost = free(TERMS, gain_margin=margin, percentile=percentile)
            rows = ROWS if margin > 1 else np.tile(ROWS, (2, 1))  # as many runs: one program less
            np.testing.assert_allclose(asked(cost).costs(rows)[:3], expected, rtol=1e-9)
    plain, raised = by_hand.mean(axis=1)
    assert (raised > plain).any()  # else the margin would not have been seen
    assert (raised < plain).any()


@pytest.mark.slow
def test_travel_beyond_that_of_ideal_sensors_costs():
    noisy = Scenario.parse(TEXT.replace("controller:", "sensors: {pressure_noise: 40 kPa}\ncontroller:", 1))
    name, gains = "controller.stiffness.kp", np.array([[0.001 * bar], [2 * bar]])
    task = TuningProblem.of((noisy,), sweep_parameters(noisy, {name: Uniform(0.0005 * bar, 4 * bar)}), free(TERMS))
    task = replace(task, scenarios=(noisy.model_copy(update={"substeps": 4}),))
    costs = task.costs(gains)
    for (gain,), cost, costly in zip(gains, costs, (False, True), strict=True):
        own, ideal = (
            run_scenario(with_values(task.scenarios[0], {name: gain, "sensors.pressure_noise": size})).metrics
            for size in (40e3, 0.0)
        )
        excess = sum(max(own[use] / (most * ideal[use]) - 1, 0) for use, most in USE.items())
        assert (excess > 1) is costly and (excess == 0) is not costly
        plain = sum(own[metric] / scale for metric, scale in SCALES.items())
        if costly:
            assert cost > 10 * plain
        else:
            assert cost == pytest.approx(plain, rel=1e-9)


def disk(scenario):
    plant, settings = scenario.plant(), {"duration": 0.1, "control_period": 2e-3, "points": 4}
    return margins(plant, scenario.control(), scenario.reference(), scenario.initial(plant), **settings).disk.min()


@pytest.mark.slow
def test_parameters_without_the_disk_margin_cost_more_the_less_they_have():
    name, rows, masses = "controller.position.kp", np.array([[2 * bar], [6 * bar], [12 * bar]]), np.array([0.4, 0.9])

    def margin(gain, mass):
        return disk(with_values(LIGHT.with_fixed_model(), {name: gain, "load.mass2": mass}))

    def costs(cost, **conditions):
        return TuningProblem.of((LIGHT,), sweep_parameters(LIGHT, {name: RANGES[name]}), cost, (), conditions).costs(
            rows
        )

    least = np.array([min(margin(float(gain), mass) for mass in masses) for (gain,) in rows])
    assert least[0] > least[1] > 0
    wanted = (least[0] + least[1]) / 2
    found = costs(Cost(TERMS, disk_margin=wanted), **{"load.mass2": masses})
    assert found[0] == costs(free(TERMS), **{"load.mass2": masses})[0] < UNSTABLE_COST
    np.testing.assert_allclose(found[1:], UNSTABLE_COST * (2 - least[1:] / wanted), rtol=0.02)


def extremes_of(scenario):
    """Least disk margin under the extremes of strength, delay and mass, by single runs."""
    table = extremes(uncertainty(scenario))
    draws = [dict(zip(table, row, strict=True)) for row in np.stack(list(table.values()), axis=1).tolist()]
    return min(disk(with_values(scenario.with_fixed_model(), draw)) for draw in draws)


@pytest.mark.slow
def test_a_search_keeps_the_least_disk_margin_for_the_uncertainty_of_the_plant():
    name, few = "controller.position.kp", {"iterations": 2, "population": 8}
    at_the_edge = with_values(LIGHT, {name: 6 * bar})
    risky, kept = (tune(at_the_edge, {name: RANGES[name]}, cost, **few) for cost in (free(TERMS), Cost(TERMS)))
    assert extremes_of(risky.scenarios[0]) < LEAST_DISK_MARGIN <= extremes_of(kept.scenarios[0])
    assert risky.cost < kept.cost and (risky.disk_margin, kept.disk_margin) == (0.0, LEAST_DISK_MARGIN)
    assert kept.limit in kept.verdict() and f"{kept.least_disk:.3g}" in kept.verdict()
    scalars, _, effect = kept.listings()  # two margins of two plants, each with its own name
    nominal = dict(zip(*(effect.columns[name][1] for name in ("metric", "tuned")), strict=True))["least disk margin"]
    assert "nominal plant" in effect.title and nominal > kept.least_disk
    assert "least disk margin" not in [title for title, _ in scalars.header()]
    assert LEAST_DISK_MARGIN <= kept.least_disk <= extremes_of(kept.scenarios[0]) * 1.01 and kept.ok
    start = TuningProblem.of(
        (LIGHT,), sweep_parameters(LIGHT, {"start.stiffness": RANGES["start.stiffness"]}), Cost(TERMS)
    )
    assert start.disk_margin == 0.0  # no gain is tuned


@pytest.mark.slow
def test_where_no_gains_have_the_margin_the_best_are_returned_with_what_limits_them():
    name = "controller.position.kp"
    tuned = tune(LIGHT, {name: Uniform(6 * bar, 9 * bar)}, Cost(TERMS, disk_margin=0.5), iterations=2, population=8)
    (remark,) = [remark for remark in tuned.remarks() if remark.severity is Severity.SEVERE]
    assert not tuned.ok and remark.field == "disk_margin" and tuned.limit in remark.text
    assert tuned.values[name] < 6.5 * bar  # the largest margin
    assert tuned.least_disk == pytest.approx(extremes_of(tuned.scenarios[0]), rel=0.1) and tuned.least_disk < 0.5
    assert all(word in tuned.limit for word in (" s in the loop of the angle at ", "Hz", "joint.muscle1.strength"))
    assert tuned.cost < UNSTABLE_COST and not tuned.keeps_margin
    assert any(name in tuned.change for name in (*extremes(uncertainty(LIGHT)), "valve.time_constant"))
    assert float(tuned.change.split()[-1]) > tuned.least_disk
    problem = TuningProblem.of((LIGHT,), sweep_parameters(LIGHT, {name: RANGES[name]}), Cost(TERMS))
    slow = replace(problem, scenarios=(with_values(LIGHT, {"valve.time_constant": 0.2}),))
    assert "valve.time_constant 100 ms" in slow.change_needed(np.array([1 * bar]))


@pytest.mark.slow
def test_a_limit_cycle_is_a_failure():
    scenario = Scenario.parse(EXAMPLE.replace("duration: 10 s", "duration: 1 s").replace("at: 5 s", "at: 0.5 s"))
    name = "controller.position.kp"
    task = TuningProblem.of((scenario,), sweep_parameters(scenario, {name: RANGES[name]}), free(TERMS))
    costs = task.costs(np.array([[1 * bar], [40 * bar]]))
    assert run_scenario(with_values(scenario, {name: 40 * bar})).outcome is Outcome.LIMIT_CYCLE
    assert costs[0] < FAILED_COST == costs[1]
    few = {"iterations": 5, "population": 8}
    start = with_values(scenario, {name: 1 * bar})
    tuned = tune(start, {name: RANGES[name]}, free(TERMS, gain_margin=40.0), **few)
    assert np.isnan(tuned.cost_before)
    assert "nan" not in repr(tuned)


@pytest.mark.slow
@pytest.mark.parametrize(("percentile", "together"), [(None, np.mean), (50.0, np.median), (100.0, np.max)])
def test_conditions_count_as_scenarios_do(percentile, together):
    masses = np.array([0.3, 0.6, 0.9])
    each = [asked(free(TERMS), (with_values(LIGHT, {"load.mass2": mass}),)) for mass in masses]
    single = np.stack([one.costs(np.tile(ROWS, (2, 1)))[:3] for one in each])
    cost, swept = free(TERMS, percentile=percentile), sweep_parameters(LIGHT, RANGES)
    task = TuningProblem.of((LIGHT,), swept, cost, "all", {"load.mass2": masses})
    np.testing.assert_allclose(task.costs(ROWS), together(single, axis=0), rtol=1e-9)


def test_a_tuned_parameter_is_no_condition():
    drawn = {"load.damping": np.array([0.01, 0.02])}
    with pytest.raises(ParameterError) as caught:
        TuningProblem.of((LIGHT,), sweep_parameters(LIGHT, RANGES), free(TERMS), (), drawn)
    assert caught.value.value == "load.damping"


def test_texts_are_read_and_conditions_that_cannot_run_are_refused_before_the_search():
    for cost in ("angle_rmse/1 deg", parse_cost("angle_rmse/1 deg")):
        with pytest.raises(SimulationError) as caught:
            tune(
                LIGHT, ["controller.position.kp=1..5 bar/rad"], cost,
                conditions={"reference.angle.frequency": np.array([1.0, 600.0])},
            )  # fmt: skip
        assert caught.value.upper == 250
    with pytest.raises(ParameterError):
        tune(LIGHT, ["controller.position.kpp=1..2"], "angle_rmse/1 deg")


@pytest.mark.slow
def test_what_is_not_allowed_or_cannot_start_costs_most_and_leaves_its_neighbours_alone():
    task = TuningProblem.of(
        (LIGHT,),
        sweep_parameters(LIGHT, RANGES | {"joint.geometry.connector_length": Uniform(0.2, 0.39)}),
        free(TERMS),
        "all",
    )
    rows = ROWS.copy()
    rows[1, 3] = 0.38  # no allowed one
    rows[2, 4] = 60.0  # no pressures hold it
    expected = asked(free(TERMS), (LIGHT,)).costs(np.tile(ROWS, (2, 1)))
    assert task.costs(np.tile(rows, (2, 1)))[:3].tolist() == [expected[0], FAILED_COST, FAILED_COST]


@pytest.mark.slow
@pytest.mark.parametrize("percentile", [None, 100.0])
def test_one_failed_scenario_is_enough_also_for_the_mean(percentile):
    lifted = with_values(LIGHT, {"start.angle": 20 * deg})  # where not every one of the stiffnesses can be held
    costs = asked(free(TERMS, percentile=percentile), (LIGHT, lifted)).costs(np.tile(ROWS, (2, 1)))[:3]
    assert costs[:2].tolist() == [FAILED_COST, FAILED_COST]
    assert costs[2] < FAILED_COST


def test_a_number_that_one_scenario_lacks_is_said_with_the_scenario():
    ideal = Scenario.parse(TEXT.replace("valve: {time_constant: 20 ms}", "valve: ideal").replace("name: ", "name: my "))
    ranges = sweep_parameters(LIGHT, {"valve.time_constant": Uniform(0.01, 0.05)})
    with pytest.raises(ParameterError, match=r"my pre-contracted.*valve, of class ideal"):
        TuningProblem.of((LIGHT, ideal), ranges, free(TERMS))
