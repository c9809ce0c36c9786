"""Pressures for a stiffness of the foot: exact where it is attainable, otherwise the nearest, with a certificate.

At a posture, torques and stiffness of the joints are affine in the pressures of taut muscles with laws affine in
pressure, and with as many movable joints as directions of the foot so is the stiffness of the foot. The nearest one is
therefore a linear least-squares problem with bounds.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import ArrayLike
from numpy.typing import NDArray

from mckibben.component.checks import check_within
from mckibben.errors import McKibbenError, Problem, RangeError, ScenarioError, UnreachableError
from mckibben.muscle import Domain
from mckibben.result import Column, Listing
from mckibben.robot.foot import FootStiffness, foot_jacobian, movable, stiffness_of, stiffness_through
from mckibben.robot.mechanism import Robot
from mckibben.robot.muscles import check_contractions
from mckibben.robot.stiffness_map import StiffnessMap, check_affine, map_at
from mckibben.units import bar, deg

if TYPE_CHECKING:
    from mckibben.robot.scenario import RobotScenario

Floats = NDArray[np.float64]

EXACT = 1e-6
"""Error of the stiffness of the foot below which it is exact."""
_WEIGHT = 1e5
"""Weight of the torques, which are constraints, relative to the errors of the stiffness."""
_CENTRED = 1e-6
"""Weight of the distance of a pressure from the middle of its range: it selects among equal solutions."""
_SINGULAR = 1e-6
_SURE = 0.01
"""Relative difference of error and bound below which the error is called the least possible."""


class FootPressures(NamedTuple):
    """Pressures for a stiffness of the foot.

    Attributes
    ----------
    pressures, tensions
        Gauge pressures [Pa] and tensions [N] of all muscles.
    stiffness, joint_stiffness
        Stiffness of the foot, and stiffness matrix [N*m/rad] of the joints, at these pressures.
    wanted, wanted_joint_stiffness
        Those that were wanted: matrices [N/m], [N*m/rad]. The second includes what balances a force on the foot.
    error
        Norm of W^(-1/2) K W^(-1/2) - 1 (Frobenius), with the stiffness K and the wanted one W: the root of the sum of
        squares of the relative errors along the axes, and of what turns them.
    least
        Certificate: no pressures within the limits have a smaller error.
    limits
        What keeps the error from being smaller: pairs of muscle and "lowest pressure", "highest pressure", "slack"
        (the lowest tension) or "rated force", the strongest limit first. Empty if the stiffness is exact, or if other
        pressures outside the limits would not be better.
    force
        Static force [N] of the ground on the foot.
    """

    pressures: tuple[float, ...]
    tensions: tuple[float, ...]
    stiffness: FootStiffness
    joint_stiffness: Floats
    wanted: Floats
    wanted_joint_stiffness: Floats
    error: float
    least: float
    limits: tuple[tuple[str, str], ...]
    force: tuple[float, ...]

    @property
    def exact(self) -> bool:
        """Whether the foot has the wanted stiffness."""
        return self.error <= EXACT

    def record(self, robot: Robot) -> dict[str, Any]:
        """Return the results as plain data."""
        return {
            "pressures_bar": dict(zip(robot.muscle_names, (one / bar for one in self.pressures), strict=True)),
            "tensions": dict(zip(robot.muscle_names, self.tensions, strict=True)),
            "exact": self.exact,
            "error": self.error,
            "least_error": self.least,
            "limits": dict(self.limits),
            "principal": list(self.stiffness.principal),
            "direction_deg": self.stiffness.direction / deg,
            "wanted_direction_deg": stiffness_of(np.linalg.inv(self.wanted)).direction / deg,
            "axes": self.stiffness.axes.T.tolist(),
            "wanted": self.wanted.tolist(),
            "attained": np.linalg.inv(self.stiffness.compliance).tolist(),
            "joint_stiffness": self.joint_stiffness.tolist(),
            "wanted_joint_stiffness": self.wanted_joint_stiffness.tolist(),
        }

    def listing(self, robot: Robot) -> Listing:
        """Table of the muscles."""
        limits = dict(self.limits)
        columns: dict[str, tuple[Column, Any]] = {
            "muscle": (Column(), list(robot.muscle_names)),
            "pressure": (Column("Pa", "pressure", "bar"), list(self.pressures)),
            "tension": (Column("N", "tension"), list(self.tensions)),
            "limit": (Column("", "limited by"), [limits.get(name, "") for name in robot.muscle_names]),
        }
        return Listing("Muscles", columns)

    def describe(self) -> str:
        """Return stiffness and error as text."""
        found, wanted = _axes_text(self.stiffness), _axes_text(stiffness_of(np.linalg.inv(self.wanted)))
        text = f"main axes {found}, wanted {wanted}: "
        if self.exact:
            return text + "exact"
        text += f"relative error {self.error:.3g}"
        if self.least >= (1 - _SURE) * self.error:
            text += f", the least possible (bound {self.least:.3g})"
        elif self.least > 0:  # 0 without a certificate
            text += f"; no pressures have less than {self.least:.3g}"
        return text if self.limits else text + ", within the limits or beyond them"


def _axes_text(stiffness: FootStiffness) -> str:
    numbers = ", ".join(f"{one:.4g}" for one in stiffness.principal)
    return f"{numbers} N/m (softest at {stiffness.direction / deg:.1f} deg)"


def pressures_for_foot_stiffness(
    robot: Robot,
    angles: Sequence[float],
    wanted: ArrayLike,
    *,
    force: Sequence[float] | None = None,
    torques: Sequence[float] | None = None,
    supply: float = np.inf,
    minimum_tension: float = 1.0,
) -> FootPressures:
    """Return the pressures with which the stiffness of the foot is nearest to a wanted one, the base held.

    Muscles stay taut, within their rated pressures and forces. Of pressures with equal errors, those nearest to the
    middle of their ranges are taken.

    Parameters
    ----------
    angles
        Angles [rad] of the joints.
    wanted
        Stiffness matrix of the foot [N/m], positive definite: forwards and up, or in space forwards, to the left and
        up.
    force
        Static force [N] of the ground on the foot. Default: none.
    torques
        Static torques [N*m] of the muscles on the joints. Default: those that hold the force, without gravity.
    supply
        Highest gauge pressure of the supply [Pa].
    minimum_tension
        Lowest tension [N] of each muscle.

    Raises
    ------
    RangeError
        If an angle is beyond a stop of its joint, the matrix is not positive definite, a law is not affine in pressure,
        the robot has not as many movable joints as directions, or it is stretched.
    UnreachableError
        If no pressures give the torques; with the joint and its attainable range.

    Examples
    --------
    Muscles over one joint cannot turn the ellipse as wanted, and two of them are at a limit:

    >>> from mckibben.robot import read_robot
    >>> robot = read_robot("lei-leg-planar")
    >>> found = pressures_for_foot_stiffness(robot, (0.0, -0.3), foot_matrix((20.0, 900.0), -0.15))
    >>> found.exact, round(found.error, 2), round(found.least, 2), [round(one) for one in found.stiffness.principal]
    (False, 0.3, 0.3, [17, 887])
    >>> found.limits
    (('hip1', 'slack'), ('knee1', 'highest pressure'))
    """
    check_affine(robot)
    _check_angles(robot, angles)
    limits = [muscle.domain for muscle in robot.all_muscles], supply, minimum_tension
    return _nearest(robot, angles, wanted, force, torques, limits)


def _nearest(
    robot: Robot,
    angles: Sequence[float],
    wanted: ArrayLike,
    force: Sequence[float] | None,
    torques: Sequence[float] | None,
    limits: tuple[list[Domain], float, float],
) -> FootPressures:
    """Pressures at one posture; `limits` are the domains of the muscles, the supply [Pa] and the lowest tension [N]."""
    from scipy.linalg import sqrtm
    from scipy.optimize import lsq_linear

    affine, free = map_at(robot, angles), movable(robot)
    jacobian, geometric = foot_jacobian(robot, angles, force)
    whole = jacobian, geometric
    wanted = _checked(wanted, len(jacobian))
    moved, geometric = _square_jacobian(jacobian[:, free]), geometric[np.ix_(free, free)]
    pushed = np.zeros(len(jacobian)) if force is None else np.asarray(force, float)
    holding = -jacobian.T @ pushed if torques is None else np.asarray(torques, float)
    low, high, names = pressure_ranges(robot, affine, *limits)

    # errors of the stiffness in the norm, as factors @ p - target, with p in bar
    root = np.linalg.inv(np.real(sqrtm(wanted)))
    to_foot = root @ np.linalg.inv(moved).T
    offset, slopes = (one[np.ix_(free, free)] for one in affine.stiffness)
    upper = np.triu_indices(len(wanted))
    twice = np.where(upper[0] == upper[1], 1.0, np.sqrt(2.0))  # both off-diagonal elements
    factors = twice[:, None] * (np.einsum("ai,ijm,bj->abm", to_foot, slopes, to_foot) * bar)[upper]
    target = twice * (np.eye(len(wanted)) - to_foot @ (offset - geometric) @ to_foot.T)[upper]
    equal, held = affine.torque[1][free] * bar, holding[free] - affine.torque[0][free]
    low, high = low / bar, high / bar
    check_torques(robot, equal, held, low, high)

    scale = _WEIGHT / np.linalg.norm(equal, axis=1)
    centred = _CENTRED / np.maximum(high - low, 1e-9)
    rows = np.concatenate([factors, scale[:, None] * equal, np.diag(centred)])
    right = np.concatenate([target, scale * held, centred * (low + high) / 2])
    bounds = low - 1e-12, high + 1e-12  # not empty for a spring, whose pressure is 0
    found = lsq_linear(rows, right, bounds, method="bvls", tol=1e-15, max_iter=100)
    residual = factors @ found.x - target
    least, multipliers = _certificate(found.x, factors.T @ residual, residual, equal, held, bounds)
    error = float(np.linalg.norm(residual))
    pressures = np.clip(found.x, low, high) * bar
    joints = affine.stiffness_at(pressures)
    return FootPressures(
        tuple(pressures.tolist()),
        tuple(np.maximum(affine.tension[0] + affine.tension[1] * pressures, 0.0).tolist()),
        stiffness_through(*whole, free, joints),
        joints,
        wanted,
        moved.T @ wanted @ moved + geometric,
        error,
        min(least, error),
        () if error <= EXACT else _limits(robot, multipliers, names),
        tuple(pushed.tolist()),
    )


def solve_foot_stiffness(scenario: RobotScenario, *, source: str = "") -> FootPressures:
    """Return the pressures for the section `stiffness` of a file of a robot.

    Raises
    ------
    ScenarioError
        If there is no such section, or it cannot be solved.
    """
    wanted, source, robot = scenario.stiffness, source or scenario.name, scenario.robot
    if wanted is None:
        raise ScenarioError(source, [Problem("lacks the section `stiffness`", remedy="see docs/robot.md")])
    matrix = foot_matrix(wanted.principal, wanted.direction, wanted.sideways)
    supply = float(getattr(scenario.valve, "supply", None) or np.inf)
    angles = robot.posture_angles(wanted.posture)
    try:
        return pressures_for_foot_stiffness(robot, angles, matrix, force=wanted.force, supply=supply)
    except McKibbenError as error:
        raise ScenarioError(source, [Problem.of(error, field="stiffness")]) from error


def foot_matrix(principal: Sequence[float], direction: float, sideways: float | None = None) -> Floats:
    """Return the stiffness matrix [N/m] of the foot with principal stiffness [N/m] in the plane of walking.

    Parameters
    ----------
    principal
        Along the first axis, and across it.
    direction
        Angle [rad] of the first axis from the forward direction.
    sideways
        Stiffness to the side [N/m], for a robot in space.
    """
    along = np.array([np.cos(direction), np.sin(direction)])
    across = np.array([-along[1], along[0]])
    plane = principal[0] * np.outer(along, along) + principal[1] * np.outer(across, across)
    if sideways is None:
        return plane
    matrix = np.diag([0.0, sideways, 0.0])
    matrix[np.ix_([0, 2], [0, 2])] = plane
    return matrix


def _checked(wanted: ArrayLike, directions: int) -> Floats:
    matrix = np.asarray(wanted, float)
    if matrix.shape != (directions, directions) or not np.allclose(matrix, matrix.T):
        raise RangeError(
            f"a stiffness of the foot with the shape {matrix.shape}",
            field="wanted",
            value=matrix.tolist(),
            remedy=f"give a symmetric matrix with {directions} rows",
        )
    if not np.linalg.eigvalsh(matrix).min() > 0:
        raise RangeError(
            "the stiffness of the foot is not positive in all directions",
            field="wanted",
            value=matrix.tolist(),
            remedy="give a positive definite matrix",
        )
    return matrix


def _check_angles(robot: Robot, angles: Sequence[float]) -> None:
    """Raise `RangeError` for a posture beyond stops, and for contractions outside the domains of the muscles."""
    for joint, angle in zip(robot.joints, angles, strict=True):
        if joint.locked is None:
            low, high = joint.lower - 1e-9, joint.upper + 1e-9
            remedy = "choose an angle between its stops"
            check_within(joint.name, low, high, "rad", remedy=remedy, angle=float(angle))
    for name, unit in zip(robot.muscle_names, robot.routed_muscles(robot.held(angles)), strict=True):
        check_contractions(name, unit.muscle, jnp.reshape(unit.path, (1,)), ["this posture"])


def _square_jacobian(jacobian: Floats) -> Floats:
    """Return the Jacobian of the movable joints; `RangeError` unless it can be inverted."""
    directions, joints = jacobian.shape
    if directions != joints:
        raise RangeError(
            f"{joints} joints can move, and the foot has {directions} directions",
            field="joints",
            value=joints,
            remedy=f"lock joints until {directions} can move",
        )
    values = np.linalg.svd(jacobian, compute_uv=False)
    if values[-1] < _SINGULAR * values[0]:
        raise RangeError(
            "the robot is stretched: along it the foot does not yield",
            field="angles",
            remedy="bend the robot",
        )
    return jacobian


def pressure_ranges(
    robot: Robot, affine: StiffnessMap, domains: list[Domain], supply: float, minimum_tension: float
) -> tuple[Floats, Floats, list[tuple[str, str]]]:
    """Lowest and highest pressure [Pa] of each taut muscle, and what limits it below and above."""
    lows, highs, names = [], [], []
    muscles = zip(robot.muscle_names, robot.all_muscles, domains, *affine.tension, strict=True)
    for name, muscle, domain, offset, slope in muscles:
        below = {"lowest pressure": float(domain.pressure_min)}
        above = {"highest pressure": min(float(domain.pressure_max), supply)}
        if slope > 0:
            below["slack"] = float((minimum_tension - offset) / slope)
            above["rated force"] = float((muscle.specimen.force_limit - offset) / slope)
        elif offset < minimum_tension:
            raise UnreachableError(
                f"{name}: it is slack, and pressure does not tighten it",
                value=float(offset),
                lower=minimum_tension,
                unit="N",
                remedy="choose a posture that stretches it more, or a shorter spring",
            )
        lower, upper = max(below, key=lambda key: below[key]), min(above, key=lambda key: above[key])
        low, high = below[lower], above[upper]
        if low > high:
            raise UnreachableError(
                f"{name}: no pressure within its limits holds it taut",
                value=low,
                upper=high,
                unit="Pa",
                remedy="choose a posture that stretches it more",
            )
        lows.append(low)
        highs.append(high)
        names.append((lower, upper))
    return np.array(lows), np.array(highs), names


def check_torques(robot: Robot, equal: Floats, held: Floats, low: Floats, high: Floats) -> None:
    """Raise `UnreachableError` unless pressures within limits give the torques."""
    from scipy.optimize import linprog

    limits = np.stack([low, high], axis=-1)
    if linprog(np.zeros(low.size), A_eq=equal, b_eq=held, bounds=limits).status == 0:
        return
    names = [joint.name for joint in robot.joints if joint.locked is None]
    for name, row, torque in zip(names, equal, held, strict=True):
        least, most = (np.where(row * sign > 0, low, high) @ row for sign in (1, -1))
        if not least <= torque <= most:
            raise UnreachableError(
                f"{name}: its torque is outside what taut muscles can hold, by "
                f"{max(least - torque, torque - most):.3g} N*m",
                value=float(torque),
                lower=float(least),
                upper=float(most),
                unit="N*m",
                remedy="choose another posture or less force",
            )
    raise UnreachableError(
        "no pressures hold the torques of all joints at once",
        unit="N*m",
        remedy="choose another posture, less force or weaker muscles over several joints",
    )


def _certificate(
    at: Floats, gradient: Floats, residual: Floats, equal: Floats, held: Floats, bounds: tuple[Floats, Floats]
) -> tuple[float, Floats]:
    """Lower bound of the error within the limits, and the multipliers of the bounds, above 0 of the upper ones.

    The squared error is convex: it lies above its tangent, whose least value is a linear program.
    """
    from scipy.optimize import linprog

    found = linprog(gradient, A_eq=equal, b_eq=held, bounds=np.stack(bounds, axis=-1))
    if found.status != 0:
        return 0.0, np.zeros(at.size)
    square = residual @ residual + 2 * (found.fun - gradient @ at)
    return float(np.sqrt(max(square, 0.0))), -(found.lower.marginals + found.upper.marginals)


def _limits(robot: Robot, multipliers: Floats, names: list[tuple[str, str]]) -> tuple[tuple[str, str], ...]:
    """Muscles whose limits keep the error from being smaller, the strongest first."""
    strength = np.abs(multipliers)
    order = np.argsort(-strength, kind="stable")
    counted = [i for i in order if strength[i] > EXACT * max(1.0, float(strength.max()))]
    return tuple((robot.muscle_names[i], names[i][1 if multipliers[i] > 0 else 0]) for i in counted)
