"""Control-limited differential dynamic programming."""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, ArrayLike, Float

Scalar = Float[Array, ""]
Pair = tuple[Scalar, Scalar]
Vector = tuple[Scalar, Scalar, Scalar, Scalar]
"""Of a state: angle, velocity, acceleration, stiffness."""


class Bent(NamedTuple):
    """A number that changes with the angle: its value here, and its first two derivatives."""

    value: ArrayLike
    slope: ArrayLike = 0.0
    curvature: ArrayLike = 0.0

    def at(self, angle: ArrayLike) -> Scalar:
        """The number at an angle counted from here."""
        return jnp.asarray(self.value + angle * (self.slope + angle * self.curvature / 2))

    def slope_at(self, angle: ArrayLike) -> Scalar:
        """How it changes there."""
        return jnp.asarray(self.slope + angle * self.curvature)


class Outlook(NamedTuple):
    """What does not change over the horizon.

    Attributes
    ----------
    stage
        h, the length of a stage.
    early
        (mu_1, mu_2): how early in a stage the acceleration changes; (1/2, 1/3) if evenly, (1, 1) if at once.
    share
        The part of the way to a command that a pressure goes in a stage.
    damping
        d, from 2 to 3.
    slowness
        rho, the square of the loop's omega_c over that of the stiffness.
    acceleration, stiffness
        What the pressures make of them, over the angle: offset and the parts of p1 and p2; the wish taken off the
        stiffness, but not off the acceleration.
    drag
        How much acceleration a velocity takes away.
    wish
        Angle (counted from here), velocity, acceleration and jerk of the wish, now.
    swing
        The square of the frequency with which its acceleration goes on; 0 if evenly.
    lowest, highest
        Pressures of either muscle over the angle: what a stage may end with.
    least, most
        What may be commanded.
    """

    stage: ArrayLike
    early: tuple[ArrayLike, ArrayLike]
    share: ArrayLike
    damping: ArrayLike
    slowness: ArrayLike
    acceleration: tuple[Bent, Bent, Bent]
    stiffness: tuple[Bent, Bent, Bent]
    drag: ArrayLike
    wish: Vector
    swing: ArrayLike
    lowest: tuple[Bent, Bent]
    highest: tuple[Bent, Bent]
    least: tuple[ArrayLike, ArrayLike]
    most: tuple[ArrayLike, ArrayLike]

    def wish_after(self, wish: Vector) -> Vector:
        """The wish a stage later: its acceleration goes on as that of a sine, for none evenly."""
        angle, velocity, acceleration, jerk = wish
        h = jnp.asarray(self.stage)
        q = self.swing * h**2  # series of sine and cosine, of a stage's part of a swing
        sine, twice = 1 - q / 6 * (1 - q / 20), 1 / 2 - q / 24 * (1 - q / 30)
        thrice = 1 / 6 - q / 120 * (1 - q / 42)
        return (
            angle + h * (velocity + h * (acceleration * twice + h * jerk * thrice)),
            velocity + h * (acceleration * sine + h * jerk * twice),
            acceleration * (1 - q * twice) + h * jerk * sine,
            jerk * (1 - q * twice) - self.swing * h * sine * acceleration,
        )


class Policy(NamedTuple):
    """The pressures at the end of each stage, affine in the state at its beginning; arrays of shape (stages,)."""

    constant: Pair
    by_state: tuple[Vector, Vector]


def steady(pressures: Pair, stages: int) -> Policy:
    """The policy to stay at pressures."""
    each = jnp.zeros(stages, pressures[0].dtype)
    still = each, each, each, each
    return Policy((each + pressures[0], each + pressures[1]), (still, still))


def later(policy: Policy, part: ArrayLike) -> Policy:
    """The policy of a plan of which part of a stage has passed."""
    return jax.tree.map(lambda each: each + part * (jnp.append(each[1:], each[-1:]) - each), policy)


def dot(row: Vector, vector: Vector | list[Scalar]) -> Scalar:
    """The scalar product."""
    return sum(a * b for a, b in zip(row, vector, strict=True))  # type: ignore


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


class _Value(NamedTuple):
    """What it costs from a state on, around a way: its gradient, and its second derivatives by rows."""

    gradient: Vector
    curvature: tuple[Vector, Vector, Vector, Vector]


