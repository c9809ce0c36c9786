"""Robot: trunk, links in a tree of joints, and muscles: pairs of joints, over two joints, or through points."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from numbers import Real
from typing import Annotated, Any, Literal, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from mckibben import catalog
from mckibben.component.base import Component
from mckibben.component.checks import check_count
from mckibben.config.model import fail_validation, with_changes
from mckibben.errors import McKibbenError, RangeError, quoted, suggest
from mckibben.joint import AntagonisticJoint, MusclePath, RigidTendon, Tendon
from mckibben.muscle import Muscle
from mckibben.numerics.calculus import value_and_derivative
from mckibben.numerics.spatial import IDENTITY, ZERO, Vector, unit_vector
from mckibben.plant.joint_friction import JointFriction
from mckibben.plant.sensors import Disturbance, NoDisturbance
from mckibben.robot.bodies import Link, Trunk
from mckibben.robot.tree import Frame, Hinge, frames_of, path_through
from mckibben.units import Angle, Coordinate, Damping, Distance, Inertia, Quantity, StiffnessScale, deg

Direction = Annotated[float, Quantity("1", "1", -1, 1)]
StopDamping = Annotated[float, Quantity("s/rad", "s/rad", 0, 1e3)]

Scalar = Float[Array, ""]

Action = Literal["lengthens", "shortens"]
"""Change of a muscle's path as the angle of a joint increases."""


class Joint(Component):
    """Hinge between a link and the one above it.

    Parameters
    ----------
    lower, upper
        Range of the angle [rad]; beyond it stops act.
    muscles
        Pair of muscles with their geometry. Default: none, so that other muscles move the joint.
    link_angle
        Angle [rad] of the link from the line of the one above, at the angle 0 of the joint; positive forwards.
    forward
        Whether the link swings forwards, or turns about `axis`, as the angle increases; otherwise the opposite.
    damping
        Viscous damping [N*m*s/rad].
    stop_stiffness, stop_damping
        Stops: k [N*m/rad] and c [s/rad] in the torque k d (1 + c d') at a depth d [rad], never pulling.
    locked
        Angle [rad] at which the joint is locked. Default: movable.
    name
        Name in results and errors.
    friction
        Friction of the joint itself. Default: none.
    disturbance
        External torque on the joint over time.
    axis
        Direction about which the link turns by `link_angle` and, if `forward`, by the angle (right-hand rule), in the
        axes of the body above: x forwards, y to the left, z up along it. Default: (0, -1, 0), the forward swing. About
        (1, 0, 0) the link swings to the left.
    parent
        Name of the joint above, whose link carries this one, or "trunk". Default: the joint before, the trunk for the
        first.
    place
        Point of the link above [m], in its own axes: x forwards, y to the left, z up along it. Default: its lower end.
    rotor_inertia
        Inertia that turns with the joint alone [kg*m^2]. Default: none.
    """

    lower: Angle
    upper: Angle
    muscles: AntagonisticJoint | None = None
    link_angle: Angle = 0.0
    forward: bool = eqx.field(static=True, default=True)
    damping: Damping = 0.0
    stop_stiffness: StiffnessScale = 1000.0
    stop_damping: StopDamping = 0.2
    locked: Angle | None = None
    name: str = eqx.field(static=True, default="joint")
    friction: JointFriction | None = eqx.field(kw_only=True, default=None)
    disturbance: Disturbance = eqx.field(kw_only=True, default=NoDisturbance())
    axis: tuple[Direction, ...] = eqx.field(kw_only=True, static=True, default=(0.0, -1.0, 0.0))
    parent: str | None = eqx.field(kw_only=True, static=True, default=None)
    place: tuple[Coordinate, ...] | None = eqx.field(kw_only=True, default=None)
    rotor_inertia: Inertia | None = eqx.field(kw_only=True, default=None)

    def __check_init__(self) -> None:
        super().__check_init__()
        if self.place is not None:
            check_point(self.name, "place", self.place)
        if len(self.axis) != 3 or not any(self.axis):
            raise RangeError(
                f"{self.name}: the axis is {', '.join(f'{one:g}' for one in self.axis)}",
                field="axis",
                value=self.axis,
                remedy="give a direction in space, such as [1, 0, 0] for a swing to the side",
            )
        if not all(isinstance(one, Real) for one in (self.lower, self.upper)):
            return
        if not self.lower < self.upper:
            raise RangeError(
                f"{self.name}: the range of the angle is {self.lower / deg:g}..{self.upper / deg:g} deg",
                field="upper",
                value=self.upper,
                lower=self.lower,
                unit="rad",
                remedy="give the lower angle first",
            )
        if isinstance(self.locked, Real) and not self.lower <= self.locked <= self.upper:
            raise RangeError(
                f"{self.name}: it is locked at {self.locked / deg:g} deg, beyond its range",
                field="locked",
                value=self.locked,
                lower=self.lower,
                upper=self.upper,
                unit="rad",
                remedy="lock it within its range",
            )
        if self.muscles is not None:
            _check_paths(self.name, self.muscles, self.lower, self.upper)

    @property
    def sign(self) -> int:
        """1 where the link turns about its axis as the angle increases, else -1."""
        return 1 if self.forward else -1

    @property
    def pair(self) -> AntagonisticJoint:
        """Its pair of muscles; `RangeError` without one."""
        if self.muscles is None:
            remedy = "give it `muscles`, or name a joint that has a pair"
            raise RangeError(f"{self.name}: it has no pair of muscles", field="muscles", remedy=remedy)
        return self.muscles

    @property
    def direction(self) -> Vector:
        """The axis as a unit vector."""
        return unit_vector(self.axis)


