"""Planar linkage of a joint: its bodies, pulleys, and the muscles between them, derived from the geometry."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import ArrayLike
from numpy.typing import NDArray

from mckibben.joint.antagonistic import AntagonisticJoint
from mckibben.joint.geometry import Ends, Geometry
from mckibben.joint.load import KneeLoad, Load, PendulumLoad, SlidingMass
from mckibben.joint.slide import Slide
from mckibben.muscle import Specimen
from mckibben.units import deg

Points = NDArray[np.float64]
"""Points (x, y) [m], shape (n, 2); the hinge is at (0, 0), and the angle turns from x to y. A slide begins there."""

SLENDER = 0.07
"""Diameter per length of a drawn muscle of unknown diameter."""
_SWING = 60 * deg  # of the joint, at which the muscles have room
_CLEARANCE = 0.06  # of the length of a muscle, above it
_LIMB = 0.62  # length of the moving limb per height


_NO_WRAP = np.empty((0, 2))


class Strand(NamedTuple):
    """A muscle with its connectors: straight from `start` to `end`, and from there on along a pulley."""

    start: Points
    end: Points
    wrap: Points

    @property
    def length(self) -> float:
        """Length [m] of the straight part."""
        return float(np.linalg.norm(self.end - self.start))

    def body(self, length: float) -> tuple[Points, Points]:
        """Ends of a muscle of a length [m]: in the middle, or above a pulley at the fixed end."""
        along = (self.end - self.start) / self.length
        above = 0.0 if len(self.wrap) else max(self.length - length, 0.0) / 2
        return self.start + above * along, self.start + (above + length) * along


class Bodies(NamedTuple):
    """Lines of the bodies: limbs, carriage and walls; and what muscles are fixed to."""

    thick: list[Points]
    thin: list[Points]


class Linkage:
    """The parts of a geometry in the plane, and of a load with point masses.

    `pivots` are the points of the hinge, of which a slide has none.

    Straight muscles lie between their anchors. Any other path is drawn on a pulley whose radius is the present moment
    arm, with a line of action parallel to the fixed limb. The angles [rad] to be drawn determine its height.
    """

    pivots = np.zeros((1, 2))

    def __init__(self, geometry: Geometry, angles: Sequence[float] = (0.0,), load: Load | None = None) -> None:
        self.geometry = geometry
        limits = geometry.angle_range
        low, high = max(limits[0], -_SWING), min(limits[1], _SWING)
        ends = [None if end is None else np.asarray(end, float) for end in geometry.anchors(min(max(0.0, low), high))]
        self.straight = [end is not None for end in ends]
        anchored = np.sum([end[0] for end in ends if end is not None], axis=0)
        quarter = round(math.atan2(anchored[1], anchored[0]) / (math.pi / 2)) % 4 if np.any(anchored) else 1
        cosine, sine = ((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0))[quarter]
        self.up = np.array([cosine, sine])
        """Direction of the fixed limb from the hinge; the moving limb points the opposite way at 0 deg."""
        self._turn = np.array([[sine, -cosine], [cosine, sine]])  # to this frame, from one with the fixed limb along y
        paths = geometry.path_lengths(np.array([min(low, *angles), max(high, *angles)]))
        self.height = max(
            float(np.max(path)) * (1 + _CLEARANCE) if end is None else float(end[0] @ self.up)
            for end, path in zip(ends, paths, strict=True)
        )
        """Distance [m] of the highest fixed end from the hinge, along the fixed limb."""
        self._masses: list[float] = []
        if isinstance(load, KneeLoad):
            self._masses = [float(load.distance1), float(load.distance2)]
        elif isinstance(load, PendulumLoad):
            self._masses = [float(load.length)]
        self._limb = max([_LIMB * self.height, *(1.1 * at for at in self._masses)])

    def strands(self, angle: float) -> tuple[Strand, Strand]:
        """Return both muscles at an angle [rad]."""
        wraps = self._circles(angle, np.linspace(0, -math.pi / 2, 26))
        first, second = (
            Strand(wrap[0] + self.height * self.up, wrap[0], wrap)
            if ends is None
            else Strand(ends[0], ends[1], _NO_WRAP)
            for ends, wrap in zip(map(_as_points, self.geometry.anchors(angle)), wraps, strict=True)
        )
        return first, second

    def cams(self, angle: float) -> list[Points]:
        """Return the outlines of the pulleys at an angle [rad]; none for straight muscles."""
        circles = self._circles(angle, np.linspace(0, 2 * math.pi, 97))
        return [circle for circle, straight in zip(circles, self.straight, strict=True) if not straight]

    def _circles(self, angle: float, turned: Points) -> list[Points]:
        """Points of both pulleys, turned [rad] from the contact with the line of action away from the fixed limb."""
        arms, circle = map(float, self.geometry.moment_arms(angle)), np.column_stack([np.cos(turned), np.sin(turned)])
        return [arm * circle * (side, 1) @ self._turn for side, arm in zip((-1, 1), arms, strict=True)]

    def limb(self, angle: float, distance: float) -> Points:
        """Return the point of the moving limb at a distance [m] from the hinge."""
        cosine, sine = math.cos(angle), math.sin(angle)
        return -distance * np.array([cosine * self.up[0] - sine * self.up[1], sine * self.up[0] + cosine * self.up[1]])

    def moving(self, angle: float) -> Points:
        """Return the line of the moving body at an angle [rad]."""
        return np.array([np.zeros(2), self.limb(angle, self._limb)])

    def tip(self, angle: float) -> Points:
        """Return the point at which the moving body is held at an angle [rad]."""
        return self.limb(angle, self._limb)

    def masses(self, angle: float) -> Points:
        """Return the load's point masses at an angle [rad]."""
        return np.array([self.limb(angle, at) for at in self._masses]).reshape(-1, 2)

    def bodies(self, angle: float) -> Bodies:
        """Return the lines of all bodies at an angle [rad]."""
        strands, top = self.strands(angle), self.height * self.up
        levers = [
            np.array([strand.end, np.zeros(2)]) for strand, is_one in zip(strands, self.straight, strict=True) if is_one
        ]
        beam = np.array([strands[0].start, top, strands[1].start])
        return Bodies([np.array([np.zeros(2), top]), self.moving(angle)], [beam, *levers])


