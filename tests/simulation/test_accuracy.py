"""Integration steps by step doubling: the estimated error is the true one, chaos is found, batches choose alike."""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import mckibben as mk
from mckibben.errors import McKibbenWarning, SimulationError
from mckibben.plant import TorquePulses
from mckibben.simulation.accuracy import BLOCK, Refinement, probed_runs, refine, refine_blocks, resolution_of
from mckibben.units import bar, deg, mm

PRINTED = mk.catalog.joint("knee-table-2")
KNEE = mk.AntagonisticJoint(
    mk.KneeGeometry(PRINTED.geometry.joint_length, PRINTED.geometry.joint_radius, 208 * mm),
    PRINTED.muscle1,
    PRINTED.muscle2,
)
PLANT = mk.JointPlant(KNEE, mk.catalog.load("knee-table-2"), mk.FirstOrderValve(0.02))
CONTROL = mk.PositionStiffnessControl(
    mk.PID(2 * bar, 60 * bar, 0.4 * bar), mk.PID(0.08 * bar, 5 * bar, 0.0), model=KNEE
)
START = PLANT.equilibrium(0.0, stiffness=12.0)
SMOOTH = mk.Reference(mk.Sine(10 * deg, 0.5), 15.0)
RUN = {"duration": 0.5, "initial": START}


def slack(amplitude, frequency, low, high):
    """A reference that slackens the muscles, so that the angle has kinks in its acceleration."""
    return mk.Reference(mk.Sine(amplitude * deg, frequency), mk.Step(low, high, 5.0))


def angle_error(result, *, reference, **options):
    fine = mk.simulate(PLANT, CONTROL, reference, initial=START, substeps=256, **options)
    return np.abs(result["angle"] - fine["angle"]).max()


def test_a_smooth_run_needs_one_step_and_says_how_far_it_is_from_two():
    run = mk.simulate(PLANT, CONTROL, SMOOTH, **RUN)
    assert run.resolution.resolved and run.resolution.substeps == 1 and 0 < run.resolution.error < 1e-10
    assert angle_error(run, reference=SMOOTH, duration=0.5) == pytest.approx(run.resolution.error, rel=0.1)


@pytest.mark.slow
def test_steps_of_one_evaluation_converge_to_those_of_runge_kutta():
    disturbed = dataclasses.replace(PLANT, disturbance=TorquePulses(0.0))  # by nothing, but integrated by RK4
    fine = mk.simulate(disturbed, CONTROL, SMOOTH, substeps=16, **RUN)["angle"]
    errors = [np.abs(mk.simulate(PLANT, CONTROL, SMOOTH, substeps=n, **RUN)["angle"] - fine).max() for n in (1, 2)]
    assert errors[0] < 1e-10 and errors[1] < errors[0] / 7


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::mckibben.errors.ReachabilityWarning")
@pytest.mark.parametrize("case", [(15, 1.0, 6.0, 20.0), (25, 1.0, 5.0, 22.0), (18, 1.3, 7.0, 18.0)])
@pytest.mark.parametrize("accuracy", [1e-5, 1e-6])
def test_the_estimated_error_is_at_least_half_the_true_one_where_muscles_are_slack(case, accuracy):
    reference = slack(*case)
    run = mk.simulate(PLANT, CONTROL, reference, initial=START, duration=3.0, accuracy=accuracy)
    assert run["slack"].any() and run.resolution.resolved
    assert angle_error(run, reference=reference, duration=3.0) < 2 * run.resolution.error


