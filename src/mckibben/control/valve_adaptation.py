"""On-line estimation of the valves' time constant from commands and measured pressures."""

from __future__ import annotations

from typing import Annotated, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from mckibben.actuator.base import lag_fraction
from mckibben.component.base import Component
from mckibben.control.observer import lagged
from mckibben.joint.geometry import Pair
from mckibben.numerics.elementary import exp, floating
from mckibben.units import PositiveTime, PressureScale, Quantity

TimeConstantSpread = Annotated[float, Quantity("1", "1", 0, 0.6, open_lower=True)]

Scalar = Float[Array, ""]

_DEVIATIONS = np.linspace(-3.0, 3.0, 9)  # of the models, in prior standard deviations
_WASHOUT = 0.1  # s, time constant of the high-pass filter of commands and pressures
_OFFSET = 0.5e5  # Pa, standard deviation of a measured pressure from its command in equilibrium
_DELAY = 0.01  # s, prior standard deviation of a delay of the commands
_LARGEST = 3.0  # error over its standard deviation; larger ones count as this


class ValveAdaptationState(NamedTuple):
    """Estimated time constant, and the regression of each model's errors on their sensitivity to a delay."""

    time_constant: Scalar  # [s]
    slow: tuple[Pair, Pair]  # commands and measured pressures, low-pass filtered [Pa]
    predicted: tuple[Array, Array]  # high-pass filtered pressures of both muscles [Pa], shape (models,)
    squares: Array  # sums of squared errors over their variance, shape (models,)
    products: Array  # of errors and sensitivities
    sensitivities: Array  # of squared sensitivities
    age: Scalar  # time since the start [s]


class ValveAdaptation(Component):
    r"""Estimate of the time constant of the valves by a bank of models.

    Nine first-order lags, whose time constants :math:`\tau_j` lie up to three prior standard deviations from the
    model's, predict both pressures from the commands alone (output error). Commands u and measured pressures p pass the
    same high-pass filter, of 0.1 s; at the start, the variance of offsets is added to that of the error. The estimate
    is the most probable time constant,

    .. math::

        \hat\tau = \arg\min_{\tau,\, d \ge 0} \sum_k w_k e^{-(t - t_k)/T}
        \frac{(p_k - \hat p_k(\tau) + d\,\dot{\hat p}_k)^2}{2 \sigma_p^2}
        + \frac{\ln^2(\tau / \tau_v)}{2 \sigma^2} + \frac{d^2}{2 \sigma_d^2}, \quad
        \tau \dot{\hat p} = u - \hat p,

    the vertex of the parabola through the best model and its neighbours, with a delay d of the commands of up to some
    10 ms. The weights w are 1 up to three standard deviations; a larger error counts as three. Both valves are assumed
    identical.

    Parameters
    ----------
    time_constant_spread
        sigma: prior standard deviation of the logarithm of the time constant [-], at most 0.6.
    pressure_error
        sigma_p: standard deviation of a measured pressure from that of a first-order lag [Pa].
    memory
        T: time constant by which errors are forgotten [s].

    References
    ----------
    D. T. Magill, Optimal adaptive estimation of sampled stochastic processes, IEEE Trans. Automatic Control 10, 1965
    (banks of models); L. Ljung, System Identification, 2nd ed., Prentice Hall 1999, ch. 5 (output-error models),
    sec. 11.2 (forgetting) and 15.2 (robust norms).
    """

    time_constant_spread: TimeConstantSpread = 0.5
    pressure_error: PressureScale = 5000.0
    memory: PositiveTime = 10.0

    def init(self, time_constant: ArrayLike, pressures: Pair) -> ValveAdaptationState:
        """Prior about the time constant [s] of the model, at measured pressures [Pa]."""
        zero = jnp.zeros_like(floating(pressures[0]))
        zeros = jnp.zeros(_DEVIATIONS.size, zero.dtype) + zero
        return ValveAdaptationState(
            zero + time_constant, (pressures, pressures), (zeros, zeros), zeros, zeros, zeros, zero
        )

    def step(
        self, state: ValveAdaptationState, time_constant: ArrayLike, commands: Pair, measured: Pair, period: ArrayLike
    ) -> ValveAdaptationState:
        """Return the estimate after a period of commands [Pa] and the pressures [Pa] measured at its end."""
        deviations = jnp.asarray(_DEVIATIONS, state.squares.dtype)
        spread, noise = jnp.asarray(self.time_constant_spread), jnp.asarray(self.pressure_error) ** 2
        fractions = lag_fraction(time_constant * exp(spread * deviations), period)
        noise = noise + _OFFSET**2 * exp(-2 / _WASHOUT * state.age)
        washout, keep = lag_fraction(_WASHOUT, period), exp(-jnp.asarray(period) / self.memory)
        slow = lagged(state.slow[0], commands, washout), lagged(state.slow[1], measured, washout)
        squares, products, sensitivities = keep * state.squares, keep * state.products, keep * state.sensitivities
        predicted = []
        for i in (0, 1):
            moved = fractions * (commands[i] - slow[0][i] - state.predicted[i])
            predicted.append(state.predicted[i] + moved)
            error = measured[i] - slow[1][i] - predicted[i]
            weight = 1 / jnp.maximum(noise, error**2 / _LARGEST**2)
            squares = squares + weight * error**2
            products = products - weight * error * moved
            sensitivities = sensitivities + weight * moved**2
        explained = jnp.maximum(products, 0.0) ** 2 / (sensitivities + (period / _DELAY) ** 2)  # by a delay above 0
        deviation = _lowest((squares - explained + deviations**2) / 2, deviations)
        estimate = floating(time_constant) * exp(spread * deviation)
        return ValveAdaptationState(
            estimate, slow, (predicted[0], predicted[1]), squares, products, sensitivities, state.age + period
        )


def _lowest(values: Array, deviations: Array) -> Scalar:
    """Deviation at which the parabola through the lowest of the inner values and its neighbours is least."""
    before, inner, after = values[:-2], values[1:-1], values[2:]
    curvature = after - 2 * inner + before
    convex = curvature > 0
    step = jnp.where(convex, (before - after) / (2 * jnp.where(convex, curvature, 1.0)), jnp.sign(before - after))
    vertices = deviations[1:-1] + (deviations[1] - deviations[0]) * jnp.clip(step, -1.0, 1.0)
    best = inner == jnp.min(inner)
    return jnp.sum(jnp.where(best, vertices, 0.0)) / jnp.sum(best)
