"""The friction of a joint's muscles: what they remember of the way, and what that adds to torque and tensions.

All else that is known of a joint (its torque and stiffness, what it attains) is that of its muscles' laws. A joint
without friction passes through here as it is, at no cost. What its muscles' creep has come to may be given along
(`mckibben.joint.creep`); else they have none.
"""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, ArrayLike

from mckibben.joint.antagonistic import AntagonisticJoint
from mckibben.joint.creep import NONE, Relaxings, creep_torque, has_creep
from mckibben.joint.geometry import Pair
from mckibben.muscle import Memory, NoFriction
from mckibben.muscle.muscle import GrippedMuscle
from mckibben.numerics.elementary import floating

Memories = tuple[Memory, Memory]
"""What muscles 1 and 2 remember; empty tuples without friction."""


class Pull(NamedTuple):
    """What the muscles do, friction and creep included: tensions [N], torque [N*m] and contractions [-]."""

    tensions: Pair
    torque: Array
    contractions: Pair


def has_friction(joint: AntagonisticJoint) -> bool:
    """Whether a muscle of the joint has friction."""
    return not all(isinstance(muscle.friction, NoFriction) for muscle in (joint.muscle1, joint.muscle2))


def plain(joint: AntagonisticJoint) -> bool:
    """Whether the muscles of the joint are their laws: neither friction nor creep."""
    return not (has_friction(joint) or has_creep(joint))


def gripped(joint: AntagonisticJoint, memories: Memories, relaxing: Relaxings = NONE) -> AntagonisticJoint:
    """The joint with the rate-independent friction of its muscles as they remember the way, for short moves."""
    if plain(joint):
        return joint
    (memory1, memory2), (relaxing1, relaxing2) = memories, relaxing
    return dataclasses.replace(
        joint,
        muscle1=joint.muscle1.gripped(memory1, relaxing1),
        muscle2=joint.muscle2.gripped(memory2, relaxing2),
    )


def unstressed(joint: AntagonisticJoint, angle: ArrayLike, pressures: tuple[ArrayLike, ArrayLike]) -> Memories:
    """What is remembered where an angle [rad] was come to at those pressures [Pa] without friction."""
    if not has_friction(joint):
        return (), ()
    contraction1, contraction2 = joint.contractions(angle, pressures)
    muscle1, muscle2 = joint.muscle1, joint.muscle2
    return (
        muscle1.friction.unstressed(muscle1.specimen.length_at(contraction1)),
        muscle2.friction.unstressed(muscle2.specimen.length_at(contraction2)),
    )


def settled(
    joint: AntagonisticJoint, memories: Memories, angle: ArrayLike, pressures: tuple[ArrayLike, ArrayLike]
) -> Memories:
    """What is remembered after a short move to an angle [rad] and pressures [Pa]; the forces there stay as they are."""
    if not has_friction(joint):
        return memories
    contraction1, contraction2 = gripped(joint, memories).contractions(angle, pressures)
    return (
        joint.muscle1.settled(memories[0], contraction1, pressures[0]),
        joint.muscle2.settled(memories[1], contraction2, pressures[1]),
    )


def pull(
    joint: AntagonisticJoint,
    memories: Memories,
    angle: ArrayLike,
    velocity: ArrayLike,
    pressures: tuple[ArrayLike, ArrayLike],
    relaxing: Relaxings = NONE,
) -> Pull:
    """What the muscles do at an angle [rad], an angular velocity [rad/s] and gauge pressures [Pa]."""
    gripped1, gripped2 = (
        joint.muscle1.gripped(memories[0], relaxing[0]),
        joint.muscle2.gripped(memories[1], relaxing[1]),
    )
    (path1, path2), (arm1, arm2) = joint.geometry.paths_and_arms(angle)
    velocity = floating(velocity)

    def one(muscle: GrippedMuscle, path: Array, rate: Array, pressure: ArrayLike) -> tuple[Array, Array]:
        contraction = joint.tendon.contraction(muscle, path, pressure)
        tension = muscle.tension(contraction, pressure)
        return tension + muscle.viscous_force(contraction, pressure, rate), contraction

    tension1, contraction1 = one(gripped1, path1, arm1 * velocity, pressures[0])  # 1 lengthens as the angle grows
    tension2, contraction2 = one(gripped2, path2, -arm2 * velocity, pressures[1])
    return Pull((tension1, tension2), tension2 * arm2 - tension1 * arm1, (contraction1, contraction2))


def friction_torque(
    joint: AntagonisticJoint,
    memories: Memories,
    angle: ArrayLike,
    velocity: ArrayLike,
    pressures: tuple[ArrayLike, ArrayLike],
    relaxing: Relaxings = NONE,
) -> Array:
    """What friction adds to the muscles' torque [N*m]; arguments as for `pull`."""
    whole = jnp.asarray(pull(joint, memories, angle, velocity, pressures, relaxing).torque)
    added = whole - joint.torque(angle, pressures)
    return added - creep_torque(joint, relaxing, angle, pressures) if has_creep(joint) else added
