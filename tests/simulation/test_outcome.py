"""How a run ended: the worst that applies, one by one and by the thousand, and never better for a wilder run."""

import itertools

import jax
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mckibben.simulation.oscillation import Signals, find_oscillations
from mckibben.simulation.outcome import OUTCOMES, Demand, Outcome, outcomes
from mckibben.units import bar, deg

SECONDS = np.arange(2000) * 1e-3
WAVE = np.sin(2 * np.pi * SECONDS)
STIFFNESS = np.where(SECONDS < 1, 13.0, 17.0)
DEMAND = Demand.of(10 * deg * WAVE, STIFFNESS, 2.0)


def outcome(angle_max=0.01, left_domain=False, saturated=False, demand=None, **more) -> Outcome:
    metrics = {"angle_max": angle_max, "time_outside_domain": 0.1 * left_domain, "time_saturated": 0.1 * saturated}
    options = {name: more.pop(name) for name in ("angle_at_end", "started", "missed") if name in more}
    return OUTCOMES[int(outcomes(metrics | more, demand, **options))]


def rms(values) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


@pytest.mark.parametrize(("span", "limit"), [(0.0, 5.0), (4.0, 5.0), (16.0, 16.0), (60.0, 60.0)])
def test_an_end_further_off_than_the_reference_moves_has_diverged(span, limit):
    demand = Demand.of(span / 2 * deg * WAVE, STIFFNESS, 2.0)
    assert outcome(angle_at_end=(limit + 0.1) * deg, demand=demand, saturated=True) is Outcome.LEFT_REFERENCE
    assert outcome(angle_at_end=(limit - 0.1) * deg, demand=demand) is Outcome.COMPLETED


def test_the_worst_that_applies_wins():
    worst = [Outcome.NO_START, Outcome.DIVERGED, Outcome.SWUNG_OVER, Outcome.LEFT_DOMAIN, Outcome.SATURATED]
    for started, angle, left, saturated in itertools.product(
        (False, True), (np.nan, 2.0, 0.1), (True, False), (True, False)
    ):
        applies = [not started, np.isnan(angle), angle > 1.58, left, saturated]
        expected = next((o for o, so in zip(worst, applies, strict=True) if so), Outcome.COMPLETED)
        assert outcome(angle, left, saturated, started=started) is expected


@pytest.mark.parametrize("amplitude", [1.0, 10.0, 80.0])
@pytest.mark.parametrize(("lag", "followed"), [(0.0, True), (28.5, True), (29.5, False), (180.0, False)])
def test_a_joint_follows_a_sine_that_it_is_later_than_by_less_than_29_deg(amplitude, lag, followed):
    """The error of a sine that lags by a phase has 2 sin(phase / 2) of its amplitude."""
    late = np.sin(2 * np.pi * SECONDS - np.deg2rad(lag))
    demand = Demand.of(amplitude * deg * WAVE, STIFFNESS, 2.0)
    error = amplitude * deg * rms(late - WAVE)
    assert error == pytest.approx(amplitude * deg * 2 * np.sin(np.deg2rad(lag) / 2) / np.sqrt(2))
    assert (outcome(angle_rmse=error, demand=demand) is Outcome.COMPLETED) == followed


@pytest.mark.parametrize(("stiffness", "error", "followed"), [(STIFFNESS, 0.9, True), (STIFFNESS, 1.1, False)])
def test_a_step_of_the_stiffness_is_followed_to_half_of_its_rms(stiffness, error, followed):
    demand = Demand.of(10 * deg * WAVE, stiffness, 2.0)
    assert (outcome(stiffness_rmse=error, demand=demand) is Outcome.COMPLETED) == followed


def test_a_constant_reference_is_held_to_5_deg_and_half_of_the_stiffness():
    demand = Demand.of(np.full(10, 20 * deg), np.full(10, 14.0), 1.0)
    assert outcome(angle_rmse=4.9 * deg, stiffness_rmse=6.9, demand=demand) is Outcome.COMPLETED
    assert outcome(angle_rmse=5.1 * deg, demand=demand) is Outcome.NOT_FOLLOWED
    assert outcome(stiffness_rmse=7.1, demand=demand) is Outcome.NOT_FOLLOWED


def test_a_run_that_misses_half_of_its_deadlines_is_late():
    assert outcome(missed=3044 / 6000) is Outcome.LATE
    assert outcome(missed=0.005) is Outcome.COMPLETED


def test_commands_may_travel_twice_per_stroke_of_the_reference_and_a_stroke_per_second():
    """In two seconds the sine has four strokes, and the start is one."""
    assert DEMAND.travel == pytest.approx((2 * (4 + 1) / 2 + 1) * 6 * bar, rel=1e-2)
    assert Demand.of(np.zeros(9), np.full(9, 14.0), 10.0).travel == pytest.approx((2 / 10 + 1) * 6 * bar)
    joints = np.stack([10 * deg * WAVE, 0 * WAVE], axis=1)
    both = Demand.of(joints, np.full((2000, 2), 14.0), 2.0)
    metrics = {"angle_max": np.zeros(2)}
    codes = [outcomes(metrics | {"command_travel": x * bar}, both, by_joint=True) for x in (35.0, 37.0)]
    assert [OUTCOMES[int(code)] for code in codes] == [Outcome.COMPLETED, Outcome.CHATTER]


SCALES = {  # of the numbers of a run, by the name of its metric
    "angle_max": 1.0,
    "angle_rmse": 10 * deg,
    "stiffness_rmse": 3.0,
    "command_travel": 50 * bar,
    "oscillation_amplitude": 1 * deg,
    "time_saturated": 1.0,
    "time_outside_domain": 1.0,
    "time_overloaded": 1.0,
    "angle_at_end": 30 * deg,
    "missed": 0.02,
}
numbers = st.tuples(*[st.sampled_from([0.0, 0.0, 0.3, 0.6, 1.0, 2.0])] * len(SCALES))


@given(numbers, numbers)
def test_a_run_that_is_worse_in_every_number_is_not_judged_better(first, second):
    def code(values):
        scaled = {name: value * scale for value, (name, scale) in zip(values, SCALES.items(), strict=True)}
        return OUTCOMES.index(outcome(demand=DEMAND, **scaled))

    assert code(np.maximum(first, second)) >= max(code(first), code(second))


searched = jax.jit(lambda command: find_oscillations(Signals(WAVE, WAVE, (command,)), 1e-3).travel)


@given(st.floats(0.01, 3.0), st.floats(1.0, 10.0), st.sampled_from(["white", "regular", "differentiated"]))
def test_commands_that_swing_further_are_not_judged_better(size, factor, shape):
    noise = np.random.default_rng(1).normal(size=2000)
    swing = {
        "white": noise,
        "regular": np.sin(2 * np.pi * 100 * SECONDS),
        "differentiated": np.diff(noise, prepend=0.0),
    }[shape]
    judged = []
    for scale in (size, size * factor):
        travel = float(searched(3 * bar + scale * bar * swing))
        judged.append(OUTCOMES.index(outcome(command_travel=travel, demand=DEMAND)))
    assert judged[1] >= judged[0]


def test_noise_wears_the_valves_as_regular_swings_do():
    """The runs of a newcomer: 324 reversals per second of 78 bar/s were named, 569 of 440 bar/s were not."""
    for travel in (78, 440):
        assert outcome(command_travel=travel * bar, demand=DEMAND) is Outcome.CHATTER
