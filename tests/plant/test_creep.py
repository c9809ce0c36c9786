"""A joint whose muscles creep: against SciPy, its energy, its rest, beside friction, many at once, its derivatives."""

import dataclasses
import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import quad, solve_ivp

from mckibben.codegen.native import NativeFunction
from mckibben.control import PID, PositionStiffnessControl, Reference, Setpoint, Sine
from mckibben.errors import RangeError
from mckibben.joint import SeriesSpring
from mckibben.muscle import MaxwellCreep, MaxwellSlip, MuscleState, NoCreep
from mckibben.numerics.batching import batched_program
from mckibben.numerics.compiled import numeric
from mckibben.plant import FirstOrderValve, JointPlant, PlantState
from mckibben.plant.joint_plant import Motion
from mckibben.simulation import compiled_episode, episode, simulate
from mckibben.simulation.engine import compute_with
from mckibben.units import mm

PERIODS, PERIOD = 1000, 1e-3
P1, P2 = 4e5, 3.6e5
ARM = MaxwellCreep(3000.0, 0.2)
SLIP = MaxwellSlip(12.0, 0.5 * mm, elements=2)


def with_creep(joint, arm=ARM, slip=None, **changes):
    given = {"creep": arm} | ({"friction": slip} if slip else {})
    muscle = dataclasses.replace(joint.muscle1, **given)
    return dataclasses.replace(joint, muscle1=muscle, muscle2=muscle, **changes)


@pytest.fixture(scope="module")
def creeping(ideal_plant, knee, load):
    return numeric(JointPlant(with_creep(knee), load, ideal_plant.valve))


def creep_of(state):
    """Shape (muscles, periods)."""
    return np.array([muscle.creep[0] for muscle in state.muscles])


@pytest.fixture(scope="module")
def swing(creeping, playback, short_episode):
    """At held pressures, from a state; all with one program."""

    def run(start, *, damping, pressures=(P1, P2)):
        held = Setpoint(*(jnp.full(PERIODS, p) for p in pressures))
        chosen = eqx.tree_at(lambda p: p.load.damping, creeping, jnp.asarray(damping))
        start = numeric(chosen.complete_state(jax.tree.map(jnp.asarray, start)))
        return short_episode(chosen, playback, held, start, jnp.asarray(PERIOD), 4)[1].state

    return run


