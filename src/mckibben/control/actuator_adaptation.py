"""On-line estimation of the delay of the commands and the speed of the valves from commands and measured pressures."""

from __future__ import annotations

from typing import Annotated, Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float, PyTree

from mckibben.actuator import Actuator, AirVolume
from mckibben.actuator.base import lag_fraction
from mckibben.component.base import Component
from mckibben.errors import RangeError
from mckibben.joint.geometry import Pair
from mckibben.numerics.elementary import exp, floating
from mckibben.units import PositiveTime, PressureScale, Quantity, ValveTime

SpeedSpread = Annotated[float, Quantity("1", "1", 0, 0.6, open_lower=True)]

Scalar = Float[Array, ""]

_WASHOUT = 0.1  # s, time constant of the high-pass filter of errors and slopes
_OFFSET = 0.5e5  # Pa, standard deviation of a measured pressure from its command in equilibrium
_LARGEST = 3.0  # error over its standard deviation; larger ones count as this
_DEVIATIONS = 3.0  # largest deviation from the model, in prior standard deviations


class Prediction(NamedTuple):
    """Pressure [Pa] and state of the model of one valve from the commands alone, and their slopes, shape (2,)."""

    pressure: Scalar
    state: PyTree
    pressure_slopes: Array  # over the logarithm of the speed, and the delay [s]
    state_slopes: PyTree
    slow_error: Scalar  # low-pass filtered
    slow_slopes: Array


class ActuatorAdaptationState(NamedTuple):
    """Estimates, and what they are computed from."""

    speed: Scalar  # relative to the model
    delay: Scalar  # [s]
    predictions: tuple[Prediction, Prediction]
    information: Array  # shape (2, 2)
    evidence: Array  # shape (2,)
    age: Scalar  # time since the start [s]


class ActuatorAdaptation(Component):
    r"""Estimate of the delay of the commands and of the speed of the valves by recursive prediction errors.

    The speed v multiplies the conductances of valves with air, and divides the time constant of a first-order valve.
    The model predicts both pressures from the commands alone (output error); the slopes :math:`\psi` of the prediction
    over :math:`x = (\ln v, d)` follow by differentiation. Errors and slopes pass the same high-pass filter, of 0.1 s.
    The estimate is the most probable one of the linearised errors,

    .. math::

        \hat x = \arg\min_x \sum_k w_k e^{-(t - t_k)/T} (e_k + \psi_k^T (\hat x_k - x))^2
        + \frac{\ln^2 v}{\sigma_v^2} + \frac{(d - d_0)^2}{\sigma_d^2},

    within three prior standard deviations of the model, and with a delay from 0 up. The weights w make errors above
    three standard deviations count as three. Both valves are assumed to differ by the same factor.

    Parameters
    ----------
    speed_spread, delay_spread
        sigma_v, sigma_d: prior standard deviations of the logarithm of the speed [-] and of the delay [s].
    pressure_error
        Standard deviation of a measured pressure from that of a correct model [Pa].
    memory
        T: time constant by which errors are forgotten [s].

    References
    ----------
    L. Ljung, System Identification, 2nd ed., Prentice Hall 1999, sec. 11.4 (recursive prediction-error methods).
    """

    speed_spread: SpeedSpread = 0.3
    delay_spread: ValveTime = 2e-3
    pressure_error: PressureScale = 5000.0
    memory: PositiveTime = 10.0

    def check_valve(self, valve: Actuator) -> None:
        """Raise `RangeError` for a model without a speed."""
        if not (valve.holds_air or valve.is_first_order):
            raise RangeError(
                f"actuator_adaptation estimates the speed of valves with air or of first order, and the model is a "
                f"{type(valve).__name__}",
                field="actuator_adaptation",
                remedy="give another model of the valves, or leave actuator_adaptation out",
            )

    def longest_delay(self, delay: ArrayLike) -> ArrayLike:
        """Longest estimate of a delay [s]."""
        return delay + _DEVIATIONS * self.delay_spread

    def init(self, valve: Actuator, delay: ArrayLike, pressures: Pair) -> ActuatorAdaptationState:
        """Prior about valves and delay [s] of the model, at measured pressures [Pa]."""
        zero = jnp.zeros_like(floating(pressures[0]))
        none = jnp.zeros(2, zero.dtype) + zero

        def begun(model: Actuator, pressure: Scalar) -> Prediction:
            state = model.init_model(pressure)
            return Prediction(pressure, state, none, jax.tree.map(lambda _: none, state), zero, none)

        predictions = begun(valve.for_muscle(0), pressures[0]), begun(valve.for_muscle(1), pressures[1])
        information = jnp.zeros((2, 2), zero.dtype) + zero
        return ActuatorAdaptationState(zero + 1, zero + delay, predictions, information, none, zero)

    def step(
        self,
        state: ActuatorAdaptationState,
        valve: Actuator,
        delay: ArrayLike,
        sent: tuple[Pair, ...],
        measured: Pair,
        air: tuple[AirVolume | None, AirVolume | None],
        period: ArrayLike,
    ) -> ActuatorAdaptationState:
        """Return the estimates after a period [s].

        `valve` and `delay` [s] are those of the model, `sent` the commands [Pa] of the last periods, the last first,
        `measured` the pressures [Pa] at the end of the period, and `air` the volumes of valves with air.
        """
        prior = jnp.stack([jnp.zeros_like(state.delay), jnp.zeros_like(state.delay) + delay])
        spreads = jnp.stack([jnp.asarray(self.speed_spread), jnp.asarray(self.delay_spread)])
        now = jnp.stack([jnp.log(state.speed), state.delay])
        keep, washout = exp(-jnp.asarray(period) / self.memory), lag_fraction(_WASHOUT, period)
        variance = jnp.asarray(self.pressure_error) ** 2 + _OFFSET**2 * exp(-2 / _WASHOUT * state.age)
        information, evidence, predictions = keep * state.information, keep * state.evidence, []
        for side, last in enumerate(state.predictions):
            predicted = _predicted(last, now, valve.for_muscle(side), [pair[side] for pair in sent], air[side], period)
            error = measured[side] - predicted.pressure
            slow_error = last.slow_error + washout * (error - last.slow_error)
            slow_slopes = last.slow_slopes + washout * (predicted.pressure_slopes - last.slow_slopes)
            error, slopes = error - slow_error, predicted.pressure_slopes - slow_slopes
            weight = 1 / jnp.maximum(variance, error**2 / _LARGEST**2)
            information = information + weight * jnp.outer(slopes, slopes)
            evidence = evidence + weight * slopes * (error + slopes @ (now - prior))
            predictions.append(predicted._replace(slow_error=slow_error, slow_slopes=slow_slopes))
        scaled = information * jnp.outer(spreads, spreads)
        moved = spreads * _solved(scaled + jnp.eye(2, dtype=now.dtype), evidence * spreads)
        estimate = prior + jnp.clip(moved, -_DEVIATIONS * spreads, _DEVIATIONS * spreads)
        return ActuatorAdaptationState(
            exp(estimate[0]),
            jnp.maximum(estimate[1], 0.0),
            (predictions[0], predictions[1]),
            information,
            evidence,
            state.age + period,
        )