def improved(outlook: Outlook, way: Stage) -> tuple[Policy, tuple[Pair, Array]]:
    """One step of Newton's method: the best policy if the limits at which it is go on to hold, from the last stage."""
    h, rho, (mu1, mu2), damping = outlook.stage, outlook.slowness, outlook.early, outlook.damping
    between = h * damping * (damping - 2)
    new = h**2 / 2 * mu2, h * mu1  # what acceleration at the end does to angle and velocity
    old = h**2 / 2 * (1 - mu2), h * (1 - mu1)  # and that at the beginning
    one, zero = jnp.ones_like(way.begin[0][0]), jnp.zeros_like(way.begin[0][0])
    root = jnp.sqrt(one * rho)
    damp = one * damping
    final = (
        (damp, damp, one, zero),
        (damp, damp**2 - 1, damp, zero),
        (one, damp, damp, zero),
        (zero, zero, zero, root),
    )  # of a triple integrator and of an integrator
    last = jax.tree.map(lambda values: values[-1], way.end)

    def stage(value: _Value, at: Stage) -> tuple[_Value, tuple[Policy, tuple[Pair, Array]]]:
        # Of the state at the end, with its own cost: W and its gradient g.
        W = [list(row) for row in value.curvature]
        weights = h, between, between, h
        for i in range(4):
            W[i][i] = W[i][i] + weights[i]
        g0, g1, g2, g3 = (g + weight * x for g, weight, x in zip(value.gradient, weights, at.end, strict=True))
        jerk, rush = (at.end[2] - at.begin[2]) / h, rho * (at.end[3] - at.begin[3]) / h

        # Over the state at the beginning x and the choice v = (acceleration, stiffness) at the end.
        into = [new[0] * W[0][j] + new[1] * W[1][j] + W[2][j] for j in range(4)]
        Q11 = new[0] * into[0] + new[1] * into[1] + into[2] + 1 / h
        Q12, Q22 = into[3], W[3][3] + rho / h
        q1, q2 = new[0] * g0 + new[1] * g1 + g2 + jerk, g3 + rush

        def from_begin(a: ArrayLike, b: ArrayLike) -> list[Any]:
            """What a row at the end, on angle and velocity, is at the beginning."""
            return [a, h * a + b, old[0] * a + old[1] * b, zero]

        S1, S2 = from_begin(into[0], into[1]), from_begin(W[3][0], W[3][1])
        S1[2], S2[3] = S1[2] - 1 / h, S2[3] - rho / h
        over = [from_begin(W[0][0], W[1][0]), from_begin(W[0][1], W[1][1])]
        Qx = [from_begin(over[0][j], over[1][j]) for j in range(4)]
        Qx[2][2], Qx[3][3] = Qx[2][2] + 1 / h, Qx[3][3] + rho / h
        qx = from_begin(g0, g1)
        qx[2], qx[3] = qx[2] - jerk, qx[3] - rush

        # The best choice without limits.
        scale = Q11 * Q22 - Q12 * Q12
        free1, free2 = (Q12 * q2 - Q22 * q1) / scale, (Q12 * q1 - Q11 * q2) / scale
        free1_x = [(Q12 * b - Q22 * a) / scale for a, b in zip(S1, S2, strict=True)]
        free2_x = [(Q12 * a - Q11 * b) / scale for a, b in zip(S1, S2, strict=True)]

        # In pressures within limits: the minimum lies on a side that the free one is beyond.
        ((m11, m12), (m21, m22)), ((n11, n12), (n21, n22)) = at.by_pressure, at.inverse
        H11 = m11 * (Q11 * m11 + Q12 * m21) + m21 * (Q12 * m11 + Q22 * m21)
        H12 = m11 * (Q11 * m12 + Q12 * m22) + m21 * (Q12 * m12 + Q22 * m22)
        H22 = m12 * (Q11 * m12 + Q12 * m22) + m22 * (Q12 * m12 + Q22 * m22)
        r1, r2 = m11 * q1 + m21 * q2, m12 * q1 + m22 * q2
        low1, low2 = (limit - p for limit, p in zip(at.lower, at.pressures, strict=True))
        high1, high2 = (limit - p for limit, p in zip(at.upper, at.pressures, strict=True))
        wish1, wish2 = n11 * free1 + n12 * free2, n21 * free1 + n22 * free2
        (x1, x2), held_x = _along(wish1, low1, high1, r2, H12, H22, low2, high2)
        (y2, y1), held_y = _along(wish2, low2, high2, r1, H12, H11, low1, high1)

        def cost(p1: Scalar, p2: Scalar) -> Scalar:
            return p1 * (r1 + H11 * p1 / 2 + H12 * p2) + p2 * (r2 + H22 * p2 / 2)

        better = cost(x1, x2) <= cost(y1, y2)
        step1, step2 = jnp.where(better, x1, y1), jnp.where(better, x2, y2)
        held1, held2 = jnp.where(better, held_x[0], held_y[1]), jnp.where(better, held_x[1], held_y[0])

        # What follows from limits that hold, and the part of the free choice that they leave.
        limit1_x, limit2_x = (
            [jnp.where(step <= low, a, b) for a, b in zip(lower, upper, strict=True)]
            for step, low, lower, upper in (
                (step1, low1, at.lower_by_state[0], at.upper_by_state[0]),
                (step2, low2, at.lower_by_state[1], at.upper_by_state[1]),
            )
        )
        given1 = [m11 * a + m12 * b + c for a, b, c in zip(limit1_x, limit2_x, at.by_state[0], strict=True)]
        given2 = [m21 * a + m22 * b + c for a, b, c in zip(limit1_x, limit2_x, at.by_state[1], strict=True)]
        along1, along2 = jnp.where(held1, m12, m11), jnp.where(held1, m22, m21)  # where one is free
        stiff = jnp.where(held1, H22, H11)
        row1, row2 = (along1 * Q11 + along2 * Q12) / stiff, (along1 * Q12 + along2 * Q22) / stiff
        both, none = held1 & held2, ~(held1 | held2)

        def part(along: Scalar, row: Scalar, diagonal: float) -> Scalar:
            return jnp.where(none, diagonal, jnp.where(both, 0.0, along * row))

        P11, P12, P21, P22 = part(along1, row1, 1), part(along1, row2, 0), part(along2, row1, 0), part(along2, row2, 1)
        more = [(a - c, b - d) for a, b, c, d in zip(free1_x, free2_x, given1, given2, strict=True)]
        G1 = [c + P11 * a + P12 * b for c, (a, b) in zip(given1, more, strict=True)]
        G2 = [c + P21 * a + P22 * b for c, (a, b) in zip(given2, more, strict=True)]
        k1, k2 = m11 * step1 + m12 * step2, m21 * step1 + m22 * step2

        apart1, apart2 = (
            [g - c for g, c in zip(G, C, strict=True)] for G, C in zip((G1, G2), at.by_state, strict=True)
        )
        gains1 = tuple(n11 * a + n12 * b for a, b in zip(apart1, apart2, strict=True))
        gains2 = tuple(n21 * a + n22 * b for a, b in zip(apart1, apart2, strict=True))
        chosen = at.pressures[0] + step1, at.pressures[1] + step2
        constant = chosen[0] - dot(gains1, at.begin), chosen[1] - dot(gains2, at.begin)  # type: ignore

        # What it costs from the beginning of the stage on.
        T1 = [Q11 * a + Q12 * b + s for a, b, s in zip(G1, G2, S1, strict=True)]
        T2 = [Q12 * a + Q22 * b + s for a, b, s in zip(G1, G2, S2, strict=True)]
        rest1, rest2 = q1 + Q11 * k1 + Q12 * k2, q2 + Q12 * k1 + Q22 * k2
        V = [[zero] * 4 for _ in range(4)]
        for i in range(4):
            for j in range(i, 4):
                V[i][j] = V[j][i] = Qx[i][j] + G1[i] * T1[j] + G2[i] * T2[j] + S1[i] * G1[j] + S2[i] * G2[j]
        gradient = tuple(qx[i] + G1[i] * rest1 + G2[i] * rest2 + S1[i] * k1 + S2[i] * k2 for i in range(4))
        value = _Value(gradient, tuple(tuple(row) for row in V))  # type: ignore
        return value, (Policy(constant, (gains1, gains2)), (chosen, held1 | held2))  # type: ignore

    begin = _Value(tuple(dot(row, last) for row in final), final)  # type: ignore
    return lax.scan(stage, begin, way, reverse=True)[1]


