"""What lies between a muscle and its path: nothing that gives, or the paper's "mechanical stretch structure"."""

from __future__ import annotations

import abc
from collections.abc import Callable

import equinox as eqx
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, ArrayLike, Float

from mckibben.muscle import Muscle
from mckibben.numerics.calculus import value_and_derivative
from mckibben.numerics.checks import check_positive
from mckibben.numerics.elementary import floating
from mckibben.units import Distance, Force, SpringRate


class Tendon(eqx.Module):
    """The elastic part of a path: path = muscle + extension, with one tension throughout."""

    @abc.abstractmethod
    def extension(self, tension: ArrayLike) -> Float[Array, "..."]:
        """How far it gives [m] under a tension [N]."""

    @abc.abstractmethod
    def contraction(self, muscle: Muscle, path: ArrayLike, pressure: ArrayLike) -> Float[Array, "..."]:
        """The contraction [-] of the muscle in a path [m] at a gauge pressure [Pa]."""

    @abc.abstractmethod
    def permitted(self, muscle: Muscle, path: ArrayLike) -> tuple[Float[Array, "..."], Float[Array, "..."]]:
        """The tensions [N] at which the muscle stays in its domain; lowest above highest if there are none."""

    def tension(self, muscle: Muscle, path: ArrayLike, pressure: ArrayLike) -> Float[Array, "..."]:
        """The tension [N] in a path [m] at a gauge pressure [Pa]."""
        return muscle.tension(self.contraction(muscle, path, pressure), pressure)

    def pressure_for(self, muscle: Muscle, path: ArrayLike, tension: ArrayLike) -> Float[Array, "..."]:
        """The gauge pressure [Pa] that makes a tension [N] in a path [m]; it may lie outside the domain."""
        length = jnp.asarray(path) - self.extension(tension)
        return muscle.pressure_for(tension, muscle.specimen.contraction_at(length))


class RigidTendon(Tendon):
    """A connector that does not give: the muscle fills its path."""

    def extension(self, tension: ArrayLike) -> Float[Array, "..."]:
        return jnp.zeros_like(floating(tension))

    def contraction(self, muscle: Muscle, path: ArrayLike, pressure: ArrayLike) -> Float[Array, "..."]:
        return muscle.specimen.contraction_at(path)

    def permitted(self, muscle: Muscle, path: ArrayLike) -> tuple[Float[Array, "..."], Float[Array, "..."]]:
        inside = muscle.domain.contains_contraction(muscle.specimen.contraction_at(path))
        return jnp.where(inside, -jnp.inf, jnp.inf), jnp.where(inside, jnp.inf, -jnp.inf)


class SeriesSpring(Tendon):
    """A preloaded spring in series with the muscle, between two stops.

    It is closed up to the preload, then gives by tension / stiffness, and is solid again at the end of its travel. It
    is our reading of the paper's "mechanical stretch structure at the upper end of the PAM, which can compensate the
    lack of PAM elongation"; the paper describes it no further.

    Parameters
    ----------
    stiffness
        Force per extension [N/m].
    preload
        The tension [N] at which it begins to give.
    travel
        The extension [m] at which it is solid.
    """

    stiffness: SpringRate
    preload: Force
    travel: Distance

    def __check_init__(self) -> None:
        check_positive("SeriesSpring", "N/m", stiffness=self.stiffness)
        check_positive("SeriesSpring", "N", zero=True, preload=self.preload)
        check_positive("SeriesSpring", "m", zero=True, travel=self.travel)

    def extension(self, tension: ArrayLike) -> Float[Array, "..."]:
        return jnp.clip((jnp.asarray(tension) - self.preload) / self.stiffness, 0.0, self.travel)

    def permitted(self, muscle: Muscle, path: ArrayLike) -> tuple[Float[Array, "..."], Float[Array, "..."]]:
        domain, specimen = muscle.domain, muscle.specimen
        least = jnp.asarray(path) - specimen.length_at(domain.contraction_min)  # extension that spares the muscle
        most = jnp.asarray(path) - specimen.length_at(domain.contraction_max)
        lowest = jnp.where(least > 0, self.preload + self.stiffness * least, -jnp.inf)
        highest = jnp.where(most < self.travel, self.preload + self.stiffness * most, jnp.inf)
        return jnp.where(least <= self.travel, lowest, jnp.inf), jnp.where(most >= 0, highest, -jnp.inf)

    def contraction(self, muscle: Muscle, path: ArrayLike, pressure: ArrayLike) -> Float[Array, "..."]:
        """The contraction at which muscle and spring carry the same tension.

        The muscle's force falls and the spring's rises as the spring gives, so the extension is the one root of their
        difference, found by Newton's method from the closed spring and bisection where Newton leaves the bracket; its
        derivatives are those of the implicit function.
        """
        path, pressure = jnp.broadcast_arrays(floating(path), floating(pressure))

        def excess(extension: Array) -> Array:
            """Muscle force minus spring force, held at the stops."""
            force = muscle.tension(muscle.specimen.contraction_at(path - extension), pressure)
            return force - self.preload - self.stiffness * extension

        closed = jnp.zeros_like(path)
        solid = jnp.full_like(path, self.travel)
        free = lax.custom_root(
            excess,
            closed,
            lambda f, _: _falling_root(f, closed, solid),
            lambda tangent, y: y / tangent(jnp.ones_like(y)),
        )
        extension = jnp.where(excess(closed) <= 0, closed, jnp.where(excess(solid) >= 0, solid, free))
        return muscle.specimen.contraction_at(path - extension)


def _falling_root(function: Callable[[Array], Array], lower: Array, upper: Array) -> Array:
    """The root of an elementwise falling function in a bracket: Newton steps, bisection where they leave it."""
    tolerance = 1e-15

    def unfinished(carry: tuple[Array, Array, Array, Array, Array]) -> Array:
        _, low, high, moved, count = carry
        return jnp.any((moved > tolerance) & (high - low > tolerance)) & (count < 100)

    def refine(carry: tuple[Array, Array, Array, Array, Array]) -> tuple[Array, Array, Array, Array, Array]:
        x, low, high, _, count = carry
        value, slope = value_and_derivative(function, x)
        low = jnp.where(value > 0, x, low)
        high = jnp.where(value > 0, high, x)
        newton = x - value / slope
        inside = (newton >= low) & (newton <= high)
        following = jnp.where(inside, newton, (low + high) / 2)
        return following, low, high, jnp.abs(following - x), count + 1

    start = (lower, lower, upper, jnp.full_like(lower, jnp.inf), jnp.asarray(0))
    return lax.while_loop(unfinished, refine, start)[0]
