"""Torques, stiffness and tensions at a posture as affine functions of the pressures of taut muscles."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike
from numpy.typing import NDArray

from mckibben.errors import RangeError
from mckibben.joint import RigidTendon
from mckibben.muscle import PressureAffineLaw
from mckibben.numerics.compiled import jit
from mckibben.robot.mechanism import Robot

Floats = NDArray[np.float64]


class StiffnessMap(NamedTuple):
    """Torques, stiffness and tensions at a posture, affine in the pressures of taut muscles: offset + slope p.

    Torques [N*m] of the joints, (joints,) and (joints, muscles); stiffness matrix [N*m/rad], minus the derivative of
    the torques, (joints, joints) and (joints, joints, muscles); tensions [N], (muscles,), each by its own pressure.
    """

    torque: tuple[Floats, Floats]
    stiffness: tuple[Floats, Floats]
    tension: tuple[Floats, Floats]

    def torque_at(self, pressures: ArrayLike) -> Floats:
        """Return the torques [N*m] at gauge pressures [Pa]."""
        return self.torque[0] + self.torque[1] @ np.asarray(pressures, float)

    def stiffness_at(self, pressures: ArrayLike) -> Floats:
        """Return the stiffness matrix [N*m/rad] at gauge pressures [Pa]."""
        return self.stiffness[0] + self.stiffness[1] @ np.asarray(pressures, float)


def map_at(robot: Robot, angles: Sequence[float]) -> StiffnessMap:
    """Return the map at angles [rad] of a robot that `check_affine` accepts."""
    (torque, gain, offset, slope), (stiffness, coupling) = _affine(robot, tuple(map(float, angles)))
    return StiffnessMap(
        (np.asarray(torque), np.asarray(gain)),
        (-np.asarray(stiffness), -np.asarray(coupling).transpose(0, 2, 1)),
        (np.asarray(offset), np.asarray(slope)),
    )


def check_affine(robot: Robot) -> None:
    """Raise `RangeError` unless laws are affine in pressure and tendons rigid."""
    for name, kind in _not_affine(robot):
        raise RangeError(
            f"{name}: with a {kind} the stiffness is not affine in the pressures",
            field="muscle",
            value=kind,
            remedy="give it a law that is affine in pressure, and a rigid tendon",
        )


def is_affine(robot: Robot) -> bool:
    """Whether laws are affine in pressure and tendons rigid."""
    return not any(_not_affine(robot))


def _not_affine(robot: Robot) -> Iterator[tuple[str, str]]:
    """Muscles, and the class of what is not affine in them."""
    for name, muscle, tendon in zip(robot.muscle_names, robot.all_muscles, robot.tendons, strict=True):
        for part, kind in ((muscle.law, PressureAffineLaw), (tendon, RigidTendon)):
            if not isinstance(part, kind):
                yield name, type(part).__name__


@jit
def _affine(robot: Robot, angles: tuple[ArrayLike, ...]) -> tuple[tuple[Array, ...], tuple[Array, Array]]:
    """Torques and tensions, offsets and slopes over the pressures; and the derivatives of the torques by the angles."""

    def terms(q: Array) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
        units = robot.routed_muscles(robot.held(tuple(q)))
        pairs = [
            unit.muscle.force_law.pressure_terms(unit.muscle.specimen.contraction_at(unit.path))  # type: ignore
            for unit in units
        ]
        offset, gain = (jnp.stack([jnp.asarray(one) for one in column]) for column in zip(*pairs, strict=True))
        zero = jnp.zeros(())
        arms = jnp.stack(
            [jnp.stack([-unit.slopes.get(joint, zero) for unit in units]) for joint in range(len(robot.joints))]
        )
        return (arms @ offset, arms * gain), (offset, gain)

    q = jnp.stack([jnp.asarray(one) for one in angles])
    (torque, gain), (offset, slope) = terms(q)
    stiffness, coupling = jax.jacfwd(lambda x: terms(x)[0])(q)
    return (torque, gain, offset, slope), (stiffness, coupling)
