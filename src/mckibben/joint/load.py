"""Dynamics of the joint's load: inertia, damping and gravity (Eq. 6 of the paper)."""

from __future__ import annotations

import abc
import dataclasses
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float

from mckibben.component.base import Component
from mckibben.component.checks import check_positive
from mckibben.numerics.elementary import floating, sincos
from mckibben.units import (
    GRAVITY,
    HINGE,
    SLIDE,
    Angle,
    Damping,
    Distance,
    Gravity,
    Inertia,
    JointType,
    Length,
    Mass,
    PositiveMass,
    Quantity,
    Torque,
)

PositiveInertia = Annotated[float, Quantity("kg*m^2", "kg*m^2", 0, 1e4, open_lower=True)]
SlideDamping = Annotated[float, Quantity("N*s/m", "N*s/m", 0, 1e6)]
Incline = Annotated[float, Quantity("rad", "deg", -90, 90)]


class Load(Component):
    r"""A load with inertia, viscous damping and the gravity of a pendulum (Eq. 6).

    .. math:: I\ddot\theta + c\dot\theta = \tau + G \sin(\theta_h - \theta)

    with the torque tau of the muscles. A subclass gives I, G, and the fields `damping` (c [N*m*s/rad]) and
    `hanging_angle` (theta_h [rad], the equilibrium of the unloaded joint: stable where G is positive).
    """

    default_class = "knee"
    joint_type: ClassVar[JointType] = HINGE
    """Joints that it loads."""
    estimated_mass: ClassVar[str] = ""
    """Field with the mass [kg] that a calibration estimates; empty if none."""

    if TYPE_CHECKING:  # fields of subclasses; declared here, they would precede the subclass's own

        def __getattr__(self, name: str) -> Any: ...

    @property
    @abc.abstractmethod
    def total_inertia(self) -> Float[Array, ""]:
        """I [kg*m^2] about the axis."""

    @property
    @abc.abstractmethod
    def gravity_moment(self) -> Float[Array, ""]:
        """G [N*m], the largest torque of gravity; negative for an inverted load."""

    @property
    def axis(self) -> tuple[ArrayLike, ArrayLike, ArrayLike]:
        """Unit vector about which it turns, or along which it slides; x is forwards, z up."""
        return (0.0, -1.0, 0.0)

    def with_weight(self, mass: ArrayLike, distance: ArrayLike) -> Load:
        """Return the load with an additional point mass [kg] on the limb, at a distance [m] from the axis.

        It acts on the side of the load's own mass: an inverted load becomes more inverted.
        """
        moment = jnp.asarray(self.gravity_moment)
        weight = jnp.where(moment < 0, -1.0, 1.0) * mass * distance * GRAVITY
        return GeneralLoad(
            inertia=self.total_inertia + mass * distance**2,  # type: ignore
            greatest_gravity_torque=moment + weight,  # type: ignore
            damping=self.damping,
            hanging_angle=self.hanging_angle,
        )

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
        (sine, cosine), (hanging_sine, hanging_cosine) = sincos(angle), sincos(self.hanging_angle)
        return self.gravity_moment * (hanging_cosine * cosine + hanging_sine * sine)


