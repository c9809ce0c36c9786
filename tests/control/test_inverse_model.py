"""A learned inverse in parallel with two loops: what it gives, how it learns, and that it does not run away."""

import ast
import dataclasses
import inspect

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax

from mckibben.control import (
    PID,
    InverseModelControl,
    Measurement,
    PositionStiffnessControl,
    Reference,
    Setpoint,
    Sine,
    Step,
    inverse_model,
)
from mckibben.control.backprop import Network
from mckibben.control.inverse_model import Motion, Moved, Smoothed, Start
from mckibben.errors import RangeError
from mckibben.muscle import TripleExponentialLaw
from mckibben.numerics.compiled import numeric
from mckibben.numerics.lanes import cast
from mckibben.plant import FirstOrderValve, JointPlant
from mckibben.simulation import compiled_episode, sampled
from mckibben.units import deg

PERIOD, SECONDS, CYCLE = 1e-3, 10.0, 1000
SINE = Sine(8 * deg, 1.0, 0.0, np.pi / 2)  # it starts at rest
SOFT = PID(3e5, 4e6, 5e4), PID(3e4, 1.1e6, 0.0)


def loops(knee, tension=None):
    return PositionStiffnessControl(*SOFT, model=knee, minimum_tension=tension)


@pytest.fixture(scope="module")
def alone(knee):
    return InverseModelControl(loops(knee))


@pytest.fixture(scope="module")
def modelled(knee, load):
    return InverseModelControl(loops(knee, 5.0), load)


@pytest.fixture(scope="module")
def run():
    """Some seconds of a wish from rest at its start; one program for each structure of a controller."""

    def run(plant, control, angle=SINE, stiffness=15.0, start=15.0):
        wishes = sampled(Reference(angle=angle, stiffness=stiffness), SECONDS, PERIOD)[1]
        start = numeric(plant.at_rest(float(wishes.angle[0]), stiffness=start))
        plant, control = numeric((plant, control))
        return compiled_episode(plant, control, wishes, start, jnp.asarray(PERIOD), 2)[1], wishes

    return run


def by_cycle(answer):
    """The RMSE of the angle in each cycle of the sine [deg]."""
    record, wishes = answer
    off = (np.asarray(record.state.angle) - np.asarray(wishes.angle)) / deg
    return np.sqrt(np.mean(off.reshape(-1, CYCLE) ** 2, axis=1))


def rated(control, rate):
    return dataclasses.replace(control, learning_rate=rate)


def other(plant, load, scales=(0.92, 1.08), mass2=0.75, lag=0.02):
    """The plant, each muscle pulling so many times as hard, with another mass and other valves."""
    laws = [muscle.law for muscle in (plant.joint.muscle1, plant.joint.muscle2)]
    names = ("a1", "a2", "b1", "b2", "c1", "c2")
    joint = eqx.tree_at(
        lambda j: [getattr(m.law, name) for m in (j.muscle1, j.muscle2) for name in names],
        plant.joint,
        [getattr(law, name) * scale for law, scale in zip(laws, scales, strict=True) for name in names],
    )
    load = numeric(dataclasses.replace(load, mass2=mass2))
    return JointPlant(joint, load, FirstOrderValve(np.asarray(lag)))


def test_without_learning_and_load_it_is_the_loops_alone(run, plant, alone):
    """But for rounding, where the wish stands or jumps."""
    wish = Step(0.05, 0.1, 0.5), Step(14.0, 16.0, 1.0)
    record, _ = run(plant, rated(alone, 0.0), *wish)
    expected, _ = run(plant, alone.loops, *wish)
    np.testing.assert_allclose(record.command1, expected.command1, rtol=1e-10)
    np.testing.assert_allclose(record.command2, expected.command2, rtol=1e-10)
    assert np.ptp(np.asarray(record.command1)) > 1e4


def test_the_error_of_a_repeated_sine_falls(run, plant, alone):
    """From nothing; without learning it stays what it is."""
    learnt, before = by_cycle(run(plant, alone)), by_cycle(run(plant, rated(alone, 0.0)))
    assert before[-1] == pytest.approx(before[2], rel=1e-3)
    assert learnt[-1] < 0.3 * before[-1]
    assert (np.diff(learnt) < 0).all()


def test_a_right_model_leaves_little_to_learn(run, plant, alone, modelled):
    assert by_cycle(run(plant, rated(modelled, 0.0))).max() < 0.02 * by_cycle(run(plant, rated(alone, 0.0)))[-1]
    assert by_cycle(run(plant, modelled)).max() < 0.05


