"""Postures that taut muscles hold: torques, stiffness and tensions, affine in the pressures, and their limits."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Array, ArrayLike
from numpy.typing import NDArray

from mckibben.codegen.engine import compiled
from mckibben.errors import RangeError, UnreachableError
from mckibben.joint import RigidTendon
from mckibben.mechanism.dynamics import equations_at_rest
from mckibben.mechanism.muscles import check_contractions
from mckibben.mechanism.point_stiffness import movable
from mckibben.mechanism.robot import Robot
from mckibben.mechanism.terms import JointTerms, joint_terms
from mckibben.muscle import PressureAffineLaw
from mckibben.units import GRAVITY, bar

Floats = NDArray[np.float64]

EXACT = 1e-6
"""Relative error of a stiffness below which it is exact."""
_WEIGHT = 1e5
"""Weight of the torques, which are constraints, relative to the errors of the stiffness."""
_HELD = 1e-7
"""Largest error of a torque that is held, as a change of pressures [bar]."""
_CENTRED = 1e-6
"""Weight of the distance of a pressure from the middle of its range: it selects among equal solutions."""


class StaticsMap(NamedTuple):
    """Torques, stiffness and tensions in a posture, affine in the pressures of taut muscles: offset + slope p.

    Torques [N*m] of the joints, (joints,) and (joints, muscles); stiffness matrix [N*m/rad], minus the derivative of
    the torques, (joints, joints) and (joints, joints, muscles); tensions [N], (muscles,), each by its own pressure. In
    many postures these are the first axis.
    """

    torque: tuple[Floats, Floats]
    stiffness: tuple[Floats, Floats]
    tension: tuple[Floats, Floats]

    def posture(self, index: int) -> StaticsMap:
        """Return the map in one of the postures."""
        return StaticsMap(*((offset[index], slope[index]) for offset, slope in self))

    def torque_at(self, pressures: ArrayLike) -> Floats:
        """Return the torques [N*m] at gauge pressures [Pa]."""
        return self.torque[0] + self.torque[1] @ np.asarray(pressures, float)

    def stiffness_at(self, pressures: ArrayLike) -> Floats:
        """Return the stiffness matrix [N*m/rad] at gauge pressures [Pa]."""
        return self.stiffness[0] + self.stiffness[1] @ np.asarray(pressures, float)


def maps_at(robot: Robot, angles: ArrayLike) -> tuple[StaticsMap, Floats]:
    """Return the maps of a robot that `check_affine` accepts, and the lengths [m] of the muscles' paths.

    Angles [rad] have shape (postures, joints); what is returned has the postures as its first axis.
    """
    rows = np.asarray(angles, float)
    terms, paths = _terms(robot, tuple(np.ascontiguousarray(rows.T)))
    shape, muscles = rows.shape, len(terms.tension)
    count = shape[1]
    torque, gain = np.zeros(shape), np.zeros((*shape, muscles))
    stiffness, slopes = np.zeros((*shape, count)), np.zeros((*shape, count, muscles))
    for i, row in enumerate(terms.torque):
        for muscle, (offset, slope) in row.items():
            torque[:, i] += offset
            gain[:, i, muscle] = slope
    for (i, j), row in terms.stiffness.items():
        for muscle, (offset, slope) in row.items():
            for first, second in {(i, j), (j, i)}:
                stiffness[:, first, second] += offset
                slopes[:, first, second, muscle] = slope
    tension = np.zeros((2, len(rows), muscles))
    for muscle, pair in enumerate(terms.tension):
        tension[0, :, muscle], tension[1, :, muscle] = pair
    lengths = np.stack([np.broadcast_to(path, len(rows)) for path in paths], axis=-1) if paths else tension[0]
    return StaticsMap((torque, gain), (stiffness, slopes), (tension[0], tension[1])), lengths


@compiled
def _terms(robot: Robot, angles: tuple[Array, ...]) -> tuple[JointTerms, list[Array]]:
    """Terms in postures, and lengths [m] of the muscles' paths, many along the last axis."""
    held = robot.held(angles)
    return joint_terms(robot, held), [unit.path for unit in robot.routed_muscles(held)]