class KneeLoad(Load):
    r"""The paper's load: a shank with two point masses, a pendulum driven by the muscles' torque.

    .. math:: I = J + m_1 l_1^2 + m_2 l_2^2, \quad G = (m_1 l_1 + m_2 l_2) g

    The paper puts the gravity term on the driving side in Eq. 6 and on the net side in Eq. 7; equated literally they
    cancel. Here it appears once, as a torque on the shank: with `hanging` true (the default) theta_h is the stable
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

    short_name = "knee"

    estimated_mass = "mass2"

    mass1: Mass
    mass2: Mass
    distance1: Distance
    distance2: Distance
    inertia: Inertia
    damping: Damping
    hanging_angle: Angle = jnp.pi / 6
    gravity: Gravity = GRAVITY
    hanging: bool = eqx.field(static=True, default=True)

    def __check_init__(self) -> None:
        super().__check_init__()
        try:
            total = self.total_inertia
        except ValueError:  # arrays of different lengths, which are refused where runs are distinguished
            return
        check_positive("KneeLoad", "kg*m^2", total_inertia=total)

    @property
    def total_inertia(self) -> Float[Array, ""]:
        return self.inertia + self.mass1 * self.distance1**2 + self.mass2 * self.distance2**2  # type: ignore

    @property
    def gravity_moment(self) -> Float[Array, ""]:
        moment = (self.mass1 * self.distance1 + self.mass2 * self.distance2) * self.gravity
        return moment if self.hanging else -moment  # type: ignore


class PendulumLoad(Load):
    r"""A point mass at a distance from the axis, without other inertia.

    .. math:: I = m l^2, \quad G = m l g

    Parameters
    ----------
    mass, length
        m [kg], and l [m] of its centre from the axis.
    damping
        c [N*m*s/rad].
    hanging_angle
        Angle [rad] at which the mass hangs below the axis; pi for a mass that is above the axis at angle 0.
    gravity
        g [m/s^2].

    Examples
    --------
    >>> from mckibben.units import mm
    >>> load = PendulumLoad(mass=0.3, length=250 * mm)
    >>> round(float(load.total_inertia), 5), round(float(load.gravity_torque(jnp.pi / 2)), 4)
    (0.01875, -0.7358)
    """

    short_name = "pendulum"

    estimated_mass = "mass"

    mass: PositiveMass
    length: Length
    damping: Damping = 0.0
    hanging_angle: Angle = 0.0
    gravity: Gravity = GRAVITY

    @property
    def total_inertia(self) -> Float[Array, ""]:
        return self.mass * self.length**2  # type: ignore

    @property
    def gravity_moment(self) -> Float[Array, ""]:
        return self.mass * self.length * self.gravity  # type: ignore


class GeneralLoad(Load):
    """Any rigid load, given by its inertia and its gravity torque.

    Parameters
    ----------
    inertia
        I [kg*m^2] about the axis.
    greatest_gravity_torque
        G [N*m], the gravity torque at a right angle from `hanging_angle`: mass times distance of the centre of mass
        times g. 0 for a vertical axis. ``gravity_torque`` in scenario files.
    damping, hanging_angle
        c [N*m*s/rad], and theta_h [rad], at which the centre of mass is below the axis.

    Examples
    --------
    >>> rod = GeneralLoad(inertia=0.3 * 0.5**2 / 3, greatest_gravity_torque=0.3 * 0.25 * 9.81)  # 0.3 kg, 0.5 m long
    >>> round(float(rod.acceleration(jnp.pi / 2, 0.0, 0.0)), 2)  # 3 g / (2 * 0.5 m)
    -29.43
    """

    short_name = "general"

    inertia: PositiveInertia
    greatest_gravity_torque: Torque
    damping: Damping = 0.0
    hanging_angle: Angle = 0.0

    @property
    def total_inertia(self) -> Float[Array, ""]:
        return self.inertia  # type: ignore

    @property
    def gravity_moment(self) -> Float[Array, ""]:
        return self.greatest_gravity_torque  # type: ignore


class SlidingMass(Load):
    r"""A mass on a slide, whose weight acts along an inclined axis.

    .. math:: m\ddot x + c\dot x = F - m g \sin\alpha

    Parameters
    ----------
    mass, damping
        m [kg], and c [N*s/m].
    incline
        alpha [rad], the angle of the axis above the horizontal, in the direction of growing positions: 90 deg if muscle
        2 lifts the mass.
    gravity
        g [m/s^2].

    Examples
    --------
    >>> from mckibben.units import deg
    >>> lifted = SlidingMass(mass=2.0, damping=10.0, incline=90 * deg)
    >>> round(float(lifted.acceleration(0.0, 0.1, 25.62)), 6)
    2.5
    """

    short_name = "sliding_mass"
    joint_type = SLIDE
    hanging_angle = 0.0  # it does not turn
    estimated_mass = "mass"

    mass: PositiveMass
    damping: SlideDamping = 0.0
    incline: Incline = 0.0
    gravity: Gravity = GRAVITY

    @property
    def total_inertia(self) -> Float[Array, ""]:
        return self.mass  # type: ignore

    @property
    def gravity_moment(self) -> Float[Array, ""]:
        return jnp.zeros_like(floating(self.mass))  # the weight does not depend on the position

    @property
    def axis(self) -> tuple[ArrayLike, ArrayLike, ArrayLike]:
        sine, cosine = sincos(self.incline)
        return cosine, 0.0, sine

    def gravity_torque(self, angle: ArrayLike) -> Float[Array, "..."]:
        return jnp.full_like(floating(angle), -self.mass * self.gravity * sincos(self.incline)[0])

    def gravity_stiffness(self, angle: ArrayLike) -> Float[Array, "..."]:
        return jnp.zeros_like(floating(angle))

    def with_weight(self, mass: ArrayLike, distance: ArrayLike) -> SlidingMass:
        return dataclasses.replace(self, mass=self.mass + mass)  # type: ignore
