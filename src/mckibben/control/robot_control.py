"""Controllers of a robot: pressures over time, and a controller for each joint with setpoints by phase."""

from __future__ import annotations

import abc
import functools
import operator
from collections.abc import Sequence
from numbers import Real
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float, PyTree

from mckibben.component.checks import check_count
from mckibben.control import Controller, Reference
from mckibben.control.base import DiscreteTimeSystem, Setpoint
from mckibben.errors import RangeError
from mckibben.joint import Measurement
from mckibben.mechanism.base import RobotMeasurement
from mckibben.mechanism.robot import Robot
from mckibben.units import Instant, Pressure

Scalar = Float[Array, ""]


class RobotController(DiscreteTimeSystem):
    """Interface from time and measurements to pressure commands of all muscles.

    A controller of a robot has its own references: instead of a setpoint, `step` receives the time [s].
    """

    @abc.abstractmethod
    def step(
        self, state: PyTree, time: ArrayLike, measurement: RobotMeasurement, period: ArrayLike
    ) -> tuple[PyTree, tuple[Array, ...]]:
        """Return the next state, and the commands [Pa] for the coming control period [s]."""


class PressureSchedule(RobotController):
    """Commands that are constant between switching times, which need not be multiples of the control period.

    The command of a control period is the mean of the schedule over it, so that results depend continuously on the
    switching times, and have derivatives with respect to them.

    Parameters
    ----------
    levels
        Gauge pressures [Pa] of each muscle, in the order of the robot: one more than its switching times.
    switches
        Increasing switching times [s] of each muscle; none for constant commands.

    Examples
    --------
    >>> schedule = PressureSchedule(levels=((1e5, 4e5), (2e5,)), switches=((1.25e-3,), ()))
    >>> nothing = RobotMeasurement((), (), jnp.zeros(()))
    >>> [float(one) for one in schedule.step((), 1e-3, nothing, 1e-3)[1]]
    [325000.0, 200000.0]
    """

    levels: tuple[tuple[Pressure, ...], ...]
    switches: tuple[tuple[Instant, ...], ...] = ()

    def __check_init__(self) -> None:
        super().__check_init__()
        times = self.switches or ((),) * len(self.levels)
        check_count("switches", len(times), len(self.levels), "muscle, () for no switching times")
        for number, (levels, own) in enumerate(zip(self.levels, times, strict=True), 1):
            check_count("levels", len(levels), len(own) + 1, f"time between switches of muscle {number}")
            if all(isinstance(one, Real) for one in own) and any(np.diff(own) < 0):
                message = f"muscle {number}: switching times {', '.join(f'{one:g}' for one in own)} s"
                raise RangeError(message, field="switches", value=own, remedy="give them in increasing order")

    @property
    def by_muscle(self) -> tuple[tuple[Any, ...], tuple[Any, ...]]:
        """Levels [Pa] and switching times [s] of each muscle."""
        return self.levels, self.switches or ((),) * len(self.levels)

    def init(self, measurement: RobotMeasurement) -> tuple[()]:
        return ()

    def step(
        self, state: PyTree, time: ArrayLike, measurement: RobotMeasurement, period: ArrayLike
    ) -> tuple[PyTree, tuple[Array, ...]]:
        commands = []
        for levels, times in zip(*self.by_muscle, strict=True):
            command = jnp.asarray(levels[0])
            for before, after, at in zip(levels, levels[1:], times, strict=False):
                part = jnp.clip((time + period - at) / period, 0.0, 1.0)
                command = command + (jnp.asarray(after) - before) * part
            commands.append(command)
        return (), tuple(commands)


class RobotReference(DiscreteTimeSystem):
    """Interface from time and measurements to the setpoints of all joints."""

    @abc.abstractmethod
    def step(
        self, state: PyTree, time: ArrayLike, measurement: RobotMeasurement, period: ArrayLike
    ) -> tuple[PyTree, tuple[Setpoint, ...]]:
        """Return the next state, and the setpoint of each joint at a time [s]."""


class TimedReference(RobotReference):
    """References of the joints over time."""

    references: tuple[Reference, ...]

    def init(self, measurement: RobotMeasurement) -> tuple[()]:
        return ()

    def step(
        self, state: PyTree, time: ArrayLike, measurement: RobotMeasurement, period: ArrayLike
    ) -> tuple[PyTree, tuple[Setpoint, ...]]:
        return (), tuple(reference(time) for reference in self.references)


