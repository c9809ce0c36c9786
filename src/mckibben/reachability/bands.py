"""Attainable torque and stiffness over the angle and along a motion."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike
from numpy.typing import NDArray

from mckibben.joint.attainable import cocontraction_segment, is_affine
from mckibben.numerics.compiled import compiled
from mckibben.numerics.elementary import floating
from mckibben.plant import JointPlant
from mckibben.reachability.motion import Motion
from mckibben.simulation.feasibility import attainable_band
from mckibben.units import deg

Values = NDArray[np.float64]

_INSIDE = 1e-9  # of a segment: at its very end a muscle is slack
_SCANNED = 41  # places along a segment that is not straight


class Range(NamedTuple):
    """Lowest and highest, each of shape (moments,); NaN where there is none."""

    lowest: Values
    highest: Values

    def missing(self, value: Values) -> Values:
        """By how much a value lies outside; 0 inside, NaN where there is no range."""
        out = np.maximum(self.lowest - value, value - self.highest)
        return np.where(out > 1e-6, out, np.where(np.isnan(out), np.nan, 0.0))

    def within(self, part: float) -> Range:
        """The same with a part of the width taken off at either end."""
        room = part * (self.highest - self.lowest)
        return Range(self.lowest + room, self.highest - room)


class Bands(NamedTuple):
    """What can be held along a motion.

    Attributes
    ----------
    torque
        Of the muscles, for the motion [N*m].
    static
        Stiffness attainable while the joint stands at the angle [N*m/rad].
    inertial
        While it moves as it should.
    driven
        While it moves as it should and the stiffness changes at its rate, at the speed of the valve.
    """

    torque: Values
    static: Range
    inertial: Range
    driven: Range


def bands_along(plant: JointPlant, motion: Motion) -> Bands:
    """The bands of stiffness at each moment of a motion.

    For laws affine in pressure and rigid tendons they are exact. Otherwise the states of a moment are looked at in 41
    places with straight lines between, and a band is from the lowest to the highest that is attainable. Friction in the
    muscles is left out: the bands are those of a joint midway between its directions.

    Valves are those whose rate is affine in the command, or that answer at once.
    """
    places = np.linspace(_INSIDE, 1 - _INSIDE, 2 if is_affine(plant.joint) else _SCANNED)
    found = _states(
        plant, motion.angle, motion.velocity, motion.acceleration, motion.jerk, motion.stiffness_rate, places
    )
    torque, low, high, holdable, stiffness, *commands = (np.asarray(x) for x in found)
    (low1, low2), (high1, high2) = rated_pressures(plant)
    held = np.broadcast_to(holdable, stiffness.shape)
    stiffness = np.where(held, stiffness, np.nan)
    inertial = Range(_least(stiffness), -_least(-stiffness))
    driven = _cut(stiffness, commands, ((low1, high1), (low2, high2)))
    return Bands(torque, Range(low, high), inertial, driven)


def rated_pressures(plant: JointPlant) -> tuple[tuple[float, float], tuple[float, float]]:
    """The commands [Pa] that the valves of both muscles let through, lowest and highest."""
    rated = [muscle.specimen.domain for muscle in (plant.joint.muscle1, plant.joint.muscle2)]
    low1, low2 = (float(domain.pressure_min) for domain in rated)
    high1, high2 = (float(domain.pressure_max) for domain in rated)
    return (low1, low2), (high1, high2)


@compiled
def _states(
    plant: JointPlant,
    angle: ArrayLike,
    velocity: ArrayLike,
    acceleration: ArrayLike,
    jerk: ArrayLike,
    stiffness_rate: ArrayLike,
    places: ArrayLike,
) -> tuple[Array, ...]:
    """Torque, static band, whether it can be held, and at each place (places, moments) stiffness and commands."""
    joint, load = plant.joint, plant.load
    angle, velocity, acceleration, jerk, places = map(floating, (angle, velocity, acceleration, jerk, places))
    inertia, damping = load.total_inertia, load.damping
    torque = inertia * acceleration + damping * velocity - load.gravity_torque(angle)
    torque_rate = inertia * jerk + damping * acceleration + load.gravity_stiffness(angle) * velocity
    segment = cocontraction_segment(joint, angle, torque, None, 0.0)
    tension = segment.first + (segment.last - segment.first) * places[:, None]

    def state(angle: Array, torque: Array, tension1: Array) -> tuple[Array, Array, Array]:
        paths, arms = joint.geometry.paths_and_arms(angle)
        tension2 = (torque + tension1 * arms[0]) / arms[1]
        pressures = (
            joint.tendon.pressure_for(joint.muscle1, paths[0], tension1),
            joint.tendon.pressure_for(joint.muscle2, paths[1], tension2),
        )
        return *pressures, joint.stiffness(angle, pressures)

    at = jnp.broadcast_arrays(angle, torque, tension)
    still, one = jnp.zeros_like(tension), jnp.ones_like(tension)
    moving = (*jnp.broadcast_arrays(velocity, torque_rate, tension)[:2], still)
    ways = tuple(jnp.stack(pair) for pair in zip(moving, (still, still, one), strict=True))
    values, rates = jax.vmap(lambda *way: jax.jvp(state, tuple(at), way), out_axes=(None, 0))(*ways)
    by_motion, by_tension = ([rate[k] for rate in rates] for k in (0, 1))
    tension_rate = (stiffness_rate - by_motion[2]) / by_tension[2]
    commands = (plant.valve.command_for(values[i], by_motion[i] + by_tension[i] * tension_rate) for i in range(2))
    return torque, *attainable_band(plant, angle), segment.feasible, values[2], *commands


def _cut(stiffness: Values, commands: list[Values], limits: tuple[tuple[float, float], ...]) -> Range:
    """The range of stiffness over the states whose commands lie within limits.

    Between neighbouring places everything is a straight line, so each limit cuts a piece of it off.
    """
    start, end = np.zeros(stiffness[1:].shape), np.ones(stiffness[1:].shape)
    with np.errstate(divide="ignore", invalid="ignore"):
        for command, (low, high) in zip(commands, limits, strict=True):
            first, rise = command[:-1], np.diff(command, axis=0)
            for bound, sign in ((low, 1.0), (high, -1.0)):  # sign (first + rise x - bound) >= 0
                here, slope = sign * (first - bound), sign * rise
                level = slope == 0
                crossing = -here / np.where(level, 1.0, slope)
                start = np.where(~level & (slope > 0), np.fmax(start, crossing), start)
                end = np.where(~level & (slope < 0), np.fmin(end, crossing), end)
                out = (level & (here < -_ROUNDING)) | ~np.isfinite(here) | ~np.isfinite(slope)
                start = np.where(out, np.inf, start)
        held = start <= end + _INSIDE * 10
        ends = [np.where(held, stiffness[:-1] + np.diff(stiffness, axis=0) * x, np.nan) for x in (start, end)]
    both = np.concatenate(ends)
    return Range(_least(both), -_least(-both))


_ROUNDING = 1e-3  # Pa


def _least(values: Values) -> Values:
    """The least over the first axis; NaN where there is none."""
    least = np.fmin.reduce(values, axis=0)
    return np.asarray(least, float)


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
    segment = cocontraction_segment(plant.joint, angle, torque, None, 0.0)
    pressures, stiffness = segment.at(places[:, None])
    _, arms = plant.joint.geometry.paths_and_arms(angle)
    able = (arms[0] > 0) & (arms[1] > 0)
    stiffness = jnp.where(able & segment.feasible, stiffness, jnp.nan)
    return torque, *(jnp.where(able, limit, jnp.nan) for limit in limits), stiffness, *pressures


@compiled
def _map(plant: JointPlant, angle: ArrayLike, torque: ArrayLike) -> tuple[Array, Array]:
    return plant.joint.attainable_stiffness(angle, torque)
