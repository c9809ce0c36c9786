"""Feedback from angle error to acceleration: pole placement and sliding mode."""

import abc
import math
from numbers import Real
from typing import Annotated, Any, Generic

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float

from mckibben.component.base import Component
from mckibben.control.base import State
from mckibben.errors import RangeError
from mckibben.numerics.elementary import floating
from mckibben.units import AngularAcceleration, Bandwidth, PoleDamping, Quantity

PositiveRate = Annotated[float, Quantity("1/s", "1/s", 0, 1e6, open_lower=True)]

# No `from __future__ import annotations`: equinox does not see an AbstractVar written as text.

Scalar = Float[Array, ""]


class Feedback(Component, Generic[State]):
    r"""Outer loop of a linearised joint, :math:`\ddot\theta = a`, whose acceleration lags its command a_c.

    .. math:: T \dot a + a = a_c, \quad T = \mathrm{lag}\,[s]
    """

    default_class = "poles"
    lag: eqx.AbstractVar[ArrayLike]

    def check_period(self, period: float) -> None:
        """Raise `RangeError` for a bandwidth that no loop with a control period [s] has."""

    @abc.abstractmethod
    def init(self, error: ArrayLike) -> State:
        """Return the state before the first step, at an error [rad]."""

    @abc.abstractmethod
    def step(
        self, state: State, error: ArrayLike, rate: ArrayLike, jerk: ArrayLike, period: ArrayLike
    ) -> tuple[State, Scalar]:
        """Return the next state and the acceleration [rad/s^2] for an error [rad] of the angle and its rate [rad/s].

        `jerk` [rad/s^3] is the rate at which the actuators can change the acceleration.
        """

    @abc.abstractmethod
    def track(self, state: State, shortfall: ArrayLike, period: ArrayLike) -> State:
        """Return the state after a command whose acceleration fell short [rad/s^2] (anti-windup)."""


def braked(error: ArrayLike, rate: ArrayLike, kp: ArrayLike, kd: ArrayLike, jerk: ArrayLike) -> Scalar:
    r"""Acceleration kd rate + kp error [rad/s^2], less for errors from which a limited jerk could not brake in time.

    From a velocity v a triple integrator with the jerk j comes to rest within :math:`v^{3/2} / \sqrt j`, and from an
    acceleration a within :math:`a^2 / (2 j)` of velocity. Linear where the line is below these limits, with the same
    slope where they meet.

    References
    ----------
    M. L. Workman, Adaptive Proximate Time-Optimal Servomechanisms, PhD thesis, Stanford 1987; of third order: L. Y. Pao
    and G. F. Franklin, Proximate time-optimal control of third-order servomechanisms, IEEE Trans. Automatic Control 38,
    1993.
    """
    jerk, slope = jnp.asarray(jerk), kp / kd
    distance, linear = jnp.abs(error), 4 / 9 * jerk / slope**3
    beyond = jnp.cbrt(jerk * jnp.maximum(distance - linear / 3, linear / 3) ** 2)
    speed = rate + jnp.where(distance <= linear, slope * error, jnp.sign(error) * beyond)
    fast, proportional = jnp.abs(speed), jerk / kd**2
    most = jnp.sqrt(2 * jerk * jnp.maximum(fast - proportional / 2, proportional / 2))
    return jnp.where(fast <= proportional, kd * speed, jnp.sign(speed) * most)


