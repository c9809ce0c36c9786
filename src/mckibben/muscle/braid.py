"""The ideal braid, on which several laws rest: a cylinder of inextensible thread."""

from __future__ import annotations

import jax.numpy as jnp
from jaxtyping import Array, Float

from mckibben.muscle.base import Parameter
from mckibben.units import deg, mm

PARAMETERS = (
    Parameter("braid_angle", "rad", "deg", "angle between thread and axis", 5 * deg, 54 * deg),
    Parameter("initial_diameter", "m", "mm", "diameter of the deflated muscle", 1 * mm, 100 * mm),
)
"""The two numbers of it that data can determine."""


def braid_gain(braid_angle: float | Array, initial_diameter: float | Array, length_ratio: Array) -> Float[Array, "..."]:
    """The force per pressure [N/Pa] where the cylinder's length is this part of its initial one (Eq. 1).

    Parameters
    ----------
    braid_angle, initial_diameter
        alpha0 [rad] and d0 [m] of the deflated muscle.
    length_ratio
        1 - contraction [-].
    """
    b1 = 3 / jnp.tan(braid_angle) ** 2
    b2 = 1 / jnp.sin(braid_angle) ** 2
    return jnp.pi * initial_diameter**2 / 4 * (b1 * length_ratio**2 - b2)
