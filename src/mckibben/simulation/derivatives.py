"""Exact derivatives of metrics with respect to any numbers of a simulation."""

from __future__ import annotations

import enum
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, ArrayLike
from numpy.typing import NDArray

from mckibben.codegen.native import NativeFunction
from mckibben.component.calls import checked_call
from mckibben.control.base import Controller, Reference, Setpoint
from mckibben.errors import ParameterError
from mckibben.numerics.batching import (
    batched_program,
    map_chunks,
    named_leaves,
    pad_chunk,
    replace_leaves,
    select_leaves,
)
from mckibben.numerics.compiled import jit_arrays, jit_lanes
from mckibben.plant import JointPlant, PlantState
from mckibben.simulation.accuracy import ACCURACY, check_accuracy
from mckibben.simulation.engine import compute_with
from mckibben.simulation.loop import streaming_episode
from mckibben.simulation.metrics import Change, Metrics, last_change
from mckibben.simulation.problem import (
    AtRest,
    SimulationProblem,
    check_names,
    sample_reference,
    sampled_reference,
    sampling_times,
    split_problem,
)
from mckibben.simulation.simulate import episode_substeps, start_of

_Begun = tuple[PlantState, Setpoint, Change]  # the last of the stiffness; some of their leaves
_FEW = 10  # up to so many parameters forward differentiation is faster
_LANES = 8  # runs computed together: one vector of 64-bit numbers


class Mode(enum.Enum):
    """Mode of automatic differentiation; both give the same derivatives, to rounding."""

    FORWARD = "one tangent per parameter, alongside the run"
    REVERSE = "one backward pass per metric, with each control period recomputed"


@dataclass(frozen=True, repr=False)
class Derivatives:
    """Metrics by name, SI, and by metric and parameter their derivatives, in the shape of the parameter.

    Where runs differ, shape (runs,) comes first.
    """

    values: dict[str, NDArray[np.float64]]
    gradients: dict[str, dict[str, NDArray[np.float64]]]

    def __repr__(self) -> str:
        parameters = next(iter(self.gradients.values()), {})
        return f"<Derivatives of {', '.join(self.values)} with respect to {', '.join(parameters)}>"


@checked_call
def differentiate(
    plant: JointPlant,
    controller: Controller,
    reference: Reference,
    parameters: Sequence[str],
    *,
    metrics: Sequence[str] = ("angle_rmse", "stiffness_rmse"),
    over: Mapping[str, ArrayLike] | None = None,
    duration: float = 10.0,
    control_period: float = 1e-3,
    accuracy: float = ACCURACY,
    substeps: int | None = None,
    initial: PlantState | AtRest | None = None,
    mode: Mode | None = None,
) -> Derivatives:
    """Derivatives of metrics with respect to named numbers: sensitivities, or gradients for tuning.

    With a C compiler, forward derivatives of one run are emitted as C, as runs are (`simulate`). They include the
    dependence of an initial state at rest. Metrics that count or search (times, settling) have
    derivatives that are zero or jump; that of the largest error is taken at the moment of the largest error.

    Parameters
    ----------
    plant, controller, reference, over, duration, control_period, initial
        As for `simulate_many`; arrays in place of numbers, or `over`, give derivatives at many points at once.
    accuracy, substeps
        As for `simulate`; all runs have the integration steps that the first one needs.
    parameters
        Dotted names of floats such as "load.mass2", "controller.position.kp", "reference.angle.amplitude".
    metrics
        Names of `Metrics`.
    mode
        Default: forward up to ten numbers, reverse beyond.

    Raises
    ------
    ParameterError
        If there is no such number, or it is an integer.
    SimulationError
        If an argument is of the wrong type, the times do not fit together, or a metric is not known.
    """
    check_names("metric", metrics, Metrics._fields)
    if isinstance(parameters, str):
        raise ParameterError(f"{parameters!r} is a text, not a list", value=parameters, remedy="give a list of names")
    check_accuracy(accuracy, substeps)
    times = sampling_times(duration, control_period)
    problem = SimulationProblem.of(plant, controller, reference, initial)
    lanes, shared, count = split_problem(problem, over or {}, control_period)
    numbers = select_leaves(_whole(lanes, shared)._asdict(), parameters)
    for name, leaf in numbers.items():
        if not eqx.is_inexact_array(leaf):
            raise ParameterError(f"{name} is an integer and has no derivative", value=name)
    varying = named_leaves(lanes._asdict()) if lanes else {}
    size = sum(leaf[0].size if name in varying else leaf.size for name, leaf in numbers.items())
    if mode is None:
        mode = Mode.FORWARD if size <= _FEW else Mode.REVERSE
    if substeps is None:
        first = _whole(None if lanes is None else jax.tree.map(lambda leaf: leaf[0], lanes), shared)
        substeps = _needed(first, times, control_period, accuracy)
    asked = _Asked(substeps, tuple(metrics), tuple(parameters), mode, count is not None)
    period = jnp.asarray(control_period, float)
    if count is None:
        native = lambda: _natively(shared, numbers, times, period, asked)  # noqa: E731
        by_xla = lambda: jax.tree.map(np.asarray, _single(lanes, shared, times, period, asked))  # noqa: E731
        engine = "auto" if mode is Mode.FORWARD else "xla"
        return _in_order(asked, *compute_with(engine, native, by_xla)[0])

    def answers(piece: slice) -> Any:
        found = _many(pad_chunk(lanes, piece, _LANES), shared, times, period, asked)
        return jax.tree.map(lambda column: np.asarray(column)[: piece.stop - piece.start], found)

    pieces = [answer for _, answer in map_chunks(answers, count, _LANES)]
    return _in_order(asked, *jax.tree.map(lambda *columns: np.concatenate(columns), *pieces))


