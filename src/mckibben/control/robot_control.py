"""Controllers of a robot: pressures over time, and a controller for each joint."""

from __future__ import annotations

import abc
import functools
import operator
from collections.abc import Sequence
from numbers import Real
from typing import Any, ClassVar

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float, PyTree

from mckibben.component.checks import check_count
from mckibben.control.base import Controller, DiscreteTimeSystem, Setpoint
from mckibben.errors import RangeError
from mckibben.joint import Measurement
from mckibben.mechanism.base import RobotMeasurement
from mckibben.mechanism.robot import Robot
from mckibben.units import Instant, Pressure

Scalar = Float[Array, ""]


class RobotController(DiscreteTimeSystem):
    """Interface from a setpoint of each joint and measurements to pressure commands of all muscles."""

    default_class = "computed_torque"

    def desired_angle(self, setpoint: Sequence[Setpoint]) -> tuple[Scalar, ...]:
        return tuple(each.angle for each in setpoint)

    @abc.abstractmethod
    def step(
        self, state: PyTree, setpoint: Sequence[Setpoint], measurement: RobotMeasurement, period: ArrayLike
    ) -> tuple[PyTree, tuple[Array, ...]]:
        """Return the next state, and the commands [Pa] for the coming control period [s]."""


class PressureSchedule(DiscreteTimeSystem):
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

    follows_reference: ClassVar = False

    levels: tuple[tuple[Pressure, ...], ...]
    switches: tuple[tuple[Instant, ...], ...] = ()

    def __check_init__(self) -> None:
        super().__check_init__()
        times = self.switches or ((),) * len(self.levels)
        check_count("switches", len(times), len(self.levels), "muscle, () for no switching times")
        for number, (levels, instants) in enumerate(zip(self.levels, times, strict=True), 1):
            check_count("levels", len(levels), len(instants) + 1, f"time between switches of muscle {number}")
            if all(isinstance(one, Real) for one in instants) and any(np.diff(instants) < 0):
                message = f"muscle {number}: switching times {', '.join(f'{one:g}' for one in instants)} s"
                raise RangeError(message, field="switches", value=instants, remedy="give them in increasing order")

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


class JointwiseControl(RobotController):
    """A controller of position and stiffness for each joint of a robot that has pairs of muscles alone.

    Parameters
    ----------
    controllers
        One controller of a joint for each joint of the robot; each has its own model.
    """

    controllers: tuple[Controller, ...]

    @property
    def samples_ahead(self) -> int:  # type: ignore[override]
        """The most control periods by which a controller needs setpoints early."""
        return max((controller.samples_ahead for controller in self.controllers), default=0)

    def init(self, measurement: RobotMeasurement) -> tuple[PyTree, ...]:
        check_count("controllers", len(self.controllers), len(measurement.angles), "joint, in their order")
        return tuple(one.init(_of_joint(measurement, index)) for index, one in enumerate(self.controllers))

    def ahead(self, setpoints: Sequence[Setpoint], period: ArrayLike) -> tuple[Setpoint, ...]:
        return tuple(one.ahead(setpoint, period) for one, setpoint in zip(self.controllers, setpoints, strict=True))

    def foreseeing(
        self, state: tuple[PyTree, ...], setpoints: Sequence[Setpoint], period: ArrayLike
    ) -> tuple[PyTree, ...]:
        parts = zip(self.controllers, state, setpoints, strict=True)
        return tuple(one.foreseeing(held, setpoint, period) for one, held, setpoint in parts)

    def step(
        self,
        state: tuple[PyTree, ...],
        setpoint: Sequence[Setpoint],
        measurement: RobotMeasurement,
        period: ArrayLike,
    ) -> tuple[tuple[PyTree, ...], tuple[Array, ...]]:
        parts = enumerate(zip(self.controllers, state, setpoint, strict=True))
        steps = [one.step(held, to, _of_joint(measurement, index), period) for index, (one, held, to) in parts]
        return tuple(held for held, _ in steps), tuple(command for _, pair in steps for command in pair)

    def telemetry(self, state: tuple[PyTree, ...]) -> dict[str, PyTree]:
        signals = [one.telemetry(held) for one, held in zip(self.controllers, state, strict=True)]
        everywhere = [name for name in signals[0] if all(name in by_name for by_name in signals)]
        joint = {name: tuple(by_name[name] for by_name in signals) for name in everywhere if name != "saturated"}
        limited = [by_name["saturated"] for by_name in signals if "saturated" in by_name]
        return joint | ({"saturated": functools.reduce(operator.or_, limited)} if limited else {})


def check_pairs(robot: Robot, controller: DiscreteTimeSystem) -> None:
    """Raise `RangeError` if a controller commands pairs of muscles, and joints of a robot have none."""
    if isinstance(controller, JointwiseControl):
        check_count("controllers", len(controller.controllers), len(robot.pairs), "joint with a pair of muscles")
        in_order = list(robot.pairs.items()) == [(index, 2 * index) for index in range(len(robot.joints))]
        if not in_order or len(robot.all_muscles) > 2 * len(robot.joints):
            remedy = "give one `controller` of all muscles, or each joint a pair, in their order, and no other muscles"
            raise RangeError("controllers of pairs, of a robot with other muscles", field="controllers", remedy=remedy)


def _of_joint(measurement: RobotMeasurement, index: int) -> Measurement:
    return Measurement(measurement.angles[index], measurement.pressures[2 * index : 2 * index + 2])  # type: ignore
