"""Computation of the blocks of a sweep."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, ArrayLike
from numpy.typing import NDArray

import mckibben
from mckibben.control.base import Reference
from mckibben.errors import SimulationError
from mckibben.joint.attainable import is_affine
from mckibben.numerics.batching import lanes_of, pad_chunk
from mckibben.numerics.compiled import compiled_batch, numeric
from mckibben.plant import JointPlant
from mckibben.simulation.feasibility import attainable_band
from mckibben.simulation.problem import sample_reference, sampling_times
from mckibben.study.parameters import Table, lanes
from mckibben.study.scenario import Scenario
from mckibben.study.scenario.running import run_many

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
        answer = _reach(pad_chunk(varied, piece, size), shared, moments, size)
        parts.append({name: np.asarray(value)[: piece.stop - start] for name, value in answer.items()})
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}


@compiled_batch
def _reach(varied: _Wished, shared: _Wished, moments: ArrayLike, size: int) -> dict[str, Array]:
    """One moment after the other, all runs at once: a joint with springs needs much memory a moment."""

    def missing(lane: _Wished, moment: Array) -> Array:
        plant, reference = eqx.combine(lane, shared)
        wish = sample_reference(reference, moment)
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


Columns = dict[str, NDArray]
"""Answers by name, one value a run."""


def software() -> dict[str, str]:
    """What computes here, and on what: other versions give other last bits."""
    return {"mckibben": mckibben.__version__, "jax": jax.__version__, "platform": jax.default_backend()}


@dataclass(frozen=True)
class Job:
    """What all blocks of a sweep share; it travels to other processes.

    Attributes
    ----------
    scenario
        With its nominal values.
    metrics
        Which are computed.
    precision
        64 or 32 bits.
    lanes
        Runs that are computed together. A block is filled up to a multiple of it, so that there is one program, and a
        run's numbers do not depend on who computes it.
    software
        What the process has to have; see `software`.
    known
        Numbers of the plant that the controller's model follows.
    """

    scenario: Scenario
    metrics: tuple[str, ...]
    precision: int
    lanes: int
    software: dict[str, str]
    known: tuple[str, ...] = ()

    def __call__(self, table: Table) -> Columns:
        """The answers to some rows.

        Raises
        ------
        SimulationError
            If this process has other software than the one that planned the sweep.
        """
        here = software()
        if here != self.software:
            raise SimulationError(
                f"a worker has {_listed(here)}, the sweep {_listed(self.software)}",
                remedy="start workers in the same environment",
            )
        rows = len(next(iter(table.values())))
        filling = -rows % self.lanes
        full = {name: np.concatenate([column, np.repeat(column[-1:], filling)]) for name, column in table.items()}
        batch = run_many(
            self.scenario,
            full,
            known=self.known,
            metrics=self.metrics,
            precision=self.precision,
            chunk=self.lanes,
            workers=1,
        )
        answers = {name: batch.table[name].to_numpy() for name in (*self.metrics, "outcome")}
        answers |= attainability(self.scenario, full, self.lanes)
        return {name: column[:rows] for name, column in answers.items()}


def _listed(software: dict[str, str]) -> str:
    return ", ".join(f"{name} {version}" for name, version in software.items())
