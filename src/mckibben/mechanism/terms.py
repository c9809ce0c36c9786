"""Torques, stiffness and tensions of a robot, affine in the pressures of its muscles."""

from __future__ import annotations

import functools
import itertools
from collections.abc import Sequence
from typing import NamedTuple, cast

import jax.numpy as jnp
from jaxtyping import Array, Float

from mckibben.mechanism.robot import Robot
from mckibben.muscle import PressureAffineLaw
from mckibben.numerics.calculus import value_and_derivative
from mckibben.numerics.elementary import Number
from mckibben.numerics.spatial import total
from mckibben.units import bar

Scalar = Float[Array, ""]
Row = dict[int, tuple[Number, Number]]
"""Offset, and slope over its pressure [1/Pa], that each muscle by its number adds to a sum."""


class JointTerms(NamedTuple):
    """Torque [N*m] of each joint, and tension [N] of each muscle, affine in the pressures.

    The `stiffness` [N*m/rad] is minus the derivative of the torque of a joint by an angle, for pairs in their order.
    """

    torque: list[Row]
    stiffness: dict[tuple[int, int], Row]
    tension: list[tuple[Number, Number]]

    def torque_at(self, pressures: Sequence[Array]) -> tuple[Array, ...]:
        """Return the torques [N*m] at gauge pressures [Pa]."""
        return tuple(_sum(row, pressures) for row in self.torque)

    def stiffness_at(self, pressures: Sequence[Array]) -> tuple[Array, ...]:
        """Return the stiffness [N*m/rad] of each joint, the others held, at gauge pressures [Pa]."""
        return tuple(_sum(self.stiffness.get((i, i), {}), pressures) for i in range(len(self.torque)))

    def errors(
        self,
        torques: Sequence[Number],
        stiffness: Sequence[Number],
        weight: float,
        centred: float,
        lower: Sequence[Array],
        upper: Sequence[Array],
    ) -> tuple[list[dict[int, Number]], list[Number]]:
        """Return rows, over pressures in bar, and right sides of the weighted errors."""
        rows, right = [], []
        for row, wanted in zip(self.torque, torques, strict=True):
            slopes = {m: gain * bar for m, (_, gain) in row.items()}
            scale = weight / jnp.sqrt(functools.reduce(total, (one * one for one in slopes.values())))
            rows.append({m: one * scale for m, one in slopes.items()})
            right.append((wanted - offset_of(row)) * scale)
        for joint, wanted in enumerate(stiffness):
            row = self.stiffness[joint, joint]
            rows.append({m: gain * bar / wanted for m, (_, gain) in row.items()})
            right.append(1 - offset_of(row) / wanted)
        for m, (low, high) in enumerate(zip(lower, upper, strict=True)):
            rows.append({m: centred})
            right.append(centred / (2 * bar) * (low + high))
        return rows, right


def joint_terms(robot: Robot, angles: Sequence[Number]) -> JointTerms:
    """Return the terms of a robot whose laws are affine in pressure at angles [rad]."""
    tension: list[tuple[Number, Number]] = []
    torque: list[Row] = [{} for _ in angles]
    stiffness: dict[tuple[int, int], Row] = {}
    for number, unit in enumerate(robot.routed_muscles(angles)):
        law = cast(PressureAffineLaw, unit.muscle.force_law)
        terms, slopes = value_and_derivative(
            lambda path, unit=unit, law=law: law.pressure_terms(unit.muscle.specimen.contraction_at(path)), unit.path
        )
        tension.append(terms)
        for joint, arm in unit.slopes.items():
            torque[joint][number] = -arm * terms[0], -arm * terms[1]
        over = sorted(unit.slopes)
        bends = unit.bends()
        for i, j in itertools.combinations_with_replacement(over, 2):
            arms, bend = unit.slopes[i] * unit.slopes[j], bends.get((i, j), 0.0)
            stiffness.setdefault((i, j), {})[number] = (
                slopes[0] * arms + terms[0] * bend,
                slopes[1] * arms + terms[1] * bend,
            )
    return JointTerms(torque, stiffness, tension)


def offset_of(row: Row) -> Number:
    """Return the value of a row at zero pressures."""
    return functools.reduce(total, (offset for offset, _ in row.values()), 0.0)


def _sum(row: Row, pressures: Sequence[Array]) -> Array:
    return jnp.asarray(functools.reduce(total, (gain * pressures[m] for m, (_, gain) in row.items()), offset_of(row)))