def check_affine(robot: Robot) -> None:
    """Raise `RangeError` unless laws are affine in pressure and tendons rigid."""
    for name, kind in _not_affine(robot):
        message = f"{name}: with a {kind} the stiffness is not affine in the pressures"
        remedy = "give it a law that is affine in pressure, and a rigid tendon"
        raise RangeError(message, field="muscle", value=kind, remedy=remedy)


def is_affine(robot: Robot) -> bool:
    """Whether laws are affine in pressure and tendons rigid."""
    return not any(_not_affine(robot))


def _not_affine(robot: Robot) -> Iterator[tuple[str, str]]:
    """Muscles, and the class of what is not affine in them."""
    for name, muscle, tendon in zip(robot.muscle_names, robot.all_muscles, robot.tendons, strict=True):
        for part, kind in ((muscle.law, PressureAffineLaw), (tendon, RigidTendon)):
            if not isinstance(part, kind):
                yield name, type(part).__name__


class HeldPostures(NamedTuple):
    """Postures with their maps, the limits of the pressures [bar], and the torques [N*m] that are held.

    Arrays have the postures as their first axis; `limits` are the names of the lowest and the highest pressures.
    """

    robot: Robot
    affine: StaticsMap
    paths: Floats  # of the muscles [m], (postures, muscles)
    outside: NDArray[np.bool_]  # whether their contraction is outside the domain, likewise
    free: NDArray[np.bool_]
    low: Floats
    high: Floats
    limits: tuple[NDArray[np.str_], NDArray[np.str_]]
    torques: Floats
    minimum_tension: float

    @classmethod
    def of(
        cls,
        robot: Robot,
        angles: ArrayLike,
        torques: ArrayLike | None = None,
        supply: float = np.inf,
        minimum_tension: float = 1.0,
    ) -> HeldPostures:
        """Return the postures of angles [rad] and torques [N*m], shape (postures, joints); no torques by default.

        Raises `RangeError` for laws that are not affine in pressure.
        """
        check_affine(robot)
        rows = np.asarray(angles, float)
        affine, paths = maps_at(robot, rows)
        held = np.zeros(rows.shape) if torques is None else np.broadcast_to(np.asarray(torques, float), rows.shape)
        domains = [muscle.domain for muscle in robot.all_muscles]
        least = np.array([float(domain.pressure_min) for domain in domains])
        most = np.array([min(float(domain.pressure_max), supply) for domain in domains])
        rated = np.array([float(muscle.specimen.force_limit) for muscle in robot.all_muscles])
        offset, slope = affine.tension
        tightens, per_newton = slope > 0, 1 / np.where(slope > 0, slope, 1.0)
        slack = np.where(tightens, (minimum_tension - offset) * per_newton, -np.inf)
        strongest = np.where(tightens, (rated - offset) * per_newton, np.inf)
        names = (
            np.where(slack > least, "slack", "lowest pressure"),
            np.where(strongest < most, "rated force", "highest pressure"),
        )
        low, high = np.maximum(slack, least) / bar, np.minimum(strongest, most) / bar
        contractions = 1 - paths / np.array([float(muscle.specimen.initial_length) for muscle in robot.all_muscles])
        ends = np.array([(float(domain.contraction_min), float(domain.contraction_max)) for domain in domains])
        outside = (contractions < ends[:, 0]) | (contractions > ends[:, 1])
        return cls(robot, affine, paths, outside, movable(robot), low, high, names, held, minimum_tension)

    def posture(self, index: int) -> HeldPosture:
        """Return one posture.

        Raises `RangeError` where a muscle is outside its domain, and `UnreachableError` where no pressures hold it taut
        or give the torques.
        """
        self._check(index)
        affine, free = self.affine.posture(index), self.free
        equal, held = affine.torque[1][free] * bar, (self.torques[index] - affine.torque[0])[free]
        names = list(zip(*(of_all[index].tolist() for of_all in self.limits), strict=True))
        posture = HeldPosture(self.robot, affine, free, self.low[index], self.high[index], names, equal, held)
        posture.check_torques()
        return posture

    def _check(self, index: int) -> None:
        """Raise unless each muscle can be taut in a posture, within its domain."""
        for number in np.flatnonzero(self.outside[index]):
            name, muscle, path = self.robot.muscle_names[number], self.robot.all_muscles[number], self.paths[index]
            check_contractions(name, muscle, path[[number]], ["this posture"])
        offset, slope = (of_all[index] for of_all in self.affine.tension)
        for number, name in enumerate(self.robot.muscle_names):
            low, high = self.low[index, number] * bar, self.high[index, number] * bar
            remedy = "choose a posture that stretches it more"
            if slope[number] <= 0 and offset[number] < self.minimum_tension:
                message, limits = f"{name}: it is slack, and pressure does not tighten it", (self.minimum_tension, "N")
                value = float(offset[number])
                remedy += ", or a shorter spring"
                raise UnreachableError(message, value=value, lower=limits[0], unit=limits[1], remedy=remedy)
            if low > high:
                message = f"{name}: no pressure within its limits holds it taut"
                raise UnreachableError(message, value=float(low), upper=float(high), unit="Pa", remedy=remedy)


