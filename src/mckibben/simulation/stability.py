"""Stability margins: the sampled loop, linearised at operating points along a run."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Iterable, Iterator, Sequence
from typing import Any, ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, PyTree
from numpy.typing import NDArray

from mckibben.codegen.engine import BatchFunction
from mckibben.component.checks import check_positive
from mckibben.control.base import DiscreteTimeSystem
from mckibben.errors import SimulationError
from mckibben.numerics.batching import map_chunks, pad_chunk
from mckibben.numerics.calculus import evenly_spaced
from mckibben.plant import Plant, PlantState
from mckibben.plant.robot_plant import RobotStart
from mckibben.result import Remark, Result, column
from mckibben.simulation.loop import LoopState, begun, initial_loop
from mckibben.simulation.oscillation import find_limit_cycle
from mckibben.simulation.problem import (
    AtRest,
    SimulationProblem,
    in_order,
    sampled_reference,
    sampled_runs,
    sampling_times,
    single_run,
    split_runs,
    starts_of,
)
from mckibben.simulation.simulate import existing_start
from mckibben.units import HINGE, Duration, JointType, ShortTime, deg, ms

_LOWEST_FREQUENCY = 0.01  # Hz, below the crossover of the slowest valves
_FREQUENCIES = 800  # from there to the Nyquist frequency, in equal ratios
_LANES = 16  # runs of one call
_RANGE = 1e10  # of the units of states: angles of 1e-5 rad, pressures of 1e5 Pa
_MOST_NUMBERS = 2**19  # of the responses of several loops at once
_OPEN = 2 * (1 - 1e-6)  # disk margin of an open loop, to rounding
_COUNTER = 1e-6  # distance from 1 of the eigenvalue of a counter or of a constant state
_STILL = 1e-9  # angle of a control period [rad] at which a loop is as at rest
_ROUNDING = 1e-9  # of responses of loops, which are open below
_WIDTHS = np.array([-4, -2, -1, -0.5, 0, 0.5, 1, 2, 4])  # about resonances, at which their responses are followed

LEAST_DISK_MARGIN = 0.2
"""Disk margin below which a loop must not be used as it is: gains off by 1.2, phases by 11 deg."""


def margin_remarks(least: float, where: str = "") -> Iterator[Remark]:
    """Yield the remark on a least disk margin below `LEAST_DISK_MARGIN`, which is severe in all results that have one.

    >>> [remark.text for remark in margin_remarks(0.12, ", of decoupling at 2 s")]
    ['the least disk margin is 0.12, below 0.2, of decoupling at 2 s']
    >>> list(margin_remarks(0.4))
    []
    """
    if least < LEAST_DISK_MARGIN:
        text = f"the least disk margin is {least:.2g}, below {LEAST_DISK_MARGIN:g}{where}"
        yield Remark.severe("disk_margin", text, "lower the gains, or let `mckibben tune` find some with this margin")


class LinearLoop(NamedTuple):
    """The closed loop over a control period: x' = a x + b d, u = c x, with commands u and their disturbance d."""

    a: NDArray[np.float64]
    b: NDArray[np.float64]
    c: NDArray[np.float64]


