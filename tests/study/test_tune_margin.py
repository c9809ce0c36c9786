"""Stability margin by simulation: against the eigenvalues of the sampled loop."""

from pathlib import Path

import numpy as np
import pytest

from mckibben.control import ExtendedStateObserver
from mckibben.errors import ParameterError
from mckibben.scenario import Scenario, run_many, with_values
from mckibben.study.tune import on_small_step, stability_margin
from mckibben.study.tune.margin import SMALL_STEP, in_conditions

TEXT = (Path(__file__).parents[2] / "examples" / "pre-contracted-step-pid.yaml").read_text()
POLES, OBSERVED, PRESSURE, LAG, PERIOD = 60.0, 160.0, 100.0, 0.02, 1e-3
CONTROLLER = f"""controller:
  class: decoupling
  feedback: {{bandwidth: {POLES} rad/s}}
  observer: {{bandwidth: {OBSERVED} rad/s}}
  pressure_observer: {{bandwidth: {PRESSURE} rad/s}}
reference:
  angle: {{class: step, before: 0 deg, after: 0.2 deg, at: 50 ms}}
  stiffness: 13 N*m/rad
start: {{angle: 0 deg, stiffness: 13 N*m/rad}}
duration: 3 s
control_period: 1 ms
"""


@pytest.fixture(scope="module")
def scenario():
    return Scenario.parse(TEXT.split("controller:\n")[0] + CONTROLLER)


def largest_pole(slower, stiffness, damping):
    """Spectral radius of the loop with valves so many times slower than modelled; per inertia, small motions."""
    first, second, third = (float(gain) for gain in ExtendedStateObserver(OBSERVED).gains(PERIOD))
    model, trust = 1 - np.exp(-PERIOD / LAG), 1 - np.exp(-PRESSURE * PERIOD)
    lead = (1 - np.exp(-3 * POLES * PERIOD)) / model

    def period(angle, velocity, torque, angle_, velocity_, disturbance, known, torque_, command):
        torque_ += model * (command - torque_)
        torque_ += trust * (torque - torque_)
        now = torque_ - stiffness * angle - damping * velocity_
        acceleration = (known + now) / 2 + disturbance
        angle_ += PERIOD * (velocity_ + PERIOD / 2 * acceleration)
        innovation = angle - angle_
        angle_ += first * innovation
        velocity_ += PERIOD * acceleration + second * innovation
        disturbance += third * innovation
        ahead = angle_ + velocity_ / (3 * POLES)
        wanted = -POLES * velocity_ - POLES**2 / 3 * angle - disturbance + stiffness * ahead + damping * velocity_
        command = torque_ + lead * (wanted - torque_)
        for _ in range(100):
            step = PERIOD / 100
            velocity += step * (torque - stiffness * angle - damping * velocity)
            angle += step * velocity
            torque = command + (torque - command) * np.exp(-step / (slower * LAG))
        return angle, velocity, torque, angle_, velocity_, disturbance, now, torque_, command

    return np.abs(np.linalg.eigvals(np.array([period(*unit) for unit in np.eye(9)]).T)).max()


@pytest.mark.slow
def test_the_margin_of_the_lag_is_that_of_the_eigenvalues(scenario):
    plant = scenario.plant()
    state, inertia = plant.equilibrium(0.0, stiffness=13.0), float(plant.load.total_inertia)
    joint = float(plant.stiffness(0.0, state.pressures)) / inertia, float(plant.load.damping) / inertia
    expected = next(factor for factor in np.linspace(1, 10, 181) if largest_pole(factor, *joint) > 1)
    found = stability_margin(scenario, ["valve.time_constant"])
    assert found == pytest.approx(expected, rel=0.15)
    assert stability_margin(scenario, ["valve.time_constant"], largest=1.2) == np.inf


@pytest.mark.slow
def test_the_margin_over_conditions_is_the_least(scenario):
    masses = np.array([0.4, 0.5, 0.7])
    lag = ["valve.time_constant"]
    each = [stability_margin(scenario, lag, conditions={"load.mass2": np.full(3, mass)}) for mass in masses]
    assert stability_margin(scenario, lag, conditions={"load.mass2": masses}) == min(each) < max(each)


def test_what_has_no_margin_is_refused(scenario):
    with pytest.raises(ParameterError) as caught:
        stability_margin(scenario, ["valve.time_constant"], growth=1.0)
    assert caught.value.value == 1.0
    with pytest.raises(ParameterError, match="mass9"):
        stability_margin(scenario, ["load.mass9"])


GAINS = [f"controller.position.{gain}" for gain in ("kp", "ki", "kd")]


def gains_of(factor):
    return dict(zip(GAINS, np.multiply(factor, (1e4, 2e6, 2e4)).tolist(), strict=True))


@pytest.fixture(scope="module")
def slow():
    """A loop that follows its large sine badly, and is far from unstable."""
    said = Scenario.parse(TEXT).model_copy(update={"duration": 2.0})
    return with_values(said, gains_of(1.0))


@pytest.mark.slow
def test_the_gain_margin_in_conditions_does_not_depend_on_the_error_of_a_large_reference(slow):
    conditions = {"load.mass2": np.array([0.3, 0.7]), "reference.angle.amplitude": np.array([0.1, 0.2])}
    found = in_conditions(slow, GAINS, conditions, largest=10.0)
    assert found.unstable == 0
    assert found.angle_rmse.min() > 4 * SMALL_STEP, "it follows badly"
    calm, wild = (
        run_many(on_small_step(with_values(slow, gains_of(factor))), {"load.mass2": np.array([0.3, 0.7])})
        for factor in (found.gain_margin, 1.4 * found.gain_margin)
    )
    assert calm["angle_rmse"].max() < SMALL_STEP < wild["angle_rmse"].max(), "beyond the margin it oscillates"


@pytest.mark.slow
def test_a_loop_that_oscillates_has_no_margin_however_large_its_error(slow):
    fast = with_values(slow, dict(zip(GAINS, (2e5, 2e8, 2e4), strict=True)))
    found = in_conditions(fast, GAINS, {"load.mass2": np.array([0.3, 0.7])}, largest=10.0)
    assert (found.unstable, found.gain_margin) == (2, 0.0)
    assert in_conditions(fast, [], {"load.mass2": np.array([0.3])}, largest=10.0).gain_margin is None
