"""A muscle: specimen, force law, domain, and the internal state of its friction and creep."""

from __future__ import annotations

import dataclasses
import warnings
from collections.abc import Callable
from numbers import Real
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, ArrayLike, Float
from numpy.typing import NDArray

from mckibben.component.base import Component, once
from mckibben.component.calls import checked_call, user_level
from mckibben.component.checks import known_numbers
from mckibben.errors import DomainWarning, McKibbenWarning, RangeError
from mckibben.muscle.adjusted import ForceCorrection, adjusted_law
from mckibben.muscle.base import LEAST_PRESSURE, ForceLaw, warn_small_pressure
from mckibben.muscle.creep import Creep, CreepState, NoCreep
from mckibben.muscle.friction import Friction, FrictionState, NoFriction
from mckibben.muscle.slopes import unphysical
from mckibben.muscle.specimen import Domain, Specimen
from mckibben.numerics.calculus import derivative
from mckibben.numerics.compiled import jit
from mckibben.units import Strength, bar

CHECK_LAW = "check the signs and units of its parameters, and its domain"
"""Remedy for a law that is not that of a muscle."""


class MuscleState(NamedTuple):
    """Internal state of a muscle; an empty part contributes no force."""

    friction: FrictionState = ()
    creep: CreepState = ()


NO_STATE = MuscleState()


