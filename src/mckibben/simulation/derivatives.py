"""Exact derivatives of metrics with respect to any numbers of a simulation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, ArrayLike, PyTree
from numpy.typing import NDArray

from mckibben.codegen.engine import BatchFunction
from mckibben.component.calls import checked_call
from mckibben.control.base import DiscreteTimeSystem, Reference
from mckibben.errors import ParameterError
from mckibben.mechanism.base import over_joints
from mckibben.numerics.batching import replace_leaves, select_leaves
from mckibben.numerics.compiled import jit_arrays
from mckibben.plant import Plant, PlantState
from mckibben.plant.robot_plant import RobotStart
from mckibben.simulation.accuracy import ACCURACY, check_accuracy
from mckibben.simulation.loop import streaming_episode
from mckibben.simulation.metrics import Metrics, last_change
from mckibben.simulation.problem import (
    AtRest,
    SimulationProblem,
    check_names,
    in_order,
    sampled_reference,
    sampling_times,
    single_run,
    starts_of,
)
from mckibben.simulation.simulate import episode_substeps
from mckibben.units import Duration, ShortTime

_Begun = tuple[PlantState, PyTree, PyTree]  # the last of the stiffness; some of their leaves


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
    plant: Plant,
    controller: DiscreteTimeSystem,
    reference: Reference | Mapping[str, Reference],
    parameters: Sequence[str],
    *,
    metrics: Sequence[str] = ("angle_rmse", "stiffness_rmse"),
    duration: Duration = 10.0,
    control_period: ShortTime = 1e-3,
    accuracy: float = ACCURACY,
    substeps: int | None = None,
    initial: PlantState | AtRest | RobotStart | None = None,
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
    if substeps is None:
        substeps = _needed(run, times, control_period, accuracy)
    program = _Program(substeps, tuple(metrics), tuple(parameters))
    flat, restored = ravel_pytree(numbers)
    varying, tangents, (rest, exists) = _begun(run, flat, times, program)
    parts = run, flat, varying, rest, jnp.asarray(control_period, float), program
    (values, slopes), _ = _along("auto", parts, (np.eye(flat.size), tangents))

    def slope(metric: str, name: str) -> NDArray[np.float64]:
        """Derivative; NaN where the metric is."""
        return np.where(np.isnan(known[metric]), np.nan, gradients[metric][name])

    known = {metric: np.where(exists, value[..., 0], np.nan) for metric, value in values.items()}
    gradients = {metric: restored(slopes[metric]) for metric in known}
    return Derivatives(known, {metric: {name: slope(metric, name) for name in parameters} for metric in known})


def _by_name(metrics: Mapping[str, PyTree], joints: Sequence[str]) -> dict[str, Array]:
    """Metrics by name; those of named joints have the joint in it, such as ``angle_rmse.hip``."""
    of_joints = {name: value for name, value in metrics.items() if isinstance(value, tuple)}
    named = {
        f"{name}.{joint}": own for name, rows in of_joints.items() for joint, own in zip(joints, rows, strict=True)
    }
    return {name: value for name, value in metrics.items() if name not in of_joints} | named


class _Program(NamedTuple):
    """Static arguments of the program."""

    substeps: int
    metrics: tuple[str, ...]
    parameters: tuple[str, ...]


@jit_arrays
def _begun(run: SimulationProblem, flat: Array, times: ArrayLike, program: _Program) -> tuple[_Begun, _Begun, PyTree]:
    """Leaves at the start that depend on the parameters, their derivatives, all other leaves, and existence."""
    of_reference = eqx.is_inexact_array if any(name.startswith("reference.") for name in program.parameters) else False

    def begin(flat: Array) -> tuple[_Begun, tuple[_Begun, Array]]:
        setpoints = (varied := _restored(run, flat, program)).setpoints(times)
        start, exists = varied.start(setpoints)
        kinds = eqx.is_inexact_array, of_reference, of_reference
        changes = over_joints(lambda own: last_change(own.stiffness), setpoints)
        varying, rest = eqx.partition((start, setpoints, changes), kinds)
        return varying, (rest, exists)

    def along(direction: Array) -> PyTree:
        return jax.jvp(begin, (flat,), (direction,), has_aux=True)

    return jax.vmap(along, out_axes=(None, -1, None))(jnp.eye(flat.size))


@BatchFunction
def _along(parts: PyTree, lane: PyTree) -> tuple[dict[str, Array], dict[str, Array]]:
    """Metrics, and their derivatives in one direction of the parameters."""
    problem, flat, varying, rest, period, program = parts

    def measured(flat: Array, varying: _Begun) -> dict[str, Array]:
        run = _restored(problem, flat, program)
        start, setpoints, change = eqx.combine(varying, rest)
        parts = run.plant, run.controller, setpoints, start, period, program.substeps
        metrics = streaming_episode(*parts, change=change, coupling="coupling" in program.metrics).metrics
        return _by_name({name: getattr(metrics, name) for name in program.metrics}, run.plant.mechanism.joint_names)

    return jax.jvp(measured, (flat, varying), lane)


def _restored(run: SimulationProblem, flat: Array, program: _Program) -> SimulationProblem:
    """The problem of one run with other values of the parameters."""
    _, restored = ravel_pytree(select_leaves(run._asdict(), program.parameters))
    return SimulationProblem(**replace_leaves(run._asdict(), restored(flat)))


def _needed(run: SimulationProblem, times: NDArray[np.float64], period: float, accuracy: float) -> int:
    """Integration steps per control period of a run; 1 if it cannot start."""
    setpoints = in_order(run.plant, sampled_reference(run.reference, times))
    start, exists = starts_of(None, run, setpoints)
    return episode_substeps(run.plant, run.controller, setpoints, start, period, accuracy=accuracy) if exists else 1
