"""Constraints of a joint that is sized, their margins over a motion, and the friction of its muscles."""

from __future__ import annotations

import jax.numpy as jnp
from jaxtyping import Array, ArrayLike

from mckibben.joint import Geometry
from mckibben.joint.attainable import pressure_limits_of
from mckibben.muscle import Muscle
from mckibben.numerics.calculus import derivative
from mckibben.numerics.compiled import jit
from mckibben.numerics.elementary import floating
from mckibben.plant import JointPlant
from mckibben.units import percent

CONSTRAINTS = (
    *(f"{end} contraction of muscle {i}" for end in ("minimum", "maximum") for i in (1, 2)),
    "attainable torque",
    "lowest attainable stiffness",
    "highest attainable stiffness",
)
"""Constraints of a sized joint, in the order of `constraint_margins`."""


def constraint_margins(
    plant: JointPlant, angle: ArrayLike, stiffness: ArrayLike, torque_reserve: ArrayLike, minimum_tension: ArrayLike
) -> Array:
    """Margins of `CONSTRAINTS`, shape (7, 2 torques, angles); negative where violated.

    Units: 1 % of contraction, 10 N of tension, and 5 % of the highest required stiffness.

    Parameters
    ----------
    plant
        Joint with laws affine in pressure and rigid tendons, its load, and valves.
    angle
        Angles of the motion [rad], shape (angles,).
    stiffness
        Lowest and highest required stiffness [N*m/rad].
    torque_reserve
        Torque in either direction in excess of gravity [N*m].
    minimum_tension
        Least tension of both muscles [N].
    """
    angle, stiffness, torque_reserve = floating(angle), floating(stiffness), floating(torque_reserve)
    joint = plant.supplied_joint
    paths, (arm1, arm2) = joint.geometry.paths_and_arms(angle)
    muscles, (lowest, highest) = (joint.muscle1, joint.muscle2), pressure_limits_of(joint)
    contractions = [muscle.specimen.contraction_at(path) for muscle, path in zip(muscles, paths, strict=True)]
    low = [jnp.maximum(m.tension(e, p), minimum_tension) for m, e, p in zip(muscles, contractions, lowest, strict=True)]
    high = [
        jnp.minimum(m.tension(e, p), m.specimen.force_limit)
        for m, e, p in zip(muscles, contractions, highest, strict=True)
    ]
    torque = jnp.stack([-torque_reserve, torque_reserve])[:, None] - plant.load.gravity_torque(angle)
    first = jnp.maximum(low[0], (low[1] * arm2 - torque) / arm1)
    last = jnp.minimum(high[0], (high[1] * arm2 - torque) / arm1)
    tension_range = jnp.minimum(last - first, jnp.minimum(high[0] - low[0], high[1] - low[1]))

    def stiffness_at(tension1: Array) -> Array:
        tension2 = (torque + tension1 * arm1) / arm2
        pressures = (
            muscles[0].force_law.pressure_for(tension1, contractions[0]),
            muscles[1].force_law.pressure_for(tension2, contractions[1]),
        )
        return _unclipped_stiffness(joint.geometry, muscles, angle, pressures)

    ends = stiffness_at(first), stiffness_at(last)
    scale = 0.05 * jnp.maximum(jnp.abs(stiffness[1]), 1.0)
    margins = [
        *((e - m.domain.contraction_min) / (1 * percent) for m, e in zip(muscles, contractions, strict=True)),
        *((m.domain.contraction_max - e) / (1 * percent) for m, e in zip(muscles, contractions, strict=True)),
        tension_range / 10.0,
        (stiffness[0] - jnp.minimum(*ends)) / scale,
        (jnp.maximum(*ends) - stiffness[1]) / scale,
    ]
    return jnp.stack([jnp.broadcast_to(margin, torque.shape) for margin in margins])


def _unclipped_stiffness(
    geometry: Geometry, muscles: tuple[Muscle, Muscle], angle: Array, pressures: tuple[Array, Array]
) -> Array:
    """Stiffness from laws that may become negative, smooth beyond the attainable set."""

    def torque(angle: Array) -> Array:
        paths, (arm1, arm2) = geometry.paths_and_arms(angle)
        pulls = [
            muscle.force_law.force(muscle.specimen.contraction_at(path), pressure)
            for muscle, path, pressure in zip(muscles, paths, pressures, strict=True)
        ]
        return pulls[1] * arm2 - pulls[0] * arm1

    return -derivative(torque, jnp.broadcast_to(angle, pressures[0].shape))


def friction_torque(
    plant: JointPlant, angle: ArrayLike, speed: ArrayLike, minimum_tension: float
) -> tuple[Array, Array]:
    """Return the largest torque [N*m] of both muscles' friction over angles [rad], at a speed [rad/s].

    The first has one muscle at its highest pressure and the other at its lowest, as for the largest torque; in the
    second each muscle has the pressure with more friction.
    """
    joint = plant.supplied_joint
    paths, arms = joint.geometry.paths_and_arms(floating(angle))
    torques = []
    for muscle, path, arm, *pressures in zip(
        (joint.muscle1, joint.muscle2), paths, arms, *pressure_limits_of(joint), strict=True
    ):
        contraction = muscle.specimen.contraction_at(path)
        length = muscle.specimen.length_at(contraction)
        for pressure in pressures:
            tension = jnp.maximum(muscle.tension(contraction, pressure), minimum_tension)
            sliding = muscle.friction.half_width_at(tension, pressure)
            viscous = muscle.friction.viscous_force(length, tension, pressure, arm * speed)
            torques.append(arm * (sliding + viscous))
    low1, high1, low2, high2 = torques
    opposed = jnp.maximum(low1 + high2, high1 + low2)
    return jnp.max(opposed), jnp.max(jnp.maximum(low1, high1) + jnp.maximum(low2, high2))


@jit
def attained_stiffness(
    plant: JointPlant, angle: ArrayLike, reserve: ArrayLike, minimum_tension: float
) -> tuple[Array, Array]:
    """Lowest and highest stiffness [N*m/rad] attainable at both torques of a reserve [N*m], over angles [rad]."""
    torque = floating(reserve) * jnp.array([-1.0, 1.0])[:, None] - plant.load.gravity_torque(angle)
    lowest, highest = plant.supplied_joint.attainable_stiffness(angle, torque, minimum_tension=minimum_tension)
    return jnp.max(lowest, axis=0), jnp.min(highest, axis=0)
