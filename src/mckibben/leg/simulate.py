"""Runs of a leg: one with its time traces, or many at once with metrics."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, NamedTuple, cast

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, ArrayLike, Float

from mckibben.codegen.native import NativeFunction
from mckibben.errors import ParameterError, SimulationError
from mckibben.leg.control import LegController, LegMeasurement
from mckibben.leg.dynamics import Posture, foot_mobility
from mckibben.leg.metrics import LEG_UNITS, SAMPLE_UNITS, LegMetrics, MetricSums, observe
from mckibben.leg.plant import LegPlant, LegState
from mckibben.muscle import SpringLaw
from mckibben.notebook import Progress, notebook_progress
from mckibben.numerics.batching import batched_program, lanes_of, map_chunks, pad_chunk, with_leaves
from mckibben.numerics.compiled import compiled, compiled_as_given, compiled_batch, numeric
from mckibben.simulation.batch import chunk_size
from mckibben.simulation.engine import compute_with
from mckibben.simulation.problem import sampling_times
from mckibben.simulation.resolution import STABILITY_LIMIT

if TYPE_CHECKING:
    import xarray as xr

Scalar = Float[Array, ""]


class LegStart(NamedTuple):
    """Start of a run: angles [rad], pressures [Pa], clearance of the foot [m], and upward speed [m/s].

    Numbers, or arrays over runs; see `LegPlant.init_state`.
    """

    angles: tuple[ArrayLike, ...]
    pressures: tuple[ArrayLike, ...]
    clearance: ArrayLike = 0.0
    upward_speed: ArrayLike = 0.0


def _begin(plant: LegPlant, controller: LegController, start: LegStart) -> tuple[LegState, Any]:
    """States of leg and controller at the start."""
    state = plant.init_state(*start[:2], clearance=start.clearance, upward_speed=start.upward_speed)
    return state, controller.init(_sample(plant, state, 0.0, 0.0)[1])


def _period(
    plant: LegPlant, controller: LegController, state: tuple[LegState, Any], time: Array, period: Any, substeps: int
) -> tuple[tuple[LegState, Any], tuple[Array, ...]]:
    """A control period: the next states, and the commands."""
    at, measured = _sample(plant, state[0], time, period)
    held, wanted = controller.step(state[1], measured, period)
    commands = plant.clip_commands(wanted)
    return (plant.follow(at, commands, period, substeps), held), commands


def _sample(plant: LegPlant, state: LegState, time: ArrayLike, period: ArrayLike) -> tuple[LegState, LegMeasurement]:
    """State at the start of a control period, with its disturbance, and the measurement."""
    state, (angles, pressures) = plant.sample(state, period)
    return state, LegMeasurement(jnp.asarray(time), cast(Any, angles), pressures, plant.ground_force(state)[1])


def leg_episode(
    plant: LegPlant, controller: LegController, start: LegStart, times: Array, period: ArrayLike, substeps: int
) -> dict[str, Any]:
    """Run a leg; a pure function, to be compiled, vmapped and differentiated: samples, commands and telemetry."""

    def advance(state: tuple[LegState, Any], time: Array) -> tuple[Any, dict[str, Any]]:
        sample = observe(plant, state[0])
        following, commands = _period(plant, controller, state, time, period, substeps)
        return following, {"sample": sample, "command": commands, "telemetry": controller.telemetry(following[1])}

    return lax.scan(advance, _begin(plant, controller, start), times)[1]


def leg_metrics(
    plant: LegPlant, controller: LegController, start: LegStart, times: Array, period: ArrayLike, substeps: int
) -> LegMetrics:
    """Run a leg and return its metrics alone; a pure function, whose memory does not grow with the duration."""

    def advance(carry: tuple[Any, MetricSums], time: Array) -> tuple[Any, None]:
        state, sums = carry
        state, _ = _period(plant, controller, state, time, period, substeps)
        return (state, sums.after(observe(plant, state[0]), period, plant)), None

    state = _begin(plant, controller, start)
    sums = MetricSums.of(observe(plant, state[0]))
    return lax.scan(advance, (state, sums), times)[0][1].finished()


def simulate_leg(
    plant: LegPlant,
    controller: LegController,
    start: LegStart,
    *,
    duration: float,
    control_period: float = 1e-3,
    substeps: int = 4,
    engine: str = "auto",
) -> xr.Dataset:
    """Simulate a leg; the dataset has all states, forces and commands over ``time``.

    Columns of joints have the dimension ``joint``, those of muscles ``muscle``. Attributes: ``units`` of each, and the
    ``engine`` that computed it.

    Parameters
    ----------
    plant, controller, start
        Leg, controller, and start of the run.
    duration, control_period
        [s]; the first is a multiple of the second.
    substeps
        Integration steps a control period.
    engine
        "native", "xla" or "auto", as for `mckibben.simulate`.

    Raises
    ------
    SimulationError
        If the times do not fit together, the step is too long for ground, stops, friction or air, or the run diverges.
    RangeError
        If the start is not possible; see `LegPlant.init_state`.
    """
    plant = plant.with_period(control_period)
    _begin(plant, controller, start)  # raises
    times = sampling_times(duration, control_period, substeps)
    check_step(plant, start, control_period, substeps)
    parts = numeric((plant, controller, start, times, np.asarray(control_period)))
    answer, used = compute_with(
        engine,
        np.float64,
        lambda: _native_episode((*parts, substeps), None),
        lambda: _episode(*parts, substeps=substeps),
    )
    table = _table(plant, jax.tree.map(np.asarray, answer), times).assign_attrs(engine=used)
    wrong = ~np.isfinite(table["z"].to_numpy())
    if wrong.any():
        raise SimulationError(
            f"the run diverges at {times[wrong.argmax()]:.4g} s",
            field="substeps",
            value=substeps,
            remedy="give more substeps, or softer stops and ground",
        )
    return table


_episode = compiled_as_given(leg_episode)


@NativeFunction
def _native_episode(parts: Any, _: None) -> dict[str, Any]:
    return leg_episode(*parts)


def simulate_legs(
    plant: LegPlant,
    controller: LegController,
    start: LegStart,
    *,
    over: Mapping[str, ArrayLike] | None = None,
    duration: float,
    control_period: float = 0.5e-3,
    substeps: int = 1,
    chunk: int | None = None,
    workers: int | None = None,
    engine: str = "auto",
    progress: Progress | None = None,
) -> xr.Dataset:
    """Simulate a leg many times, as `simulate_leg` does, and return the `LegMetrics` along ``run``.

    Parameters
    ----------
    plant, controller, start
        With arrays of shape (runs,) in place of numbers that differ between runs.
    over
        Arrays by the dotted name of a leaf, such as ``{"plant.leg.trunk.mass": [0.9, 1.1]}``; the names begin with
        ``plant``, ``controller`` or ``start``.
    duration, control_period, substeps, engine
        As for `simulate_leg`; forces are sampled once a control period.
    chunk, workers, progress
        As for `mckibben.simulate_many`.

    Raises
    ------
    ParameterError
        If there is no such leaf, or no number varies.
    SimulationError
        If the times do not fit together, or the step is too long for ground, stops, friction or air.
    """
    trees = with_leaves({"plant": plant, "controller": controller, "start": start}, over or {})
    trees["plant"] = plant = trees["plant"].with_period(control_period)
    count, varying = lanes_of(trees)
    if count is None:
        raise ParameterError("all runs are the same", remedy="give an array in place of a number, or use simulate_leg")
    times = sampling_times(duration, control_period, substeps)
    check_step(trees["plant"], trees["start"], control_period, substeps)
    lanes, shared = eqx.partition(numeric(trees), varying)
    size = chunk_size(chunk, count, workers, engine)
    given = shared, times, np.asarray(control_period), substeps

    def compute(piece: slice) -> tuple[LegMetrics, str]:
        lane = pad_chunk(lanes, piece, size)
        answer, used = compute_with(
            engine,
            np.float64,
            lambda: _native_metrics(given, _last_axis(lane)),
            lambda: _metrics(lane, shared, *given[1:]),
        )
        return jax.tree.map(lambda x: np.asarray(x)[..., : piece.stop - piece.start], answer), used

    progress = progress or notebook_progress()
    answers = []
    for piece, answer in map_chunks(compute, count, size, workers):
        answers.append(answer)
        if progress:
            progress(f"{piece.stop} of {count} runs", piece.stop / count)
    import xarray as xr

    joined = jax.tree.map(lambda *parts: np.concatenate(parts, axis=-1), *(found for found, _ in answers))
    table: dict[str, Any] = {}
    for name, values in joined._asdict().items():
        dims = ("joint", "run") if isinstance(values, tuple) else ("run",)
        table[name] = (dims, np.stack(values) if isinstance(values, tuple) else values, {"units": LEG_UNITS[name]})
    finite = np.isfinite(joined.peak_force + joined.peak_trunk_force + joined.deflection)
    table["diverged"] = ("run", ~finite, {"long_name": "whether the run diverged"})
    coords = {"joint": [joint.name for joint in plant.leg.joints]}
    return xr.Dataset(table, coords=coords, attrs={"engine": answers[0][1]})


def _last_axis(tree: Any) -> Any:
    return jax.tree.map(lambda x: np.moveaxis(np.asarray(x), 0, -1), tree)


def _run(lane: Any, shared: Any, times: Any, period: Any, substeps: int) -> LegMetrics:
    own = eqx.combine(lane, shared)
    return leg_metrics(own["plant"], own["controller"], own["start"], times, period, substeps)


@compiled_batch
def _metrics(lanes: Any, *given: Any) -> LegMetrics:
    def run(lane: Any) -> LegMetrics:
        with batched_program():
            return _run(lane, *given)

    return jax.vmap(run)(lanes)


@NativeFunction
def _native_metrics(given: Any, lane: Any) -> LegMetrics:
    return _run(lane, *given)


_LONGEST = 0.5  # of a step, times the circular frequency of ground or stops


def check_step(plant: LegPlant, start: LegStart, control_period: float, substeps: int) -> None:
    """Raise `SimulationError` where integration steps do not resolve ground, stops, friction or air at the start.

    Of many runs the first is taken.
    """
    first = jax.tree.map(lambda x: np.asarray(x, float).ravel()[0] if eqx.is_array_like(x) else x, (plant, start))
    plant, start = first
    leg, ground, step = plant.leg, plant.ground, control_period / substeps
    mobility = np.asarray(_mobility(leg, start.angles))
    stops = [
        math.sqrt(joint.stop_stiffness / (link.inertia + link.mass * link.centre**2))
        for joint, link in zip(leg.joints, leg.links, strict=True)
        if joint.locked is None
    ]
    sticking = [
        math.sqrt(float(joint.friction.steepest) / (link.inertia + link.mass * link.centre**2))
        for joint, link in zip(leg.joints, leg.links, strict=True)
        if joint.locked is None and joint.friction is not None
    ]
    weight = float(leg.total_mass) * plant.gravity
    needed = {
        "the ground": math.sqrt(ground.stiffness * np.linalg.eigvalsh(mobility)[-1]) / _LONGEST,
        "the stops": max(stops, default=0.0) / _LONGEST,
        "the friction of the joints": max(sticking, default=0.0) / _LONGEST,
        "the friction of the ground": ground.friction * weight / ground.slip_speed * mobility[0, 0] / STABILITY_LIMIT,
    }
    if plant.valve.holds_air:
        muscles = (muscle for muscle in leg.muscles if not isinstance(muscle.law, SpringLaw))
        volumes = (float(muscle.specimen.volume(muscle.domain.contraction_min)) for muscle in muscles)
        needed["the air"] = plant.valve.fastest_rate_in(min(volumes)) / STABILITY_LIMIT
    what, fastest = max(needed.items(), key=lambda item: item[1])
    if fastest * step > 1 + 1e-9:
        raise SimulationError(
            f"integration steps of {step * 1e3:g} ms do not resolve {what}: {1e3 / fastest:.2g} ms would",
            field="substeps",
            value=substeps,
            lower=math.ceil(fastest * control_period),
            remedy="give more substeps or a shorter step, or what is softer or slower there",
        )


@compiled
def _mobility(leg: Any, angles: tuple[ArrayLike, ...]) -> Array:
    zero = jnp.zeros(())
    return foot_mobility(leg, Posture(zero, zero, zero, leg.held(angles)))


def _table(plant: LegPlant, answer: dict[str, Any], times: Any) -> xr.Dataset:
    import xarray as xr

    columns: dict[str, Any] = {}
    joints = [joint.name for joint in plant.leg.joints]
    given = answer["sample"]._asdict() | {"command": answer["command"]}
    of_joints = ("angle", "velocity", "stop_torque")
    for name, values in given.items():
        about = {"units": SAMPLE_UNITS[name]} if name in SAMPLE_UNITS else {}
        if isinstance(values, tuple):
            columns[name] = (("joint" if name in of_joints else "muscle", "time"), np.stack(values), about)
        else:
            columns[name] = ("time", values, about)
    columns |= {name: ("time", values) for name, values in answer["telemetry"].items()}
    coords = {"time": ("time", times, {"units": "s"}), "joint": joints, "muscle": list(plant.leg.muscle_names)}
    return xr.Dataset(columns, coords=coords)
