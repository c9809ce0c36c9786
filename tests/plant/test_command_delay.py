"""Delay of the commands: runs against those of late commands, batches, both engines, scenarios and a joint rig."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest

import mckibben as mk
from mckibben.actuator import FlowValve
from mckibben.control import Setpoint
from mckibben.errors import RangeError, ScenarioError
from mckibben.scenario import Scenario, batched, find_parameter
from mckibben.simulation import run_episode
from mckibben.units import bar, litre, ms

PERIOD, LAG = 1 * ms, 20 * ms
SCENARIO = (Path(__file__).parents[2] / "examples" / "pre-contracted-step-pid.yaml").read_text()


@pytest.fixture(scope="module")
def late(plant):
    return lambda delay: dataclasses.replace(plant, command_delay=delay)


@pytest.fixture(scope="module")
def start(plant):
    return plant.equilibrium(0.0)


@pytest.fixture(scope="module")
def commands(start):
    """Random commands of both muscles about the pressures at the start, shape (2, periods)."""
    draws = np.random.default_rng(2).uniform(-0.3, 0.3, (2, 60)) * bar
    return np.array(start.pressures)[:, None] + draws


@pytest.mark.slow
def test_the_motion_is_that_of_late_commands(plant, late, playback, start, commands):
    delay = 4
    run = run_episode(late(delay * PERIOD), playback, Setpoint(*commands), start, PERIOD, 4)
    held = np.repeat(np.array(start.pressures)[:, None], delay, axis=1)
    shifted = np.concatenate([held, commands[:, :-delay]], axis=1)
    expected = run_episode(plant, playback, Setpoint(*shifted), start, PERIOD, 4)
    assert np.ptp(expected["angle"]) > 1e-4
    for name in ("angle", "pressure1", "pressure2"):
        assert run[name] == pytest.approx(expected[name], rel=1e-12, abs=1e-12)
    assert run["command1"] == pytest.approx(commands[0])  # those that are sent


@pytest.mark.slow
def test_between_two_periods_it_is_their_mean(late, playback, start):
    """A step of the command: closed form of a first-order lag under it, whose error is of second order."""
    delay, low, high = 3.4 * PERIOD, float(start.pressures[0]), float(start.pressures[0]) + 0.5 * bar
    steps = np.full((2, 40), high)
    steps[1] = float(start.pressures[1])
    found = run_episode(late(delay), playback, Setpoint(*steps), start, PERIOD, 4)["pressure1"]
    since = np.maximum(np.arange(40) * PERIOD - delay, 0.0)
    expected = high + (low - high) * np.exp(-since / LAG)
    assert np.all(found[:4] == low)
    assert np.abs(found - expected).max() < 0.4 * 0.6 / 2 * (PERIOD / LAG) ** 2 * (high - low) * 1.01
    assert np.abs(found - expected).max() > 0


@pytest.mark.slow
def test_runs_of_a_batch_are_those_alone_in_both_engines(late):
    scenario = Scenario.parse(SCENARIO)
    parts = {"controller": scenario.control(), "reference": scenario.reference()}
    times = {"duration": 0.1, "control_period": PERIOD, "substeps": 4}
    delays = [0.0, 2.4 * PERIOD, 4 * PERIOD]
    batch, again = (
        mk.simulate_many(late(0.0), **parts, over={"command_delay": delays}, keep=["angle"], engine=engine, **times)
        for engine in ("auto", "xla")
    )
    np.testing.assert_allclose(again["angle"], batch["angle"], rtol=0, atol=1e-12)
    alone, at_once = (mk.simulate(late(delay), **parts, **times) for delay in (delays[-1], None))
    assert batch["angle"][2] == pytest.approx(alone["angle"], abs=1e-12)
    assert batch["angle"][0] == pytest.approx(at_once["angle"], abs=1e-12)
    early, between, last = batch["angle"]
    assert 0 < np.abs(between - early).max() < np.abs(last - early).max()


def test_openings_are_zero_before_the_start(knee, load):
    valve = FlowValve(conductance=0.4 * litre / bar, supply=7 * bar, direct=True)
    plant = mk.JointPlant(knee, load, valve, command_delay=2 * PERIOD).with_period(PERIOD)
    sent = plant.init_state(0.0, (3 * bar, 3 * bar)).sent
    assert [list(map(float, one)) for one in sent] == [[0.0, 0.0], [0.0, 0.0]]


def test_wrong_delays_are_refused(late):
    with pytest.raises(RangeError) as caught:
        late(101 * PERIOD).with_period(PERIOD)
    assert (caught.value.field, caught.value.upper) == ("command_delay", pytest.approx(100 * PERIOD))
    with pytest.raises(RangeError) as caught:
        late(-PERIOD)
    assert caught.value.field == "command_delay"


def test_a_scenario_has_it():
    scenario = Scenario.parse(SCENARIO + "command_delay: 12 ms\n")
    assert scenario.plant().command_delay == 12 * ms
    assert Scenario.parse(scenario.dumps()) == scenario
    assert find_parameter(scenario, "command_delay").show(5 * ms) == "5 ms"
    assert batched(scenario, {"command_delay": [5 * ms, 10 * ms]}).plant().command_delay.tolist() == [5 * ms, 10 * ms]
    without = Scenario.parse(SCENARIO)
    assert without.plant().command_delay is None
    assert find_parameter(without, "command_delay").nominal == 0
    with pytest.raises(ScenarioError) as caught:
        Scenario.parse(SCENARIO + "command_delay: -1 ms\n")
    assert caught.value.problems[0].field == "command_delay"
