"""On-line estimation of the valves' time constant from commands and measured pressures."""

from __future__ import annotations

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from mckibben.control.observer import lag_fraction
from mckibben.joint.geometry import Pair
from mckibben.numerics.checks import check_positive, check_within
from mckibben.numerics.elementary import exp, floating
from mckibben.units import PositiveTime, PressureScale, TimeConstantSpread

Scalar = Float[Array, ""]

_DEVIATIONS = np.linspace(-3.0, 3.0, 9)  # of the models, in prior standard deviations
_LARGEST = 3.0  # innovation over its standard deviation; larger ones count as this


class ValveAdaptationState(NamedTuple):
    """Estimated time constant, and what each model of the bank has predicted."""

    time_constant: Scalar  # [s]
    predicted: tuple[Array, Array]  # pressures of both muscles [Pa], shape (models,)
    variance: Array  # of a predicted pressure [Pa^2], shape (models,)
    misfits: Array  # half the sums of squared innovations over their variances, shape (models,)


class ValveAdaptation(eqx.Module):
    r"""Estimate of the time constant of both valves by a bank of Kalman filters.

    Nine first-order lags, whose time constants lie up to three prior standard deviations from the model's, predict the
    pressures from the commands. The filters have no process noise: they find the pressures at the start, and predict
    them from the commands alone then, so that noise of the sensors does not bias the estimate (output error). It is
    the most probable time constant, the vertex of the parabola through the best model and its neighbours:

    .. math::

        J_j \leftarrow e^{-h / T} J_j
        + \frac12 \sum_{i=1,2} \min\Big(\frac{(p_i - \hat p_{ij})^2}{\sigma_p^2 + P_j}, 3^2\Big), \quad
        \hat\tau_v = \arg\min_\tau \Big(J(\tau) + \frac{\ln^2(\tau / \tau_v)}{2 \sigma^2}\Big)

    Innovations above three standard deviations count as these: what is no lag, such as a supply below the commands,
    hardly biases the estimate. Pressures at rest tell nothing: without changes of the commands it returns to the model
    with the memory T.

    Parameters
    ----------
    time_constant_spread
        sigma: prior standard deviation of the logarithm of the time constant [-], at most 1.
    pressure_error
        sigma_p: standard deviation of a measured pressure from that of a first-order lag [Pa].
    memory
        T: time constant by which errors are forgotten [s].

    References
    ----------
    D. T. Magill, Optimal adaptive estimation of sampled stochastic processes, IEEE Trans. Automatic Control 10, 1965
    (banks of filters); L. Ljung, System Identification, 2nd ed., Prentice Hall 1999, sec. 11.2 (exponential
    forgetting).
    """

    time_constant_spread: TimeConstantSpread = 0.5
    pressure_error: PressureScale = 5000.0
    memory: PositiveTime = 10.0

    def __check_init__(self) -> None:
        check_positive("ValveAdaptation", time_constant_spread=self.time_constant_spread)
        check_within("ValveAdaptation", 0.0, 1.0, time_constant_spread=self.time_constant_spread)
        check_positive("ValveAdaptation", "Pa", pressure_error=self.pressure_error)
        check_positive("ValveAdaptation", "s", memory=self.memory)

    def init(self, time_constant: ArrayLike, pressures: Pair) -> ValveAdaptationState:
        """Prior about the time constant [s] of the model, at measured pressures [Pa]."""
        zeros = jnp.zeros_like(pressures[0]) + np.zeros(_DEVIATIONS.size)
        predicted = zeros + pressures[0], zeros + pressures[1]
        variance = zeros + self.pressure_error**2
        return ValveAdaptationState(jnp.zeros_like(pressures[0]) + time_constant, predicted, variance, zeros)

    def step(
        self, state: ValveAdaptationState, time_constant: ArrayLike, commands: Pair, measured: Pair, period: ArrayLike
    ) -> ValveAdaptationState:
        """Return the estimate after a period of commands [Pa] and the pressures [Pa] measured at its end."""
        fractions = lag_fraction(time_constant * exp(self.time_constant_spread * _DEVIATIONS), period)
        before, noise = (1 - fractions) ** 2 * state.variance, self.pressure_error**2
        total = before + noise
        predicted1, predicted2 = (p + fractions * (u - p) for p, u in zip(state.predicted, commands, strict=True))
        error1, error2 = measured[0] - predicted1, measured[1] - predicted2
        predicted = predicted1 + before / total * error1, predicted2 + before / total * error2
        squares = (jnp.minimum(error**2 / total, _LARGEST**2) for error in (error1, error2))
        misfits = exp(-jnp.asarray(period) / self.memory) * state.misfits + sum(squares) / 2
        deviation = _lowest(misfits + _DEVIATIONS**2 / 2)
        estimate = floating(time_constant) * exp(self.time_constant_spread * deviation)
        return ValveAdaptationState(estimate, predicted, before * noise / total, misfits)


def _lowest(values: Array) -> Scalar:
    """Deviation at which the parabola through the lowest of the inner values and its neighbours is least."""
    before, inner, after = values[:-2], values[1:-1], values[2:]
    curvature = after - 2 * inner + before
    convex = curvature > 0
    step = jnp.where(convex, (before - after) / (2 * jnp.where(convex, curvature, 1.0)), jnp.sign(before - after))
    spacing = _DEVIATIONS[1] - _DEVIATIONS[0]
    vertices = _DEVIATIONS[1:-1] + spacing * jnp.clip(step, -1.0, 1.0)
    best = inner == jnp.min(inner)
    return jnp.sum(jnp.where(best, vertices, 0.0)) / jnp.sum(best)
