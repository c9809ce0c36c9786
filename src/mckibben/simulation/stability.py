"""Stability margins: the sampled loop, linearised at operating points along a run."""

from __future__ import annotations

import dataclasses
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, ArrayLike
from numpy.typing import NDArray

from mckibben.component.checks import check_positive
from mckibben.control.base import Controller, Reference, Setpoint
from mckibben.errors import ParameterError
from mckibben.notebook import draw, html_table
from mckibben.numerics.batching import batched_program, map_chunks, pad_chunk
from mckibben.numerics.calculus import evenly_spaced
from mckibben.numerics.compiled import compiled_as_given, numeric
from mckibben.plant import JointPlant, PlantState
from mckibben.simulation.loop import LoopState, initial_loop
from mckibben.simulation.problem import AtRest, SimulationProblem, sample_reference, sampling_times, split_runs
from mckibben.units import deg, ms

_FREQUENCIES = 400  # from a hundredth of the Nyquist frequency up, in equal ratios
_FEW_FREQUENCIES = 60  # of margins of many runs
_LANES = 8  # runs of one call
_COUNTER = 1e-6  # distance from 1 of the eigenvalue of a counter or of a constant state


class LinearLoop(NamedTuple):
    """The closed loop over a control period: x' = a x + b d, u = c x, with commands u and their disturbance d."""

    a: Any
    b: Any
    c: Any


class Margins(NamedTuple):
    """Margins along a run; every leaf has the shape (points,) unless another is given.

    The loop is opened at the commands of both valves. Infinite where no disturbance of any size leads to instability,
    and 0 at an unstable point. The disk margin alpha is that of both commands at once, each with its own gain and
    phase, without skew: gains from (2 - alpha)/(2 + alpha) to its inverse and phases up to 2 arctan(alpha / 2).

    References
    ----------
    P. Seiler, A. Packard and P. Gahinet, An introduction to disk margins, IEEE Control Systems Magazine 40, 2020.
    """

    time: NDArray[np.float64]  # of the operating point [s]
    radius: NDArray[np.float64]  # largest modulus of the poles in discrete time; below 1 for a stable loop
    gain: NDArray[np.float64]  # smallest factor of both commands beyond which the loop is unstable
    phase: NDArray[np.float64]  # likewise [rad]
    delay: NDArray[np.float64]  # likewise [s]
    disk: NDArray[np.float64]
    frequency: NDArray[np.float64]  # shape (frequencies,) [Hz]
    sensitivity: NDArray[np.float64]  # largest singular value at the commands, shape (points, frequencies)
    loci: NDArray[np.complex128]  # eigenvalues of the open loop, shape (points, frequencies, 2)

    def __repr__(self) -> str:
        least = ", ".join(f"{name} {margin.min():.3g}" for name, margin in self.in_shown_units().items())
        return f"<Margins at {len(self.time)} points; least: {least}>"

    def _repr_html_(self) -> str:
        return html_table("stability margins", self.headers, self.rows(), [self.verdict()])

    @property
    def headers(self) -> tuple[str, ...]:
        """Columns of `rows`."""
        return "margin", "least", "median", "unit", "least at"

    def rows(self) -> list[tuple[str, ...]]:
        """Least and median margins with the time of the least, as text."""
        return [
            (
                name.partition("_")[0],
                f"{values.min():.3g}",
                f"{np.median(values):.3g}",
                name.partition("_")[2] or "1",
                f"{self.time[values.argmin()]:.3g} s",
            )
            for name, values in self.in_shown_units().items()
        ]

    def verdict(self) -> str:
        """Text that says whether the loop is stable at all points."""
        unstable = self.time[self.radius >= 1]
        if unstable.size:
            return f"unstable at {unstable.size} of {self.time.size} points, first at {unstable[0]:.3g} s"
        return f"stable at all {self.time.size} points; largest pole {self.radius.max():.4f} in discrete time"

    def plot(self) -> Any:
        """Return a figure of the open loop and the sensitivity, see `mckibben.report.margins`."""
        return draw("margins", self)

    def in_shown_units(self) -> dict[str, NDArray[np.float64]]:
        """Return the margins by name and unit, each of shape (points,)."""
        return {"gain": self.gain, "phase_deg": self.phase / deg, "delay_ms": self.delay / ms, "disk": self.disk}