def with_speed(valve: Actuator, speed: ArrayLike) -> Actuator:
    """Valve that is faster by a factor."""
    model: Any = valve
    if not model.holds_air:
        return eqx.tree_at(lambda first_order: first_order.time_constant, model, model.time_constant / speed)
    return model.scaled(speed)


def arriving(sent: list[Scalar], delay: ArrayLike, period: ArrayLike) -> Scalar:
    """Mean command [Pa] that arrives over the last period [s] after a delay [s]; the last sent is the first."""
    ages = jnp.arange(len(sent), dtype=sent[0].dtype)
    shares = jnp.maximum(1 - jnp.abs(jnp.asarray(delay) / period - ages), 0.0)
    return shares @ jnp.stack(sent)


def _predicted(
    last: Prediction, now: Array, valve: Actuator, sent: list[Scalar], air: AirVolume | None, period: ArrayLike
) -> Prediction:
    """Prediction after a further period [s] with estimates, and its slopes over these."""

    def follow(pressure: Scalar, state: PyTree, estimates: Array) -> tuple[Scalar, PyTree]:
        command = arriving(sent, estimates[1], period)
        return with_speed(valve, exp(estimates[0])).predict(pressure, state, command, air, period)

    def along(slope: Scalar, state_slope: PyTree, direction: Array) -> PyTree:
        return jax.jvp(follow, (last.pressure, last.state, now), (slope, state_slope, direction))

    along_all = jax.vmap(along, out_axes=(None, 0))
    directions = jnp.eye(2, dtype=now.dtype)
    (pressure, state), (slopes, state_slopes) = along_all(last.pressure_slopes, last.state_slopes, directions)
    return last._replace(pressure=pressure, state=state, pressure_slopes=slopes, state_slopes=state_slopes)


def _solved(matrix: Array, vector: Array) -> Array:
    """Solution of two equations with a positive definite matrix."""
    (a, b), (_, c) = matrix
    return jnp.stack([c * vector[0] - b * vector[1], a * vector[1] - b * vector[0]]) / (a * c - b**2)
