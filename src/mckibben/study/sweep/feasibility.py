"""Whether the joint can hold the references of a sweep's runs."""

from __future__ import annotations

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, ArrayLike
from numpy.typing import NDArray

from mckibben.control.base import Reference
from mckibben.joint.attainable import is_affine
from mckibben.numerics.batching import lanes_of, pad_chunk
from mckibben.numerics.calculus import evenly_spaced
from mckibben.numerics.compiled import jit_lanes, numeric
from mckibben.plant import JointPlant
from mckibben.scenario import Scenario, batched
from mckibben.simulation.feasibility import attainable_band
from mckibben.simulation.problem import sample_reference, sampling_times
from mckibben.study.study import Table

FEASIBILITY = {
    "shortfall_max": ("N*m/rad", "largest distance of the stiffness reference from the attainable stiffness"),
    "infeasible_time": ("1", "share of the time in which no pressures within limits hold the reference angle"),
}
"""Unit and meaning of the variables that `feasibility` returns."""


class _Case(NamedTuple):
    """A plant, its reference, and the amplitude [rad] of its stiffness."""

    plant: JointPlant
    reference: Reference
    amplitude: Any = None


def feasibility(scenario: Scenario, table: Table, size: int) -> dict[str, NDArray[np.float64]]:
    """Compare the reference of each run with the attainable stiffness, at 200 instants from start to end.

    With springs at 50 instants, each of which costs as much as 100 with rigid tendons.

    Parameters
    ----------
    scenario
        Scenario with the nominal values.
    table
        Values [SI] of the varied parameters by name, shape (runs,).
    size
        Runs that are computed together.

    Returns
    -------
    dict
        Variables of `FEASIBILITY`, shape (runs,); the shortfall is NaN if no angle can be held.
    """
    many = batched(scenario, table)
    case = numeric(_Case(many.plant(), many.reference(), many.controller.stiffness_amplitude))
    times = sampling_times(scenario.duration, scenario.control_period)
    instants = times[evenly_spaced(times.size, 200 if is_affine(case.plant.joint) else 50)]
    rows = len(next(iter(table.values())))
    varied_rows, varying = lanes_of(case)
    if varied_rows is None:  # only the controller differs between runs
        nothing = _Case(None, None)  # type: ignore[arg-type]
        columns = _feasibility(nothing, case, instants, 1)
        return {name: np.broadcast_to(np.asarray(value), rows).copy() for name, value in columns.items()}
    varied, shared = eqx.partition(case, varying)
    parts = []
    for start in range(0, rows, size):
        piece = slice(start, min(start + size, rows))
        columns = _feasibility(pad_chunk(varied, piece, size), shared, instants, size)
        parts.append({name: np.asarray(value)[: piece.stop - start] for name, value in columns.items()})
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}


@jit_lanes
def _feasibility(varied: _Case, shared: _Case, instants: ArrayLike, size: int) -> dict[str, Array]:
    """Scan over instants, with all runs in parallel: a joint with springs needs much memory per instant."""

    def shortfall(lane: _Case, instant: Array) -> Array:
        plant, reference, amplitude = eqx.combine(lane, shared)
        setpoint = sample_reference(reference, instant)
        low, high = attainable_band(plant, setpoint.angle, amplitude)
        return jnp.maximum(low - setpoint.stiffness, setpoint.stiffness - high)

    def step(carry: tuple[Array, Array], instant: Array) -> tuple[tuple[Array, Array], None]:
        largest, infeasible = carry
        short = jax.vmap(shortfall, in_axes=(0, None), axis_size=size)(varied, instant)
        return (jnp.fmax(largest, short), infeasible + jnp.isnan(short)), None

    initial = jnp.full(size, jnp.nan), jnp.zeros(size)
    (largest, infeasible), _ = lax.scan(step, initial, jnp.asarray(instants))
    largest = jnp.where(largest <= 1e-6, 0.0, largest)  # rounding
    return {"shortfall_max": largest, "infeasible_time": infeasible / jnp.size(instants)}
