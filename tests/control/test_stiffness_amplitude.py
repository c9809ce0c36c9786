"""Controllers that hold the stiffness of a motion of a given size: a test of the joint afterwards meets it."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest

import mckibben as mk
from mckibben.control import Setpoint
from mckibben.errors import ReachabilityWarning
from mckibben.numerics.compiled import numeric
from mckibben.units import deg, mm, ms

PERIODS, PERIOD = 800, 2e-3
ANGLE, SIZE, ASKED = 3 * deg, 1 * deg, 38.0
PI = mk.PID(kp=2e5, ki=60e5, kd=0.2e5), mk.PID(kp=0.1e5, ki=8e5, kd=0.0)


@pytest.fixture(scope="module")
def joint(knee):
    muscle = dataclasses.replace(knee.muscle1, friction=mk.MaxwellSlip(7.5, 0.5 * mm))
    return dataclasses.replace(knee, muscle1=muscle, muscle2=muscle)


@pytest.fixture(scope="module")
def plant(joint, load):
    return mk.JointPlant(joint, load, mk.FirstOrderValve(20 * ms))


@pytest.fixture(scope="module")
def settle(plant, short_episode):
    """State of the plant after the setpoint was held under a controller, and the last estimate of the stiffness."""

    def settle(controller, stiffness=ASKED):
        setpoints = Setpoint(jnp.full(PERIODS, ANGLE), jnp.full(PERIODS, stiffness))
        parts = numeric((plant, controller, setpoints, plant.equilibrium(ANGLE), jnp.asarray(PERIOD)))
        final, record = short_episode(*parts, 4)
        return final, float(record.telemetry["stiffness_estimate"][-1])

    return settle


def met(plant, state):
    """Stiffness that a slow motion about the angle meets at the pressures of a state."""
    held = dataclasses.replace(plant, valve=mk.IdealValve())
    return float(mk.dynamic_stiffness(held, state, SIZE, 1.0).stiffness[0, 0])


def controllers(joint, load):
    loops = mk.PositionStiffnessControl(*PI, model=joint, minimum_tension=5.0, stiffness_amplitude=SIZE)
    model = {"valve": mk.FirstOrderValve(20 * ms), "stiffness_amplitude": SIZE}
    return {
        "PID": loops,
        "inverse model": mk.InverseModelControl(loops, load),
        "decoupling": mk.DecouplingControl(
            joint, load, mk.PolePlacement(40.0), mk.ExtendedStateObserver(120.0), **model
        ),
        "predictive": mk.PredictiveControl(joint, load, mk.ExtendedStateObserver(120.0), bandwidth=40.0, **model),
    }


@pytest.mark.slow
@pytest.mark.parametrize("name", ["PID", "inverse model", "decoupling", "predictive"])
def test_a_motion_of_the_size_meets_the_stiffness_asked_for(joint, load, plant, settle, name):
    controller = controllers(joint, load)[name]
    state, estimate = settle(controller)
    assert float(state.angle) == pytest.approx(ANGLE, abs=0.05 * deg)
    assert met(plant, state) == pytest.approx(ASKED, rel=5e-3)
    assert estimate == pytest.approx(ASKED, rel=5e-3)
    isobaric = float(joint.stiffness(state.angle, state.pressures))
    assert isobaric < ASKED - 15  # friction adds the rest


def test_a_wrapper_controls_what_the_controller_in_it_does(joint, load):
    loops = controllers(joint, load)["PID"]
    delayed = mk.DelayCompensation(joint, load, controller=loops, command_delay=5 * ms)
    for wrapper in (delayed, mk.InverseModelControl(loops, load)):
        assert (wrapper.stiffness_amplitude, wrapper.minimum_tension) == (SIZE, 5.0)


@pytest.mark.slow
def test_a_simulation_compares_the_stiffness_of_that_size(joint, load, plant):
    controller = controllers(joint, load)["PID"]
    short = {"duration": 0.8, "control_period": PERIOD}
    result = mk.simulate(plant, controller, mk.Reference(ANGLE, ASKED), **short)  # attainable: no warning
    assert result["stiffness"][-1] == pytest.approx(ASKED, rel=0.02)
    at_end = float(result["angle"][-1]), (float(result["pressure1"][-1]), float(result["pressure2"][-1]))
    assert result["stiffness"][-1] == pytest.approx(float(joint.secant_stiffness(*at_end, SIZE)), rel=1e-6)
    with pytest.warns(ReachabilityWarning):  # friction adds more than that
        mk.simulate(plant, controller, mk.Reference(ANGLE, 15.0), **short)
    batch = mk.simulate_many(
        plant, controller, mk.Reference(ANGLE, np.array([ASKED, 36.0])), **short, metrics=("stiffness_rmse",)
    )
    assert float(batch.table["stiffness_rmse"][0]) == pytest.approx(result.metrics["stiffness_rmse"], rel=1e-6)
