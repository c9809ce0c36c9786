"""Robot: bodies in a tree of hinges on a base, and muscles along paths."""

from __future__ import annotations

import functools
import itertools
from collections.abc import Iterator, Mapping, Sequence
from numbers import Real
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from mckibben import catalog
from mckibben.component.base import Component
from mckibben.component.checks import check_count
from mckibben.config.model import fail_validation, with_changes
from mckibben.errors import McKibbenError, RangeError, quoted, suggest
from mckibben.joint import AntagonisticJoint, RigidTendon, Tendon
from mckibben.joint.route import Route
from mckibben.mechanism.bodies import MOTIONS, Body, Foot, Freedom, GravityRatio, Joint, PathElement, check_base
from mckibben.mechanism.muscles import MuscleUnit, Skeleton, check_contractions
from mckibben.mechanism.tree import Frame, TreeHinge, frames_of
from mckibben.muscle import Muscle
from mckibben.numerics.calculus import value_and_derivative
from mckibben.numerics.spatial import IDENTITY, ZERO, Vector, difference, total
from mckibben.units import deg


class Robot(Component):
    """Robot: bodies in a tree of hinges, and any number of muscles.

    x is forwards, y to the left, and z up. Sequences over joints and muscles have the order of the file; a pair has
    muscle 1 before muscle 2. A robot whose joints all turn about y, on a base that stays in the plane, is planar.

    Parameters
    ----------
    bodies
        The base, and the bodies on joints.
    joints
        Hinges, each after the one that carries it.
    muscles
        Muscles, each a pair over a joint, or one along a path.
    base
        How the base moves: "fixed", "vertical" (on a slider), "planar" (a boom: no pitch), "free" (in the plane),
        "spatial" (a gantry: no rotation), or "floating" (in space). A floating base must not pitch by 90 deg, where yaw
        and roll coincide.
    foot
        Sphere that touches the ground. Default: none.
    contacts
        Further spheres that touch it.
    gravity
        Gravity in the axes of the base, as multiples of g: [-1, 0, 0] for a base whose x axis points up, [0, 0, 0] for
        none. Default: along -z.

    Examples
    --------
    >>> from mckibben.robot import read_robot
    >>> robot = read_robot("lei-leg")
    >>> robot
    Robot(side, hip, knee; 6 muscles)
    >>> robot.muscle_names, round(float(robot.total_mass), 2)
    (('side1', 'side2', 'hip1', 'hip2', 'knee1', 'knee2'), 2.2)
    """

    bodies: tuple[Body, ...]
    joints: tuple[Joint, ...]
    muscles: tuple[MuscleUnit, ...] = ()
    base: Freedom = eqx.field(static=True, default="fixed")
    foot: Foot | None = None
    contacts: tuple[Foot, ...] = ()
    gravity: tuple[GravityRatio, ...] = eqx.field(static=True, default=(0.0, 0.0, -1.0))

    @classmethod
    def from_file(cls, value: Any) -> Any:
        """Return the section of an entry of the catalog with changes, those of lists name the part; or of a file."""
        section = {"from": value} if isinstance(value, str) else value
        if not isinstance(section, dict):
            return value
        if "robot" in section:  # a scenario
            return cls.from_file(section["robot"])
        if "from" not in section or str(section["from"]).endswith((".yaml", ".yml")):
            return section
        if section["from"] not in catalog.names("legs"):
            fail_validation(
                f"the catalog has no robot {quoted(section['from'])}",
                suggest(str(section["from"]), catalog.names("legs")),
            )
        return with_changes(catalog.leg_section(section["from"]), section)

    def __check_init__(self) -> None:
        super().__check_init__()
        for field, noun in (("bodies", "bodies"), ("joints", "joints")):
            if not getattr(self, field):
                raise RangeError(f"a robot of no {noun}", field=field, remedy="give the base, and a joint")
        if len(self.gravity) != 3:
            message, remedy = f"gravity has {len(self.gravity)} components", "give three, such as [0, 0, -1]"
            raise RangeError(message, field="gravity", value=self.gravity, remedy=remedy)
        errors = (*self._name_errors(), *self._tree_errors(), *self._muscle_errors())
        for message, field, value, remedy in errors[:1]:
            raise RangeError(message, field=field, value=value, remedy=remedy)
        check_base(self.bodies[0], self.base)
        self._check_paths()

    def _name_errors(self) -> Iterator[tuple[str, str, Any, str]]:
        """Names that are given twice: message, field, value and remedy."""
        groups = {
            "bodies": [(str(i), body.name) for i, body in enumerate(self.bodies)],
            "joints": [(str(i), joint.name) for i, joint in enumerate(self.joints)],
            "muscles": [(str(i), name) for i, unit in enumerate(self.muscles) for name in unit.names],
        }
        for field, named in groups.items():
            names = [name for _, name in named]
            for place, (number, name) in enumerate(named):
                if name in names[:place]:
                    yield f"{field}: {quoted(name)} is given twice", f"{field}.{number}.name", name, "give unique names"

    def _tree_errors(self) -> Iterator[tuple[str, str, Any, str]]:
        """Joints that carry no body of the robot, or hang on none, and bodies without a joint or without mass."""
        names, frames = [body.name for body in self.bodies], self.frame_names
        for number, joint in enumerate(self.joints):
            above, field = frames[: number + 1], f"joints.{number}"
            if joint.parent not in (None, *above):
                remedy = f"name a body before it: {', '.join(above)}"
                yield f"{joint.name}: its parent is {joint.parent!r}", f"{field}.parent", joint.parent, remedy
            if joint.body is not None and (joint.body not in names[1:] or joint.body in above):
                free = ", ".join(name for name in names[1:] if name not in above) or "none is left"
                message = f"{joint.name}: it carries {joint.body!r}"
                yield message, f"{field}.body", joint.body, f"name a body that has no joint: {free}"
        for number, name in enumerate(names[1:], 1):
            if name not in frames:
                yield f"{name}: no joint carries it", f"bodies.{number}.name", name, "give its name to a joint's `body`"
        for number, joint in enumerate(self.joints):
            inertia = self.inertia_beyond(number)
            if isinstance(inertia, Real) and not inertia:
                message = f"{joint.name}: it turns no mass and no inertia about its axis"
                remedy = "give it a body with mass and inertia, a rotor_inertia, or another axis"
                yield message, f"joints.{number}.body", joint.body, remedy

    def _muscle_errors(self) -> Iterator[tuple[str, str, Any, str]]:
        """Muscles over unknown joints or through points of unknown bodies."""
        joints, frames = self.joint_names, self.frame_names
        for number, unit in enumerate(self.muscles):
            over = unit.joint_names
            for place, name in enumerate(over):
                if name not in joints or name in over[:place]:
                    field = f"muscles.{number}.over" + (f".{place}.joint" if len(unit.names) == 1 else "")
                    message = f"{unit.names[0]}: it passes over {quoted(name)}"
                    yield message, field, name, f"name different joints of {', '.join(joints)}"
            for place, element in enumerate(unit.elements):
                if (body := element.carrier) is not None and body not in frames:
                    field = f"muscles.{number}.through.{place}.body"
                    message = f"{unit.names[0]}: the robot has no body {quoted(body)}"
                    yield message, field, body, f"name one of {', '.join(frames)}"
        fields = (["foot"] if self.foot else []) + [f"contacts.{number}" for number in range(len(self.contacts))]
        for field, sphere in zip(fields, self.spheres, strict=True):
            if sphere.body not in frames:
                message = f"the robot has no body {quoted(sphere.body)}"
                yield message, f"{field}.body", sphere.body, f"name one of {', '.join(frames)}"

    def _check_paths(self) -> None:
        """Raise for paths that the domain of a muscle does not permit within the ranges of its joints."""
        limits = [(joint.lower, joint.upper) for joint in self.joints]
        if not all(isinstance(limit, Real) for pair in limits for limit in pair):
            return
        ends = [f"the {place} of all ranges" for place in ("lower ends", "middle", "upper ends")]
        between = self._skeleton(self.held([np.linspace(low, high, len(ends)) for low, high in limits]))
        for number, unit in enumerate(self.muscles):
            over = [self.index(name) for name in unit.joint_names]
            for index, (low, high) in zip(over, unit.angle_ranges, strict=True):
                for end, angle in zip(("lower", "upper"), limits[index], strict=True):
                    if not low - 1e-9 <= angle <= high + 1e-9:
                        known = f"{low / deg:.4g}..{high / deg:.4g} deg"
                        message = f"{self.joint_names[index]}: the geometry of its muscles is known for {known}"
                        details: Any = {"value": float(angle), "lower": low, "upper": high, "unit": "rad"}
                        remedy = "give a smaller range, or a geometry for all of it"
                        raise RangeError(message, field=f"joints.{index}.{end}", remedy=remedy, **details)
            skeleton, places = between, ends
            if not unit.elements:
                corners = np.array(list(itertools.product(*(limits[index] for index in over))))
                places = [f"{', '.join(f'{angle / deg:.4g}' for angle in corner)} deg" for corner in corners]
                angles = [np.full(len(places), np.mean(pair)) for pair in limits]
                for index, column in zip(over, corners.T, strict=True):
                    angles[index] = column
                skeleton = self._skeleton(self.held(angles))
            for name, routed in zip(unit.names, unit.routed(skeleton), strict=True):
                _check_slopes(name, routed, f"muscles.{number}")
                if isinstance(routed.tendon, RigidTendon):  # a spring takes up lengths beyond the range of the muscle
                    paths = jnp.broadcast_to(routed.path, (len(places),))
                    check_contractions(name, routed.muscle, paths, places, f"muscles.{number}")

    def __repr__(self) -> str:
        return f"Robot({', '.join(self.joint_names)}; {len(self.all_muscles)} muscles)"

    @property
    def spheres(self) -> tuple[Foot, ...]:
        """All spheres that touch the ground, the foot first."""
        return (*((self.foot,) if self.foot else ()), *self.contacts)

    @property
    def motions(self) -> tuple[str, ...]:
        """Coordinates of the base that are free: translations, then rotations."""
        return MOTIONS[self.base]

    @property
    def is_planar(self) -> bool:
        """Whether the robot moves in the plane of x and z."""
        across = any(one for joint in self.joints for one in (joint.direction.x, joint.direction.z))
        return not across and "y" not in self.motions

    def posture_angles(self, named: Mapping[str, float]) -> tuple[float, ...]:
        """Return the angles [rad] of all joints: by name, else where a joint is locked, or as near 0 as it can be."""
        return tuple(
            float(named.get(one.name, np.clip(0.0, one.lower, one.upper) if one.locked is None else one.locked))
            for one in self.joints
        )

    @property
    def total_mass(self) -> Float[Array, ""]:
        """Mass of all bodies [kg]."""
        return functools.reduce(lambda mass, body: mass + body.mass, self.bodies[1:], jnp.asarray(self.bodies[0].mass))

    @property
    def highest_pressure(self) -> float:
        """Highest rated pressure [Pa] of a muscle."""
        return max((float(muscle.domain.pressure_max) for muscle in self.all_muscles), default=1.0)

    @property
    def frame_names(self) -> tuple[str, ...]:
        """Names of the base and of what each joint carries: a body, or the joint itself."""
        return (self.bodies[0].name, *(joint.body or joint.name for joint in self.joints))

    @property
    def frame_bodies(self) -> tuple[Body | None, ...]:
        """The base, and the body on each joint."""
        named = {body.name: body for body in self.bodies}
        return (self.bodies[0], *(named.get(joint.body or "") for joint in self.joints))

    @property
    def parents(self) -> tuple[int, ...]:
        """Place in `frame_names` of what carries each joint."""
        names = self.frame_names
        return tuple(
            number if joint.parent is None else names.index(joint.parent) for number, joint in enumerate(self.joints)
        )

    def inertia_beyond(self, index: int) -> Any:
        """Return the least inertia [kg*m^2] that a joint turns: its rotor and the next body with a mass."""
        joint = self.joints[index]
        rotor = 0.0 if joint.rotor_inertia is None else joint.rotor_inertia
        beyond = self._inertias_beyond(joint.direction, index, ZERO)
        return total(rotor, functools.reduce(jnp.minimum, beyond) if beyond else 0.0)

    def _inertias_beyond(self, axis: Vector, index: int, point: Vector) -> list[Any]:
        """Inertia about an axis through a point of the body on a joint, or, without one, of each next body with one."""
        body = self.frame_bodies[index + 1]
        own = 0.0 if body is None else body.inertia_about(axis, point)
        if not (isinstance(own, Real) and own == 0):
            return [own]
        below = [number for number, parent in enumerate(self.parents) if parent == index + 1]
        places = [point - self.joints[number].place.vector for number in below]
        pairs = zip(below, places, strict=True)
        return [found for number, at in pairs for found in self._inertias_beyond(axis, number, at)]

    @property
    def all_muscles(self) -> tuple[Muscle, ...]:
        """All muscles, in their order."""
        return tuple(muscle for unit in self.muscles for muscle in unit.muscles)

    @property
    def muscle_names(self) -> tuple[str, ...]:
        """Names of all muscles, such as hip1, hip2, knee1, knee2."""
        return tuple(name for unit in self.muscles for name in unit.names)

    @property
    def tendons(self) -> tuple[Tendon, ...]:
        """Tendons of all muscles."""
        return tuple(unit.tendon for unit in self.muscles for _ in unit.names)  # type: ignore[attr-defined]

    @property
    def pairs(self) -> dict[int, int]:
        """Joints with a pair of muscles by their numbers, and the number of muscle 1 of each."""
        first, found = 0, {}
        for unit in self.muscles:
            if unit.pair is not None:
                found[self.index(unit.joint_names[0])] = first
            first += len(unit.names)
        return dict(sorted(found.items()))

    @property
    def has_disjoint_pairs(self) -> bool:
        """Whether its muscles are a pair of each joint, and no others."""
        return len(self.pairs) == len(self.joints) and len(self.all_muscles) == 2 * len(self.joints)

    def pair(self, index: int) -> AntagonisticJoint:
        """Return the pair of muscles of a joint; `RangeError` without one."""
        return self.named_pair(index)[1]

    def named_pair(self, index: int) -> tuple[tuple[str, ...], AntagonisticJoint]:
        """Return the names of the pair of muscles of a joint, and the pair; `RangeError` without one."""
        name = self.joints[index].name
        for unit in self.muscles:
            if name in unit.joint_names and (pair := unit.pair) is not None:
                return unit.names, pair
        remedy = "give it one (a muscle with `over` and `geometry`), or name a joint that has one"
        raise RangeError(f"{name}: it has no pair of muscles", field="muscles", remedy=remedy)

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of all joints."""
        return tuple(joint.name for joint in self.joints)

    def index(self, name: str, field: str = "joint") -> int:
        """Return the number of a joint; `RangeError` for an unknown name, with the field that gives it."""
        if name not in self.joint_names:
            remedy = suggest(name, self.joint_names)
            raise RangeError(f"there is no joint {quoted(name)}", field=field, value=name, remedy=remedy)
        return self.joint_names.index(name)

    def check_angles(self, angles: Mapping[str, object], field: str = "angles") -> None:
        """Raise `RangeError` for angles [rad] of unknown joints, of joints that are locked elsewhere, or beyond stops.

        They are by joint; traced ones pass.
        """
        for name, angle in angles.items():
            joint = self.joints[self.index(name, f"{field}.{name}")]
            limits, what = (joint.lower, joint.upper), "beyond its stops"
            remedy = "give an angle between them"
            if joint.locked is not None:
                limits, what, remedy = (joint.locked,) * 2, "where it is not locked", "leave it out"
            if not all(isinstance(number, Real) for number in (angle, *limits)):
                continue
            number, low, high = (float(number) for number in (angle, *limits))  # type: ignore[arg-type]
            if not low - 1e-9 <= number <= high + 1e-9:
                message = f"{name} is at {number / deg:.4g} deg, {what} ({low / deg:.4g}..{high / deg:.4g} deg)"
                details = {"value": number, "lower": low, "upper": high, "unit": "rad"}
                raise RangeError(message, field=f"{field}.{name}", remedy=remedy, **details)

    def check_posture(self, angles: Sequence[object]) -> None:
        """Raise `RangeError` as `check_angles` does, for one angle [rad] of each joint; those of locked ones pass."""
        check_count("angles", len(angles), len(self.joints), f"of {', '.join(self.joint_names)}")
        pairs = zip(self.joints, angles, strict=True)
        self.check_angles({joint.name: angle for joint, angle in pairs if joint.locked is None})

    def held(self, angles: Sequence[ArrayLike]) -> tuple[Array, ...]:
        """Return the angles [rad] with those of locked joints at their place."""
        return tuple(
            jnp.asarray(angle if joint.locked is None else joint.locked)
            for angle, joint in zip(angles, self.joints, strict=True)
        )

    def _skeleton(self, angles: Sequence[ArrayLike]) -> Skeleton:
        @functools.cache
        def posed() -> tuple[list[TreeHinge], list[Frame]]:
            hinges = self.hinges(angles, [0.0] * len(self.joints))
            return hinges, frames_of(Frame(IDENTITY, ZERO, ZERO, ZERO), hinges)

        return Skeleton(self.joints, self.frame_names, angles, posed)

    def routed_muscles(self, angles: Sequence[ArrayLike]) -> list[Route]:
        """Return all muscles with their paths at angles [rad]."""
        skeleton = self._skeleton(angles)
        return [routed for unit in self.muscles for routed in unit.routed(skeleton)]

    def path_along(
        self, elements: Sequence[PathElement], angles: Sequence[ArrayLike]
    ) -> tuple[Array, dict[int, Array]]:
        """Return the length [m] of a path at angles [rad], and its derivatives [m/rad] by joint."""
        return self._skeleton(angles).path_along(elements)[:2]

    def hinges(self, angles: Sequence[Any], rates: Sequence[Any], base: int = 0) -> list[TreeHinge]:
        """Return the hinges of the joints at angles [rad] and rates [rad/s]; the base has a number."""
        return [
            TreeHinge(
                joint.direction,
                joint.place.vector,
                joint.offset + angle,
                rate,
                base + parent,
                joint.locked is None,
                0.0 if joint.rotor_inertia is None else joint.rotor_inertia,
            )
            for joint, parent, angle, rate in zip(self.joints, self.parents, angles, rates, strict=True)
        ]

    def torques(self, angles: Sequence[ArrayLike], pressures: Sequence[ArrayLike]) -> tuple[Array, ...]:
        """Return the torque [N*m] of all muscles' laws on each joint at angles [rad] and gauge pressures [Pa]."""
        torques: list[Any] = [0.0] * len(self.joints)
        for routed, pressure in zip(self.routed_muscles(angles), pressures, strict=True):
            tension = routed.tension(pressure)
            for joint, slope in routed.slopes.items():
                torques[joint] = difference(torques[joint], tension * slope)
        return tuple(map(jnp.asarray, torques))

    def stiffness(self, angles: Sequence[ArrayLike], pressures: Sequence[ArrayLike]) -> tuple[Array, ...]:
        """Return the isobaric stiffness [N*m/rad] of each joint, the others held, by all muscles' laws."""
        found: list[Any] = [0.0] * len(self.joints)
        for unit, pressure in zip(self.routed_muscles(angles), pressures, strict=True):
            tension, slope = value_and_derivative(
                lambda path, unit=unit, p=pressure: unit.tendon.tension(unit.muscle, path, p), unit.path
            )
            bends = unit.bends()
            for joint, arm in unit.slopes.items():
                found[joint] = total(found[joint], slope * arm * arm + tension * bends[joint, joint])
        return tuple(map(jnp.asarray, found))

    def pressures_for(
        self,
        angles: Sequence[Any],
        torques: Sequence[Any],
        stiffness: Sequence[Any],
        others: Sequence[float] = (),
    ) -> tuple[Any, ...]:
        """Return gauge pressures [Pa] of all muscles for torques [N*m] and stiffness [N*m/rad] of the joints.

        Numbers, or arrays over postures.
        Stiffness is that of a joint's own pair, None for the middle of the attainable range. The pressures of other
        muscles are given; the pairs take over their torque.

        Raises
        ------
        RangeError
            If a joint has no pair.
        UnreachableError
            If they are not attainable in a joint; with its name and the attainable range.
        """
        firsts, count = self.pairs, len(self.all_muscles)
        pairs = [self.pair(index) for index in range(len(self.joints))]
        of_pairs = {first + number for first in firsts.values() for number in (0, 1)}
        rest = [number for number in range(count) if number not in of_pairs]
        found: dict[int, Any] = dict(zip(rest, others or (0.0,) * len(rest), strict=True))
        needed = [jnp.asarray(torque) for torque in torques]
        routed = self.routed_muscles(angles)
        for number, pressure in found.items():
            tension = routed[number].tension(pressure)
            for joint, slope in routed[number].slopes.items():
                needed[joint] = needed[joint] + tension * slope
        for index, (joint, pair) in enumerate(zip(self.joints, pairs, strict=True)):
            try:
                pressures = map(np.asarray, pair.pressures_for(angles[index], needed[index], stiffness[index]))
            except McKibbenError as error:
                error.message = f"{joint.name}: {error.message}"
                raise
            for number, pressure in enumerate(pressures, firsts[index]):
                found[number] = float(pressure) if pressure.ndim == 0 else pressure
        return tuple(found[number] for number in range(count))


def _check_slopes(name: str, routed: Route, field: str) -> None:
    """Raise `RangeError` for a path without a direction, or of which no joint changes the length."""
    try:
        path, *slopes = (np.asarray(value, float) for value in (routed.path, *routed.slopes.values()))
    except (TypeError, ValueError):  # of a geometry that varies
        return
    if any(np.isnan(value).any() for value in (path, *slopes)):
        remedy = "move one of them, or leave it out"
        raise RangeError(f"{name}: two points of its path coincide", field=field, remedy=remedy)
    if all(np.allclose(slope, 0.0) for slope in slopes):
        remedy = "let it pass at a distance from an axis, or leave it out"
        raise RangeError(f"{name}: no joint changes the length of its path", field=field, remedy=remedy)
