"""What a joint can hold standing, over its angle: torque, stiffness, and the pressures at both ends of the band."""

from __future__ import annotations

from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike
from numpy.typing import NDArray

from mckibben.joint.attainable import is_affine, segment_of
from mckibben.numerics.arrays import floating
from mckibben.numerics.compiled import compiled
from mckibben.plant import JointPlant
from mckibben.study.envelope.band import Range
from mckibben.units import deg

Values = NDArray[np.float64]

_WIDEST = 80 * deg
_STEPS = (0.25, 0.5, 1.0, 2.0, 2.5, 5.0, 10.0, 20.0)
_ROWS = 11


@dataclass(frozen=True)
class Holdable:
    """What a plant's joint can hold against gravity.

    Attributes
    ----------
    angles
        Shape (angles,) [rad].
    torque
        What the muscles give to hold the load [N*m].
    torques
        Lowest and highest torque that pressures within limits can give [N*m].
    stiffness
        Lowest and highest stiffness while they hold the load [N*m/rad].
    pressures_lowest, pressures_highest
        Gauge pressures at either end of the stiffness, shape (2, angles) [Pa].
    first, last
        The ends of the range of angle that can be held around `about` without a gap [rad]; NaN if there is none.
    map_angles, map_torques
        A grid from the lowest to the highest attainable torque of each angle, shape (torques, columns) [rad], [N*m];
        without columns if nothing is attainable.
    lowest_at, highest_at
        The stiffness that is attainable there, of the same shape [N*m/rad].
    """

    angles: Values
    torque: Values
    torques: Range
    stiffness: Range
    pressures_lowest: Values
    pressures_highest: Values
    first: float
    last: float
    map_angles: Values
    map_torques: Values
    lowest_at: Values
    highest_at: Values

    def rows(self) -> NDArray[np.int_]:
        """The indices of about a dozen round angles within the range that can be held; none if there is none."""
        if not self.first <= self.last:
            return np.empty(0, int)
        inside = (self.angles >= self.first - 1e-9) & (self.angles <= self.last + 1e-9)
        degrees = self.angles / deg
        round_ones = (inside & (np.abs(degrees / step - np.round(degrees / step)) < 1e-6) for step in _STEPS)
        return next((at for chosen in round_ones if len(at := np.flatnonzero(chosen)) <= _ROWS), np.empty(0, int))


def holdable(plant: JointPlant, *, about: float = 0.0) -> Holdable:
    """What a plant's joint can hold at angles from -80 to 80 deg, where both muscles have an arm.

    Parameters
    ----------
    plant
        Joint and load.
    about
        An angle [rad] in the range that is of interest; the next one that can be held is taken if it cannot.

    Examples
    --------
    >>> from mckibben import IdealValve, catalog
    >>> printed = JointPlant(catalog.joint("knee-table-2"), catalog.load("knee-table-2"), IdealValve())
    >>> found = holdable(printed)
    >>> round(found.first / deg, 1), round(found.last / deg, 1)  # one muscle is stretched by 3 % there
    (-10.4, 10.4)
    """
    affine = is_affine(plant.joint)
    count = 641 if affine else 161
    angles = np.linspace(-_WIDEST, _WIDEST, count)
    places = np.linspace(1e-9, 1 - 1e-9, 2 if affine else 41)
    torque, *limits, stiffness, pressure1, pressure2 = (np.asarray(x) for x in _standing(plant, angles, places))
    lost = np.asarray(np.isnan(stiffness).all(axis=0))
    filled = np.where(np.isnan(stiffness), np.inf, stiffness)
    low = np.argmin(filled, axis=0)
    high = np.argmax(np.where(np.isnan(stiffness), -np.inf, stiffness), axis=0)
    each = np.arange(count)

    def at(index: NDArray[np.int_]) -> Values:
        found = np.stack([pressure1[index, each], pressure2[index, each]])
        return np.where(lost, np.nan, found)

    first, last = _range_about(plant, angles, lost, about, places)
    grid = _grid(angles, limits, *((81, 33) if affine else (33, 17)))
    lowest_at, highest_at = (np.asarray(x) for x in _map(plant, *grid))
    return Holdable(
        angles,
        torque,
        Range(*limits),
        Range(stiffness[low, each], stiffness[high, each]),
        at(low),
        at(high),
        first,
        last,
        *grid,
        lowest_at,
        highest_at,
    )


def _range_about(
    plant: JointPlant, angles: Values, lost: NDArray[np.bool_], about: float, places: Values
) -> tuple[float, float]:
    """From an angle outwards to the first that is lost on either side, and closer between it and the one before."""
    if lost.all():
        return np.nan, np.nan
    held = np.flatnonzero(~lost)
    middle = int(held[np.argmin(np.abs(angles[held] - about))])

    def edge(outwards: Values, gone: NDArray[np.bool_]) -> float:
        if not gone.any():
            return float(outwards[-1])
        at = int(np.argmax(gone))
        between = np.linspace(outwards[at - 1], outwards[at], angles.size)
        closer = np.asarray(_standing(plant, between, places)[3])
        return float(between[int(np.argmax(np.isnan(closer).all(axis=0))) - 1])

    return edge(angles[middle::-1], lost[middle::-1]), edge(angles[middle:], lost[middle:])


def _grid(angles: Values, torques: list[Values], columns: int, rows: int) -> tuple[Values, Values]:
    """Angles and torques all over what is attainable, a little inside its edge."""
    able = np.flatnonzero(~np.isnan(torques[0]))
    if not able.size:
        return np.empty((rows, 0)), np.empty((rows, 0))
    chosen = able[np.linspace(0, able.size - 1, columns).round().astype(int)]
    part = np.linspace(1e-6, 1 - 1e-6, rows)[:, None]
    low, high = (limit[chosen] for limit in torques)
    return np.broadcast_to(angles[chosen], (rows, columns)), low + part * (high - low)


@compiled
def _standing(plant: JointPlant, angle: ArrayLike, places: ArrayLike) -> tuple[Array, ...]:
    """Torque held, attainable torques, and at each place (places, angles) stiffness and pressures; NaN if not held."""
    angle, places = floating(angle), floating(places)
    torque = -plant.load.gravity_torque(angle)
    limits = plant.joint.attainable_torque(angle)
    segment = segment_of(plant.joint, angle, torque, None, 0.0)
    pressures, stiffness = segment.at(places[:, None])
    _, arms = plant.joint.geometry.paths_and_arms(angle)
    able = (arms[0] > 0) & (arms[1] > 0)
    stiffness = jnp.where(able & segment.holdable, stiffness, jnp.nan)
    return torque, *(jnp.where(able, limit, jnp.nan) for limit in limits), stiffness, *pressures


@compiled
def _map(plant: JointPlant, angle: ArrayLike, torque: ArrayLike) -> tuple[Array, Array]:
    return plant.joint.attainable_stiffness(angle, torque)
