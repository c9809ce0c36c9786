# ruff: noqa: E501 - tables of cases
"""The plan within limits against SciPy's, on the problem written anew in plain NumPy; without limits, closed forms."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import minimize

from mckibben.actuator.base import Attainable
from mckibben.control.ddp import HorizonProblem, Quadratic, _pressures_x, constant, extrapolate, solve
from mckibben.numerics.calculus import value_and_derivative

STAGES = 6
HIGHEST = 6.0  # command
FREQUENCY_SQ = 0.1


def joint_problem(
    *,
    bend=1.0,
    stage=0.4,
    hold_weights=(0.52, 0.35),
    valve_fraction=0.22,  # of first-order valves
    lowest=0.3,
    highest=5.0,
    reference=(0.0, 0.0, 0.0, 0.0),
    sign=1,
    steps=(0.0, 0.0),  # of angle and stiffness, known ahead
):
    """Near what the knee at 80 rad/s has; 0.1 deg and 0.5 N*m/rad weigh the same."""
    signals = np.transpose([reference_at(reference, stage * k) for k in range(STAGES + 1)])
    signals[0, 3:] += steps[0]
    setpoints = steps[1] * (np.arange(STAGES + 1) >= 2)
    return HorizonProblem(
        stage=stage,
        hold_weights=hold_weights,
        damping=2.25,
        bandwidth_ratio_sq=1.5,
        acceleration=(
            Quadratic(0.3, -0.4 * bend, 0.01 * bend),
            Quadratic(-4.8, -0.02 * bend, 0.001 * bend),
            Quadratic(4.9, -0.02 * bend, -0.001 * bend),
        ),
        stiffness=(
            Quadratic(-30.0 * sign, 0.1 * bend),
            Quadratic(5.0 * sign, 0.05 * bend),
            Quadratic(5.2 * sign, -0.05 * bend),
        ),
        drag=0.005,
        reference=tuple(signals),
        setpoints=setpoints,
        pressure_lower=(Quadratic(lowest, 0.01 * bend), Quadratic(lowest + 0.1, -0.01 * bend)),
        pressure_upper=(Quadratic(highest, -0.01 * bend), Quadratic(highest + 0.2, 0.01 * bend)),
        attainable=(Attainable(1 - valve_fraction, 0.0, HIGHEST * valve_fraction),) * 2,
    )


def value(quadratic, angle):
    return quadratic.value + angle * quadratic.slope + angle**2 * quadratic.curvature / 2


def given(parts, angle, pressures):
    return sum(value(part, angle) * p for part, p in zip(parts, (1.0, *pressures), strict=True))


def reference_at(reference, time):
    """The reference and its derivatives, its acceleration a sine with an offset of none."""
    angle, velocity, acceleration, jerk = reference
    w = np.sqrt(FREQUENCY_SQ)
    return (
        angle
        + velocity * time
        + acceleration * (1 - np.cos(w * time)) / w**2
        + jerk * (time - np.sin(w * time) / w) / w**2,
        velocity + acceleration * np.sin(w * time) / w + jerk * (1 - np.cos(w * time)) / w**2,
        acceleration * np.cos(w * time) + jerk * np.sin(w * time) / w,
        jerk * np.cos(w * time) - acceleration * w * np.sin(w * time),
    )


def start_of(problem, error, rate, pressures):
    angle, velocity, now, _ = (signal[0] for signal in problem.reference)
    angle += error
    acceleration = given(problem.acceleration, angle, pressures) - problem.drag * (velocity + rate) - now
    return error, rate, acceleration, given(problem.stiffness, angle, pressures)


def costs(state, pressures, reference, _):
    """Residuals beside the errors: the angle beyond a limit, linear in state and pressures, and a product of both."""
    return 3 * (reference[0] + state[0] - 1.0), 0.5 * pressures[0] * (1 + 0.1 * state[1]), 0.3 * state[3]


def cost_and_margins(problem, start, pressures, plan, costly=False):
    """What a plan costs, and how far each pressure is from its limits (below zero: beyond)."""
    h, (mu1, mu2), d = problem.stage, problem.hold_weights, problem.damping
    c, x, before = d * (d - 2), np.array(start), pressures
    cost, margins = 0.0, []
    for k, chosen in enumerate(plan.reshape(-1, 2)):
        (r0, v0, a0, _), (r1, v1, a1, _) = ([signal[i] for signal in problem.reference] for i in (k, k + 1))
        turned = r0 + x[0] + h * (v0 + x[1])  # the joint itself, not its error
        angle = turned + h**2 / 2 * (a0 + x[2] + mu2 * (a1 - a0))
        turning = v0 + x[1] + h * (a0 + x[2] + mu1 * (a1 - a0))
        for i in range(2):
            slowest, fastest = problem.attainable[i](before[i])
            upper = max(min(value(problem.pressure_upper[i], angle), fastest), slowest)
            margins += [
                chosen[i] - min(max(value(problem.pressure_lower[i], angle), slowest), upper),
                upper - chosen[i],
            ]
        acceleration = given(problem.acceleration, angle, chosen) - problem.drag * turning
        mine = x[2] + a0  # goes from one to the next, by the hold weights
        turned += h**2 / 2 * (mine + mu2 * (acceleration - mine))
        speed = v0 + x[1] + h * (mine + mu1 * (acceleration - mine))
        stiffness = given(problem.stiffness, angle, chosen)
        new = np.array([turned - r1, speed - v1, acceleration - a1, stiffness - problem.setpoints[k + 1]])
        rates = (new - x)[2:] / h
        rates[1] = (stiffness - x[3] - problem.setpoints[k]) / h
        cost += h / 2 * (new**2 @ [1, c, c, 1] + rates**2 @ [1, problem.bandwidth_ratio_sq])
        if costly:
            cost += h / 2 * sum(residual**2 for residual in costs(new, chosen, (r1, v1, a1, 0.0), 0.0))
        x, before = new, chosen
    final = np.array([[d, d, 1], [d, d**2 - 1, d], [1, d, d]])
    return cost + x[:3] @ final @ x[:3] / 2 + np.sqrt(problem.bandwidth_ratio_sq) * x[3] ** 2 / 2, np.array(margins)


@functools.partial(jax.jit, static_argnums=4)
def improved(problem, start, pressures, iterations, costly=False):
    if costly:
        problem = problem._replace(residuals=costs)
    return solve(problem, start, pressures, constant(pressures, STAGES), iterations)


def first_command(iterations, problem, start, pressures, costly=False):
    """From a plan to stand still."""
    return improved(*floats((problem, start, pressures)), iterations, costly)[1]


def optimum(problem, start, pressures, costly=False):
    return minimize(
        lambda plan: cost_and_margins(problem, start, pressures, plan, costly)[0],
        np.tile(pressures, STAGES),
        constraints={"type": "ineq", "fun": lambda plan: cost_and_margins(problem, start, pressures, plan)[1]},
        method="SLSQP",
        options={"ftol": 1e-13, "maxiter": 200},
    )


def floats(tree):
    return jax.tree.map(lambda number: jnp.asarray(number, float), tree)


def test_the_pressures_follow_from_the_state_by_the_implicit_function_theorem():
    """Against differences of the state by angle error, its rate and both pressures."""
    problem = joint_problem()
    at = np.array([2.5, 1.2, 3.0, 3.3])

    def state(x):
        return np.array(start_of(problem, x[0], x[1], x[2:]), float)

    steps = 1e-5 * np.eye(4)
    differences = np.stack([(state(at + step) - state(at - step)) / 2e-5 for step in steps], axis=1)
    expected = np.linalg.inv(differences)[2:]  # rows of the pressures
    end, speed, pressures = problem.reference[0][0] + at[0], problem.reference[1][0] + at[1], tuple(at[2:])
    _, by_angle = value_and_derivative(lambda angle: problem.outputs(angle, speed, pressures), jnp.asarray(end))
    by_pressure = tuple(tuple(one(end) for one in each[1:]) for each in (problem.acceleration, problem.stiffness))
    np.testing.assert_allclose(_pressures_x(problem, by_angle, by_pressure), expected, rtol=1e-6, atol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("problem", "error", "rate", "pressures", "saturated", "near"),
    [
        pytest.param(joint_problem(), 2.5, 1.2, (3.0, 3.0), False, 1e-6, id="free"),
        pytest.param(joint_problem(reference=(3.0, 2.0, -0.3, 0.1)), -3.0, -3.2, (2.3, 3.3), False, 1e-6, id="along a reference"),
        pytest.param(joint_problem(steps=(8.0, 4.0)), 0.1, 0.0, (3.0, 3.0), False, 1e-6, id="steps known ahead"),
        pytest.param(joint_problem(highest=2.5), 0.5, 0.2, (2.4, 2.4), True, 1e-6, id="stiffness above the attainable"),
        pytest.param(joint_problem(lowest=3.2), 4.0, 1.2, (3.3, 3.3), True, 1e-6, id="stiffness below the attainable"),
        pytest.param(joint_problem(highest=2.5, lowest=2.2), -6.0, 1.0, (2.4, 2.4), True, 1e-6, id="in a corner"),
        pytest.param(joint_problem(sign=-1, highest=3.1), 2.5, 1.2, (3.0, 3.0), True, 1e-6, id="springs: softer with pressure"),
        # What a valve can do hangs on the pressure before, which is told from the state but for a part in a thousand.
        pytest.param(joint_problem(), -40.0, 1.2, (3.0, 3.0), True, 5e-3, id="as fast as valves can"),
        pytest.param(joint_problem(highest=2.5), 0.5, 0.2, (4.0, 4.0), True, 1e-6, id="back within limits, as valves can"),
    ],
)  # fmt: skip
def test_the_move_is_that_of_the_optimum(problem, error, rate, pressures, saturated, near):
    start = start_of(problem, error, rate, pressures)
    command = first_command(8, problem, start, pressures)
    found = optimum(problem, start, pressures)
    np.testing.assert_allclose(command.pressures, found.x[:2], atol=near)
    assert bool(command.limited[0] | command.limited[1]) == saturated
    assert (cost_and_margins(problem, start, pressures, found.x)[1][:4].min() < 1e-9) == saturated


def test_the_extrapolated_reference_goes_on_with_its_frequency():
    start = 3.0, 2.0, -0.3, 0.1
    found = extrapolate(*floats((start, 0.4, FREQUENCY_SQ)), STAGES)
    expected = np.transpose([reference_at(start, 0.4 * k) for k in range(STAGES + 1)])
    np.testing.assert_allclose(np.stack(found), expected, atol=1e-6)


@pytest.mark.slow
def test_costs_of_a_user_enter_the_optimum():
    """A nonlinear residual: Gauss-Newton leaves out its curvature, so that a step is small where it is small."""
    problem, pressures = joint_problem(), (3.0, 3.0)
    start = start_of(problem, 2.5, 1.2, pressures)
    command = first_command(30, problem, start, pressures, True)
    found = optimum(problem, start, pressures, True)
    np.testing.assert_allclose(command.pressures, found.x[:2], atol=1e-4)
    without = first_command(8, problem, start, pressures)
    assert abs(float(command.pressures[0] - without.pressures[0])) > 0.05


def test_without_limits_it_is_the_linear_loop_however_short_the_horizon():
    """With d = 2.25 the jerk is -(e + d de/dt + d dde/dtt), and the stiffness falls with its own pole."""
    problem = joint_problem(bend=0.0, stage=0.01, hold_weights=(0.5, 1 / 3), valve_fraction=1.0)
    start = (1.0, -0.4, 0.3, 0.8)
    torque, stiff = problem.acceleration, problem.stiffness
    matrix = np.array([[torque[1].value, torque[2].value], [stiff[1].value, stiff[2].value]])
    drag = problem.drag * (start[1] + 0.01 * start[2])
    before = np.linalg.solve(matrix, [start[2] - torque[0].value + drag, start[3] - stiff[0].value])
    command = first_command(1, problem, start, tuple(before))
    acceleration, stiffness = matrix @ command.pressures + [torque[0].value - drag, stiff[0].value]
    assert (acceleration - start[2]) / 0.01 == pytest.approx(-(1.0 - 2.25 * 0.4 + 2.25 * 0.3), rel=0.03)
    assert (stiffness - start[3]) / 0.01 == pytest.approx(-0.8 / np.sqrt(1.5), rel=0.03)