class Margins(Result):
    """Stability margins of the sampled loop at operating points along a run.

    The loop is opened at the commands of all valves. Infinite where no disturbance of any size leads to instability,
    and 0 at an unstable point. The disk margin alpha is that of all commands at once, each with its own gain and
    phase, without skew: gains from (2 - alpha)/(2 + alpha) to its inverse and phases up to 2 arctan(alpha / 2).

    Attributes
    ----------
    time
        Time of each operating point [s], shape (points,).
    radius
        Largest modulus of the poles in discrete time, shape (points,); below 1 for a stable loop.
    gain, phase, delay
        Smallest factor, phase [rad] and delay [s] of all commands beyond which the loop is unstable, shape (points,).
    disk
        Disk margin, shape (points,).
    alone
        Disk margin of each command alone, with the loops of the others closed, shape (points, commands).
    peak, loop
        Frequency [Hz] at which the loop comes closest to instability, and whether that is in the loop of the angle,
        which drives the pressures apart, or of the stiffness, or, of a robot, the muscle that takes the largest part in
        it; NaN and empty at an unstable point. Shape (points,).
    frequency
        Frequencies [Hz] of the response, shape (frequencies,).
    sensitivity
        Largest singular value of the sensitivity at the commands, shape (points, frequencies).
    loci
        Eigenvalues of the open loop, complex, shape (points, frequencies, commands).
    oscillation
        Amplitude of the limit cycle of the run [rad]; 0 without one.
    friction
        Whether muscles or joint of the plant have friction.
    muscles
        Names of the muscles of a robot, in the order of the commands.

    References
    ----------
    P. Seiler, A. Packard and P. Gahinet, An introduction to disk margins, IEEE Control Systems Magazine 40, 2020.
    """

    figures: ClassVar = ("margins",)

    time: NDArray[np.float64] = column("s", "time")
    radius: NDArray[np.float64] = column("1", "largest pole", digits=5)
    gain: NDArray[np.float64] = column("1", "gain margin")
    phase: NDArray[np.float64] = column("rad", "phase margin", "deg", phase=True)
    delay: NDArray[np.float64] = column("s", "delay margin", "ms")
    disk: NDArray[np.float64] = column("1", "disk margin")
    peak: NDArray[np.float64] = column("Hz", "at frequency")
    loop: NDArray[np.str_] = column(title="in loop")
    frequency: NDArray[np.float64] = column("Hz", "frequency", dims=("frequency",))
    sensitivity: NDArray[np.float64] = column("1", "sensitivity", dims=("point", "frequency"))
    loci: NDArray[np.complex128] = column("1", "open loop", dims=("point", "frequency", "command"))
    oscillation: float = column("rad", "amplitude of the limit cycle", "deg", default=0.0)
    friction: bool = False
    muscles: tuple[str, ...] = ()
    joint_type: JointType = HINGE
    alone: NDArray[np.float64] = column("1", "disk margin of one", dims=("point", "command"), default=None)

    @property
    def stable(self) -> bool:
        """Whether the loop is stable at all points, and the run free of limit cycles."""
        return bool((self.radius < 1).all()) and not self.oscillation

    def least(self) -> dict[str, float]:
        """Return the least margins by name, with the unit in which results show them."""
        margins = {"gain": self.gain, "phase_deg": self.phase / deg, "delay_ms": self.delay / ms, "disk": self.disk}
        return {name: float(values.min()) for name, values in margins.items()}

    def limit(self) -> str:
        """Return the operating point of the least disk margin, and the loop and frequency of its peak."""
        worst = int(self.disk.argmin())
        which = f"{'' if self.muscles else 'the '}{self.loop[worst]}"
        peak = f" in the loop of {which} at {self.peak[worst]:.3g} Hz" if self.loop[worst] else ""
        return f"at {self.time[worst]:.3g} s{peak}"

    def verdict(self) -> str:
        """Whether the loop is stable at all points, and the least margins."""
        gain, phase, delay, disk = self.least().values()
        text = f"stable at all {self.time.size} points"
        if self.oscillation:
            text = f"the run ends in a limit cycle of {self.joint_type.show(self.oscillation, 'deg', 3)}"
        elif not self.stable:
            first = self.time[self.radius >= 1][0]
            text = f"unstable at {int(np.sum(self.radius >= 1))} of {self.time.size} points, first at {first:.3g} s"
        return f"{text}; least gain {gain:.3g}, phase {phase:.3g} deg, delay {delay:.3g} ms, disk {disk:.3g}"

    def remarks(self) -> Iterable[Remark]:
        """Instability, limit cycle and open loops."""
        if self.oscillation:
            yield Remark.severe("controller", "the margins are of points along the limit cycle", "lower the gains")
        elif not self.stable:
            yield Remark.severe("controller", "the loop is unstable", "lower the gains, or tune with a gain margin")
        yield from margin_remarks(float(self.disk.min()), f", {self.limit()}")
        if self.friction and not self.stable:
            text = (
                "where friction sticks it counts as a spring: oscillations grow there after a small disturbance, until "
                "friction slips"
            )
            yield Remark.warning("friction", text, "simulate with a `disturbance` to see their amplitude")
        if opened := int(np.sum(self.disk >= _OPEN)):
            text = (
                f"at {opened} of the points the loop is open, with all valves in their dead zone, or all commands at "
                "a limit"
            )
            yield Remark.warning("reference", text, "choose a reference in motion")


