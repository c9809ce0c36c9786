"""Commands optimised off line, against a convex problem and another optimiser."""

import numpy as np
import pytest
from scipy.optimize import lsq_linear, minimize

import mckibben as mk
from mckibben.actuator import FirstOrderValve
from mckibben.control import OpenLoopControl, Samples
from mckibben.errors import SimulationError
from mckibben.simulation import differentiate, optimal_commands
from mckibben.units import bar, deg, mm, ms

PERIOD = 5 * ms


def simulated(plant, reference, commands, start):
    """The run with the commands, by the ordinary simulation."""
    times = np.arange(len(commands)) * PERIOD
    signals = (Samples(times, column) for column in commands.T)
    control = OpenLoopControl(*signals, plant.joint)
    return mk.simulate(plant, control, reference, duration=len(commands) * PERIOD, control_period=PERIOD, initial=start)


@pytest.fixture(scope="module")
def linear(knee):
    """Stiffness of a joint at rest in its middle, which is linear in the pressures: equal pulleys, no gravity."""
    law = mk.ChouLaw.of(knee.muscle1.specimen)
    muscle = mk.Muscle(knee.muscle1.specimen, law)
    joint = mk.AntagonisticJoint(mk.PairedPaths(*[mk.Pulley(25 * mm, 160 * mm)] * 2), muscle, muscle)
    return mk.JointPlant(
        joint, mk.GeneralLoad(inertia=0.05, greatest_gravity_torque=0.0, damping=0.1), FirstOrderValve(50 * ms)
    )


@pytest.mark.slow
def test_the_optimum_of_a_linear_plant_is_that_of_least_squares_with_bounds(linear):
    lowest, highest = (float(linear.joint.stiffness(0.0, (p, p))) for p in (1 * bar, 5 * bar))
    slope = (highest - lowest) / (4 * bar)
    before, after = lowest + 0.2 * (highest - lowest), lowest + 0.8 * (highest - lowest)
    periods, jump = 60, 30
    reference = mk.Reference(angle=0.0, stiffness=mk.Step(before, after, jump * PERIOD))
    start = linear.equilibrium(0.0, stiffness=before)
    first = float(start.pressures[0])
    found = optimal_commands(
        linear,
        reference,
        start,
        np.full((periods, 2), first),
        stiffness_scale=0.5,
        duration=periods * PERIOD,
        control_period=PERIOD,
    )
    assert found.converged and found.angle_rmse < 1e-9

    keep = np.exp(-PERIOD / (50 * ms))
    response = np.array(
        [[(1 - keep) * keep ** (k - 1 - j) if j < k else 0.0 for j in range(periods)] for k in range(periods)]
    )
    desired = np.where(np.arange(periods) >= jump, after, before)
    free = lowest + slope * (first * keep ** np.arange(periods) - 1 * bar)  # without commands
    limits = [float(np.asarray(end)) for end in linear.valve.command_range(linear.joint.muscle1.specimen.domain)]
    best = lsq_linear(slope * response, desired - free, limits, tol=1e-14)
    rmse = np.sqrt(2 * best.cost / periods)
    assert np.isclose(found.stiffness_rmse, rmse, rtol=1e-4)
    assert np.allclose(found.commands[:-1, 0], best.x[:-1], atol=0.02 * bar)


@pytest.mark.slow
def test_no_better_commands_are_found_by_a_quasi_newton_method(plant):
    periods = 40
    reference = mk.Reference(angle=mk.Step(0 * deg, 4 * deg, 0.1), stiffness=15.0)
    start = plant.equilibrium(0.0, stiffness=15.0)
    begun = np.tile(np.asarray(start.pressures), (periods, 1))
    settings = {"duration": periods * PERIOD, "control_period": PERIOD}
    found = optimal_commands(plant, reference, start, begun, angle_scale=0.2 * deg, **settings, iterations=200)
    assert found.converged and found.angle_rmse < 0.5 * simulated(plant, reference, begun, start).metrics["angle_rmse"]

    result = simulated(plant, reference, found.commands, start)
    assert np.isclose(result.metrics["angle_rmse"], found.angle_rmse, rtol=1e-6)
    assert np.isclose(result.metrics["stiffness_rmse"], found.stiffness_rmse, rtol=1e-6)

    times = np.arange(periods) * PERIOD
    names = ["controller.pressure1.values", "controller.pressure2.values"]

    def cost(flat):
        control = OpenLoopControl(*(Samples(times, column) for column in flat.reshape(2, -1) * bar), plant.joint)
        at = differentiate(plant, control, reference, names, initial=start, substeps=4, **settings)
        angle, stiffness = at.values["angle_rmse"] / (0.2 * deg), at.values["stiffness_rmse"] / 0.5
        slopes = [
            2 * angle / (0.2 * deg) * at.gradients["angle_rmse"][name]
            + 2 * stiffness / 0.5 * at.gradients["stiffness_rmse"][name]
            for name in names
        ]
        return angle**2 + stiffness**2, np.concatenate(slopes) * bar

    limits = [(0.0, 8.0)] * (2 * periods)
    other = minimize(cost, found.commands.T.ravel() / bar, jac=True, bounds=limits, method="L-BFGS-B")
    assert other.fun > 0.99 * found.cost
    alone = minimize(cost, begun.T.ravel() / bar, jac=True, bounds=limits, method="L-BFGS-B", options={"maxiter": 300})
    assert alone.fun > 0.99 * found.cost and np.isclose(alone.fun, found.cost, rtol=0.1)


def test_commands_that_do_not_fit_the_run_are_refused(linear):
    start = linear.equilibrium(0.0)
    with pytest.raises(SimulationError) as caught:
        optimal_commands(linear, mk.Reference(0.0, 15.0), start, np.zeros((3, 2)), duration=0.1, control_period=PERIOD)
    assert caught.value.field == "commands" and caught.value.value == (3, 2)
