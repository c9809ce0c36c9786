"""A muscle that is weaker or stronger than its law: another one of the same make, or an older one."""

# No `from __future__ import annotations` here: equinox would see the domain as text.

from typing import Any

import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float

from mckibben.muscle.base import ForceLaw, PressureAffineLaw
from mckibben.muscle.specimen import Domain
from mckibben.numerics.checks import check_positive


class StrongerLaw(ForceLaw):
    """A law times a factor; `stronger` makes it."""

    law: ForceLaw
    strength: Any
    domain: Domain

    equation = "F = s F_law"
    source = "ours"

    def force(self, contraction: ArrayLike, pressure: ArrayLike) -> Float[Array, "..."]:
        return self.strength * self.law.force(contraction, pressure)

    def pressure_for(self, force: ArrayLike, contraction: ArrayLike) -> Float[Array, "..."]:
        return self.law.pressure_for(jnp.asarray(force) / self.strength, contraction)


class StrongerAffineLaw(PressureAffineLaw):
    """A law that is affine in pressure times a factor; `stronger` makes it."""

    law: PressureAffineLaw
    strength: Any
    domain: Domain

    equation = "F = s F_law"
    source = "ours"

    def pressure_terms(self, contraction: ArrayLike) -> tuple[Float[Array, "..."], Float[Array, "..."]]:
        offset, gain = self.law.pressure_terms(contraction)
        return self.strength * offset, self.strength * gain


def stronger(law: ForceLaw, strength: Any) -> ForceLaw:
    """The law of a muscle whose every force is so many times that of a law.

    Muscles of one make differ by some percent from one to the next, and lose force with age; to first order all their
    forces do so alike.

    Parameters
    ----------
    law
        Whose domain stays as it is. Where it holds at all is looked at once, here.
    strength
        The factor [-].

    Raises
    ------
    RangeError
        If the factor is not above 0.

    Examples
    --------
    >>> from mckibben import catalog
    >>> from mckibben.units import bar, percent
    >>> law = catalog.law("lei-mas-10-180n")
    >>> weak = stronger(law, 0.9)
    >>> round(float(weak.force(10 * percent, 3 * bar) / law.force(10 * percent, 3 * bar)), 12)
    0.9
    """
    check_positive("stronger", strength=strength)
    domain = law.domain.intersection(law.holds)
    if isinstance(law, PressureAffineLaw):
        return StrongerAffineLaw(law=law, strength=strength, domain=domain)
    return StrongerLaw(law=law, strength=strength, domain=domain)
