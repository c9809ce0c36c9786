"""What is ahead of the joint: what its pressures will do, what it shall do, and the limits."""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float

Scalar = Float[Array, ""]
Pair = tuple[Scalar, Scalar]
Vector = tuple[Scalar, Scalar, Scalar, Scalar]
"""Of a state: angle, velocity, acceleration, stiffness."""


class Bent(NamedTuple):
    """A number that changes with the angle: its value here, and its first two derivatives."""

    value: ArrayLike
    slope: ArrayLike = 0.0
    curvature: ArrayLike = 0.0

    def at(self, angle: ArrayLike) -> Scalar:
        """The number at an angle counted from here."""
        return jnp.asarray(self.value + angle * (self.slope + angle * self.curvature / 2))

    def slope_at(self, angle: ArrayLike) -> Scalar:
        """How it changes there."""
        return jnp.asarray(self.slope + angle * self.curvature)


class Outlook(NamedTuple):
    """What does not change over the horizon.

    Attributes
    ----------
    stage
        h, the length of a stage.
    early
        (mu_1, mu_2): how early in a stage the acceleration changes; (1/2, 1/3) if evenly, (1, 1) if at once.
    share
        The part of the way to a command that a pressure goes in a stage.
    damping
        d, from 2 to 3.
    slowness
        rho, the square of the loop's omega_c over that of the stiffness.
    acceleration, stiffness
        What the pressures make of them, over the angle: offset and the parts of p1 and p2; the wish taken off the
        stiffness, but not off the acceleration.
    drag
        How much acceleration a velocity takes away.
    wish
        Angle (counted from here), velocity, acceleration and jerk of the wish, now.
    swing
        The square of the frequency with which its acceleration goes on; 0 if evenly.
    lowest, highest
        Pressures of either muscle over the angle: what a stage may end with.
    least, most
        What may be commanded.
    """

    stage: ArrayLike
    early: tuple[ArrayLike, ArrayLike]
    share: ArrayLike
    damping: ArrayLike
    slowness: ArrayLike
    acceleration: tuple[Bent, Bent, Bent]
    stiffness: tuple[Bent, Bent, Bent]
    drag: ArrayLike
    wish: Vector
    swing: ArrayLike
    lowest: tuple[Bent, Bent]
    highest: tuple[Bent, Bent]
    least: tuple[ArrayLike, ArrayLike]
    most: tuple[ArrayLike, ArrayLike]

    def wish_after(self, wish: Vector) -> Vector:
        """The wish a stage later: its acceleration goes on as that of a sine, for none evenly."""
        angle, velocity, acceleration, jerk = wish
        h = jnp.asarray(self.stage)
        q = self.swing * h**2  # series of sine and cosine, of a stage's part of a swing
        sine, twice = 1 - q / 6 * (1 - q / 20), 1 / 2 - q / 24 * (1 - q / 30)
        thrice = 1 / 6 - q / 120 * (1 - q / 42)
        return (
            angle + h * (velocity + h * (acceleration * twice + h * jerk * thrice)),
            velocity + h * (acceleration * sine + h * jerk * twice),
            acceleration * (1 - q * twice) + h * jerk * sine,
            jerk * (1 - q * twice) - self.swing * h * sine * acceleration,
        )
