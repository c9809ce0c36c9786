"""Geometry of the joint: path lengths and moment arms over the joint angle, Eqs. 4 and 5 of the paper."""

from __future__ import annotations

import abc
import math
from numbers import Real
from typing import ClassVar

import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float

from mckibben.component.base import Component
from mckibben.component.checks import check_positive, check_within
from mckibben.muscle import Muscle
from mckibben.numerics.calculus import value_and_derivative
from mckibben.numerics.compiled import jit_inline
from mckibben.numerics.elementary import sincos
from mckibben.units import HINGE, Angle, Distance, JointType, Length, MomentArm, Strength, deg

Pair = tuple[Float[Array, "..."], Float[Array, "..."]]
"""Values of muscle 1 (antagonist: lengthens as the angle increases) and muscle 2 (agonist)."""

Ends = Float[Array, "2 2"]
"""Fixed and moving end (x, y) [m] of a straight line; the hinge is at (0, 0), and the angle turns from x to y."""

Pressures = tuple[ArrayLike, ArrayLike]
"""Gauge pressures (p1, p2) [Pa]; each a number or an array."""


class Geometry(Component):
    """Path lengths of both muscles over the joint angle; moment arms follow by differentiation."""

    default_class = "knee"
    joint_type: ClassVar[JointType] = HINGE
    """Joint type."""

    @property
    def angle_range(self) -> tuple[float, float]:
        """Range of angles [rad] for which the geometry is defined."""
        return -math.inf, math.inf

    def check_muscles(self, muscles: tuple[Muscle, Muscle]) -> None:
        """Raise `RangeError` for muscles that it lacks the length of."""

    def span(self, muscles: tuple[Muscle, Muscle]) -> tuple[float, float]:
        """Return the angles [rad] between which muscles may hold a load, in whole degrees."""
        return -80 * deg, 80 * deg

    @abc.abstractmethod
    def path_lengths(self, angle: ArrayLike) -> Pair:
        """Return the length [m] of each muscle with its series spring at an angle [rad]."""

    def remedy(self, number: int, *, longer: bool) -> str:
        """Return the change of a field that makes the path of muscle 1 or 2 longer or shorter, in words."""
        return f"other lengths of its {type(self).__name__}"

    def anchors(self, angle: ArrayLike) -> tuple[Ends | None, Ends | None]:
        """Return the ends of each muscle with its connectors; None if its path is unknown or not a straight line."""
        return None, None

    def moment_arms(self, angle: ArrayLike) -> Pair:
        """Return the moment arm [m] of each muscle, positive; muscle 2 acts in the direction of the angle."""
        return self.paths_and_arms(angle)[1]

    @jit_inline
    def paths_and_arms(self, angle: ArrayLike) -> tuple[Pair, Pair]:
        """Return `path_lengths` and `moment_arms` from one pass."""
        paths, (slope1, slope2) = value_and_derivative(self.path_lengths, angle)
        return paths, (slope1, -slope2)


class KneeGeometry(Geometry):
    r"""Two muscles on either side of a round joint.

    .. math::

        L_{1,2} = \sqrt{(H \pm r\sin\theta)^2 + (r - r\cos\theta)^2} - (L_u + L_d)

    Parameters
    ----------
    joint_length, joint_radius, connector_length
        H, distance of the upper anchors of the muscles from the axis; r, radius of the lower anchors; L_u + L_d, length
        of the connectors [m].

    References
    ----------
    Eqs. 4 and 5 of the paper; the moment arms (Eq. 5) are the derivative of Eq. 4.

    Examples
    --------
    >>> knee = KneeGeometry(joint_length=0.37, joint_radius=0.03, connector_length=0.19)
    >>> [round(float(length), 6) for length in (*knee.path_lengths(0.0), *knee.moment_arms(0.0))]
    [0.18, 0.18, 0.03, 0.03]
    """

    short_name = "knee"

    joint_length: Length
    joint_radius: MomentArm
    connector_length: Distance

    def __check_init__(self) -> None:
        super().__check_init__()
        plain = all(isinstance(x, Real) for x in (self.joint_length, self.joint_radius))
        longest = self.joint_length - self.joint_radius if plain else math.inf
        check_within("KneeGeometry", 0.0, longest, "m", connector_length=self.connector_length)
        if not plain:
            try:
                length = self.joint_length - self.joint_radius - self.connector_length
            except ValueError:  # arrays of different lengths, which are refused where runs are distinguished
                return
            check_positive("KneeGeometry", "m", zero=True, muscle_length=length)

    def path_lengths(self, angle: ArrayLike) -> Pair:
        H, r = self.joint_length, self.joint_radius
        sine, cosine = sincos(angle)
        # Eq. 4 with its squares multiplied out, r^2 (sin^2 + cos^2) being r^2: fewer operations.
        common, difference = (H * H + 2 * r * r) - (2 * r * r) * cosine, (2 * H * r) * sine
        return (
            jnp.sqrt(common + difference) - self.connector_length,
            jnp.sqrt(common - difference) - self.connector_length,
        )

    def remedy(self, number: int, *, longer: bool) -> str:
        return f"a {'shorter' if longer else 'longer'} connector_length"

    def anchors(self, angle: ArrayLike) -> tuple[Ends, Ends]:
        H, r = self.joint_length, self.joint_radius
        sine, cosine = sincos(angle)
        turned = jnp.stack([r * cosine, r * sine])  # of muscle 2; opposite for muscle 1
        return jnp.stack([jnp.asarray([-r, H]), -turned]), jnp.stack([jnp.asarray([r, H]), turned])


class ScaledArms(Geometry):
    """A geometry with scaled moment arms; the lengths at one angle are unchanged.

    Parameters
    ----------
    geometry, scale, angle
        The geometry, the factor [-] of its moment arms, and the angle [rad] of unchanged lengths.

    Examples
    --------
    >>> knee = KneeGeometry(joint_length=0.37, joint_radius=0.03, connector_length=0.19)
    >>> [round(float(arm), 6) for arm in ScaledArms(knee, 1.02).moment_arms(0.0)]
    [0.0306, 0.0306]
    """

    short_name = "scaled_arms"

    geometry: Geometry
    scale: Strength
    angle: Angle = 0.0

    @property
    def joint_type(self) -> JointType:  # type: ignore[override]
        return self.geometry.joint_type

    def span(self, muscles: tuple[Muscle, Muscle]) -> tuple[float, float]:
        return self.geometry.span(muscles)

    def remedy(self, number: int, *, longer: bool) -> str:
        return self.geometry.remedy(number, longer=longer)

    @property
    def angle_range(self) -> tuple[float, float]:
        return self.geometry.angle_range

    def path_lengths(self, angle: ArrayLike) -> Pair:
        lengths, fixed = self.geometry.path_lengths(angle), self.geometry.path_lengths(self.angle)
        first, second = (at + self.scale * (now - at) for now, at in zip(lengths, fixed, strict=True))
        return first, second