class Muscle(Component):
    """A specimen with its force law, friction and creep.

    Unlike the law, a muscle cannot push: where the law is negative the muscle is slack and its force is zero. Friction
    and creep act only through an internal state (`MuscleState`); without it, `force` and all joint quantities follow
    from the law alone. `strength` multiplies all forces of the law (scatter among muscles, and ageing); `correction` is
    added to them. The law's domain replaces infinite bounds of the specimen's domain; the lowest pressure becomes 0
    where the law's is higher. `extrapolate` applies the law at all pressures of the specimen, not only at those
    of its data. Raises `RangeError` if the domains of specimen and law do not overlap; a `McKibbenWarning` names a law
    whose force rises with contraction or falls with pressure.

    Parameters
    ----------
    specimen, law, friction, creep
        Parts of the muscle.
    strength
        Factor of all forces of the law. Default: 1.
    correction
        Force [N] that is added to those of the law. Default: none.
    extrapolate
        Whether the law is applied at all pressures of the specimen.
    """

    specimen: Specimen
    law: ForceLaw
    friction: Friction = NoFriction()
    creep: Creep = NoCreep()
    strength: Strength | None = eqx.field(kw_only=True, default=None)
    correction: ForceCorrection | None = eqx.field(kw_only=True, default=None)
    extrapolate: bool = eqx.field(kw_only=True, static=True, default=False)

    @classmethod
    def from_file(cls, value: Any) -> Any:
        """Return the section of a muscle for one of a return spring, or of none; `RangeError` for a fit."""
        if isinstance(value, dict) and {"law"} <= value.keys() <= {"law", "equation", "version", "fit"}:
            remedy = "give the muscle a specimen, and the file as its law"
            raise RangeError("is a fit, the law of a muscle", remedy=remedy)
        passive = {"domain": {"pressure_min": "0 bar", "pressure_max": "0 bar"}, "volume_terms": ("1 cm^3",)}
        if value == "none":
            return {"specimen": {"name": "no muscle", "initial_length": "1 m", **passive}, "law": "no_force"}
        if not isinstance(value, dict) or value.get("class") != "return_spring":
            return value
        specimen = {"name": "return spring", "initial_length": value.get("free_length", ""), **passive}
        spring = {key: field for key, field in value.items() if key not in ("class", "free_length")}
        return {"specimen": specimen, "law": {"class": "spring", **spring}}

    @property
    def force_law(self) -> ForceLaw:
        """The law with strength and correction."""
        if self.strength is None and self.correction is None:
            return self.law
        return adjusted_law(self.law, strength=self.strength, correction=self.correction)

    def __post_init__(self) -> None:
        if isinstance(self.specimen, Specimen) and isinstance(self.law, ForceLaw):
            measured, lowest = self.law.domain, self.law.domain.pressure_min
            vented = min(lowest, 0.0) if isinstance(lowest, Real) and lowest > -jnp.inf else 0.0
            domain = self.specimen.domain.filled(dataclasses.replace(measured, pressure_min=vented))
            if domain is not self.specimen.domain:
                self.specimen = dataclasses.replace(self.specimen, domain=domain)

    def __check_init__(self) -> None:
        super().__check_init__()
        self.domain  # noqa: B018  # raises if there is none
        if self.violation:
            warnings.warn(f"{self.violation}; {CHECK_LAW}", McKibbenWarning, stacklevel=user_level())

    def __repr__(self) -> str:
        words = [self.specimen.name, type(self.law).__name__]
        words += [type(effect).__name__ for effect in (self.friction, self.creep) if self._is_dynamic(effect)]
        return f"Muscle({', '.join(words)})"

    @once
    def domain(self) -> Domain:
        """Intersection of the domains of the specimen and the law; pressures of the specimen with `extrapolate`."""
        measured = self.law.domain
        if self.extrapolate:
            measured = Domain(measured.contraction_min, measured.contraction_max)
        return self.specimen.domain.intersection(measured).intersection(self.law.formula_domain)

    @property
    def extrapolation(self) -> str:
        """Pressures of the domain at which the law was not measured, in words; empty if there are none."""
        domain, law = self.domain, self.law.domain
        bounds = domain.pressure_min, domain.pressure_max, law.pressure_min, law.pressure_max
        if not self.extrapolate or not all(isinstance(bound, Real) for bound in bounds):
            return ""
        low, high, lowest, highest = (float(bound) / bar for bound in bounds)
        if low >= lowest and high <= highest:
            return ""
        ranges = f"{lowest:g}..{highest:g} bar, where it was measured, to {low:g}..{high:g} bar"
        return f"the law of the muscle {self.specimen.name!r} is extrapolated from {ranges}"

    @property
    def violation(self) -> str:
        """First violation of a muscle's slopes by the law within the domain; empty for none, and for traced numbers."""
        if not all(isinstance(leaf, Real) for leaf in jax.tree.leaves((self.law, self.domain))):
            return ""
        wrong = unphysical(self.law, self.domain)
        return wrong and f"the law of {self.specimen.name!r} is not that of a muscle: {wrong}"

    def check_pressure_limit(self) -> None:
        """Raise `RangeError` if neither specimen nor law limits the pressure, or if the limit is in bar."""
        highest = self.domain.pressure_max
        if isinstance(highest, float | int) and not (highest <= 0 or LEAST_PRESSURE <= highest < jnp.inf):
            stated = "unknown" if highest == jnp.inf else f"{highest:g} Pa; numbers are in SI"
            message = f"the highest pressure of the muscle {self.specimen.name!r} is {stated}"
            remedy = "give the specimen a domain with its pressure_max, such as 6 * bar"
            raise RangeError(message, field="pressure_max", value=float(highest), unit="Pa", remedy=remedy)

    @property
    def has_friction(self) -> bool:
        """Whether friction contributes to the force."""
        return self._is_dynamic(self.friction)

    @property
    def has_creep(self) -> bool:
        """Whether creep contributes to the force."""
        return self._is_dynamic(self.creep)

    @staticmethod
    def _is_dynamic(effect: Friction | Creep) -> bool:
        return not isinstance(effect, NoFriction | NoCreep)

    def init_state(self, contraction: ArrayLike, pressure: ArrayLike) -> MuscleState:
        """Return the unstressed, relaxed state at a contraction [-] and a gauge pressure [Pa]."""
        length = self.specimen.length_at(contraction)
        return MuscleState(self.friction.initial(length), self.creep.initial(length, pressure))

    @checked_call
    def force(self, contraction: ArrayLike, pressure: ArrayLike, state: MuscleState = NO_STATE) -> Float[Array, "..."]:
        """Return the force [N] at a contraction [-] and a gauge pressure [Pa], never below 0; the arguments broadcast.

        An internal state adds friction, within the law's force, and creep, within half of it. Except inside `jax.jit`,
        a `DomainWarning` is issued outside the domain, where the law is extrapolated, and a warning for pressures up to
        1 kPa, which were probably given in bar.
        """
        warn_outside((self, contraction, pressure))
        return self.tension(contraction, pressure, state)

    def tension(
        self, contraction: ArrayLike, pressure: ArrayLike, state: MuscleState = NO_STATE
    ) -> Float[Array, "..."]:
        """Return `force` without a check of the domain."""
        tension = total = self._static_tension(contraction, pressure)
        if state.friction:
            length = self.specimen.length_at(contraction)
            total = total + self.friction.force(state.friction, length, tension, pressure)
        if not state.creep:
            return total
        return jnp.maximum(total + self.creep_force(contraction, tension, state), 0.0)

    def creep_force(self, contraction: ArrayLike, tension: ArrayLike, state: MuscleState) -> Float[Array, "..."]:
        """Return the force [N] of creep at a contraction [-] and the law's tension [N] there."""
        return self.creep.force(state.creep, tension, lambda pressure: self._static_tension(contraction, pressure))

    def _static_tension(self, contraction: ArrayLike, pressure: ArrayLike) -> Float[Array, "..."]:
        force = self.force_law.force(contraction, pressure)
        return jnp.where(force < 0, 0.0, force)  # in this form, NaN does not count as slack

    def viscous_force(
        self, contraction: ArrayLike, pressure: ArrayLike, rate: ArrayLike, state: MuscleState = NO_STATE
    ) -> Float[Array, "..."]:
        """Return the viscous force [N] at a rate of the length [m/s]; the sum with `force` is never below 0."""
        tension, length = self.tension(contraction, pressure), self.specimen.length_at(contraction)
        force = self.friction.viscous_force(length, tension, pressure, rate)
        return jnp.maximum(force, -self.tension(contraction, pressure, state)) if state.creep else force

    def state_rate(self, state: MuscleState, rate: ArrayLike, pressure: ArrayLike) -> MuscleState:
        """Return the time derivative of the state at a rate of the length [m/s] and a gauge pressure [Pa].

        It is 0 for friction.
        """
        return MuscleState((), self.creep.rate(state.creep, rate, pressure) if state.creep else ())

    def update_state(self, state: MuscleState, contraction: ArrayLike, pressure: ArrayLike) -> MuscleState:
        """Return the state after a move to a contraction [-] and a gauge pressure [Pa], projected on its bounds."""
        friction, creep = state
        tension = self.tension(contraction, pressure)
        if friction:
            friction = self.friction.project(friction, self.specimen.length_at(contraction), tension, pressure)
        return MuscleState(friction, self.creep.project(creep, tension) if creep else ())

    @checked_call
    def slope(self, contraction: ArrayLike, pressure: ArrayLike) -> Float[Array, "..."]:
        """Return the derivative of `force` with respect to the contraction [N], 0 where slack; warns as `force`."""
        warn_outside((self, contraction, pressure))
        return derivative(lambda c: self.tension(c, pressure), contraction)

    @checked_call
    def pressure_for(self, force: ArrayLike, contraction: ArrayLike) -> Float[Array, "..."]:
        """Return the gauge pressure [Pa] that gives a force [N] at a contraction [-]; warns outside the domain."""
        pressure = self.force_law.pressure_for(force, contraction)
        warn_outside((self, contraction, pressure))
        return pressure


