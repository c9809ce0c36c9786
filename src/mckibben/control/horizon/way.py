"""The way that a policy goes from here, and how each stage of it changes with the state at its beginning."""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax

from mckibben.control.horizon.outlook import Outlook, Pair, Scalar, Vector
from mckibben.control.horizon.policy import Policy, dot


class Stage(NamedTuple):
    """One stage of a way: where it begins and ends, what is chosen, and what is needed to choose better.

    Attributes
    ----------
    begin, end
        The states.
    pressures
        Chosen for its end.
    by_pressure, inverse
        M and its inverse, by rows.
    by_state
        How acceleration and stiffness at the end change with the state at the beginning, pressures held; by rows.
    lower, upper
        The limits of the pressures.
    lower_by_state, upper_by_state
        How these change with the state at the beginning; by rows.
    """

    begin: Vector
    end: Vector
    pressures: Pair
    by_pressure: tuple[Pair, Pair]
    inverse: tuple[Pair, Pair]
    by_state: tuple[Vector, Vector]
    lower: Pair
    upper: Pair
    lower_by_state: tuple[Vector, Vector]
    upper_by_state: tuple[Vector, Vector]


def followed(outlook: Outlook, start: Vector, pressures: Pair, policy: Policy) -> Stage:
    """The stages of the way that a policy goes from here."""
    h, drag, (mu1, mu2) = outlook.stage, outlook.drag, outlook.early
    zero = jnp.zeros_like(start[0])

    def stage(carry: tuple, policy: Policy) -> tuple[tuple, Stage]:
        begin, before, before_by_state, wish = carry
        wished = outlook.wish_after(wish)
        ahead = begin[0] + h * (begin[1] + h / 2 * begin[2])
        speed = begin[1] + h * begin[2]
        angle = wished[0] + ahead
        (a0, a1, a2), (s0, s1, s2) = (
            [part.at(angle) for part in parts] for parts in (outlook.acceleration, outlook.stiffness)
        )

        asked1, asked2 = (p + dot(gains, begin) for p, gains in zip(policy.constant, policy.by_state, strict=True))
        lower1, upper1 = _limits(outlook, 0, angle, before[0])
        lower2, upper2 = _limits(outlook, 1, angle, before[1])
        p1, p2 = (
            jnp.clip(asked1, lower1.value, upper1.value),
            jnp.clip(asked2, lower2.value, upper2.value),
        )

        acceleration = a0 + a1 * p1 + a2 * p2 - drag * (wished[1] + speed) - wished[2]
        # What moves with mu where the wish moves as it does, is off by this.
        change = wished[2] - wish[2]
        drift = (
            wish[0] + h * (wish[1] + h / 2 * (wish[2] + mu2 * change)) - wished[0],
            wish[1] + h * (wish[2] + mu1 * change) - wished[1],
        )
        end = (
            ahead + h**2 / 2 * mu2 * (acceleration - begin[2]) + drift[0],
            speed + h * mu1 * (acceleration - begin[2]) + drift[1],
            acceleration,
            s0 + s1 * p1 + s2 * p2,
        )
        turn_a, turn_s = (
            parts[0].slope_at(angle) + p1 * parts[1].slope_at(angle) + p2 * parts[2].slope_at(angle)
            for parts in (outlook.acceleration, outlook.stiffness)
        )

        determinant = a1 * s2 - a2 * s1
        least = 1e-3 * (jnp.abs(a1 * s2) + jnp.abs(a2 * s1)) + 1e-12  # where pressures hardly change the stiffness
        determinant = jnp.where(determinant > 0, jnp.maximum(determinant, least), jnp.minimum(determinant, -least))
        inverse = (s2 / determinant, -a2 / determinant), (-s1 / determinant, a1 / determinant)

        def by_state(limit: _Limit, i: int) -> Vector:
            turn, kept = limit.by_angle, before_by_state[i]
            return (
                turn + limit.by_pressure * kept[0],
                turn * h + limit.by_pressure * kept[1],
                turn * h**2 / 2 + limit.by_pressure * kept[2],
                limit.by_pressure * kept[3],
            )

        told = Stage(
            begin=begin,
            end=end,
            pressures=(p1, p2),
            by_pressure=((a1, a2), (s1, s2)),
            inverse=inverse,
            by_state=(
                (turn_a, turn_a * h - drag, turn_a * h**2 / 2 - drag * h, zero),
                (turn_s, turn_s * h, turn_s * h**2 / 2, zero),
            ),
            lower=(lower1.value, lower2.value),
            upper=(upper1.value, upper2.value),
            lower_by_state=(by_state(lower1, 0), by_state(lower2, 1)),
            upper_by_state=(by_state(upper1, 0), by_state(upper2, 1)),
        )
        # What the pressures at the end of the stage have to do with the state there.
        by_end = tuple((-(to_a * turn_a + to_s * turn_s), to_a * drag, to_a, to_s) for to_a, to_s in inverse)
        return (end, (p1, p2), by_end, wished), told

    fixed = (zero, zero, zero, zero)
    return lax.scan(stage, (start, pressures, (fixed, fixed), outlook.wish), policy)[1]


class _Limit(NamedTuple):
    """A limit of a pressure, and how it changes with the angle and with the pressure before."""

    value: Scalar
    by_angle: Scalar
    by_pressure: Scalar


def _smaller(one: _Limit, other: _Limit) -> _Limit:
    return jax.tree.map(lambda a, b: jnp.where(one.value < other.value, a, b), one, other)


def _larger(one: _Limit, other: _Limit) -> _Limit:
    return jax.tree.map(lambda a, b: jnp.where(one.value > other.value, a, b), one, other)


def _limits(outlook: Outlook, i: int, angle: Scalar, pressure: Scalar) -> tuple[_Limit, _Limit]:
    """Of a muscle's pressure at the end of a stage; what a valve cannot do in a stage counts before all else."""
    nothing, kept = jnp.zeros_like(pressure), jnp.ones_like(pressure) - outlook.share
    slowest, fastest = (
        _Limit(pressure + outlook.share * (command[i] - pressure), nothing, kept)
        for command in (outlook.least, outlook.most)
    )
    low, high = (
        _Limit(limit[i].at(angle), nothing + limit[i].slope_at(angle), nothing)
        for limit in (outlook.lowest, outlook.highest)
    )
    upper = _larger(_smaller(high, fastest), slowest)
    return _smaller(_larger(low, slowest), upper), upper
