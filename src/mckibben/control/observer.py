"""What is not measured, or not well: the joint's velocity, what pushes it beside a model's torques, the pressures."""

from __future__ import annotations

import abc
import math
from numbers import Real
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float

from mckibben.joint.geometry import Pair
from mckibben.numerics.checks import check_positive
from mckibben.numerics.elementary import exp, floating
from mckibben.units import Bandwidth

Scalar = Float[Array, ""]


class Motion(NamedTuple):
    """What an observer believes of the joint, and what it remembers.

    Attributes
    ----------
    angle
        [rad].
    velocity
        [rad/s].
    disturbance
        The acceleration [rad/s^2] that the model has no cause for; 0 where it is not observed.
    known
        The acceleration [rad/s^2] that it has a cause for.
    """

    angle: Scalar
    velocity: Scalar
    disturbance: Scalar
    known: Scalar

    @property
    def acceleration(self) -> Scalar:
        """All of it [rad/s^2]."""
        return self.known + self.disturbance


class Observer(eqx.Module):
    r"""Estimates motion from the measured angle and the acceleration that a model expects.

    Between two measurements the acceleration is taken as constant, and then every estimate is corrected by its gain
    times what the angle is off, so that all errors die out as :math:`e^{-\omega_o t}`: all poles of the error lie at
    :math:`\beta = e^{-\omega_o h}`.
    """

    def init(self, angle: ArrayLike, known: ArrayLike) -> Motion:
        """At rest at a measured angle [rad], where the model expects an acceleration [rad/s^2]."""
        angle = floating(angle)
        nothing = jnp.zeros_like(angle)
        return Motion(angle, nothing, nothing, nothing + known)

    def step(self, motion: Motion, angle: ArrayLike, known: ArrayLike, period: ArrayLike) -> Motion:
        """What is believed after the next measurement.

        Parameters
        ----------
        motion
            What was believed at the last one, a period ago.
        angle
            The measured angle [rad].
        known
            The acceleration [rad/s^2] that the model expects here and now.
        period
            The control period [s].
        """
        acceleration = (motion.known + known) / 2 + motion.disturbance
        moved = motion.angle + period * (motion.velocity + period / 2 * acceleration)
        off = angle - moved
        by_angle, by_velocity, by_disturbance = self.gains(period)
        return Motion(
            moved + by_angle * off,
            motion.velocity + period * acceleration + by_velocity * off,
            motion.disturbance + by_disturbance * off,
            floating(known),
        )

    @abc.abstractmethod
    def gains(self, period: ArrayLike) -> tuple[ArrayLike, ArrayLike, ArrayLike]:
        """The corrections of angle [-], velocity [1/s] and disturbance [1/s^2] for a control period [s]."""


class VelocityObserver(Observer):
    r"""Angle and velocity: the model is taken at its word.

    .. math:: l_1 = 1 - \beta^2, \quad l_2 = (1 - \beta)^2 / h, \quad \beta = e^{-\omega_o h}

    Parameters
    ----------
    bandwidth
        omega_o [rad/s]. With a model that misses an acceleration a it reads the velocity wrong by 2 a / omega_o.

    References
    ----------
    D. G. Luenberger, An introduction to observers, IEEE Trans. Automatic Control 16, 1971; the gains are those of the
    second-order fading-memory filter, N. Morrison, Introduction to Sequential Smoothing and Prediction, 1969.

    Examples
    --------
    >>> [round(float(gain), 4) for gain in VelocityObserver(bandwidth=100.0).gains(1e-3)]
    [0.1813, 9.0559, 0.0]
    """

    bandwidth: Bandwidth = 250.0

    def __check_init__(self) -> None:
        check_positive("VelocityObserver", "rad/s", bandwidth=self.bandwidth)

    def gains(self, period: ArrayLike) -> tuple[ArrayLike, ArrayLike, ArrayLike]:
        pole = exp(-jnp.asarray(self.bandwidth) * period)
        return 1 - pole**2, (1 - pole) ** 2 / period, 0.0


class ExtendedStateObserver(Observer):
    r"""Angle, velocity, and all that the model has wrong as one slowly changing disturbance.

    .. math:: l_1 = 1 - \beta^3, \quad l_2 = \tfrac{3}{2} (1 - \beta)^2 (1 + \beta) / h, \quad
              l_3 = (1 - \beta)^3 / h^2, \quad \beta = e^{-\omega_o h}

    Parameters
    ----------
    bandwidth
        omega_o [rad/s]: what changes more slowly than this is seen. Noise of the encoder is what bounds it.

    References
    ----------
    J. Han, From PID to active disturbance rejection control, IEEE Trans. Industrial Electronics 56, 2009; one
    bandwidth for all gains: Z. Gao, Scaling and bandwidth-parameterization based controller tuning, ACC 2003; in
    discrete time: R. Miklosovic, A. Radke and Z. Gao, Discrete implementation and generalization of the extended state
    observer, ACC 2006.

    Examples
    --------
    >>> [round(float(gain), 4) for gain in ExtendedStateObserver(bandwidth=100.0).gains(1e-3)]
    [0.2592, 25.8751, 861.7844]
    """

    bandwidth: Bandwidth = 250.0

    def __check_init__(self) -> None:
        check_positive("ExtendedStateObserver", "rad/s", bandwidth=self.bandwidth)

    def gains(self, period: ArrayLike) -> tuple[ArrayLike, ArrayLike, ArrayLike]:
        pole = exp(-jnp.asarray(self.bandwidth) * period)
        return 1 - pole**3, 1.5 * (1 - pole) ** 2 * (1 + pole) / period, (1 - pole) ** 3 / period**2


class PressureObserver(eqx.Module):
    r"""The pressures without the noise of their sensors, by a model of the valves.

    .. math:: \hat p^- = \hat p + (1 - e^{-h/\tau_v}) (p_{command} - \hat p), \quad
              \hat p = \hat p^- + (1 - e^{-\omega_p h}) (p - \hat p^-)

    Noise that is white comes through with a part of :math:`\sqrt{\omega_p h / 2}`; a valve whose lag is not the one
    believed makes an error that dies out with omega_p.

    Parameters
    ----------
    bandwidth
        omega_p [rad/s]; infinite where the sensors are to be taken as they are.
    """

    bandwidth: Bandwidth = 200.0

    def __check_init__(self) -> None:
        if not (isinstance(self.bandwidth, Real) and math.isinf(self.bandwidth)):
            check_positive("PressureObserver", "rad/s", bandwidth=self.bandwidth)

    def step(self, pressures: Pair, commands: Pair, measured: Pair, share: ArrayLike, period: ArrayLike) -> Pair:
        """The pressures [Pa] now.

        Parameters
        ----------
        pressures
            What they were a period ago [Pa].
        commands
            What was commanded since [Pa].
        measured
            What the sensors say now [Pa].
        share
            The part of a step that a valve does in a period [-].
        period
            The control period [s].
        """
        trust = 1 - exp(-jnp.asarray(self.bandwidth) * period)

        def one(pressure: Scalar, command: Scalar, sensed: Scalar) -> Scalar:
            moved = pressure + share * (command - pressure)
            return moved + trust * (sensed - moved)

        return one(pressures[0], commands[0], measured[0]), one(pressures[1], commands[1], measured[1])
