r"""The band of stiffness along a motion: statically, with its inertia, and at the speed of the valve.

The muscles have to give what the motion takes (Eq. 6),

.. math:: \tau = I\ddot\theta + c\dot\theta - \tau_{gravity}(\theta),

which leaves one freedom, the tension of muscle 1: with it both tensions rise together, and stiffness and pressures
follow. The stiffness may not change as it likes either: with its rate given, so is that of the tension, and with it the
rate of both pressures. A valve has to be commanded more than the pressure for it to move; a first-order one
:math:`p + T \dot p`. A state belongs to the band if both commands are pressures that the valve lets through.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike
from numpy.typing import NDArray

from mckibben.joint.attainable import is_affine, segment_of
from mckibben.numerics.arrays import floating
from mckibben.numerics.compiled import compiled
from mckibben.plant import JointPlant
from mckibben.simulation.reach import attainable_band
from mckibben.study.envelope.motion import Motion

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
    segment = segment_of(joint, angle, torque, None, 0.0)
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
    return torque, *attainable_band(plant, angle), segment.holdable, values[2], *commands


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