def test_what_a_model_has_wrong_is_learned_on_top_of_it(run, plant, load, modelled):
    wrong = other(plant, load)
    without, learnt = by_cycle(run(wrong, rated(modelled, 0.0))), by_cycle(run(wrong, rated(modelled, 1000.0)))
    assert learnt[-1] < 0.75 * without[-1]
    assert learnt[0] < without[0]  # it does no harm while it learns


def test_no_rate_makes_it_run_away_where_nothing_is_as_believed(run, plant, load, modelled):
    """Mass, valves and each muscle's law are off; rates go up to one per control period."""
    rng = np.random.default_rng(3)
    for _ in range(8):
        wrong = other(plant, load, rng.uniform(0.9, 1.1, 2), rng.uniform(0.25, 0.75), rng.uniform(0.01, 0.05))
        without = by_cycle(run(wrong, rated(modelled, 0.0)))
        for rate in (3.0, 1000.0):
            record, wishes = run(wrong, rated(modelled, rate))
            assert by_cycle((record, wishes)).max() < 1.1 * without.max()
            tensions = wrong.joint.tensions(record.state.angle, record.state.pressures)
            assert np.min(tensions) > 0.0
            assert float(jnp.abs(record.telemetry["forward_differential"]).max()) < 3e5


def test_the_commands_follow_from_the_measurements_alone(run, plant, modelled):
    """A plant that differs in all its numbers: what it measured, told again without it, gives the same commands."""
    numbers, rest = eqx.partition(plant, eqx.is_array_like)
    differing = eqx.combine(jax.tree.map(lambda x: 0.98 * x, numbers), rest)
    record, wishes = run(differing, modelled)
    again = replayed(modelled, wishes, record.state)
    np.testing.assert_allclose(again[0], record.command1, rtol=1e-6)
    np.testing.assert_allclose(again[1], record.command2, rtol=1e-6)


def test_32_bits_stay_32_bits(modelled):
    periods = jax.ShapeDtypeStruct((10,), jnp.float32)
    wishes, seen = Setpoint(periods, periods), Measurement(periods, (periods, periods))
    control, period = cast((numeric(modelled), np.asarray(PERIOD)), jnp.float32)
    assert {c.dtype for c in eqx.filter_eval_shape(told, control, wishes, seen, period)} == {jnp.dtype("float32")}


@eqx.filter_jit
def told(control, wishes, seen, period):
    def one(state, at):
        return control.step(state, *at, period)

    return lax.scan(one, control.init(jax.tree.map(lambda x: x[0], seen)), (wishes, seen))[1]


def replayed(control, wishes, states):
    """The commands to measurements as they were."""
    return told(numeric(control), wishes, Measurement(states.angle, states.pressures), np.asarray(PERIOD))


def test_it_takes_over_the_pressures_as_they_are(modelled, paper_precontracted):
    """Also where the model would have others."""
    held, periods = (4.1e5, 4.6e5), np.ones(int(SECONDS / PERIOD))
    wish = Setpoint(jnp.array(0.1 * periods), jnp.array(paper_precontracted.stiffness(0.1, held) * periods))
    still = Measurement(wish.angle, (jnp.array(held[0] * periods), jnp.array(held[1] * periods)))
    commands = told(numeric(modelled), wish, still, np.asarray(PERIOD))
    np.testing.assert_allclose(commands[0], held[0], rtol=1e-6)
    np.testing.assert_allclose(commands[1], held[1], rtol=1e-6)


START = Start(*map(jnp.asarray, (14.0, 0.1e5, 1e5)))


def moved(angle=0.05, stiffness=15.0, pressures=(4.0e5, 4.4e5), velocity=0.4):
    return Moved(*(Smoothed(jnp.asarray(x), None) for x in (angle, stiffness, *pressures)), jnp.asarray(velocity))


def network(seed=0, hidden=8):
    rng = np.random.default_rng(seed)
    return Network(jnp.asarray(rng.normal(size=(hidden, 5))), jnp.asarray(0.2 * rng.normal(size=(2, hidden + 1))))


def test_it_steps_down_the_gradient_by_no_more_than_it_may(alone):
    """Against JAX's own derivative of the network; a part of the error goes that is below learning rate x period."""
    start, acceleration = START, jnp.asarray(3.0)
    motion = Motion(jnp.asarray(0.05), jnp.asarray(0.4), acceleration, jnp.asarray(15.0))
    target = jnp.asarray([0.2 - 0.1, 4.2 - 1.0])  # bar: beyond what it starts from

    def answers(weights):
        return jnp.stack(alone._learned(weights, motion, start)[0]) / alone.pressure_scale

    before = network()
    errors = jnp.clip(target - answers(before), -1.0, 1.0)
    slopes = jax.jit(jax.jacobian(answers))(before)
    size = float(jnp.sum(slopes.output[0] ** 2) + jnp.sum(slopes.hidden**2))
    after, off = alone._taught(before, moved(), acceleration, start, PERIOD)
    for mine, old, slope in zip(after, before, slopes, strict=True):
        gradient = jnp.tensordot(errors, slope, axes=1)
        np.testing.assert_allclose(mine - old, alone.learning_rate * PERIOD / (1 + size) * gradient, atol=1e-12)
    np.testing.assert_allclose(jnp.stack(off), (target - answers(before)) * 1e5, rtol=1e-9)
    fast, _ = rated(alone, 1e6)._taught(before, moved(), acceleration, start, PERIOD)
    assert float(jnp.linalg.norm(jnp.clip(target - answers(fast), -1, 1))) < float(jnp.linalg.norm(errors))


