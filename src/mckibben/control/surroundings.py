"""What a model says of the joint around where it is: a look ahead needs to know how things change with the angle."""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, ArrayLike, Float

from mckibben.control.inversion import map_at, pressures_between
from mckibben.joint import AffineMap, AntagonisticJoint, TorqueStiffnessMap
from mckibben.joint.attainable import is_affine
from mckibben.joint.geometry import Pair

Scalar = Float[Array, ""]

_ASIDE = 0.02  # rad: where the model is asked a second time, to tell how it changes with the angle


class Surroundings(NamedTuple):
    """What a model says of the joint at an angle, and how it changes with the angle.

    Attributes
    ----------
    torque, softening
        Torque over the pressures, of taut muscles, and how it falls with the angle.
    stiffness, stiffness_slope
        The same of the stiffness, and how it grows.
    lowest, highest, lowest_slope, highest_slope
        Limits of the pressures.
    """

    torque: AffineMap
    softening: AffineMap
    stiffness: AffineMap
    stiffness_slope: AffineMap
    lowest: Pair
    highest: Pair
    lowest_slope: Pair
    highest_slope: Pair


def surroundings(
    model: AntagonisticJoint, angle: Scalar, pressures: Pair, *, minimum_tension: ArrayLike
) -> Surroundings:
    """What a model says of the joint about an angle [rad] and pressures [Pa], no muscle below a tension [N]."""

    def at(angle: Scalar) -> tuple[TorqueStiffnessMap, Pair, Pair]:
        lowest, highest = pressures_between(model, angle, minimum_tension)
        return map_at(model, angle, _taut(pressures, lowest)), lowest, highest

    both = lax.map(at, jnp.stack([angle, angle + _ASIDE]))  # a loop: half of the code to compile
    (torque, stiffness), lowest, highest = jax.tree.map(lambda values: values[0], both)
    (_, stiffness_slope), *limit_slopes = jax.tree.map(lambda values: (values[1] - values[0]) / _ASIDE, both)
    softening = stiffness
    if not is_affine(model):  # a secant across the stop of a spring says nothing of other pressures
        nothing = jnp.zeros_like(angle)
        softening = AffineMap(stiffness(_taut(pressures, lowest)), nothing, nothing)
        stiffness_slope = AffineMap(nothing, nothing, nothing)
    return Surroundings(torque, softening, stiffness, stiffness_slope, lowest, highest, *limit_slopes)


def _taut(pressures: Pair, lowest: Pair) -> Pair:
    """The nearest pressures that keep both muscles taut."""
    return jnp.maximum(pressures[0], lowest[0]), jnp.maximum(pressures[1], lowest[1])
