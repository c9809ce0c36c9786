"""Feedback from the angle error to an acceleration: pole placement and sliding mode."""

import abc
from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float

from mckibben.numerics.checks import check_positive
from mckibben.numerics.elementary import floating
from mckibben.units import AngularAcceleration, Bandwidth, PositiveRate, PositiveTime

# No `from __future__ import annotations` here: equinox does not see an AbstractVar written as text.


Scalar = Float[Array, ""]


class Feedback(eqx.Module):
    r"""The outer loop of a controller that has made the joint :math:`\ddot\theta = a`, where a follows with a lag.

    .. math:: T \dot a + a = a_{wanted}

    Attributes
    ----------
    lag
        T [s]: how fast the acceleration, and so the pressures, have to follow.
    """

    lag: eqx.AbstractVar[Any]

    @abc.abstractmethod
    def init(self, error: ArrayLike) -> Any:
        """The state before the first step, at an error [rad]."""

    @abc.abstractmethod
    def step(self, state: Any, error: ArrayLike, rate: ArrayLike, period: ArrayLike) -> tuple[Any, Scalar]:
        """The next state and the acceleration [rad/s^2].

        Parameters
        ----------
        state
            From `init` or `realised`.
        error, rate
            Wish minus angle [rad], and its rate [rad/s].
        period
            The control period [s].
        """

    @abc.abstractmethod
    def realised(self, state: Any, missing: ArrayLike, period: ArrayLike) -> Any:
        """The state once it is known how much acceleration [rad/s^2] the joint could not give: anti-windup."""


class PolePlacement(Feedback):
    r"""All poles of the closed loop at one place, :math:`s = -\omega_c`.

    .. math:: a = k_d \dot e + k_p e \; [+ k_i \int e], \quad
              T s^3 + s^2 + k_d s + k_p = T (s + \omega_c)^3

    so that :math:`T = 1/(3\omega_c), k_d = \omega_c, k_p = \omega_c^2/3`. With an integral there are four poles:
    :math:`T = 1/(4\omega_c), k_d = 3\omega_c/2, k_p = \omega_c^2, k_i = \omega_c^3/4`. Beside an observer of the
    disturbance it is of no use, without one it takes away what a wrong model leaves.

    With a lag that is g times slower than believed the loop is stable up to g = 9 (5 with the integral).

    Parameters
    ----------
    bandwidth
        omega_c [rad/s].
    integral
        Whether there is one.

    References
    ----------
    One bandwidth for all gains: Z. Gao, Scaling and bandwidth-parameterization based controller tuning, ACC 2003.
    """

    bandwidth: Bandwidth = 80.0
    integral: bool = eqx.field(static=True, default=False)

    def __check_init__(self) -> None:
        check_positive("PolePlacement", "rad/s", bandwidth=self.bandwidth)

    @property
    def lag(self) -> Any:
        """T [s], which places the poles with the gains."""
        return 1 / (4 * self.bandwidth) if self.integral else 1 / (3 * self.bandwidth)

    def init(self, error: ArrayLike) -> Scalar:
        return jnp.zeros_like(floating(error))

    def step(self, state: Scalar, error: ArrayLike, rate: ArrayLike, period: ArrayLike) -> tuple[Scalar, Scalar]:
        pole = jnp.asarray(self.bandwidth)
        if not self.integral:
            return state, pole * rate + pole**2 / 3 * error
        state = state + period * pole**3 / 4 * error
        return state, 1.5 * pole * rate + pole**2 * error + state

    def realised(self, state: Scalar, missing: ArrayLike, period: ArrayLike) -> Scalar:
        return state - period * self.bandwidth * missing if self.integral else state


class SlidingMode(Feedback):
    r"""Sliding mode with a boundary layer.

    .. math:: s = \dot e + \lambda e, \quad a = \lambda \dot e + \rho\, \mathrm{sat}(s / \phi)

    Outside the layer :math:`|s| < \phi` the surface s = 0 is reached whatever disturbance below rho there is; inside it
    is a PD loop, and a disturbance d leaves an error of :math:`\phi d / (\lambda \rho)`. A layer of no width would
    chatter: the pressures follow with the lag T only, and stability inside asks for
    :math:`\lambda + \rho/\phi > T \lambda \rho/\phi`.

    Parameters
    ----------
    slope
        lambda [1/s].
    reach
        rho [rad/s^2].
    layer
        phi [rad/s].
    lag
        T [s].

    References
    ----------
    J.-J. E. Slotine and W. Li, Applied Nonlinear Control, Prentice Hall 1991, ch. 7.
    """

    slope: PositiveRate = 40.0
    reach: AngularAcceleration = 80.0
    layer: Bandwidth = 1.0
    lag: PositiveTime = 0.005

    def __check_init__(self) -> None:
        check_positive("SlidingMode", "1/s", slope=self.slope)
        check_positive("SlidingMode", "rad/s^2", reach=self.reach)
        check_positive("SlidingMode", "rad/s", layer=self.layer)
        check_positive("SlidingMode", "s", lag=self.lag)

    def init(self, error: ArrayLike) -> tuple[()]:
        return ()

    def step(self, state: tuple[()], error: ArrayLike, rate: ArrayLike, period: ArrayLike) -> tuple[tuple[()], Scalar]:
        surface = rate + self.slope * jnp.asarray(error)
        return state, self.slope * jnp.asarray(rate) + self.reach * jnp.clip(surface / self.layer, -1.0, 1.0)

    def realised(self, state: tuple[()], missing: ArrayLike, period: ArrayLike) -> tuple[()]:
        return state
