"""A muscle: a specimen that follows a law, inside a domain, and the friction and creep that go with it."""

from __future__ import annotations

import warnings

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, ArrayLike, Float
from numpy.typing import NDArray

from mckibben.errors import DomainWarning
from mckibben.muscle.base import ForceLaw
from mckibben.muscle.creep import Creep, NoCreep, Relaxing
from mckibben.muscle.friction import Friction, Memory, NoFriction
from mckibben.muscle.specimen import Domain, Specimen
from mckibben.numerics.calculus import derivative
from mckibben.numerics.checks import check_kind
from mckibben.numerics.compiled import compiled


class Muscle(eqx.Module):
    """A specimen and the law of its force.

    The difference to the law alone: a muscle cannot push. Where the law turns negative the muscle is slack and its
    force is zero.

    Parameters
    ----------
    specimen
        Dimensions and ratings.
    law
        Force over contraction and pressure.
    friction
        What the way to there adds to it; none unless given. `force` and all that follows from it (the torque and
        stiffness of a joint, what it can attain) are the law's; `gripped` adds friction and creep.
    creep
        What the time since then adds to it; none unless given.
    """

    specimen: Specimen
    law: ForceLaw
    friction: Friction = NoFriction()
    creep: Creep = NoCreep()

    def __check_init__(self) -> None:
        check_kind(
            "Muscle",
            specimen=(self.specimen, Specimen),
            law=(self.law, ForceLaw),
            friction=(self.friction, Friction),
            creep=(self.creep, Creep),
        )

    @property
    def domain(self) -> Domain:
        """Where both the specimen may be used and the law holds."""
        return self.specimen.domain.intersection(self.law.domain).intersection(self.law.holds)

    def force(self, contraction: ArrayLike, pressure: ArrayLike) -> Float[Array, "..."]:
        """The force [N], never below 0; arguments as for the law.

        Warns
        -----
        DomainWarning
            Outside the domain, where the answer is an extrapolation; not inside `jax.jit`, where nothing can be looked
            at.
        """
        _warn_outside(self, contraction, pressure)
        return self.tension(contraction, pressure)

    def tension(self, contraction: ArrayLike, pressure: ArrayLike) -> Float[Array, "..."]:
        """`force` without a look at the domain: for code that deals with it itself."""
        force = self.law.force(contraction, pressure)
        return jnp.where(force < 0, 0.0, force)  # this way round a lost state (NaN) is not taken for slack

    def gripped(self, memory: Memory, relaxing: Relaxing = ()) -> GrippedMuscle:
        """The muscle with its friction as it remembers the way, and what of its creep is still relaxing.

        For short moves from where memory and creep are of; without a state it has no creep.
        """
        return GrippedMuscle(self.specimen, self.law, self.friction, self.creep, memory, relaxing)

    def settled(self, memory: Memory, contraction: ArrayLike, pressure: ArrayLike) -> Memory:
        """What its friction remembers after a move to a contraction [-] and a gauge pressure [Pa]."""
        length = self.specimen.length_at(contraction)
        return self.friction.settled(memory, length, self.tension(contraction, pressure), pressure)

    def slope(self, contraction: ArrayLike, pressure: ArrayLike) -> Float[Array, "..."]:
        """The derivative of `force` with respect to the contraction [N]; 0 where slack. Warns as `force` does."""
        _warn_outside(self, contraction, pressure)
        return derivative(lambda c: self.tension(c, pressure), contraction)

    def pressure_for(self, force: ArrayLike, contraction: ArrayLike) -> Float[Array, "..."]:
        """The gauge pressure [Pa] that gives a force [N] at a contraction [-]; it may lie outside the domain."""
        return self.law.pressure_for(force, contraction)


class GrippedMuscle(Muscle):
    """A muscle whose force contains its friction and creep, their states being held; `Muscle.gripped` makes it.

    Its force is still a function of contraction and pressure alone, and still falls with the contraction.
    """

    memory: Memory = ()
    relaxing: Relaxing = ()

    def tension(self, contraction: ArrayLike, pressure: ArrayLike) -> Float[Array, "..."]:
        """The force [N] with friction and creep; each takes at most half of that without."""
        tension = Muscle.tension(self, contraction, pressure)
        length = self.specimen.length_at(contraction)
        gripped = tension + self.friction.force(self.memory, length, tension, pressure)
        return gripped if isinstance(self.creep, NoCreep) else gripped + self.creep.force(self.relaxing, tension)

    def viscous_force(self, contraction: ArrayLike, pressure: ArrayLike, rate: ArrayLike) -> Float[Array, "..."]:
        """The force [N] that depends on the rate of the length [m/s]: so much that the muscle does not push."""
        tension = Muscle.tension(self, contraction, pressure)
        if not isinstance(self.creep, NoCreep):  # half of the tension is the friction's, what is left of the other this
            tension = tension + 2 * jnp.minimum(self.creep.force(self.relaxing, tension), 0.0)
        return self.friction.viscous_force(tension, rate)


def _warn_outside(muscle: Muscle, contraction: ArrayLike, pressure: ArrayLike) -> None:
    """Warn of numbers outside the domain; at traced ones not even the domain is worked out."""
    if isinstance(contraction, Tracer) or isinstance(pressure, Tracer):
        return
    if outside := muscle.domain.describe_outside(contraction, pressure):
        text = f"{muscle.specimen.name}: {outside}; the law is extrapolated there"
        warnings.warn(text, DomainWarning, stacklevel=4)  # past the method, and how equinox calls it


def forces(of: Muscle | ForceLaw, contraction: ArrayLike, pressure: ArrayLike) -> NDArray[np.float64]:
    """The force [N] of a muscle or law at measured points, as NumPy has it: for analysis, compiled as one piece.

    Points are padded to a power of two, so that datasets of different sizes share what is compiled.
    """
    contraction, pressure = np.broadcast_arrays(np.asarray(contraction, float), np.asarray(pressure, float))
    points = contraction.size
    pad = (0, max(128, 1 << (points - 1).bit_length()) - points) if points else (0, 0)
    padded = (np.pad(column.ravel(), pad, mode="edge") if points else column for column in (contraction, pressure))
    return (
        np.asarray(_force(of, *(jnp.asarray(column) for column in padded))).ravel()[:points].reshape(contraction.shape)
    )


@compiled
def _force(of: Muscle | ForceLaw, contraction: Array, pressure: Array) -> Array:
    return of.force(contraction, pressure)
