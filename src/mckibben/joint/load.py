"""Dynamics of the joint's load: inertia, damping and gravity (Eq. 6 of the paper)."""

from __future__ import annotations

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float

from mckibben.notebook import Displayed
from mckibben.numerics.checks import check_positive
from mckibben.numerics.elementary import sincos
from mckibben.units import Angle, Damping, Distance, Gravity, Inertia, Mass


class Load(eqx.Module, Displayed):
    r"""A shank with two point masses: a pendulum driven by the muscles' torque (Eq. 6).

    .. math:: I\ddot\theta + c\dot\theta = \tau + G \sin(\theta_h - \theta),
              \quad I = J + m_1 l_1^2 + m_2 l_2^2, \quad G = (m_1 l_1 + m_2 l_2) g

    The paper puts the gravity term on the driving side in Eq. 6 and on the net side in Eq. 7; equated literally they
    cancel. Here it stands once, as a torque on the shank: with `hanging` true (the default) theta_h is the stable
    equilibrium of the unloaded joint. The paper's other reading, an inverted load, is ``hanging=False``.

    Parameters
    ----------
    mass1, mass2, distance1, distance2
        m1 of the knee and m2 of the external load [kg], and l1, l2 of their centres from the axis [m].
    inertia
        J [kg*m^2], of the mechanism itself.
    damping
        c [N*m*s/rad]; printed as N*s/m in the paper's Table 2.
    hanging_angle
        theta_h [rad], pi/6 in the paper.
    gravity
        g [m/s^2].
    hanging
        Whether theta_h is the stable equilibrium.

    Examples
    --------
    >>> from mckibben import catalog
    >>> load = catalog.load("knee-table-2")
    >>> torque = load.required_torque(0.0, 0.5, 20.0)
    >>> round(float(torque), 3), round(float(load.acceleration(0.0, 0.5, torque)), 9)
    (0.172, 20.0)
    """

    mass1: Mass
    mass2: Mass
    distance1: Distance
    distance2: Distance
    inertia: Inertia
    damping: Damping
    hanging_angle: Angle = jnp.pi / 6
    gravity: Gravity = 9.81
    hanging: bool = eqx.field(static=True, default=True)

    def __check_init__(self) -> None:
        check_positive("Load", "kg", zero=True, mass1=self.mass1, mass2=self.mass2)
        check_positive("Load", "m", zero=True, distance1=self.distance1, distance2=self.distance2)
        check_positive("Load", "kg*m^2", zero=True, inertia=self.inertia)
        try:
            total = self.total_inertia
        except ValueError:  # arrays of different lengths, which are refused where runs are told apart
            return
        check_positive("Load", "kg*m^2", total_inertia=total)
        check_positive("Load", "N*m*s/rad", zero=True, damping=self.damping)

    @property
    def total_inertia(self) -> Float[Array, ""]:
        """I [kg*m^2] about the axis."""
        return self.inertia + self.mass1 * self.distance1**2 + self.mass2 * self.distance2**2  # type: ignore

    @property
    def gravity_moment(self) -> Float[Array, ""]:
        """G [N*m], the largest torque of gravity; negative for an inverted load."""
        moment = (self.mass1 * self.distance1 + self.mass2 * self.distance2) * self.gravity
        return moment if self.hanging else -moment  # type: ignore

    def acceleration(self, angle: ArrayLike, velocity: ArrayLike, torque: ArrayLike) -> Float[Array, "..."]:
        """Angular acceleration [rad/s^2] under a torque [N*m] at an angle [rad] and a velocity [rad/s] (Eq. 6)."""
        resisting = self.gravity_torque(angle) - self.damping * velocity
        return (torque + resisting) * (1 / self.total_inertia)  # type: ignore

    def required_torque(self, angle: ArrayLike, velocity: ArrayLike, acceleration: ArrayLike) -> Float[Array, "..."]:
        """Torque [N*m] for an acceleration [rad/s^2]: the inverse of `acceleration`."""
        return self.dynamic_torque(velocity, acceleration) - self.gravity_torque(angle)

    def dynamic_torque(self, velocity: ArrayLike, acceleration: ArrayLike) -> Float[Array, "..."]:
        """Torque [N*m] of inertia and damping: `required_torque` without gravity."""
        return self.total_inertia * acceleration + self.damping * velocity  # type: ignore

    def gravity_torque(self, angle: ArrayLike) -> Float[Array, "..."]:
        """Torque of gravity on the shank [N*m] at an angle [rad]."""
        (sine, cosine), (hanging_sine, hanging_cosine) = sincos(angle), sincos(self.hanging_angle)
        return self.gravity_moment * (hanging_sine * cosine - hanging_cosine * sine)

    def gravity_stiffness(self, angle: ArrayLike) -> Float[Array, "..."]:
        """Stiffness due to gravity [N*m/rad] at an angle [rad], minus the slope of `gravity_torque`."""
        return self.gravity_moment * sincos(self.hanging_angle - jnp.asarray(angle))[1]
