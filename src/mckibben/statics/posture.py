"""Postures that taut muscles hold: torques, stiffness and tensions, affine in the pressures, and their limits."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike
from numpy.typing import NDArray

from mckibben.codegen.engine import compiled
from mckibben.errors import RangeError, UnreachableError
from mckibben.joint import RigidTendon
from mckibben.mechanism.dynamics import joint_equations
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
_CENTRED = 1e-6
"""Weight of the distance of a pressure from the middle of its range: it selects among equal solutions."""


class StaticsMap(NamedTuple):
    """Torques, stiffness and tensions at a posture, affine in the pressures of taut muscles: offset + slope p.

    Torques [N*m] of the joints, (joints,) and (joints, muscles); stiffness matrix [N*m/rad], minus the derivative of
    the torques, (joints, joints) and (joints, joints, muscles); tensions [N], (muscles,), each by its own pressure.
    """

    torque: tuple[Floats, Floats]
    stiffness: tuple[Floats, Floats]
    tension: tuple[Floats, Floats]

    def torque_at(self, pressures: ArrayLike) -> Floats:
        """Return the torques [N*m] at gauge pressures [Pa]."""
        return self.torque[0] + self.torque[1] @ np.asarray(pressures, float)

    def stiffness_at(self, pressures: ArrayLike) -> Floats:
        """Return the stiffness matrix [N*m/rad] at gauge pressures [Pa]."""
        return self.stiffness[0] + self.stiffness[1] @ np.asarray(pressures, float)


def map_at(robot: Robot, angles: Sequence[float]) -> StaticsMap:
    """Return the map at angles [rad] of a robot that `check_affine` accepts.

    Raises `RangeError` for contractions outside the domains of the muscles.
    """
    terms, paths = _terms((robot, tuple(np.asarray(angle, float) for angle in angles)))
    for name, muscle, path in zip(robot.muscle_names, robot.all_muscles, paths, strict=True):
        check_contractions(name, muscle, np.reshape(path, (1,)), ["this posture"])
    count, muscles = len(robot.joints), len(terms.tension)
    torque, gain = np.zeros(count), np.zeros((count, muscles))
    stiffness, slopes = np.zeros((count, count)), np.zeros((count, count, muscles))
    for i, row in enumerate(terms.torque):
        for muscle, (offset, slope) in row.items():
            torque[i] += offset
            gain[i, muscle] = slope
    for (i, j), row in terms.stiffness.items():
        stiffness[i, j] = stiffness[j, i] = sum(float(offset) for offset, _ in row.values())
        for muscle, (_, slope) in row.items():
            slopes[i, j, muscle] = slopes[j, i, muscle] = slope
    tension = np.array(terms.tension, float).reshape(muscles, 2).T
    return StaticsMap((torque, gain), (stiffness, slopes), (tension[0], tension[1]))


@compiled
def _terms(parts: tuple[Robot, tuple[ArrayLike, ...]], _: None) -> tuple[JointTerms, list[Array]]:
    """Terms in a posture, and lengths [m] of the muscles' paths."""
    robot, angles = parts
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
        affine, free = map_at(robot, angles), movable(robot)
        torques = np.zeros(len(free)) if torques is None else np.asarray(torques, float)
        low, high, names = _pressure_ranges(robot, affine, supply, minimum_tension)
        equal, held = affine.torque[1][free] * bar, torques[free] - affine.torque[0][free]
        setting = cls(robot, affine, free, low / bar, high / bar, names, equal, held)
        setting.check_torques()
        return setting

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
        if self.program(np.zeros(self.low.size)).status == 0:
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
        """Return the least value of a goal over the pressures, and the muscle whose limit keeps it from being less."""
        found = self.program(goal)
        multipliers = -(found.lower.marginals + found.upper.marginals)
        limits = self.limits(multipliers)
        return float(found.fun), " at ".join(limits[0]) if limits else ""

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


def holding_torques(robot: Robot, angles: Sequence[float], gravity: float = GRAVITY) -> Floats:
    """Return the torques [N*m] with which the muscles hold a posture, the base held; 0 of locked joints."""
    torques, free = np.zeros(len(robot.joints)), movable(robot)
    torques[free] = _torques_at_rest((robot, tuple(np.asarray(angle, float) for angle in angles), gravity))
    return torques


@compiled
def _torques_at_rest(parts: tuple[Robot, tuple[ArrayLike, ...], ArrayLike], _: None) -> list[Array]:
    """Torques [N*m] of gravity on the joints that can move."""
    robot, angles, gravity = parts
    return [jnp.asarray(torque) for torque in joint_equations(robot, angles, (0.0,) * len(angles), gravity).bias]


def _pressure_ranges(
    robot: Robot, affine: StaticsMap, supply: float, minimum_tension: float
) -> tuple[Floats, Floats, list[tuple[str, str]]]:
    """Lowest and highest pressure [Pa] of each taut muscle, and what limits it below and above."""
    lows, highs, names = [], [], []
    muscles = zip(robot.muscle_names, robot.all_muscles, *affine.tension, strict=True)
    for name, muscle, offset, slope in muscles:
        domain = muscle.domain
        below = {"lowest pressure": float(domain.pressure_min)}
        above = {"highest pressure": min(float(domain.pressure_max), supply)}
        if slope > 0:
            below["slack"] = float((minimum_tension - offset) / slope)
            above["rated force"] = float((muscle.specimen.force_limit - offset) / slope)
        elif offset < minimum_tension:
            message = f"{name}: it is slack, and pressure does not tighten it"
            remedy = "choose a posture that stretches it more, or a shorter spring"
            raise UnreachableError(message, value=float(offset), lower=minimum_tension, unit="N", remedy=remedy)
        lower, upper = max(below, key=lambda key: below[key]), min(above, key=lambda key: above[key])
        low, high = below[lower], above[upper]
        if low > high:
            message, remedy = (
                f"{name}: no pressure within its limits holds it taut",
                "choose a posture that stretches it more",
            )
            raise UnreachableError(message, value=low, upper=high, unit="Pa", remedy=remedy)
        lows.append(low)
        highs.append(high)
        names.append((lower, upper))
    return np.array(lows), np.array(highs), names
