"""PID with a filtered derivative and anti-windup by back-calculation."""

from __future__ import annotations

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from mckibben.component.checks import known_numbers
from mckibben.control.base import Loop
from mckibben.errors import RangeError
from mckibben.numerics.elementary import floating
from mckibben.units import DerivativeGain, Gain, IntegralGain, ShortTime

Scalar = Float[Array, ""]


class LastSample(NamedTuple):
    """Last measurement; last setpoint and its last change, empty where the derivative is that of the measurement."""

    measured: Scalar
    setpoint: tuple[Scalar, ...] = ()
    change: tuple[Scalar, ...] = ()


class PIDState(NamedTuple):
    """Integral term (in the output's unit), last sample, filtered derivative."""

    integral: Scalar
    last: LastSample
    derivative: Scalar


class PID(Loop[PIDState]):
    r"""PID controller.

    .. math:: u = k_p e + k_i \int e \, dt + k_d \dot e

    The derivative passes a first-order filter. It acts on the measurement alone, or on the error with
    `derivative_on_error`. Of two consecutive changes of the setpoint it then has the smaller one, and none if their
    signs differ (minmod), so that a step of the setpoint causes no kick. A reverse-acting loop has negative gains, in
    the units of output and error.

    Parameters
    ----------
    kp, ki, kd
        Gains in SI: of a position loop in Pa/rad, Pa/(rad*s) and Pa*s/rad, so that ``2 * bar`` is 2 bar/rad.
    filter_time, tracking_time
        Time constants [s] of the derivative's filter, and of the anti-windup: at or below the control period the
        integral is reset at once, and with ki = 0 there is none.

    References
    ----------
    K. J. Astrom and T. Hagglund, Advanced PID Control, ISA 2006, sections 3.3 and 3.5 (back-calculation).
    """

    short_name = "pid"

    kp: Gain
    ki: IntegralGain
    kd: DerivativeGain
    filter_time: ShortTime = eqx.field(kw_only=True, default=0.005)
    tracking_time: ShortTime = eqx.field(kw_only=True, default=0.05)
    derivative_on_error: bool = eqx.field(kw_only=True, static=True, default=False)

    def __check_init__(self) -> None:
        super().__check_init__()
        gains = {"kp": self.kp, "ki": self.ki, "kd": self.kd}
        numbers = [known_numbers("PID", name, gain) for name, gain in gains.items()]
        table = np.stack(np.broadcast_arrays(*numbers)) if all(part.size for part in numbers) else np.zeros(3)
        if (wrong := table.min(axis=0) * table.max(axis=0) < 0).any():
            first = zip(gains, table[:, wrong][:, 0], strict=True)
            signs = ", ".join(f"{name} is {'negative' if gain < 0 else 'positive'}" for name, gain in first if gain)
            remedy = "give all one sign, negative if the loop is reverse-acting"
            raise RangeError(f"PID: the gains differ in sign: {signs}", remedy=remedy)

    def init(self, setpoint: ArrayLike, measured: ArrayLike, output: ArrayLike) -> PIDState:
        return PIDState(
            integral=floating(output),
            last=self.sample(None, setpoint, measured),
            derivative=jnp.zeros_like(floating(output)),
        )

    def step(
        self, state: PIDState, setpoint: ArrayLike, measured: ArrayLike, period: ArrayLike
    ) -> tuple[PIDState, Scalar]:
        error = jnp.asarray(setpoint) - measured
        derivative = self.derivative(state, setpoint, measured, period)
        integral = state.integral + self.ki * period * error
        output = self.kp * error + integral + self.kd * derivative
        return PIDState(integral, self.sample(state, setpoint, measured), derivative), output

    def track(self, state: PIDState, output: ArrayLike, achieved: ArrayLike, period: ArrayLike) -> PIDState:
        fraction = jnp.minimum(period / jnp.maximum(self.tracking_time, 1e-12), 1.0)
        fraction = jnp.where(jnp.asarray(self.ki) == 0, 0.0, fraction)  # no integral action removes a bias
        return state._replace(integral=state.integral + fraction * (achieved - jnp.asarray(output)))

    def telemetry(self, state: PIDState) -> dict[str, Scalar]:
        return {}

    def sample(self, state: PIDState | None, setpoint: ArrayLike, measured: ArrayLike) -> LastSample:
        """Sample for the derivative of the next period.

        The change of the setpoint since the last sample of the state is part of it with `derivative_on_error`.
        """
        measured = floating(measured)
        if not self.derivative_on_error:
            return LastSample(measured)
        setpoint = jnp.broadcast_to(floating(setpoint), measured.shape)
        change = jnp.zeros_like(setpoint) if state is None else setpoint - state.last.setpoint[0]
        return LastSample(measured, (setpoint,), (change,))

    def derivative(self, state: PIDState, setpoint: ArrayLike, measured: ArrayLike, period: ArrayLike) -> Scalar:
        """Filtered derivative one control period [s] later, in the unit of the measurement per second.

        Backward Euler: (T d + change) / (T + h), with the filter time T and the change of minus the measurement.
        """
        change = state.last.measured - floating(measured)
        if self.derivative_on_error:
            now, before = jnp.asarray(setpoint) - state.last.setpoint[0], state.last.change[0]
            smooth = jnp.where(jnp.abs(now) < jnp.abs(before), now, before)
            change = change + jnp.where(now * before > 0, smooth, 0.0)
        return (self.filter_time * state.derivative + change) / (self.filter_time + period)