def margins(
    plant: Plant,
    controller: DiscreteTimeSystem,
    reference: PyTree,
    initial: PlantState | AtRest | RobotStart,
    *,
    duration: Duration,
    control_period: ShortTime = 1e-3,
    substeps: int = 4,
    points: int = 20,
) -> Margins:
    """Return the margins of a loop at points in equal distances along a run, without noise and disturbance torques.

    A reading delay of the sensors counts as a delay of the commands, and valves that switch have their mean flow, with
    commands that lag by half a period. Where a command or a pressure is at its limit, or a valve in its dead zone, the
    linearised loop is open, and its margins are infinite. A run in a limit cycle is not stable, whatever its margins.

    Raises `SimulationError` if the times do not fit together; `RangeError` if there are no points.
    """
    check_positive("margins", points=points)
    times = sampling_times(duration, control_period)
    chosen = evenly_spaced(times.size, int(points))
    problem = single_run(
        _problem(plant, controller, reference, initial, control_period), control_period, "disk_margins"
    )
    mechanism, setpoints = plant.mechanism, in_order(plant, sampled_reference(problem.reference, times))
    kind, muscles = mechanism.joint_type, mechanism.muscle_names
    single = not muscles and any(muscle.law.is_passive for muscle in mechanism.muscles)
    names = (kind.words("angle"),) * len(mechanism.muscles) if single else muscles
    start = existing_start(plant, problem, setpoints, initial)
    start, times = jax.tree.map(lambda leaf: np.asarray(leaf)[..., None], start), times[chosen]
    loops, oscillations = _linearised(None, problem, start, setpoints, control_period, chosen, substeps)
    if not all(np.isfinite(leaf).all() for leaf in loops):
        raise SimulationError("the run diverges before the last point", remedy="give other gains or a shorter duration")
    parts = [
        _margins_of(LinearLoop(*(leaf[:, i] for leaf in loops)), control_period, names, kind) for i in range(len(times))
    ]
    columns: dict[str, Any] = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    columns |= {"oscillation": float(oscillations[0]), "muscles": muscles, "friction": plant.has_friction}
    columns["joint_type"] = kind
    return Margins(time=times, frequency=_frequencies(control_period), **columns)


def disk_margins(
    plant: Plant,
    controller: DiscreteTimeSystem,
    reference: PyTree,
    initial: AtRest | RobotStart | PlantState | None = None,
    *,
    duration: Duration,
    control_period: ShortTime = 1e-3,
    substeps: int = 4,
    points: int = 4,
) -> NDArray[np.float64]:
    """Return the least disk margin along each of many runs.

    1 minus the spectral radius, at least -1, if a point is unstable; at most 0 if the run ends in a limit cycle; NaN if
    it cannot start.

    As `margins`, at fewer points and frequencies, for a batch: arguments as for `simulate_many`, with arrays in place
    of numbers. Shape (runs,).

    Raises `ParameterError` if all runs are the same; `SimulationError` if the times do not fit together.
    """
    times = sampling_times(duration, control_period)
    problem = _problem(plant, controller, reference, initial, control_period)
    lanes, shared, count = split_runs(problem, {}, control_period, "margins")

    chosen = evenly_spaced(times.size, points)

    def of_chunk(piece: slice) -> NDArray[np.float64]:
        some = jax.tree.map(lambda leaf: np.moveaxis(leaf, 0, -1), pad_chunk(lanes, piece, _LANES))
        setpoints = in_order(plant, sampled_runs(some.reference, shared.reference, times))
        start, exists = starts_of(some, shared, setpoints)
        loops, oscillation = _linearised(some, shared, start, setpoints, control_period, chosen, substeps)
        asked = slice(piece.stop - piece.start)
        flat = LinearLoop(*(leaf[asked].reshape(-1, *leaf.shape[2:]) for leaf in loops))
        margins = _disk_margins(flat, control_period).reshape(-1, chosen.size).min(axis=1)
        margins = np.where(oscillation[asked] > 0, np.minimum(margins, 0.0), margins)
        return np.where(np.asarray(exists)[asked], margins, np.nan)

    return np.concatenate([margins_of_chunk for _, margins_of_chunk in map_chunks(of_chunk, count, _LANES)])