class HeldPosture(NamedTuple):
    """A posture with its map, the movable joints, the limits of the pressures, and the torques that are held.

    Pressures are in bar here, so that the problems are well scaled. `equal` and `held` are the equations of the torques
    of the movable joints.
    """

    robot: Robot
    affine: StaticsMap
    free: NDArray[np.bool_]
    low: Floats
    high: Floats
    names: list[tuple[str, str]]
    equal: Floats
    held: Floats

    @classmethod
    def of(
        cls,
        robot: Robot,
        angles: Sequence[float],
        torques: ArrayLike | None,
        supply: float = np.inf,
        minimum_tension: float = 1.0,
    ) -> HeldPosture:
        """Raises as `pressures_for_joint_stiffness` does."""
        check_affine(robot)
        robot.check_posture(angles)
        rows = np.asarray(angles, float)[None]
        return HeldPostures.of(robot, rows, torques, supply, minimum_tension).posture(0)

    @property
    def bounds(self) -> Floats:
        """Lowest and highest pressure of each muscle [bar]."""
        return np.stack([self.low, self.high], axis=-1)

    def stiffness(self) -> tuple[Floats, Floats]:
        """Return offset and slopes per bar of the stiffness matrix of the movable joints."""
        inner = np.ix_(self.free, self.free)
        return self.affine.stiffness[0][inner], self.affine.stiffness[1][inner] * bar

    def check_torques(self) -> None:
        """Raise `UnreachableError` unless pressures within the limits give the torques."""
        nearest = self.nearest(np.zeros((0, self.low.size)), np.zeros(0))
        size = np.linalg.norm(self.equal, axis=1)
        if np.all(np.abs(self.equal @ nearest - self.held) <= _HELD * size):
            return
        names = [joint.name for joint in self.robot.joints if joint.locked is None]
        for name, row, torque in zip(names, self.equal, self.held, strict=True):
            least, most = (np.where(row * sign > 0, self.low, self.high) @ row for sign in (1, -1))
            if not least <= torque <= most:
                excess = max(least - torque, torque - most)
                message = f"{name}: its torque is outside what taut muscles can hold, by {excess:.3g} N*m"
                details: Any = {"value": float(torque), "lower": float(least), "upper": float(most), "unit": "N*m"}
                raise UnreachableError(message, remedy="choose another posture or less force", **details)
        remedy = "choose another posture, less force or weaker muscles over several joints"
        raise UnreachableError("no pressures hold the torques of all joints at once", unit="N*m", remedy=remedy)

    def program(self, goal: Floats, slack: float = 0.0) -> Any:
        """Solve the linear program of a goal over the pressures [bar] that hold the torques, their limits wider."""
        from scipy.optimize import linprog

        return linprog(goal, A_eq=self.equal, b_eq=self.held, bounds=self.bounds + np.array([-slack, slack]))

    def extreme(self, goal: Floats) -> tuple[float, str]:
        """Return the least value of a goal over the pressures, and the muscle whose limit keeps it from being less.

        In closed form where the torques leave the muscles of the goal free, or one degree of freedom to them, such as
        the co-contraction of a pair; else by a linear program.
        """
        value, multipliers = self._free_extreme(goal)
        if value is None:
            solved = self.program(goal)
            value, multipliers = float(solved.fun), -(solved.lower.marginals + solved.upper.marginals)
        limits = self.limits(multipliers)
        return value, " at ".join(limits[0]) if limits else ""

    def _free_extreme(self, goal: Floats) -> tuple[float | None, Floats]:
        """Least value in closed form, None if there is none, and the multipliers of the limits."""
        turning = self.equal != 0
        muscles = goal != 0
        for _ in self.equal:  # those that are coupled by torques, too
            muscles = muscles | turning[turning[:, muscles].any(axis=1)].any(axis=0)
        rows = self.equal[turning[:, muscles].any(axis=1)][:, muscles]
        if not rows.size:
            return float(np.minimum(goal * self.low, goal * self.high).sum()), -goal
        if muscles.sum() - len(rows) != 1:
            return None, goal
        direction = np.linalg.svd(rows)[2][-1]
        slope = float(goal[muscles] @ direction)
        held = self.nearest(np.zeros((0, goal.size)), np.zeros(0))
        away = -np.sign(slope) * direction
        with np.errstate(divide="ignore", invalid="ignore"):
            room = np.where(away > 0, self.high[muscles] - held[muscles], self.low[muscles] - held[muscles]) / away
        room[away == 0] = np.inf
        first, multipliers = int(np.argmax(room <= room.min() + EXACT)), np.zeros(goal.size)
        if slope == 0:
            return float(goal @ held), multipliers
        multipliers[np.flatnonzero(muscles)[first]] = -slope / direction[first]
        return float(goal @ held - abs(slope) * max(room[first], 0.0)), multipliers

    def limits(self, multipliers: Floats) -> tuple[tuple[str, str], ...]:
        """Return muscles whose limits keep a value from being smaller, and these limits, the strongest first."""
        strength = np.abs(multipliers)
        order = np.argsort(-strength, kind="stable")
        counted = [i for i in order if strength[i] > EXACT * max(1.0, float(strength.max()))]
        names = self.robot.muscle_names
        return tuple((names[i], self.names[i][1 if multipliers[i] > 0 else 0]) for i in counted)

    def nearest(self, factors: Floats, target: Floats) -> Floats:
        """Return the pressures [bar] whose ``factors @ pressures`` are nearest to a target."""
        from scipy.optimize import lsq_linear

        scale = _WEIGHT / np.linalg.norm(self.equal, axis=1)
        centred = _CENTRED / np.maximum(self.high - self.low, 1e-9)
        rows = np.concatenate([factors, scale[:, None] * self.equal, np.diag(centred)])
        right = np.concatenate([target, scale * self.held, centred * (self.low + self.high) / 2])
        bounds = self.low - 1e-12, self.high + 1e-12  # not empty for a spring, whose pressure is 0
        return lsq_linear(rows, right, bounds, method="bvls", tol=1e-15, max_iter=100).x


def holding_torques(robot: Robot, angles: ArrayLike | Sequence[float], gravity: float = GRAVITY) -> Floats:
    """Return the torques [N*m] with which the muscles hold postures, the base held; 0 of locked joints.

    Angles [rad] have shape (joints,), or (postures, joints), which is that of the torques.
    """
    rows = np.asarray(angles, float)
    torques = np.zeros(rows.shape)
    bias = equations_at_rest(robot, np.atleast_2d(rows), gravity)[1][:, len(robot.motions) :]
    torques[..., movable(robot)] = bias.reshape(*rows.shape[:-1], -1)
    return torques
