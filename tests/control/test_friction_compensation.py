"""Feed-forward of friction in closed loop: what it takes off the error, and that it does not chatter."""

import dataclasses
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from mckibben.control import (
    PID,
    Constant,
    DecouplingControl,
    FrictionCompensation,
    Measurement,
    PolePlacement,
    PositionStiffnessControl,
    Reference,
    Setpoint,
    Sine,
)
from mckibben.errors import RangeError
from mckibben.muscle import MaxwellSlip, NoFriction
from mckibben.numerics.compiled import numeric
from mckibben.plant import JointPlant
from mckibben.scenario import Scenario, with_values
from mckibben.simulation import AtRest, Outcome, sampled, simulate_many
from mckibben.units import deg, mm

EXAMPLE = Path(__file__).parents[2] / "examples" / "valves" / "regulator-decoupling.yaml"
SLIP = MaxwellSlip(12.0, 0.5 * mm, elements=1)
SLOW = Reference(angle=Sine(10 * deg, 0.25), stiffness=Constant(15.0))


def with_friction(joint, slip):
    muscle = dataclasses.replace(joint.muscle1, friction=slip)
    return dataclasses.replace(joint, muscle1=muscle, muscle2=muscle)


@pytest.fixture(scope="module")
def inner(knee):
    return PositionStiffnessControl(PID(2e5, 60e5, 0.4e5), PID(0.08e5, 5e5, 0.0), model=knee)


@pytest.fixture(scope="module")
def rubbing(knee, load, plant):
    return JointPlant(with_friction(knee, SLIP), load, plant.valve)


@pytest.fixture(scope="module")
def run(rubbing, short_episode):
    """Four seconds of the setpoint; one program for a controller."""
    setpoints = sampled(SLOW, 4.0, 1e-3)[1]
    start = numeric(rubbing.equilibrium(0.0))

    def run(chosen, control):
        chosen, control = numeric((chosen, control))
        return short_episode(chosen, control, setpoints, start, jnp.asarray(1e-3), 4)[1], setpoints

    return run


@pytest.fixture(scope="module")
def runs(run, rubbing, inner, knee):
    """The same setpoint without friction, with it, and with it made up for by a model that is right or 30 % off."""
    trace = MaxwellSlip(1e-6, 0.5 * mm, elements=1)  # next to none, in the same program
    off = with_friction(knee, MaxwellSlip(15.6, 0.7 * mm, elements=1))
    return {
        "none": run(JointPlant(with_friction(knee, trace), rubbing.load, rubbing.valve), inner),
        "friction": run(rubbing, inner),
        "made up for": run(rubbing, FrictionCompensation(inner, model=rubbing.joint)),
        "model off": run(rubbing, FrictionCompensation(inner, model=off)),
    }


def rmse(record, setpoints, after=0):
    """Of the angle [rad]."""
    return float(np.sqrt(np.mean((np.asarray(record.state.angle) - setpoints.angle)[after:] ** 2)))


@pytest.mark.slow
def test_the_error_that_friction_makes_is_all_but_gone(runs):
    errors = {name: rmse(*run, after=1000) for name, run in runs.items()}
    made, left = errors["friction"] - errors["none"], errors["made up for"] - errors["none"]
    assert made > 0.35 * errors["none"]
    assert abs(left) < 0.15 * made
    assert errors["model off"] < errors["friction"] - 0.6 * made


@pytest.mark.slow
def test_it_does_not_chatter(runs):
    """The command goes no further up and down than it did to overcome friction by feedback."""

    def way(name):
        return np.abs(np.diff(runs[name][0].commands[1])).sum()

    assert way("made up for") < 1.05 * way("friction")
    rates = np.abs(np.diff(runs["made up for"][0].telemetry["friction_compensation"]))
    assert rates.max() < 0.02  # N*m in a period: the torque changes sides continuously


def test_what_it_expects_is_the_friction_that_there_is(runs, rubbing):
    record, _ = runs["made up for"]
    late = jax.tree.map(lambda column: column[1000:], record.state)
    true = jax.jit(rubbing.joint.friction_torque)(late.angle, late.velocity, late.pressures, late.muscles)
    expected = record.telemetry["friction_compensation"][1000:]
    assert np.corrcoef(expected, true)[0, 1] > 0.9
    assert np.abs(expected).max() == pytest.approx(np.abs(true).max(), rel=0.05)


