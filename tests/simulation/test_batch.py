# ruff: noqa: E501 - tables of cases
"""Many runs at once are the single runs: every metric, every outcome, whatever differs and however they are chunked."""

import dataclasses
import functools
import math
import warnings

import equinox as eqx
import jax
import numpy as np
import pytest

from mckibben.actuator import FirstOrderValve, IdealValve
from mckibben.control import PID, BackpropPID, Multisine, PositionStiffnessControl, Reference, Samples, Sine, Step
from mckibben.errors import ParameterError, RangeError, ReachabilityWarning, SimulationError, UnreachableError
from mckibben.joint import AntagonisticJoint, SeriesSpring
from mckibben.muscle import ChouLaw, Muscle
from mckibben.plant import JointPlant, PlantState
from mckibben.simulation import AtRest, Metrics, Outcome, simulate, simulate_many
from mckibben.simulation.trajectories import column_names
from mckibben.units import bar, deg, mm

SHORT = {"duration": 0.1, "substeps": 2}
PERIODS = 100
REFERENCE = Reference(angle=Sine(5 * deg, 2.0), stiffness=Step(13.0, 15.0, 0.05))


def control_of(model) -> PositionStiffnessControl:
    return PositionStiffnessControl(PID(2 * bar, 60 * bar, 0.4 * bar), PID(0.08 * bar, 5 * bar, 0.0), model=model)


@pytest.fixture(scope="module")
def parts(knee, load):
    """Plant and controller in plain numbers, as a user has them."""
    return JointPlant(knee, load, FirstOrderValve(0.02)), control_of(knee)


def put(tree, name: str, value):
    """The tree with another value at a dotted name, by hand."""

    def at(node):
        for step in name.split("."):
            node = node[int(step)] if step.isdigit() else getattr(node, step)
        return node

    return eqx.tree_at(at, tree, value)


def lane_of(whole, names, values):
    """Plant, controller and reference of one lane."""
    trees = dict(zip(("plant", "controller", "reference"), whole, strict=True))
    for name, value in zip(names, values, strict=True):
        root, rest = name.split(".", 1) if name.split(".")[0] in trees else ("plant", name)
        trees[root] = put(trees[root], rest, value)
    return trees.values()


