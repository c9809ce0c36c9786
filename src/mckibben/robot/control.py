"""Controllers of a robot: pressures over time, and a controller for each joint with setpoints by phase."""

from __future__ import annotations

import abc
import dataclasses
from collections.abc import Sequence
from numbers import Real
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from mckibben.component.checks import check_count
from mckibben.control import Controller, DecouplingControl, Reference
from mckibben.control.base import DiscreteTimeSystem, Setpoint
from mckibben.errors import RangeError
from mckibben.joint import GeneralLoad, Measurement
from mckibben.robot.dynamics import joint_equations
from mckibben.robot.mechanism import Robot
from mckibben.robot.plant import RobotMeasurement
from mckibben.units import Gravity, Instant, Pressure

Scalar = Float[Array, ""]


class RobotController(DiscreteTimeSystem):
    """Interface from time and measurements to pressure commands of all muscles.

    A controller of a robot has its own references: instead of a setpoint, `step` receives the time [s].
    """

    @abc.abstractmethod
    def step(
        self, state: Any, time: ArrayLike, measurement: RobotMeasurement, period: ArrayLike
    ) -> tuple[Any, tuple[Array, ...]]:
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
            if len(levels) != len(own) + 1:
                raise RangeError(
                    f"muscle {number}: {len(levels)} levels for {len(own)} switching times",
                    field="levels",
                    value=len(levels),
                    remedy=f"give {len(own) + 1}",
                )
            if all(isinstance(one, Real) for one in own) and any(np.diff(own) < 0):
                raise RangeError(
                    f"muscle {number}: switching times {', '.join(f'{one:g}' for one in own)} s",
                    field="switches",
                    value=own,
                    remedy="give them in increasing order",
                )

    def init(self, measurement: RobotMeasurement) -> tuple[()]:
        return ()

    def step(
        self, state: Any, time: ArrayLike, measurement: RobotMeasurement, period: ArrayLike
    ) -> tuple[Any, tuple[Array, ...]]:
        commands = []
        for levels, times in zip(self.levels, self.switches or ((),) * len(self.levels), strict=True):
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
        self, state: Any, time: ArrayLike, measurement: RobotMeasurement, period: ArrayLike
    ) -> tuple[Any, tuple[Setpoint, ...]]:
        """Return the next state, and the setpoint of each joint at a time [s]."""


class TimedReference(RobotReference):
    """References of the joints over time."""

    references: tuple[Reference, ...]

    def init(self, measurement: RobotMeasurement) -> tuple[()]:
        return ()

    def step(
        self, state: Any, time: ArrayLike, measurement: RobotMeasurement, period: ArrayLike
    ) -> tuple[Any, tuple[Setpoint, ...]]:
        return (), tuple(reference(time) for reference in self.references)


class JointwiseControl(RobotController):
    """A controller of position and stiffness for each joint with a pair, and constant pressures of other muscles.

    Parameters
    ----------
    controllers
        One controller of a joint for each joint of the robot; each has its own model.
    reference
        Setpoints of the joints.
    others
        Gauge pressures [Pa] of the muscles that are in no pair.
    """

    controllers: tuple[Controller, ...]
    reference: RobotReference
    others: tuple[Pressure, ...] = ()

    def init(self, measurement: RobotMeasurement) -> Any:
        check_count("controllers", len(self.controllers), len(measurement.angles), "joint, in their order")
        if any(controller.samples_ahead for controller in self.controllers):
            raise RangeError("a robot gives no setpoints ahead", field="controllers", remedy="leave preview out")
        states = [one.init(_of_joint(measurement, index)) for index, one in enumerate(self.controllers)]
        return self.reference.init(measurement), tuple(states)

    def step(
        self, state: Any, time: ArrayLike, measurement: RobotMeasurement, period: ArrayLike
    ) -> tuple[Any, tuple[Array, ...]]:
        reference, setpoints = self.reference.step(state[0], time, measurement, period)
        states, commands = [], []
        for index, (one, held, setpoint) in enumerate(zip(self.controllers, state[1], setpoints, strict=True)):
            held, pair = one.step(held, setpoint, _of_joint(measurement, index), period)
            states.append(held)
            commands += pair
        return (reference, tuple(states)), (*commands, *map(jnp.asarray, self.others))

    def telemetry(self, state: Any) -> dict[str, Array]:
        found = dict(self.reference.telemetry(state[0]))
        for index, (one, held) in enumerate(zip(self.controllers, state[1], strict=True)):
            found |= {f"{name}_{index}": value for name, value in one.telemetry(held).items()}
        return found


def check_pairs(robot: Robot, controller: RobotController) -> None:
    """Raise `RangeError` if a controller commands pairs of muscles, and joints of a robot have none."""
    if isinstance(controller, JointwiseControl):
        check_count("controllers", len(controller.controllers), len(robot.pairs), "joint with a pair of muscles")
        if list(robot.pairs.items()) != [(index, 2 * index) for index in range(len(robot.joints))]:
            remedy = "give all joints a pair, in their order and before the other muscles"
            raise RangeError("a controller of pairs, of a robot with others", field="controllers", remedy=remedy)


