"""The time constant of the valves, estimated on line: by SciPy's minimum of the same objective, and as it is."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax
from scipy.optimize import minimize_scalar, nnls
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
from mckibben.control.valve_adaptation import _lowest
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


def lagged(fraction, inputs, first=0.0):
    """First-order lag in discrete time, from its first output on."""
    return first + lfilter([fraction], [1, fraction - 1], inputs - first, axis=1)


def measured(time_constant, commands, *, offset=0.0, delay=0, noise=NOISE):
    """Pressures [Pa] at each sample, in equilibrium with the first command before it; each command is held."""
    late = np.concatenate([np.full((2, 1 + delay), 3 * bar), commands], axis=1)[:, :PERIODS]
    true = lagged(1 - np.exp(-PERIOD / time_constant), late, 3 * bar)
    return true + offset + np.random.default_rng(0).normal(0.0, noise, commands.shape)


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


def objective(deviation, adaptation, given, seen):
    """Least misfit of a time constant over delays, with both priors: by SciPy's filter and least squares."""
    fraction = 1 - np.exp(-PERIOD / (MODEL * np.exp(adaptation.time_constant_spread * deviation)))
    slow = 1 - np.exp(-PERIOD / 0.1)
    high_pass = lambda x: x - lagged(slow, x, seen[:, :1])  # noqa: E731
    predicted = lagged(fraction, high_pass(given[:, :-1]))
    errors = high_pass(seen[:, 1:]) - predicted
    rates = np.diff(predicted, axis=1, prepend=0.0) / PERIOD
    ages = TIMES[:-1]
    variance = np.maximum(adaptation.pressure_error**2 + 0.5e5**2 * np.exp(-20 * ages), errors**2 / 9)
    root = np.sqrt(np.exp((ages - ages[-1]) / adaptation.memory) / variance)
    matrix, goal = (np.append((root * x).ravel(), last) for x, last in ((rates, 1 / 0.01), (-errors, 0.0)))
    return nnls(matrix[:, None], goal)[1] ** 2 + deviation**2


@pytest.mark.parametrize("true", [8 * ms, 14 * ms, 20 * ms, 35 * ms, 60 * ms])
def test_it_is_the_most_probable_one_and_near_the_true_one(true, followed):
    given, adaptation = commands(), ValveAdaptation(0.5, NOISE, memory=1.0)
    seen = measured(true, given)
    best = minimize_scalar(objective, bounds=(-3, 3), args=(adaptation, given, seen), method="bounded")
    estimates = followed(adaptation, given, seen)
    assert np.log(estimates[-1] / MODEL) / 0.5 == pytest.approx(best.x, abs=0.2)  # a parabola in place of the objective
    assert estimates[-1] == pytest.approx(true, rel=0.1)
    assert estimates[300:] == pytest.approx(true, rel=0.15)  # after 0.3 s


@pytest.mark.parametrize(("offset", "delay"), [(0.3 * bar, 0), (-0.3 * bar, 0), (0.0, 5), (0.2 * bar, 10)])
def test_offsets_and_delays_are_no_lag(offset, delay, followed):
    """Half of a delay [periods] at most is taken for lag."""
    given = commands()
    for true in (10 * ms, 30 * ms):
        estimate = followed(ValveAdaptation(), given, measured(true, given, offset=offset, delay=delay))[-1]
        assert estimate == pytest.approx(true, abs=0.12 * true + PERIOD * delay / 2)


def test_pressures_at_rest_leave_it_at_the_model_and_lead_it_back(followed):
    rest = np.full((2, PERIODS), 3 * bar)
    assert followed(ValveAdaptation(), rest, measured(50 * ms, rest)) == pytest.approx(MODEL, rel=0.05)
    given = commands(moving=0.5)
    estimates = followed(ValveAdaptation(memory=0.1), given, measured(50 * ms, given))
    assert estimates[480] == pytest.approx(50 * ms, rel=0.15)
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


REFERENCE = Reference(Sine(5 * deg, 1.0, phase=np.pi / 2), Step(14.0, 16.0, 0.5))


@pytest.mark.parametrize(
    ("values", "lowest"),
    [
        (lambda x: (x - 0.3) ** 2, 0.3),
        (lambda x: (x + 1.2) ** 2, -1.2),
        (lambda x: 5.0 - x, 3.0),  # not convex: the end towards which they fall
        (lambda x: 5.0 + x - 0.1 * x**2, -3.0),
    ],
)
def test_the_lowest_of_values_is_that_of_their_parabola(values, lowest):
    deviations = jnp.linspace(-3.0, 3.0, 7)
    assert float(_lowest(values(deviations), deviations)) == pytest.approx(lowest)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["decoupling", "predictive"])
def test_a_controller_with_it_is_nearly_as_good_as_one_that_knows_its_valves(kind, controllers, knee, load):
    """Slow valves of 50 ms, 20 ms in the model; errors after the first third of a second."""
    sensors = SampledSensors(pressure_noise=NOISE, seed=3)
    plant = JointPlant(knee, load, FirstOrderValve(50 * ms), sensors=sensors)

    def run(**valves):
        control = controllers[kind](knee, **valves)
        return mk.simulate(plant, control, REFERENCE, duration=1.0)

    wrong, estimated, known = run(), run(valve_adaptation=ValveAdaptation()), run(valve=mk.FirstOrderValve(50 * ms))
    told = estimated["valve_time_constant_estimate"]
    assert told[0] == pytest.approx(MODEL) and told[-1] == pytest.approx(50 * ms, rel=0.1)
    assert "valve_time_constant_estimate" not in wrong
    late = slice(333, None)
    errors = [np.std(one["angle"][late] - one["desired_angle"][late]) for one in (wrong, estimated, known)]
    assert errors[1] < 1.15 * errors[2] and errors[1] < 0.3 * errors[0], errors


@pytest.mark.slow
def test_runs_of_a_batch_are_those_alone(controllers, knee, load):
    lags = np.array([10 * ms, 40 * ms])
    plants = JointPlant(knee, load, FirstOrderValve(lags))
    control = controllers["decoupling"](knee, valve_adaptation=ValveAdaptation())
    batch, single = (
        mk.simulate_many(plants, control, REFERENCE, duration=0.3, metrics=("angle_rmse",), precision=bits)
        for bits in (64, 32)
    )
    assert single["angle_rmse"] == pytest.approx(batch["angle_rmse"], rel=0.03)
    for lag, error in zip(lags, batch["angle_rmse"], strict=True):
        alone = mk.simulate(
            dataclasses.replace(plants, valve=FirstOrderValve(float(lag))), control, REFERENCE, duration=0.3
        )
        assert error == pytest.approx(alone.metrics["angle_rmse"], rel=1e-9)


@pytest.mark.parametrize(
    ("name", "value"),
    [("time_constant_spread", 0.0), ("time_constant_spread", 0.7), ("pressure_error", 0.0), ("memory", 0.0)],
)
def test_numbers_outside_of_their_ranges_are_refused(name, value):
    with pytest.raises(RangeError, match=name):
        ValveAdaptation(**{name: value})


def test_valves_without_lag_and_what_is_no_adaptation_are_refused(controllers, knee):
    with pytest.raises(RangeError, match="first-order") as caught:
        controllers["decoupling"](knee, valve=mk.IdealValve(), valve_adaptation=ValveAdaptation())
    assert caught.value.field == "valve_adaptation"
    for wrong in ({}, ValveAdaptation, 1.0):
        with pytest.raises(RangeError) as caught:
            controllers["decoupling"](knee, valve_adaptation=wrong)
        assert caught.value.field == "valve_adaptation"
