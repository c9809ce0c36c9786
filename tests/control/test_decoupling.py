"""Control by inversion in closed loop: exact where the model is, and what is left where nothing is as it believes."""

import dataclasses
import time

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax

from mckibben.control import (
    PID,
    Constant,
    Controller,
    DecouplingControl,
    ExtendedStateObserver,
    Measurement,
    PolePlacement,
    PositionStiffnessControl,
    Reference,
    Setpoint,
    Sine,
    SlidingMode,
    Step,
    VelocityObserver,
)
from mckibben.errors import RangeError
from mckibben.muscle import MaxwellSlip
from mckibben.numerics.batching import cast
from mckibben.numerics.compiled import numeric
from mckibben.plant import JointPlant
from mckibben.simulation import sampled, simulate_many
from mckibben.units import deg, mm

PERIOD, PERIODS = 1e-3, 2000
SINE = Sine(10 * deg, 0.5, 0.0, np.pi / 2)  # it starts at rest


def eso(knee, load, bandwidth=60.0, observed=200.0, **more):
    return DecouplingControl(knee, load, PolePlacement(bandwidth), ExtendedStateObserver(observed), **more)


@pytest.fixture(scope="module")
def controllers(knee, load):
    return {
        "observer": eso(knee, load),
        "integral": DecouplingControl(knee, load, PolePlacement(60.0, integral=True), VelocityObserver(200.0)),
        "sliding": DecouplingControl(knee, load, SlidingMode(40.0, 250.0), ExtendedStateObserver(200.0)),
    }


@pytest.fixture(scope="module")
def run(short_episode):
    """Two seconds of a setpoint from rest at its start; one program for each structure of a controller."""

    def run(plant, control, angle=SINE, stiffness=15.0, start=None):
        setpoints = sampled(Reference(angle=angle, stiffness=stiffness), PERIODS * PERIOD, PERIOD)[1]
        start = numeric(plant.equilibrium(float(setpoints.angle[0]), stiffness=start))
        plant, control = numeric((plant, control))
        return short_episode(plant, control, setpoints, start, jnp.asarray(PERIOD), 2)[1], setpoints

    return run


def off(answer, after=0):
    """The error of the angle [deg]."""
    record, setpoints = answer
    return (np.asarray(record.state.angle) - np.asarray(setpoints.angle))[after:] / deg


def rmse(answer, after=0):
    return float(np.sqrt(np.mean(off(answer, after) ** 2)))


@pytest.fixture(scope="module")
def tracked(run, plant, controllers):
    return {name: run(plant, control) for name, control in controllers.items()}


@pytest.mark.parametrize("name", ["observer", "integral", "sliding"])
@pytest.mark.slow
def test_with_a_right_model_there_is_next_to_no_error(tracked, plant, name):
    record, _ = tracked[name]
    assert rmse(tracked[name]) < 0.01
    stiffness = plant.joint.stiffness(record.state.angle, record.state.pressures)
    assert float(jnp.abs(stiffness - 15.0)[100:].max()) < 0.1


def test_the_loop_is_the_linear_one_that_was_designed(run, plant, controllers):
    """All poles at 60 rad/s: after a step the error is (1 + wt + (wt)^2/2) e^-wt of it."""
    error = -off(run(plant, controllers["observer"], Step(0.0, 0.5 * deg, 0.1)))[100:400]
    wt = 60.0 * PERIOD * np.arange(300)
    np.testing.assert_allclose(error, 0.5 * (1 + wt + wt**2 / 2) * np.exp(-wt), atol=0.015)


def test_it_stands_still_where_it_stands(run, plant, controllers):
    record, _ = run(plant, controllers["observer"], 0.0, 15.0, start=15.0)
    np.testing.assert_allclose(record.state.angle, 0.0, atol=1e-9)
    np.testing.assert_allclose(record.commands[0], record.commands[0][0], atol=1.0)


def test_a_step_of_stiffness_hardly_moves_the_angle(run, plant, controllers, knee, load):
    """From next to the lowest to next to the highest attainable, while moving; a tenth of the PID's is asked for."""
    low, high = (float(k) for k in knee.attainable_stiffness(0.0, -load.gravity_torque(0.0), minimum_tension=5.0))
    setpoint = SINE, Step(low + 0.1, high - 0.1, 1.5)  # at 0 deg on the way back
    pid = PositionStiffnessControl(PID(2e5, 60e5, 0.4e5), PID(0.08e5, 5e5, 0.0), model=knee)

    def moved(control):
        with_step, without = run(plant, control, *setpoint), run(plant, control, SINE, low + 0.1)
        return np.abs(off(with_step) - off(without)).max()

    assert moved(controllers["observer"]) < 0.02 * moved(pid)