@pytest.mark.slow
def test_a_batch_is_what_single_runs_are(run, rubbing, inner):
    widths = np.array([8.0, 12.0])
    batch = simulate_many(
        rubbing,
        inner,
        SLOW,
        over={"joint.muscle2.friction.half_width": widths},
        duration=4.0,
        initial=AtRest(0.0),
        metrics=("angle_rmse",),
        substeps=4,
    )
    for k, width in enumerate(widths):
        slip = dataclasses.replace(SLIP, half_width=float(width))
        muscle2 = dataclasses.replace(rubbing.joint.muscle2, friction=slip)
        one = dataclasses.replace(rubbing, joint=dataclasses.replace(rubbing.joint, muscle2=muscle2))
        assert batch.metrics["angle_rmse"][k] == pytest.approx(rmse(*run(one, inner)), rel=1e-9)


@pytest.fixture(scope="module")
def shifted(inner, rubbing):
    """Steps towards setpoints [rad] from rest at 0 rad and two pressures, compensated and not."""
    control = FrictionCompensation(inner, model=rubbing.joint)

    @jax.jit
    def steps(pressures, setpoints):
        here = Measurement(jnp.zeros(()), pressures)
        state = control.init(here)
        setpoints = [Setpoint(setpoint, jnp.asarray(15.0)) for setpoint in setpoints]
        plain = control.controller.step(state.inner, setpoints[0], here, 1e-3)[1]
        first, commands = control.step(state, setpoints[0], here, 1e-3)
        second, _ = control.step(first, setpoints[1], here, 1e-3)
        won = rubbing.joint.torque(0.0, (pressures[0] + commands[0] - plain[0], pressures[1] + commands[1] - plain[1]))
        won = won - rubbing.joint.torque(0.0, pressures)
        return plain, commands, [control.telemetry(s) for s in (state, first, second)], won

    return lambda pressures, setpoints: steps(tuple(map(jnp.asarray, pressures)), tuple(map(jnp.asarray, setpoints)))


def test_it_shifts_the_differential_pressure_by_the_torque_of_friction(shifted):
    plain, commands, told, won = shifted((3e5, 3e5), (0.1, 0.05))  # far: both muscles slip
    shift = float(commands[1] - plain[1])
    assert shift > 0 and float(plain[0] - commands[0]) == pytest.approx(shift)
    before, after, back = (float(each["friction_compensation"]) for each in told)
    assert before == 0.0
    assert float(won) == pytest.approx(-after, rel=1e-6)
    assert after < -0.3 < 0.3 < back  # at the turn it changes sides with the setpoint, though the joint has not moved
    assert not told[1]["saturated"]


def test_commands_stay_within_the_limits_and_say_so(shifted):
    _, commands, told, _ = shifted((0.0, 6e5), (0.3, 0.3))
    assert 0 <= float(commands[0]) <= 6e5 and 0 <= float(commands[1]) <= 6e5
    assert bool(told[1]["saturated"])


def test_a_model_without_friction_is_refused(inner, knee):
    with pytest.raises(RangeError, match="no muscle of its model has friction"):
        FrictionCompensation(inner, model=knee)
    with pytest.raises(RangeError, match="model is a NoFriction"):
        FrictionCompensation(inner, model=NoFriction())


@pytest.mark.slow
def test_presliding_in_the_observer_ends_a_limit_cycle():
    """Stuck muscles are several times stiffer than sliding ones, here by more than the model says."""
    given = Scenario.read(EXAMPLE).with_fixed_model()
    changes = {
        "joint.muscle1.friction.half_width": 13.0,
        "joint.muscle2.friction.half_width": 13.0,
        "controller.feedback.bandwidth": 45.0,
        "controller.observer.bandwidth": 60.0,
        "controller.pressure_observer.bandwidth": 60.0,
        "reference.angle.amplitude": 0.002,
        "reference.angle.frequency": 0.25,
    }
    given = with_values(given, changes)

    def run(observed):
        return given.simulate(dataclasses.replace(given.control(), friction_in_observer=observed))

    outside, inside = run(None), run(1.0)
    assert outside.outcome is Outcome.LIMIT_CYCLE and inside.outcome is not Outcome.LIMIT_CYCLE
    assert inside.metrics["air"] < 0.5 * outside.metrics["air"]
    assert inside.metrics["angle_rmse"] < outside.metrics["angle_rmse"]


def test_friction_in_the_observer_is_compensated(rubbing):
    with pytest.raises(RangeError, match="nothing would compensate"):
        DecouplingControl(rubbing.joint, rubbing.load, PolePlacement(60.0), friction_in_observer=1.0)
