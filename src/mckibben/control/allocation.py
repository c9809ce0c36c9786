"""Control allocation: pressures for a commanded torque and stiffness, within limits."""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float

from mckibben.joint import AffineMap, AntagonisticJoint, TorqueStiffnessMap
from mckibben.joint.attainable import is_affine, pressure_limits_of
from mckibben.joint.geometry import Pair
from mckibben.numerics.compiled import cached_trace

Scalar = Float[Array, ""]

_SECANT = 5e3  # Pa: above rounding in 32 bits, below the curvature of a law


class Allocation(NamedTuple):
    """Pressures [Pa] within limits, their torque [N*m], and whether a limit was met."""

    pressures: Pair
    torque: Scalar
    saturated: Array


def prioritise_torque(
    affine: TorqueStiffnessMap,
    torque: ArrayLike,
    stiffness: ArrayLike,
    lower: Pair,
    upper: Pair,
    springs: tuple[bool, bool] = (False, False),
) -> Allocation:
    """Pressures for a torque and the nearest attainable stiffness, within limits.

    The torque fixes a line in the plane of both pressures; the stiffness chooses the point on it. With a return spring,
    the torque determines the pressure of the only muscle, and the stiffness.

    Parameters
    ----------
    affine
        Torque and stiffness over the pressures.
    torque, stiffness
        Commanded torque [N*m] and stiffness [N*m/rad].
    lower, upper
        Limits of both pressures [Pa].
    springs
        Whether muscles 1 and 2 are return springs.
    """
    (torque0, t1, t2), (stiffness0, k1, k2) = affine.torque, affine.stiffness
    if any(springs):
        driven = springs.index(False)
        slope = (t1, t2)[driven]
        free = (torque - torque0) / slope
        pressure = jnp.clip(free, lower[driven], upper[driven])
        pair = (pressure, lower[1]) if driven == 0 else (lower[0], pressure)
        return Allocation(pair, torque0 + slope * pressure, pressure != free)
    least = torque0 + t1 * upper[0] + t2 * lower[1]
    greatest = torque0 + t1 * lower[0] + t2 * upper[1]
    attained = jnp.clip(torque, least, greatest)

    def pressure1_for(pressure2: ArrayLike) -> Scalar:
        """Pressure of muscle 1 on the line of constant torque."""
        return (attained - torque0 - t2 * pressure2) / t1

    slope = -t1 / t2  # the line is p2 = intercept + slope p1, slope > 0
    intercept = (attained - torque0) / t2
    stiffness_slope = k1 + k2 * slope
    flat = jnp.abs(stiffness_slope) * (upper[0] - lower[0]) < 1e-6 * jnp.abs(stiffness0)
    free = (stiffness - stiffness0 - k2 * intercept) / jnp.where(flat, 1.0, stiffness_slope)
    free = jnp.where(flat, (lower[0] + upper[0]) / 2, free)  # no pressure changes the stiffness
    begin, end = jnp.maximum(lower[0], pressure1_for(lower[1])), jnp.minimum(upper[0], pressure1_for(upper[1]))
    pressure1 = jnp.maximum(jnp.minimum(free, end), begin)
    pressure2 = jnp.clip(intercept + slope * pressure1, lower[1], upper[1])
    return Allocation((pressure1, pressure2), attained, (attained != torque) | (pressure1 != free))


def prioritise_differential(
    differential: ArrayLike, cocontraction: ArrayLike, lower: Pair, upper: Pair
) -> tuple[Pair, Array]:
    """Pressures within limits for a differential pressure, and the nearest attainable co-contraction.

    Parameters
    ----------
    differential, cocontraction
        Half-difference and mean of the pressures (p1, p2) [Pa].
    lower, upper
        Limits of both pressures [Pa].

    Returns
    -------
    tuple
        Pressures [Pa], and whether a limit was met.

    Examples
    --------
    >>> [float(p) for p in prioritise_differential(1e5, 2e5, (0.0, 0.0), (6e5, 2.5e5))[0]]  # p2 at its limit
    [50000.0, 250000.0]
    """
    attained = jnp.clip(differential, (lower[1] - upper[0]) / 2, (upper[1] - lower[0]) / 2)
    begin = jnp.maximum(lower[0] + attained, lower[1] - attained)
    end = jnp.minimum(upper[0] + attained, upper[1] - attained)
    mean = jnp.maximum(jnp.minimum(cocontraction, end), begin)
    pressures = jnp.clip(mean - attained, lower[0], upper[0]), jnp.clip(mean + attained, lower[1], upper[1])
    return pressures, (attained != differential) | (mean != cocontraction)