def test_commands_stay_within_limits_and_muscles_taut_when_too_much_is_asked(run, plant, controllers, knee):
    for stiffness in (5.0, 25.0):
        record, _ = run(plant, controllers["observer"], SINE, stiffness)
        commands = np.stack([record.commands[0], record.commands[1]])
        assert commands.min() >= 0.0 and commands.max() <= 6e5
        assert np.asarray(record.telemetry["saturated"]).mean() > 0.9
        tensions = np.asarray(knee.tensions(record.state.angle, record.state.pressures))
        assert tensions.min() > 4.0
        assert rmse((record, sampled(Reference(angle=SINE, stiffness=15.0), 2.0, PERIOD)[1])) < 0.02  # the torque first


def test_a_wrong_load_leaves_no_error_at_rest(run, knee, load, plant, controllers):
    heavy = JointPlant(knee, dataclasses.replace(load, mass2=0.75), plant.valve)
    for name in ("observer", "integral"):
        answer = run(heavy, controllers[name], Constant(0.1))
        assert abs(off(answer)[-1]) < 1e-3
        weight = float(heavy.load.gravity_torque(0.1) - load.gravity_torque(0.1))
        if name == "observer":
            assert float(answer[0].telemetry["disturbance_estimate"][-1]) == pytest.approx(weight, rel=1e-3)


def test_nothing_winds_up_while_the_torque_is_out_of_reach(run, plant, controllers):
    """A step of 40 deg asks for more than the muscles have; it is not overshot by what was out of reach meanwhile."""
    for name in ("observer", "integral"):
        angle = np.asarray(run(plant, controllers[name], Step(-20 * deg, 20 * deg, 0.1))[0].state.angle) / deg
        assert angle.max() < 21.5
        assert angle[-1] == pytest.approx(20.0, abs=0.01)


@pytest.mark.parametrize("name", ["observer", "integral", "sliding"])
@pytest.mark.slow
def test_the_commands_follow_from_the_measurements_alone(run, plant, controllers, name):
    """A plant that differs in all its numbers: what it measured, told again without it, gives the same commands."""
    numbers, rest = eqx.partition(plant, eqx.is_array_like)
    other = eqx.combine(jax.tree.map(lambda x: 0.98 * x, numbers), rest)
    record, setpoints = run(other, controllers[name], SINE, 15.0)
    again, seconds = replayed(controllers[name], setpoints, record.state)
    np.testing.assert_allclose(again[0], record.commands[0], rtol=1e-7)
    np.testing.assert_allclose(again[1], record.commands[1], rtol=1e-7)
    assert np.ptp(np.asarray(record.commands[0])) > 1e4
    assert seconds < 50e-6  # a step; it takes about one microsecond


def replayed(control, setpoints, states, kind=jnp.float64):
    """The commands to measurements as they were, and how long a step took [s]."""
    seen = Measurement(states.angle, states.pressures)
    control, setpoints, seen, period = cast((numeric(control), setpoints, seen, PERIOD), kind)

    @jax.jit
    def told(control, setpoints, seen, period):
        def one(state, at):
            return control.step(state, *at, period)

        return lax.scan(one, control.init(jax.tree.map(lambda x: x[0], seen)), (setpoints, seen))[1]

    commands = jax.block_until_ready(told(control, setpoints, seen, period))
    begun = time.perf_counter()
    jax.block_until_ready(told(control, setpoints, seen, period))
    return commands, (time.perf_counter() - begun) / PERIODS


@pytest.mark.slow
def test_32_bits_will_do(tracked, controllers):
    record, setpoints = tracked["observer"]
    commands, _ = replayed(controllers["observer"], setpoints, record.state, jnp.float32)
    assert commands[0].dtype == jnp.float32
    assert np.sqrt(np.mean((np.asarray(commands[0]) - record.commands[0]) ** 2)) < 500.0  # Pa


