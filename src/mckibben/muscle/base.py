"""Interface of a force law, its numerical inverse in pressure, and the ideal braid (Eq. 1)."""

import abc
import itertools
import warnings
from dataclasses import dataclass
from numbers import Real
from typing import Annotated, Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, ArrayLike, Float

from mckibben.component.base import Component
from mckibben.component.calls import checked_call, user_level
from mckibben.component.checks import check_within, known_numbers
from mckibben.component.classes import find_class
from mckibben.component.extensions import is_foreign
from mckibben.errors import DomainWarning, McKibbenWarning, RangeError, quoted
from mckibben.muscle.specimen import Domain
from mckibben.numerics.calculus import bracketed_root, derivative
from mckibben.units import Percent, Quantity, atm, bar, deg, mm, percent, show

# No `from __future__ import annotations` here: equinox does not recognise an AbstractVar written as text.


PositiveContraction = Annotated[float, Percent("1", "%", 0, 80, open_lower=True)]


@dataclass(frozen=True)
class Parameter:
    """Parameter of a law that can be identified: field, SI unit, unit in reports, meaning, and bounds in SI.

    A penalised parameter has a Gaussian prior about zero; its law has its own identification method.
    """

    name: str
    unit: str
    shown: str
    meaning: str
    lower: float = -jnp.inf
    upper: float = jnp.inf
    penalised: bool = False


class ForceLaw(Component):
    """Static axial force of a muscle as a function of contraction and pressure.

    A law is the formula of its source and may be negative where the muscle is slack; `Muscle` clips it. Subclasses
    define the fields (parameters in SI and `domain`), `force`, and the class attributes below.
    """

    domain: eqx.AbstractVar[Domain]

    suggestions: ClassVar = {
        "stiffness": "slope(contraction, pressure), or joint.stiffness(angle, pressures)",
        "()": "to identify it from data, write mk.identify(data, {})",
    }
    equation: ClassVar[str] = ""
    """Formula in the symbols of the source."""
    source: ClassVar[str]
    """Paper and equation."""
    linear_parameters: ClassVar[tuple[Parameter, ...]] = ()
    """Parameters in which the force is affine when the shape parameters are fixed."""
    shape_parameters: ClassVar[tuple[Parameter, ...]] = ()
    """All other parameters, each with finite bounds."""
    constants: ClassVar[tuple[Parameter, ...]] = ()
    """Fields that an identification sets but does not estimate."""
    is_passive: ClassVar[bool] = False
    """Whether it is a spring, or no muscle at all: nothing commands it."""
    pulls: ClassVar[bool] = True
    """Whether it has any force."""
    formula_domain: ClassVar[Domain] = Domain()
    """Domain of the formula for any parameters; `domain` is the domain of the data behind a law."""

    @classmethod
    def unit_of(cls, name: str) -> Quantity | None:
        parameters = {parameter.name: parameter for parameter in (*cls.parameters(), *cls.constants)}
        return Quantity(parameters[name].unit, parameters[name].shown, -1e40, 1e40) if name in parameters else None

    @classmethod
    def check_equation(cls, equation: object) -> None:
        """Raise `RangeError` if a file has another equation."""
        if equation != cls.equation:
            message = f"is {quoted(equation)}, that of {cls.__module__}.{cls.__qualname__} is {quoted(cls.equation)}"
            remedy = "import the law that the file was made with, or identify it again"
            raise RangeError(message, field="equation", value=equation, remedy=remedy)

    @classmethod
    def from_file(cls, value: Any) -> Any:
        """Return the section without its equation, which has to be that of the class."""
        if not isinstance(value, dict) or "equation" not in value:
            return value
        kind = find_class(cls, str(value.get("class")))
        if kind is not None:
            kind.check_equation(value["equation"])
        return {key: field for key, field in value.items() if key != "equation"}

    @classmethod
    def to_file(cls, section: dict[str, Any]) -> dict[str, Any]:
        """Return the section, of a class that a reader may lack with its equation."""
        kind = find_class(cls, section.get("class", ""))
        if kind is None or not is_foreign(kind.__module__):
            return section
        return section | {"equation": kind.equation} if kind.equation else section

    @classmethod
    def parameters(cls) -> tuple[Parameter, ...]:
        """Return all parameters, linear ones first."""
        return cls.linear_parameters + cls.shape_parameters

    @abc.abstractmethod
    def force(self, contraction: ArrayLike, pressure: ArrayLike) -> Float[Array, "..."]:
        """Return the force [N] at a contraction [-] and a gauge pressure [Pa]; the arguments broadcast."""

    @abc.abstractmethod
    def pressure_for(self, force: ArrayLike, contraction: ArrayLike) -> Float[Array, "..."]:
        """Return the gauge pressure [Pa] that gives a force [N] at a contraction [-]; the arguments broadcast."""

    def slope(self, contraction: ArrayLike, pressure: ArrayLike) -> Float[Array, "..."]:
        """Return the derivative of the force with respect to the contraction [N], at constant pressure."""
        return derivative(lambda c: self.force(c, pressure), contraction)


LEAST_PRESSURE = 1e3  # Pa: a lower maximum was given in bar or kPa
ZERO_PRESSURE = 0.01  # Pa: a lower pressure is 0, from a solver for pressures of some bar
_POSSIBLE = -0.5, 0.8  # contractions