def margins(
    plant: JointPlant,
    controller: Controller,
    reference: Reference,
    initial: PlantState,
    *,
    duration: float,
    control_period: float = 1e-3,
    substeps: int = 4,
    points: int = 20,
) -> Margins:
    """Return the margins of a loop at points in equal distances along a run, without noise and disturbance torques.

    A reading delay of the sensors counts as a delay of the commands. Where a command or a pressure is at its limit the
    linearised loop is open, and its margins are infinite.

    Raises `SimulationError` if the times do not fit together; `RangeError` if there are no points.
    """
    check_positive("margins", points=points)
    times = sampling_times(duration, control_period)
    chosen = evenly_spaced(times.size, int(points))
    loops = _linearised_at(plant, controller, reference, initial, times, control_period, chosen, substeps)[0]
    found = [_margins_of(LinearLoop(*loop), control_period) for loop in zip(*map(np.asarray, loops), strict=True)]
    radius, gain, phase, delays, disk, sensitivity, loci = (np.array(column) for column in zip(*found, strict=True))
    return Margins(times[chosen], radius, gain, phase, delays, disk, _frequencies(control_period), sensitivity, loci)


def linear_loop(
    plant: JointPlant,
    controller: Controller,
    reference: Reference,
    initial: PlantState,
    *,
    duration: float,
    control_period: float = 1e-3,
    substeps: int = 4,
    time: float = 0.0,
) -> tuple[LinearLoop, float, list[str]]:
    """Return the linearisation at the control period nearest to a time [s], its time, and the names of its states.

    As for `margins`; names are attributes of the states of plant and controller, such as "plant.angle".

    Raises `ParameterError` if the time is not within the duration; `SimulationError` if the times do not fit together.
    """
    times = sampling_times(duration, control_period)
    if not 0 <= time <= duration:
        message = f"the time {time:g} s is not within the run of {duration:g} s"
        remedy = "choose a time of the run"
        raise ParameterError(message, field="time", value=time, lower=0.0, upper=duration, unit="s", remedy=remedy)
    chosen = np.array([int(np.argmin(np.abs(times - time)))])
    loops, state = _linearised_at(plant, controller, reference, initial, times, control_period, chosen, substeps)
    names = []
    for path, leaf in jax.tree_util.tree_leaves_with_path(state):
        name = ("plant", "controller")[path[0].idx] + jax.tree_util.keystr(path[1:])
        names += [name] if leaf.shape == () else [f"{name}[{i}]" for i in range(leaf.size)]
    return LinearLoop(*(np.asarray(leaf)[0] for leaf in loops)), float(times[chosen[0]]), names


def _linearised_at(
    plant: JointPlant,
    controller: Controller,
    reference: Reference,
    initial: PlantState,
    times: NDArray[np.float64],
    control_period: float,
    chosen: NDArray[np.int64],
    substeps: int,
) -> tuple[LinearLoop, Any]:
    """Linearisations at control periods of a run, and the shapes of the states of plant and controller."""
    plant = _without_noise(plant, control_period).with_period(control_period)
    controller = controller.with_period(control_period)
    plant, controller, initial = numeric((plant, controller, plant.complete_state(initial)))
    setpoints = sample_reference(reference, times)
    loops = _linearised(
        plant, controller, initial, jnp.asarray(control_period), setpoints, jnp.asarray(chosen), substeps
    )
    return loops, jax.eval_shape(initial_loop, plant, controller, initial)


