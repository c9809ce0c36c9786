"""Design lengths of a joint: the fields of its geometry, and the lengths of its muscles."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from functools import reduce

import equinox as eqx
from jaxtyping import ArrayLike

from mckibben.component.base import field_quantities
from mckibben.errors import ParameterError, suggest
from mckibben.joint import AntagonisticJoint, Geometry
from mckibben.plant import JointPlant
from mckibben.reachability.requirement import LengthRange
from mckibben.units import BoundedInt, Quantity

Place = tuple[str, ...]
"""Attribute names on the path from the joint to a length."""

_MUSCLE1, _MUSCLE2 = ((name, "specimen", "initial_length") for name in ("muscle1", "muscle2"))
_MUSCLES = {"muscle_length": [_MUSCLE1, _MUSCLE2], "muscle1_length": [_MUSCLE1], "muscle2_length": [_MUSCLE2]}


def design_lengths(joint: AntagonisticJoint) -> dict[str, list[Place]]:
    """Locations of each length by name; equal lengths of both paths, or of both muscles, also have a joint name.

    Examples
    --------
    >>> from mckibben import PairedPaths, Pulley, catalog
    >>> knee = catalog.joint("knee-table-2")
    >>> list(design_lengths(knee))[:3]
    ['joint_length', 'joint_radius', 'connector_length']
    >>> pulleys = eqx.tree_at(lambda joint: joint.geometry, knee, PairedPaths(Pulley(0.03, 0.16), Pulley(0.03, 0.16)))
    >>> list(design_lengths(pulleys))[:3]
    ['path1.radius', 'path1.rest_length', 'path2.radius']
    """
    geometry = joint.geometry
    own: dict[str, list[Place]] = {".".join(place): [("geometry", *place)] for place, _ in _lengths(geometry)}
    shared: dict[str, list[Place]] = {}
    for place, quantity in _lengths(geometry):
        if len(place) > 1 and quantity.lower >= 0:  # coordinates of the two muscles differ in sign
            shared.setdefault(place[-1], []).append(("geometry", *place))
    return own | shared | _MUSCLES  # pyrefly: ignore[bad-return]


def with_lengths(plant: JointPlant, lengths: Mapping[str, ArrayLike]) -> JointPlant:
    """The plant with new lengths [m], which may be traced.

    Force laws depend on contraction and do not change; the volume of a muscle scales with its length.
    """
    for name, value in lengths.items():
        for place in design_lengths(plant.joint)[name]:
            if place[-1] == "initial_length":
                muscle = getattr(plant.joint, place[0])
                scale = value / muscle.specimen.initial_length
                terms = muscle.specimen.volume_terms and tuple(term * scale for term in muscle.specimen.volume_terms)
                specimen = dataclasses.replace(muscle.specimen, initial_length=value, volume_terms=terms)
                longer = dataclasses.replace(muscle, specimen=specimen)
                plant = dataclasses.replace(plant, joint=dataclasses.replace(plant.joint, **{place[0]: longer}))
            else:
                plant = eqx.tree_at(lambda plant, place=place: reduce(getattr, place, plant.joint), plant, value)
    return plant


def check_lengths(joint: AntagonisticJoint, ranges: Sequence[LengthRange]) -> None:
    """Raise `ParameterError` for a length that a joint lacks, one that is given twice, or a negative one."""
    known = design_lengths(joint)
    signed = {".".join(place) for place, quantity in _lengths(joint.geometry) if quantity.lower < 0}
    places = [place for length in ranges for place in known.get(length.name, ())]
    for length in ranges:
        if length.name not in known:
            message = f"{length.name!r} is not a length of a joint with {type(joint.geometry).__name__}"
            remedy = suggest(length.name, list(known))
            raise ParameterError(message, field="lengths", value=length.name, remedy=remedy)
        if length.lowest < 0 and length.name not in signed:
            message = f"{length.name} is never negative"
            raise ParameterError(message, field="lengths", value=length.lowest, lower=0.0, unit="m")
    if len(set(places)) < len(places):
        remedy = "give each length once; a name such as muscle_length or radius applies to both muscles"
        raise ParameterError("a length is given twice", field="lengths", remedy=remedy)


def _lengths(part: Geometry | eqx.Module) -> Iterator[tuple[Place, Quantity | BoundedInt]]:
    """Location and quantity of each length among the fields of a geometry and its parts."""
    quantities = field_quantities(type(part))
    for name, value in vars(part).items():
        quantity = quantities.get(name)
        if isinstance(value, eqx.Module):
            yield from (((name, *place), found) for place, found in _lengths(value))
        elif quantity and quantity.unit == "m" and value is not None and not isinstance(value, tuple):
            yield (name,), quantity