def _problem(
    plant: PyTree, controller: DiscreteTimeSystem, reference: PyTree, initial: PyTree, period: float
) -> SimulationProblem:
    """The problem without noise.

    Valves have their mean flow, which lacks the state of a pulse width modulation, and sensors are perfect; their delay
    counts as one of the commands.
    """
    if plant.valve.switches and isinstance(initial, PlantState):
        initial = initial._replace(air=())
    return SimulationProblem.of(linearisable(plant, period), controller, reference, initial)


def linearisable(plant: PyTree, period: float) -> PyTree:
    """Return a plant without noise and disturbance: its valves have their mean flow, and all delays are in commands."""
    own = 0.0 if plant.command_delay is None else plant.command_delay
    delay = getattr(plant.sensors, "delay", 0.0) * period + own
    ideal = dataclasses.replace(plant.with_ideal_io(), valve=plant.valve.averaged())
    return dataclasses.replace(ideal, command_delay=delay if np.any(delay) else None)


class _Loop(NamedTuple):
    """Plant and controller of a sampled loop, or parts of them that vary."""

    plant: PyTree
    controller: PyTree


def _linearised(
    lanes: PyTree,
    shared: PyTree,
    start: PyTree,
    setpoints: PyTree,
    control_period: float,
    chosen: NDArray[np.int64],
    substeps: int,
) -> tuple[LinearLoop, NDArray[np.float64]]:
    """Linearisations of runs at control periods, leaves (runs, points, ...), and amplitudes of limit cycles [rad].

    Arguments have the runs along their last axis; setpoints of all runs alike may lack it.
    """
    constant = _Loop(*shared[:2]), np.asarray(control_period), np.asarray(substeps)
    own, inputs = None if lanes is None else _Loop(*lanes[:2]), len(shared.plant.muscles)
    runs = jax.tree.leaves(start)[0].shape[-1]
    setpoints = jax.tree.map(lambda leaf: np.broadcast_to(leaf.reshape(len(leaf), -1), (len(leaf), runs)), setpoints)
    visited, oscillation = map(np.asarray, _visited("auto", constant, (own, start, setpoints))[0])
    setpoints = jax.tree.map(np.asarray, shared.controller.ahead(setpoints, control_period))
    states = np.moveaxis(visited[chosen], 0, -1)  # (states, runs, points)
    count, *shape = states.shape
    directions = np.eye(count + inputs)

    def lane(leaf: NDArray) -> NDArray:
        """A leaf as lanes, one for each run, point and direction, which are its last axes."""
        return np.broadcast_to(leaf, (*leaf.shape[:-3], *shape, count + inputs)).reshape(*leaf.shape[:-3], -1)

    parts = (
        *jax.tree.map(lambda leaf: lane(np.asarray(leaf)[..., None, None]), (own, start)),
        lane(states[..., None]),
        jax.tree.map(lambda leaf: lane(np.moveaxis(leaf[chosen], 0, -1)[..., None]), setpoints),
        lane(directions[:, None, None]),
    )
    following, wanted = (
        np.moveaxis(np.asarray(rows).reshape(-1, *shape, count + inputs), 0, 2)
        for rows in _along("auto", constant, parts)[0]
    )
    return LinearLoop(following[..., :count], following[..., count:], wanted[..., :count]), oscillation