@pytest.mark.filterwarnings("ignore::mckibben.errors.ReachabilityWarning")
@pytest.mark.slow
def test_the_estimated_error_is_that_from_scipy():
    """A joint that swings at constant pressures, so that its muscles go slack in turn."""
    plant, pressures = mk.JointPlant(KNEE, PLANT.load, mk.IdealValve()), (0.3 * bar, 0.3 * bar)
    start = plant.init_state(25 * deg, pressures)
    control = mk.OpenLoopControl(*pressures, model=KNEE)
    run = mk.simulate(plant, control, mk.Reference(0.0, 3.0), initial=start, duration=1.0, control_period=0.01)
    assert run["slack"].any()

    @jax.jit
    def rate(_, motion):
        state = start._replace(position=motion[0], velocity=motion[1])
        return jnp.stack(plant.rate(state)[:2])

    exact = solve_ivp(
        rate, (0.0, 0.99), (25 * deg, 0.0), method="RK45", t_eval=run.times, rtol=1e-11, atol=1e-12, max_step=1e-3
    )
    assert 0.5 < np.abs(run["angle"] - exact.y[0]).max() / run.resolution.error < 2


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::mckibben.errors.ReachabilityWarning")
def test_a_run_that_is_not_resolved_is_reported_with_the_time_from_which_solutions_separate():
    reference = slack(25, 2.0, 3.0, 25.0)
    with pytest.warns(McKibbenWarning, match="not resolved"):
        run = mk.simulate(PLANT, CONTROL, reference, initial=START)
    assert not run.resolution.resolved and run.resolution.error > 1e-6
    twice = mk.simulate(PLANT, CONTROL, reference, initial=START, substeps=2 * run.resolution.substeps)
    apart = np.abs(twice["angle"] - run["angle"]) > 1e-6
    assert run.times[apart.argmax()] == pytest.approx(run.resolution.unresolved_from)


@pytest.mark.slow
def test_friction_and_a_finer_accuracy_need_more_steps():
    plant = dataclasses.replace(PLANT, friction=mk.JointFriction(0.3, 1 * deg))
    runs = [mk.simulate(plant, CONTROL, SMOOTH, accuracy=accuracy, **RUN).resolution for accuracy in (1e-6, 1e-8)]
    assert runs[0].substeps < runs[1].substeps and runs[1].error <= 1e-8


@pytest.mark.parametrize(
    ("run", "lowest"),
    [(mk.simulate, 1e-12), (mk.simulate_many, 1e-12), (functools.partial(mk.simulate_many, precision=32), 1e-6)],
)
def test_an_accuracy_below_rounding_is_refused_with_the_one_that_can_be_reached(run, lowest):
    with pytest.raises(SimulationError) as caught:
        run(PLANT, CONTROL, SMOOTH, accuracy=0.5 * lowest, **RUN)
    assert (caught.value.field, caught.value.lower, caught.value.unit) == ("accuracy", lowest, "rad")


@pytest.mark.parametrize("accuracy", [0.0, -1e-6, np.nan, np.inf, "fine", True])
def test_an_accuracy_is_a_positive_angle(accuracy):
    with pytest.raises(SimulationError) as caught:
        mk.simulate(PLANT, CONTROL, SMOOTH, accuracy=accuracy, **RUN)
    assert caught.value.field == "accuracy"


def test_an_accuracy_between_rounding_and_the_finest_steps_is_refused_with_the_one_that_can_be_reached():
    plant = dataclasses.replace(PLANT, friction=mk.JointFriction(0.3, 1 * deg))
    with pytest.raises(SimulationError) as caught:
        mk.simulate(plant, CONTROL, SMOOTH, accuracy=1e-12, **RUN)
    lowest = caught.value.lower
    assert caught.value.field == "accuracy" and 1e-12 < lowest < 1e-7
    assert mk.simulate(plant, CONTROL, SMOOTH, accuracy=lowest, **RUN).resolution.error <= lowest


def test_the_resolution_is_kept_in_a_file(tmp_path):
    run = mk.simulate(PLANT, CONTROL, SMOOTH, **RUN)
    run.to_netcdf(tmp_path / "run.nc")
    again = mk.SimulationResult.from_netcdf(tmp_path / "run.nc").resolution
    assert again[:2] == run.resolution[:2] and again.resolved


MANY = {"load.mass2": np.linspace(0.3, 0.7, 40)}


@pytest.mark.slow
def test_a_batch_has_the_steps_and_the_error_that_its_extreme_runs_need():
    batch = mk.simulate_many(PLANT, CONTROL, SMOOTH, over=MANY, metrics=["angle_rmse"], keep=["angle"], **RUN)
    assert np.all(batch["substeps"] == 1) and np.all(batch["error_estimate"] < 1e-10) and not batch.chaotic.any()
    fine = mk.simulate_many(
        PLANT, CONTROL, SMOOTH, over=MANY, metrics=["angle_rmse"], keep=["angle"], substeps=8, **RUN
    )
    assert np.abs(batch["angle"] - fine["angle"]).max() <= 2 * batch["error_estimate"].max()
    assert np.isnan(fine["error_estimate"]).all() and np.all(fine["substeps"] == 8)


