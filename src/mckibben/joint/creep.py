"""The creep of a joint's muscles: what is relaxing in each, how it changes, and what it adds to the torque."""

from __future__ import annotations

from jaxtyping import Array, ArrayLike

from mckibben.joint.antagonistic import AntagonisticJoint
from mckibben.muscle import NoCreep, Relaxing

Relaxings = tuple[Relaxing, Relaxing]
"""What is relaxing in muscles 1 and 2; empty tuples without creep."""

NONE: Relaxings = ((), ())


def has_creep(joint: AntagonisticJoint) -> bool:
    """Whether a muscle of the joint has creep."""
    return not all(isinstance(muscle.creep, NoCreep) for muscle in (joint.muscle1, joint.muscle2))


def relaxed(joint: AntagonisticJoint, angle: ArrayLike) -> Relaxings:
    """What is relaxing where the joint has been at an angle [rad] for long."""
    path1, path2 = joint.geometry.path_lengths(angle)
    return joint.muscle1.creep.relaxed(path1), joint.muscle2.creep.relaxed(path2)


def rates(joint: AntagonisticJoint, relaxing: Relaxings, angle: ArrayLike, velocity: ArrayLike) -> Relaxings:
    """The derivatives [N/s] of what is relaxing, at an angle [rad] and an angular velocity [rad/s]."""
    arm1, arm2 = joint.geometry.moment_arms(angle)
    return (
        joint.muscle1.creep.rate(relaxing[0], arm1 * velocity),  # muscle 1 lengthens as the angle grows
        joint.muscle2.creep.rate(relaxing[1], -arm2 * velocity),
    )


def settled(
    joint: AntagonisticJoint, relaxing: Relaxings, angle: ArrayLike, pressures: tuple[ArrayLike, ArrayLike]
) -> Relaxings:
    """What is relaxing after a short move to an angle [rad] and pressures [Pa]; the forces there stay as they are."""
    tension1, tension2 = joint.tensions(angle, pressures)
    return joint.muscle1.creep.settled(relaxing[0], tension1), joint.muscle2.creep.settled(relaxing[1], tension2)


def creep_torque(
    joint: AntagonisticJoint, relaxing: Relaxings, angle: ArrayLike, pressures: tuple[ArrayLike, ArrayLike]
) -> Array:
    """What creep adds to the muscles' torque [N*m]."""
    tension1, tension2 = joint.tensions(angle, pressures)
    arm1, arm2 = joint.geometry.moment_arms(angle)
    return (
        joint.muscle2.creep.force(relaxing[1], tension2) * arm2
        - joint.muscle1.creep.force(relaxing[0], tension1) * arm1
    )
