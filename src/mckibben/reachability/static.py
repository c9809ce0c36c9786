"""Static envelope of a joint: torque and stiffness attainable at rest, over the angle.

That of a pair of muscles follows in closed form; that of a joint of a robot whose muscles pass over several joints, by
linear programs.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike
from numpy.typing import NDArray

from mckibben.errors import McKibbenError
from mckibben.joint import AntagonisticJoint
from mckibben.joint.antagonistic import SMALL_MOTION
from mckibben.joint.attainable import cocontraction_segment, is_affine, stiffness_range, unattainable
from mckibben.mechanism.robot import Robot
from mckibben.numerics.compiled import jit
from mckibben.numerics.elementary import floating
from mckibben.plant import JointPlant
from mckibben.statics.attainable import held_statics
from mckibben.statics.posture import HeldPostures, holding_torques
from mckibben.units import HINGE, JointType, deg

Values = NDArray[np.float64]

_STEPS = 24  # of a range that is scanned by linear programs

SEGMENT_MARGIN = 1e-9  # of a segment of tensions: at its end a muscle is slack


class AttainableRange(NamedTuple):
    """Lower and upper bound, each of shape (samples,); NaN where nothing is attainable."""

    lowest: Values
    highest: Values

    @property
    def width(self) -> Values:
        """Upper minus lower bound."""
        return self.highest - self.lowest


@dataclass(frozen=True)
class StaticEnvelope:
    """Torque and stiffness attainable by a joint at rest.

    The joint is one with a pair of muscles; of others pressures and map have no rows, and `limits` are known.
    """

    angles: Values  # shape (angles,) [rad]
    torque: Values  # of the muscles, which balances gravity, shape (angles,) [N*m]
    torque_range: AttainableRange  # [N*m]
    stiffness: AttainableRange  # under gravity [N*m/rad]
    pressures_at_lowest: Values  # gauge, at the lowest stiffness, shape (2, angles) [Pa]
    pressures_at_highest: Values
    angle_min: float  # of the contiguous range of static angles about the requested one [rad]; NaN if there is none
    angle_max: float
    map_angles: Values  # grid over the attainable torques of each angle, shape (torques, columns) [rad]
    map_torques: Values  # likewise [N*m]; no columns if nothing is attainable
    map_stiffness: AttainableRange  # on that grid [N*m/rad]
    small_motion: AttainableRange | None = None  # of motion by 0.1 deg at the ends of `stiffness`, with friction
    limits: tuple[Sequence[str], Sequence[str]] = ((), ())  # muscle and limit at the lowest and the highest stiffness
    obstacle: str = ""  # why no angle can be held
    one_muscle: bool = False  # whose load determines the stiffness, so that both bounds are the same
    joint_type: JointType = HINGE  # of a slide, angles are in m, torques in N and stiffnesses in N/m

    @property
    def limit_texts(self) -> list[str]:
        """Limits of both ends of the stiffness, the most frequent first."""
        pairs = zip(("lowest", "highest"), self.limits, strict=True)
        counts = {end: Counter(filter(None, names)).most_common() for end, names in pairs}
        return [
            f"{end} stiffness: limited by {' or '.join(name for name, _ in names)}"
            for end, names in counts.items()
            if names
        ]

    def __repr__(self) -> str:
        if not self.exists:
            return "<StaticEnvelope: the load cannot be held at any angle>"
        stiffness = np.nanmin(self.stiffness.lowest), np.nanmax(self.stiffness.highest)
        angles, span = (self.angle_min, self.angle_max), self.joint_type.span
        return f"<StaticEnvelope: {span(angles, 'deg')}, stiffness {span(stiffness, 'N*m/rad')}>"

    @property
    def exists(self) -> bool:
        """Whether the load can be held at any angle."""
        return self.angle_min <= self.angle_max

    @property
    def inside(self) -> NDArray[np.bool_]:
        """Mask of the static angles, shape (angles,)."""
        return (self.angles >= self.angle_min) & (self.angles <= self.angle_max)

    def place_of(self, angle: float) -> int:
        """Index of the tabulated angle nearest to one [rad]."""
        return int(np.argmin(np.abs(self.angles - angle)))

    def at(self, angle: float) -> tuple[float, float]:
        """Lowest and highest stiffness [N*m/rad] at the tabulated angle nearest to one [rad]."""
        place = self.place_of(angle)
        return float(self.stiffness.lowest[place]), float(self.stiffness.highest[place])

    def table_rows(self) -> NDArray[np.int_]:
        """Indices of about ten whole angles [deg] of the static range, 0 deg among them; empty if there is none."""
        inside = np.flatnonzero(self.inside)
        degrees = np.round(self.angles[inside] / self.joint_type.size("deg"), 6)
        return inside[degrees % max(math.ceil((np.ptp(degrees) if degrees.size else 0.0) / 10), 1) == 0]


def scan_points(affine: bool) -> Values:
    """Positions along a segment of tensions, 0 to 1: its ends if all requested quantities are affine, else a scan."""
    return np.linspace(SEGMENT_MARGIN, 1 - SEGMENT_MARGIN, 2 if affine else 41)


def static_envelope(plant: JointPlant, *, about: float = 0.0, angles: Values | None = None) -> StaticEnvelope:
    """Compute the static envelope of a plant's joint, where both moment arms are positive.

    Parameters
    ----------
    plant
        Joint and load, and valves whose supply may be below the rated pressures.
    about
        An angle [rad] in the range of interest; if it is not static, the nearest static angle replaces it.
    angles
        Angles [rad], ascending. Default: from -80 to 80 deg; of a slide, where a muscle is within its domain.

    Examples
    --------
    >>> from mckibben import IdealValve, catalog
    >>> printed = JointPlant(catalog.joint("knee-table-2"), catalog.load("knee-table-2"), IdealValve())
    >>> found = static_envelope(printed)
    >>> round(found.angle_min / deg, 1), round(found.angle_max / deg, 1)  # there one muscle is stretched by 3 %
    (-10.4, 10.4)
    """
    return pair_envelope(
        plant.supplied_joint, lambda angle: -plant.load.gravity_torque(angle), about=about, angles=angles
    )


def pair_envelope(
    joint: AntagonisticJoint,
    torque_at: Callable[[Values], ArrayLike],
    *,
    about: float = 0.0,
    angles: Values | None = None,
) -> StaticEnvelope:
    """Compute the static envelope of a pair of muscles that gives a torque [N*m] over the angle [rad].

    `about` and `angles` are those of `static_envelope`; the domains of the muscles end at the supply.
    """
    affine, kind = is_affine(joint), joint.joint_type
    if angles is None:
        first, last = joint.geometry.span(joint.muscles)
        angles = np.linspace(first, last, round((last - first) / kind.size("deg")) * (4 if affine else 1) + 1)
    points = scan_points(affine)

    def stiffness_at(angles: Values) -> tuple[Array, ...]:
        return _static_states(joint, angles, torque_at(angles), points)

    *limits, stiffness, pressure1, pressure2 = map(np.asarray, stiffness_at(angles))
    infeasible = np.asarray(np.isnan(stiffness).all(axis=0))
    low = np.argmin(np.where(np.isnan(stiffness), np.inf, stiffness), axis=0)
    high = np.argmax(np.where(np.isnan(stiffness), -np.inf, stiffness), axis=0)
    column = np.arange(angles.size)

    def pressures(index: NDArray[np.int_]) -> Values:
        return np.where(infeasible, np.nan, np.stack([pressure1[index, column], pressure2[index, column]]))

    grid = _torque_grid(angles, limits, *((81, 33) if affine else (33, 17)))
    ends = pressures(low), pressures(high)
    small = None
    if joint.has_friction:
        small = AttainableRange(*(np.asarray(_small_motion_stiffness(joint, angles, end)) for end in ends))
    obstacle = ""
    if infeasible.all():
        torque = float(np.asarray(torque_at(np.array([about])))[0])
        obstacle = f"at {kind.show(about, 'deg', 4)}, {unattainable(joint, about, torque)}"
    return StaticEnvelope(
        angles,
        np.asarray(torque_at(angles)),
        AttainableRange(*limits),
        AttainableRange(stiffness[low, column], stiffness[high, column]),
        *ends,
        *_contiguous_range(angles, infeasible, about, lambda angles: np.asarray(stiffness_at(angles)[2])),
        *grid,
        AttainableRange(*map(np.asarray, stiffness_range(joint, *grid, None, 0.0))),
        small,
        obstacle=obstacle,
        one_muscle=any(joint.springs),
        joint_type=kind,
    )


def coupled_envelope(robot: Robot, index: int, posture: Sequence[float], supply: float) -> StaticEnvelope:
    """Compute the static envelope of a joint of a robot by linear programs, the other joints held in a posture [rad].

    The torques of gravity are held in all joints, the base held, and the muscles may be slack. The angles are within
    the stops.
    """
    joint = robot.joints[index]
    angles = angles_within(float(joint.lower), float(joint.upper), _STEPS)
    rows = np.tile(np.asarray(posture, float), (angles.size, 1))
    rows[:, index] = angles
    torques = holding_torques(robot, rows)
    postures = HeldPostures.of(robot, rows, torques, supply, minimum_tension=0.0)
    ends = np.full((4, angles.size), np.nan)
    limits: tuple[list[str], list[str]] = ([], [])
    obstacle = ""
    for place in range(angles.size):
        names = "", ""
        try:
            found = held_statics(postures.posture(place), (joint.name,))[joint.name]
        except McKibbenError as error:
            obstacle = obstacle or f"at {angles[place] / deg:.4g} deg, {error}"
        else:
            ends[:, place], names = (*found.torque, *found.stiffness), found.limits[2:]
        for row, name in zip(limits, names, strict=True):
            row.append(name)
    infeasible, none = np.isnan(ends[0]), np.empty((0, angles.size))
    nothing = np.empty((0, 0))
    return StaticEnvelope(
        angles,
        torques[:, index],
        AttainableRange(ends[0], ends[1]),
        AttainableRange(ends[2], ends[3]),
        none,
        none,
        *_contiguous_range(angles, infeasible, posture[index]),
        nothing,
        nothing,
        AttainableRange(nothing, nothing),
        limits=limits,
        obstacle=obstacle * bool(infeasible.all()),
    )


def angles_within(low: float, high: float, steps: int = 160) -> Values:
    """Multiples of a quarter, a half or of whole degrees between two angles [rad] in about that many steps, and both.

    >>> (angles_within(-3 * deg, 4.5 * deg, 8) / deg).round(3).tolist()
    [-3.0, -2.0, -1.0, 0.0, 1.0, 2.0, 3.0, 4.0, 4.5]
    """
    finest = (high - low) / deg / steps
    step = next((size for size in (0.25, 0.5) if size >= finest), math.ceil(finest))
    inner = np.arange(math.ceil(low / deg / step - 1e-6), math.floor(high / deg / step + 1e-6) + 1) * step * deg
    ends = [end for end in (low, high) if not np.isclose(inner, end, rtol=0, atol=1e-9).any()]
    return np.sort(np.concatenate([inner, ends]))


def _contiguous_range(
    angles: Values,
    infeasible: NDArray[np.bool_],
    about: float,
    stiffness_at: Callable[[Values], Values] | None = None,
) -> tuple[float, float]:
    """First infeasible angle on either side of `about`, refined once between grid points by a stiffness there."""
    if infeasible.all():
        return np.nan, np.nan
    feasible = np.flatnonzero(~infeasible)
    middle = int(feasible[np.argmin(np.abs(angles[feasible] - about))])

    def edge(outwards: Values, outside: NDArray[np.bool_]) -> float:
        if not outside.any():
            return float(outwards[-1])
        at = int(np.argmax(outside))
        if stiffness_at is None:
            return float(outwards[at - 1])
        between = np.linspace(outwards[at - 1], outwards[at], angles.size)
        stiffness = stiffness_at(between)
        return float(between[int(np.argmax(np.isnan(stiffness).all(axis=0))) - 1])

    return edge(angles[middle::-1], infeasible[middle::-1]), edge(angles[middle:], infeasible[middle:])


def _torque_grid(angles: Values, torques: list[Values], columns: int, rows: int) -> tuple[Values, Values]:
    """Angles and torques over the attainable set, a little inside its boundary."""
    attainable = np.flatnonzero(~np.isnan(torques[0]))
    if not attainable.size:
        return np.empty((rows, 0)), np.empty((rows, 0))
    chosen = attainable[np.linspace(0, attainable.size - 1, columns).round().astype(int)]
    fraction = np.linspace(1e-6, 1 - 1e-6, rows)[:, None]
    low, high = (limit[chosen] for limit in torques)
    return np.broadcast_to(angles[chosen], (rows, columns)), low + fraction * (high - low)


@jit
def _static_states(
    joint: AntagonisticJoint, angle: ArrayLike, torque: ArrayLike, points: ArrayLike
) -> tuple[Array, ...]:
    """Attainable torques; stiffness and pressures, (points, angles), at a torque, NaN where infeasible."""
    angle, points = floating(angle), floating(points)
    limits = joint.attainable_torque(angle)
    segment = cocontraction_segment(joint, angle, torque, None, 0.0)
    pressures, stiffness = segment.at(points[:, None])
    _, arms = joint.geometry.paths_and_arms(angle)
    able = (arms[0] > 0) & (arms[1] > 0)
    first, last = joint.geometry.angle_range
    if math.isfinite(last - first):  # a measured table
        able &= (angle >= first) & (angle <= last)
    stiffness = jnp.where(able & segment.feasible, stiffness, jnp.nan)
    return *(jnp.where(able, limit, jnp.nan) for limit in limits), stiffness, *pressures


@jit
def _small_motion_stiffness(joint: AntagonisticJoint, angle: ArrayLike, pressures: Values) -> Array:
    return joint.secant_stiffness(angle, (pressures[0], pressures[1]), SMALL_MOTION)
