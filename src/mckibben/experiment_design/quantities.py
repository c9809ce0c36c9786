"""Quantities of interest of an experiment design, and their text form."""

from __future__ import annotations

import abc
import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from mckibben.errors import ParameterError, RangeError, UnitError
from mckibben.experiment_design.candidates import StateGrid
from mckibben.experiment_design.information import Floats
from mckibben.identification.least_squares import design_matrix
from mckibben.joint import AntagonisticJoint
from mckibben.muscle import Domain, ForceLaw, forces
from mckibben.muscle.base import Parameter
from mckibben.numerics.compiled import jit
from mckibben.units import bar, deg, parse_range, quantity


@dataclass(frozen=True, eq=False)
class LinearizedQuantity:
    """A quantity of one or more values at the estimate of the parameters."""

    gradients: Floats = field(repr=False)  # (values, parameters), in SI
    values: Floats = field(repr=False)  # (values,)
    # (states, 2): contraction [-] and pressure [Pa] of the muscle that it depends on
    states: Floats = field(default_factory=lambda: np.empty((0, 2)), repr=False)
    warnings: tuple[str, ...] = ()  # on its value


class QuantityOfInterest(abc.ABC):
    """A quantity that depends on the parameters of a law."""

    @abc.abstractmethod
    def linearize(self, law: ForceLaw, states: StateGrid) -> LinearizedQuantity:
        """Linearise about a law; `states` are the measurable ones."""

    @abc.abstractmethod
    def unit(self, law_type: type[ForceLaw]) -> tuple[str, str]:
        """Unit of its standard error in SI, and the shown one."""


@dataclass(frozen=True)
class Coefficient(QuantityOfInterest):
    """A parameter of the law (c-optimal)."""

    name: str

    def __str__(self) -> str:
        return self.name

    def unit(self, law_type: type[ForceLaw]) -> tuple[str, str]:
        parameter = self._parameter(law_type)
        return parameter.unit, parameter.shown

    def linearize(self, law: ForceLaw, states: StateGrid) -> LinearizedQuantity:
        self._parameter(type(law))
        gradients = np.array([[float(p.name == self.name) for p in type(law).parameters()]])
        return LinearizedQuantity(gradients, np.array([float(getattr(law, self.name))]))

    def _parameter(self, law_type: type[ForceLaw]) -> Parameter:
        parameters = {p.name: p for p in law_type.parameters()}
        if self.name not in parameters:
            remedy = f"give stiffness, force, or a coefficient; {law_type.__name__} has {', '.join(parameters)}"
            raise ParameterError(f"{self.name!r} is not a quantity of interest", value=self.name, remedy=remedy)
        return parameters[self.name]


@dataclass(frozen=True)
class Force(QuantityOfInterest):
    """Mean force of the law over the taut part of a region (V-optimal); default: all measurable states.

    A region has 21 states along each side. Linearisation raises `RangeError` if the law has no force anywhere in it.
    """

    region: Domain | None = None

    def __str__(self) -> str:
        return f"force at {self.region}" if self.region else "force"

    def unit(self, law_type: type[ForceLaw]) -> tuple[str, str]:
        return "N", "N"

    def linearize(self, law: ForceLaw, states: StateGrid) -> LinearizedQuantity:
        if self.region is None:
            rows, columns = states.places.T
            contraction, pressure = states.contractions[columns], states.pressures[rows]
            force, region = states.force[rows, columns], np.empty((0, 2))
        else:
            box = self.region
            sides = (
                np.linspace(float(low), float(high), 21 if high > low else 1)
                for low, high in ((box.contraction_min, box.contraction_max), (box.pressure_min, box.pressure_max))
            )
            contraction, pressure = (axis.ravel() for axis in np.meshgrid(*sides))
            force = forces(law, contraction, pressure)
            with np.errstate(invalid="ignore"):
                taut = (force > 0) & np.asarray(type(law).formula_domain.contains(contraction, pressure))
            if not taut.any():
                remedy = "choose a region where the muscle is taut"
                raise RangeError(f"the law has no force anywhere in the region {box}", remedy=remedy)
            contraction, pressure, force = contraction[taut], pressure[taut], force[taut]
            region = np.stack([contraction, pressure], axis=1)
        names = [p.name for p in type(law).parameters()]
        gradients = design_matrix(law, names, contraction, pressure)
        return LinearizedQuantity(gradients, force, states=region)


