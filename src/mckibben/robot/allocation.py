"""Allocation of the pressures of all muscles within a control period: a bounded least-squares problem."""

from __future__ import annotations

import functools
import itertools
from collections.abc import Sequence
from typing import NamedTuple, cast

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

from mckibben.control.allocation import prioritise_torque
from mckibben.joint import AffineMap, TorqueStiffnessMap
from mckibben.muscle import PressureAffineLaw
from mckibben.numerics.calculus import value_and_derivative
from mckibben.numerics.elementary import Number
from mckibben.numerics.spatial import product, total
from mckibben.robot.mechanism import Robot
from mckibben.robot.tree import solve_symmetric
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
            right.append((wanted - _offset(row)) * scale)
        for joint, wanted in enumerate(stiffness):
            row = self.stiffness[joint, joint]
            rows.append({m: gain * bar / wanted for m, (_, gain) in row.items()})
            right.append(1 - _offset(row) / wanted)
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


def _offset(row: Row) -> Number:
    return functools.reduce(total, (offset for offset, _ in row.values()), 0.0)


def _sum(row: Row, pressures: Sequence[Array]) -> Array:
    return jnp.asarray(functools.reduce(total, (gain * pressures[m] for m, (_, gain) in row.items()), _offset(row)))


class BoundedSolution(NamedTuple):
    """Solution of a bounded least-squares problem.

    Attributes
    ----------
    values
        The unknowns.
    active
        -1 of an unknown at its lower limit, 1 at its upper, 0 between.
    gap
        Certificate: the sum of squares is at most this far above its least value within the limits.
    """

    values: tuple[Scalar, ...]
    active: tuple[Scalar, ...]
    gap: Scalar


def allocate_pairs(
    terms: JointTerms,
    torques: Sequence[Number],
    stiffness: Sequence[Number],
    lower: Sequence[Array],
    upper: Sequence[Array],
    springs: Sequence[tuple[bool, bool]],
) -> BoundedSolution:
    """Return the pressures [bar] of robots whose muscles are a pair of each joint, in closed form.

    The torque of each joint [N*m] has priority over its stiffness [N*m/rad]; see `prioritise_torque`.

    Parameters
    ----------
    lower, upper
        Limits of the pressures [Pa].
    springs
        Whether muscles 1 and 2 of each pair are return springs.
    """
    values: dict[int, Array] = {}
    for joint, row in enumerate(terms.torque):
        first, second = row

        def affine(row: Row) -> AffineMap:
            slopes = (jnp.asarray(row[muscle][1]) for muscle in (first, second))  # noqa: B023
            return AffineMap(jnp.asarray(_offset(row)), *slopes)

        both = TorqueStiffnessMap(affine(row), affine(terms.stiffness[joint, joint]))
        low, high = ((limit[first], limit[second]) for limit in (lower, upper))
        pressures = prioritise_torque(both, torques[joint], stiffness[joint], low, high, springs[joint]).pressures
        values[first], values[second] = pressures
    ordered = [values[muscle] for muscle in range(len(lower))]
    active = tuple(
        jnp.where(value <= low, -1.0, jnp.where(value >= high, 1.0, 0.0))
        for value, low, high in zip(ordered, lower, upper, strict=True)
    )
    return BoundedSolution(tuple(value / bar for value in ordered), active, jnp.zeros_like(ordered[0]))


def bounded_least_squares(
    rows: Sequence[dict[int, Number]],
    right: Sequence[Number],
    lower: Sequence[Array],
    upper: Sequence[Array],
    start: BoundedSolution,
    steps: int | None = None,
) -> BoundedSolution:
    """Return the least squares of ``rows @ x - right`` within limits, by a primal active set.

    Every step solves for the unknowns that are free, goes as far as the limits permit, and holds the unknown that meets
    one; where none does, it frees the held one whose release lowers the sum most. The number of steps is fixed, two
    for each unknown by default; each of them lowers the sum, and the gap tells what is left.

    Parameters
    ----------
    rows, right
        Factors by the number of the unknown, and right sides; of full rank.
    start
        Solution of a similar problem, such as that of the last period.

    References
    ----------
    J. Nocedal and S. J. Wright, Numerical Optimization, 2nd ed., Springer 2006, algorithm 16.3; the gap is that of a
    linear function below a convex one.
    """
    size = len(lower)
    matrix: list[list[Number]] = [[0.0] * (i + 1) for i in range(size)]
    for row in rows:
        for i, factor in row.items():
            for j, other in row.items():
                if j <= i:
                    matrix[i][j] = total(matrix[i][j], product(factor, other))

    def gradient(x: Sequence[Array]) -> list[Number]:
        slopes: list[Number] = [0.0] * size
        for row, value in zip(rows, right, strict=True):
            error = functools.reduce(total, (product(factor, x[i]) for i, factor in row.items())) - value
            for i, factor in row.items():
                slopes[i] = total(slopes[i], product(factor, error))
        return slopes

    def step(_: object, at: tuple[tuple[Array, ...], tuple[Array, ...]]) -> tuple[tuple[Array, ...], tuple[Array, ...]]:
        x, active = at
        free = [jnp.where(one == 0, 1.0, 0.0) for one in active]
        slopes = gradient(x)
        masked = [
            [product(entry, free[i] * free[j]) if j < i else entry for j, entry in enumerate(row)]
            for i, row in enumerate(matrix)
        ]
        solved = solve_symmetric(masked, [-one * slope for one, slope in zip(free, slopes, strict=True)])
        moves = [one * move for one, move in zip(free, solved, strict=True)]
        room = [
            jnp.where(move == 0, jnp.inf, (jnp.where(move > 0, high, low) - one) / jnp.where(move == 0, 1.0, move))
            for one, move, low, high in zip(x, moves, lower, upper, strict=True)
        ]
        share = jnp.minimum(functools.reduce(jnp.minimum, room), 1.0)
        blocks = [(one <= share) & (one < 1) for one in room]
        moved = tuple(
            jnp.where(block, jnp.where(move > 0, high, low), one + share * move)
            for one, move, block, low, high in zip(x, moves, blocks, lower, upper, strict=True)
        )
        gains = [
            jnp.where(low == high, 0.0, one * slope)
            for one, slope, low, high in zip(active, gradient(moved), lower, upper, strict=True)
        ]
        best = functools.reduce(jnp.maximum, gains)
        frees = (share >= 1) & (best > 0)
        active = tuple(
            jnp.where(block, jnp.sign(move), jnp.where(frees & (gain == best), 0.0, one))
            for one, block, move, gain in zip(active, blocks, moves, gains, strict=True)
        )
        return moved, active

    held = [
        jnp.where(one < 0, low, jnp.where(one > 0, high, x))
        for one, low, high, x in zip(start.active, lower, upper, start.values, strict=True)
    ]
    inside = tuple(jnp.clip(one, low, high) for one, low, high in zip(held, lower, upper, strict=True))
    fixed = tuple(jnp.where(low == high, -1.0, one) for one, low, high in zip(start.active, lower, upper, strict=True))
    x, active = lax.fori_loop(0, 2 * size if steps is None else steps, step, (inside, fixed))
    descents = [
        slope * (one - jnp.where(slope > 0, low, high))
        for one, slope, low, high in zip(x, gradient(x), lower, upper, strict=True)
    ]
    return BoundedSolution(x, active, 2 * functools.reduce(total, descents))
