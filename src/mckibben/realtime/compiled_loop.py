"""Control periods of a simulated joint that is not paced, computed by one compiled loop.

The operations are those of the loop period by period, in their order, so that all results are the same.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array
from numpy.typing import NDArray

from mckibben.codegen.native import EXACT, NativeFunction
from mckibben.realtime.compiled_step import (
    ControlProgram,
    FlatTree,
    LimitCycleDetection,
    advance_flat,
    detect_flat,
    step_flat,
)
from mckibben.realtime.simulated import SimulatedJoint
from mckibben.rig.calibration import Calibration
from mckibben.rig.safety import JointMonitor
from mckibben.simulation.oscillation import Oscillations


class Channels(NamedTuple):
    """Conversions of the simulated joint and of its host; each a tuple over channels, in SI and volts."""

    sensors: tuple[tuple[Any, ...], ...]  # gain, offset, tare; ends of the converter; ends of a working sensor
    valves: tuple[tuple[Any, ...], ...]  # gain, offset, tare; ends of the converter; rated pressures
    steps: tuple[Any, Any]  # of the encoder [rad] and the converter [V]; 0 for none
    limits: tuple[tuple[Any, Any], ...]  # of the commands [Pa]
    following: tuple[tuple[Any, Any], ...]  # gain and zero of the pressures, as the monitor has them
    share: Any  # of the monitor's filter


class Periods(NamedTuple):
    """Inputs of control periods, each of shape (periods,)."""

    counts: Any  # whether it is one: the others fill the chunk
    raising: Any  # whether the commands are given
    step: Any  # number of the controller's step, from 0
    ramp: tuple[Any, Any]  # given commands [Pa]
    reference: tuple[Any, Any]
    noise: tuple[Any, Any]  # of the pressures [Pa]


class LoopState(NamedTuple):
    """State of joint and host between two periods."""

    plant: Any
    controller: Any
    detection: Any  # of limit cycles
    commands: tuple[Any, Any]  # [Pa], of the host
    valves: tuple[Any, Any]  # [Pa], as the valves have them
    errors: tuple[Any, Any]  # of the pressures from their commands [Pa], filtered


class PeriodRecord(NamedTuple):
    """Record of control periods: tuples of columns, or arrays of shape (periods, columns)."""

    volts: Any
    reading: Any
    errors: Any
    wanted: Any
    commands: Any
    telemetry: Any
    cycle: Any  # `Oscillations` so far


class Joint(NamedTuple):
    """Numbers and layouts of controller and plant, as compiled, and the period [s]."""

    controller: Any
    plant: Any
    controller_layouts: tuple[FlatTree, FlatTree]
    plant_layouts: tuple[FlatTree, FlatTree, int]
    detection_layout: FlatTree
    resolution: Any  # of the angle [rad], for the detection
    telemetry: int  # number of its values
    period: Any


def _clip(x: Any, low: Any, high: Any) -> Any:
    """`min(max(x, low), high)` of Python."""
    x = jnp.where(low > x, low, x)
    return jnp.where(high < x, high, x)


def _rounded(x: Any, step: Any) -> Any:
    return jnp.where(step > 0, lax.round(x / step, lax.RoundingMethod.TO_NEAREST_EVEN) * step, x)


def _run(parts: tuple[Joint, Channels, LoopState, Periods], _: None) -> tuple[LoopState, PeriodRecord]:
    """States and records of periods, each from the sample at its start to its command."""
    joint, channels, start, periods = parts

    def period(state: LoopState, at: Periods) -> tuple[LoopState, PeriodRecord]:
        moving = jnp.stack([*state.valves, joint.period])
        plant = advance_flat(*joint.plant_layouts, joint.plant, state.plant, moving)
        true = _rounded(plant[0], channels.steps[0]), plant[2] + at.noise[0], plant[3] + at.noise[1]
        volts, reading = [], []
        for value, (gain, offset, tare, low, high, working, broken) in zip(true, channels.sensors, strict=True):
            signal = _clip(_rounded((value + tare) / gain + offset, channels.steps[1]), low, high)
            volts.append(signal)
            right = (working <= signal) & (signal <= broken)
            reading.append(jnp.where(right, (signal - offset) * gain - tare, jnp.nan))
        errors = tuple(
            error + channels.share * (signal * gain + zero - command - error)
            for error, signal, (gain, zero), command in zip(
                state.errors, volts[1:], channels.following, state.commands, strict=True
            )
        )

        def controlled(memory: Array, detection: Array) -> tuple[Array, ...]:
            inputs = jnp.stack([*at.reference, *reading, joint.period])
            memory, values = step_flat(*joint.controller_layouts, joint.controller, memory, inputs)
            sent = [_clip(values[i], *limits) for i, limits in enumerate(channels.limits)]
            seen = jnp.stack([reading[0], at.reference[0], *sent, at.step, joint.period, joint.resolution])
            return memory, values, *detect_flat(joint.detection_layout, detection, seen)

        def raised(memory: Array, detection: Array) -> tuple[Array, ...]:
            values = jnp.concatenate([jnp.stack(at.ramp), jnp.full(joint.telemetry, jnp.nan)])
            return memory, values, detection, jnp.zeros(len(Oscillations._fields))

        memory, values, detection, cycle = lax.cond(at.raising, raised, controlled, state.controller, state.detection)
        wanted = values[0], values[1]
        commands = tuple(_clip(one, *limits) for one, limits in zip(wanted, channels.limits, strict=True))
        valves = tuple(
            _clip((_clip((command + tare) / gain + offset, low, high) - offset) * gain - tare, least, most)
            for command, (gain, offset, tare, low, high, least, most) in zip(commands, channels.valves, strict=True)
        )
        new = LoopState(plant, memory, detection, commands, valves, errors)  # type: ignore[arg-type]
        new = LoopState(*(_chosen(at.counts, *pair) for pair in zip(new, state, strict=True)))
        reported = tuple(values[2 + i] for i in range(joint.telemetry))
        return new, PeriodRecord(tuple(volts), tuple(reading), errors, wanted, commands, reported, tuple(cycle))

    return lax.scan(period, start, periods)


def _chosen(counts: Any, new: Any, old: Any) -> Any:
    if isinstance(new, tuple):
        return tuple(jnp.where(counts, *pair) for pair in zip(new, old, strict=True))
    return jnp.where(counts, new, old)


run_periods = NativeFunction(_run, EXACT)
"""Program of `_run`; raises `ExportError` where it cannot be compiled."""


def compute_periods(
    program: ControlProgram,
    backend: SimulatedJoint,
    monitor: JointMonitor,
    limits: tuple[tuple[float, float], tuple[float, float]],
    memory: NDArray[np.float64] | None,
    detection: LimitCycleDetection,
    steps: NDArray[np.int64],
    commands: tuple[float, float],
    ramp: NDArray[np.float64],
    references: NDArray[np.float64],
    sensors: Sequence[Calibration],
    *,
    size: int,
) -> tuple[PeriodRecord, LoopState]:
    """Compute many periods of a simulated joint after a command.

    Parameters
    ----------
    program, backend, monitor, detection
        Controller, joint, safety monitor and detection of limit cycles, the last with its state before the periods.
    limits
        Lowest and highest command of each muscle [Pa].
    memory
        Packed state of the controller, shape (size,); None on a ramp.
    steps
        Numbers of the controller's steps, shape (periods,), for the detection.
    commands
        Commands before the periods [Pa].
    ramp, references
        Commands of a ramp [Pa], and references [rad], [N*m/rad]; shape (periods, 2).
    sensors
        Calibrations of the sensors as the host has them.
    size
        Most periods of a call.

    Returns
    -------
    tuple of PeriodRecord and LoopState
        Record, arrays of shape (periods, ...), and the state after the periods.

    Raises
    ------
    ExportError
        If it cannot be compiled.
    """
    count, raising, start = len(references), memory is None, backend.ahead(len(references))
    memory = np.zeros(program.layouts[1].size) if memory is None else memory
    plant, period, telemetry = backend.program, start.period, len(program.telemetry)
    layouts = program.layouts, plant.layouts, detection.layout
    joint = Joint(program.numbers, plant.numbers, *layouts, detection.resolution, telemetry, period)
    of_sensors, valves = backend.channels()
    working = [one.working_volts(channel) for one, channel in zip(sensors, backend.inputs, strict=True)]
    channels = Channels(
        tuple((*one, *ends) for one, ends in zip(of_sensors, working, strict=True)),
        valves,
        (backend.sensing.angle_step, backend.sensing.volts_step),
        limits,
        tuple((one.gain, one.zero) for one in monitor.signals[1:]),
        monitor.share,
    )
    columns = [_filled(column, size) for column in (*ramp.T, *references.T, *start.noise.T)]
    pairs = zip(columns[::2], columns[1::2], strict=True)
    periods = Periods(np.arange(size) < count, np.full(size, raising), _filled(steps.astype(float), size), *pairs)
    errors: Any = tuple(monitor.errors)
    state = LoopState(start.state, memory, detection.memory, commands, start.commands, errors)
    parts = jax.tree.map(_as_array, (joint, channels, state, periods))  # other numbers compile nothing
    after, record = run_periods(parts)
    parts = (np.array([column[:count] for column in part]).reshape(len(part), count).T for part in record)
    return PeriodRecord(*parts), after


def _as_array(leaf: Any) -> Any:
    return np.asarray(leaf) if isinstance(leaf, float) else leaf


def _filled(values: NDArray[np.float64], size: int) -> NDArray[np.float64]:
    """Values, and then the last one."""
    return np.concatenate([values, np.repeat(values[-1:], size - len(values), axis=0)])
