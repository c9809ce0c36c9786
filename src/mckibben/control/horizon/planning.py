"""Policies made better, and the move that they begin with."""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, ArrayLike

from mckibben.control.horizon.improving import improved
from mckibben.control.horizon.outlook import Outlook, Pair, Vector
from mckibben.control.horizon.policy import Policy
from mckibben.control.horizon.way import followed


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