def limit_commands(
    model: AntagonisticJoint,
    minimum_tension: ArrayLike | None,
    angle: ArrayLike,
    differential: ArrayLike,
    cocontraction: ArrayLike,
) -> tuple[Pair, Array]:
    """Commands for a differential pressure and a co-contraction, and whether a limit was met.

    Parameters
    ----------
    model
        Model of the joint, with the limits of its muscles.
    minimum_tension
        Least tension of each muscle [N], which limits the pressures together; None to clip each command alone.
    angle
        Joint angle [rad].
    differential, cocontraction
        Half-difference and mean of the pressures [Pa].
    """
    if minimum_tension is not None:
        limits = pressure_range(model, angle, minimum_tension)
        return prioritise_differential(differential, cocontraction, *limits)
    return clip_commands(model, (cocontraction - jnp.asarray(differential), cocontraction + jnp.asarray(differential)))


def achieved(model: AntagonisticJoint, commands: Pair, cocontraction: ArrayLike) -> Pair:
    """Differential pressure and co-contraction [Pa] of commands; with a spring the co-contraction is as requested."""
    command1, command2 = commands
    if model.springs[0]:
        return command2 - jnp.asarray(cocontraction), jnp.asarray(cocontraction)
    if model.springs[1]:
        return jnp.asarray(cocontraction) - command1, jnp.asarray(cocontraction)
    return (command2 - command1) / 2, (command1 + command2) / 2


def clip_commands(model: AntagonisticJoint, commands: tuple[ArrayLike, ArrayLike]) -> tuple[Pair, Array]:
    """Commands [Pa] clipped to the pressures of the model's domains, and whether a limit was met."""
    (low1, low2), (high1, high2) = pressure_limits_of(model)
    clipped = jnp.clip(commands[0], low1, high1), jnp.clip(commands[1], low2, high2)
    limited = [clipped[i] != commands[i] for i, spring in enumerate(model.springs) if not spring]
    return clipped, limited[0] if len(limited) == 1 else limited[0] | limited[1]


def linearise(joint: AntagonisticJoint, angle: ArrayLike, pressures: Pair) -> TorqueStiffnessMap:
    """Torque and stiffness of taut muscles over the pressures [Pa]; the secant where they are not affine."""
    if is_affine(joint):
        return joint.affine_map(angle)
    pressure1, pressure2 = (jnp.stack([p, p, p]) for p in pressures)
    pressure1, pressure2 = pressure1.at[1].add(_SECANT), pressure2.at[2].add(_SECANT)
    samples = joint.evaluate(jnp.broadcast_to(angle, (3,)), (pressure1, pressure2))

    def through(values: Array) -> AffineMap:
        slope1, slope2 = (values[1] - values[0]) / _SECANT, (values[2] - values[0]) / _SECANT
        return AffineMap(values[0] - slope1 * pressure1[0] - slope2 * pressure2[0], slope1, slope2)

    return TorqueStiffnessMap(*map(through, samples))


@cached_trace
def pressure_range(joint: AntagonisticJoint, angle: ArrayLike, minimum_tension: ArrayLike) -> tuple[Pair, Pair]:
    """Lowest and highest pressures [Pa] at an angle [rad], for tensions from a minimum [N] to the rating."""
    (low1, low2), (high1, high2) = pressure_limits_of(joint)
    paths = joint.geometry.path_lengths(angle)

    def of_muscle(i: int, low: Scalar, high: Scalar) -> tuple[Scalar, Scalar]:
        muscle, tendon, path = (joint.muscle1, joint.muscle2)[i], joint.tendon, paths[i]
        rated = muscle.specimen.rated_force
        least, greatest = tendon.tension(muscle, jnp.stack([path, path]), jnp.stack([low, high]))
        highest = high if rated is None else jnp.where(greatest > rated, tendon.pressure_for(muscle, path, rated), high)
        lowest = jnp.where(least < minimum_tension, tendon.pressure_for(muscle, path, minimum_tension), low)
        highest = jnp.clip(highest, low, high)
        return jnp.clip(lowest, low, highest), highest

    (lowest1, highest1), (lowest2, highest2) = of_muscle(0, low1, high1), of_muscle(1, low2, high2)
    return (lowest1, lowest2), (highest1, highest2)


def keep_taut(pressures: Pair, lowest: Pair) -> Pair:
    """Nearest pressures at or above the lowest [Pa]."""
    return jnp.maximum(pressures[0], lowest[0]), jnp.maximum(pressures[1], lowest[1])
