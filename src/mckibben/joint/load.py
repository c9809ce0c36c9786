"""What the joint moves: inertia, damping and gravity, Eq. 6 of the paper."""

from __future__ import annotations

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float

from mckibben.numerics.checks import check_positive
from mckibben.numerics.elementary import sincos
from mckibben.units import Angle, Damping, Distance, Gravity, Inertia, Mass


class Load(eqx.Module):
    r"""A shank with two point masses, hanging at an angle.

    .. math:: I\ddot\theta + c\dot\theta = \tau_{muscles} + G \sin(\theta_h - \theta),
              \quad I = J + m_1 l_1^2 + m_2 l_2^2, \quad G = (m_1 l_1 + m_2 l_2) g

    The paper puts the gravity term on the driving side in Eq. 6 and on the net side in Eq. 7; equated literally they
    cancel. Here it stands once, as a torque on the shank: with `hanging` true (the default) theta_h is the stable
    equilibrium of the unloaded joint. The paper's other reading, an inverted load, is ``hanging=False``: the same
    torque with the opposite sign.

    Parameters
    ----------
    mass1, mass2
        m1 of the knee and m2 of the external load [kg].
    distance1, distance2
        Of their centres from the axis, l1 and l2 [m].
    inertia
        J [kg*m^2], of the mechanism itself.
    damping
        c [N*m*s/rad]; printed as N*s/m in the paper's Table 2.
    hanging_angle
        theta_h [rad], pi/6 in the paper.
    gravity
        g [m/s^2].
    hanging
        The sign of the gravity torque, see above.
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
        """G [N*m], the highest torque of gravity; negative for an inverted load."""
        moment = (self.mass1 * self.distance1 + self.mass2 * self.distance2) * self.gravity
        return moment if self.hanging else -moment  # type: ignore

    def gravity_torque(self, angle: ArrayLike) -> Float[Array, "..."]:
        """The torque of gravity [N*m] at an angle [rad]."""
        (sine, cosine), (hanging_sine, hanging_cosine) = sincos(angle), sincos(self.hanging_angle)
        return self.gravity_moment * (hanging_sine * cosine - hanging_cosine * sine)

    def gravity_stiffness(self, angle: ArrayLike) -> Float[Array, "..."]:
        """What gravity adds to the joint's stiffness [N*m/rad] at an angle [rad]."""
        return self.gravity_moment * sincos(self.hanging_angle - jnp.asarray(angle))[1]