class SlideLinkage:
    """A carriage between two walls, each with a muscle, along an axis that may be inclined."""

    pivots = np.empty((0, 2))
    up = np.array([0.0, 1.0])

    def __init__(self, geometry: Slide, positions: Sequence[float] = (0.0,), load: Load | None = None) -> None:
        self.geometry = geometry
        lengths = geometry.rest_length1, geometry.rest_length2
        whole = sum(float(length) for length in lengths if length is not None)
        self._half = SLENDER * whole  # of the carriage's length
        reach = self._half + max(map(abs, positions))
        first, second = (2 * reach if length is None else self._half + float(length) for length in lengths)
        self._walls, self._present = (-first, second), [length is not None for length in lengths]
        self.height = first + second
        """Distance [m] of the walls."""
        incline = float(load.incline) if isinstance(load, SlidingMass) else 0.0
        self.along = np.array([math.cos(incline), math.sin(incline)])
        """Direction of growing positions."""

    def _at(self, position: float, across: float = 0.0) -> Points:
        return position * self.along + across * np.array([-self.along[1], self.along[0]])

    def strands(self, position: float) -> tuple[Strand | None, Strand | None]:
        """Return both muscles at a position [m]; None for no muscle."""
        first, second = (
            Strand(self._at(wall), self._at(position + side * self._half), _NO_WRAP) if present else None
            for wall, side, present in zip(self._walls, (-1, 1), self._present, strict=True)
        )
        return first, second

    def cams(self, position: float) -> list[Points]:
        """Return no outlines: muscles of a slide are straight."""
        return []

    def moving(self, position: float) -> Points:
        """Return the outline of the carriage at a position [m]."""
        h = self._half
        corners = ((-h, -h), (h, -h), (h, h), (-h, h), (-h, -h))
        return np.array([self._at(position + along, across) for along, across in corners])

    def tip(self, position: float) -> Points:
        """Return the point at which the carriage is held at a position [m]."""
        return self._at(position)

    def masses(self, position: float) -> Points:
        """Return no point masses: the carriage is the mass."""
        return np.empty((0, 2))

    def bodies(self, position: float) -> Bodies:
        """Return the lines of all bodies at a position [m]."""
        high = 2 * self._half
        walls = [
            np.array([self._at(wall, -high), self._at(wall, high)])
            for wall, present in zip(self._walls, self._present, strict=True)
            if present
        ]
        rail = np.array([self._at(wall, -1.6 * self._half) for wall in self._walls])
        return Bodies([*walls, self.moving(position)], [rail])


def linkage_of(
    geometry: Geometry, angles: Sequence[float] = (0.0,), load: Load | None = None
) -> Linkage | SlideLinkage:
    """Return the linkage of a joint for drawings at angles [rad], or at positions [m] of a slide.

    >>> carriage = linkage_of(Slide("150 mm", "165 mm"), (0.0, 0.004))
    >>> [round(strand.length, 6) for strand in carriage.strands(0.004)]
    [0.154, 0.161]
    """
    return SlideLinkage(geometry, angles, load) if isinstance(geometry, Slide) else Linkage(geometry, angles, load)


def _as_points(ends: Ends | None) -> Points | None:
    return None if ends is None else np.asarray(ends, float)


def muscle_sizes(
    joint: AntagonisticJoint, contractions: Iterable[ArrayLike]
) -> tuple[list[Points], list[Points | None]]:
    """Lengths [m] and diameters [m] of the muscles at pairs of contractions; None for an unknown volume."""
    pairs = zip(joint.muscles, contractions, strict=True)
    sizes = [specimen_size(muscle.specimen, contraction) for muscle, contraction in pairs]
    return [length for length, _ in sizes], [diameter for _, diameter in sizes]


def specimen_size(specimen: Specimen, contraction: ArrayLike) -> tuple[Points, Points | None]:
    """Length [m], and diameter [m] of the cylinder of that length and volume; None for an unknown volume.

    >>> from mckibben import catalog
    >>> length, diameter = specimen_size(catalog.specimen("MAS-10-180N-AA-MC-O"), 0.0)
    >>> float(length), round(float(diameter), 6)
    (0.18, 0.01)
    """
    length = np.asarray(specimen.length_at(contraction), float)
    if not specimen.has_volume:
        return length, None
    volume = np.asarray(specimen.volume(contraction), float)
    return length, np.sqrt(np.maximum(4 * volume / (np.pi * length), 0.0))
