"""Pressures of all muscles within a control period: a bounded least-squares problem, or pairs in closed form."""

from __future__ import annotations

import functools
import operator
from collections.abc import Sequence
from typing import NamedTuple

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

from mckibben.control.allocation import prioritise_torque
from mckibben.joint import AffineMap, TorqueStiffnessMap
from mckibben.mechanism.terms import JointTerms, Row, offset_of
from mckibben.mechanism.tree import solve_symmetric
from mckibben.numerics.elementary import Number
from mckibben.numerics.spatial import product, total
from mckibben.units import bar

Scalar = Float[Array, ""]

_TORQUE = 30.0  # weight of the torques, relative to the errors of the stiffness
_CENTRED = 1e-3  # weight of the distance from the middle of the range, which selects among equal solutions

MOST_MUSCLES = 90
"""Muscles of a quadratic program: it grows with the cube of their number, and a compiler takes minutes for these."""


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

    @classmethod
    def at(cls, pressures: Sequence[Array]) -> BoundedSolution:
        """Return a start at pressures [Pa], without active limits."""
        zero = jnp.zeros_like(pressures[0])
        return cls(tuple(pressure / bar for pressure in pressures), (zero,) * len(pressures), zero)


class JointAllocation(NamedTuple):
    """Pressures [Pa] of all muscles, torques [N*m] of all joints, and whether a limit was met.

    `solution` is that of the quadratic program, () of pairs in closed form.
    """

    pressures: tuple[Scalar, ...]
    torques: tuple[Scalar, ...]
    saturated: Array
    solution: BoundedSolution | tuple[()] = ()


def allocate_pairs(
    terms: JointTerms,
    torques: Sequence[Number],
    stiffness: Sequence[Number],
    lower: Sequence[Array],
    upper: Sequence[Array],
    springs: Sequence[bool],
) -> JointAllocation:
    """Return the allocation for muscles that are a pair of each joint, in closed form.

    The torque of each joint [N*m] has priority over its stiffness [N*m/rad]; see `prioritise_torque`.

    Parameters
    ----------
    lower, upper
        Limits of the pressures [Pa].
    springs
        Whether each muscle is a return spring.
    """
    pressures: dict[int, Array] = {}
    pairs = []
    for joint, row in enumerate(terms.torque):
        first, second = muscles = tuple(row)

        def affine(row: Row) -> AffineMap:
            slopes = (jnp.asarray(row[muscle][1]) for muscle in muscles)  # noqa: B023
            return AffineMap(jnp.asarray(offset_of(row)), *slopes)

        both = TorqueStiffnessMap(affine(row), affine(terms.stiffness[joint, joint]))
        low, high = ((limit[first], limit[second]) for limit in (lower, upper))
        held = springs[first], springs[second]
        pairs.append(prioritise_torque(both, torques[joint], stiffness[joint], low, high, held))
        pressures |= zip(muscles, pairs[-1].pressures, strict=True)
    saturated = functools.reduce(operator.or_, (pair.saturated for pair in pairs))
    ordered = tuple(pressures[muscle] for muscle in range(len(lower)))
    return JointAllocation(ordered, tuple(pair.torque for pair in pairs), saturated)


def allocate_bounded(
    terms: JointTerms,
    torques: Sequence[Number],
    stiffness: Sequence[Number],
    lower: Sequence[Array],
    upper: Sequence[Array],
    springs: Sequence[bool],
    start: BoundedSolution,
) -> JointAllocation:
    """Return the allocation for any muscles by a quadratic program, continued from the last solution.

    Arguments are those of `allocate_pairs`; torques have priority by their weight.
    """
    low, high = (tuple(limit / bar for limit in limits) for limits in (lower, upper))
    errors = terms.errors(torques, stiffness, _TORQUE, _CENTRED, lower, upper)
    solution = bounded_least_squares(*errors, low, high, start)
    pressures = tuple(value * bar for value in solution.values)
    held = [active != 0 for active, spring in zip(solution.active, springs, strict=True) if not spring]
    return JointAllocation(pressures, terms.torque_at(pressures), functools.reduce(operator.or_, held), solution)


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