class TrackingControl(RobotController):
    """Base of controllers whose joints follow a reference, that of a file or `reference`."""

    default_class = "computed_torque"

    reference: RobotReference | PyTree = eqx.field(kw_only=True, default=None)  # not in a section of a file

    def step(
        self, state: PyTree, time: PyTree, measurement: RobotMeasurement, period: ArrayLike
    ) -> tuple[PyTree, tuple[Array, ...]]:
        if isinstance(time, tuple):  # setpoints that were sampled before the run, see `setpoints_over`
            return self.step_toward(state, time, measurement, period)
        held, setpoints = self.reference.step(state.reference, time, measurement, period)
        return self.step_toward(state._replace(reference=held), setpoints, measurement, period)

    def setpoints_at(self, time: PyTree) -> tuple[Setpoint, ...]:
        """Return the setpoints of the joints at a time [s], of a `TimedReference`, or those sampled."""
        timed: PyTree = self.reference
        return time if isinstance(time, tuple) else tuple(reference(time) for reference in timed.references)

    def desired_angle(self, setpoint: PyTree) -> PyTree:
        return tuple(each.angle for each in self.setpoints_at(setpoint))

    @abc.abstractmethod
    def step_toward(
        self, state: PyTree, setpoints: Sequence[Setpoint], measurement: RobotMeasurement, period: ArrayLike
    ) -> tuple[PyTree, tuple[Array, ...]]:
        """Return the next state, and the commands [Pa], for a setpoint of each joint."""


class JointwiseState(NamedTuple):
    """States of the reference and of the controllers."""

    reference: PyTree
    controllers: tuple[PyTree, ...]


class JointwiseControl(TrackingControl):
    """A controller of position and stiffness for each joint of a robot that has pairs of muscles alone.

    Parameters
    ----------
    controllers
        One controller of a joint for each joint of the robot; each has its own model.
    reference
        Setpoints of the joints.
    """

    controllers: tuple[Controller, ...]

    def init(self, measurement: RobotMeasurement) -> JointwiseState:
        check_count("controllers", len(self.controllers), len(measurement.angles), "joint, in their order")
        if any(controller.samples_ahead for controller in self.controllers):
            raise RangeError("a robot gives no setpoints ahead", field="controllers", remedy="leave preview out")
        states = [one.init(_of_joint(measurement, index)) for index, one in enumerate(self.controllers)]
        return JointwiseState(self.reference.init(measurement), tuple(states))

    def step_toward(
        self, state: JointwiseState, setpoints: Sequence[Setpoint], measurement: RobotMeasurement, period: ArrayLike
    ) -> tuple[JointwiseState, tuple[Array, ...]]:
        parts = enumerate(zip(self.controllers, state.controllers, setpoints, strict=True))
        steps = [one.step(held, to, _of_joint(measurement, index), period) for index, (one, held, to) in parts]
        commands = tuple(command for _, pair in steps for command in pair)
        return state._replace(controllers=tuple(held for held, _ in steps)), commands

    def telemetry(self, state: JointwiseState) -> dict[str, PyTree]:
        signals = [one.telemetry(held) for one, held in zip(self.controllers, state.controllers, strict=True)]
        everywhere = [name for name in signals[0] if all(name in own for own in signals)]
        joint = {name: tuple(own[name] for own in signals) for name in everywhere if name != "saturated"}
        limited = [own["saturated"] for own in signals if "saturated" in own]
        joint |= {"saturated": functools.reduce(operator.or_, limited)} if limited else {}
        return dict(self.reference.telemetry(state.reference)) | joint


def check_pairs(robot: Robot, controller: RobotController) -> None:
    """Raise `RangeError` if a controller commands pairs of muscles, and joints of a robot have none."""
    if isinstance(controller, JointwiseControl):
        check_count("controllers", len(controller.controllers), len(robot.pairs), "joint with a pair of muscles")
        in_order = list(robot.pairs.items()) == [(index, 2 * index) for index in range(len(robot.joints))]
        if not in_order or len(robot.all_muscles) > 2 * len(robot.joints):
            remedy = "give one `controller` of all muscles, or each joint a pair, in their order, and no other muscles"
            raise RangeError("controllers of pairs, of a robot with other muscles", field="controllers", remedy=remedy)


def _of_joint(measurement: RobotMeasurement, index: int) -> Measurement:
    return Measurement(measurement.angles[index], measurement.pressures[2 * index : 2 * index + 2])  # type: ignore
