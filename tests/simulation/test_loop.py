"""The sampled-data loop against an independent solver, and its order, batches and precision."""

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax

from mckibben.control import PID, PositionStiffnessControl, Reference, Setpoint, Sine, Step
from mckibben.numerics.compiled import numeric
from mckibben.simulation import compiled_episode, sampled

PERIOD = 1e-3
REFERENCE = Reference(angle=Sine(amplitude=0.17, frequency=0.5), stiffness=Step(before=13.0, after=17.0, at=5.0))


@pytest.fixture(scope="module")
def control(knee):
    return numeric(PositionStiffnessControl(PID(3e5, 4e6, 3e4), PID(2e3, 2e5, 0.0), model=knee))


@pytest.fixture(scope="module", params=["first order", "ideal"])
def run(request, plant, ideal_plant, control):
    """Ten seconds in closed loop, with either valve."""
    chosen = plant if request.param == "first order" else ideal_plant
    setpoints = sampled(REFERENCE, 10_000 * PERIOD, PERIOD)[1]
    record = compiled_episode(chosen, control, setpoints, numeric(chosen.equilibrium(0.0)), jnp.asarray(PERIOD), 4)
    return request.param, setpoints, *record


def solved(paper, record, time_constant):
    """The same commands, held over each period, through the paper's own equations and an eighth-order method."""

    def rate(t, y, commands):
        angle, velocity, p1, p2 = y  # pressures in bar
        lag = jnp.inf if time_constant is None else time_constant
        acceleration = paper.acceleration(angle, velocity, (p1 * 1e5, p2 * 1e5), jnp)
        return velocity, acceleration, (commands[0] - p1) / lag, (commands[1] - p2) / lag

    term, solver = diffrax.ODETerm(rate), diffrax.Dopri8()
    tight = diffrax.PIDController(rtol=1e-12, atol=1e-13)

    def period(y, commands):
        start = y if time_constant is not None else (*y[:2], *commands)
        answer = diffrax.diffeqsolve(
            term, solver, 0.0, PERIOD, PERIOD, start, commands, stepsize_controller=tight, max_steps=64
        )
        return jax.tree.map(lambda x: x[-1], answer.ys), y[0]

    state, commands = record.state, (record.commands[0] / 1e5, record.commands[1] / 1e5)
    start = (state.angle[0], state.velocity[0], state.pressures[0][0] / 1e5, state.pressures[1][0] / 1e5)
    return jax.jit(lambda y, c: lax.scan(period, y, c)[1])(start, commands)


@pytest.mark.slow
def test_it_agrees_with_an_independent_solver_to_1e_8_rad_over_10_s(run, paper_precontracted):
    valve, _, _, record = run
    angle = solved(paper_precontracted, record, 0.02 if valve == "first order" else None)
    assert np.ptp(np.asarray(angle)) > 0.2
    np.testing.assert_allclose(record.state.angle, angle, rtol=0, atol=1e-8)


@pytest.mark.slow
def test_the_loop_tracks_and_stays_within_limits(run):
    _, setpoints, final, record = run
    assert float(jnp.max(jnp.abs(record.state.angle - setpoints.angle)[1000:])) < 0.06
    for command in (record.commands[0], record.commands[1]):
        assert 0.0 <= float(command.min()) <= float(command.max()) <= 6e5
    assert float(jnp.mean(record.telemetry["stiffness_estimate"][8000:])) == pytest.approx(17.0, abs=0.5)
    assert record.state.angle.shape == (10_000,)
    assert np.isfinite([float(x) for x in jax.tree.leaves(final)]).all()


def test_the_record_holds_the_start_of_each_period(run):
    valve, _, _, record = run
    assert float(record.state.angle[0]) == 0.0
    assert float(record.state.velocity[0]) == 0.0
    if valve == "ideal":  # the pressure of the last period is its command
        np.testing.assert_array_equal(record.state.pressures[0][1:], record.commands[0][:-1])


def test_the_commands_are_those_of_the_controller_stepped_by_hand(run, control):
    from mckibben.control import Measurement

    _, setpoints, _, record = run
    step = jax.jit(lambda memory, reference, seen: control.step(memory, reference, seen, PERIOD))
    at = lambda k: Measurement(record.state.angle[k], (record.state.pressures[0][k], record.state.pressures[1][k]))  # noqa: E731
    memory = control.init(at(0))
    for k in range(5):
        memory, commands = step(memory, Setpoint(setpoints.angle[k], setpoints.stiffness[k]), at(k))
        assert [float(c) for c in commands] == pytest.approx(
            [float(record.commands[0][k]), float(record.commands[1][k])], rel=1e-12
        )