def _along(
    wish: Scalar,
    low: Scalar,
    high: Scalar,
    slope: Scalar,
    across: Scalar,
    curvature: Scalar,
    low2: Scalar,
    high2: Scalar,
) -> tuple[Pair, tuple[Array, Array]]:
    """One pressure at its wish or the limit before it, the other best there; and which are held by a limit."""
    first = jnp.clip(wish, low, high)
    best = -(slope + across * first) / curvature
    second = jnp.clip(best, low2, high2)
    return (first, second), (first != wish, second != best)


class Move(NamedTuple):
    """The pressures to go for in the first stage, and whether a limit holds one."""

    pressures: Pair
    held: Array


def planned(outlook: Outlook, start: Vector, pressures: Pair, policy: Policy, iterations: int) -> tuple[Policy, Move]:
    """A better policy, and the move that it begins with.

    Parameters
    ----------
    outlook
        What is ahead.
    start, pressures
        State and pressures now.
    policy
        To begin with.
    iterations
        How often to improve it, at least once. Without limits once is enough for the first move, whatever the policy
        was; with them each is a step of Newton's method.
    """

    def better(_: ArrayLike, last: tuple[Policy, Move]) -> tuple[Policy, Move]:
        policy, (chosen, held) = improved(outlook, followed(outlook, start, pressures, last[0]))
        return policy, Move((chosen[0][0], chosen[1][0]), held[0])

    last = policy, Move(pressures, jnp.zeros_like(start[0], bool))
    return lax.fori_loop(0, iterations, better, last)


__all__ = ["Bent", "Move", "Outlook", "Policy", "later", "planned", "steady"]
