"""Static envelope of a joint: torque and stiffness attainable at rest, over the angle."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike
from numpy.typing import NDArray

from mckibben.joint import AntagonisticJoint
from mckibben.joint.antagonistic import SMALL_MOTION
from mckibben.joint.attainable import cocontraction_segment, is_affine, stiffness_range
from mckibben.numerics.compiled import jit
from mckibben.numerics.elementary import floating
from mckibben.plant import JointPlant
from mckibben.units import deg

Values = NDArray[np.float64]

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
    """Torque and stiffness attainable by a plant's joint at rest."""

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

    def __repr__(self) -> str:
        if not self.exists:
            return "<StaticEnvelope: the load cannot be held at any angle>"
        low, high = np.nanmin(self.stiffness.lowest), np.nanmax(self.stiffness.highest)
        angles = f"{self.angle_min / deg:.4g}..{self.angle_max / deg:.4g} deg"
        return f"<StaticEnvelope: {angles}, stiffness {low:.4g}..{high:.4g} N*m/rad>"

    @property
    def exists(self) -> bool:
        """Whether the load can be held at any angle."""
        return self.angle_min <= self.angle_max

    @property
    def inside(self) -> NDArray[np.bool_]:
        """Mask of the static angles, shape (angles,)."""
        return (self.angles >= self.angle_min) & (self.angles <= self.angle_max)

    def at(self, angle: float) -> tuple[float, float]:
        """Lowest and highest stiffness [N*m/rad] at the tabulated angle nearest to one [rad]."""
        place = int(np.argmin(np.abs(self.angles - angle)))
        return float(self.stiffness.lowest[place]), float(self.stiffness.highest[place])

    def table_rows(self) -> NDArray[np.int_]:
        """Indices of about ten whole angles [deg] of the static range, 0 deg among them; empty if there is none."""
        inside = np.flatnonzero(self.inside)
        degrees = np.round(self.angles[inside] / deg, 6)
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
        Angles [rad], ascending. Default: from -80 to 80 deg.

    Examples
    --------
    >>> from mckibben import IdealValve, catalog
    >>> printed = JointPlant(catalog.joint("knee-table-2"), catalog.load("knee-table-2"), IdealValve())
    >>> found = static_envelope(printed)
    >>> round(found.angle_min / deg, 1), round(found.angle_max / deg, 1)  # there one muscle is stretched by 3 %
    (-10.4, 10.4)
    """
    affine = is_affine(plant.joint)
    angles = np.linspace(-80 * deg, 80 * deg, 641 if affine else 161) if angles is None else angles
    points = scan_points(affine)
    torque, *limits, stiffness, pressure1, pressure2 = (np.asarray(x) for x in _static_states(plant, angles, points))
    infeasible = np.asarray(np.isnan(stiffness).all(axis=0))
    low = np.argmin(np.where(np.isnan(stiffness), np.inf, stiffness), axis=0)
    high = np.argmax(np.where(np.isnan(stiffness), -np.inf, stiffness), axis=0)
    column = np.arange(angles.size)

    def pressures(index: NDArray[np.int_]) -> Values:
        return np.where(infeasible, np.nan, np.stack([pressure1[index, column], pressure2[index, column]]))

    grid = _torque_grid(angles, limits, *((81, 33) if affine else (33, 17)))
    ends = pressures(low), pressures(high)
    small = None
    if plant.joint.has_friction:
        small = AttainableRange(*(np.asarray(_small_motion_stiffness(plant.joint, angles, end)) for end in ends))
    return StaticEnvelope(
        angles,
        torque,
        AttainableRange(*limits),
        AttainableRange(stiffness[low, column], stiffness[high, column]),
        *ends,
        *_contiguous_range(plant, angles, infeasible, about, points),
        *grid,
        AttainableRange(*map(np.asarray, stiffness_range(plant.supplied_joint, *grid, None, 0.0))),
        small,
    )


def _contiguous_range(
    plant: JointPlant, angles: Values, infeasible: NDArray[np.bool_], about: float, points: Values
) -> tuple[float, float]:
    """First infeasible angle on either side of `about`, refined once between grid points."""
    if infeasible.all():
        return np.nan, np.nan
    feasible = np.flatnonzero(~infeasible)
    middle = int(feasible[np.argmin(np.abs(angles[feasible] - about))])

    def edge(outwards: Values, outside: NDArray[np.bool_]) -> float:
        if not outside.any():
            return float(outwards[-1])
        at = int(np.argmax(outside))
        between = np.linspace(outwards[at - 1], outwards[at], angles.size)
        stiffness = np.asarray(_static_states(plant, between, points)[3])
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
def _static_states(plant: JointPlant, angle: ArrayLike, points: ArrayLike) -> tuple[Array, ...]:
    """Static torque, attainable torques; stiffness and pressures, (points, angles), NaN where infeasible."""
    angle, points = floating(angle), floating(points)
    torque = -plant.load.gravity_torque(angle)
    joint = plant.supplied_joint
    limits = joint.attainable_torque(angle)
    segment = cocontraction_segment(joint, angle, torque, None, 0.0)
    pressures, stiffness = segment.at(points[:, None])
    _, arms = plant.joint.geometry.paths_and_arms(angle)
    able = (arms[0] > 0) & (arms[1] > 0)
    first, last = plant.joint.geometry.angle_range
    if math.isfinite(last - first):  # a measured table
        able &= (angle >= first) & (angle <= last)
    stiffness = jnp.where(able & segment.feasible, stiffness, jnp.nan)
    return torque, *(jnp.where(able, limit, jnp.nan) for limit in limits), stiffness, *pressures


@jit
def _small_motion_stiffness(joint: AntagonisticJoint, angle: ArrayLike, pressures: Values) -> Array:
    return joint.secant_stiffness(angle, (pressures[0], pressures[1]), SMALL_MOTION)