@BatchFunction
def _visited(shared: PyTree, lane: PyTree) -> tuple[Array, Array]:
    """States of plant and controller at each control period, and the amplitude of the limit cycle of the run [rad]."""
    (loop, period, substeps), (own, start, setpoints) = shared, lane
    run: _Loop = loop if own is None else eqx.combine(own, loop)
    still = jnp.zeros(len(run.plant.muscles))

    def step(loop: LoopState, setpoint: PyTree) -> tuple[LoopState, tuple[Array, PyTree, PyTree]]:
        following, _ = _advance(run, loop, setpoint, still, period, substeps)
        angles = run.plant.true_measurement(loop[0]).angle, run.controller.desired_angle(setpoint)
        return following, (ravel_pytree(loop)[0], *jax.tree.map(jnp.asarray, angles))

    states, *angles = lax.scan(step, *begun(run.plant, run.controller, setpoints, start, period))[1]
    find = functools.partial(find_limit_cycle, period=period, scale=run.plant.mechanism.joint_type.scale)
    cycles = map(find, *map(jax.tree.leaves, angles))
    return states, functools.reduce(jnp.maximum, (cycle.amplitude for cycle in cycles))


@functools.partial(BatchFunction, flags=("-O1",))  # long, and run for few periods: -O2 takes gcc four times as long
def _along(shared: PyTree, lane: PyTree) -> tuple[Array, Array]:
    """Derivatives of the next state and of the commands in a direction of the state and the disturbed commands."""
    (loop, period, substeps), (own, start, state, setpoint, direction) = shared, lane
    run: _Loop = loop if own is None else eqx.combine(own, loop)
    shapes = jax.eval_shape(initial_loop, run.plant, run.controller, start)
    unravel = ravel_pytree(jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), shapes))[1]

    def flat_step(x: Array, disturbance: Array) -> tuple[Array, Array]:
        following, wanted = _advance(run, unravel(x), setpoint, disturbance, period, substeps)
        return ravel_pytree(following)[0], wanted

    size = state.shape[0]
    return jax.jvp(flat_step, (state, jnp.zeros(len(run.plant.muscles))), (direction[:size], direction[size:]))[1]


def _advance(
    run: _Loop, loop: LoopState, setpoint: PyTree, disturbance: Array, period: Array, substeps: PyTree
) -> tuple[LoopState, Array]:
    """The loop after a control period with disturbed commands, and the commands."""
    state, held = loop
    state, measurement = run.plant.sample(state, period)
    held, wanted = run.controller.step(held, setpoint, measurement, period)
    commands = run.plant.clip_commands(tuple(one + disturbance[i] for i, one in enumerate(wanted)))
    return (run.plant.follow(state, commands, period, substeps), held), jnp.stack(wanted)


def _frequencies(period: float, count: int = _FREQUENCIES) -> NDArray[np.float64]:
    """Frequencies [Hz] of the response."""
    return np.geomspace(_LOWEST_FREQUENCY, 1 / (2 * period), count)


def _radii(poles: NDArray[np.complex128]) -> NDArray[np.float64]:
    """Largest moduli of the poles that move, of loops with poles of shape (loops, n)."""
    return np.where(np.abs(poles - 1) > _COUNTER, np.abs(poles), 0.0).max(axis=1)


