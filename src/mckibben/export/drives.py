"""Muscles as actuators of another simulator: what each drives, and the functions of their forces."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import equinox as eqx
from jaxtyping import Array, PyTree

from mckibben.actuator.base import state_of_muscle
from mckibben.codegen.source_module import SourceModule
from mckibben.export.muscle_plugin import MuscleFunctions, is_filter
from mckibben.joint import Geometry, KneeGeometry, PairedPaths, Pulley, Tendon, TwoBonePath
from mckibben.muscle import Muscle
from mckibben.numerics.compiled import numeric

Place = tuple[float, float]
"""Point [m] in the plane of a joint."""


class Transmission(NamedTuple):
    """Transmission of a muscle; without points and coefficient it drives the joint: its length is the angle.

    Attributes
    ----------
    offset
        Path length in excess of the tendon [m].
    points
        Ends of a straight tendon, on the fixed and on the moving body [m].
    coefficient
        Length per angle [m/rad], in place of points.
    """

    offset: float = 0.0
    points: tuple[Place, ...] = ()
    coefficient: float = 0.0

    @property
    def has_tendon(self) -> bool:
        """Whether it is a tendon, or else drives the joint."""
        return bool(self.points or self.coefficient)


def transmissions(geometry: Geometry) -> tuple[Transmission, Transmission]:
    """Transmissions of both muscles of a geometry."""
    if isinstance(geometry, KneeGeometry):
        height, radius = float(geometry.joint_length), float(geometry.joint_radius)
        offset = -float(geometry.connector_length)
        first, second = (Transmission(offset, ((x, height), (x, 0.0))) for x in (-radius, radius))
        return first, second
    if isinstance(geometry, PairedPaths):
        return path_transmission(geometry.path1, 1), path_transmission(geometry.path2, -1)
    return Transmission(), Transmission()


def path_transmission(path: object, side: int) -> Transmission:
    """Transmission over a path; `side` is the sign of its moment arm."""
    if isinstance(path, TwoBonePath):
        fixed, moving = (path.proximal_x, path.proximal_y), (path.distal_x, path.distal_y)
        points = tuple((float(x), float(y)) for x, y in (fixed, moving))
        return Transmission(-float(path.connector_length), points)
    if isinstance(path, Pulley):
        return Transmission(float(path.rest_length), coefficient=float(side * path.radius))
    return Transmission()


class Drive(NamedTuple):
    """A muscle: its name, its index in a plant, and the muscle with its path there.

    Attributes
    ----------
    muscle
        Muscle and tendon of a plant.
    path
        Length [m] of the path, of a plant at a length of its tendon or at an angle.
    joint
        Name of the joint that it drives; empty for a tendon.
    """

    name: str
    index: int
    muscle: Callable[[PyTree], tuple[Muscle, Tendon]]
    path: Callable[[PyTree, Array], Array]
    joint: str = ""


def muscle_drive(
    name: str, index: int, unit_of: Callable[[PyTree], PyTree], place: int, offset: float, joint: str = ""
) -> Drive:
    """Drive of a muscle of a unit.

    Parameters
    ----------
    unit_of, place
        Selection of the unit, which has `muscles`, `tendon` and possibly `geometry`, from a plant; and the place of the
        muscle in it.
    offset
        Path length in excess of the tendon [m].
    joint
        Name of the joint that it drives in place of a tendon.
    """

    def muscle(plant: PyTree) -> tuple[Muscle, Tendon]:
        unit = unit_of(plant)
        return unit.muscles[place], unit.tendon

    def path(plant: PyTree, length: Array) -> Array:
        return unit_of(plant).geometry.path_lengths(length)[place] if joint else length + offset

    return Drive(name, index, muscle, path, joint)


def muscle_functions(
    plant: PyTree, name: str, drives: Sequence[Drive], start: PyTree
) -> tuple[SourceModule, list[MuscleFunctions]]:
    """The functions of all muscles of a plant in a module.

    Parameters
    ----------
    start
        State of the plant at the start.
    """
    numbers, fixed = eqx.partition(numeric(plant), eqx.is_inexact_array_like)
    module, functions = SourceModule(name, {"plant": numbers}, "plant."), []
    for number, drive in enumerate(drives, 1):
        state = start.muscles[drive.index], start.pressures[drive.index], state_of_muscle(start.air, drive.index)
        filtered = is_filter(plant.valve.for_muscle(drive.index))
        functions.append(MuscleFunctions(fixed, number, drive.muscle, drive.path, state, filtered))
        functions[-1].add_to(module)
    return module, functions
