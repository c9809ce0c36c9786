"""PID with a filtered derivative and anti-windup on what could be realised."""

from __future__ import annotations

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float

from mckibben.control.base import Loop
from mckibben.numerics.checks import check_positive
from mckibben.numerics.elementary import floating
from mckibben.units import ShortTime

Scalar = Float[Array, ""]


class PIDState(NamedTuple):
    """Integral part (in the output's unit), the last input of the derivative, and the filtered derivative."""

    integral: Scalar
    differentiated: Scalar
    derivative: Scalar


class PID(Loop):
    r"""u = kp e + ki \int e + kd de/dt.

    The derivative is filtered to first order and taken of the measurement alone, so that a step of the wish does not
    kick; `derivative_on_error` takes it of the error. A reverse-acting loop, whose measurement falls as its output
    rises, has negative gains.

    Parameters
    ----------
    kp, ki, kd
        Gains, in units of output per unit of error, per second of it, and seconds of it.
    filter_time
        Time constant of the derivative's filter [s].
    tracking_time
        With which the integral follows what could be realised [s]; at or below the control period it does so at once.
        Without integral action (ki = 0) the integral keeps its initial value and tracks nothing.
    derivative_on_error
        Whether the derivative sees the wish as well.

    References
    ----------
    K. J. Astrom and T. Hagglund, Advanced PID Control, ISA 2006, sections 3.3 and 3.5 (back-calculation).
    """

    kp: float
    ki: float
    kd: float
    filter_time: ShortTime = 0.005
    tracking_time: ShortTime = 0.05
    derivative_on_error: bool = eqx.field(static=True, default=False)

    def __check_init__(self) -> None:
        check_positive("PID", "s", zero=True, filter_time=self.filter_time, tracking_time=self.tracking_time)

    def init(self, desired: ArrayLike, measured: ArrayLike, output: ArrayLike) -> PIDState:
        return PIDState(
            integral=floating(output),
            differentiated=self.differentiated(desired, measured),
            derivative=jnp.zeros_like(floating(output)),
        )

    def step(
        self,
        state: PIDState,
        desired: ArrayLike,
        measured: ArrayLike,
        sensitivity: ArrayLike,
        period: ArrayLike,
    ) -> tuple[PIDState, Scalar]:
        error = jnp.asarray(desired) - measured
        derivative = self.derivative(state, desired, measured, period)
        integral = state.integral + self.ki * period * error
        output = self.kp * error + integral + self.kd * derivative
        return PIDState(integral, self.differentiated(desired, measured), derivative), output

    def realised(self, state: PIDState, output: ArrayLike, realised: ArrayLike, period: ArrayLike) -> PIDState:
        share = jnp.minimum(period / jnp.maximum(self.tracking_time, 1e-12), 1.0)
        share = jnp.where(jnp.asarray(self.ki) == 0, 0.0, share)  # else its bias would stay for good
        return state._replace(integral=state.integral + share * (realised - jnp.asarray(output)))

    def telemetry(self, state: PIDState) -> dict[str, Scalar]:
        return {}

    def differentiated(self, desired: ArrayLike, measured: ArrayLike) -> Scalar:
        """What the derivative is taken of."""
        measured = floating(measured)
        return jnp.asarray(desired) - measured if self.derivative_on_error else -measured

    def derivative(self, state: PIDState, desired: ArrayLike, measured: ArrayLike, period: ArrayLike) -> Scalar:
        """The filtered derivative one control period [s] later."""
        change = self.differentiated(desired, measured) - state.differentiated
        return (self.filter_time * state.derivative + change) / (self.filter_time + period)
