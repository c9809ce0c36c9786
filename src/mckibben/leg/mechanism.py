"""Leg: trunk, links in a chain, joints with pairs of muscles, and muscles over two joints."""

from __future__ import annotations

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
from mckibben.leg.bodies import Link, Trunk
from mckibben.muscle import Muscle
from mckibben.numerics.calculus import value_and_derivative
from mckibben.numerics.spatial import Vector, unit_vector
from mckibben.plant.joint_friction import JointFriction
from mckibben.plant.sensors import Disturbance, NoDisturbance
from mckibben.units import Angle, Damping, Distance, Quantity, StiffnessScale, deg

Direction = Annotated[float, Quantity("1", "1", -1, 1)]
StopDamping = Annotated[float, Quantity("s/rad", "s/rad", 0, 1e3)]

Scalar = Float[Array, ""]

Action = Literal["lengthens", "shortens"]
"""Change of a muscle's path as the angle of a joint increases."""


class LegJoint(Component):
    """Hinge with two muscles between a link and the one above it.

    Parameters
    ----------
    muscles
        Pair of muscles with their geometry.
    lower, upper
        Range of the angle [rad]; beyond it stops act.
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
    """

    muscles: AntagonisticJoint
    lower: Angle
    upper: Angle
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

    def __check_init__(self) -> None:
        super().__check_init__()
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
        _check_paths(self)

    @property
    def sign(self) -> int:
        """1 where the link turns about its axis as the angle increases, else -1."""
        return 1 if self.forward else -1

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


class RoutedMuscle(NamedTuple):
    """A muscle in the leg: its path length [m], and the derivative [m/rad] of that over the angles of its joints."""

    muscle: Muscle
    tendon: Tendon
    path: Array
    slopes: dict[int, Array]