class BiarticularMuscle(Component):
    """Muscle over two joints, through a point of the link between them: its length is the sum of two paths.

    Parameters
    ----------
    muscle
        The muscle.
    path1, path2
        Path over each joint; the sum of both is the length of the muscle.
    joint1, joint2
        Names of its joints.
    action1, action2
        Whether it "lengthens" or "shortens" as the angle of that joint increases.
    """

    muscle: Muscle
    path1: MusclePath
    path2: MusclePath
    joint1: str = eqx.field(static=True)
    joint2: str = eqx.field(static=True)
    action1: Action = eqx.field(static=True)
    action2: Action = eqx.field(static=True)
    name: str = eqx.field(static=True, default="biarticular")

    def __check_init__(self) -> None:
        super().__check_init__()
        self.muscle.check_pressure_limit()

    @property
    def sides(self) -> tuple[int, int]:
        """Side of the path over each joint: 1 where it lengthens as the angle increases, else -1."""
        return 1 if self.action1 == "lengthens" else -1, 1 if self.action2 == "lengthens" else -1

    def parts(self, angle1: ArrayLike, angle2: ArrayLike) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
        """Return the length [m] of the path over each joint, and its derivative [m/rad]."""
        side1, side2 = self.sides
        return (
            value_and_derivative(lambda x: self.path1.length(x, side1), angle1),
            value_and_derivative(lambda x: self.path2.length(x, side2), angle2),
        )


class BodyPoint(Component):
    """Point of a body.

    Parameters
    ----------
    body
        "trunk", or the name of the joint whose link it is.
    place
        Coordinates [m] in the axes of the body, from the hip or from that joint: x forwards, y to the left, z up along
        it.
    """

    body: str = eqx.field(static=True)
    place: tuple[Coordinate, ...]

    def __check_init__(self) -> None:
        super().__check_init__()
        check_point(self.body, "place", self.place)


class SpanningMuscle(Component):
    """Muscle along straight lines through points of bodies, whatever joints are between them.

    Parameters
    ----------
    muscle
        The muscle.
    through
        Points, from one end to the other; successive ones are of different bodies.
    connector_length
        Length of the connectors in series with the muscle [m]; below 0 for a muscle that is longer than its path.
    tendon
        Element in series. Default: rigid.
    """

    muscle: Muscle
    through: tuple[BodyPoint, ...]
    connector_length: Coordinate = 0.0
    tendon: Tendon = RigidTendon()
    name: str = eqx.field(static=True, default="spanning")

    def __check_init__(self) -> None:
        super().__check_init__()
        self.muscle.check_pressure_limit()
        bodies = [point.body for point in self.through]
        if len(bodies) < 2 or any(first == second for first, second in itertools.pairwise(bodies)):
            raise RangeError(
                f"{self.name}: it passes through {', '.join(bodies) or 'no body'}",
                field="through",
                value=bodies,
                remedy="give two points or more, successive ones of different bodies",
            )


