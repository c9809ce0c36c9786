"""Design lengths of a joint: the fields of its geometry, and the lengths of its muscles."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import reduce
from typing import Any

import equinox as eqx
from jaxtyping import ArrayLike

from mckibben.component.base import field_quantities
from mckibben.errors import ParameterError, suggest
from mckibben.joint import Geometry
from mckibben.plant import JointPlant
from mckibben.units import BoundedInt, Quantity

Place = tuple[str, ...]
"""Attribute names on the path from the joint to a length."""

_MUSCLE1, _MUSCLE2 = ((name, "specimen", "initial_length") for name in ("muscle1", "muscle2"))
_MUSCLES = {"muscle_length": [_MUSCLE1, _MUSCLE2], "muscle1_length": [_MUSCLE1], "muscle2_length": [_MUSCLE2]}


def design_lengths(plant: JointPlant) -> dict[str, list[Place]]:
    """Locations of each length by name; equal lengths of both paths, or of both muscles, also have a joint name.

    Examples
    --------
    >>> from mckibben import IdealValve, PairedPaths, Pulley, catalog
    >>> knee = catalog.joint("knee-table-2")
    >>> plant = JointPlant(knee, catalog.load("knee-table-2"), IdealValve())
    >>> list(design_lengths(plant))[:3]
    ['joint_length', 'joint_radius', 'connector_length']
    >>> pulleys = eqx.tree_at(lambda p: p.joint.geometry, plant, PairedPaths(Pulley(0.03, 0.16), Pulley(0.03, 0.16)))
    >>> list(design_lengths(pulleys))[:3]
    ['path1.radius', 'path1.rest_length', 'path2.radius']
    """
    geometry = plant.joint.geometry
    found: dict[str, list[Place]] = {".".join(place): [("geometry", *place)] for place, _ in _lengths(geometry)}
    shared: dict[str, list[Place]] = {}
    for place, quantity in _lengths(geometry):
        if len(place) > 1 and quantity.lower >= 0:  # coordinates of the two muscles differ in sign
            shared.setdefault(place[-1], []).append(("geometry", *place))
    return found | shared | _MUSCLES  # pyrefly: ignore[bad-return]


def length_of(plant: JointPlant, name: str) -> float:
    """A length of a plant [m]; the first one if the name refers to two."""
    return float(_leaves(plant, name)[0])


def with_lengths(plant: JointPlant, lengths: Mapping[str, ArrayLike]) -> JointPlant:
    """The plant with new lengths [m], which may be traced; force laws depend on contraction and do not change."""
    for name, value in lengths.items():
        plant = eqx.tree_at(lambda p, name=name: _leaves(p, name), plant, [value] * len(_leaves(plant, name)))
    return plant


def check_length(plant: JointPlant, name: str, lower: float) -> None:
    """Reject a length that the joint does not have, and negative bounds of a nonnegative one."""
    known = design_lengths(plant)
    if name not in known:
        kind = type(plant.joint.geometry).__name__
        remedy = suggest(name, list(known))
        raise ParameterError(f"{name!r} is not a design variable of a joint with {kind}", value=name, remedy=remedy)
    signed = {".".join(place) for place, quantity in _lengths(plant.joint.geometry) if quantity.lower < 0}
    if lower < 0 and name not in signed:
        raise ParameterError(f"{name} is never negative", value=lower, lower=0.0, unit="m", remedy="give 0 or more")


def _leaves(plant: JointPlant, name: str) -> list[Any]:
    return [reduce(getattr, place, plant.joint) for place in design_lengths(plant)[name]]


def _lengths(part: Geometry | eqx.Module) -> Iterator[tuple[Place, Quantity | BoundedInt]]:
    """Location and quantity of each length among the fields of a geometry and its parts."""
    quantities = field_quantities(type(part))
    for name, value in vars(part).items():
        quantity = quantities.get(name)
        if isinstance(value, eqx.Module):
            yield from (((name, *place), found) for place, found in _lengths(value))
        elif quantity and quantity.unit == "m" and value is not None and not isinstance(value, tuple):
            yield (name,), quantity
