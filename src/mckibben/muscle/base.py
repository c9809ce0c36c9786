"""The interface of a force law, its inverse in pressure, and the ideal braid."""

import abc
from dataclasses import dataclass
from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float

from mckibben.muscle.specimen import Domain
from mckibben.numerics.calculus import bracketed_root, derivative
from mckibben.units import atm, bar, deg, mm

# No `from __future__ import annotations` here: equinox does not see an AbstractVar written as text.


@dataclass(frozen=True)
class Parameter:
    """One number of a law that data can determine.

    Attributes
    ----------
    name
        The field of the law that holds it, in SI.
    unit
        Its SI unit, as text.
    shown
        The unit in which publications and reports give it.
    lower, upper
        The range in which it has a meaning, in SI; where an identification looks for it.
    meaning
        A few words.
    """

    name: str
    unit: str
    shown: str
    meaning: str
    lower: float = -jnp.inf
    upper: float = jnp.inf


class ForceLaw(eqx.Module):
    """The static axial force of a muscle as a function of contraction and pressure.

    A law is the fitted formula as it stands: it may turn negative where the muscle goes slack. `Muscle` clips it.

    Subclasses give the fields (parameters in SI and `domain`), `force`, and the class attributes below.
    """

    domain: eqx.AbstractVar[Domain]

    equation: ClassVar[str]
    """The formula, in the letters of the source."""
    source: ClassVar[str]
    """Paper and equation."""
    linear_parameters: ClassVar[tuple[Parameter, ...]] = ()
    """Parameters in which the force is affine once the shape is known."""
    shape_parameters: ClassVar[tuple[Parameter, ...]] = ()
    """All others; each with a finite range."""
    holds: ClassVar[Domain] = Domain()
    """Where the formula has a meaning at all, whatever its parameters; `domain` is where to trust this law."""

    @classmethod
    def parameters(cls) -> tuple[Parameter, ...]:
        """All parameters, linear ones first."""
        return cls.linear_parameters + cls.shape_parameters

    @abc.abstractmethod
    def force(self, contraction: ArrayLike, pressure: ArrayLike) -> Float[Array, "..."]:
        """The force [N] at a contraction [-] and a gauge pressure [Pa]; the arguments broadcast."""

    @abc.abstractmethod
    def pressure_for(self, force: ArrayLike, contraction: ArrayLike) -> Float[Array, "..."]:
        """The gauge pressure [Pa] that gives a force [N] at a contraction [-]; the arguments broadcast."""

    def slope(self, contraction: ArrayLike, pressure: ArrayLike) -> Float[Array, "..."]:
        """The derivative of the force with respect to the contraction [N], at constant pressure."""
        return derivative(lambda c: self.force(c, pressure), contraction)


class PressureAffineLaw(ForceLaw):
    """A law whose force is affine in pressure: F = offset(contraction) + gain(contraction) p.

    Inverse, and the attainable set of a joint, are then closed forms.
    """

    @abc.abstractmethod
    def pressure_terms(self, contraction: ArrayLike) -> tuple[Float[Array, "..."], Float[Array, "..."]]:
        """Offset [N] and gain [N/Pa] of the force at a contraction [-]."""

    def force(self, contraction: ArrayLike, pressure: ArrayLike) -> Float[Array, "..."]:
        offset, gain = self.pressure_terms(contraction)
        return offset + gain * pressure

    def pressure_for(self, force: ArrayLike, contraction: ArrayLike) -> Float[Array, "..."]:
        offset, gain = self.pressure_terms(contraction)
        return (jnp.asarray(force) - offset) / gain


_LOWEST, _HIGHEST = -0.5 * atm, 12 * bar  # beyond, no muscle of rubber and thread is used


def pressure_for(law: ForceLaw, force: ArrayLike, contraction: ArrayLike) -> Float[Array, "..."]:
    """The gauge pressure [Pa] up to 12 bar that gives a force [N] at a contraction [-]; NaN for none.

    The force has to rise with the pressure from 0 up; below 0, to -0.5 bar, it is looked for where that at 0 is more.
    """
    force, contraction = jnp.asarray(force), jnp.asarray(contraction)
    lowest = jnp.where(law.force(contraction, 0.0) <= force, 0.0, _LOWEST)
    return bracketed_root(lambda pressure: law.force(contraction, pressure) - force, lowest, _HIGHEST)


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
