"""A make of muscle: what the maker says of it, before any test."""

from __future__ import annotations

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float

from mckibben.muscle.domain import Domain
from mckibben.numerics.checks import check_positive, check_within


class Specimen(eqx.Module):
    """Dimensions and ratings of a muscle.

    Parameters
    ----------
    name
        The maker's designation.
    initial_length, initial_diameter
        l0 and d0 [m] of the deflated, unloaded muscle.
    braid_angle
        alpha0 [rad] between thread and axis of the deflated muscle.
    rated_force
        The highest permissible force [N].
    domain
        Permissible contraction [-] and gauge pressure [Pa].
    """

    name: str = eqx.field(static=True)
    initial_length: float
    initial_diameter: float
    braid_angle: float
    rated_force: float
    domain: Domain

    def __check_init__(self) -> None:
        check_positive(self.name, "m", initial_length=self.initial_length, initial_diameter=self.initial_diameter)
        check_positive(self.name, "N", rated_force=self.rated_force)
        check_within(self.name, 0.01, 1.56, "rad", braid_angle=self.braid_angle)

    def contraction_at(self, length: ArrayLike) -> Float[Array, "..."]:
        """(l0 - l)/l0 [-] at a length [m]; positive = shorter."""
        return 1 - jnp.asarray(length) * (1 / self.initial_length)  # in loops, a product waits less than a quotient

    def length_at(self, contraction: ArrayLike) -> Float[Array, "..."]:
        """The length [m] at a contraction [-]."""
        return self.initial_length * (1 - jnp.asarray(contraction))

    def volume(self, contraction: ArrayLike) -> Float[Array, "..."]:
        r"""The volume [m^3] inside the braid, a cylinder of inextensible thread.

        .. math::

            V = \frac{\pi d_0^2 l_0}{4} (1-\varepsilon) \frac{1 - \cos^2\alpha_0 (1-\varepsilon)^2}{\sin^2\alpha_0}

        The virtual work of this volume, F = -p dV/dl, is Chou's law (Eq. 1).
        """
        ratio = 1 - jnp.asarray(contraction)
        cylinder = jnp.pi * self.initial_diameter**2 * self.initial_length / 4
        widening = (1 - jnp.cos(self.braid_angle) ** 2 * ratio**2) / jnp.sin(self.braid_angle) ** 2
        return cylinder * ratio * widening
