"""Whether the joint can hold what is wished for, for every run of a sweep: known from the joint alone."""

from __future__ import annotations

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, ArrayLike
from numpy.typing import NDArray

from mckibben.control.base import Reference
from mckibben.joint.attainable import is_affine
from mckibben.numerics.compiled import compiled_batch, numeric
from mckibben.numerics.lanes import lanes_of, padded
from mckibben.plant import JointPlant
from mckibben.simulation.loop import sampling_times, wishes_at
from mckibben.simulation.reach import attainable_band
from mckibben.study.parameters import Table, lanes
from mckibben.study.scenario import Scenario

REACH = {
    "shortfall_max": ("N*m/rad", "by how much the desired stiffness is out of static reach at most"),
    "unheld": ("1", "part of the time at which no pressures within limits hold the desired angle"),
}
"""The variables that come of it: unit and meaning."""

_MOMENTS = 200
_MOMENTS_WITH_SPRINGS = 50  # each of which costs as much as 100 of rigid tendons
_ROUNDING = 1e-6  # N*m/rad


class _Wished(NamedTuple):
    """A plant, and what is wanted of it."""

    plant: JointPlant
    reference: Reference


def attainability(scenario: Scenario, table: Table, size: int) -> dict[str, NDArray[np.float64]]:
    """How far each run's reference is from what its joint can hold against gravity.

    It is looked at at some 200 moments of the run, with springs in series at 50.

    Parameters
    ----------
    scenario, table
        As for `run_many`.
    size
        Runs that are computed together.

    Returns
    -------
    columns
        ``shortfall_max`` [N*m/rad]: by how much the desired stiffness is out of reach at most, while the angle can be
        held; NaN where it never can. ``unheld``: the part of the time at which the angle itself cannot be held.
    """
    many = lanes(scenario, table)
    wished = numeric(_Wished(many.plant(), many.reference()))
    times = sampling_times(scenario.duration, scenario.control_period)
    most = _MOMENTS if is_affine(wished.plant.joint) else _MOMENTS_WITH_SPRINGS
    moments = times[np.unique(np.linspace(0, times.size - 1, most).round().astype(int))]
    rows = len(next(iter(table.values())))
    count, varying = lanes_of(wished)
    if count is None:  # only the controller differs from run to run
        varied, shared = _Wished(*[None] * 2), wished  # type: ignore[arg-type]
        answer = {name: np.asarray(value) for name, value in _reach(varied, shared, moments, 1).items()}
        return {name: np.broadcast_to(value, rows).copy() for name, value in answer.items()}
    varied, shared = eqx.partition(wished, varying)
    parts = []
    for start in range(0, rows, size):
        piece = slice(start, min(start + size, rows))
        answer = _reach(padded(varied, piece, size), shared, moments, size)
        parts.append({name: np.asarray(value)[: piece.stop - start] for name, value in answer.items()})
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}


@compiled_batch
def _reach(varied: _Wished, shared: _Wished, moments: ArrayLike, size: int) -> dict[str, Array]:
    """One moment after the other, all runs at once: a joint with springs needs much memory a moment."""

    def missing(lane: _Wished, moment: Array) -> Array:
        plant, reference = eqx.combine(lane, shared)
        wish = wishes_at(reference, moment)
        low, high = attainable_band(plant, wish.angle)
        return jnp.maximum(low - wish.stiffness, wish.stiffness - high)

    def following(carried: tuple[Array, Array], moment: Array) -> tuple[tuple[Array, Array], None]:
        most, unheld = carried
        short = jax.vmap(missing, in_axes=(0, None), axis_size=size)(varied, moment)
        return (jnp.fmax(most, short), unheld + jnp.isnan(short)), None

    begin = jnp.full(size, jnp.nan), jnp.zeros(size)
    (most, unheld), _ = lax.scan(following, begin, jnp.asarray(moments))
    most = jnp.where(most > _ROUNDING, most, jnp.where(jnp.isnan(most), jnp.nan, 0.0))
    return {"shortfall_max": most, "unheld": unheld / jnp.size(moments)}