def _of_joint(measurement: RobotMeasurement, index: int) -> Measurement:
    return Measurement(measurement.angles[index], measurement.pressures[2 * index : 2 * index + 2])  # type: ignore


class CoupledControl(JointwiseControl):
    r"""Jointwise control that compensates the torques between the joints by a model of the robot.

    In each period the load in the model of each joint's controller is that of the robot at the measured angles and the
    estimated velocities, with its base at rest and its foot in the air:

    .. math:: \tau_i = M_{ii}\,\ddot q_i + c_i\,\dot q_i
              + \Big[ \sum_{k \ne i} M_{ik}\,\ddot q_{r,k} + h_i(q, \dot q) - \tau_{b,i} \Big]

    with the mass matrix M and the torques h of velocities and gravity, the accelerations of the other joints'
    references after the lag of their feedback, and the torques of the other muscles at their measured pressures.
    The observers of the joints see what is left. Stiffness setpoints are those of a joint's own pair.

    For controllers with a `command_delay` the load is that of the motion to be expected when their commands arrive.

    Parameters
    ----------
    controllers, reference, others
        As for `JointwiseControl`; the loads of the controllers are replaced.
    robot
        Model of the robot: masses, lengths, axes and damping; no joint is locked.
    gravity
        g [m/s^2].

    References
    ----------
    J. Y. S. Luh, M. W. Walker and R. P. C. Paul, Resolved-acceleration control of mechanical manipulators, IEEE Trans.
    Automatic Control 25, 1980 (computed torque).
    """

    robot: Robot = eqx.field(kw_only=True)
    gravity: Gravity = eqx.field(kw_only=True, default=9.81)

    def __check_init__(self) -> None:
        super().__check_init__()
        check_count("controllers", len(self.controllers), len(self.robot.joints), "joint, in their order")
        for joint, one in zip(self.robot.joints, self.controllers, strict=True):
            if not isinstance(one, DecouplingControl):
                raise RangeError(
                    f"{joint.name}: a {type(one).__name__} has no torque to add others to",
                    field="controllers",
                    value=type(one).__name__,
                    remedy="give a DecouplingControl, or use JointwiseControl",
                )
            if joint.locked is not None:
                remedy = "use JointwiseControl"
                raise RangeError(f"{joint.name} is locked", field="robot", value=joint.name, remedy=remedy)

    def init(self, measurement: RobotMeasurement) -> Any:
        zero = tuple(map(jnp.zeros_like, measurement.angles))
        return JointwiseControl.init(self._with_loads(self._loads(measurement, zero, zero)), measurement)

    def step(
        self, state: Any, time: ArrayLike, measurement: RobotMeasurement, period: ArrayLike
    ) -> tuple[Any, tuple[Array, ...]]:
        controllers: Any = self.controllers
        estimates = [one.estimates for one in state[1]]
        delays = [0.0 if one.command_delay is None else one.command_delay for one in controllers]
        planned = [
            one.reference.acceleration_after(control.feedback.lag + delay + period, period)
            for one, control, delay in zip(estimates, controllers, delays, strict=True)
        ]
        velocities = [one.motion.velocity for one in estimates]
        angles = tuple(
            angle + delay * velocity
            for angle, velocity, delay in zip(measurement.angles, velocities, delays, strict=True)
        )
        loads = self._loads(measurement._replace(angles=angles), velocities, planned)
        return JointwiseControl.step(self._with_loads(loads), state, time, measurement, period)

    def _loads(self, at: RobotMeasurement, rates: Sequence[Array], planned: Sequence[Array]) -> list[GeneralLoad]:
        """Loads of the joints in a motion, for accelerations [rad/s^2] of the others' references."""
        angles = at.angles
        made = joint_equations(self.robot, angles, rates, self.gravity)
        others = list(made.bias)
        units = self.robot.routed_muscles(angles)
        for unit, pressure in list(zip(units, at.pressures, strict=True))[2 * len(angles) :]:
            tension = unit.tension(pressure)
            for joint, slope in unit.slopes.items():
                others[joint] = others[joint] + tension * slope
        loads = []
        for i, joint in enumerate(self.robot.joints):
            torque = others[i] + sum(made.matrix[i][k] * planned[k] for k in range(len(angles)) if k != i)
            load = GeneralLoad(made.matrix[i][i], -torque, joint.damping, angles[i] + jnp.pi / 2)  # type: ignore
            loads.append(load)  # its gravity acts at a right angle: the torque
        return loads

    def _with_loads(self, loads: Sequence[GeneralLoad]) -> JointwiseControl:
        """The controller with other loads of its joints."""
        controllers = tuple(
            dataclasses.replace(one, load=load)  # type: ignore[call-arg]
            for one, load in zip(self.controllers, loads, strict=True)
        )
        return dataclasses.replace(self, controllers=controllers)