class PolePlacement(Feedback[Scalar]):
    r"""Poles of the closed loop at the distance :math:`\omega_c` from the origin, the bandwidth [rad/s].

    .. math:: a = k_d \dot e + k_p e \; [+ k_i \int e], \quad
              T s^3 + s^2 + k_d s + k_p = T (s + \omega_c)(s^2 + (d - 1)\,\omega_c s + \omega_c^2)

    so that :math:`T = 1/(d\omega_c), k_d = \omega_c, k_p = \omega_c^2/d`. A damping d of 3 places all poles at one; 2
    are those of Butterworth. With an integral there is one more pole at :math:`-\omega_c`, and
    :math:`T = 1/((d+1)\omega_c), k_d = 2d\omega_c/(d+1), k_p = \omega_c^2, k_i = \omega_c^3/(d+1)`. The integral
    removes the static error of a wrong model; with a disturbance observer it is redundant. With a lag g times that of
    the model the loop is stable up to g = d^2 (2d - 1 with the integral).

    Parameters
    ----------
    bandwidth
        omega_c [rad/s]: higher is faster, and passes more noise to the pressures.
    integral
        Whether there is an integral of the error.
    damping
        d, from 2 (Butterworth poles: fast, with some overshoot) to 3 (all poles at one place).

    References
    ----------
    One bandwidth for all gains: Z. Gao, Scaling and bandwidth-parameterization based controller tuning, ACC 2003.
    """

    short_name = "poles"

    bandwidth: Bandwidth = 80.0
    integral: bool = eqx.field(static=True, default=False)
    damping: PoleDamping = 3.0

    def check_period(self, period: float) -> None:
        if isinstance(self.bandwidth, Real) and self.bandwidth > (nyquist := math.pi / period):
            message = f"a bandwidth of {float(self.bandwidth):.4g} rad/s is above the Nyquist frequency of the control "
            message += f"period, {nyquist:.4g} rad/s"
            details: dict[str, Any] = {"value": float(self.bandwidth), "upper": nyquist, "unit": "rad/s"}
            remedy = "give a bandwidth that is lower by a factor of ten or so, or a shorter period"
            raise RangeError(message, field="controller.feedback.bandwidth", remedy=remedy, **details)

    @property
    def lag(self) -> ArrayLike:  # pyrefly: ignore[bad-override]
        """T [s]."""
        return 1 / ((self.damping + 1 if self.integral else self.damping) * self.bandwidth)

    def init(self, error: ArrayLike) -> Scalar:
        return jnp.zeros_like(floating(error))

    def step(
        self, state: Scalar, error: ArrayLike, rate: ArrayLike, jerk: ArrayLike, period: ArrayLike
    ) -> tuple[Scalar, Scalar]:
        pole, damping = jnp.asarray(self.bandwidth), jnp.asarray(self.damping)
        if not self.integral:
            return state, braked(error, rate, pole**2 / damping, pole, jerk)
        kp, kd = pole**2, 2 * damping / (damping + 1) * pole
        state = state + period * pole**3 / (damping + 1) * error
        linear, limited = kp * error + kd * rate + state, braked(error + state / kp, rate, kp, kd, jerk)
        return self.track(state, linear - limited, period), limited

    def track(self, state: Scalar, shortfall: ArrayLike, period: ArrayLike) -> Scalar:
        return state - period * self.bandwidth * shortfall if self.integral else state


class SlidingMode(Feedback[tuple[()]]):
    r"""Sliding mode with a boundary layer.

    .. math:: s = \dot e + \lambda e, \quad a = \lambda \dot e + \rho\, \mathrm{sat}(s / \phi), \quad
              \phi = \rho / \lambda, \quad T = 1/(6\lambda)

    Outside the layer :math:`|s| < \phi` the surface s = 0 is reached under any disturbance below rho; inside, the loop
    is PD, and a disturbance d leaves an error of :math:`d / \lambda^2`. The width of the layer makes the approach to
    the surface as fast as the motion on it, so that unmodelled lags see no higher bandwidth than lambda. T is a third
    of the inverse gain of the rate, as for `PolePlacement`: with a lag g times that of the model the loop is stable up
    to g = 12, lags of observers not counted.

    Parameters
    ----------
    slope, reach
        lambda [1/s] and rho [rad/s^2].

    References
    ----------
    J.-J. E. Slotine and W. Li, Applied Nonlinear Control, Prentice Hall 1991, ch. 7: balance of the boundary layer, and
    choice of lambda by unmodelled lags.
    """

    short_name = "sliding"

    slope: PositiveRate = 40.0
    reach: AngularAcceleration = 250.0

    @property
    def lag(self) -> ArrayLike:  # pyrefly: ignore[bad-override]
        """T [s]."""
        return 1 / (6 * self.slope)

    @property
    def layer(self) -> ArrayLike:
        """Width of the boundary layer, phi [rad/s]."""
        return self.reach / self.slope

    def init(self, error: ArrayLike) -> tuple[()]:
        return ()

    def step(
        self, state: tuple[()], error: ArrayLike, rate: ArrayLike, jerk: ArrayLike, period: ArrayLike
    ) -> tuple[tuple[()], Scalar]:
        surface = rate + self.slope * jnp.asarray(error)
        return state, self.slope * jnp.asarray(rate) + self.reach * jnp.clip(surface / self.layer, -1.0, 1.0)

    def track(self, state: tuple[()], shortfall: ArrayLike, period: ArrayLike) -> tuple[()]:
        return state