def test_nothing_is_learned_from_a_slack_muscle(alone):
    for pressures, learns in (((0.0, 4.4e5), False), ((4.0e5, 4.4e5), True)):
        after, off = alone._taught(network(), moved(pressures=pressures), jnp.asarray(0.0), START, PERIOD)
        assert bool(jnp.any(after.output != network().output)) == learns
        assert (float(off[0]) != 0.0) == learns


def test_motion_and_pressures_are_of_one_moment(alone):
    """Behind the same filters a constant acceleration is one, and what is affine in the motion stays so."""

    def angle(k):
        return 0.5 * 2.0 * (PERIOD * k) ** 2 - 0.05

    state = alone.init(Measurement(jnp.asarray(angle(0)), (jnp.asarray(2e5), jnp.asarray(3e5)))).moved

    def one(state, k):
        now = Measurement(angle(k), (2e5 + 1e5 * angle(k), 3e5 - 1e5 * angle(k)))
        return alone._moved(state, now, 15.0 + angle(k), PERIOD)

    state, acceleration = lax.scan(jax.jit(one), state, jnp.arange(1.0, 501.0))
    assert float(acceleration[-1]) == pytest.approx(2.0, rel=1e-6)
    delay = 2 / 60.0  # of two filters, but for half a period each
    assert float(state.velocity) == pytest.approx(2.0 * (0.5 - delay), abs=2.0 * 2 * PERIOD)
    seen = float(state.angle.value)
    assert float(state.pressure1.value) == pytest.approx(2e5 + 1e5 * (seen + 0.05) - 5e3, abs=1e-3)
    assert float(state.stiffness.value) == pytest.approx(15.0 + (seen + 0.05) - 0.05, abs=0.06)


def test_a_law_that_is_not_affine_is_inverted_step_by_step(knee, load):
    """One Newton step a period, from where the pressures are."""
    law = TripleExponentialLaw(-154.4, 8.196e-4, -2.557e-3, -4.87e-11, 116.2, 38.1, 5.0, 11.63, knee.muscle1.domain)
    bent = dataclasses.replace(knee.muscle1, law=law)
    joint = dataclasses.replace(knee, muscle1=bent, muscle2=bent)
    control = InverseModelControl(loops(joint, 5.0), load)

    @jax.jit
    def stepped(motion, pressures):
        differential, cocontraction = control._modelled(motion, pressures, PERIOD)
        return joint.torque_and_stiffness(motion.angle, pressures), (
            cocontraction - differential,
            cocontraction + differential,
        )

    def motion(stiffness):
        return Motion(*map(jnp.asarray, (0.05, 0.3, 2.0, stiffness)))

    stiffness = float(stepped(motion(15.0), (jnp.asarray(3.0e5), jnp.asarray(3.3e5)))[0][1])
    pressures = jnp.asarray(2.8e5), jnp.asarray(3.2e5)
    for _ in range(5):
        reached, pressures = stepped(motion(stiffness), pressures)
    wanted = float(load.total_inertia) * 2.0 + load.damping * 0.3 - float(load.gravity_torque(0.05))
    assert tuple(map(float, reached)) == pytest.approx((wanted, stiffness), rel=1e-5)


def test_numbers_that_make_no_sense_are_named(knee, load):
    with pytest.raises(RangeError, match=r"loops is a Load.*swapped"):
        InverseModelControl(load, loops(knee))
    with pytest.raises(RangeError, match="learning_rate is -1"):
        InverseModelControl(loops(knee), learning_rate=-1.0)
    with pytest.raises(RangeError, match="angle_scale is 0"):
        InverseModelControl(loops(knee), angle_scale=0.0)


def test_it_knows_no_plant():
    tree = ast.parse(inspect.getsource(inverse_model))
    names = {
        f"{node.module}.{alias.name}"
        for node in ast.walk(tree)
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
    }
    assert {n for n in names if n.startswith(("mckibben.plant", "mckibben.simulation"))} == {"mckibben.plant.Load"}
