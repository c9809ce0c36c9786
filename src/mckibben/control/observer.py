"""Observers of velocity, disturbance and pressures."""

from __future__ import annotations

import abc
import math
from typing import Annotated, Any, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float

from mckibben.component.base import Component
from mckibben.numerics.elementary import exp, floating, sincos
from mckibben.units import Bandwidth, PoleDamping, Quantity

Scalar = Float[Array, ""]


class MotionEstimate(NamedTuple):
    """Estimated motion of the joint."""

    angle: Scalar  # [rad]
    velocity: Scalar  # [rad/s]
    disturbance: Scalar  # acceleration that the model does not explain [rad/s^2]
    known: Scalar  # acceleration by the model [rad/s^2]

    @property
    def acceleration(self) -> Scalar:
        """Total acceleration [rad/s^2]."""
        return self.known + self.disturbance


class Observer(Component):
    r"""Observer of the motion from the measured angle and the acceleration by a model.

    Prediction at constant acceleration between two samples, then correction by the innovation of the angle.
    """

    default_class = "extended_state"

    def init(self, angle: ArrayLike, modelled: ArrayLike) -> MotionEstimate:
        """Estimate at rest at a measured angle [rad], with the model's acceleration [rad/s^2]."""
        angle = floating(angle)
        zero = jnp.zeros_like(angle)
        return MotionEstimate(angle, zero, zero, zero + modelled)

    def step(self, motion: MotionEstimate, angle: ArrayLike, modelled: ArrayLike, period: ArrayLike) -> MotionEstimate:
        """Return the estimate after a measured angle [rad], with the acceleration by the model now [rad/s^2]."""
        acceleration = (motion.known + modelled) / 2 + motion.disturbance
        predicted = motion.angle + period * (motion.velocity + period / 2 * acceleration)
        innovation = angle - predicted
        angle_gain, velocity_gain, disturbance_gain = self.gains(period)
        return MotionEstimate(
            predicted + angle_gain * innovation,
            motion.velocity + period * acceleration + velocity_gain * innovation,
            motion.disturbance + disturbance_gain * innovation,
            floating(modelled),
        )

    @abc.abstractmethod
    def gains(self, period: ArrayLike) -> tuple[ArrayLike, ArrayLike, ArrayLike]:
        """Gains of angle [-], velocity [1/s] and disturbance [1/s^2] for a control period [s]."""


class VelocityObserver(Observer):
    r"""Observer of angle and velocity, with both poles at :math:`\beta = e^{-\omega_o h}`.

    .. math:: l_1 = 1 - \beta^2, \quad l_2 = (1 - \beta)^2 / h, \quad \beta = e^{-\omega_o h}

    An unmodelled acceleration a biases the velocity by 2 a / omega_o, with the bandwidth omega_o [rad/s].

    References
    ----------
    D. G. Luenberger, An introduction to observers, IEEE Trans. Automatic Control 16, 1971; the gains are those of the
    second-order fading-memory filter, N. Morrison, Introduction to Sequential Smoothing and Prediction, 1969.

    Examples
    --------
    >>> [round(float(gain), 4) for gain in VelocityObserver(bandwidth=100.0).gains(1e-3)]
    [0.1813, 9.0559, 0.0]
    """

    short_name = "velocity"

    bandwidth: Bandwidth = 250.0

    def gains(self, period: ArrayLike) -> tuple[ArrayLike, ArrayLike, ArrayLike]:
        pole = exp(-jnp.asarray(self.bandwidth) * period)
        return 1 - pole**2, (1 - pole) ** 2 / period, 0.0


class ExtendedStateObserver(Observer):
    r"""Observer of angle, velocity, and the total model error as one slowly changing disturbance.

    Poles at :math:`(s + \omega_o)(s^2 + (d - 1)\,\omega_o s + \omega_o^2)`, in discrete time at
    :math:`\beta = e^{-\omega_o h}` and :math:`r e^{\pm j\varphi}`:

    .. math:: l_1 = 1 - \beta r^2, \quad l_2 = \big((1 - \beta)(1 - r^2) + \tfrac12 (1 + \beta) m\big) / h, \quad
              l_3 = (1 - \beta)\, m / h^2, \quad m = 1 - 2 r \cos\varphi + r^2

    Disturbances slower than the bandwidth omega_o [rad/s] are observed; noise and steps of the encoder limit the
    bandwidth. A damping d of 3 gives a triple pole; 2 gives Butterworth poles, those of the steady-state Kalman filter
    for white noise of the angle and a disturbance of independent increments: less noise at the same error.

    Parameters
    ----------
    bandwidth
        omega_o [rad/s], up to which disturbances are observed; noise and steps of the encoder limit it.
    damping
        d, from 2 (Butterworth poles) to 3 (a triple pole).

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

    short_name = "extended_state"

    bandwidth: Bandwidth = 250.0
    damping: PoleDamping = 3.0

    def gains(self, period: ArrayLike) -> tuple[ArrayLike, ArrayLike, ArrayLike]:
        angle = jnp.asarray(self.bandwidth) * period
        real = (jnp.asarray(self.damping) - 1) / 2  # of the pair of poles, over the bandwidth
        oscillates = real < 1
        imaginary = jnp.where(oscillates, jnp.sqrt(1 - jnp.where(oscillates, real, 0.0) ** 2), 0.0)
        pole, radius = exp(-angle), exp(-real * angle)
        distance_sq = (1 - radius) ** 2 + 2 * radius * (1 - sincos(imaginary * angle)[1])
        velocity_gain = ((1 - pole) * (1 - radius**2) + (1 + pole) / 2 * distance_sq) / period
        return 1 - pole * radius**2, velocity_gain, (1 - pole) * distance_sq / period**2


SensorBandwidth = Annotated[float, Quantity("rad/s", "rad/s", 0, math.inf, open_lower=True)]


class PressureObserver(Component):
    r"""Correction of the pressures that a model of the valves predicts, by the measured ones.

    .. math:: \hat p = \hat p^- + (1 - e^{-\omega_p h}) (p - \hat p^-)

    White noise is attenuated by :math:`\sqrt{\omega_p h / 2}`; the error of a wrong model decays with the bandwidth
    omega_p [rad/s], infinite for no filter.

    Parameters
    ----------
    bandwidth
        omega_p [rad/s], up to which the estimates follow the measured pressures.
    """

    bandwidth: SensorBandwidth = 200.0

    def step(self, predicted: tuple[Scalar, ...], measured: tuple[Scalar, ...], period: ArrayLike) -> Any:
        """Return the estimated pressures [Pa] from the predicted and the measured ones."""
        gain = 1 - exp(-jnp.asarray(self.bandwidth) * period)
        return tuple(model + gain * (reading - model) for model, reading in zip(predicted, measured, strict=True))
