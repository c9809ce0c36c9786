"""The time constant of the valves, estimated on line: by SciPy's minimum of the same objective, and as it is."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax
from scipy.optimize import minimize_scalar
from scipy.signal import lfilter

import mckibben as mk
from mckibben.control import (
    DecouplingControl,
    ExtendedStateObserver,
    PolePlacement,
    PredictiveControl,
    Reference,
    Sine,
    Step,
    ValveAdaptation,
)
from mckibben.errors import RangeError
from mckibben.plant import FirstOrderValve, JointPlant, SampledSensors
from mckibben.units import bar, deg, ms

PERIOD, PERIODS, NOISE = 1e-3, 1500, 4e3
TIMES = PERIOD * np.arange(PERIODS)
MODEL = 20 * ms


def commands(moving=np.inf):
    """Commands [Pa] of both valves, shape (2, periods); constant after a time [s]."""
    change = 0.3 * bar * np.stack([np.sin(9 * TIMES) + np.sign(np.sin(17 * TIMES)), np.cos(13 * TIMES)])
    still = int(np.searchsorted(TIMES, moving))
    change[:, still:] = change[:, [min(still, PERIODS - 1)]]
    return 3 * bar + change


def pressures(time_constant, commands, first):
    """Pressures [Pa] of first-order lags at each sample, each command being held until the next."""
    pole = np.exp(-PERIOD / time_constant)
    moved = lfilter([0, 1 - pole], [1, -pole], commands - first[:, None], axis=1)
    return first[:, None] + moved


def measured(time_constant, commands, seed=0):
    noise = np.random.default_rng(seed).normal(0.0, NOISE, commands.shape)
    return pressures(time_constant, commands, np.full(2, 3 * bar)) + noise


@pytest.fixture(scope="module")
def followed():
    """Estimates [s] over time."""

    @eqx.filter_jit
    def program(adaptation, model, commands, measured):
        def step(state, now):
            before, (p1, p2) = now
            state = adaptation.step(state, model, (before[0], before[1]), (p1, p2), PERIOD)
            return state, state.time_constant

        first = adaptation.init(model, (measured[0, 0], measured[1, 0]))
        return lax.scan(step, first, (commands[:, :-1].T, measured[:, 1:].T))[1]

    def followed(adaptation, commands, measured, model=MODEL):
        numbers = jax.tree.map(jnp.asarray, (adaptation, model, commands, measured))
        return np.asarray(program(*numbers))

    return followed


@pytest.mark.parametrize("true", [8 * ms, 14 * ms, 20 * ms, 35 * ms, 60 * ms])
def test_it_is_the_most_probable_one_and_near_the_true_one(true, followed):
    given = commands()
    seen, adaptation = measured(true, given), ValveAdaptation(0.5, NOISE, memory=10.0)
    weights = np.exp(-(TIMES[-1] - TIMES[1:]) / adaptation.memory)

    def objective(deviation):
        predicted = pressures(MODEL * np.exp(0.5 * deviation), given, seen[:, 0])
        return float(((seen - predicted)[:, 1:] ** 2 @ weights).sum() / (2 * NOISE**2) + deviation**2 / 2)

    best = minimize_scalar(objective, bounds=(-3, 3), method="bounded", options={"xatol": 1e-6})
    estimates = followed(adaptation, given, seen)
    assert np.log(estimates[-1] / MODEL) / 0.5 == pytest.approx(best.x, abs=0.1)  # a parabola in place of the objective
    assert estimates[-1] == pytest.approx(true, rel=0.06)
    assert estimates[200:] == pytest.approx(true, rel=0.12)  # after 0.2 s


def test_pressures_at_rest_leave_it_at_the_model_and_lead_it_back(followed):
    rest = np.full((2, PERIODS), 3 * bar)
    assert followed(ValveAdaptation(), rest, measured(50 * ms, rest)) == pytest.approx(MODEL, rel=0.05)
    given = commands(moving=0.5)
    estimates = followed(ValveAdaptation(memory=0.1), given, measured(50 * ms, given))
    assert estimates[480] == pytest.approx(50 * ms, rel=0.1)
    assert estimates[-1] == pytest.approx(MODEL, rel=0.1)


def test_no_estimate_leaves_three_prior_deviations(followed):
    given = commands()
    for true, sign in ((1 * ms, -1), (400 * ms, 1)):
        estimates = followed(ValveAdaptation(0.3), given, measured(true, given))
        assert estimates[-1] == pytest.approx(MODEL * np.exp(sign * 0.9), rel=1e-6)


@pytest.fixture(scope="module")
def controllers(load):
    observer = ExtendedStateObserver(160.0, damping=2.0)

    def decoupling(model, **valves):
        return DecouplingControl(model, load, PolePlacement(60.0), observer, **valves)

    def predictive(model, **valves):
        return PredictiveControl(model, load, observer, bandwidth=60.0, **valves)

    return {"decoupling": decoupling, "predictive": predictive}


REFERENCE = Reference(Sine(5 * deg, 1.0), Step(14.0, 16.0, 0.5))


@pytest.mark.parametrize("kind", ["decoupling", "predictive"])
def test_a_controller_with_it_is_nearly_as_good_as_one_that_knows_its_valves(kind, controllers, knee, load):
    """Slow valves of 50 ms, 20 ms in the model: with the estimate within a tenth of the error of the true model."""
    sensors = SampledSensors(pressure_noise=NOISE, seed=3)
    plant = JointPlant(knee, load, FirstOrderValve(50 * ms), sensors)

    def run(**valves):
        control = controllers[kind](knee, **valves)
        return mk.simulate(plant, control, REFERENCE, duration=1.0)

    wrong, estimated, known = run(), run(valve_adaptation=ValveAdaptation()), run(valve_time_constant=50 * ms)
    told = estimated["valve_time_constant_estimate"]
    assert told[0] == pytest.approx(MODEL) and told[-1] == pytest.approx(50 * ms, rel=0.1)
    assert "valve_time_constant_estimate" not in wrong
    errors = [one.metrics["angle_rmse"] for one in (wrong, estimated, known)]
    assert errors[1] < 1.1 * errors[2] and errors[1] < 0.8 * errors[0], errors


def test_runs_of_a_batch_are_those_alone(controllers, knee, load):
    lags = np.array([10 * ms, 40 * ms])
    plants = JointPlant(knee, load, FirstOrderValve(lags))
    control = controllers["decoupling"](knee, valve_adaptation=ValveAdaptation())
    batch = mk.simulate_many(plants, control, REFERENCE, duration=0.3, metrics=("angle_rmse",))
    for lag, error in zip(lags, batch["angle_rmse"], strict=True):
        alone = mk.simulate(
            dataclasses.replace(plants, valve=FirstOrderValve(float(lag))), control, REFERENCE, duration=0.3
        )
        assert error == pytest.approx(alone.metrics["angle_rmse"], rel=1e-9)


@pytest.mark.parametrize(
    ("name", "value"), [("time_constant_spread", 0.0), ("time_constant_spread", 1.1), ("pressure_error", 0.0)]
)
def test_numbers_outside_of_their_ranges_are_refused(name, value):
    with pytest.raises(RangeError, match=name):
        ValveAdaptation(**{name: value})


def test_valves_without_lag_are_refused(controllers, knee):
    with pytest.raises(RangeError, match="valve_time_constant"):
        controllers["decoupling"](knee, valve_time_constant=0.0, valve_adaptation=ValveAdaptation())
