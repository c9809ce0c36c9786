"""Delay of the commands and speed of the valves, estimated on line, on the pressures of simulated plants."""

import dataclasses
from pathlib import Path

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax

import mckibben as mk
from mckibben.actuator import FirstOrderValve, PressureRegulator, SecondOrderValve, UnequalValves
from mckibben.actuator.base import air_volumes
from mckibben.control import ActuatorAdaptation, DelayCompensation, OpenLoopControl, Samples
from mckibben.control.actuator_adaptation import with_speed
from mckibben.errors import RangeError
from mckibben.numerics.compiled import numeric
from mckibben.scenario import Scenario, run_scenario, with_values
from mckibben.units import bar, deg, kPa, litre, ms

EXAMPLE = Path(__file__).parents[2] / "examples" / "valves" / "regulator-decoupling.yaml"
PERIOD, DELAY, SENT, SECONDS = 1 * ms, 4 * ms, 16, 4.0
REGULATOR = PressureRegulator(
    0.05 * litre / bar, 8 * bar, time_constant=15 * ms, band=0.5 * bar, dead_volume=5e-6, polytropic_index=1.2
)
VALVES = {"air": REGULATOR, "first order": FirstOrderValve(20 * ms)}


def commands(periods, still):
    """Commands [Pa] of both valves, shape (periods, 2), constant until `still` s before the end."""
    times = np.arange(periods) * PERIOD
    waves = [np.sign(np.sin(2 * np.pi * rate * times)) + np.sin(2 * np.pi * 3.1 * rate * times) for rate in (1.3, 1.7)]
    moving = times < periods * PERIOD - still
    return 3 * bar + 0.4 * bar * np.stack(waves, axis=1) * moving[:, None]


@pytest.fixture(scope="module")
def estimated(knee, load):
    """Estimates over time on the pressures of a plant, shape (periods, 2): speed and delay [s]."""

    def estimated(valve, speed, delay, *, still=0.0, offset=0.0, adaptation=None, known=None):
        model = VALVES[valve]
        plant = mk.JointPlant(knee, load, with_speed(model, speed), command_delay=delay)
        sent = commands(round(SECONDS / PERIOD), still)
        times = np.arange(len(sent)) * PERIOD
        control = OpenLoopControl(*(Samples(times, column) for column in sent.T), knee)
        reference = mk.Reference(angle=0.0, stiffness=15.0)
        start = plant.init_state(0.0, (3 * bar, 3 * bar))
        run = mk.simulate(plant, control, reference, duration=SECONDS, initial=start, substeps=8)
        noise = np.random.default_rng(0).normal(0, 4 * kPa, sent.shape)
        measured = np.stack([run["pressure1"], run["pressure2"]], axis=1) + offset + noise
        rows = [sent, measured, run["angle"], run["velocity"]]
        found = _followed(
            *numeric((adaptation or ActuatorAdaptation(), known or model, knee)), tuple(map(jnp.asarray, rows))
        )
        return np.asarray(found).T

    return estimated


@eqx.filter_jit
def _followed(adaptation, model, joint, rows):
    def step(carry, row):
        state, sent = carry
        command, measured, angle, velocity = row
        air = (None, None)
        if model.holds_air:
            air = air_volumes(joint, angle, velocity, tuple(measured), dead_volumes=(REGULATOR.dead_volume,) * 2)
        state = adaptation.step(state, model, DELAY, sent, tuple(measured), air, PERIOD)
        return (state, ((command[0], command[1]), *sent[:-1])), (state.speed, state.delay)

    sent, measured, *_ = rows
    first = adaptation.init(model, DELAY, tuple(measured[0]))
    begun = ((sent[0, 0], sent[0, 1]),) * SENT
    return lax.scan(step, (first, begun), rows)[1]


@pytest.mark.parametrize(
    ("valve", "speed", "delay"),
    [
        ("first order", 0.7, 6.5 * ms),
        pytest.param("air", 1.3, 2 * ms, marks=pytest.mark.slow),
        pytest.param("air", 1.0, 4 * ms, marks=pytest.mark.slow),
    ],
)
def test_the_estimates_converge_to_the_plant(estimated, valve, speed, delay):
    found = estimated(valve, speed, delay, offset=10 * kPa)[-1]
    assert found[0] == pytest.approx(speed, rel=0.05)
    assert found[1] == pytest.approx(delay, abs=0.4 * ms)


@pytest.mark.slow
def test_without_changes_of_the_commands_the_estimates_stay(estimated):
    found = estimated("air", 0.7, 6.5 * ms, still=1.5)
    moved, later = found[2500], found[-1]
    assert moved[0] == pytest.approx(0.7, rel=0.05)
    assert abs(later - moved)[0] < 0.03 and abs(later - moved)[1] < 0.3 * ms


@pytest.mark.slow
def test_the_estimates_are_bounded(estimated):
    adaptation = ActuatorAdaptation(speed_spread=0.1, delay_spread=0.5 * ms)
    found = estimated("air", 0.4, 9 * ms, adaptation=adaptation)
    assert (found[:, 0] >= np.exp(-0.3) - 1e-9).all() and (found[:, 1] <= DELAY + 1.5 * ms + 1e-9).all()


@pytest.mark.slow
def test_in_the_loop_the_error_falls_and_the_speed_is_found():
    nominal = Scenario.read(EXAMPLE).with_fixed_model()
    changes = {
        "valve.conductance": 0.7 * float(nominal.valve.conductance),
        "command_delay": 6 * ms,
        "reference.angle.amplitude": 5 * deg,
        "reference.angle.frequency": 1.0,
        "start.angle": 5 * deg,
    }
    slow = with_values(nominal, changes).model_copy(update={"duration": 6.0})
    runs = []
    for adaptation in (ActuatorAdaptation(speed_spread=1e-9, delay_spread=1e-12), ActuatorAdaptation()):
        control = dataclasses.replace(slow.controller, actuator_adaptation=adaptation)
        runs.append(run_scenario(slow.model_copy(update={"controller": control})))
    fixed, adapted = (np.sqrt(np.mean((run["angle"] - run["desired_angle"])[3000:] ** 2)) for run in runs)
    assert adapted < 0.85 * fixed
    assert runs[1]["valve_speed_estimate"][-1] == pytest.approx(0.7, rel=0.05)
    assert runs[1]["command_delay_estimate"][-1] > DELAY + 0.2 * ms  # towards 6 ms, which the slow sine hardly shows


def test_a_model_without_a_speed_is_refused(knee, load):
    control = {"controller": OpenLoopControl(3 * bar, 3 * bar, knee), "command_delay": DELAY}
    with pytest.raises(RangeError) as caught:
        DelayCompensation(
            knee,
            load,
            valve=SecondOrderValve(bandwidth=60.0, damping=0.7),
            actuator_adaptation=ActuatorAdaptation(),
            **control,
        )
    assert caught.value.field == "actuator_adaptation"


@pytest.mark.slow
def test_a_pair_is_estimated_as_its_valves_are(estimated):
    """The speed multiplies both valves; two equal valves of a pair give the estimates of one."""
    one, pair = (estimated("air", 1.3, 2 * ms, known=known) for known in (None, UnequalValves(REGULATOR, REGULATOR)))
    np.testing.assert_allclose(pair, one, rtol=1e-9)
    pair = with_speed(UnequalValves(REGULATOR, with_speed(REGULATOR, 2.0)), 1.5)
    assert (
        pair.muscle2.conductance
        == pytest.approx(2 * pair.muscle1.conductance)
        == pytest.approx(3 * REGULATOR.conductance)
    )
