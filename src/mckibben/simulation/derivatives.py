"""Exact derivatives of metrics with respect to any numbers of a simulation."""

from __future__ import annotations

import enum
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, ArrayLike, PyTree
from numpy.typing import NDArray

from mckibben.codegen.native import NativeFunction
from mckibben.component.calls import checked_call
from mckibben.control.base import Controller, Reference, Setpoint
from mckibben.errors import ParameterError
from mckibben.numerics.batching import (
    batched_program,
    replace_leaves,
    select_leaves,
)
from mckibben.numerics.compiled import jit_arrays
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
    single_run,
)
from mckibben.simulation.simulate import episode_substeps, start_of

_Begun = tuple[PlantState, Setpoint, Change]  # the last of the stiffness; some of their leaves
_FEW = 10  # up to so many parameters forward differentiation is faster


class Mode(enum.Enum):
    """Mode of automatic differentiation; both give the same derivatives, to rounding."""

    FORWARD = "one tangent per parameter, alongside the run"
    REVERSE = "one backward pass per metric, with each control period recomputed"


@dataclass(frozen=True, repr=False)
class Derivatives:
    """Metrics by name, SI, and by metric and parameter their derivatives, in the shape of the parameter."""

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
    plant, controller, reference, duration, control_period, initial, accuracy, substeps
        As for `simulate`.
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
    run = single_run(problem, control_period, "simulate_many")
    numbers = select_leaves(run._asdict(), parameters)
    for name, leaf in numbers.items():
        if not eqx.is_inexact_array(leaf):
            raise ParameterError(f"{name} is an integer and has no derivative", value=name)
    if mode is None:
        mode = Mode.FORWARD if sum(leaf.size for leaf in numbers.values()) <= _FEW else Mode.REVERSE
    if substeps is None:
        substeps = _needed(run, times, control_period, accuracy)
    asked = _Asked(substeps, tuple(metrics), tuple(parameters), mode)
    period = jnp.asarray(control_period, float)
    native = lambda: _natively(run, numbers, times, period, asked)  # noqa: E731
    by_xla = lambda: jax.tree.map(np.asarray, _by_xla(run, times, period, asked))  # noqa: E731
    values, gradients = compute_with("auto" if mode is Mode.FORWARD else "xla", native, by_xla)[0]

    def slope(metric: str, name: str) -> NDArray[np.float64]:
        """Derivative; NaN where the metric is."""
        return np.where(np.isnan(values[metric]), np.nan, gradients[metric][name])

    return Derivatives(  # in the requested order: compiled programs sort their dictionaries
        {metric: values[metric] for metric in metrics},
        {metric: {name: slope(metric, name) for name in parameters} for metric in metrics},
    )


class _Asked(NamedTuple):
    """Static arguments of the program."""

    substeps: int
    metrics: tuple[str, ...]
    parameters: tuple[str, ...]
    mode: Mode


@jit_arrays
def _by_xla(
    run: SimulationProblem, times: ArrayLike, period: ArrayLike, asked: _Asked
) -> tuple[dict[str, Array], dict[str, dict[str, Array]]]:
    """Metrics and their derivatives."""
    flat, restored = ravel_pytree(select_leaves(run._asdict(), asked.parameters))

    def measured(flat: Array) -> dict[str, Array]:
        return _metrics(_restored(run, flat, asked), times, period, asked)

    if asked.mode is Mode.FORWARD:

        def along(direction: Array) -> tuple[dict[str, Array], dict[str, Array]]:
            return jax.jvp(measured, (flat,), (direction,))

        values, slopes = jax.vmap(along, out_axes=(None, -1))(jnp.eye(len(flat), dtype=flat.dtype))
    else:
        # All metrics at once: one backward program.
        values, back = jax.vjp(measured, flat)
        units = {
            name: jnp.stack([jnp.full_like(value, name == other) for other in asked.metrics])
            for name, value in values.items()
        }
        slopes = dict(zip(asked.metrics, jax.vmap(lambda unit: back(unit)[0])(units), strict=True))
    return values, {name: restored(slope) for name, slope in slopes.items()}


def _natively(
    shared: SimulationProblem, numbers: dict[str, Array], times: ArrayLike, period: ArrayLike, asked: _Asked
) -> tuple[dict[str, NDArray], dict[str, dict[str, NDArray]]]:
    """`_by_xla` forwards: the directions are runs side by side, in a program of the C compiler."""
    leaves, structure = jax.tree.flatten(numbers)
    flat: Any = np.concatenate([np.ravel(leaf) for leaf in leaves])
    varying, tangents, (rest, exists, split) = _begun(shared, flat, times, asked)
    values, slopes = _along((shared, flat, varying, rest, split, period, asked), (np.eye(flat.size), tangents))
    ends = np.cumsum([np.size(leaf) for leaf in leaves])[:-1]

    def shaped(slope: NDArray) -> dict[str, NDArray]:
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

    def along(direction: Array) -> PyTree:
        return jax.jvp(begin, (flat,), (direction,), has_aux=True)

    return jax.vmap(along, out_axes=(None, -1, None))(jnp.eye(flat.size))


@NativeFunction
def _along(parts: PyTree, lane: PyTree) -> PyTree:
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
    streamed = streaming_episode(*parts, change=change, split=split, checkpoint=checkpoint)
    return {name: getattr(streamed.metrics, name) for name in asked.metrics}


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
    with batched_program(rolled=False):
        metrics = _measured(run, (start, setpoints, change), _split(change, times, asked), period, asked)
    return {name: jnp.where(exists, value, jnp.nan) for name, value in metrics.items()}


def _split(change: Change, times: ArrayLike, asked: _Asked) -> Array | None:
    """Period from which the run without the last change of the stiffness is computed too, if it is needed."""
    return jnp.where(change.ends, change.at, jnp.size(times)) if "coupling" in asked.metrics else None
