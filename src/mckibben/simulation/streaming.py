"""An episode that keeps its metrics instead of its record: what batches, gradients and tuning run."""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, ArrayLike

from mckibben.control.base import Controller, Setpoint
from mckibben.plant import JointPlant, PlantState
from mckibben.simulation.loop import Running, control_period, started
from mckibben.simulation.metrics import (
    SETTLING_PART,
    Change,
    Metrics,
    Tally,
    last_change,
    metrics_of,
    tally,
    trajectory,
)


class Measured(NamedTuple):
    """What is left of an episode.

    Attributes
    ----------
    metrics
        As `measure` gives them for the whole trajectory.
    final
        The plant's state after the last control period.
    kept
        The parts of the trajectory that were asked for, by name, every so many control periods.
    """

    metrics: Metrics
    final: PlantState
    kept: dict[str, Array]


class _Carried(NamedTuple):
    """From one control period to the next: the run, the run without the last change of stiffness, and the tally.

    And what the tally needs of the period before.
    """

    running: Running
    undisturbed: Running
    total: Tally
    stiffness_at_change: Array
    air: tuple[Array, Array]


def measured_episode(
    plant: JointPlant,
    controller: Controller,
    setpoints: Setpoint,
    initial: PlantState,
    period: ArrayLike,
    substeps: int,
    *,
    change: Change | None = None,
    split: ArrayLike | None = None,
    keep: tuple[str, ...] = (),
    every: int = 1,
    checkpoint: bool = False,
) -> Measured:
    """Run a controller on a plant, like `episode`, and measure on the way: memory does not grow with the duration.

    Parameters
    ----------
    plant, controller, setpoints, initial, period, substeps
        As for `episode`.
    change
        The last change of the desired stiffness; worked out from the setpoints unless given. (In 32 bits neighbouring
        wishes may be the same number.)
    split
        The control period from which on the same run without the last change of the desired stiffness is computed
        beside, for the coupling; in a batch the earliest of all lanes, as one number. None leaves it out: the coupling
        is then NaN.
    keep
        Names of `Trajectory` to keep over time.
    every
        So many control periods apart; a divisor of their number.
    checkpoint
        Whether reverse differentiation shall compute each control period twice instead of remembering it.
    """
    periods = setpoints.angle.shape[0]
    change = last_change(setpoints.stiffness) if change is None else change

    def following(running: Running, setpoint: Setpoint) -> tuple[Running, Any]:
        return control_period(plant, controller, running, setpoint, period, substeps)

    def beside(carried: _Carried, running: Running, setpoint: Setpoint, index: Array) -> Running:
        """One period further in the run without the last change; until the change it is the run itself."""
        if split is None:
            return running
        held = jnp.where(index >= change.at, change.before, setpoint.stiffness)
        return lax.cond(
            index >= split,
            lambda undisturbed, wish: following(undisturbed, wish)[0],
            lambda *_: running,
            carried.undisturbed,
            setpoint._replace(stiffness=held),
        )

    def next_period(carried: _Carried, at: tuple[Array, Setpoint]) -> tuple[_Carried, dict[str, Array]]:
        index, setpoint = at
        running, record = following(carried.running, setpoint)
        moment = trajectory(plant, setpoint, record, carried.undisturbed[0].angle, period)
        at_change = jnp.where(index == change.at, moment.stiffness, carried.stiffness_at_change)
        air = (moment.air1, moment.air2)
        before = [jnp.where(index == 0, now, then) for now, then in zip(air, carried.air, strict=True)]
        added = tally(moment, index, change, at_change, before, SETTLING_PART)
        here = {name: getattr(moment, name) for name in keep}
        undisturbed = beside(carried, running, setpoint, index)
        return _Carried(running, undisturbed, carried.total.with_next(added), at_change, air), here

    if checkpoint:
        next_period = jax.checkpoint(next_period, prevent_cse=False)

    begun = started(plant, controller, initial)
    nothing = jnp.zeros_like(jnp.asarray(initial.angle))
    carried = _Carried(begun, begun, Tally.nothing(nothing), nothing, (nothing, nothing))
    blocks = jax.tree.map(lambda x: x.reshape(-1, every, *x.shape[1:]), (jnp.arange(periods), setpoints))

    def block(carried: _Carried, at: tuple[Array, Setpoint]) -> tuple[_Carried, dict[str, Array]]:
        carried, here = lax.scan(next_period, carried, at)
        return carried, {name: values[0] for name, values in here.items()}

    if every == 1 or not keep:
        carried, kept = lax.scan(next_period, carried, (jnp.arange(periods), setpoints))
    else:
        carried, kept = lax.scan(block, carried, blocks)
    metrics = metrics_of(carried.total, change, periods, period)
    if split is None:
        metrics = metrics._replace(coupling=jnp.full_like(metrics.coupling, jnp.nan))
    return Measured(metrics, carried.running[0], kept)
