"""Pressures for a commanded torque and stiffness, within limits."""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float

from mckibben.joint import AffineMap, AntagonisticJoint, TorqueStiffnessMap
from mckibben.joint.attainable import is_affine, pressure_limits_of
from mckibben.joint.geometry import Pair

Scalar = Float[Array, ""]

_APART = 5e3  # Pa: of the points of a secant; more than rounding to 32 bits, less than a law bends over


class Chosen(NamedTuple):
    """Pressures [Pa] within limits, the torque [N*m] that they give, and whether a wish had to be cut off."""

    pressures: Pair
    torque: Scalar
    cut: Array


def torque_first(
    affine: TorqueStiffnessMap, torque: ArrayLike, stiffness: ArrayLike, lower: Pair, upper: Pair
) -> Chosen:
    r"""The pressures within limits that give a torque, and of these the ones with the nearest stiffness.

    Torque and stiffness are affine in the pressures. The torque leaves a line, along which both pressures rise
    together; its part within the limits is a segment, and the place of the stiffness on the line is moved into it. A
    torque beyond the limits becomes the nearest within: one muscle at its highest, the other at its lowest pressure.

    Parameters
    ----------
    affine
        Torque falls with p1 and rises with p2.
    torque, stiffness
        What is wanted [N*m], [N*m/rad].
    lower, upper
        Limits [Pa] of each pressure.

    Examples
    --------
    >>> from mckibben import catalog
    >>> from mckibben.units import bar
    >>> knee = catalog.joint("knee-table-2")
    >>> limits = (1 * bar, 1 * bar), (4 * bar, 4 * bar)
    >>> (p1, p2), torque, cut = torque_first(knee.affine_map(0.0), 2.0, 72.2, *limits)
    >>> round(float(p1) / bar, 3), round(float(p2) / bar, 3), bool(cut)
    (2.121, 2.817, False)
    >>> (p1, p2), torque, cut = torque_first(knee.affine_map(0.0), 2.0, 60.0, *limits)
    >>> round(float(p1) / bar, 3), round(float(p2) / bar, 3), round(float(torque), 6), bool(cut)
    (3.304, 4.0, 2.0, True)
    """
    (torque0, by1, by2), (stiffness0, stiffness1, stiffness2) = affine.torque, affine.stiffness
    least = torque0 + by1 * upper[0] + by2 * lower[1]
    most = torque0 + by1 * lower[0] + by2 * upper[1]
    given = jnp.clip(torque, least, most)

    def first(second: ArrayLike) -> Scalar:
        """The pressure of muscle 1 that goes with one of muscle 2."""
        return (given - torque0 - by2 * second) / by1

    # Along the line p2 = at_zero + along p1, with `along` above zero.
    along = -by1 / by2
    at_zero = (given - torque0) / by2
    rise = stiffness1 + stiffness2 * along
    flat = jnp.abs(rise) * (upper[0] - lower[0]) < 1e-6 * jnp.abs(stiffness0)
    wanted = (stiffness - stiffness0 - stiffness2 * at_zero) / jnp.where(flat, 1.0, rise)
    wanted = jnp.where(flat, (lower[0] + upper[0]) / 2, wanted)  # no pressure changes the stiffness
    begin, end = jnp.maximum(lower[0], first(lower[1])), jnp.minimum(upper[0], first(upper[1]))
    pressure1 = jnp.maximum(jnp.minimum(wanted, end), begin)
    pressure2 = jnp.clip(at_zero + along * pressure1, lower[1], upper[1])
    return Chosen((pressure1, pressure2), given, (given != torque) | (pressure1 != wanted))


def differential_first(
    differential: ArrayLike, cocontraction: ArrayLike, lower: Pair, upper: Pair
) -> tuple[Pair, Array]:
    """The pressures [Pa] within limits that keep a differential pressure, as near to a co-contraction as they let it.

    A differential pressure beyond the limits becomes the nearest within: one muscle at its highest, the other at its
    lowest pressure.

    Parameters
    ----------
    differential, cocontraction
        What is wanted [Pa]: p1 = pc - pd, p2 = pc + pd.
    lower, upper
        Limits [Pa] of each pressure.

    Returns
    -------
    pressures, cut
        (p1, p2), and whether a wish had to be cut off.

    Examples
    --------
    >>> (p1, p2), cut = differential_first(0.5, 1.0, (1.2, 0.0), (6.0, 6.0))
    >>> round(float(p1), 3), round(float(p2), 3), bool(cut)
    (1.2, 2.2, True)
    """
    given = jnp.clip(differential, (lower[1] - upper[0]) / 2, (upper[1] - lower[0]) / 2)
    begin = jnp.maximum(lower[0] + given, lower[1] - given)
    end = jnp.minimum(upper[0] + given, upper[1] - given)
    middle = jnp.maximum(jnp.minimum(cocontraction, end), begin)
    pressures = jnp.clip(middle - given, lower[0], upper[0]), jnp.clip(middle + given, lower[1], upper[1])
    return pressures, (given != differential) | (middle != cocontraction)


def map_at(joint: AntagonisticJoint, angle: ArrayLike, pressures: Pair) -> TorqueStiffnessMap:
    """Torque and stiffness at an angle [rad] over the pressures: exact where affine, else a secant from those [Pa] up.

    The muscles have to be taut there: the force of a slack one does not change.
    """
    if is_affine(joint):
        return joint.affine_map(angle)
    pressure1, pressure2 = (jnp.stack([p, p, p]) for p in pressures)
    pressure1, pressure2 = pressure1.at[1].add(_APART), pressure2.at[2].add(_APART)
    at_points = joint.torque_and_stiffness(jnp.broadcast_to(angle, (3,)), (pressure1, pressure2))

    def through(values: Array) -> AffineMap:
        slope1, slope2 = (values[1] - values[0]) / _APART, (values[2] - values[0]) / _APART
        return AffineMap(values[0] - slope1 * pressure1[0] - slope2 * pressure2[0], slope1, slope2)

    return TorqueStiffnessMap(*map(through, at_points))


def pressures_between(joint: AntagonisticJoint, angle: ArrayLike, minimum_tension: ArrayLike) -> tuple[Pair, Pair]:
    """The lowest and highest pressures [Pa] at an angle [rad].

    They are those of the muscles' domains, and keep each tension above a minimum [N] and below the specimen's rating;
    where both cannot be had, the highest counts.
    """
    (low1, low2), (high1, high2) = pressure_limits_of(joint)
    paths = joint.geometry.path_lengths(angle)

    def between(i: int, low: Scalar, high: Scalar) -> tuple[Scalar, Scalar]:
        muscle, tendon, path = (joint.muscle1, joint.muscle2)[i], joint.tendon, paths[i]
        rated = muscle.specimen.rated_force
        slackest, tightest = tendon.tension(muscle, jnp.stack([path, path]), jnp.stack([low, high]))
        too_little, too_much = slackest < minimum_tension, tightest > rated
        highest = jnp.where(too_much, tendon.pressure_for(muscle, path, rated), high)
        lowest = jnp.where(too_little, tendon.pressure_for(muscle, path, minimum_tension), low)
        highest = jnp.clip(highest, low, high)
        return jnp.clip(lowest, low, highest), highest

    (lowest1, highest1), (lowest2, highest2) = between(0, low1, high1), between(1, low2, high2)
    return (lowest1, lowest2), (highest1, highest2)