def single(*given, **options):
    """The single run; None where it says that there is no start."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ReachabilityWarning)
        try:
            return simulate(*given, **options)
        except (UnreachableError, RangeError):
            return None


SCALES = {"angle": 0.1, "coupling": 0.1, "stiffness": 10.0, "estimate": 10.0, "force": 100.0}
"""What matters, in SI: a metric that is 0 is compared to a part of it."""


def assert_singles(batch, results, runs=slice(None), *, rtol: float = 1e-12) -> None:
    """Metrics and outcomes of runs are those of the single ones; None stands for one that refused to start."""
    ended = [Outcome.NO_START if result is None else result.outcome for result in results]
    assert np.array(batch.outcomes)[runs].tolist() == ended
    unknown = dict.fromkeys(Metrics._fields, math.nan)
    expected = [unknown if result is None else result.metrics for result in results]
    for name, found in batch.metrics.items():
        atol = rtol * SCALES.get(name.split("_")[0], 0.1)
        np.testing.assert_allclose(found[runs], [one[name] for one in expected], rtol, atol, err_msg=name)


# Every number below differs in some run; the first run is the nominal one.
NOMINAL = {
    "load.mass1": 0.5,
    "load.mass2": 0.5,
    "load.inertia": 0.02,
    "load.damping": 0.015,
    "load.hanging_angle": math.pi / 6,
    "valve.time_constant": 0.02,
    "joint.geometry.joint_radius": 0.03,
    "joint.geometry.connector_length": 0.208,
    "joint.muscle1.law.a1": -245.8,
    "joint.muscle2.law.c2": -13.18e-5,
    "joint.muscle1.law.decay": 30.0,
    "joint.muscle2.specimen.initial_length": 0.18,
    "joint.muscle1.specimen.rated_force": 630.0,
    "controller.position.kp": 2 * bar,
    "controller.position.ki": 60 * bar,
    "controller.position.kd": 0.4 * bar,
    "controller.position.filter_time": 0.005,
    "controller.stiffness.kp": 0.08 * bar,
    "controller.stiffness.ki": 5 * bar,
    "controller.model.geometry.joint_radius": 0.03,
    "reference.angle.amplitude": 5 * deg,
    "reference.angle.frequency": 2.0,
    "reference.angle.offset": 0.0,
    "reference.stiffness.before": 13.0,
    "reference.stiffness.after": 15.0,
    "reference.stiffness.at": 0.05,
}
AT_REST = {"angle": math.nan, "stiffness": math.nan}
SPECIAL = {
    "starts at another angle": {"angle": 3 * deg},
    "starts at another stiffness": {"stiffness": 14.0},
    "starts elsewhere": {"angle": -2 * deg, "stiffness": 12.5},
    "step before the run": {"reference.stiffness.at": 0.0},
    "step in the second period": {"reference.stiffness.at": 0.001},
    "step early": {"reference.stiffness.at": 0.0105},
    "step late": {"reference.stiffness.at": 0.0801},
    "step in the last but one": {"reference.stiffness.at": 0.0979},
    "step in the last period": {"reference.stiffness.at": 0.0985},
    "step after the run": {"reference.stiffness.at": 7.0},
    "step down": {"reference.stiffness.before": 16.0, "reference.stiffness.after": 13.0},
    "constant": {"reference.stiffness.after": 13.0},
    "step too small for 32 bits": {"reference.stiffness.after": 13.0 + 1e-7},
    "saturated": {"controller.position.kp": 40 * bar, "reference.angle.offset": 15 * deg, "angle": 0.0},
    "overloaded": {"joint.muscle1.specimen.rated_force": 60.0, "reference.stiffness.before": 25.0, "reference.stiffness.after": 30.0},
    "swung over": {"reference.angle.offset": 2.0, "angle": 0.0},
    "diverged": {"load.damping": 5000.0},
    "too heavy": {"load.mass2": 50.0},
    "too stiff a start": {"stiffness": 500.0},
    "stretched": {"joint.geometry.connector_length": 0.15},
}  # fmt: skip


def varied() -> list[dict[str, float]]:
    """Runs: the nominal one, one for each number alone, and the special ones."""
    rows = [{}] + [{name: value * 1.01 if value else 1 * deg} for name, value in NOMINAL.items()]
    return [NOMINAL | AT_REST | row for row in (*rows, *SPECIAL.values())]


ROWS = varied()


def special(name: str) -> int:
    return 1 + len(NOMINAL) + list(SPECIAL).index(name)


def columns(rows, names) -> dict[str, np.ndarray]:
    return {name: np.array([row[name] for row in rows]) for name in names}


@pytest.fixture(scope="module")
def everything(parts):
    """A batch in which every number differs, with some of its trajectories."""
    return simulate_many(
        *parts,
        REFERENCE,
        over=columns(ROWS, NOMINAL),
        initial=AtRest(**columns(ROWS, AT_REST)),
        metrics=Metrics._fields,
        keep=column_names(()),
        chunk=16,
        **SHORT,
    )


@pytest.fixture(scope="module")
def alone(parts):
    """The single run of each row."""

    @functools.cache
    def run(row: int):
        values = ROWS[row]
        of = lane_of((*parts, REFERENCE), NOMINAL, [values[name] for name in NOMINAL])
        return single(*of, initial=AtRest(values["angle"], values["stiffness"]), **SHORT)

    return run


@pytest.mark.slow
def test_each_run_of_a_batch_is_the_single_run(everything, alone):
    tame = [row for row in range(len(ROWS)) if row != special("diverged")]
    assert_singles(everything, [alone(row) for row in tame], tame, rtol=1e-11)
    with pytest.raises(SimulationError) as caught:
        alone(special("diverged"))
    assert caught.value.field == "substeps"
    assert everything.outcomes[special("diverged")] is Outcome.DIVERGED
    assert not np.isfinite(everything.metrics["angle_max"][special("diverged")])


@pytest.mark.slow
def test_the_runs_ended_in_many_ways(everything):
    """In a tenth of a second a PID of this joint does not follow 2 Hz."""
    ended = {name: everything.outcomes[special(name)] for name in SPECIAL}
    assert ended["diverged"] is Outcome.DIVERGED
    assert ended["swung over"] is Outcome.SWUNG_OVER
    assert everything.metrics["time_overloaded"][special("overloaded")] > 0
    assert {ended[n] for n in ("too heavy", "too stiff a start", "stretched")} == {Outcome.NO_START}
    assert everything.outcomes[0] is ended["saturated"] is ended["overloaded"] is Outcome.NOT_FOLLOWED
    assert everything.failed.tolist() == [outcome.failed for outcome in everything.outcomes]
    assert everything.count == len(ROWS)
    assert np.nanmax(everything.metrics["time_saturated"]) > 0


@pytest.mark.slow
def test_coupling_is_known_where_the_stiffness_changes_and_stops(everything):
    coupling = everything.metrics["coupling"]
    for name in ("step before the run", "step in the last period", "step after the run", "constant"):
        assert np.isnan(coupling[special(name)]), name
    for name in ("step in the second period", "step early", "step late", "step down"):
        assert coupling[special(name)] > 0, name


@pytest.mark.slow
def test_what_is_kept_are_columns_of_the_single_run(everything, alone):
    np.testing.assert_allclose(everything.table["time"], np.arange(PERIODS) * 1e-3, rtol=1e-15)
    for row in (0, 3, special("step early"), special("step late"), special("saturated")):
        for name in column_names(()):
            kept = everything.table[name].to_numpy()[row]
            column = alone(row).columns[name]
            np.testing.assert_allclose(kept, column, rtol=1e-10, atol=1e-11 * np.abs(column).max(), err_msg=name)
    assert everything.table["saturated"].dtype == bool
    assert everything.table["angle"].attrs["units"] == "rad"


@pytest.mark.slow
def test_the_table_names_the_values_and_the_outcomes(everything):
    masses = everything.table["load.mass2"].to_numpy()
    np.testing.assert_array_equal(masses, [row["load.mass2"] for row in ROWS])
    assert everything.table["outcome"].attrs["flag_meanings"].split() == [o.name for o in Outcome]
    assert everything.table["coupling"].attrs["units"] == "rad"


# Another structure: ideal valves, springs, Chou's law, learning loops, samples, several sines, given states.
SEEDS = np.array([0, 1, 2, 3, 2**31 - 1])
STATES = PlantState(
    np.linspace(-0.02, 0.02, 5), np.array([0.0, 0.1, -0.1, 0.0, 0.2]), (2.2e5, np.linspace(2e5, 3e5, 5))
)
TIMES = np.linspace(0.0, 0.099, 4)
KNOTS = np.array(  # constant; rises, then rests; changes to the end; falls; changes first of all
    [[14, 14, 14, 14], [13, 13, 15, 15], [13, 13.5, 14, 14.5], [15, 14, 14, 14], [13, 14, 14, 14.0]]
)


def learning(base: PID, scales, *, seed) -> BackpropPID:
    signal, error, output = scales
    return BackpropPID(
        base, signal_scale=signal, error_scale=error, output_scale=output, gain_ratio=2.0, learning_rate=3.0, seed=seed
    )


def learner(model, seed) -> PositionStiffnessControl:
    return PositionStiffnessControl(
        learning(PID(2 * bar, 60 * bar, 0.4 * bar), (10 * deg, 1 * deg, 10 * bar), seed=seed),
        learning(PID(0.08 * bar, 5 * bar, 0.0), (15.0, 1.0, 1 * bar), seed=1),
        model=model,
    )


def sampled_reference(knots) -> Reference:
    return Reference(angle=Multisine((3 * deg, 1 * deg), (2.0, 7.0), (0.0, 0.3)), stiffness=Samples(TIMES, knots))


@pytest.fixture(scope="module")
def springy(knee, load, specimen):
    muscle = Muscle(specimen, ChouLaw.of(specimen))
    joint = AntagonisticJoint(knee.geometry, muscle, muscle, SeriesSpring(20e3, 20.0, 18 * mm))
    return JointPlant(joint, load, IdealValve())


@pytest.mark.slow
def test_springs_samples_and_learning_loops_with_seeds_are_the_single_runs(springy, knee):
    gravity = np.array([9.81, 9.7, 9.9, 9.81, 3.7])
    plant = put(springy, "load.gravity", gravity)
    batch = simulate_many(plant, learner(knee, SEEDS), sampled_reference(KNOTS), initial=STATES, **SHORT)
    assert batch.count == 5
    assert len({*batch.metrics["angle_rmse"]}) == 5
    assert "coupling" not in batch.metrics  # it takes a second run
    alone = []
    for row in range(5):
        state = jax.tree.map(lambda x, row=row: x if np.ndim(x) == 0 else x[row], STATES)
        heavy = put(springy, "load.gravity", gravity[row])
        alone.append(
            single(heavy, learner(knee, int(SEEDS[row])), sampled_reference(KNOTS[row]), initial=state, **SHORT)
        )
    assert_singles(batch, alone, rtol=1e-10)


# Chunks


FEW = ("angle_rmse", "stiffness_rmse", "time_saturated")


@pytest.fixture(scope="module")
def masses(parts):
    """A batch over so many masses."""

    def run(count: int, **options):
        mass = np.linspace(0.3, 0.7, 300)[:count]
        return simulate_many(*parts, REFERENCE, over={"load.mass2": mass}, metrics=FEW, **SHORT, **options)

    return run


@pytest.fixture(scope="module")
def most(masses):
    return masses(300, chunk=16, workers=2)


def same_bits(few, many) -> None:
    for name in FEW:
        np.testing.assert_array_equal(few.metrics[name], many.metrics[name][: few.count], err_msg=name)


@pytest.mark.parametrize("count", [1, 2, 15, 16, 17])
@pytest.mark.parametrize("workers", [1, 3])
@pytest.mark.slow
def test_a_run_gives_the_same_bits_whatever_runs_beside_it(masses, most, count, workers):
    few = masses(count, chunk=16, workers=workers)
    assert few.count == count
    same_bits(few, most)


@pytest.mark.slow
def test_a_chunk_of_another_size_gives_the_same_to_rounding(masses, most, alone):
    few = masses(7, chunk=2, workers=2, keep=("angle",))
    for name in FEW:
        np.testing.assert_allclose(few.metrics[name], most.metrics[name][:7], rtol=1e-12, err_msg=name)
    assert few.table.sizes == {"run": 7, "time": PERIODS}
    error = few.table["angle"].to_numpy() - alone(0).columns["desired_angle"]
    np.testing.assert_allclose(np.sqrt(np.mean(error**2, axis=1)), few.metrics["angle_rmse"], rtol=1e-12)
    thin = masses(7, chunk=2, workers=2, keep=("angle",), every=10)
    np.testing.assert_allclose(thin.table["angle"], few.table["angle"][:, ::10], rtol=1e-12)
    np.testing.assert_allclose(thin.metrics["angle_rmse"], few.metrics["angle_rmse"], rtol=1e-12)


@pytest.mark.parametrize("chunk", [0, -1, 2.5, True])
def test_a_chunk_is_a_whole_number_of_runs(masses, chunk):
    with pytest.raises(SimulationError, match="runs per chunk"):
        masses(2, chunk=chunk)


@pytest.mark.slow
def test_arrays_in_place_of_numbers_are_the_same_as_values_by_name(parts, masses, most):
    plant, control = parts
    mass = np.linspace(0.3, 0.7, 300)[:16]
    plant = dataclasses.replace(plant, load=dataclasses.replace(plant.load, mass2=mass))
    batch = simulate_many(plant, control, REFERENCE, metrics=FEW, chunk=16, **SHORT)
    same_bits(batch, most)
    assert "load.mass2" not in batch.table


# Metrics and what is kept


@pytest.mark.parametrize(
    ("asked", "value"),
    [
        ({"metrics": ["rmse"]}, "rmse"),
        ({"metrics": "angle_rmse"}, "angle_rmse"),
        ({"keep": ["speed"]}, "speed"),
        ({"precision": 16}, 16),
        ({"every": 0}, 0),
        ({"every": 7}, 7),
        ({"duration": 0.1005}, 0.1005),
    ],
)
def test_what_makes_no_sense_is_refused(parts, asked, value):
    with pytest.raises(SimulationError) as caught:
        simulate_many(*parts, REFERENCE, over={"load.mass2": [0.4, 0.5]}, **(SHORT | asked))
    np.testing.assert_equal(caught.value.value, value)
    assert caught.value.remedy


# Errors


def refused(kind, message, parts, **options):
    with pytest.raises(kind, match=message):
        simulate_many(*parts, REFERENCE, **(SHORT | options))


def test_lengths_that_differ_are_named(parts):
    both = "mass2 has 2 values.*kp has 3|kp has 3 values.*mass2 has 2"
    refused(ParameterError, both, parts, over={"load.mass2": [0.4, 0.5], "controller.position.kp": [1.0, 2, 3]})
    start = AtRest(np.zeros(3))
    refused(ParameterError, r"initial\.angle has 3 .*mass2 has 2", parts, over={"load.mass2": [1, 2]}, initial=start)


@pytest.mark.parametrize(
    ("over", "message"),
    [
        ({"load.mass2": np.ones((2, 3))}, r"load.mass2 has the shape \(2, 3\); give a number"),
        ({"load.mass2": np.ones(0)}, "load.mass2 is empty"),
        ({}, "all runs are the same; give a NumPy array"),
        ({"load.mas2": [1.0]}, "no parameter 'load.mas2'; did you mean 'load.mass2'"),
        ({"load": [1.0]}, "no parameter 'load'"),
    ],
)
def test_values_that_no_run_can_take_are_named(parts, over, message):
    refused(ParameterError, message, parts, over=over)


def test_a_single_run_says_what_to_use_for_many(parts):
    plant, control = parts
    many = put(plant, "load.mass2", np.array([0.4, 0.5]))
    with pytest.raises(ParameterError, match=r"load.mass2: an array in place of a number; use `simulate_many`"):
        simulate(many, control, REFERENCE, **SHORT)
    with pytest.raises(ParameterError, match=r"initial\.stiffness: an array.*simulate_many"):
        simulate(plant, control, REFERENCE, initial=AtRest(0.0, np.array([13.0, 14.0])), **SHORT)