class Sensed(Controller):
    """A controller behind an encoder and noisy pressure sensors."""

    inner: Controller
    seed: int = 0
    encoder: float = 0.022 * deg
    noise: float = 4e3

    def through(self, measurement, count):
        # Sines of large numbers for random ones: all but white, and a third of the code to compile.
        phase = 12.9898 * count + 78.233 * self.seed
        noise = jnp.sqrt(2.0) * self.noise * jnp.sin(jnp.stack([phase * count, phase * (count + 0.5)]))
        pressure1, pressure2 = measurement.pressures
        angle = jnp.round(measurement.angle / self.encoder) * self.encoder
        return Measurement(angle, (pressure1 + noise[0], pressure2 + noise[1]))

    def init(self, measurement):
        return self.inner.init(measurement), jnp.asarray(1)

    def step(self, state, setpoint, measurement, period):
        inner, commands = self.inner.step(state[0], setpoint, self.through(measurement, state[1]), period)
        return (inner, state[1] + 1), commands

    def telemetry(self, state):
        return self.inner.telemetry(state[0])


def unseen(count, seed, joint):
    """Conditions that no controller knows of."""
    rng = np.random.default_rng(seed)
    frequency = np.exp(rng.uniform(np.log(0.25), np.log(2.0), count))
    over = {
        "controller.seed": np.arange(count) + 1000 * seed,
        "load.mass2": rng.uniform(0.25, 0.75, count),
        "valve.time_constant": rng.uniform(0.01, 0.05, count),
        "reference.angle.frequency": frequency,
        "reference.angle.amplitude": np.minimum(10 * deg, 60 / (2 * np.pi * frequency) ** 2)
        * rng.uniform(0.5, 1, count),
        "reference.stiffness.before": rng.uniform(13.5, 17.5, count),
        "reference.stiffness.after": rng.uniform(13.5, 17.5, count),
    }
    width = rng.uniform(0.0, 15.0, count)
    for name in ("muscle1", "muscle2"):
        scale = rng.uniform(0.9, 1.1, count)
        for key in ("a1", "a2", "b1", "b2", "c1", "c2"):
            over[f"joint.{name}.law.{key}"] = getattr(getattr(joint, name).law, key) * scale
        over[f"joint.{name}.friction.half_width"] = np.maximum(width, 1e-6)
    return over


@pytest.mark.slow
def test_on_unseen_conditions_it_is_far_better_than_a_tuned_pid(knee, load, plant):
    """Encoder, noise, lag, hysteresis, mass and each muscle's law are off; the PID was tuned for such conditions."""
    rubbing = dataclasses.replace(knee.muscle1, friction=MaxwellSlip(1e-6, 0.5 * mm, elements=1))
    joint = dataclasses.replace(knee, muscle1=rubbing, muscle2=rubbing)
    pid = PositionStiffnessControl(PID(0.94e5, 1239e5, 1.58e5), PID(0.198e5, 12.25e5, 0.0), model=knee)

    def metrics(control):
        batch = simulate_many(
            JointPlant(joint, load, plant.valve),
            Sensed(control),
            Reference(angle=SINE, stiffness=Step(13.0, 17.0, 1.0)),
            over=unseen(64, 7, knee),
            duration=2.0,
            substeps=2,
            metrics=("angle_rmse", "stiffness_rmse"),
        )
        angle = np.where(batch.failed, np.inf, batch.metrics["angle_rmse"] / deg)
        return angle, np.where(batch.failed, np.inf, batch.metrics["stiffness_rmse"])

    (before, stiffness_before), (after, stiffness_after) = metrics(pid), metrics(eso(knee, load, 80.0, 250.0))
    assert np.isfinite(after).all()
    assert np.median(after) < 0.15 * np.median(before)
    assert np.percentile(after, 95) < np.median(before)
    assert np.median(stiffness_after) < 1.02 * np.median(stiffness_before)


