"""Planar mechanism of a joint: anchors, cams, and the muscles between them, derived from the geometry."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from jaxtyping import ArrayLike
from numpy.typing import NDArray

from mckibben.joint.antagonistic import AntagonisticJoint
from mckibben.joint.geometry import Geometry, Pair
from mckibben.muscle import Specimen
from mckibben.numerics.calculus import value_and_derivative
from mckibben.numerics.compiled import jit
from mckibben.units import deg

Points = NDArray[np.float64]
"""Points (x, y) [m], shape (n, 2); the hinge is at (0, 0), and the angle turns from x to y."""

SLENDER = 0.07
"""Diameter per length of a drawn muscle of unknown diameter."""
_SWING = 60 * deg  # of the drawn part of a cam
_BEYOND = np.linspace(0, 35 * deg, 26)[1:]  # of the arc of a circle that follows
_CLEARANCE = 0.06  # of the length of a muscle, above it


_NO_WRAP = np.empty((0, 2))


class Strand(NamedTuple):
    """A muscle with its connectors: straight from `start` to `end`, and from there on along a cam to its anchor."""

    start: Points
    end: Points
    wrap: Points

    @property
    def length(self) -> float:
        """Length [m] of the straight part."""
        return float(np.linalg.norm(self.end - self.start))

    def body(self, length: float) -> tuple[Points, Points]:
        """Ends of a muscle of a length [m]: in the middle, or above a cam at the fixed end."""
        along = (self.end - self.start) / self.length
        above = 0.0 if len(self.wrap) else max(self.length - length, 0.0) / 2
        return self.start + above * along, self.start + (above + length) * along


class Mechanism:
    """The parts of a geometry in the plane.

    Straight muscles lie between their anchors. Any other path is drawn as the cam with its moment arms: a line of
    action parallel to the fixed limb touches the cam, at the distance of the moment arm from the hinge. A pulley is a
    round cam. The angles [rad] to be drawn determine the extent of cams.
    """

    def __init__(self, geometry: Geometry, angles: tuple[float, ...] = (0.0,)) -> None:
        self.geometry = geometry
        known = geometry.angle_range
        low, high = max(known[0], -_SWING), min(known[1], _SWING)
        grid = np.linspace(min(low, *angles), max(high, *angles), 241)
        ends = [None if end is None else np.asarray(end, float) for end in geometry.anchors(min(max(0.0, low), high))]
        self.straight = [end is not None for end in ends]
        anchored = np.sum([end[0] for end in ends if end is not None], axis=0)
        quarter = round(math.atan2(anchored[1], anchored[0]) / (math.pi / 2)) % 4 if np.any(anchored) else 1
        cosine, sine = ((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0))[quarter]
        self.up = np.array([cosine, sine])
        """Direction of the fixed limb from the hinge; the moving limb points the opposite way at 0 deg."""
        self._turn = np.array([[sine, -cosine], [cosine, sine]])  # to this frame, from one with the fixed limb along y
        (paths, arms), (_, slopes) = _profiles(geometry, grid)
        self._cams = [
            _Cam(side * grid, np.asarray(arm, float), side * np.asarray(slope, float))
            for side, arm, slope in zip((-1, 1), arms, slopes, strict=True)
        ]
        self.height = max(
            float(end[0] @ self.up)
            if end is not None
            else float(np.max(path)) * (1 + _CLEARANCE) - float(cam.slopes.min())
            for end, path, cam in zip(ends, paths, self._cams, strict=True)
        )
        """Distance [m] of the highest fixed end from the hinge, along the fixed limb."""

    def strands(self, angle: float) -> tuple[Strand, Strand]:
        """Return both muscles at an angle [rad]."""
        first, second = (
            self._on_cam(index, angle) if ends is None else Strand(np.asarray(ends[0]), np.asarray(ends[1]), _NO_WRAP)
            for index, ends in enumerate(self.geometry.anchors(angle))
        )
        return first, second

    def _on_cam(self, index: int, angle: float) -> Strand:
        side = 2 * index - 1
        wrap = self._cams[index].surface(side * angle, wrapped=True) * (side, 1)
        start = np.array([wrap[0, 0], self.height])
        return Strand(start @ self._turn, wrap[0] @ self._turn, wrap @ self._turn)

    def cams(self, angle: float) -> list[Points]:
        """Return the outlines of the cams at an angle [rad]; none for straight muscles."""
        sides = [
            (cam, side) for cam, side, straight in zip(self._cams, (-1, 1), self.straight, strict=True) if not straight
        ]
        return [np.vstack([cam.surface(side * angle) * (side, 1), (0, 0)]) @ self._turn for cam, side in sides]

    def limb(self, angle: float, distance: float) -> Points:
        """Return the point of the moving limb at a distance [m] from the hinge."""
        cosine, sine = math.cos(angle), math.sin(angle)
        return -distance * np.array([cosine * self.up[0] - sine * self.up[1], sine * self.up[0] + cosine * self.up[1]])


@jit
def _profiles(geometry: Geometry, angles: ArrayLike) -> tuple[tuple[Pair, Pair], tuple[Pair, Pair]]:
    """Paths and moment arms over angles [rad], and their derivatives; compiled once per kind of geometry."""
    return value_and_derivative(geometry.paths_and_arms, angles)


class _Cam:
    """Cam on the side of muscle 2, turned by an angle that shortens its muscle; the line of action is along y."""

    # The moment arm is the support function of the profile, the envelope of the lines of action. If it is not convex,
    # no cam has these arms, and a circle with the current arm is drawn.

    def __init__(self, angles: Points, arms: Points, slopes: Points) -> None:
        order = np.argsort(angles)
        self.angles, self.arms, self.slopes = angles[order], arms[order], slopes[order]
        self.radii = self.arms + np.gradient(self.slopes, self.angles)  # of curvature
        self.convex = bool((self.radii > 0).all())

    def _beyond(self, end: int, by: Points) -> tuple[Points, Points]:
        """Arms and slopes beyond an end, where the profile continues as a circular arc."""
        radius = min(self.radii[end], self.arms[end])
        along, across = self.arms[end] - radius, self.slopes[end]
        cosine, sine = np.cos(by), np.sin(by)
        return radius + along * cosine + across * sine, across * cosine - along * sine

    def surface(self, turned: float, *, wrapped: bool = False) -> Points:
        """Points of the profile turned by an angle [rad]; if wrapped only, from the contact on."""
        ends = [(0, -_BEYOND[::-1]), (-1, _BEYOND)]
        at = np.concatenate([[turned], self.angles[self.angles > turned]]) if wrapped else self.angles
        arms, slopes = np.interp(at, self.angles, self.arms), np.interp(at, self.angles, self.slopes)
        below, above = (self._beyond(end, by) for end, by in ends)
        arms, slopes = (np.concatenate(parts) for parts in zip(below, (arms, slopes), above, strict=True))
        normals = turned - np.concatenate([self.angles[0] + ends[0][1], at, self.angles[-1] + _BEYOND])
        if not self.convex:
            arms, slopes = np.full_like(arms, np.interp(turned, self.angles, self.arms)), np.zeros_like(arms)
        cosine, sine = np.cos(normals), np.sin(normals)
        points = np.column_stack([arms * cosine + slopes * sine, arms * sine - slopes * cosine])
        return points[len(_BEYOND) :] if wrapped else points


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
