"""From the error of the angle to the acceleration that makes up for it."""

# No `from __future__ import annotations` here: equinox does not see an AbstractVar written as text.

import abc
from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float

from mckibben.numerics.arrays import floating
from mckibben.numerics.checks import check_positive

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

    bandwidth: float = 80.0
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
