"""A plan: what to do at each stage, also where the joint is not where it was thought to be."""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import ArrayLike

from mckibben.control.horizon.outlook import Pair, Scalar, Vector


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