class _Triangular(NamedTuple):
    """Linear loops in the coordinates of a Schur decomposition, whose matrices are upper triangular.

    Shapes (loops, n, n), (loops, n, commands) and (loops, commands, n).
    """

    a: NDArray[np.complex128]
    b: NDArray[np.complex128]
    c: NDArray[np.complex128]

    @classmethod
    def of(cls, loops: LinearLoop) -> _Triangular:
        from scipy.linalg import get_lapack_funcs

        (balance,), (decompose,) = get_lapack_funcs(("gebal",), (loops.a,)), get_lapack_funcs(("gees",), dtype=complex)
        triangular: list[Any] = []
        for a, b, c in zip(*loops, strict=True):
            scale = np.clip(balance(a, scale=1)[3], 1 / _RANGE, _RANGE)
            upper, _, _, basis, _, _ = decompose(lambda _: None, a * scale / scale[:, None])
            triangular.append((upper, basis.conj().T @ (b / scale[:, None]), (c * scale) @ basis))
        return cls(*map(np.array, zip(*triangular, strict=True)))

    @property
    def poles(self) -> NDArray[np.complex128]:
        return np.diagonal(self.a, axis1=1, axis2=2)

    def sensitivity(self, angles: NDArray[np.float64]) -> NDArray[np.complex128]:
        """Commands over their disturbance, at angles [rad] of a control period.

        Angles of shape (loops, frequencies) give (loops, frequencies, commands, commands).
        """
        count, size, inputs = self.b.shape
        if count * size * inputs * angles.shape[1] > _MOST_NUMBERS and count > 1:
            alone = [_Triangular(*(leaf[i : i + 1] for leaf in self)) for i in range(count)]
            return np.concatenate([loop.sensitivity(angles[i : i + 1]) for i, loop in enumerate(alone)])
        z, b = np.repeat(np.exp(1j * angles), inputs, axis=1), np.tile(self.b, angles.shape[1])
        states = np.zeros((count, size, z.shape[1]), complex)
        for k in reversed(range(size)):  # substitution from the last state, of all loops at all angles at once
            known = b[:, k] + (self.a[:, k, None, k + 1 :] @ states[:, k + 1 :])[:, 0]
            states[:, k] = known / (z - self.a[:, k, k, None])
        return np.eye(inputs) + np.moveaxis((self.c @ states).reshape(count, inputs, -1, inputs), 1, 2)

    def peaks(self, period: float, *, few: int = 120, tops: int = 4, rounds: int = 4) -> tuple[NDArray, ...]:
        """Disk margins, frequencies [Hz] of the peaks that limit them, and the commands of the peaks.

        The disk margin is the inverse of the largest response of S - 1/2 of a stable loop.

        From frequencies in equal ratios and the resonances of the poles with their widths, the frequencies about the
        largest local maxima, the `tops`, are refined by a factor of four in each round, so that narrow peaks are met
        to well below 1 %.
        """
        poles, half = self.poles, np.eye(self.b.shape[2]) / 2
        turning = poles.imag > 0
        some = np.argsort(~turning, axis=1, kind="stable")[:, : turning.sum(axis=1).max()]
        resonance, width = np.where(turning, np.angle(poles), np.pi), 1 - np.abs(poles)
        resonance, width = (np.take_along_axis(values, some, axis=1) for values in (resonance, width))
        even = np.tile([_STILL, *(2 * np.pi * _frequencies(period, few) * period)], (len(poles), 1))
        angles = np.concatenate([even, resonance, resonance - width, resonance + width], axis=1)
        angles = np.sort(angles.clip(_STILL, np.pi), axis=1)
        sizes = _largest_singular(self.sensitivity(angles) - half)
        between = np.array([0.25, 0.5, 0.75])
        for _ in range(rounds):
            padded = np.pad(sizes, ((0, 0), (1, 1)))
            maxima = np.where((sizes > padded[:, :-2]) & (sizes >= padded[:, 2:]), sizes, 0.0)
            top = np.argsort(maxima, axis=1)[:, -tops:]
            sides = (top[..., None] + [-1, 1]).clip(0, angles.shape[1] - 1)
            middle = np.take_along_axis(angles, top, axis=1)[..., None, None]
            towards = np.take_along_axis(angles[:, None], sides, axis=2)[..., None] - middle
            new = (middle + towards * between).reshape(len(poles), -1)
            new_sizes = _largest_singular(self.sensitivity(new) - half)
            angles, sizes = np.concatenate([angles, new], axis=1), np.concatenate([sizes, new_sizes], axis=1)
            order = np.argsort(angles, axis=1, kind="stable")
            angles, sizes = (np.take_along_axis(values, order, axis=1) for values in (angles, sizes))
        top = np.argmax(sizes, axis=1)[:, None]
        angle, size = (np.take_along_axis(values, top, axis=1) for values in (angles, sizes))
        directions = np.linalg.svd(self.sensitivity(angle)[:, 0] - half)[2][:, 0]
        return 1 / size[:, 0], angle[:, 0] / (2 * np.pi * period), directions