class RoutedMuscle(NamedTuple):
    """A muscle in the robot: its path length [m], and the derivative [m/rad] of that over the angles of its joints."""

    muscle: Muscle
    tendon: Tendon
    path: Array
    slopes: dict[int, Array]


class Robot(Component):
    """Robot: a trunk, and a tree of links, each on a joint.

    x is forwards, y to the left, and z up. A link with the angle 0 hangs below the one above. All sequences over joints
    begin at the trunk; those over muscles have muscles 1 and 2 of each joint with a pair, then the biarticular and the
    spanning ones. A robot whose joints all swing forwards moves in the plane of walking.

    Parameters
    ----------
    trunk, links, joints
        Bodies, and the joint above each link; the one above that comes before it.
    biarticular
        Muscles over two joints.
    foot_radius
        Radius [m] of the foot, a sphere about the end of the last link.
    spanning
        Muscles through points of bodies.

    Examples
    --------
    >>> from mckibben.robot import read_robot
    >>> robot = read_robot("lei-leg")
    >>> robot.muscle_names, round(float(robot.total_mass), 2)
    (('side1', 'side2', 'hip1', 'hip2', 'knee1', 'knee2'), 2.2)
    """

    trunk: Trunk
    links: tuple[Link, ...]
    joints: tuple[Joint, ...]
    biarticular: tuple[BiarticularMuscle, ...] = ()
    foot_radius: Distance = 0.0
    spanning: tuple[SpanningMuscle, ...] = ()

    @classmethod
    def from_file(cls, value: Any) -> Any:
        """Return the section of an entry of the catalog with changes; those of `joints` name the joint."""
        section = {"from": value} if isinstance(value, str) else value
        if not isinstance(section, dict) or "from" not in section:
            return value
        if section["from"] not in catalog.names("legs"):
            fail_validation(
                f"the catalog has no robot {quoted(section['from'])}",
                suggest(str(section["from"]), catalog.names("legs")),
            )
        return with_changes(catalog.leg_section(section["from"]), section)

    def __check_init__(self) -> None:
        super().__check_init__()
        if not self.links:
            raise RangeError("a robot of no links", field="links", remedy="give at least one, and a joint for each")
        check_count("joints", len(self.joints), len(self.links), "link, the joint above it")
        self._check_names()
        for number, joint in enumerate(self.joints):
            if joint.parent not in (None, *self.body_names[: number + 1]):
                raise RangeError(
                    f"{joint.name}: its parent is {joint.parent!r}",
                    field=f"joints.{number}.parent",
                    value=joint.parent,
                    remedy=f"name a body before it: {', '.join(self.body_names[: number + 1])}",
                )
        names = [joint.name for joint in self.joints]
        for number, muscle in enumerate(self.biarticular):
            place = f"biarticular.{number}"
            for field in ("joint1", "joint2"):
                if getattr(muscle, field) not in names or (field == "joint2" and muscle.joint1 == muscle.joint2):
                    raise RangeError(
                        f"{muscle.name}: {field} is {getattr(muscle, field)!r}",
                        field=f"{place}.{field}",
                        value=getattr(muscle, field),
                        remedy=f"name two different joints of {', '.join(names)}",
                    )
            ends = (self.joints[names.index(name)] for name in (muscle.joint1, muscle.joint2))
            _check_biarticular(muscle, place, *ends)
        for number, link in enumerate(self.links, 1):
            if number not in self.parents and isinstance(link.mass, Real) and link.mass == 0:
                remedy = "give mass and inertia of the last link"
                raise RangeError("the last link has no mass", field="links", value=0.0, remedy=remedy)
        self._check_spanning()

    def _check_spanning(self) -> None:
        """Raise for a point of an unknown body, and for a contraction that a muscle does not permit in the range."""
        for number, spanning in enumerate(self.spanning):
            for place, point in enumerate(spanning.through):
                if point.body not in self.body_names:
                    raise RangeError(
                        f"{spanning.name}: the robot has no body {point.body!r}",
                        field=f"spanning.{number}.through.{place}.body",
                        value=point.body,
                        remedy=f"name one of {', '.join(self.body_names)}",
                    )
        limits = [(joint.lower, joint.upper) for joint in self.joints]
        if not all(isinstance(limit, Real) for pair in limits for limit in pair):
            return
        places = [f"the {place} of all ranges" for place in ("lower ends", "middle", "upper ends")]
        units = self._spanning_muscles(self.held([np.linspace(low, high, len(places)) for low, high in limits]))
        for number, (spanning, unit) in enumerate(zip(self.spanning, units, strict=True)):
            if isinstance(spanning.tendon, RigidTendon):
                paths = jnp.broadcast_to(unit.path, (len(places),))
                check_contractions(spanning.name, spanning.muscle, paths, places, f"spanning.{number}.muscle")

    def _check_names(self) -> None:
        names, muscles = [joint.name for joint in self.joints], list(self.muscle_names)
        twice = [(f"joints.{i}.name", name) for i, name in enumerate(names) if name in ("trunk", *names[:i])]
        pairs = self.pair_count
        others = enumerate(muscles[2 * pairs : len(muscles) - len(self.spanning)])
        twice += [(f"biarticular.{i}.name", name) for i, name in others if muscles.count(name) > 1]
        spanning = enumerate(muscle.name for muscle in self.spanning)
        twice += [(f"spanning.{i}.name", name) for i, name in spanning if muscles.count(name) > 1]
        if twice:
            raise RangeError(
                f"joints {', '.join(names)}, and muscles {', '.join(muscles)}: a name is given twice",
                field=twice[0][0],
                value=twice[0][1],
                remedy="give each joint and each muscle a unique name",
            )

    def __repr__(self) -> str:
        return f"Robot({', '.join(joint.name for joint in self.joints)}; {len(self.muscles)} muscles)"

    @property
    def is_planar(self) -> bool:
        """Whether the robot moves in the plane of walking."""
        across = any(one for joint in self.joints for one in (joint.direction.x, joint.direction.z))
        return not across and "y" not in self.trunk.motions

    def posture_angles(self, named: Mapping[str, float]) -> tuple[float, ...]:
        """Return the angles [rad] of all joints: by name, else where a joint is locked, or as near 0 as it can be."""
        return tuple(
            float(named.get(one.name, np.clip(0.0, one.lower, one.upper) if one.locked is None else one.locked))
            for one in self.joints
        )

    @property
    def total_mass(self) -> Float[Array, ""]:
        """Mass of trunk and links [kg]."""
        return jnp.asarray(self.trunk.mass) + sum(jnp.asarray(link.mass) for link in self.links)

    @property
    def body_names(self) -> tuple[str, ...]:
        """Names of trunk and links; a link has the name of its joint."""
        return ("trunk", *(joint.name for joint in self.joints))

    @property
    def parents(self) -> tuple[int, ...]:
        """Place in `body_names` of the body above each joint."""
        names = self.body_names
        return tuple(
            number if joint.parent is None else names.index(joint.parent) for number, joint in enumerate(self.joints)
        )

    def inertia_beyond(self, index: int) -> Any:
        """Return the least inertia [kg*m^2] that a joint turns: its rotor and the next link with a mass."""
        joint, link = self.joints[index], self.links[index]
        rotor = 0.0 if joint.rotor_inertia is None else joint.rotor_inertia
        if own := link.inertia_about_joint:
            return rotor + own
        below = [number for number, parent in enumerate(self.parents) if parent == index + 1]
        return rotor + min((self.inertia_beyond(number) for number in below), default=0.0)

    @property
    def pair_count(self) -> int:
        """Number of joints with a pair of muscles."""
        return sum(joint.muscles is not None for joint in self.joints)

    @property
    def muscles(self) -> tuple[Muscle, ...]:
        """All muscles, in their order."""
        pairs = [pair for joint in self.joints if (pair := joint.muscles) is not None]
        own = [muscle for pair in pairs for muscle in (pair.muscle1, pair.muscle2)]
        return (*own, *(unit.muscle for unit in (*self.biarticular, *self.spanning)))

    @property
    def muscle_names(self) -> tuple[str, ...]:
        """Names of all muscles, such as hip1, hip2, knee1, knee2."""
        pairs = [f"{joint.name}{number}" for joint in self.joints if joint.muscles is not None for number in (1, 2)]
        return (*pairs, *(unit.name for unit in (*self.biarticular, *self.spanning)))

    @property
    def tendons(self) -> tuple[Tendon, ...]:
        """Tendons of all muscles."""
        pairs = [joint.muscles.tendon for joint in self.joints if joint.muscles is not None for _ in (1, 2)]
        return (*pairs, *(RigidTendon() for _ in self.biarticular), *(muscle.tendon for muscle in self.spanning))

    def index(self, name: str) -> int:
        """Return the place of a joint in the robot; `RangeError` for an unknown name."""
        names = [joint.name for joint in self.joints]
        if name not in names:
            raise RangeError(
                f"the robot has no joint {quoted(name)}", field="joint", value=name, remedy=f"it has {', '.join(names)}"
            )
        return names.index(name)

    def held(self, angles: Sequence[ArrayLike]) -> tuple[Array, ...]:
        """Return the angles [rad] with those of locked joints at their place."""
        return tuple(
            jnp.asarray(angle if joint.locked is None else joint.locked)
            for angle, joint in zip(angles, self.joints, strict=True)
        )

    def routed_muscles(self, angles: Sequence[ArrayLike]) -> list[RoutedMuscle]:
        """Return all muscles with their paths at angles [rad]."""
        found = []
        for index, (joint, angle) in enumerate(zip(self.joints, angles, strict=True)):
            if (pair := joint.muscles) is None:
                continue
            (path1, path2), (arm1, arm2) = pair.geometry.paths_and_arms(angle)
            found.append(RoutedMuscle(pair.muscle1, pair.tendon, path1, {index: arm1}))
            found.append(RoutedMuscle(pair.muscle2, pair.tendon, path2, {index: -arm2}))
        for one in self.biarticular:
            first, second = self.index(one.joint1), self.index(one.joint2)
            (part1, slope1), (part2, slope2) = one.parts(angles[first], angles[second])
            found.append(RoutedMuscle(one.muscle, RigidTendon(), part1 + part2, {first: slope1, second: slope2}))
        return found + self._spanning_muscles(angles)

    def _spanning_muscles(self, angles: Sequence[ArrayLike]) -> list[RoutedMuscle]:
        if not self.spanning:
            return []
        hinges, found = self.hinges(angles, [0.0] * len(self.joints)), []
        frames = frames_of(Frame(IDENTITY, ZERO, ZERO, ZERO), hinges)
        for unit in self.spanning:
            points = [(self.body_names.index(point.body), Vector(*point.place)) for point in unit.through]
            length, slopes = path_through(points, hinges, frames)
            own = {number - 1: self.joints[number - 1].sign * slope for number, slope in slopes.items()}
            found.append(RoutedMuscle(unit.muscle, unit.tendon, length - unit.connector_length, own))
        return found

    def hinges(self, angles: Sequence[Any], rates: Sequence[Any], trunk: int = 0) -> list[Hinge]:
        """Return the hinges of the joints at angles [rad] and rates [rad/s]; the trunk has a number."""
        ends = [ZERO, *(Vector(0.0, 0.0, -link.length) for link in self.links)]
        return [
            Hinge(
                joint.direction,
                ends[parent] if joint.place is None else Vector(*joint.place),
                joint.link_angle + joint.sign * angle,
                joint.sign * rate,
                trunk + parent,
                joint.locked is None,
                0.0 if joint.rotor_inertia is None else joint.rotor_inertia,
            )
            for joint, parent, angle, rate in zip(self.joints, self.parents, angles, rates, strict=True)
        ]

    def torques(self, angles: Sequence[ArrayLike], pressures: Sequence[ArrayLike]) -> tuple[Array, ...]:
        """Return the torque [N*m] of all muscles' laws on each joint at angles [rad] and gauge pressures [Pa]."""
        total: list[Any] = [0.0] * len(self.joints)
        for unit, pressure in zip(self.routed_muscles(angles), pressures, strict=True):
            tension = unit.tendon.tension(unit.muscle, unit.path, pressure)
            for joint, slope in unit.slopes.items():
                total[joint] = total[joint] - tension * slope
        return tuple(map(jnp.asarray, total))

    def pressures_for(
        self,
        angles: Sequence[Any],
        torques: Sequence[Any],
        stiffness: Sequence[Any],
        biarticular: Sequence[float] = (),
    ) -> tuple[Any, ...]:
        """Return gauge pressures [Pa] of all muscles for torques [N*m] and stiffness [N*m/rad] of the joints.

        Numbers, or arrays over postures.
        Stiffness is that of a joint's own pair, None for the middle of the attainable range. Those of other muscles
        are given; the pairs take over their torque.

        Raises
        ------
        RangeError
            If a joint has no pair.
        UnreachableError
            If they are not attainable in a joint; with its name and the attainable range.
        """
        pairs = [joint.pair for joint in self.joints]
        given = tuple(biarticular) or (0.0,) * (len(self.biarticular) + len(self.spanning))
        needed = [jnp.asarray(torque) for torque in torques]
        for unit, pressure in zip(self.routed_muscles(angles)[2 * len(pairs) :], given, strict=True):
            tension = unit.tendon.tension(unit.muscle, unit.path, pressure)
            for joint, slope in unit.slopes.items():
                needed[joint] = needed[joint] + tension * slope
        found: list[Any] = []
        for joint, pair, angle, torque, wanted in zip(self.joints, pairs, angles, needed, stiffness, strict=True):
            try:
                pressures = map(np.asarray, pair.pressures_for(angle, torque, wanted))
                found += (float(one) if one.ndim == 0 else one for one in pressures)
            except McKibbenError as error:
                error.message = f"{joint.name}: {error.message}"
                raise
        return (*found, *given)


