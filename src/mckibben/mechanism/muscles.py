"""Muscles of a robot and their paths: a pair over a joint, or one over joints and through points of bodies."""

from __future__ import annotations

import abc
import functools
from collections.abc import Callable, Sequence
from numbers import Real
from typing import Any, ClassVar, Literal, NamedTuple

import equinox as eqx
import numpy as np
from jaxtyping import Array, ArrayLike

from mckibben.component.base import Component, once
from mckibben.errors import RangeError
from mckibben.joint import AntagonisticJoint, Geometry, MusclePath, RigidTendon, Tendon
from mckibben.joint.route import Bends, Route, pair_routes
from mckibben.mechanism.bodies import Joint, PathElement
from mckibben.mechanism.tree import Frame, TreeHinge
from mckibben.mechanism.wrapping import check_path, path_along
from mckibben.muscle import Muscle
from mckibben.numerics.calculus import value_and_derivative
from mckibben.numerics.spatial import total
from mckibben.units import Coordinate

Action = Literal["lengthens", "shortens"]
"""Change of a muscle's path as the angle of a joint increases."""


class Skeleton(NamedTuple):
    """Joints and frames by name, and how to find hinges and frames in the posture in which muscles are routed."""

    joints: Sequence[Joint]
    frame_names: Sequence[str]
    angles: Sequence[ArrayLike]
    posed: Callable[[], tuple[list[TreeHinge], list[Frame]]]

    def number(self, name: str) -> int:
        """Return the number of a joint."""
        return [joint.name for joint in self.joints].index(name)

    def path_along(self, elements: Sequence[PathElement]) -> tuple[Array, dict[int, Array], Callable[[], Bends]]:
        """Return the length [m] of a path, and its derivatives [m/rad] by the number of the joint."""
        length, slopes, bends = path_along(elements, self.frame_names, *self.posed())

        def by_joints() -> Bends:
            return {(i - 1, j - 1): bend for (i, j), bend in bends().items()}

        return length, {body - 1: slope for body, slope in slopes.items()}, by_joints


class TendonParts(NamedTuple):
    """Parts of a path: paths over joints, points and surfaces, and what is taken from its length [m]."""

    over: tuple[OverJoint, ...]
    through: tuple[PathElement, ...]
    connector_length: float


class MuscleUnit(Component):
    """A muscle with its path, or a pair of muscles over a joint.

    `pair` and `tendon_parts` describe what `routed` computes, for joints and other simulators. A subclass with its own
    `routed` has neither of them, unless it gives its own.
    """

    def __init_subclass__(cls) -> None:
        super().__init_subclass__()
        for name in {"pair", "tendon_parts"} - vars(cls).keys() if "routed" in vars(cls) else ():
            setattr(cls, name, vars(MuscleUnit)[name])

    @property
    def pair(self) -> AntagonisticJoint | None:
        """The muscles as a joint, if they are a pair over one; None by default."""
        return None

    @property
    def tendon_parts(self) -> TendonParts | None:
        """Parts whose lengths add up to the path; None by default."""
        return None

    @classmethod
    def from_file(cls, value: object) -> object:
        """Return a section with its class: a pair has a geometry."""
        if not isinstance(value, dict) or "class" in value:
            return value
        return {"class": "pair" if "geometry" in value else "path", **value}

    @classmethod
    def to_file(cls, section: dict[str, object]) -> dict[str, object]:
        """Return a section without its class."""
        return {name: field for name, field in section.items() if name != "class"}

    @property
    @abc.abstractmethod
    def names(self) -> tuple[str, ...]:
        """Names of the muscles."""

    @property
    @abc.abstractmethod
    def muscles(self) -> tuple[Muscle, ...]:
        """The muscles."""

    @property
    @abc.abstractmethod
    def joint_names(self) -> tuple[str, ...]:
        """Names of the joints that `over` gives."""

    @property
    def elements(self) -> tuple[PathElement, ...]:
        """Points, surfaces and pulleys of its path."""
        return ()

    @abc.abstractmethod
    def routed(self, skeleton: Skeleton) -> Sequence[Route]:
        """Return the muscles in a posture."""

    @property
    @abc.abstractmethod
    def angle_ranges(self) -> tuple[tuple[float, float], ...]:
        """Angles [rad] of each of these joints between which the path over it is known."""


class MusclePair(MuscleUnit):
    """Antagonistic muscles over a joint: its name with 1, which lengthens as the angle increases, and with 2.

    Parameters
    ----------
    over
        Name of the joint.
    geometry
        Path lengths of both muscles over the angle.
    muscle1, muscle2, tendon
        The muscles; in files also `muscle`, for both.
    """

    short_name = "pair"
    aliases: ClassVar = {"muscle": ("muscle1", "muscle2")}

    over: str = eqx.field(static=True)
    geometry: Geometry
    muscle1: Muscle
    muscle2: Muscle
    tendon: Tendon = RigidTendon()

    @once
    def pair(self) -> AntagonisticJoint:
        return AntagonisticJoint(self.geometry, self.muscle1, self.muscle2, self.tendon)

    @property
    def names(self) -> tuple[str, ...]:
        return f"{self.over}1", f"{self.over}2"

    @property
    def muscles(self) -> tuple[Muscle, ...]:
        return self.muscle1, self.muscle2

    @property
    def joint_names(self) -> tuple[str, ...]:
        return (self.over,)

    def routed(self, skeleton: Skeleton) -> Sequence[Route]:
        index = skeleton.number(self.over)
        return pair_routes(self.geometry, (self.muscle1, self.muscle2), self.tendon, skeleton.angles[index], index)

    @property
    def angle_ranges(self) -> tuple[tuple[float, float], ...]:
        return (self.geometry.angle_range,)


