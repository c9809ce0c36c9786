import numpy as np
import pytest

from mckibben.control import Multisine, Ramp, RandomSteps, Samples, Sine, Step, Sum
from mckibben.errors import RangeError

TIMES = np.array([0.0, 0.25, 1.0, 4.999, 5.0, 10.0])


def test_a_step_has_its_new_value_from_its_time_on():
    np.testing.assert_array_equal(Step(before=13.0, after=17.0, at=5.0)(TIMES), [13, 13, 13, 13, 17, 17])


def test_a_ramp_has_a_constant_rate_and_is_held():
    ramp = Ramp(2.0, -4.0, start=1.0, duration=3.0)
    np.testing.assert_allclose(ramp(np.array([0.0, 1.0, 2.5, 4.0, 9.0])), [2, 2, -1, -4, -4])
    with pytest.raises(RangeError) as caught:
        Ramp(0.0, 1.0, 0.0, duration=0.0)
    assert caught.value.field == "duration"


@pytest.mark.slow
def test_random_steps_hold_levels_of_their_range_for_dwells_of_theirs():
    times = np.arange(400_000) * 1e-3
    values = np.asarray(RandomSteps(-2.0, 1.0, dwell=0.2, longest_dwell=0.6, seed=5)(times))
    changes = np.flatnonzero(np.diff(values)) + 1
    levels, dwells = values[changes], np.diff(times[changes])
    assert 0.2 - 1e-9 <= dwells.min() < 0.25 and 0.55 < dwells.max() <= 0.6 + 1e-9
    assert dwells.mean() == pytest.approx(0.4, abs=0.01)
    assert -2 <= levels.min() < -1.99 and 0.99 < levels.max() <= 1
    assert levels.mean() == pytest.approx(-0.5, abs=0.1)
    assert levels.std() == pytest.approx(3 / 12**0.5, abs=0.05)
    assert abs(np.corrcoef(levels[:-1], levels[1:])[0, 1]) < 0.1


def test_a_sine_is_at_its_amplitude_after_a_quarter_period():
    sine = Sine(amplitude=0.2, frequency=0.5, offset=0.1)
    assert float(sine(0.0)) == pytest.approx(0.1)
    assert float(sine(0.5)) == pytest.approx(0.3)
    assert float(sine(1.5)) == pytest.approx(-0.1)
    assert float(Sine(1.0, 2.0, phase=np.pi / 2)(0.0)) == pytest.approx(1.0)


def test_a_multisine_is_the_sum_of_its_sines():
    many = Multisine((0.1, 0.2), (0.5, 1.5), (0.3, -0.7), offset=1.0)
    expected = 1 + 0.1 * np.sin(np.pi * TIMES + 0.3) + 0.2 * np.sin(3 * np.pi * TIMES - 0.7)
    np.testing.assert_allclose(many(TIMES), expected, atol=1e-13)
    np.testing.assert_allclose(Multisine((0.1,), (0.5,))(TIMES), Sine(0.1, 0.5)(TIMES), atol=1e-15)


def test_samples_are_joined_by_straight_lines_and_held_beyond():
    signal = Samples([1.0, 2.0, 4.0], [10.0, 20.0, 0.0])
    np.testing.assert_allclose(signal(np.array([0.0, 1.0, 1.5, 3.0, 4.0, 9.0])), [10, 10, 15, 10, 0, 0])


def test_a_sum_is_all_of_its_parts():
    parts = Step(13.0, 17.0, at=5.0), Sine(0.5, 0.3, 1.0, 0.2), Samples([0.0, 10.0], [0.0, 2.0])
    expected = np.where(TIMES < 5, 13.0, 17.0) + 1 + 0.5 * np.sin(0.6 * np.pi * TIMES + 0.2) + 0.2 * TIMES
    np.testing.assert_allclose(Sum(parts)(TIMES), expected, atol=1e-13)
    np.testing.assert_array_equal(Sum((Sum(parts[:1]),))(TIMES), parts[0](TIMES))
    with pytest.raises(RangeError, match="no signals"):
        Sum(())