def check_point(owner: str, field: str, place: tuple[Any, ...]) -> None:
    """Raise `RangeError` unless a point has three coordinates."""
    if len(place) != 3:
        remedy = "give three coordinates: forwards, to the left and up"
        raise RangeError(f"{owner}: a point with {len(place)} coordinates", field=field, value=place, remedy=remedy)


def _check_paths(name: str, pair: AntagonisticJoint, lower: float, upper: float) -> None:
    """Raise unless both muscles are within their domain over the whole range of a joint."""
    angles = np.array([lower, upper])
    low, high = pair.geometry.angle_range
    outside = (angles < low - 1e-9) | (angles > high + 1e-9)
    if outside.any():
        raise RangeError(
            f"{name}: its geometry is known for {low / deg:.4g}..{high / deg:.4g} deg",
            field="lower" if outside[0] else "upper",
            value=float(angles[outside][0]),
            lower=low,
            upper=high,
            unit="rad",
            remedy="give a smaller range, or a geometry for all of it",
        )
    paths = pair.geometry.path_lengths(angles)
    if not isinstance(pair.tendon, RigidTendon):
        return  # a spring takes up lengths beyond the range of the muscle
    for number, (muscle, path) in enumerate(zip((pair.muscle1, pair.muscle2), paths, strict=True), 1):
        check_contractions(f"{name}, muscle {number}", muscle, path, [f"{a / deg:.4g} deg" for a in angles])