@pytest.mark.slow
def test_expected_friction_is_part_of_the_torque(knee, load):
    """Drawn along the setpoint it is made up for at once, and the observer is told of it."""
    rubbing = dataclasses.replace(knee.muscle1, friction=MaxwellSlip(12.0, 0.5 * mm, elements=1))
    control = eso(dataclasses.replace(knee, muscle1=rubbing, muscle2=rubbing), load, friction_compensation=True)
    held = tuple(map(jnp.asarray, knee.pressures_for(0.0, -float(load.gravity_torque(0.0)), 15.0)))
    here, setpoint = Measurement(jnp.asarray(0.0), held), Setpoint(jnp.asarray(0.018), jnp.asarray(15.0))

    @jax.jit
    def stepped(control):
        state, commands = control.step(control.init(here), setpoint, here, PERIOD)
        return state, control.telemetry(state), commands

    state, told, commands = stepped(numeric(control))
    expected = float(told["friction_compensation"])
    assert expected == pytest.approx(-2 * 12.0 * 0.03, rel=0.05)
    speed = (1 - np.exp(-PERIOD * 180)) / (1 - np.exp(-PERIOD / 0.02))
    aimed = [p + (c - p) / speed for p, c in zip(held, commands, strict=True)]
    motion = state.estimates.motion
    acceleration = 60.0**2 / 3 * 0.018 - float(motion.disturbance) - 60.0 * float(motion.velocity)
    balance = float(load.total_inertia) * acceleration - float(load.gravity_torque(0.0)) - expected
    assert float(knee.torque(0.0, tuple(aimed))) == pytest.approx(balance, abs=2e-3)
    assert float(motion.known) == pytest.approx(expected / float(load.total_inertia), rel=1e-3)
    with pytest.raises(RangeError, match="no muscle of its model has friction"):
        eso(knee, load, friction_compensation=True)


def test_sliding_mode_is_bounded_outside_its_layer_and_linear_inside():
    law = SlidingMode(40.0, 80.0)
    assert float(law.step((), 0.001, 0.02, 1e6, PERIOD)[1]) == pytest.approx(40 * 0.02 + 40 * (0.02 + 0.04))
    assert float(law.step((), 1.0, 0.0, 1e6, PERIOD)[1]) == 80.0
    with pytest.raises(RangeError, match="reach is 0 rad/s"):
        SlidingMode(reach=0.0)


@pytest.mark.parametrize(
    ("law", "ratio"),
    [(PolePlacement(30.0), 9), (PolePlacement(30.0, damping=2.0), 4), (SlidingMode(30.0, 80.0), 12)],
)
def test_the_feedback_is_stable_up_to_so_many_times_the_lag(law, ratio):
    step = law.step(law.init(0.0), 1e-6, 0.0, 1e6, PERIOD), law.step(law.init(0.0), 0.0, 1e-6, 1e6, PERIOD)
    by_error, by_rate = (float(acceleration) / 1e-6 for _, acceleration in step)
    for slower, stable in ((0.99 * ratio, True), (1.01 * ratio, False)):
        assert (np.roots([slower * law.lag, 1.0, by_rate, by_error]).real.max() < 0) == stable


@pytest.mark.parametrize("integral", [False, True])
@pytest.mark.parametrize("damping", [2.0, 2.5, 3.0])
def test_poles_lie_where_they_are_placed(integral, damping):
    """Poles of the dynamics of the error: a pair of the damping (d - 1)/2, and real ones, all at the bandwidth."""
    law = PolePlacement(30.0, integral=integral, damping=damping)
    by_error, by_rate = float(law.step(0.0, 1.0, 0.0, 1e9, 1e-9)[1]), float(law.step(0.0, 0.0, 1.0, 1e9, 1e-9)[1])
    by_integral = float(law.step(0.0, 1.0, 0.0, 1e9, 1.0)[0])
    polynomial = [law.lag, 1.0, by_rate, by_error, *([by_integral] if integral else [])]
    real = [-30.0] * (len(polynomial) - 3)
    expected = np.polymul(np.poly(real), [1.0, (damping - 1) * 30.0, 30.0**2])
    np.testing.assert_allclose(np.divide(polynomial, law.lag), expected, rtol=1e-6)


def test_a_damping_outside_its_range_is_refused():
    with pytest.raises(RangeError) as caught:
        PolePlacement(damping=3.5)
    assert (caught.value.field, caught.value.value) == ("damping", 3.5)


def test_arguments_that_are_swapped_are_named(knee, load):
    with pytest.raises(RangeError, match="ExtendedStateObserver") as caught:
        DecouplingControl(knee, load, ExtendedStateObserver(), PolePlacement())
    assert caught.value.field == "feedback"
    with pytest.raises(RangeError, match="minimum_tension is -1 N"):
        eso(knee, load, minimum_tension=-1.0)
