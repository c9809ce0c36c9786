"""The pressure of a force, for laws that give none in closed form."""

from __future__ import annotations

from typing import TYPE_CHECKING

import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float

from mckibben.numerics.root import increasing_root
from mckibben.units import atm, bar

if TYPE_CHECKING:
    from mckibben.muscle.base import ForceLaw

_LOWEST, _HIGHEST = -0.5 * atm, 12 * bar  # beyond, no muscle of rubber and thread is used


def pressure_for(law: ForceLaw, force: ArrayLike, contraction: ArrayLike) -> Float[Array, "..."]:
    """The gauge pressure [Pa] up to 12 bar that gives a force [N] at a contraction [-]; NaN for none.

    The force has to rise with the pressure from 0 up; below 0, to -0.5 bar, it is looked for where that at 0 is more.
    """
    force, contraction = jnp.asarray(force), jnp.asarray(contraction)
    lowest = jnp.where(law.force(contraction, 0.0) <= force, 0.0, _LOWEST)
    return increasing_root(lambda pressure: law.force(contraction, pressure) - force, lowest, _HIGHEST)