@dataclass(frozen=True)
class JointStiffness(QuantityOfInterest):
    """Stiffness, at constant pressures, of a joint whose muscles both follow the law.

    At angles [rad] and pressures of muscles 1 and 2 [Pa]; the criterion for several angles is the mean variance.
    Linearisation raises `RangeError` for an angle or a pressure outside the range of a muscle; a slack muscle is a
    warning.
    """

    joint: AntagonisticJoint
    angle: float | Sequence[float] = 0.0
    pressures: tuple[float, float] = (3 * bar, 3 * bar)

    def __str__(self) -> str:
        angles = np.atleast_1d(np.asarray(self.angle, float)) / deg
        angle_text = f"{angles[0]:.4g}" if len(angles) == 1 else f"{angles[0]:.4g}..{angles[-1]:.4g}"
        p1, p2 = (pressure / bar for pressure in self.pressures)
        return f"stiffness at {angle_text} deg, {p1:.4g} bar, {p2:.4g} bar"

    def unit(self, law_type: type[ForceLaw]) -> tuple[str, str]:
        return "N*m/rad", "N*m/rad"

    def linearize(self, law: ForceLaw, states: StateGrid) -> LinearizedQuantity:
        angles = np.atleast_1d(np.asarray(self.angle, np.float64))
        pressures = [np.full(len(angles), float(pressure)) for pressure in self.pressures]
        linearised = _linearised_stiffness(self.joint, law, angles, (pressures[0], pressures[1]))
        values, gradients, contractions = jax.tree.map(np.asarray, linearised)
        warnings: list[str] = []
        muscles = self.joint.muscle1, self.joint.muscle2
        for number, muscle, contraction, pressure in zip((1, 2), muscles, contractions, pressures, strict=True):
            domain, name = muscle.specimen.domain, muscle.specimen.name
            remedy = "choose a smaller angle, or other lengths of the joint"
            for value in contraction:
                domain.check_contraction(float(value), f"{name} (muscle {number}, {self})", remedy)
            low, high = float(domain.pressure_min), float(domain.pressure_max)
            if not low <= pressure[0] <= high:
                message = f"{pressure[0] / bar:g} bar is outside {low / bar:g}..{high / bar:g} bar of {name}"
                raise RangeError(message, value=pressure[0], lower=low, upper=high, unit="Pa")
            if np.any(forces(law, contraction, pressure) <= 0):
                warnings.append(f"muscle {number} is slack there and does not contribute to the stiffness")
        places = np.stack([np.concatenate(contractions), np.concatenate(pressures)], axis=1)
        return LinearizedQuantity(gradients, values, states=places, warnings=tuple(warnings))


@jit
def _linearised_stiffness(
    joint: AntagonisticJoint, law: ForceLaw, angle: Floats, pressures: tuple[Floats, Floats]
) -> tuple[Array, Array, tuple[Array, Array]]:
    """Stiffness [N*m/rad] of both muscles with a law, its gradients, shape (angles, parameters), and contractions."""
    names = [parameter.name for parameter in type(law).parameters()]

    def joint_with(values: Any) -> AntagonisticJoint:
        changed = dataclasses.replace(law, **dict(zip(names, values, strict=True)))
        return eqx.tree_at(lambda j: (j.muscle1.law, j.muscle2.law), joint, (changed, changed))

    def stiffness(values: Array) -> Array:
        return joint_with(values).evaluate(angle, pressures)[1]

    values = jnp.stack([getattr(law, name) for name in names])
    return stiffness(values), jax.jacfwd(stiffness)(values), joint_with(values).contractions(angle, pressures)


def parse_quantity_of_interest(
    text: str, law_type: type[ForceLaw], joint: Callable[[], AntagonisticJoint]
) -> QuantityOfInterest:
    """Parse a quantity of interest.

    Parameters
    ----------
    text
        A coefficient such as "decay"; "force", or "force at 0..10 %, 3..6 bar"; "stiffness", or that "at 5 deg, 3 bar"
        (both muscles), "at -10..10 deg, 2 bar, 4 bar" (muscles 1 and 2). The default is 0 deg and 3 bar.
    law_type
        Law with the coefficients.
    joint
        Function that returns the joint, called only if needed.

    Raises
    ------
    ParameterError
        If the text has a different form.
    UnitError
        If a quantity after "at" has a unit of another dimension.

    Examples
    --------
    >>> from mckibben import catalog
    >>> from mckibben.muscle import ExponentialLaw
    >>> knee = lambda: catalog.joint("knee-table-2")
    >>> for words in ("decay", "force at 0..10 %, 3..6 bar", "stiffness at 5 deg, 2 bar, 4 bar"):
    ...     print(parse_quantity_of_interest(words, ExponentialLaw, knee))
    decay
    force at contraction 0..10 %, pressure 3..6 bar
    stiffness at 5 deg, 2 bar, 4 bar
    """
    kind, _, place = (word.strip() for word in text.partition(" at "))
    values = [word.strip() for word in place.split(",")] if place else []
    if kind not in _FORMS:
        coefficient = Coefficient(text.strip())
        coefficient.unit(law_type)  # raises for a name that the law lacks
        return coefficient
    if len(values) not in _FORMS[kind]:
        raise ParameterError(f"{text!r} has {len(values)} values", value=text, remedy=_PLACES[kind == "force"])
    try:
        if kind == "force":
            return Force(Domain(*parse_range(values[0], "1"), *parse_range(values[1], "Pa")) if values else None)
        if not values:
            return JointStiffness(joint())
        low, high = parse_range(values[0], "rad")
        pressures = [quantity(word, "Pa") for word in values[1:]] or [3 * bar]
    except UnitError as error:
        raise UnitError(f"{text!r}: {error}; {_PLACES[kind == 'force']}", value=text) from None
    angle = low if low == high else tuple(np.linspace(low, high, 5).tolist())
    return JointStiffness(joint(), angle, (pressures[0], pressures[-1]))


_FORMS = {"force": (0, 2), "stiffness": (0, 1, 2, 3)}
"""Numbers of values after "at"."""
_PLACES = "write an angle and pressures, 'at 5 deg, 2 bar, 4 bar'", "write 'force at 0..10 %, 3..6 bar'"
