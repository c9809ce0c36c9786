"""The knee for engines without a language of their own: the same formulas over floats and symbols.

The stiffness is the closed-form derivative of the torque, as in plain C.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

from reference import PERIOD, SUBSTEPS, Numbers


class Maths(NamedTuple):
    """The functions that the formulas need."""

    sin: Callable[[Any], Any]
    cos: Callable[[Any], Any]
    exp: Callable[[Any], Any]
    sqrt: Callable[[Any], Any]
    where_positive: Callable[[Any, Any], Any]  # the second where the first is above 0, else 0
    clip: Callable[[Any, Any, Any], Any]


FLOATS = Maths(
    math.sin,
    math.cos,
    math.exp,
    math.sqrt,
    lambda x, value: value if x > 0 else 0.0,
    lambda x, low, high: low if x < low else high if x > high else x,
)


class Knee(NamedTuple):
    """Functions of the state (angle, velocity, p1, p2)."""

    torque: Callable[[Any, Any, Any], Any]  # of the muscles and gravity: angle, p1, p2
    stiffness: Callable[[Any, Any, Any], Any]  # of the muscles: angle, p1, p2
    rate: Callable[[Any, Any, Any], tuple[Any, ...]]  # state, u1, u2
    rk4: Callable[[Any, Any, Any], tuple[Any, ...]]  # state, u1, u2: one substep
    init: Callable[[Any], tuple[Any, ...]]  # of both loops, from the state
    control: Callable[..., tuple[tuple[Any, ...], Any, Any, Any]]  # memory, setpoints, state: memory, u1, u2, estimate


def knee(maths: Maths, k: Numbers, substeps: int = SUBSTEPS) -> Knee:
    """The knee over one kind of number. Closures, because looking names up costs more than sums in plain Python."""
    sin, cos, exp, sqrt, where_positive, clip = maths
    a1, a2, b1, b2, c1, c2, decay, l0, H, r, connector, inertia, damping, gravity, hanging, lag, low, high = k[:18]
    h = PERIOD / substeps

    def lengths(angle: Any) -> tuple[Any, ...]:
        s, c = sin(angle), cos(angle)
        across, along1, along2 = r * (1 - c), H + r * s, H - r * s
        q1, q2 = sqrt(along1 * along1 + across * across), sqrt(along2 * along2 + across * across)
        return s, c, q1, q2, r * (H * c + r * s) / q1, r * (H * c - r * s) / q2

    def muscle(q: Any, p: Any) -> tuple[Any, Any, Any, Any]:
        eps = 1 - (q - connector) / l0
        straight, decayed = b1 + b2 * p, (c1 + c2 * p) * exp(-decay * eps)
        force = (a1 + a2 * p) + straight * eps + decayed
        return where_positive(force, force), force, straight, decayed

    def torque(angle: Any, p1: Any, p2: Any) -> Any:
        _, _, q1, q2, arm1, arm2 = lengths(angle)
        return muscle(q2, p2)[0] * arm2 - muscle(q1, p1)[0] * arm1 + gravity * sin(hanging - angle)

    def stiffness(angle: Any, p1: Any, p2: Any) -> Any:
        s, c, q1, q2, arm1, arm2 = lengths(angle)
        force1, law1, straight1, decayed1 = muscle(q1, p1)
        force2, law2, straight2, decayed2 = muscle(q2, p2)
        slope1 = where_positive(law1, straight1 - decay * decayed1)
        slope2 = where_positive(law2, straight2 - decay * decayed2)
        arm_slope1 = r * (-H * s + r * c) / q1 - arm1 * arm1 / q1
        arm_slope2 = r * (-H * s - r * c) / q2 + arm2 * arm2 / q2
        return -slope1 * arm1 / l0 * arm1 + force1 * arm_slope1 - slope2 * arm2 / l0 * arm2 - force2 * arm_slope2

    def rate(x: Any, u1: Any, u2: Any) -> tuple[Any, ...]:
        angle, velocity, p1, p2 = x
        return velocity, (torque(angle, p1, p2) - damping * velocity) / inertia, (u1 - p1) / lag, (u2 - p2) / lag

    def moved(x: Any, d: Any, by: float) -> tuple[Any, ...]:
        return x[0] + by * d[0], x[1] + by * d[1], x[2] + by * d[2], x[3] + by * d[3]

    def rk4(x: Any, u1: Any, u2: Any) -> tuple[Any, ...]:
        d1 = rate(x, u1, u2)
        d2 = rate(moved(x, d1, h / 2), u1, u2)
        d3 = rate(moved(x, d2, h / 2), u1, u2)
        d4 = rate(moved(x, d3, h), u1, u2)
        return tuple(
            value + h / 6 * (k1 + 2 * (k2 + k3) + k4) for value, k1, k2, k3, k4 in zip(x, d1, d2, d3, d4, strict=True)
        )

    (kp1, kp2), (ki1, ki2), (kd1, kd2) = k[18:20], k[20:22], k[22:24]
    (filter1, filter2), share1, share2 = k[24:26], min(PERIOD / k[26], 1.0), min(PERIOD / k[27], 1.0)

    def init(x: Any) -> tuple[Any, ...]:
        angle, _, p1, p2 = x
        return (p2 - p1) / 2, -angle, 0 * angle, (p1 + p2) / 2, -stiffness(angle, p1, p2), 0 * angle

    def control(memory: Any, wanted_angle: Any, wanted_stiffness: Any, x: Any) -> tuple[tuple[Any, ...], Any, Any, Any]:
        integral1, before1, derivative1, integral2, before2, derivative2 = memory
        angle, _, p1, p2 = x
        estimate = stiffness(angle, p1, p2)
        error1, error2 = wanted_angle - angle, wanted_stiffness - estimate
        derivative1 = (filter1 * derivative1 - angle - before1) / (filter1 + PERIOD)
        derivative2 = (filter2 * derivative2 - estimate - before2) / (filter2 + PERIOD)
        integral1, integral2 = integral1 + ki1 * PERIOD * error1, integral2 + ki2 * PERIOD * error2
        differential = kp1 * error1 + integral1 + kd1 * derivative1
        cocontraction = kp2 * error2 + integral2 + kd2 * derivative2
        u1, u2 = clip(cocontraction - differential, low, high), clip(cocontraction + differential, low, high)
        integral1 = integral1 + share1 * ((u2 - u1) / 2 - differential)
        integral2 = integral2 + share2 * ((u1 + u2) / 2 - cocontraction)
        return (integral1, -angle, derivative1, integral2, -estimate, derivative2), u1, u2, estimate

    return Knee(torque, stiffness, rate, rk4, init, control)