class OverJoint(Component):
    """Path over a joint.

    Parameters
    ----------
    joint
        Name of the joint.
    action
        Whether it "lengthens" or "shortens" as the angle of the joint increases.
    path
        Length over the angle of the joint.
    """

    joint: str = eqx.field(static=True)
    action: Action = eqx.field(static=True)
    path: MusclePath

    @property
    def side(self) -> int:
        """1 where it lengthens as the angle increases, else -1."""
        return 1 if self.action == "lengthens" else -1

    def length(self, angle: ArrayLike) -> tuple[Array, Array]:
        """Return its length [m], and the derivative of that [m/rad]."""
        return value_and_derivative(lambda x: self.path.length(x, self.side), angle)


class PathMuscle(MuscleUnit):
    """Muscle over joints and through points of bodies: its path is the sum of the paths over each joint and of the
    lines from point to point, straight or around a surface between them.

    Parameters
    ----------
    name
        Name in results and errors.
    muscle
        The muscle.
    over
        Paths over joints.
    through
        Points from one end to the other, spheres and cylinders that the path touches between two of them, and pulleys.
    connector_length
        Length of the connectors in series with the muscle [m]; below 0 for a muscle that is longer than its path.
    tendon
        Element in series. Default: rigid.
    """

    short_name = "path"

    name: str = eqx.field(static=True)
    muscle: Muscle
    over: tuple[OverJoint, ...] = ()
    through: tuple[PathElement, ...] = ()
    connector_length: Coordinate = 0.0
    tendon: Tendon = RigidTendon()

    def __check_init__(self) -> None:
        super().__check_init__()
        self.muscle.check_pressure_limit()
        if self.through:
            check_path(self.name, self.through)
        elif not self.over:
            remedy = "give points that it goes `through`, or paths `over` joints"
            raise RangeError(f"{self.name}: it has no path", field="through", remedy=remedy)

    @property
    def names(self) -> tuple[str, ...]:
        return (self.name,)

    @property
    def muscles(self) -> tuple[Muscle, ...]:
        return (self.muscle,)

    @property
    def joint_names(self) -> tuple[str, ...]:
        return tuple(part.joint for part in self.over)

    @property
    def elements(self) -> tuple[PathElement, ...]:
        return self.through

    @property
    def tendon_parts(self) -> TendonParts:
        return TendonParts(self.over, self.through, self.connector_length)

    def routed(self, skeleton: Skeleton) -> Sequence[Route]:
        over = [(skeleton.number(part.joint), part) for part in self.over]
        lengths = {index: part.length(skeleton.angles[index]) for index, part in over}
        slopes: dict[int, Any] = {index: slope for index, (_, slope) in lengths.items()}
        length: Any = functools.reduce(total, (own for own, _ in lengths.values()), 0.0)
        straight: Callable[[], Bends] = dict
        if self.through:
            lines, by_joint, straight = skeleton.path_along(self.through)
            length = total(length, lines)
            for joint, slope in by_joint.items():
                slopes[joint] = total(slopes.get(joint, 0.0), slope)

        def bends() -> Bends:
            found = dict(straight())
            for index, part in over:
                bend = value_and_derivative(lambda x, part=part: part.length(x)[1], skeleton.angles[index])[1]
                found[index, index] = total(found.get((index, index), 0.0), bend)
            return found

        return [Route(self.muscle, self.tendon, length - self.connector_length, slopes, bends)]

    @property
    def angle_ranges(self) -> tuple[tuple[float, float], ...]:
        return tuple(part.path.angle_range for part in self.over)


def check_contractions(
    owner: str, muscle: Muscle, paths: ArrayLike, places: Sequence[str], field: str = "muscle"
) -> None:
    """Raise where a path of a muscle is longer or shorter than its domain permits."""
    domain = muscle.domain
    numbers = muscle.specimen.initial_length, domain.contraction_min, domain.contraction_max
    if not all(isinstance(one, Real) for one in numbers):
        return
    try:
        contractions = np.asarray(muscle.specimen.contraction_at(paths), float)
    except (TypeError, ValueError):  # of a geometry with many values
        return
    lower, upper = domain.contraction_min, domain.contraction_max
    for place, contraction in zip(places, contractions, strict=True):
        if not lower - 1e-9 <= contraction <= upper + 1e-9:
            long = contraction < lower
            raise RangeError(
                f"{owner}: at {place} its contraction is {contraction * 100:.3g} %: the muscle is too "
                f"{'short' if long else 'long'} for its path",
                field=field,
                value=float(contraction),
                lower=float(lower),
                upper=float(upper),
                unit="1",
                remedy="reduce the range of the joint, or "
                + ("lengthen the connectors or the muscle" if long else "shorten the connectors or the muscle"),
            )