@pytest.mark.slow
def test_blocks_of_a_batch_choose_for_themselves():
    strengths = np.where(np.arange(2 * BLOCK) < BLOCK, 1e-3, 0.5)  # of the friction, N*m
    plant = dataclasses.replace(PLANT, friction=mk.JointFriction(0.1, 1 * deg))
    given = {"metrics": ["angle_rmse"], "duration": 0.1, "initial": START, "accuracy": 1e-8}
    whole = mk.simulate_many(plant, CONTROL, SMOOTH, over={"friction.torque": strengths}, **given)
    first, second = whole["substeps"][:BLOCK], whole["substeps"][BLOCK:]
    assert np.ptp(first) == np.ptp(second) == 0 and first[0] < second[0]
    alone = mk.simulate_many(plant, CONTROL, SMOOTH, over={"friction.torque": strengths[BLOCK:]}, **given)
    assert np.array_equal(alone["angle_rmse"], whole["angle_rmse"][BLOCK:])


def test_probed_runs_are_extreme_or_random_and_all_of_a_small_block():
    values = np.random.default_rng(1).random((3, 500))
    found = probed_runs(tuple(values))
    extremes = {0, *values.argmin(axis=1), *values.argmax(axis=1)}
    assert extremes <= set(found.tolist()) and len(found) <= 4 + len(extremes)
    assert np.array_equal(found, probed_runs(tuple(values)))
    assert np.array_equal(probed_runs((values[0, :20],)), np.arange(20))
    assert len(probed_runs(tuple(np.random.default_rng(2).random((50, 500))))) <= 33


def exponential(substeps, runs):
    """Solutions whose error falls with the fourth power of the steps, faster for the first run; 10 s apart."""
    size = np.array([1e-6, 1e-3, np.nan])[runs]
    error = np.where(np.isnan(size), (-1.0) ** round(np.log2(substeps)), size / substeps**4)
    return (error * np.array([0.0, 0.5, 1.0])[:, None])[None]


def test_doubling_stops_for_each_run_when_it_agrees():
    found = refine(exponential, 3, accuracy=1e-6, spacing=10.0)
    assert found.substeps[:2].tolist() == [1, 8] and np.all(found.error[:2] <= 1e-6)
    assert np.isnan(found.unresolved_from[:2]).all()
    assert found.unresolved_from[2] == 10.0 and not found.converges[2] and found.converges[:2].all()


def test_a_run_counts_until_it_diverges_if_all_solutions_diverge_alike():
    """The plant of the first run diverges; the second one does so with fewer than 16 steps, the third one with all."""

    def diverging(substeps, runs):
        blown = np.array([0.0, 10.0**substeps, np.inf])
        each = [np.array([0.0, 2.0 + 1e-5 / substeps, np.inf]), np.zeros(3) if substeps >= 16 else blown, blown]
        return np.stack(each, axis=-1)[None][..., runs]

    found = refine(diverging, 3, accuracy=1e-6, spacing=1.0, meaningful=lambda x, _: np.abs(x[0]) < 1.0)
    assert found.substeps.tolist() == [1, 16, 64] and found.error.tolist() == [0.0, 0.0, np.inf]
    assert found.resolved.tolist() == [True, True, False] and found.unresolved_from[2] == 1.0
    assert "too long" in resolution_of(Refinement(*(one[..., 2:] for one in found[:5]), 1), 1e-6).describe()
    steps = refine_blocks({"x": np.arange(3.0)}, 3, lambda runs: found)
    assert steps.error.tolist() == [0.0, 0.0, np.inf] and not steps.chaotic.any()
    with pytest.warns(McKibbenWarning, match="1 runs"):
        steps.warn_of(1e-6)


def test_runs_that_converge_slowly_decide_the_steps_of_their_block():
    """The second run needs more than 64 steps: it gets the most, not as few as the first."""
    errors = np.array([[1e-9, np.nan, np.nan, np.nan, np.nan, np.nan], [1e-1, 3e-2, 1e-2, 3e-3, 1e-3, 3e-4]]).T
    unresolved, converges = np.array([np.nan, 0.5]), np.array([True, True])
    refined = Refinement(np.array([1, 32]), np.array([1e-9, 3e-4]), unresolved, converges, errors, 1)
    steps = refine_blocks({"x": np.arange(2.0)}, 2, lambda runs: refined)
    assert steps.substeps.tolist() == [32, 32] and steps.error.max() == 3e-4
    with pytest.warns(McKibbenWarning):
        steps.warn_of(1e-6)
