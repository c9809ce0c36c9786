"""What a run is made of: plant, controller, reference and start, as one tree whose leaves have names."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike

from mckibben.control.base import Controller, Reference, Setpoint
from mckibben.errors import SimulationError
from mckibben.numerics.arrays import floating
from mckibben.numerics.compiled import numeric
from mckibben.numerics.lanes import check_again, lanes_of, with_leaves
from mckibben.plant import JointPlant, PlantState


class AtRest(NamedTuple):
    """A start at rest: angle [rad], and stiffness [N*m/rad] (NaN: amid the attainable ones); numbers, or one a run."""

    angle: ArrayLike
    stiffness: ArrayLike = math.nan


class Run(NamedTuple):
    """All that a run is made of; its leaves are numbers, or arrays with one number a run."""

    plant: JointPlant
    controller: Controller
    reference: Reference
    initial: PlantState | AtRest

    def start(self, wish: Setpoint) -> tuple[PlantState, Array]:
        """The state to start from, for wishes of shape (periods,), and whether there is one."""
        if isinstance(self.initial, PlantState):
            return self.plant.remembering(jax.tree.map(floating, self.initial)), jnp.asarray(True)
        return self.plant.resting(*self.rest(wish))

    def rest(self, wish: Setpoint) -> tuple[Array, Array]:
        """The angle [rad] and the stiffness [N*m/rad] at which it is to rest at the start."""
        asked = self.initial
        assert isinstance(asked, AtRest)
        return jnp.where(jnp.isnan(asked.angle), wish.angle[0], asked.angle), jnp.asarray(asked.stiffness)


def described(
    plant: JointPlant,
    controller: Controller,
    reference: Reference,
    initial: PlantState | AtRest | None,
    over: Mapping[str, ArrayLike],
) -> tuple[Run, Run, int | None]:
    """A run with other values at named leaves, in two parts: the leaves that vary over runs, and all others.

    With them comes the number of runs; None if no leaf varies.

    Raises
    ------
    ParameterError
        If there is no such leaf, or their arrays are of different lengths.
    RangeError
        If an object refuses a value.
    """
    run = Run(plant, controller, reference, AtRest(math.nan) if initial is None else initial)
    run = Run(**with_leaves(run._asdict(), over))
    count, varying = lanes_of(run)
    check_again(run)
    return *eqx.partition(numeric(run), varying), count


def check_names(what: str, names: Sequence[str], known: Sequence[str]) -> None:
    """Raise unless all names of a list are known."""
    for name in [names] if isinstance(names, str) else names:
        if name not in known or isinstance(names, str):
            raise SimulationError(
                f"{name!r} is no {what}" if name not in known else f"one {what} alone: {name!r}",
                value=name,
                remedy=f"give a list of {', '.join(known)}",
            )
