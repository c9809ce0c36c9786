"""Controllers with a model of the valves, on valves that let air in, and with commands that arrive late."""

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest

import mckibben as mk
from mckibben.actuator import PressureRegulator
from mckibben.control import ExtendedStateObserver, PressureObserver
from mckibben.control import base as control_base
from mckibben.errors import McKibbenError, RangeError, ReachabilityWarning
from mckibben.muscle.air import L_PER_S_BAR
from mckibben.plant import SampledSensors
from mckibben.simulation import Outcome
from mckibben.units import bar, deg, kPa, ms

SINE = mk.Reference(angle=mk.Sine(6 * deg, 1.0, 0.0, np.pi / 2), stiffness=15.0)
SENSORS = SampledSensors(encoder=0.022 * deg, pressure_noise=4 * kPa)
VALVES = {  # by the conductance in L/(s*bar) and the lag
    conductance: PressureRegulator(conductance * L_PER_S_BAR, 8 * bar, time_constant=lag)
    for conductance, lag in ((0.4, 8 * ms), (0.12, 8 * ms), (0.05, 8 * ms), (0.025, 30 * ms))
}


def observers(bandwidth):
    return {"observer": ExtendedStateObserver(3 * bandwidth, damping=2.0), "pressure_observer": PressureObserver(200.0)}


@pytest.fixture(scope="module")
def make(knee, load):
    def make(kind, valve, bandwidth, **more):
        given = observers(bandwidth) | {"valve": valve} | more
        if kind == "predictive":
            return mk.PredictiveControl(knee, load, bandwidth=bandwidth, **given)
        return mk.DecouplingControl(knee, load, mk.PolePlacement(bandwidth, damping=2.5), **given)

    return make


@pytest.fixture(scope="module")
def run(knee, load):
    def run(valve, control, reference=SINE, **more):
        plant = mk.JointPlant(knee, load, valve, sensors=SENSORS, **more)
        return mk.simulate(plant, control, reference, duration=2.0, substeps=4)

    return run


def settled(result):
    """RMS error of the angle [rad] after the start, which no command reaches in time."""
    return float(np.sqrt(np.mean((result["angle"] - result["desired_angle"])[1000:] ** 2)))


@pytest.mark.parametrize("kind", ["decoupling", "predictive"])
@pytest.mark.parametrize("conductance", [0.4, 0.025])
@pytest.mark.slow
def test_valves_with_air_are_controlled_as_well_as_lags(run, make, kind, conductance):
    result = run(VALVES[conductance], make(kind, VALVES[conductance], 60.0))
    assert not result.outcome.failed and result.outcome is not Outcome.LIMIT_CYCLE
    assert result.metrics["angle_rmse"] < 0.15 * deg
    assert result.metrics["stiffness_rmse"] < 0.1


@pytest.mark.slow
def test_a_step_too_fast_for_the_valves_is_braked_in_time(run, make):
    """A regulator of 0.0091 L/(s*bar), as in the paper: bandwidths that its flow allows for small errors alone."""
    valve = mk.catalog.valve("smc-itv0050", supply=8 * bar)
    step = mk.Reference(angle=mk.Step(-8 * deg, 8 * deg, 0.1), stiffness=15.0)
    for bandwidth in (20.0, 60.0):
        result = run(valve, make("decoupling", valve, bandwidth), step)
        assert result.outcome is not Outcome.LIMIT_CYCLE and not result.outcome.failed
        assert result["angle"].max() < 9 * deg
        assert abs(result["angle"][-1] - 8 * deg) < 0.3 * deg


@pytest.mark.slow
def test_the_supply_of_the_model_limits_the_pressures(run, make):
    """At a stiffness that needs more than the supply the angle is kept, and no integral winds up."""
    valve = dataclasses.replace(VALVES[0.12], supply=4 * bar)
    reference = mk.Reference(angle=SINE.angle, stiffness=16.5)
    with pytest.warns(ReachabilityWarning):
        result = run(valve, make("decoupling", valve, 40.0), reference)
    assert result.metrics["angle_rmse"] < 0.5 * deg
    assert max(result["command1"].max(), result["command2"].max()) <= 4 * bar


@pytest.mark.parametrize("delay", [4.5 * ms, 16 * ms])
@pytest.mark.slow
def test_a_known_delay_of_the_commands_is_compensated(run, make, delay):
    valve = mk.FirstOrderValve(20 * ms)
    inner = make("decoupling", valve, 60.0)
    control = dataclasses.replace(inner, command_delay=delay)
    late = run(valve, control, command_delay=delay)
    assert late.outcome is not Outcome.LIMIT_CYCLE
    assert settled(late) < 2.5 * settled(run(valve, inner))
    if delay >= 8 * ms:
        assert settled(late) < 0.2 * settled(run(valve, inner, command_delay=delay))


def test_a_model_of_valves_that_lacks_a_number_is_refused(make, knee):
    class Unknown(mk.FirstOrderValve):
        """First-order valve whose time constant a controller does not know."""

        lag = None

    with pytest.raises(RangeError) as caught:
        make("decoupling", Unknown(20 * ms), 60.0)
    assert caught.value.field == "valve"
    bare = dataclasses.replace(knee.muscle1.specimen, initial_diameter=None, braid_angle=None)
    muscle = dataclasses.replace(knee.muscle1, specimen=bare)
    joint = dataclasses.replace(knee, muscle1=muscle, muscle2=muscle)
    with pytest.raises(McKibbenError, match="initial_diameter"):
        mk.DecouplingControl(joint, mk.catalog.load("knee-table-2"), mk.PolePlacement(60.0), valve=VALVES[0.05])


def test_a_valve_without_a_known_lag_is_not_inherited_as_a_model():
    """A file has to give one; `KeyError` says that there is nothing to inherit."""
    unknown, known = (SimpleNamespace(holds_air=False, lag=lag) for lag in (None, 0.02))
    with pytest.raises(KeyError):
        control_base._valve_model({"valve": unknown})
    assert control_base._valve_model({"valve": known}) is known
