"""Connection of a muscle to its path: rigid, or a series spring (the paper's "mechanical stretch structure")."""

from __future__ import annotations

import abc
from collections.abc import Callable
from typing import Annotated

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, ArrayLike, Float

from mckibben.component.base import Component
from mckibben.muscle import NO_STATE, Muscle, MuscleState
from mckibben.numerics.calculus import value_and_derivative
from mckibben.numerics.elementary import floating
from mckibben.units import Force, Quantity, SpringRate

_BISECTIONS, _STEPS = 3, 12  # to rounding for springs from 1 N/mm and 100 mm of travel

SpringTravel = Annotated[float, Quantity("m", "mm", 0, 500)]


class Tendon(Component):
    """Elastic element in series with a muscle: path = muscle length + extension, at equal tension."""

    default_class = "spring"

    @abc.abstractmethod
    def extension(self, tension: ArrayLike) -> Float[Array, "..."]:
        """Return the extension [m] under a tension [N]."""

    @abc.abstractmethod
    def contraction(
        self, muscle: Muscle, path: ArrayLike, pressure: ArrayLike, state: MuscleState = NO_STATE
    ) -> Float[Array, "..."]:
        """Return the contraction [-] of the muscle for a path length [m] and a gauge pressure [Pa]."""

    @abc.abstractmethod
    def permitted(self, muscle: Muscle, path: ArrayLike) -> tuple[Float[Array, "..."], Float[Array, "..."]]:
        """Return the range of tension [N] with the muscle in its domain; empty if lowest exceeds highest.

        At a path length [m] the extension of the tendon, and with it the contraction, follows from the tension.
        """

    def tension(
        self, muscle: Muscle, path: ArrayLike, pressure: ArrayLike, state: MuscleState = NO_STATE
    ) -> Float[Array, "..."]:
        """Return the tension [N] for a path length [m] and a gauge pressure [Pa]."""
        return muscle.tension(self.contraction(muscle, path, pressure, state), pressure, state)

    def pressure_for(self, muscle: Muscle, path: ArrayLike, tension: ArrayLike) -> Float[Array, "..."]:
        """Return the gauge pressure [Pa] for a tension [N] and a path length [m], possibly outside the domain."""
        length = jnp.asarray(path) - self.extension(tension)
        return muscle.force_law.pressure_for(tension, muscle.specimen.contraction_at(length))


class RigidTendon(Tendon):
    """Inextensible connector."""

    short_name = "rigid"

    def extension(self, tension: ArrayLike) -> Float[Array, "..."]:
        return jnp.zeros_like(floating(tension))

    def contraction(
        self, muscle: Muscle, path: ArrayLike, pressure: ArrayLike, state: MuscleState = NO_STATE
    ) -> Float[Array, "..."]:
        return muscle.specimen.contraction_at(path)

    def permitted(self, muscle: Muscle, path: ArrayLike) -> tuple[Float[Array, "..."], Float[Array, "..."]]:
        inside = muscle.domain.contains_contraction(muscle.specimen.contraction_at(path))
        return jnp.where(inside, -jnp.inf, jnp.inf), jnp.where(inside, jnp.inf, -jnp.inf)


class SeriesSpring(Tendon):
    """Preloaded spring in series with the muscle: our reading of the paper's "mechanical stretch structure".

    It is rigid up to the preload [N], then extends by (tension - preload) / stiffness [N/m] up to its travel [m].

    >>> spring = SeriesSpring(stiffness=2e4, preload=60.0, travel=0.01)
    >>> [round(float(spring.extension(tension)), 4) for tension in (50.0, 160.0, 500.0)]
    [0.0, 0.005, 0.01]
    """

    short_name = "spring"

    stiffness: SpringRate
    preload: Force
    travel: SpringTravel

    def extension(self, tension: ArrayLike) -> Float[Array, "..."]:
        return jnp.clip((jnp.asarray(tension) - self.preload) / self.stiffness, 0.0, self.travel)

    def permitted(self, muscle: Muscle, path: ArrayLike) -> tuple[Float[Array, "..."], Float[Array, "..."]]:
        domain, specimen = muscle.domain, muscle.specimen
        least = jnp.asarray(path) - specimen.length_at(domain.contraction_min)  # extension at the lowest contraction
        most = jnp.asarray(path) - specimen.length_at(domain.contraction_max)
        lowest = jnp.where(least > 0, self.preload + self.stiffness * least, -jnp.inf)
        highest = jnp.where(most < self.travel, self.preload + self.stiffness * most, jnp.inf)
        return jnp.where(least <= self.travel, lowest, jnp.inf), jnp.where(most >= 0, highest, -jnp.inf)

    def contraction(
        self, muscle: Muscle, path: ArrayLike, pressure: ArrayLike, state: MuscleState = NO_STATE
    ) -> Float[Array, "..."]:
        """Return the contraction at which muscle and spring carry the same tension.

        The difference of their forces decreases with the extension, so its root is unique. Derivatives are those of
        the implicit function.
        """
        path, pressure = jnp.broadcast_arrays(floating(path), floating(pressure))

        def excess(extension: Array) -> Array:
            """Muscle force minus spring force."""
            force = muscle.tension(muscle.specimen.contraction_at(path - extension), pressure, state)
            return force - self.preload - self.stiffness * extension

        closed = jnp.zeros_like(path)
        extended = jnp.full_like(path, self.travel)
        free = lax.custom_root(
            excess,
            closed,
            lambda f, _: _falling_root(f, closed, extended),
            lambda tangent, y: y / tangent(jnp.ones_like(y)),
        )
        extension = jnp.where(excess(closed) <= 0, closed, jnp.where(excess(extended) >= 0, extended, free))
        return muscle.specimen.contraction_at(path - extension)


def _falling_root(function: Callable[[Array], Array], lower: Array, upper: Array) -> Array:
    """Return the root of a decreasing elementwise function in a bracket.

    By a fixed number of bisections, then of Newton steps that stay in the bracket, so that it compiles everywhere.
    """

    def refine(step: Array, carry: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        x, low, high = carry
        value, slope = value_and_derivative(function, x)
        low = jnp.where(value > 0, x, low)
        high = jnp.where(value > 0, high, x)
        newton = x - value / slope
        inside = (step >= _BISECTIONS) & (newton >= low) & (newton <= high)
        return jnp.where(inside, newton, (low + high) / 2), low, high

    return lax.fori_loop(0, _STEPS, refine, ((lower + upper) / 2, lower, upper))[0]
