r"""What a wish takes of a joint, as margins that are above zero where it is met, with derivatives by its lengths.

At each of 25 angles, and for each torque that is wanted there, everything that has to hold is a margin: that both
contractions stay in their domain, that there are tensions at all which give the torque, and that the stiffness at
either end of these tensions lies beyond the wanted range. Each is divided by a size that matters (1 % of contraction,
10 N, 5 % of the highest stiffness), so that the least of them can be made as large as it can be.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike

from mckibben.joint import KneeGeometry
from mckibben.joint.attainable import pressure_limits_of
from mckibben.muscle import Muscle
from mckibben.numerics.arrays import floating
from mckibben.numerics.compiled import compiled
from mckibben.numerics.derivative import derivative
from mckibben.plant import JointPlant
from mckibben.study.envelope.wanted import put
from mckibben.units import percent

ANGLES = 25
"""Angles of the wanted range that are looked at in a search."""

BROKEN = (
    "muscle 1 is stretched beyond its domain",
    "muscle 2 is stretched beyond its domain",
    "muscle 1 is contracted beyond its domain",
    "muscle 2 is contracted beyond its domain",
    "no tensions within limits give the torque",
    "the lowest attainable stiffness",
    "the highest attainable stiffness",
)
"""What each kind of margin below zero means."""

NEAR = (
    "stretching muscle 1",
    "stretching muscle 2",
    "contracting muscle 1",
    "contracting muscle 2",
    "the torque to be held",
    "the lowest stiffness",
    "the highest stiffness",
)
"""What each kind of margin stands for where it is met."""

_CONTRACTION, _TENSION, _STIFFNESS = 1 * percent, 10.0, 0.05


def margins(
    plant: JointPlant,
    lengths: dict[str, Array],
    angle: ArrayLike,
    stiffness: ArrayLike,
    torque: ArrayLike,
    minimum_tension: ArrayLike,
) -> Array:
    """Every margin, shape (7 kinds, 2 torques, angles), in the order of `BROKEN`.

    Parameters
    ----------
    plant
        Joint and load; laws affine in pressure, rigid tendons.
    lengths
        In place of the plant's own [m], by name.
    angle, stiffness
        Shape (angles,) [rad]; lowest and highest that are wanted [N*m/rad].
    torque, minimum_tension
        To spare either way [N*m]; what each muscle keeps [N].
    """
    angle, stiffness, torque = floating(angle), floating(stiffness), floating(torque)
    plant = put(plant, lengths)
    joint = plant.joint
    paths, (arm1, arm2) = joint.geometry.paths_and_arms(angle)
    muscles, (lowest, highest) = (joint.muscle1, joint.muscle2), pressure_limits_of(joint)
    contractions = [muscle.specimen.contraction_at(path) for muscle, path in zip(muscles, paths, strict=True)]
    low = [jnp.maximum(m.tension(e, p), minimum_tension) for m, e, p in zip(muscles, contractions, lowest, strict=True)]
    high = [
        jnp.minimum(m.tension(e, p), m.specimen.rated_force)
        for m, e, p in zip(muscles, contractions, highest, strict=True)
    ]
    held = jnp.stack([-torque, torque])[:, None] - plant.load.gravity_torque(angle)
    first = jnp.maximum(low[0], (low[1] * arm2 - held) / arm1)
    last = jnp.minimum(high[0], (high[1] * arm2 - held) / arm1)
    room = jnp.minimum(last - first, jnp.minimum(high[0] - low[0], high[1] - low[1]))

    def stiffness_at(tension1: Array) -> Array:
        tension2 = (held + tension1 * arm1) / arm2
        pressures = (
            muscles[0].pressure_for(tension1, contractions[0]),
            muscles[1].pressure_for(tension2, contractions[1]),
        )
        return _taut(joint.geometry, muscles, angle, pressures)

    ends = stiffness_at(first), stiffness_at(last)
    size = _STIFFNESS * jnp.maximum(jnp.abs(stiffness[1]), 1.0)
    each = [
        *((e - m.domain.contraction_min) / _CONTRACTION for m, e in zip(muscles, contractions, strict=True)),
        *((m.domain.contraction_max - e) / _CONTRACTION for m, e in zip(muscles, contractions, strict=True)),
        room / _TENSION,
        (stiffness[0] - jnp.minimum(*ends)) / size,
        (jnp.maximum(*ends) - stiffness[1]) / size,
    ]
    return jnp.stack([jnp.broadcast_to(margin, held.shape) for margin in each])


def _taut(
    geometry: KneeGeometry, muscles: tuple[Muscle, Muscle], angle: Array, pressures: tuple[Array, Array]
) -> Array:
    """The stiffness by the laws as they are, not cut off where they turn negative: smooth beyond what is attainable."""

    def torque(angle: Array) -> Array:
        paths, (arm1, arm2) = geometry.paths_and_arms(angle)
        pulls = [
            muscle.law.force(muscle.specimen.contraction_at(path), pressure)
            for muscle, path, pressure in zip(muscles, paths, pressures, strict=True)
        ]
        return pulls[1] * arm2 - pulls[0] * arm1

    return -derivative(torque, jnp.broadcast_to(angle, pressures[0].shape))


@compiled
def margins_and_slopes(
    plant: JointPlant,
    lengths: dict[str, float],
    angle: ArrayLike,
    stiffness: ArrayLike,
    torque: ArrayLike,
    minimum_tension: ArrayLike,
) -> tuple[Array, dict[str, Array]]:
    """The margins, and their derivatives by each length [1/m]."""

    def twice(lengths: dict[str, Array]) -> tuple[Array, Array]:
        values = margins(plant, lengths, angle, stiffness, torque, minimum_tension)
        return values, values

    slopes, values = jax.jacfwd(twice, has_aux=True)({name: floating(value) for name, value in lengths.items()})
    return values, slopes