def warn_outside(*points: tuple[Muscle, ArrayLike, ArrayLike]) -> None:
    """Issue one `DomainWarning` for concrete values outside their muscle's domain; warn of pressures in bar."""
    if any(isinstance(value, Tracer) for _, *values in points for value in values):
        return
    warn_small_pressure(max(float(np.max(pressure, initial=0.0)) for _, _, pressure in points))
    texts = [
        (f"muscle {muscle.specimen.name!r}", muscle.domain.describe_outside(*values)) for muscle, *values in points
    ]
    if outside := dict.fromkeys(f"{name}: {text}" for name, text in texts if text):
        text = f"{'; '.join(outside)}; the law is extrapolated there"
        warnings.warn(text, DomainWarning, stacklevel=user_level())


def forces(of: Muscle | ForceLaw, contraction: ArrayLike, pressure: ArrayLike) -> NDArray[np.float64]:
    """Return the force [N] of a muscle or law at measured points as a NumPy array, compiled as one piece."""
    known_numbers("forces", "contraction", contraction)
    known_numbers("forces", "pressure", pressure)
    return _at_points(_force, of, contraction, pressure)


def half_widths(of: Friction, tension: ArrayLike, pressure: ArrayLike) -> NDArray[np.float64]:
    """Return the half width [N] of a friction band at points as a NumPy array, compiled as one piece."""
    return _at_points(_half_width, of, tension, pressure)


def _at_points(function: Callable[..., Array], of: Any, *arguments: ArrayLike) -> NDArray[np.float64]:
    """Values at points, padded to a power of two so that datasets of different sizes share compiled code."""
    columns = np.broadcast_arrays(*(np.asarray(column, float) for column in arguments))
    shape, points = columns[0].shape, columns[0].size
    pad = (0, max(128, 1 << (points - 1).bit_length()) - points) if points else (0, 0)
    padded = (np.pad(column.ravel(), pad, mode="edge") if points else column for column in columns)
    values = np.asarray(function(of, *padded))
    return values.ravel()[:points].reshape(shape)


@jit
def _force(of: Muscle | ForceLaw, contraction: Array, pressure: Array) -> Array:
    return of.force(contraction, pressure)


@jit
def _half_width(of: Friction, tension: Array, pressure: Array) -> Array:
    return jnp.broadcast_to(of.half_width_at(tension, pressure), tension.shape)
