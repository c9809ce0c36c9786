"""Stability margins: the sampled loop, linearised at operating points along a run."""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, ArrayLike
from numpy.typing import NDArray

from mckibben.control.base import Controller, Reference, Setpoint
from mckibben.numerics.batching import batched_program
from mckibben.numerics.compiled import compiled_as_given, numeric
from mckibben.plant import JointPlant, PlantState
from mckibben.simulation.loop import LoopState, initial_loop
from mckibben.simulation.problem import sample_reference, sampling_times

_FREQUENCIES = 400  # from a hundredth of the Nyquist frequency up, in equal ratios
_COUNTER = 1e-6  # distance from 1 of the eigenvalue of a counter or of what nothing moves


class LinearLoop(NamedTuple):
    """Linearisation of the closed loop over a control period: x' = a x + b d, u = c x.

    u are the commands of the controller, and d a disturbance of them.
    """

    a: Array
    b: Array
    c: Array


class Margins(NamedTuple):
    """Margins along a run; every leaf has the shape (points,), loci and frequencies aside.

    The loop is opened at the commands of both valves. Infinite where no disturbance of any size leads to instability,
    and 0 at an unstable point.

    Attributes
    ----------
    time
        Of the operating point [s].
    radius
        Largest modulus of the poles in discrete time; below 1 for a stable loop.
    gain, phase, delay
        Least factor of both commands, phase [rad], and delay [s], beyond which the loop is unstable.
    disk
        Disk margin alpha of both commands at once, each with its own gain and phase, without skew: gains from
        (2 - alpha)/(2 + alpha) to its inverse and phases up to 2 arctan(alpha / 2).
    frequency
        [Hz], shape (frequencies,).
    sensitivity
        Largest singular value of the sensitivity at the commands, shape (points, frequencies).
    loci
        Eigenvalues of the open loop, shape (points, frequencies, 2).

    References
    ----------
    P. Seiler, A. Packard and P. Gahinet, An introduction to disk margins, IEEE Control Systems Magazine 40, 2020.
    """

    time: NDArray[np.float64]
    radius: NDArray[np.float64]
    gain: NDArray[np.float64]
    phase: NDArray[np.float64]
    delay: NDArray[np.float64]
    disk: NDArray[np.float64]
    frequency: NDArray[np.float64]
    sensitivity: NDArray[np.float64]
    loci: NDArray[np.complex128]


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

    Raises
    ------
    SimulationError
        If the times do not fit together.
    """
    delay = getattr(plant.sensors, "delay", 0.0) * control_period + (plant.command_delay or 0.0)
    plant = dataclasses.replace(plant.with_ideal_io(), command_delay=delay or None)
    plant, controller = plant.with_period(control_period), controller.with_period(control_period)
    times = sampling_times(duration, control_period)
    chosen = np.unique(np.linspace(0, times.size - 1, points).round().astype(int))
    plant, controller, initial = numeric((plant, controller, plant.complete_state(initial)))
    setpoints = sample_reference(reference, times)
    loops = _linearised(
        plant, controller, initial, jnp.asarray(control_period), setpoints, jnp.asarray(chosen), substeps
    )
    found = [
        _margins_of(np.asarray(a), np.asarray(b), np.asarray(c), control_period) for a, b, c in zip(*loops, strict=True)
    ]
    radius, gain, phase, delays, disk, sensitivity, loci = (np.array(column) for column in zip(*found, strict=True))
    return Margins(times[chosen], radius, gain, phase, delays, disk, _frequencies(control_period), sensitivity, loci)


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


def _frequencies(period: float) -> NDArray[np.float64]:
    """Frequencies [Hz] of the response."""
    return np.geomspace(0.01, 1.0, _FREQUENCIES) / (2 * period)


def _margins_of(
    a: NDArray[np.float64], b: NDArray[np.float64], c: NDArray[np.float64], period: float
) -> tuple[ArrayLike, ...]:
    """Radius, gain, phase, delay and disk margin, sensitivity and loci of a linearised loop."""
    poles = np.linalg.eigvals(a)
    moving = np.abs(poles[np.abs(poles - 1) > _COUNTER])
    radius = float(moving.max(initial=0.0))
    angles = 2 * np.pi * _frequencies(period) * period
    identity = np.eye(len(a))
    response = np.stack([c @ np.linalg.solve(np.exp(1j * w) * identity - a, b) for w in angles])
    sensitivity = np.eye(2) + response  # of the commands to their disturbance
    opened = np.eye(2) - np.linalg.inv(sensitivity)  # commands over disturbed commands: minus the loop gain
    loci = -np.linalg.eigvals(opened).astype(np.complex128)
    largest = np.linalg.norm(sensitivity, 2, axis=(1, 2))
    alpha = 1 / np.linalg.norm(sensitivity - np.eye(2) / 2, 2, axis=(1, 2)).max()
    if radius >= 1:
        return radius, 0.0, 0.0, 0.0, 0.0, largest, loci
    gain, phase, delay = _crossings(loci, angles, period)
    return radius, gain, phase, delay, alpha, largest, loci


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