def check_point(contraction: ArrayLike, pressure: ArrayLike) -> tuple[ArrayLike, ArrayLike]:
    """Arguments of a direct call of a law's force, lists as arrays; refuses texts, and warns of impossible points."""
    if isinstance(contraction, Tracer) or isinstance(pressure, Tracer):
        return contraction, pressure
    contractions, pressures = (
        known_numbers("force", "contraction", contraction),
        known_numbers("force", "pressure", pressure),
    )
    if (wrong := contractions[(contractions < _POSSIBLE[0]) | (contractions > _POSSIBLE[1])]).size:
        text = (
            f"a contraction of {wrong[0] / percent:.4g} % is impossible: contractions are ratios, such as 10 * percent"
        )
        warnings.warn(text, DomainWarning, stacklevel=user_level())
    if (lowest := pressures.min(initial=0.0)) < -atm:
        text = f"a gauge pressure of {show(float(lowest), 'bar')} is impossible: it is below a vacuum"
        warnings.warn(text, DomainWarning, stacklevel=user_level())
    warn_small_pressure(float(pressures.max(initial=0.0)))
    return _as_array(contraction), _as_array(pressure)


def warn_small_pressure(highest: float) -> None:
    """Warn of a highest pressure [Pa] that was probably given in bar or kPa."""
    if ZERO_PRESSURE < highest < LEAST_PRESSURE:
        text = f"the highest pressure is {highest:g} Pa: numbers are in SI, such as 6 * bar"
        warnings.warn(text, McKibbenWarning, stacklevel=user_level())


def _as_array(numbers: ArrayLike) -> ArrayLike:
    """Array of a list, which may be nested and hold tracers; other numbers as they are."""
    if not isinstance(numbers, list | tuple):
        return numbers
    traced = any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves(numbers))
    return (jnp if traced else np).asarray(numbers)


class PressureAffineLaw(ForceLaw):
    """Law affine in pressure, F = offset(contraction) + gain(contraction) p, with a closed-form inverse."""

    @abc.abstractmethod
    def pressure_terms(self, contraction: ArrayLike) -> tuple[Float[Array, "..."], Float[Array, "..."]]:
        """Return offset [N] and gain [N/Pa] of the force at a contraction [-]."""

    @checked_call
    def force(self, contraction: ArrayLike, pressure: ArrayLike) -> Float[Array, "..."]:
        contraction, pressure = check_point(contraction, pressure)
        offset, gain = self.pressure_terms(contraction)
        return offset + gain * pressure

    @checked_call
    def pressure_for(self, force: ArrayLike, contraction: ArrayLike) -> Float[Array, "..."]:
        contraction, _ = check_point(contraction, 0.0)
        offset, gain = self.pressure_terms(contraction)
        return (jnp.asarray(force) - offset) / gain


def check_gain(law: ForceLaw, **gain: ArrayLike) -> None:
    """Raise `RangeError` if the force per pressure [N/Pa], an area, exceeds 1 m^2 at contraction 0 within the domain.

    Individual terms may be larger and cancel.
    """
    low, high = law.domain.contraction_min, law.domain.contraction_max
    if isinstance(low, Real) and isinstance(high, Real) and float(low) <= 0.0 <= float(high):
        check_within(type(law).__name__, -1.0, 1.0, "N/Pa", remedy="numbers are in SI: 1 N/bar is 1e-05 N/Pa", **gain)


_LOWEST, _HIGHEST = -0.5 * atm, 12 * bar  # range of pressures of any rubber muscle
_ROUNDING = 1e-9  # of a pressure


def pressure_for(law: ForceLaw, force: ArrayLike, contraction: ArrayLike) -> Float[Array, "..."]:
    """Return the gauge pressure [Pa], -0.5 to 12 bar, for a force [N] that rises with pressure; NaN if none exists.

    Within the pressures of the domain it need not rise beyond them, as the extrapolation of a fitted law may not.
    """
    force, contraction = jnp.asarray(force), jnp.asarray(contraction)
    least, most = (jnp.clip(pressure, 0.0, _HIGHEST) for pressure in (law.domain.pressure_min, law.domain.pressure_max))
    ends = _LOWEST, 0.0, least * (1 - _ROUNDING), most * (1 + _ROUNDING), _HIGHEST
    low, high = ends[:2]
    for start, end in itertools.pairwise(ends[1:]):
        reached = law.force(contraction, start) <= force
        low, high = jnp.where(reached, start, low), jnp.where(reached, end, high)
    return bracketed_root(lambda pressure: law.force(contraction, pressure) - force, low, high)


BRAID_PARAMETERS = (
    Parameter("braid_angle", "rad", "deg", "angle between thread and axis", 5 * deg, 54 * deg),
    Parameter("initial_diameter", "m", "mm", "diameter of the deflated muscle", 1 * mm, 100 * mm),
)
"""Parameters of `braid_gain` that can be identified."""


def braid_gain(braid_angle: float | Array, initial_diameter: float | Array, length_ratio: Array) -> Float[Array, "..."]:
    """Return the force per pressure [N/Pa] of an ideal braid (Eq. 1) at a relative length l/l0 [-]."""
    beta1 = 3 / jnp.tan(braid_angle) ** 2
    beta2 = 1 / jnp.sin(braid_angle) ** 2
    return jnp.pi * initial_diameter**2 / 4 * (beta1 * length_ratio**2 - beta2)
