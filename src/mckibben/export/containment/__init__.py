"""Checks around the steps of a controller: no bad sample changes its state, and its commands end in a vent.

Written once in scalar `jax.numpy`, and part of every generated controller. A sample is not used if a number is not
finite or outside its limits, or if a sensor is frozen while the commands move. The state then stays as it is, and the
last commands are held, and the time of holding is counted; beyond the time `tolerated` they are those of the vent. The
count falls with the good samples as it rose, but for the first one after a bad one: a fault that comes and goes vents
if it takes at least half of the samples, and one of three in turn never does. After a time `tolerated` of good samples
alone the controller starts again from the measurement, its commands along a ramp.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, PyTree

from mckibben.joint import Measurement
from mckibben.serial_protocol import FaultCode, FirmwareState

USE, HOLD, RESTART = 0, 1, 2
"""Results of `Containment.check`: what to do with a sample."""


class ControlSample(NamedTuple):
    """Setpoint and measurement of a control period."""

    setpoint: PyTree
    measurement: PyTree


class Containment(NamedTuple):
    """Limits of the samples and commands of a controller; its numbers are parameters of the program.

    Attributes
    ----------
    lowest, highest
        Bounds of the numbers of a sample, which are finite.
    lowest_commands, highest_commands, vent
        Bounds of the commands [Pa, or openings], and the commands of the vent.
    moved
        Change of the command of each sensor beyond which the sensor has to change.
    frozen
        Longest time [s] without a change of a sensor after that.
    tolerated
        Time [s] of holding before the vent, and of good samples after it.
    ramp
        Duration [s] of the ramp after a restart.
    """

    lowest: ControlSample
    highest: ControlSample
    lowest_commands: tuple[ArrayLike, ...]
    highest_commands: tuple[ArrayLike, ...]
    vent: tuple[ArrayLike, ...]
    moved: tuple[ArrayLike, ...]
    frozen: ArrayLike
    tolerated: ArrayLike
    ramp: ArrayLike

    def clip(self, commands: tuple[Array, ...]) -> tuple[Array, ...]:
        """Commands within their limits."""
        return tuple(map(jnp.clip, commands, self.lowest_commands, self.highest_commands))


class WatchedSensor(NamedTuple):
    """Last value of a sensor, the command when it changed, and the time [s] since the command left that behind."""

    value: Array
    command: Array
    unchanged: Array


class ContainedState(NamedTuple):
    """State of a controller, its last commands, and what the checks remember.

    Attributes
    ----------
    start, share
        Commands at the beginning of a ramp, and the share of it that has passed.
    held, good
        Time [s] of holding less that of good samples which follow a good one, when vented since the last good sample;
        and of good samples alone since the vent.
    status, fault
        A `FirmwareState` and a `FaultCode`.
    """

    controller: PyTree
    commands: tuple[Array, ...]
    start: tuple[Array, ...]
    sensors: tuple[WatchedSensor, ...]
    share: Array
    held: Array
    good: Array
    status: Array
    fault: Array


def begin(
    limits: Containment, period_is_right: Array, measurement: PyTree, commands: tuple[Array, ...]
) -> tuple[ContainedState, Array]:
    """State at the start, without that of the controller, and whether period and measurement are valid.

    If not, it is vented, and with a wrong period remains so.

    Parameters
    ----------
    commands
        First ones, held if the first sample is not usable.
    """
    zero, within_limits = jnp.zeros(()), within(measurement, limits.lowest.measurement, limits.highest.measurement)
    valid, commands = period_is_right & within_limits, limits.clip(commands)
    sensors = tuple(WatchedSensor(value, command, zero) for value, command in _watched(measurement, commands))
    sent = tuple(jnp.where(valid, *pair) for pair in zip(commands, limits.vent, strict=True))
    good = jnp.where(period_is_right, 0.0, -jnp.inf)
    status = jnp.where(valid, int(FirmwareState.RUNNING), int(FirmwareState.VENTED))
    fault = jnp.where(within_limits, int(FaultCode.NONE), int(FaultCode.OUT_OF_RANGE))
    fault = jnp.where(period_is_right, fault, int(FaultCode.LATE))
    return ContainedState((), sent, sent, sensors, zero + 1.0, zero, good, status, fault), valid


def _watched(measurement: PyTree, commands: tuple[Array, ...]) -> list[tuple[Array, Array]]:
    """Sensors that have to change with commands: pressures, and the angle of a joint with half their difference."""
    watched = list(zip(measurement.pressures, commands, strict=True))
    if isinstance(measurement, Measurement):
        watched.append((measurement.angle, (commands[1] - commands[0]) / 2))
    return watched


def within(sample: PyTree, lowest: PyTree, highest: PyTree) -> Array:
    """Whether all numbers of a sample are within their bounds, and so finite."""
    numbers = zip(*map(jax.tree.leaves, (sample, lowest, highest)), strict=True)
    return _all((low <= number) & (number <= high) for number, low, high in numbers)


def check(
    limits: Containment, state: ContainedState, sample: ControlSample, commands: tuple[Array, ...], period: float
) -> tuple[ContainedState, Array]:
    """State after checking a sample, and whether to use it, to hold, or to begin the controller again first.

    Parameters
    ----------
    commands
        Those from which a restart begins.
    """
    finite, inside = _all(map(jnp.isfinite, jax.tree.leaves(sample))), within(sample, limits.lowest, limits.highest)
    watched = zip(state.sensors, _watched(sample.measurement, state.commands), limits.moved, strict=True)
    sensors = tuple(_watch(sensor, *now, moved, period) for sensor, now, moved in watched)
    alive = _all(sensor.unchanged <= limits.frozen for sensor in sensors)
    fault = jnp.where(alive, int(FaultCode.NONE), int(FaultCode.FROZEN))
    fault = jnp.where(inside, fault, int(FaultCode.OUT_OF_RANGE))
    fault = jnp.where(finite, fault, int(FaultCode.NOT_FINITE))
    right, vented = fault == 0, state.status == int(FirmwareState.VENTED)
    good = jnp.where(right, state.good + period, jnp.minimum(state.good, 0.0))
    again = vented & (good > limits.tolerated)
    start = tuple(jnp.where(again, *pair) for pair in zip(limits.clip(commands), state.start, strict=True))
    action = jnp.where(again, RESTART, jnp.where(right & ~vented, USE, HOLD))
    share = jnp.where(again, 0.0, state.share)
    held = jnp.where(right & vented, 0.0, state.held)
    return state._replace(sensors=sensors, start=start, share=share, held=held, good=good, fault=fault), action


def _all(conditions: Iterable[Array]) -> Array:
    """Whether all conditions hold."""
    result = jnp.asarray(True)
    for condition in conditions:
        result = result & condition
    return result


def _watch(sensor: WatchedSensor, value: Array, command: Array, moved: ArrayLike, period: float) -> WatchedSensor:
    """Sensor after a sample."""
    changed = value != sensor.value
    counts = (jnp.abs(command - sensor.command) > moved) | (sensor.unchanged > 0)
    unchanged = jnp.where(changed, 0.0, jnp.where(counts, sensor.unchanged + period, 0.0))
    return WatchedSensor(value, jnp.where(changed, command, sensor.command), unchanged)


def hold(limits: Containment, state: ContainedState, period: float) -> ContainedState:
    """State after a period without a usable sample: the last commands, or those of the vent."""
    was_vented = state.status == int(FirmwareState.VENTED)
    held = state.held + period
    vented = was_vented | (held > limits.tolerated - period / 2)
    status = jnp.where(vented, int(FirmwareState.VENTED), int(FirmwareState.HOLDING))
    commands = tuple(jnp.where(vented, vent, last) for vent, last in zip(limits.vent, state.commands, strict=True))
    fault = jnp.where((state.fault == 0) & ~was_vented, int(FaultCode.LATE), state.fault)
    good = jnp.where(was_vented & (state.held == 0), state.good, jnp.minimum(state.good, 0.0))
    return state._replace(commands=commands, held=held, good=good, status=status, fault=fault)


def send(
    limits: Containment, state: ContainedState, controller: PyTree, commands: tuple[Array, ...], period: float
) -> ContainedState:
    """State after a step of the controller, with its commands within their limits and along a ramp.

    Commands that are not finite count as a period without a usable sample.
    """
    share = jnp.minimum(state.share + period / jnp.maximum(limits.ramp, period), 1.0)
    ramping = share < 1.0
    within = limits.clip(commands)
    sent = tuple(
        jnp.where(ramping, start + share * (command - start), command)
        for start, command in zip(state.start, within, strict=True)
    )
    status = jnp.where(ramping, int(FirmwareState.RAMPING), int(FirmwareState.RUNNING))
    leak = jnp.where(state.status == int(FirmwareState.HOLDING), 0.0, period)
    done = state._replace(commands=sent, share=share, held=jnp.maximum(state.held - leak, 0.0), status=status)
    broken = hold(limits, state._replace(fault=jnp.full((), int(FaultCode.NOT_FINITE))), period)
    finite = _all(map(jnp.isfinite, sent))
    choice = jax.tree.map(
        lambda x, y: jnp.where(finite, x, y), done._replace(controller=()), broken._replace(controller=())
    )
    return choice._replace(controller=controller)
