# ruff: noqa: E501 - tables of cases
"""Sensors: quantisation, noise and delay, in 64 and 32 bits."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from mckibben.errors import RangeError
from mckibben.joint import Measurement
from mckibben.numerics.batching import cast
from mckibben.numerics.compiled import numeric
from mckibben.plant import JointPlant, PerfectSensors, SampledSensors
from mckibben.units import deg

pytestmark = pytest.mark.usefixtures("optimized")  # noise, of 32 bits, is compared to the last bit of 64
PERIOD, PERIODS = 1e-3, 4000
STEP, NOISE = 0.022 * deg, 4e3


@jax.jit
def _measured(sensors, true):
    def next_period(last, at):
        return sensors.measure(last, *at)

    first = sensors.init(jax.tree.map(lambda x: x[0], true))
    return jax.lax.scan(next_period, first, (jnp.arange(PERIODS, dtype=true.angle.dtype), true))[1]


def measured(sensors, true, kind=jnp.float64):
    """Return measurements over time, compiled."""
    return jax.tree.map(np.asarray, _measured(*cast((numeric(sensors), jax.tree.map(jnp.asarray, true)), kind)))


@pytest.fixture(scope="module")
def true():
    """An angle and two pressures that vary."""
    times = PERIOD * np.arange(PERIODS)
    return Measurement(0.2 * np.sin(times), (3e5 + 2e4 * times, 4e5 - 1e4 * times))


@pytest.fixture(scope="module")
def noise(true):
    """Of both pressures, shape (2, periods), for some seeds."""

    def of(seed, kind=jnp.float64, size=NOISE):
        found = measured(
            SampledSensors(pressure_noise=size, seed=seed), Measurement(0 * true.angle, (0 * true.angle,) * 2), kind
        )
        return np.stack(found.pressures)

    return {seed: of(seed) for seed in (0, 1, 2**31 - 1)} | {"32 bits": of(1, jnp.float32), "none": of(1, size=0.0)}


def test_perfect_sensors_are_exact_without_delay():
    here = Measurement(jnp.asarray(0.1), (jnp.asarray(2e5), jnp.asarray(3e5)))
    sensors = PerfectSensors()
    assert sensors.init(here) == ()
    assert sensors.measure((), 3, here) == ((), here)


@pytest.mark.slow
def test_an_offset_of_the_encoder_is_in_the_measurement_and_not_in_the_joint(true, plant):
    found = measured(SampledSensors(encoder_offset=2 * deg), true)
    np.testing.assert_allclose(found.angle, true.angle + 2 * deg, rtol=0, atol=1e-15)
    np.testing.assert_array_equal(found.pressures, true.pressures)
    steps = measured(SampledSensors(STEP, encoder_offset=0.3 * STEP), true).angle / STEP
    np.testing.assert_allclose(steps, np.round(true.angle / STEP + 0.3), atol=1e-9)
    sensing = JointPlant(plant.joint, plant.load, plant.valve, sensors=SampledSensors(encoder_offset=2 * deg))
    state, seen = sensing.sample(sensing.equilibrium(0.1), PERIOD)
    assert (float(state.angle), float(seen.angle)) == pytest.approx((0.1, 0.1 + 2 * deg))


def test_without_faults_sampled_sensors_are_perfect(true):
    jax.tree.map(np.testing.assert_array_equal, measured(SampledSensors(seed=3), true), true)


def test_an_encoder_counts_whole_steps_and_takes_the_nearest(true):
    found = measured(SampledSensors(encoder=STEP), true)
    counts = found.angle / STEP
    np.testing.assert_allclose(counts, np.rint(true.angle / STEP), atol=1e-9)
    assert np.abs(found.angle - true.angle).max() == pytest.approx(STEP / 2, rel=0.01)
    np.testing.assert_array_equal(found.pressures[0], true.pressures[0])


def test_the_noise_is_white_normal_and_of_the_given_size(noise):
    """Each bound is four standard deviations of what is estimated from so many samples."""
    for seed in (0, 1, 2**31 - 1):
        both = noise[seed] / NOISE
        assert np.abs(both.mean(axis=1)).max() < 4 / np.sqrt(PERIODS)
        assert np.abs(both.std(axis=1) - 1).max() < 4 / np.sqrt(2 * PERIODS)
        within = [(np.abs(both) < width).mean() - share for width, share in ((1, 0.682689), (2, 0.954500))]
        assert np.abs(within).max() < 4 * np.sqrt(0.68 * 0.32 / (2 * PERIODS))
        for one, other in (
            (both[0], both[1]),
            *((each[1:], each[:-1]) for each in both),
            *((each[2:], each[:-2]) for each in both),
        ):
            assert abs(np.mean(one * other)) < 4 / np.sqrt(one.size)


@pytest.mark.parametrize("delay", [0.0, 0.25, 1.0])
def test_a_measurement_is_delayed_by_a_fraction_of_a_period(true, delay):
    """The noise is that of when it was sampled, and so are the counts."""
    sensors = {"encoder": STEP, "pressure_noise": NOISE, "seed": 1}
    at_once, late = measured(SampledSensors(**sensors), true), measured(SampledSensors(**sensors, delay=delay), true)
    for now, then in zip(jax.tree.leaves(at_once), jax.tree.leaves(late), strict=True):
        before = np.concatenate([now[:1], now[:-1]])
        np.testing.assert_allclose(then, (1 - delay) * now + delay * before, rtol=1e-13, atol=1e-15)


@pytest.mark.parametrize(
    ("field", "value", "unit"), [("encoder", -0.1, "rad"), ("encoder", np.nan, "rad"), ("pressure_noise", -1.0, "Pa"), ("delay", 1.5, "1"), ("delay", np.array([0.0, -0.5]), "1")]
)  # fmt: skip
def test_invalid_sensors_are_refused(field, value, unit):
    with pytest.raises(RangeError, match="SampledSensors") as refused:
        SampledSensors(**{field: value})
    assert (refused.value.field, refused.value.unit) == (field, unit)
    np.testing.assert_equal(refused.value.value, np.ravel(value)[-1])