def disk_margins(
    plant: JointPlant,
    controller: Controller,
    reference: Reference,
    initial: AtRest | PlantState | None = None,
    *,
    duration: float,
    control_period: float = 1e-3,
    substeps: int = 4,
    points: int = 4,
) -> NDArray[np.float64]:
    """Return the least disk margin along each of many runs: 0 if a point is unstable, NaN if a run cannot start.

    As `margins`, at fewer points and frequencies, for a batch: arguments as for `simulate_many`, with arrays in place
    of numbers. Shape (runs,).

    Raises `ParameterError` if all runs are the same; `SimulationError` if the times do not fit together.
    """
    times = sampling_times(duration, control_period)
    problem = SimulationProblem.of(_without_noise(plant, control_period), controller, reference, initial)
    lanes, shared, count = split_runs(problem, {}, control_period, "margins")
    period, chosen = jnp.asarray(control_period), jnp.asarray(evenly_spaced(times.size, points))

    def of_chunk(piece: slice) -> list[float]:
        found = _linearised_lanes(pad_chunk(lanes, piece, _LANES), shared, times, period, chosen, substeps)
        loops, exists = jax.tree.map(lambda leaf: np.asarray(leaf)[: piece.stop - piece.start], found)
        each = zip(zip(*loops, strict=True), exists, strict=True)
        return [_least_disk_margin(LinearLoop(*loop), control_period) if starts else np.nan for loop, starts in each]

    return np.concatenate([found for _, found in map_chunks(of_chunk, count, _LANES)])


def _without_noise(plant: JointPlant, period: float) -> JointPlant:
    """The plant with perfect sensors, whose reading delay counts as one of the commands."""
    own = 0.0 if plant.command_delay is None else plant.command_delay
    delay = getattr(plant.sensors, "delay", 0.0) * period + own
    return dataclasses.replace(plant.with_ideal_io(), command_delay=delay if np.any(delay) else None)


@compiled_as_given
def _linearised_lanes(
    lanes: SimulationProblem, shared: SimulationProblem, times: ArrayLike, period: Array, chosen: Array, substeps: int
) -> tuple[LinearLoop, Array]:
    """Linearisations of many runs, leaves of shape (runs, points, ...), and whether each can start."""

    def one(lane: SimulationProblem) -> tuple[LinearLoop, Array]:
        run = eqx.combine(lane, shared)
        setpoints = sample_reference(run.reference, times)
        start, exists = run.start(setpoints)
        return _linearised(run.plant, run.controller, start, period, setpoints, chosen, substeps), exists

    return lax.map(one, lanes)  # in parallel they take minutes to compile


@compiled_as_given
def _linearised(
    plant: JointPlant,
    controller: Controller,
    initial: PlantState,
    period: Array,
    setpoints: Setpoint,
    chosen: Array,
    substeps: int,
) -> LinearLoop:
    """Linearisations at control periods of a run; leaves have the shape (points, ...)."""

    def advance(loop: LoopState, setpoint: Setpoint, disturbance: Array) -> tuple[LoopState, Array]:
        state, held = loop
        state, measurement = plant.sample(state, period)
        held, wanted = controller.step(held, setpoint, measurement, period)
        commands = plant.clip_commands((wanted[0] + disturbance[0], wanted[1] + disturbance[1]))
        return (plant.follow(state, commands, period, substeps), held), jnp.stack(wanted)

    begun = initial_loop(plant, controller, initial)
    flat, unravel = ravel_pytree(begun)
    none = jnp.zeros(2, flat.dtype)

    def step(loop: LoopState, setpoint: Setpoint) -> tuple[LoopState, Array]:
        return advance(loop, setpoint, none)[0], ravel_pytree(loop)[0]

    def linearise(at: Array) -> LinearLoop:
        setpoint = jax.tree.map(lambda column: column[at], setpoints)

        def flat_step(x: Array, disturbance: Array) -> tuple[Array, Array]:
            following, wanted = advance(unravel(x), setpoint, disturbance)
            return ravel_pytree(following)[0], wanted

        (a, b), (c, _) = jax.jacfwd(flat_step, (0, 1))(visited[at], none)
        return LinearLoop(a, b, c)

    with batched_program():  # quicker to compile
        visited = lax.scan(step, begun, setpoints)[1]
        return lax.map(linearise, chosen)


def _frequencies(period: float, count: int = _FREQUENCIES) -> NDArray[np.float64]:
    """Frequencies [Hz] of the response."""
    return np.geomspace(0.01, 1.0, count) / (2 * period)


def _radius(poles: NDArray[np.complex128]) -> float:
    """Largest modulus of the poles that move."""
    return float(np.abs(poles[np.abs(poles - 1) > _COUNTER]).max(initial=0.0))


