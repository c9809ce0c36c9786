"""A better policy from a way: one step of Newton's method within limits, stage by stage from the last."""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, ArrayLike

from mckibben.control.horizon.outlook import Outlook, Pair, Scalar, Vector
from mckibben.control.horizon.policy import Policy, dot
from mckibben.control.horizon.way import Stage


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
