"""A return spring in place of a muscle."""

from __future__ import annotations

from typing import Annotated

import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float

from mckibben.component.base import Inherited
from mckibben.component.calls import checked_call
from mckibben.muscle.base import PressureAffineLaw
from mckibben.muscle.muscle import Muscle
from mckibben.muscle.specimen import Domain, Specimen
from mckibben.units import Length, SpringRate

_VOLUME = 1e-6  # m^3: the valve simulated with it needs a chamber, which stays at 0 bar


class SpringLaw(PressureAffineLaw):
    """Tension spring: a force proportional to the extension beyond the free length, independent of pressure.

    Parameters
    ----------
    rate
        Spring rate [N/m].
    free_length
        Unloaded length [m], the reference of the contraction.
    """

    short_name = "spring"
    is_passive = True

    rate: SpringRate
    free_length: Annotated[Length, Inherited(lambda scope: scope["specimen"].initial_length)]
    domain: Domain = Domain(pressure_min=0.0, pressure_max=0.0)

    equation = "F = -k l0 eps"
    source = "Hooke"

    def pressure_terms(self, contraction: ArrayLike) -> tuple[Float[Array, "..."], Float[Array, "..."]]:
        eps = jnp.asarray(contraction)
        return -self.rate * self.free_length * eps, jnp.zeros_like(eps)

    def pressure_for(self, force: ArrayLike, contraction: ArrayLike) -> Float[Array, "..."]:
        """Return 0, the only pressure of a spring."""
        return jnp.zeros_like(jnp.asarray(force) - jnp.asarray(contraction))


class NoForce(PressureAffineLaw):
    """Law of a muscle that is not there, as that opposite one that a weight stretches."""

    short_name = "no_force"
    is_passive = True
    pulls = False

    domain: Domain = Domain(pressure_min=0.0, pressure_max=0.0)

    equation = "F = 0"
    source = "-"

    def pressure_terms(self, contraction: ArrayLike) -> tuple[Float[Array, "..."], Float[Array, "..."]]:
        nothing = jnp.zeros_like(jnp.asarray(contraction))
        return nothing, nothing

    def pressure_for(self, force: ArrayLike, contraction: ArrayLike) -> Float[Array, "..."]:
        return jnp.zeros_like(jnp.asarray(force) - jnp.asarray(contraction))


def no_muscle() -> Muscle:
    """Return what stands in place of a muscle of a joint that has only one, against a weight."""
    law = NoForce()
    return Muscle(Specimen("no muscle", 1.0, domain=law.domain, volume_terms=(_VOLUME,)), law)


@checked_call
def return_spring(rate: SpringRate, free_length: Length) -> Muscle:
    """A tension spring in place of a muscle of a joint; its pressure is 0, and it is slack without tension.

    Parameters
    ----------
    rate, free_length
        Spring rate [N/m] and unloaded length [m].

    Examples
    --------
    >>> from mckibben.units import N, mm
    >>> float(return_spring(2 * N / mm, 100 * mm).force(-0.05, 0.0))  # 5 mm longer
    10.0
    """
    law = SpringLaw(rate=rate, free_length=free_length)
    return Muscle(Specimen("return spring", free_length, domain=law.domain, volume_terms=(_VOLUME,)), law)
