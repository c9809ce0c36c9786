"""Statics: pressures of taut muscles for a stiffness of the joints or of a point in a posture.

In a posture, torques and stiffness of the joints are affine in the pressures of taut muscles with laws that are affine
in pressure. The pressures for a stiffness are a linear least-squares problem with bounds: exact where it is attainable,
otherwise the nearest, with a certificate.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from jaxtyping import ArrayLike

from mckibben.component.checks import check_count, check_positive
from mckibben.errors import RangeError
from mckibben.mechanism.bodies import BodyPoint, Foot
from mckibben.mechanism.point_stiffness import (
    Floats,
    PointStiffness,
    check_point,
    movable,
    stiffness_of,
    stiffness_through,
)
from mckibben.mechanism.robot import Robot
from mckibben.result import Column, Result, TableColumns, column
from mckibben.statics.posture import EXACT, HeldPosture, check_affine
from mckibben.units import bar, deg

_STARTS, _MARGIN = 8, 0.1
"""Starts of the search of a redundant arm, and the least part of the lowest stiffness that a step keeps."""
_SURE = 0.01
"""Relative difference of error and bound below which the error is called the least possible."""


class StaticPressures(Result):
    """Pressures for a stiffness of joints or of a point.

    Attributes
    ----------
    muscles
        Names of the muscles.
    pressures, tensions
        Gauge pressures [Pa] and tensions [N] of all muscles.
    joint_stiffness
        Stiffness matrix [N*m/rad] of the joints at these pressures.
    error
        Of joints: the root of the sum of squares of the relative errors. Of a point: the norm of
        W^(-1/2) K W^(-1/2) - 1 (Frobenius), with the stiffness K and the wanted one W: the root of the sum of squares
        of the relative errors along the axes, and of what turns them.
    least
        Certificate: no pressures within the limits have a smaller error. 0, none, for a point that more joints move
        than it has directions, whose stiffness is not affine in the pressures.
    limits
        What keeps the error from being smaller: pairs of muscle and "lowest pressure", "highest pressure", "slack"
        (the lowest tension) or "rated force", the strongest limit first. Empty if the stiffness is exact, or if other
        pressures outside the limits would not be better.
    stiffness, wanted
        Stiffness of the point, and the matrix [N/m] that was wanted.
    force
        Static force [N] on the point.
    """

    muscles: tuple[str, ...] = column(title="muscle")
    pressures: tuple[float, ...] = column("Pa", "pressure", "bar")
    tensions: tuple[float, ...] = column("N", "tension")
    joint_stiffness: Floats = column("N*m/rad", "stiffness of the joints", dims=("joint", "other_joint"))
    error: float = column("1", "relative error", digits=3)
    least: float = column("1", "lower bound of the error", digits=3)
    limits: tuple[tuple[str, str], ...]
    stiffness: PointStiffness | None = None
    wanted: Floats | None = None
    force: tuple[float, ...] = ()

    @property
    def exact(self) -> bool:
        """Whether the stiffness is that wanted."""
        return self.error <= EXACT

    def declared(self) -> TableColumns:
        """Columns and values of the fields, the limit of each muscle, and the stiffness of the point."""
        columns, limits, point = super().declared(), dict(self.limits), self.stiffness
        columns["limited_by"] = Column(), [limits.get(name, "") for name in self.muscles]
        if point is not None and self.wanted is not None:
            matrix = "direction", "other_direction"
            attained = np.linalg.inv(point.compliance)
            columns |= {
                "principal": (
                    Column("N/m", "stiffness along the main axes", dims=("axis",)),
                    np.array(point.principal),
                ),
                "axes": (Column("1", "main axes", dims=("axis", "direction")), point.axes.T),
                "attained": (Column("N/m", "stiffness of the point", dims=matrix), attained),
                "wanted": (Column("N/m", "desired stiffness of the point", dims=matrix), self.wanted),
            }
        return columns

    def verdict(self) -> str:
        """Stiffness and error."""
        text = "stiffness of the joints: "
        if self.stiffness is not None and self.wanted is not None:
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


def _axes_text(stiffness: PointStiffness) -> str:
    numbers = ", ".join(f"{one:.4g}" for one in stiffness.principal)
    return f"{numbers} N/m (softest at {stiffness.direction / deg:.1f} deg)"


def pressures_for_joint_stiffness(
    robot: Robot,
    angles: Sequence[float],
    stiffness: Sequence[float | None],
    *,
    torques: ArrayLike | None = None,
    supply: float = np.inf,
    minimum_tension: float = 1.0,
) -> StaticPressures:
    """Return the pressures with which the stiffness of the joints is nearest to a wanted one.

    Muscles stay taut, within their rated pressures and forces. Of pressures with equal errors, those nearest to the
    middle of their ranges are taken.

    Parameters
    ----------
    angles
        Angles [rad] of the joints.
    stiffness
        Stiffness [N*m/rad] of each joint, the others held; None for any.
    torques
        Static torques [N*m] of the muscles on the joints. Default: none.
    supply
        Highest gauge pressure of the supply [Pa].
    minimum_tension
        Lowest tension [N] of each muscle.

    Raises
    ------
    RangeError
        If an angle is beyond a stop of its joint, a stiffness is not positive, or a law is not affine in pressure.
    UnreachableError
        If no pressures give the torques; with the joint and its attainable range.

    Examples
    --------
    >>> from mckibben.robot import read_robot
    >>> found = pressures_for_joint_stiffness(read_robot("lei-leg-planar"), (0.0, 0.0), (None, 15.0))
    >>> found.exact, round(float(found.joint_stiffness[1, 1]), 6)
    (True, 15.0)
    """
    return held_joint_stiffness(HeldPosture.of(robot, angles, torques, supply, minimum_tension), stiffness)


def held_joint_stiffness(setting: HeldPosture, stiffness: Sequence[float | None]) -> StaticPressures:
    """Return the pressures of a posture for a stiffness [N*m/rad] of the joints, as `pressures_for_joint_stiffness`."""
    joints = setting.robot.joints
    check_count("stiffness", len(stiffness), len(joints), "joint, None for any")
    free = [index for index, joint in enumerate(joints) if joint.locked is None]
    rows = [(place, stiffness[index]) for place, index in enumerate(free) if stiffness[index] is not None]
    for place, number in rows:
        check_positive(joints[free[place]].name or "joint", "N*m/rad", stiffness=number)
    offset, slopes = setting.stiffness()
    places, desired = [place for place, _ in rows], np.array([number for _, number in rows], float)
    factors = slopes[places, places] / desired[:, None]
    return _solved(setting, factors, 1 - offset[places, places] / desired)


def _solved(
    setting: HeldPosture, factors: Floats, target: Floats, found: Floats | None = None, **others: Any
) -> StaticPressures:
    """Nearest pressures, or given ones [bar], for a stiffness whose errors are ``factors @ pressures - target``."""
    certain = found is None
    found = setting.nearest(factors, target) if found is None else found
    residual = factors @ found - target
    error, least, limits = float(np.linalg.norm(residual)), 0.0, ()
    if error > EXACT:
        least, multipliers = _certificate(setting, found, factors.T @ residual, residual)
        limits = setting.limits(multipliers)
    pressures = np.clip(found, setting.low, setting.high) * bar
    affine = setting.affine
    return StaticPressures(
        setting.robot.muscle_names,
        tuple(pressures.tolist()),
        tuple(np.maximum(affine.tension[0] + affine.tension[1] * pressures, 0.0).tolist()),
        affine.stiffness_at(pressures),
        error,
        min(least, error) if certain else 0.0,
        limits,
        **others,
    )


def pressures_for_point_stiffness(
    robot: Robot,
    angles: Sequence[float],
    wanted: ArrayLike,
    *,
    point: BodyPoint | Foot | None = None,
    force: Sequence[float] | None = None,
    torques: ArrayLike | None = None,
    supply: float = np.inf,
    minimum_tension: float = 1.0,
) -> StaticPressures:
    r"""Return the pressures with which the stiffness of a point is nearest to a wanted one, the base held.

    Where more joints move the point than it has directions, its stiffness

    .. math:: K = (J K_q^{-1} J^\top)^{-1} = N^\top K_q N, \qquad N = K_q^{-1} J^\top K

    is not affine in the pressures; as the derivative of N has no effect, it is linearised about each solution until
    that stays. The result is then a local one.

    Parameters
    ----------
    angles, supply, minimum_tension
        As for `pressures_for_joint_stiffness`.
    wanted
        Stiffness matrix of the point [N/m], positive definite: forwards and up, or in space forwards, to the left and
        up.
    point
        Point of a body. Default: the foot.
    force
        Static force [N] on the point. Default: none.
    torques
        Static torques [N*m] of the muscles on the joints. Default: those that hold the force, without gravity.

    Raises
    ------
    RangeError, UnreachableError
        As for `pressures_for_joint_stiffness`; if the matrix is not positive definite, fewer joints move than the point
        has directions, or the robot is stretched.

    Examples
    --------
    Muscles over one joint cannot turn the ellipse as wanted, and two of them are at a limit:

    >>> from mckibben.robot import read_robot, stiffness_matrix
    >>> robot = read_robot("lei-leg-planar")
    >>> found = pressures_for_point_stiffness(robot, (0.0, -0.3), stiffness_matrix((20.0, 900.0), -0.15))
    >>> found.exact, round(found.error, 2), round(found.least, 2), [round(one) for one in found.stiffness.principal]
    (False, 0.3, 0.3, [17, 887])
    >>> found.limits
    (('hip1', 'slack'), ('knee1', 'highest pressure'))
    """
    from scipy.linalg import sqrtm

    check_affine(robot)
    wanted, jacobian, geometric = check_point(robot, angles, wanted, point, force)
    pushed = np.zeros(len(jacobian)) if force is None else np.asarray(force, float)
    free = movable(robot)
    moved, bent = jacobian[:, free], geometric[np.ix_(free, free)]
    setting = HeldPosture.of(
        robot, angles, -jacobian.T @ pushed if torques is None else torques, supply, minimum_tension
    )
    root = np.linalg.inv(np.real(sqrtm(wanted)))
    offset, slopes = setting.stiffness()
    upper = np.triu_indices(len(wanted))
    twice = np.where(upper[0] == upper[1], 1.0, np.sqrt(2.0))  # both off-diagonal elements

    def problem(inverse: Floats) -> tuple[Floats, Floats]:
        """Errors of the stiffness in the norm, as factors @ pressures - target, for an N."""
        to_point = root @ inverse.T
        factors = twice[:, None] * np.einsum("ai,ijm,bj->abm", to_point, slopes, to_point)[upper]
        return factors, twice * (np.eye(len(wanted)) - to_point @ (offset - bent) @ to_point.T)[upper]

    others = {"wanted": wanted, "force": tuple(pushed.tolist())}
    if moved.shape[0] == moved.shape[1]:
        found = _solved(setting, *problem(np.asarray(np.linalg.inv(moved), float)), **others)
    else:
        inverse, at = _settled(setting, moved, bent, problem)
        found = _solved(setting, *problem(inverse), at, **others)
    return replace(found, stiffness=stiffness_through(jacobian, geometric, free, found.joint_stiffness))


def _settled(
    setting: HeldPosture, moved: Floats, bent: Floats, problem: Callable[[Floats], tuple[Floats, Floats]]
) -> tuple[Floats, Floats]:
    """N at the pressures [bar] that solve the problem linearised about them, and these."""
    offset, slopes = setting.stiffness()

    def yielding(pressures: Floats) -> tuple[Floats, float]:
        """Stiffness matrix of the joints under the force, and its least eigenvalue."""
        matrix = offset + slopes @ pressures - bent
        return matrix, float(np.linalg.eigvalsh((matrix + matrix.T) / 2).min())

    def inverse_at(pressures: Floats) -> Floats:
        compliant = np.linalg.solve(yielding(pressures)[0], moved.T)
        return compliant @ np.linalg.inv(moved @ compliant)

    def error(pressures: Floats, margin: float = 0.0) -> float:
        """Error of the stiffness, infinite where the least eigenvalue is not above a margin."""
        if not yielding(pressures)[1] > margin:
            return np.inf
        factors, target = problem(inverse_at(pressures))
        return float(np.linalg.norm(factors @ pressures - target))

    def settled(at: Floats) -> Floats:
        before = error(at)
        while np.isfinite(before):
            step, part = setting.nearest(*problem(inverse_at(at))) - at, 1.0
            margin = _MARGIN * yielding(at)[1]
            while part > EXACT and not error(at + part * step, margin) < before:
                part /= 2
            gained = before - error(at + part * step, margin)
            if not gained > EXACT * before:
                break
            at, before = at + part * step, before - gained
        return at

    rng, size = np.random.default_rng(0), slopes.shape[-1]
    goals = [-np.trace(slopes), *rng.normal(size=(_STARTS, size))]  # the stiffest on average, and others
    found = [setting.program(goal).x for goal in goals]
    middle = np.mean(found, axis=0)
    at = min((settled(start) for start in (middle, *found)), key=error)
    if not np.isfinite(error(at)):
        remedy = "give less force, or another posture"
        raise RangeError("the posture is not stable at any pressures that were tried", field="force", remedy=remedy)
    inverse = inverse_at(at)
    return inverse, at


def _certificate(setting: HeldPosture, at: Floats, gradient: Floats, residual: Floats) -> tuple[float, Floats]:
    """Lower bound of the error within the limits, and the multipliers of the bounds, above 0 of the upper ones.

    The squared error is convex: it lies above its tangent, whose least value is a linear program.
    """
    found = setting.program(gradient, slack=1e-12)
    if found.status != 0:
        return 0.0, np.zeros(at.size)
    square = residual @ residual + 2 * (found.fun - gradient @ at)
    return float(np.sqrt(max(square, 0.0))), -(found.lower.marginals + found.upper.marginals)
