"""A joint whose muscles creep: against SciPy, and its bound."""

import dataclasses
import math

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from mckibben.actuator import FirstOrderValve
from mckibben.control import Setpoint
from mckibben.errors import RangeError
from mckibben.joint import SeriesSpring
from mckibben.muscle import MaxwellCreep
from mckibben.numerics.compiled import numeric
from mckibben.plant import JointPlant
from mckibben.simulation.engine import run_alone
from mckibben.units import mm

PERIODS, PERIOD = 1000, 1e-3
P1, P2 = 4e5, 3.6e5
ARM = MaxwellCreep(3000.0, 0.2)


def with_creep(joint, arm=ARM, **changes):
    muscle = dataclasses.replace(joint.muscle1, creep=arm)
    return dataclasses.replace(joint, muscle1=muscle, muscle2=muscle, **changes)


def creep_of(state):
    """Shape (muscles, periods)."""
    return np.array([muscle.creep[0] for muscle in state.muscles])


@pytest.mark.parametrize("engine", ["native", pytest.param("xla", marks=pytest.mark.slow)])
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
    state = run_alone(engine, (plant, playback, held, numeric(start), jnp.asarray(PERIOD), 4))[0][1].state
    delayed = np.array([muscle.creep[1] for muscle in state.muscles])
    assert np.ptp(expected[0]) > math.radians(1) and np.ptp(expected[4:6], axis=1).min() > 4e4
    np.testing.assert_allclose(state.angle, expected[0], atol=1e-8)
    np.testing.assert_allclose(creep_of(state), expected[2:4], atol=1e-5)
    np.testing.assert_allclose(delayed, expected[4:6], atol=0.5)


def test_creep_holds_at_most_half_of_the_tension(ideal_plant, knee, load, playback, short_episode, paper_precontracted):
    """A swing at low pressures, at which the muscles go slack."""
    pressures, paper = (1.2e5, 0.9e5), paper_precontracted
    plant = numeric(JointPlant(with_creep(knee), load, ideal_plant.valve))
    start = numeric(plant.init_state(math.radians(15), pressures)._replace(velocity=jnp.asarray(0.3)))
    held = Setpoint(*(jnp.full(PERIODS, p) for p in pressures))
    state = short_episode(plant, playback, held, start, jnp.asarray(PERIOD), 4)[1].state
    angles = np.asarray(state.angle)
    tensions = np.array(
        [np.maximum(paper.eq3(c, p), 0) for c, p in zip(paper.contractions(angles), pressures, strict=True)]
    )
    assert tensions.min() == 0 and np.abs(creep_of(state)).max() > 1
    assert np.all(np.abs(creep_of(state)) <= tensions / 2 + 1e-9)


def test_a_series_spring_is_refused(knee):
    with pytest.raises(RangeError, match="in series with a SeriesSpring: creep needs the rate"):
        with_creep(knee, tendon=SeriesSpring(stiffness=20e3, preload=10.0, travel=18 * mm))