class _Asked(NamedTuple):
    """Static arguments of the program."""

    substeps: int
    metrics: tuple[str, ...]
    parameters: tuple[str, ...]
    mode: Mode
    many: bool


def _in_order(asked: _Asked, values: dict[str, Any], gradients: dict[str, dict[str, Any]]) -> Derivatives:
    """In the requested order; compiled programs sort their dictionaries."""

    def slope(metric: str, name: str) -> Any:
        """Derivative; NaN where the metric is."""
        gradient = gradients[metric][name]
        value = values[metric].reshape(values[metric].shape + (1,) * (gradient.ndim - values[metric].ndim))
        return np.where(np.isnan(value), np.nan, gradient)

    return Derivatives(
        {metric: values[metric] for metric in asked.metrics},
        {metric: {name: slope(metric, name) for name in asked.parameters} for metric in asked.metrics},
    )


def _whole(lane: SimulationProblem | None, shared: SimulationProblem) -> SimulationProblem:
    """The problem of one run."""
    return shared if lane is None else eqx.combine(lane, shared)


def _derivatives(
    lanes: SimulationProblem | None, shared: SimulationProblem, times: ArrayLike, period: ArrayLike, asked: _Asked
) -> tuple[dict[str, Array], dict[str, dict[str, Array]]]:
    def numbers(lane: SimulationProblem | None) -> dict[str, Array]:
        return select_leaves(_whole(lane, shared)._asdict(), asked.parameters)

    def measured(lane: SimulationProblem | None, flat: Array) -> dict[str, Array]:
        return _metrics(_restored(_whole(lane, shared), flat, asked), times, period, asked)

    first = jax.tree.map(lambda leaf: leaf[0], lanes) if asked.many else lanes
    size, restored = len(ravel_pytree(numbers(first))[0]), ravel_pytree(numbers(first))[1]
    flat = (
        jax.vmap(lambda lane: ravel_pytree(numbers(lane))[0])(lanes) if asked.many else ravel_pytree(numbers(lanes))[0]
    )
    function = (lambda flat: jax.vmap(measured)(lanes, flat)) if asked.many else (lambda flat: measured(lanes, flat))

    if asked.mode is Mode.FORWARD:
        # Each direction for all runs at once: runs are side by side in a vector, and the values are shared.
        def along(direction: Array) -> tuple[dict[str, Array], dict[str, Array]]:
            return jax.jvp(function, (flat,), (jnp.broadcast_to(direction, flat.shape),))

        values, slopes = jax.vmap(along, out_axes=(None, -1))(jnp.eye(size, dtype=flat.dtype))
    else:
        # All metrics at once: one backward program.
        values, back = jax.vjp(function, flat)
        ones = {
            name: jnp.stack([jnp.full_like(value, name == other) for other in asked.metrics])
            for name, value in values.items()
        }
        rows = jax.vmap(lambda each: back(each)[0])(ones)
        slopes = dict(zip(asked.metrics, rows, strict=True))
    shaped = jax.vmap(restored) if asked.many else restored
    return values, {name: shaped(slope) for name, slope in slopes.items()}


_single, _many = jit_arrays(_derivatives), jit_lanes(_derivatives)  # wide vectors slow a single run down


