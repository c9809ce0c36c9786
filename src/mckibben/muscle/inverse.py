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
    """The gauge pressure [Pa] between -0.5 and 12 bar that gives a force [N] at a contraction [-]; NaN for none.

    The force has to rise with the pressure there.
    """
    force, contraction = jnp.asarray(force), jnp.asarray(contraction)
    return increasing_root(lambda pressure: law.force(contraction, pressure) - force, _LOWEST, _HIGHEST)