class Leg(Component):
    """Leg: a trunk, and a chain of links, each on a joint with two muscles.

    x is forwards, y to the left, and z up. A link with the angle 0 hangs below the one above. All sequences over joints
    begin at the trunk; those over muscles have muscles 1 and 2 of each joint, then the biarticular ones. A leg whose
    joints all swing forwards moves in the plane of walking.

    Parameters
    ----------
    trunk, links, joints
        Bodies, and the joint above each link.
    biarticular
        Muscles over two joints.
    foot_radius
        Radius [m] of the foot, a sphere about the end of the last link.

    Examples
    --------
    >>> from mckibben.leg import read_leg
    >>> leg = read_leg("lei-leg")
    >>> leg.muscle_names, round(float(leg.total_mass), 2)
    (('side1', 'side2', 'hip1', 'hip2', 'knee1', 'knee2'), 2.2)
    """

    trunk: Trunk
    links: tuple[Link, ...]
    joints: tuple[LegJoint, ...]
    biarticular: tuple[BiarticularMuscle, ...] = ()
    foot_radius: Distance = 0.0

    @classmethod
    def from_file(cls, value: Any) -> Any:
        """Return the section of an entry of the catalog with changes; those of `joints` name the joint."""
        section = {"from": value} if isinstance(value, str) else value
        if not isinstance(section, dict) or "from" not in section:
            return value
        if section["from"] not in catalog.names("legs"):
            fail_validation(
                f"the catalog has no leg {quoted(section['from'])}",
                suggest(str(section["from"]), catalog.names("legs")),
            )
        return with_changes(catalog.leg_section(section["from"]), section)

    def __check_init__(self) -> None:
        super().__check_init__()
        if not self.links:
            raise RangeError("a leg of no links", field="links", remedy="give at least one, and a joint for each")
        check_count("joints", len(self.joints), len(self.links), "link, the joint above it")
        if isinstance(self.links[-1].mass, Real) and self.links[-1].mass == 0:
            raise RangeError(
                "the last link has no mass", field="links", value=0.0, remedy="give mass and inertia of the last link"
            )
        names, muscles = [joint.name for joint in self.joints], list(self.muscle_names)
        twice = [(f"joints.{i}.name", one) for i, one in enumerate(names) if one in names[:i]]
        others = enumerate(muscles[2 * len(names) :])
        twice += [(f"biarticular.{i}.name", one) for i, one in others if muscles.count(one) > 1]
        if twice:
            raise RangeError(
                f"joints {', '.join(names)}, and muscles {', '.join(muscles)}: a name is given twice",
                field=twice[0][0],
                value=twice[0][1],
                remedy="give each joint and each biarticular muscle a unique name",
            )
        for number, one in enumerate(self.biarticular):
            place = f"biarticular.{number}"
            for field in ("joint1", "joint2"):
                if getattr(one, field) not in names or (field == "joint2" and one.joint1 == one.joint2):
                    raise RangeError(
                        f"{one.name}: {field} is {getattr(one, field)!r}",
                        field=f"{place}.{field}",
                        value=getattr(one, field),
                        remedy=f"name two different joints of {', '.join(names)}",
                    )
            ends = (self.joints[names.index(name)] for name in (one.joint1, one.joint2))
            _check_biarticular(one, place, *ends)

    def __repr__(self) -> str:
        return f"Leg({', '.join(joint.name for joint in self.joints)}; {len(self.muscles)} muscles)"

    @property
    def is_planar(self) -> bool:
        """Whether the leg moves in the plane of walking."""
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
    def muscles(self) -> tuple[Muscle, ...]:
        """All muscles, in their order."""
        pairs = [one for joint in self.joints for one in (joint.muscles.muscle1, joint.muscles.muscle2)]
        return (*pairs, *(one.muscle for one in self.biarticular))

    @property
    def muscle_names(self) -> tuple[str, ...]:
        """Names of all muscles, such as hip1, hip2, knee1, knee2."""
        pairs = [f"{joint.name}{number}" for joint in self.joints for number in (1, 2)]
        return (*pairs, *(one.name for one in self.biarticular))

    def index(self, name: str) -> int:
        """Return the place of a joint in the leg; `RangeError` for an unknown name."""
        names = [joint.name for joint in self.joints]
        if name not in names:
            raise RangeError(
                f"the leg has no joint {quoted(name)}", field="joint", value=name, remedy=f"it has {', '.join(names)}"
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
            pair = joint.muscles
            (path1, path2), (arm1, arm2) = pair.geometry.paths_and_arms(angle)
            found.append(RoutedMuscle(pair.muscle1, pair.tendon, path1, {index: arm1}))
            found.append(RoutedMuscle(pair.muscle2, pair.tendon, path2, {index: -arm2}))
        for one in self.biarticular:
            first, second = self.index(one.joint1), self.index(one.joint2)
            (part1, slope1), (part2, slope2) = one.parts(angles[first], angles[second])
            found.append(RoutedMuscle(one.muscle, RigidTendon(), part1 + part2, {first: slope1, second: slope2}))
        return found

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
        Stiffness is that of a joint's own pair, None for the middle of the attainable range. Those of biarticular
        muscles are given; the pairs take over their torque.

        Raises
        ------
        UnreachableError
            If they are not attainable in a joint; with its name and the attainable range.
        """
        given = tuple(biarticular) or (0.0,) * len(self.biarticular)
        needed = [jnp.asarray(torque) for torque in torques]
        for unit, pressure in zip(self.routed_muscles(angles)[2 * len(self.joints) :], given, strict=True):
            tension = unit.tendon.tension(unit.muscle, unit.path, pressure)
            for joint, slope in unit.slopes.items():
                needed[joint] = needed[joint] + tension * slope
        found: list[Any] = []
        for joint, angle, torque, wanted in zip(self.joints, angles, needed, stiffness, strict=True):
            try:
                pair = map(np.asarray, joint.muscles.pressures_for(angle, torque, wanted))
                found += (float(one) if one.ndim == 0 else one for one in pair)
            except McKibbenError as error:
                error.message = f"{joint.name}: {error.message}"
                raise
        return (*found, *given)


def _check_paths(joint: LegJoint) -> None:
    """Raise unless both muscles are within their domain over the whole range of a joint."""
    angles = np.array([joint.lower, joint.upper])
    low, high = joint.muscles.geometry.angle_range
    outside = (angles < low - 1e-9) | (angles > high + 1e-9)
    if outside.any():
        raise RangeError(
            f"{joint.name}: its geometry is known for {low / deg:.4g}..{high / deg:.4g} deg",
            field="lower" if outside[0] else "upper",
            value=float(angles[outside][0]),
            lower=low,
            upper=high,
            unit="rad",
            remedy="give a smaller range, or a geometry for all of it",
        )
    paths = joint.muscles.geometry.path_lengths(angles)
    pair = joint.muscles
    if not isinstance(pair.tendon, RigidTendon):
        return  # a spring takes up lengths beyond the range of the muscle
    for number, (muscle, path) in enumerate(zip((pair.muscle1, pair.muscle2), paths, strict=True), 1):
        check_contractions(f"{joint.name}, muscle {number}", muscle, path, [f"{a / deg:.4g} deg" for a in angles])


def _check_biarticular(one: BiarticularMuscle, place: str, first: LegJoint, second: LegJoint) -> None:
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