def _natively(
    shared: SimulationProblem, numbers: dict[str, Any], times: ArrayLike, period: ArrayLike, asked: _Asked
) -> tuple[dict[str, Any], dict[str, dict[str, Any]]]:
    """`_single` forwards: the directions are runs side by side, in a program of the C compiler."""
    leaves, structure = jax.tree.flatten(numbers)
    flat: Any = np.concatenate([np.ravel(leaf) for leaf in leaves])
    varying, tangents, (rest, exists, split) = _begun(shared, flat, times, asked)
    values, slopes = _along((shared, flat, varying, rest, split, period, asked), (np.eye(flat.size), tangents))
    ends = np.cumsum([np.size(leaf) for leaf in leaves])[:-1]

    def shaped(slope: Any) -> dict[str, Any]:
        parts = zip(np.split(slope, ends), leaves, strict=True)
        return jax.tree.unflatten(structure, [part.reshape(np.shape(leaf)) for part, leaf in parts])

    return (
        {name: np.where(exists, value[..., 0], np.nan) for name, value in values.items()},
        {name: shaped(slope) for name, slope in slopes.items()},
    )


@jit_arrays
def _begun(
    shared: SimulationProblem, flat: Array, times: ArrayLike, asked: _Asked
) -> tuple[_Begun, _Begun, tuple[_Begun, Array, Array | None]]:
    """Leaves at the start that depend on the parameters, their derivatives; the other leaves, existence and split."""
    of_reference = eqx.is_inexact_array if any(name.startswith("reference.") for name in asked.parameters) else False

    def begin(flat: Array) -> tuple[_Begun, tuple[_Begun, Array, Array | None]]:
        run = _restored(shared, flat, asked)
        setpoints = sample_reference(run.reference, times)
        start, exists = run.start(setpoints)
        change = last_change(setpoints.stiffness)
        kinds = eqx.is_inexact_array, of_reference, of_reference
        varying, rest = eqx.partition((start, setpoints, change), kinds)
        return varying, (rest, exists, _split(change, times, asked))

    def along(direction: Array) -> Any:
        return jax.jvp(begin, (flat,), (direction,), has_aux=True)

    return jax.vmap(along, out_axes=(None, -1, None))(jnp.eye(flat.size))


@NativeFunction
def _along(parts: Any, lane: Any) -> Any:
    """Metrics, and their derivatives in one direction."""
    shared, flat, varying, rest, split, period, asked = parts

    def measured(flat: Array, varying: _Begun) -> dict[str, Array]:
        return _measured(_restored(shared, flat, asked), eqx.combine(varying, rest), split, period, asked)

    return jax.jvp(measured, (flat, varying), lane)


def _measured(
    run: SimulationProblem, begun: _Begun, split: Array | None, period: ArrayLike, asked: _Asked
) -> dict[str, Array]:
    """Metrics of a run that has begun."""
    start, setpoints, change = begun
    checkpoint = asked.mode is Mode.REVERSE
    parts = run.plant, run.controller, setpoints, start, period, asked.substeps
    found = streaming_episode(*parts, change=change, split=split, checkpoint=checkpoint)
    return {name: getattr(found.metrics, name) for name in asked.metrics}


def _needed(run: SimulationProblem, times: NDArray[np.float64], period: float, accuracy: float) -> int:
    """Integration steps per control period of a run; 1 if it cannot start."""
    setpoints = sampled_reference(run.reference, times)
    without: Any = {"reference": None, "controller": None}
    start, exists = start_of(run._replace(**without), setpoints)
    return episode_substeps(run.plant, run.controller, setpoints, start, period, accuracy=accuracy) if exists else 1


def _restored(run: SimulationProblem, flat: Array, asked: _Asked) -> SimulationProblem:
    """The problem of one run with other values of the parameters."""
    _, restored = ravel_pytree(select_leaves(run._asdict(), asked.parameters))
    return SimulationProblem(**replace_leaves(run._asdict(), restored(flat)))


def _metrics(run: SimulationProblem, times: ArrayLike, period: ArrayLike, asked: _Asked) -> dict[str, Array]:
    setpoints = sample_reference(run.reference, times)
    start, exists = run.start(setpoints)
    change = last_change(setpoints.stiffness)
    with batched_program(rolled=asked.many):
        found = _measured(run, (start, setpoints, change), _split(change, times, asked), period, asked)
    return {name: jnp.where(exists, value, jnp.nan) for name, value in found.items()}


def _split(change: Change, times: ArrayLike, asked: _Asked) -> Array | None:
    """Period from which the run without the last change of the stiffness is computed too, if it is needed."""
    return jnp.where(change.ends, change.at, jnp.size(times)) if "coupling" in asked.metrics else None