def test_it_moves_as_scipy_has_it(swing, paper_precontracted):
    paper = paper_precontracted

    def rate(_, y):
        angle, velocity, x1, x2 = y
        arm1, arm2 = paper.eq5(angle, math)
        torque = paper.torque(angle, (P1, P2)) + x2 * arm2 - x1 * arm1 + paper.G * math.sin(math.pi / 6 - angle)
        return (
            velocity,
            (torque - 0.02 * velocity) / paper.inertia,
            3000 * arm1 * velocity - x1 / 0.2,
            -3000 * arm2 * velocity - x2 / 0.2,
        )

    times = np.arange(PERIODS) * PERIOD
    start = (math.radians(12), 0.5, 0.0, 0.0)
    expected = solve_ivp(rate, (0, times[-1]), start, t_eval=times, rtol=1e-10, atol=1e-12, method="DOP853").y
    state = swing(PlantState(*start[:2], (P1, P2)), damping=0.02)
    assert np.abs(expected[2:]).max() > 5 and np.ptp(expected[0]) > math.radians(8)
    np.testing.assert_allclose(state.angle, expected[0], atol=1e-8)
    np.testing.assert_allclose(creep_of(state), expected[2:], atol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("engine", ["native", "xla"])
def test_creep_after_steps_of_the_pressure_moves_as_scipy_has_it(engine, knee, load, playback, paper_precontracted):
    """Lags of the valves, delayed pressures and the equation of motion, by Eqs. 3 and 5 written out."""
    paper, share, delay, lag, steps = paper_precontracted, 0.12, 0.3, 0.02, (4.8e5, 4.6e5)
    arm = MaxwellCreep(3000.0, 0.2, pressure_share=share, pressure_time_constant=delay)
    plant = numeric(JointPlant(with_creep(knee, arm), load, FirstOrderValve(lag)))

    def rate(_, y):
        angle, velocity, x1, x2, y1, y2, p1, p2 = y
        arms = paper.eq5(angle, math)
        pulls = []
        for contraction, p, x, held in zip(paper.contractions(angle, math), (p1, p2), (x1, x2), (y1, y2), strict=True):
            tension = paper.eq3(contraction, p, math)
            pulls.append(tension + x + share * (paper.eq3(contraction, held, math) - tension))
        torque = pulls[1] * arms[1] - pulls[0] * arms[0] + paper.G * math.sin(math.pi / 6 - angle)
        return (
            velocity,
            (torque - float(load.damping) * velocity) / paper.inertia,
            3000 * arms[0] * velocity - x1 / 0.2,
            -3000 * arms[1] * velocity - x2 / 0.2,
            (p1 - y1) / delay,
            (p2 - y2) / delay,
            (steps[0] - p1) / lag,
            (steps[1] - p2) / lag,
        )

    times = np.arange(PERIODS) * PERIOD
    start = plant.init_state(0.0, (P1, P2))
    first = (0.0, 0.0, 0.0, 0.0, P1, P2, P1, P2)
    expected = solve_ivp(rate, (0, times[-1]), first, t_eval=times, rtol=1e-11, atol=1e-9, method="DOP853").y
    held = Setpoint(*(jnp.full(PERIODS, p) for p in steps))
    parts = (plant, playback, held, numeric(start), jnp.asarray(PERIOD), 4)
    natively = NativeFunction(lambda parts, _: episode(*parts))
    state = compute_with(engine, lambda: natively(parts), lambda: compiled_episode(*parts))[0][1].state
    delayed = np.array([muscle.creep[1] for muscle in state.muscles])
    assert np.ptp(expected[0]) > math.radians(1) and np.ptp(expected[4:6], axis=1).min() > 4e4
    np.testing.assert_allclose(state.angle, expected[0], atol=1e-8)
    np.testing.assert_allclose(creep_of(state), expected[2:4], atol=1e-5)
    np.testing.assert_allclose(delayed, expected[4:6], atol=0.5)


@pytest.mark.parametrize("pressures", [(P1, P2), (1.2e5, 0.9e5)])  # the second goes slack and meets the bound
def test_a_free_swing_only_loses_energy(swing, paper_precontracted, pressures):
    paper = paper_precontracted
    state = swing(PlantState(math.radians(15), 0.3, pressures), damping=0.0, pressures=pressures)
    every = slice(None, None, 25)
    angles, velocities = np.asarray(state.angle)[every], np.asarray(state.velocity)[every]
    work = [quad(lambda a: paper.torque(a, pressures), 0, x, epsabs=1e-11, epsrel=1e-11, limit=200)[0] for x in angles]
    stored = sum(np.asarray(x)[every] ** 2 / (2 * ARM.stiffness) for x in creep_of(state))
    total = paper.inertia * velocities**2 / 2 - np.array(work) - paper.G * np.cos(np.pi / 6 - angles) + stored
    assert np.diff(total).max() < 1e-6 * (total[0] - total[-1])
    assert total[0] - total[-1] > 5e-3
    tensions = np.array(
        [np.maximum(paper.eq3(c, p), 0) for c, p in zip(paper.contractions(angles), pressures, strict=True)]
    )
    assert (tensions.min() == 0) == (pressures[1] < 1e5)
    assert np.all(np.abs(creep_of(state)[:, every]) <= tensions / 2 + 1e-9)


def test_it_comes_to_rest_where_the_laws_alone_would(swing, creeping):
    rest = creeping.equilibrium(0.1)
    assert jax.tree.leaves(rest.muscles) == [0.0, 0.0] and rest.muscles[0].friction == ()
    np.testing.assert_allclose(jax.tree.leaves(creeping.rate(rest)), 0.0, atol=1e-9)
    pressures = tuple(map(float, rest.pressures))
    state = swing(PlantState(0.1 + 0.02, 0.0, pressures), damping=2.0, pressures=pressures)
    assert abs(float(state.angle[-1]) - 0.1) < 0.02 * 0.02
    assert np.abs(creep_of(state)).max() > 0.5 > 5 * np.abs(creep_of(state)[:, -1]).max()


def test_a_quick_turn_meets_more_than_the_law(creeping):
    """Creep resists a quick turn with its stiffness at the moment arms, and nothing a while after."""
    joint, (p1, p2) = creeping.joint, (P1, P2)
    arm1, arm2 = map(float, joint.geometry.moment_arms(0.0))
    rates = joint.state_rate(joint.init_state(0.0, (p1, p2)), 0.0, 1.0, (p1, p2))
    after = jax.tree.map(lambda x: x * 1e-3, rates)  # after a turn of a milliradian
    torque = float(joint.creep_torque(0.0, (p1, p2), after))
    assert torque == pytest.approx(-3000.0 * (arm1**2 + arm2**2) * 1e-3, rel=1e-9)
    whole = joint.forces(0.0, 0.0, (p1, p2), after)
    assert float(whole.torque) == pytest.approx(float(joint.torque(0.0, (p1, p2))) + torque, rel=1e-12)
    assert float(joint.friction_torque(0.0, 0.0, (p1, p2), after)) == pytest.approx(0, abs=1e-12)


def test_a_series_spring_is_refused(knee):
    with pytest.raises(RangeError, match="in series with a SeriesSpring: creep needs the rate"):
        with_creep(knee, tendon=SeriesSpring(stiffness=20e3, preload=10.0, travel=18 * mm))


def test_without_creep_there_is_no_state(plant):
    state = plant.equilibrium(0.1)
    assert jax.tree.leaves(state.muscles) == [] and plant.project(state) == state
    assert len(jax.tree.leaves(state)) == 4


@pytest.fixture(scope="module")
def both(ideal_plant, knee, load):
    """Creep beside friction."""
    joint = with_creep(knee, MaxwellCreep(1000.0, 0.3, arms=2), SLIP)
    return numeric(JointPlant(joint, load, ideal_plant.valve))


@pytest.mark.slow
def test_many_runs_are_the_same_as_one(both, playback):
    held = Setpoint(jnp.full(100, P1), jnp.full(100, P2))
    start = both.complete_state(PlantState(*map(jnp.asarray, (0.1, 0.8)), (jnp.asarray(P1), jnp.asarray(P2))))
    assert [len(leaves) for muscle in start.muscles for leaves in muscle] == [2, 2, 2, 2]

    def final(stiffness):
        plant = eqx.tree_at(lambda p: p.joint.muscle1.creep.stiffness, both, stiffness)
        return episode(plant, playback, held, start, PERIOD, 1)[0]

    stiffness = jnp.array([500.0, 1000.0, 4000.0])
    with batched_program():
        many = jax.jit(jax.vmap(final))(stiffness)
    one = jax.jit(final)
    for k in range(3):
        for whole, alone in zip(jax.tree.leaves(many), jax.tree.leaves(one(stiffness[k])), strict=True):
            np.testing.assert_allclose(whole[k], alone, rtol=1e-9, atol=1e-11)
    assert np.ptp(many.angle) > 1e-4


@pytest.mark.slow
def test_a_result_tells_creep_and_friction_apart(both):
    control = PositionStiffnessControl(PID(1e5, 2e5, 0.1e5), PID(-1e4, -5e4, 0.0), model=both.joint)
    plant = dataclasses.replace(both, valve=FirstOrderValve(0.02))
    columns = simulate(plant, control, Reference(angle=Sine(0.1, 2.0), stiffness=15.0), duration=0.3).columns
    law = np.asarray(both.joint.torque(columns["angle"], (columns["pressure1"], columns["pressure2"])))
    parts = columns["friction_torque"] + columns["creep_torque"]
    np.testing.assert_allclose(columns["torque"], law + parts, atol=1e-9)
    assert np.abs(columns["creep_torque"]).max() > 0.01 and np.abs(columns["friction_torque"]).max() > 0.2
    contraction, pressure = columns["contraction1"], columns["pressure1"]
    added = columns["force1"] - np.asarray(both.joint.muscle1.force(contraction, pressure))
    assert np.abs(added).max() > 5  # forces contain both


def test_the_friction_torque_of_relaxed_muscles_is_without_creep(both, knee):
    """What `friction_compensation` asks of the model's joint."""
    with_slip = with_creep(knee, NoCreep(), SLIP)
    joint = both.joint
    states = joint.update_state(joint.init_state(0.0, (P1, P2)), 0.05, (P1, P2))
    alone = tuple(MuscleState(state.friction) for state in states)
    expected = with_slip.friction_torque(0.06, 0.0, (P1, P2), alone)
    assert float(joint.friction_torque(0.06, 0.0, (P1, P2), states)) == pytest.approx(float(expected))
    assert float(expected) < -0.1


@pytest.mark.slow
def test_a_derivative_is_that_of_a_small_change(creeping):
    start = creeping.complete_state(PlantState(*map(jnp.asarray, (0.1, 0.8)), (jnp.asarray(P1), jnp.asarray(P2))))

    @jax.jit
    def angle(stiffness, time_constant):
        def chosen(p):
            return p.joint.muscle1.creep.stiffness, p.joint.muscle1.creep.time_constant

        plant = eqx.tree_at(chosen, creeping, (stiffness, time_constant))

        def euler(_, state):
            before = Motion.of(state)
            after = jax.tree.map(lambda x, dx: x + 5e-4 * dx, before, plant.rate(state))
            return plant.project(after.applied_to(state, state.pressures))

        return jax.lax.scan(lambda s, _: (euler(None, s), None), start, None, length=200)[0].angle

    slopes = jax.jit(jax.jacfwd(angle, argnums=(0, 1)))(jnp.asarray(3000.0), jnp.asarray(0.2))
    for k, small in enumerate((0.1, 1e-5)):
        up, down = ([3000.0, 0.2], [3000.0, 0.2])
        up[k], down[k] = up[k] + small, down[k] - small
        quotient = (angle(*map(jnp.asarray, up)) - angle(*map(jnp.asarray, down))) / (2 * small)
        assert float(slopes[k]) == pytest.approx(float(quotient), rel=1e-5) and abs(float(slopes[k])) > 1e-7