def _largest_singular(matrices: NDArray[np.complex128]) -> NDArray[np.float64]:
    """Largest singular values of matrices; of 2 x 2 ones from the invariants of each times its adjoint."""
    if matrices.shape[-1] != 2:
        return np.linalg.norm(matrices, 2, axis=(-2, -1))
    trace = (np.abs(matrices) ** 2).sum(axis=(-2, -1))
    determinant = np.abs(matrices[..., 0, 0] * matrices[..., 1, 1] - matrices[..., 0, 1] * matrices[..., 1, 0])
    return np.sqrt((trace + np.sqrt(np.maximum(trace**2 - 4 * determinant**2, 0.0))) / 2)


def _disk_margins(loops: LinearLoop, period: float) -> NDArray[np.float64]:
    """Disk margins of loops, leaves (loops, ...); 1 minus the spectral radius of unstable ones, -1 if not finite."""
    margins = np.full(len(loops.a), -1.0)
    finite = np.logical_and.reduce([np.isfinite(leaf).all(axis=(1, 2)) for leaf in loops])
    if finite.any():
        triangular = _Triangular.of(LinearLoop(*(leaf[finite] for leaf in loops)))
        radii = _radii(triangular.poles)
        stable, margins[finite] = radii < 1, np.maximum(1 - radii, -1.0)
        if stable.any():
            some = _Triangular(*(leaf[stable] for leaf in triangular))
            margins[np.flatnonzero(finite)[stable]] = some.peaks(period)[0]
    return margins


def _margins_of(
    loops: LinearLoop, period: float, names: Sequence[str] = (), joint_type: JointType = HINGE
) -> dict[str, NDArray]:
    """Columns of `Margins` of linear loops, leaves (loops, ...), of a joint, or with names of the loops of muscles."""
    triangular, angles = _Triangular.of(loops), 2 * np.pi * _frequencies(period) * period
    radius, turning = _radii(triangular.poles), triangular.poles[triangular.poles.imag > 0]
    narrow = np.angle(turning) + np.multiply.outer(_WIDTHS, 1 - np.abs(turning))
    dense = np.unique(np.concatenate([[_STILL], angles, narrow[(narrow > _STILL) & (narrow < np.pi)]]))
    sensitivity = triangular.sensitivity(np.broadcast_to(dense, (radius.size, dense.size)))
    responses = np.linalg.eigvals(sensitivity - np.eye(sensitivity.shape[-1])).astype(np.complex128)
    even = np.searchsorted(dense, angles)
    gain, phase, delay = _crossings(responses, dense, period)
    sensitivity, responses = sensitivity[:, even], responses[:, even]
    with np.errstate(divide="ignore", invalid="ignore"):  # of an integrator
        loci = -responses / (1 + responses)
    disk, peak, directions = triangular.peaks(period)
    if names:
        loop = np.array(names)[np.abs(directions).argmax(axis=1)]
    else:  # that of the angle drives the pressures apart, that of the stiffness both up and down
        common, difference = np.abs(directions @ [[1, 1], [1, -1]]).T
        loop = np.where(difference > common, joint_type.words("angle"), "stiffness")
    gain = np.maximum(gain, np.divide(2 + disk, 2 - disk, out=np.full_like(disk, np.inf), where=disk < 2))  # its bound
    alone = 1 / np.abs(np.diagonal(sensitivity, axis1=2, axis2=3) - 0.5).max(axis=1)
    margins: dict[str, NDArray] = {"gain": gain, "phase": phase, "delay": delay, "disk": disk, "alone": alone.T}
    margins = {name: np.where(radius < 1, values, 0.0).T for name, values in margins.items()}
    margins |= {"peak": np.where(radius < 1, peak, np.nan), "loop": np.where(radius < 1, loop, "")}
    return margins | {"radius": radius, "sensitivity": _largest_singular(sensitivity), "loci": loci}


