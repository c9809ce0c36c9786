"""Where the muscles run: path lengths over the joint angle, Eq. 4 of the paper."""

from __future__ import annotations

import abc
import math
from numbers import Real

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float

from mckibben.numerics.calculus import value_and_derivative
from mckibben.numerics.checks import check_positive, check_within
from mckibben.numerics.elementary import sincos
from mckibben.units import Distance, Length

Pair = tuple[Float[Array, "..."], Float[Array, "..."]]
"""One value for muscle 1 (antagonist: it lengthens as the angle grows) and one for muscle 2 (agonist)."""


_LONGEST = 10.0  # m: a longer joint is one in millimetres


class Geometry(eqx.Module):
    """Path lengths of both muscles over the joint angle; moment arms follow by differentiation."""

    @abc.abstractmethod
    def path_lengths(self, angle: ArrayLike) -> Pair:
        """Length [m] available to each muscle and its series spring at an angle [rad]."""

    def moment_arms(self, angle: ArrayLike) -> Pair:
        """Moment arm [m] of each muscle; both positive where muscle 2 drives and muscle 1 brakes."""
        return self.paths_and_arms(angle)[1]

    def paths_and_arms(self, angle: ArrayLike) -> tuple[Pair, Pair]:
        """`path_lengths` and `moment_arms` in one pass."""
        paths, (slope1, slope2) = value_and_derivative(self.path_lengths, angle)
        return paths, (slope1, -slope2)


class KneeGeometry(Geometry):
    r"""Two muscles on either side of a round joint.

    .. math::

        L_{1,2} = \sqrt{(H \pm r\sin\theta)^2 + (r - r\cos\theta)^2} - (L_u + L_d)

    Parameters
    ----------
    joint_length
        H [m], from the muscles' upper anchors to the joint's axis.
    joint_radius
        r [m], at which the muscles' lower ends are fixed.
    connector_length
        L_u + L_d [m], what lies between muscle and anchors.

    References
    ----------
    Eqs. 4 and 5 of the paper. Eq. 5, the moment arms, follows from Eq. 4 by differentiation.

    Examples
    --------
    >>> knee = KneeGeometry(joint_length=0.37, joint_radius=0.03, connector_length=0.19)
    >>> [round(float(length), 6) for length in knee.path_lengths(0.0)]
    [0.18, 0.18]
    >>> [round(float(arm), 6) for arm in knee.moment_arms(0.0)]
    [0.03, 0.03]
    """

    joint_length: Length
    joint_radius: Length
    connector_length: Distance

    def __check_init__(self) -> None:
        check_positive("KneeGeometry", "m", joint_length=self.joint_length, joint_radius=self.joint_radius)
        check_within("KneeGeometry", 0.0, _LONGEST, "m", joint_length=self.joint_length)
        plain = all(isinstance(x, Real) for x in (self.joint_length, self.joint_radius))
        longest = self.joint_length - self.joint_radius if plain else math.inf
        check_within("KneeGeometry", 0.0, longest, "m", connector_length=self.connector_length)
        if not plain:
            try:
                room = self.joint_length - self.joint_radius - self.connector_length
            except ValueError:  # arrays of different lengths, which are refused where runs are told apart
                return
            check_positive("KneeGeometry", "m", zero=True, room_for_a_muscle=room)

    def path_lengths(self, angle: ArrayLike) -> Pair:
        """What is left for each muscle (and its series spring) [m] at an angle [rad]."""
        H, r = self.joint_length, self.joint_radius
        sine, cosine = sincos(angle)
        # Eq. 4 with its squares multiplied out, r^2 (sin^2 + cos^2) being r^2: a shorter way from angle to length.
        common, difference = (H * H + 2 * r * r) - (2 * r * r) * cosine, (2 * H * r) * sine
        return (
            jnp.sqrt(common + difference) - self.connector_length,
            jnp.sqrt(common - difference) - self.connector_length,
        )