def _check_biarticular(one: BiarticularMuscle, place: str, first: Joint, second: Joint) -> None:
    """Raise unless a biarticular muscle is within its domain at all corners of the ranges of its joints."""
    corners = [(a, b) for a in (first.lower, first.upper) for b in (second.lower, second.upper)]
    if not all(isinstance(angle, Real) for corner in corners for angle in corner):
        return
    paths = [sum((part for part, _ in one.parts(*corner)), start=jnp.zeros(())) for corner in corners]
    places = [f"{a / deg:.4g}, {b / deg:.4g} deg" for a, b in corners]
    check_contractions(one.name, one.muscle, jnp.stack(paths), places, f"{place}.muscle")


def check_contractions(owner: str, muscle: Muscle, paths: Array, places: Sequence[str], field: str = "muscle") -> None:
    """Raise where a path of a muscle is longer or shorter than its domain permits."""
    numbers = muscle.specimen.initial_length, muscle.domain.contraction_min, muscle.domain.contraction_max
    if not all(isinstance(one, Real) for one in numbers):
        return
    try:
        contractions = np.asarray(muscle.specimen.contraction_at(paths), float)
    except (TypeError, ValueError):  # of a geometry with many values
        return
    lower, upper = muscle.domain.contraction_min, muscle.domain.contraction_max
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