def _crossings(
    responses: NDArray[np.complex128], angles: NDArray[np.float64], period: float
) -> list[NDArray[np.float64]]:
    """Gain margins, phase margins [rad] and delay margins [s] of stable loops.

    They follow from the eigenvalues m of the responses of the commands to their disturbance, of shape (loops,
    frequencies, commands), at angles [rad of a period] from 0 to pi. All commands times 1 + 1/m put a pole at that
    angle: the gain margin is the least of these factors that is real and above 1, phases and delays are those of
    factors of size 1. Below 0 and beyond pi the responses are conjugate. A delay of one period makes a loop unstable
    whose locus ends beyond 1 or -1.
    """
    followed = _followed(np.concatenate([responses[:, 1:2].conj(), responses, responses[:, -2:-1].conj()], axis=1))
    factors = 1 + 1 / np.where(np.abs(followed) > _ROUNDING, followed, _ROUNDING)  # at a resonance a line
    before, change = factors[:, :-1], np.diff(factors, axis=1)
    crosses = (before.imag > 0) != (factors[:, 1:].imag > 0)
    at = before.real - before.imag / np.where(crosses, change.imag, 1) * change.real
    gain = np.min(at, axis=(1, 2), where=crosses & (at > 1) & (at < 1 / _ROUNDING), initial=np.inf)
    before, change = before[:, 1:-1], change[:, 1:-1]
    square, half = np.maximum(np.abs(change) ** 2, 1e-300), (before.conj() * change).real
    rooted = half**2 - square * (np.abs(before) ** 2 - 1)
    part = np.stack([sign * np.sqrt(np.maximum(rooted, 0)) - half for sign in (-1, 1)]) / square
    inside = (rooted >= 0) & (part >= 0) & (part <= 1)
    lag = np.mod(-np.angle(before + np.where(inside, part, 0) * change), 2 * np.pi)
    delay = lag / (angles[:-1, None] + np.where(inside, part, 0) * np.diff(angles)[:, None]) * period
    phase = np.min(np.minimum(lag, 2 * np.pi - lag), axis=(0, 2, 3), where=inside, initial=np.inf)
    least = np.where(np.prod(factors[:, -2] ** 2 - 1, axis=1).real < 0, period, np.inf)
    return [gain, phase, np.minimum(least, np.min(delay, axis=(0, 2, 3), where=inside, initial=np.inf))]


def _followed(loci: NDArray[np.complex128]) -> NDArray[np.complex128]:
    """Loci (loops, frequencies, commands), followed over the frequency to the nearest neighbours."""
    from scipy.optimize import linear_sum_assignment

    distances, places = np.abs(loci[:, :-1, :, None] - loci[:, 1:, None]), np.arange(loci.shape[2])
    nearest = distances.argmin(axis=3)
    for at in zip(*np.nonzero((np.sort(nearest) != places).any(axis=2)), strict=True):  # two have the same neighbour
        nearest[at] = linear_sum_assignment(distances[at])[1]
    order = np.tile(places, (*loci.shape[:2], 1))
    for k in np.flatnonzero((nearest != places).any(axis=(0, 2))):  # where the solver gives them in another order
        order[:, k + 1 :] = np.take_along_axis(nearest[:, k], order[:, k], axis=1)[:, None]
    return np.take_along_axis(loci, order, axis=2)
