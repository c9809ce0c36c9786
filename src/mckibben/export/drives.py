"""Muscles as actuators of another simulator: what each drives, and the functions of their forces."""

from __future__ import annotations

import cmath
import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, PyTree

from mckibben.actuator.base import state_of_muscle
from mckibben.codegen.source_module import SourceModule
from mckibben.export.muscle_plugin import MuscleFunctions, is_filter
from mckibben.joint import Geometry, MusclePath, Tendon
from mckibben.joint.geometry import Ends
from mckibben.muscle import Muscle
from mckibben.numerics.calculus import value_and_derivative
from mckibben.numerics.compiled import numeric

_COMPARED = -0.4, -0.1, 0.2, 0.5  # rad
_SAME = 1e-9  # m

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

    def length(self, angle: float) -> float:
        """Length [m] of the path at an angle [rad] of the joint."""
        straight = (
            abs(complex(*self.points[0]) - complex(*self.points[1]) * cmath.exp(1j * angle)) if self.points else 0
        )
        return self.offset + self.coefficient * angle + straight


def transmissions(geometry: Geometry) -> tuple[Transmission, ...]:
    """Transmissions of both muscles of a geometry."""
    ends = geometry.anchors(0.0)
    return tuple(_transmission(lambda x, i=i: geometry.path_lengths(x)[i], ends[i]) for i in (0, 1))


def path_transmission(path: MusclePath, side: int) -> Transmission:
    """Transmission over a path; `side` is the sign of its moment arm."""
    return _transmission(lambda angle: path.length(angle, 1 if side > 0 else -1), path.anchors(0.0))


def _transmission(length: Callable[[ArrayLike], Array], ends: Ends | None) -> Transmission:
    """Transmission of a path by its length [m] over the angle [rad], and its ends at the angle 0 if it is straight.

    Neither points nor coefficient if a straight line between the ends, or on a pulley, has another length.
    """
    start, slope = (float(value) for value in value_and_derivative(length, jnp.zeros(())))
    moved = Transmission(start, coefficient=slope)
    if ends is not None:
        fixed, moving = ((float(x), float(y)) for x, y in ends)
        moved = Transmission(start - math.dist(fixed, moving), (fixed, moving))
    same = all(math.isclose(moved.length(angle), float(length(angle)), abs_tol=_SAME) for angle in _COMPARED)
    return moved if same else Transmission()


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
