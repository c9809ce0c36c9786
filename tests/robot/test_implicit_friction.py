"""Steps that are implicit in the slip of the foot: the same motion, in steps that friction does not limit."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import mckibben as mk
from mckibben import robot as robots
from mckibben.errors import SimulationError
from mckibben.numerics.batching import batched_program
from mckibben.plant.base import Motion
from mckibben.robot.dynamics import motion
from mckibben.units import deg, mm, ms

ANGLES = 2 * deg, 2 * deg, -5 * deg


AIR = robots.RobotScenario.read("examples/robot/lei-leg-in-space.yaml").valve


def with_ground(ground, valve=None):
    """The catalog's robot in space, as it touches the ground with a middle stiffness."""
    robot = robots.read_robot("lei-leg")
    pressures = robot.pressures_for(ANGLES, (0.0,) * 3, (None, None, 17.0))
    return robots.RobotPlant(robot, valve or mk.FirstOrderValve(20 * ms), ground), robots.RobotStart(
        ANGLES, pressures, 0.0, -0.9
    )


def pressed(plant, start):
    """The start with the foot 3 mm in the ground."""
    state = plant.begin(start)
    return state._replace(posture=state.posture._replace(z=state.posture.z - 3 * mm))


def numbers(position, velocity):
    return jnp.stack([position.z, *position.angles, velocity.z, *velocity.angles])


@jax.jit
def slope(plant, state, y):
    posture = state.posture._replace(z=y[0], angles=tuple(y[1:4]))
    velocity = state.velocity._replace(z=y[4], angles=tuple(y[5:]))
    moving = plant.rate(state._replace(posture=posture, velocity=velocity))
    return numbers(moving.position, moving.velocity)


slopes = jax.jit(jax.jacfwd(slope, argnums=2))


@jax.jit
def moved(plant, state, duration, count):
    with batched_program():  # compiles in a fraction of the time
        after = plant.advance(state, state.pressures, duration, count)
    return numbers(after.posture, after.velocity)


@pytest.mark.slow
@pytest.mark.parametrize("slip_speed", [100 * mm, 10 * mm])
def test_the_motion_is_that_of_a_stiff_solver(slip_speed):
    plant, start = with_ground(robots.Ground(slip_speed=slip_speed, implicit_friction=True))
    state, duration = pressed(plant, start), 4 * ms
    solved = solve_ivp(
        lambda _, y: np.asarray(slope(plant, state, y)),
        (0, duration),
        np.asarray(numbers(state.posture, state.velocity)),
        method="Radau",
        jac=lambda _, y: np.asarray(slopes(plant, state, y)),
        rtol=1e-10,
        atol=1e-12,
    )
    ends = (moved(plant, state, duration, count) for count in (8, 32, 64, 128))
    errors = [np.abs(np.asarray(one) - solved.y[:, -1]).max() for one in ends]
    assert errors[0] < 1e-3  # rad/s; steps of 0.5 ms
    assert errors[-1] < errors[0] / 20
    if slip_speed == 100 * mm:  # at 10 mm/s all of these steps are long for the friction
        assert np.all(np.log2(np.array(errors[1:-1]) / errors[2:]) > 2.5)


@pytest.mark.slow
@pytest.mark.parametrize("freedom", ["vertical", "fixed"])
def test_friction_takes_energy_in_stages_of_any_length(freedom):
    rng = np.random.default_rng(5)
    plant, start = with_ground(robots.Ground(slip_speed=1 * mm, implicit_friction=True))
    plant = dataclasses.replace(plant, robot=dataclasses.replace(plant.robot, base=freedom))
    start = start._replace(upward_speed=0.0 if freedom == "fixed" else start.upward_speed)
    free = dataclasses.replace(plant, ground=dataclasses.replace(plant.ground, friction=0.0))

    @jax.jit
    def energy(plant, state, length):
        change = plant.rate(state, ahead=(Motion.of(state), length)).velocity
        after = jax.tree.map(lambda one, rate: one + length * rate, state.velocity, change)
        return motion(plant.robot, state.posture, after, plant.gravity).kinetic

    state = pressed(plant, start)
    lost = []
    for length in 10.0 ** rng.uniform(-5, 0, 30):
        velocity = state.velocity._replace(angles=tuple(map(jnp.asarray, rng.normal(0.0, 5.0, 3))))
        moving = state._replace(velocity=velocity)
        left, without = (float(energy(one, moving, length)) for one in (plant, free))
        assert left <= without * (1 + 1e-12)
        lost.append(1 - left / without)
    assert max(lost) > 0.01


@pytest.mark.slow
@pytest.mark.parametrize("valve", [None, AIR])
def test_friction_does_not_limit_the_step(valve):
    ground = robots.Ground(slip_speed=30 * mm)
    plant, start = with_ground(ground, valve)
    implicit = dataclasses.replace(plant, ground=dataclasses.replace(ground, implicit_friction=True))
    schedule = robots.PressureSchedule(tuple((one,) for one in start.pressures))
    given = {"duration": 0.1, "control_period": 2 * ms}
    fine = robots.simulate_robot(plant, schedule, start, substeps=64, **given)
    run = robots.simulate_robot(implicit, schedule, start, substeps=3, **given)
    assert np.abs(run["angle"] - fine["angle"]).max() < 0.03 * deg
    assert run["ground_up"].max() == pytest.approx(fine["ground_up"].max(), rel=2e-3)
    with pytest.raises(SimulationError) as caught:
        robots.simulate_robot(plant, schedule, start, substeps=3, **given)
    assert (caught.value.field, caught.value.lower) == ("substeps", 8)
    assert "implicit_friction" in caught.value.remedy