def _sensitivity(loop: LinearLoop, angles: NDArray[np.float64]) -> NDArray[np.complex128]:
    """Commands over their disturbance, at angles [rad] of a control period; shape (angles, 2, 2)."""
    a, b, c = loop
    shifted = np.exp(1j * angles)[:, None, None] * np.eye(len(a)) - a
    return np.eye(2) + c @ np.linalg.solve(shifted, np.broadcast_to(b, (angles.size, *b.shape)))


def _with_resonances(angles: NDArray[np.float64], poles: NDArray[np.complex128]) -> NDArray[np.float64]:
    """Angles [rad] of a control period, and those of the poles between them, near which narrow peaks lie."""
    resonances = np.abs(np.angle(poles))
    return np.concatenate([angles, resonances[(resonances > angles[0]) & (resonances < angles[-1])]])


def _disk(sensitivity: NDArray[np.complex128]) -> float:
    """Disk margin of a stable loop."""
    return float(1 / np.linalg.norm(sensitivity - np.eye(2) / 2, 2, axis=(1, 2)).max())


def _least_disk_margin(loops: LinearLoop, period: float) -> float:
    """Least disk margin of the loops at several points; 0 if one is unstable."""
    angles = 2 * np.pi * _frequencies(period, _FEW_FREQUENCIES) * period
    if not np.isfinite(loops.a).all():
        return 0.0
    poles = np.linalg.eigvals(loops.a)
    if any(_radius(one) >= 1 for one in poles):
        return 0.0
    each = zip(map(LinearLoop._make, zip(*loops, strict=True)), poles, strict=True)
    return min(_disk(_sensitivity(loop, _with_resonances(angles, one))) for loop, one in each)


def _margins_of(loop: LinearLoop, period: float) -> tuple[ArrayLike, ...]:
    """Radius, gain, phase, delay and disk margin, sensitivity and loci of a linearised loop."""
    poles = np.linalg.eigvals(loop.a)
    radius = _radius(poles)
    angles = 2 * np.pi * _frequencies(period) * period
    at_all = _sensitivity(loop, _with_resonances(angles, poles) if radius < 1 else angles)
    sensitivity = at_all[: angles.size]
    opened = np.eye(2) - np.linalg.inv(sensitivity)  # commands over disturbed commands: minus the loop gain
    loci = -np.linalg.eigvals(opened).astype(np.complex128)
    largest = np.linalg.norm(sensitivity, 2, axis=(1, 2))
    if radius >= 1:
        return radius, 0.0, 0.0, 0.0, 0.0, largest, loci
    gain, phase, delay = _crossings(loci, angles, period)
    return radius, gain, phase, delay, _disk(at_all), largest, loci


def _crossings(loci: NDArray[np.complex128], angles: NDArray[np.float64], period: float) -> tuple[float, float, float]:
    """Gain margin, phase margin [rad] and delay margin [s] from the loci of the open loop over the frequency."""
    gain = phase = delay = np.inf
    followed = loci.copy()
    for k in range(1, len(followed)):  # in the order of the nearest neighbours
        if np.abs(followed[k] - followed[k - 1]).sum() > np.abs(followed[k][::-1] - followed[k - 1]).sum():
            followed[k] = followed[k][::-1]
    for locus in followed.T:
        turned = np.unwrap(np.angle(locus))
        size = np.abs(locus)
        for k in np.flatnonzero((size[:-1] - 1) * (size[1:] - 1) < 0):
            part = (1 - size[k]) / (size[k + 1] - size[k])
            lag = np.mod(turned[k] + part * (turned[k + 1] - turned[k]) + np.pi, 2 * np.pi)
            phase = min(phase, lag, 2 * np.pi - lag)
            delay = min(delay, lag / (angles[k] + part * (angles[k + 1] - angles[k])) * period)
        crossing = np.floor((turned - np.pi) / (2 * np.pi))
        for k in np.flatnonzero(np.diff(crossing)):
            at = size[k : k + 2].mean()
            gain = min(gain, 1 / at) if at < 1 else gain
    return float(gain), float(phase), float(delay)
