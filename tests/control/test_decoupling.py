"""Control by inversion in closed loop: exact where the model is, and what is left where nothing is as it believes."""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import mckibben as mk
from mckibben.control import Measurement, Setpoint
from mckibben.errors import RangeError
from mckibben.numerics.compiled import numeric
from mckibben.simulation import sampled
from mckibben.units import deg, mm
from tests.control.conftest import PERIOD, SINE, off, rmse


def eso(knee, load, bandwidth=60.0, observed=200.0, **more):
    return mk.DecouplingControl(knee, load, mk.PolePlacement(bandwidth), mk.ExtendedStateObserver(observed), **more)


@pytest.fixture(scope="module")
def controllers(knee, load):
    return {
        "observer": eso(knee, load),
        "integral": mk.DecouplingControl(knee, load, mk.PolePlacement(60.0, integral=True), mk.VelocityObserver(200.0)),
        "sliding": mk.DecouplingControl(knee, load, mk.SlidingMode(40.0, 250.0), mk.ExtendedStateObserver(200.0)),
        "predictive": mk.PredictiveControl(knee, load, mk.ExtendedStateObserver(200.0), bandwidth=60.0),
    }


@pytest.fixture(scope="module")
def run(follow):
    return functools.partial(follow, 2.0)


@pytest.fixture(scope="module")
def tracked(run, plant, controllers):
    return {name: run(plant, controllers[name]) for name in ("observer", "integral", "sliding")}


@pytest.mark.parametrize("name", ["observer", "integral", "sliding"])
@pytest.mark.slow
def test_with_a_right_model_there_is_next_to_no_error(tracked, plant, name):
    record, _ = tracked[name]
    assert rmse(tracked[name]) < 0.01
    stiffness = plant.joint.stiffness(record.state.angle, record.state.pressures)
    assert float(jnp.abs(stiffness - 15.0)[100:].max()) < 0.1


@pytest.mark.slow
def test_the_loop_is_the_linear_one_that_was_designed(run, plant, controllers):
    """All poles at 60 rad/s: after a step the error is (1 + wt + (wt)^2/2) e^-wt of it."""
    error = -off(run(plant, controllers["observer"], mk.Step(0.0, 0.5 * deg, 0.1)))[100:400]
    wt = 60.0 * PERIOD * np.arange(300)
    np.testing.assert_allclose(error, 0.5 * (1 + wt + wt**2 / 2) * np.exp(-wt), atol=0.015)


@pytest.mark.slow
def test_a_step_of_stiffness_hardly_moves_the_angle(run, plant, controllers, knee, load):
    """From next to the lowest to next to the highest attainable, while moving; a tenth of the PID's is asked for."""
    low, high = (float(k) for k in knee.attainable_stiffness(0.0, -load.gravity_torque(0.0), minimum_tension=5.0))
    setpoint = SINE, mk.Step(low + 0.1, high - 0.1, 1.5)  # at 0 deg on the way back
    pid = mk.PositionStiffnessControl(mk.PID(2e5, 60e5, 0.4e5), mk.PID(0.08e5, 5e5, 0.0), model=knee)

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
        assert (
            rmse((record, sampled(mk.Reference(angle=SINE, stiffness=15.0), 2.0, PERIOD)[1])) < 0.02
        )  # the torque first


@pytest.mark.slow
def test_a_wrong_load_leaves_no_error_at_rest(run, knee, load, plant, controllers):
    heavy = mk.JointPlant(knee, dataclasses.replace(load, mass2=0.75), plant.valve)
    for name in ("observer", "integral", "predictive"):
        answer = run(heavy, controllers[name], mk.Constant(0.1))
        assert abs(off(answer)[-1]) < 1e-3
        weight = float(heavy.load.gravity_torque(0.1) - load.gravity_torque(0.1))
        if name != "integral":
            assert float(answer[0].telemetry["disturbance_estimate"][-1]) == pytest.approx(weight, rel=1e-3)


@pytest.mark.slow
def test_nothing_winds_up_while_the_torque_is_out_of_reach(run, plant, controllers):
    """A step of 40 deg asks for more than the muscles have; it is not overshot by what was out of reach meanwhile."""
    for name, most in (("observer", 21.5), ("integral", 21.5), ("predictive", 23.0)):
        angle = np.asarray(run(plant, controllers[name], mk.Step(-20 * deg, 20 * deg, 0.1))[0].state.angle) / deg
        assert angle.max() < most
        assert angle[-1] == pytest.approx(20.0, abs=0.01)


@pytest.mark.slow
def test_expected_friction_is_part_of_the_torque(knee, load):
    """Drawn along the setpoint it is made up for at once, and the observer is told of it."""
    rubbing = dataclasses.replace(knee.muscle1, friction=mk.MaxwellSlip(12.0, 0.5 * mm, elements=1))
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
    (motion,) = state.estimates.motion
    acceleration = 60.0**2 / 3 * 0.018 - float(motion.disturbance) - 60.0 * float(motion.velocity)
    balance = float(load.total_inertia) * acceleration - float(load.gravity_torque(0.0)) - expected
    assert float(knee.torque(0.0, tuple(aimed))) == pytest.approx(balance, abs=2e-3)
    assert float(motion.known) == pytest.approx(expected / float(load.total_inertia), rel=1e-3)
    with pytest.raises(RangeError, match="no muscle of its model has friction"):
        eso(knee, load, friction_compensation=True)


def test_sliding_mode_is_bounded_outside_its_layer_and_linear_inside():
    law = mk.SlidingMode(40.0, 80.0)
    assert float(law.step((), 0.001, 0.02, 1e6, PERIOD)[1]) == pytest.approx(40 * 0.02 + 40 * (0.02 + 0.04))
    assert float(law.step((), 1.0, 0.0, 1e6, PERIOD)[1]) == 80.0
    with pytest.raises(RangeError, match="reach is 0 rad/s"):
        mk.SlidingMode(reach=0.0)


@pytest.mark.parametrize(
    ("law", "ratio"),
    [(mk.PolePlacement(30.0), 9), (mk.PolePlacement(30.0, damping=2.0), 4), (mk.SlidingMode(30.0, 80.0), 12)],
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
    law = mk.PolePlacement(30.0, integral=integral, damping=damping)
    by_error, by_rate = float(law.step(0.0, 1.0, 0.0, 1e9, 1e-9)[1]), float(law.step(0.0, 0.0, 1.0, 1e9, 1e-9)[1])
    by_integral = float(law.step(0.0, 1.0, 0.0, 1e9, 1.0)[0])
    polynomial = [law.lag, 1.0, by_rate, by_error, *([by_integral] if integral else [])]
    real = [-30.0] * (len(polynomial) - 3)
    expected = np.polymul(np.poly(real), [1.0, (damping - 1) * 30.0, 30.0**2])
    np.testing.assert_allclose(np.divide(polynomial, law.lag), expected, rtol=1e-6)
