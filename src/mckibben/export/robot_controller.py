"""Controller of a robot as C99, with a recorded run for checking it."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import jax.numpy as jnp
from jaxtyping import ArrayLike, PyTree

from mckibben.containment import ControlSample
from mckibben.containment.functions import functions_of
from mckibben.containment.limits import FINITE, Limits
from mckibben.control import Setpoint
from mckibben.errors import ExportError
from mckibben.export.controller import ControllerModule, recorded, stepping_module
from mckibben.export.controller_files import described_files
from mckibben.export.targets import Exported
from mckibben.numerics.compiled import numeric
from mckibben.robot import Robot, RobotMeasurement, RobotReference, RobotScenario, TrackingControl
from mckibben.simulation.problem import sampling_times
from mckibben.units import deg


class _GivenSetpoints(RobotReference):
    """Setpoints that the program receives in each period."""

    setpoints: tuple[Setpoint, ...]

    def init(self, measurement: RobotMeasurement) -> tuple[()]:
        """No state."""
        return ()

    def step(
        self, state: PyTree, time: ArrayLike, measurement: RobotMeasurement, period: ArrayLike
    ) -> tuple[PyTree, tuple[Setpoint, ...]]:
        """The setpoints, whatever the time."""
        return (), self.setpoints


def c_files(
    scenario: RobotScenario, name: str, folder: Path, *, single: bool = False, limits: Limits | None = None
) -> Exported:
    """The controller of all joints of a robot as C99; its inputs are setpoints and measurements.

    `make check` replays a run of the plant with the references of the scenario, and times the steps. Parameters are
    those of `mckibben.export.controller_files.c_files`.

    Raises `ExportError` for a scenario without a controller, and for parts that C cannot express.
    """
    if scenario.duration is None:
        remedy = "give it `controller` or `controllers`, `reference` and `duration`"
        raise ExportError("the robot has no controller", field="controller", remedy=remedy)
    made = _module(scenario, name, scenario.duration, limits or Limits())
    return described_files(made, scenario, "robot", name, folder, single=single)


def _module(scenario: RobotScenario, name: str, duration: float, limits: Limits) -> ControllerModule:
    """Program and recorded run of a controller."""
    period, start = scenario.control_period, scenario.initial()
    plant = scenario.plant()
    plant, controller, initial = numeric((plant, scenario.control().with_period(period), plant.begin(start)))
    zeros = (jnp.zeros(()),) * len(plant.robot.joints)
    example, setpoint = _with_setpoints(controller, ()), {"angles": zeros, "stiffness": zeros}

    def applied(controller: TrackingControl, setpoint: PyTree) -> tuple[TrackingControl, ArrayLike]:
        setpoints = tuple(map(Setpoint, setpoint["angles"], setpoint["stiffness"]))
        return _with_setpoints(controller, setpoints), jnp.zeros(())

    bounds = limits.containment(plant, *(_bounds(scenario.robot, limits, side) for side in (-1, 1)))
    source = functions_of(plant, example, initial, period, setpoint, bounds, applied)
    substeps = scenario.substeps or plant.needed_substeps(start.angles, None, period)
    times = sampling_times(duration, period)
    return recorded(source, stepping_module(name, source), controller, times, substeps, _wanted)


def _bounds(robot: Robot, limits: Limits, side: int) -> ControlSample:
    """Lowest or highest sample: by default angles 10 deg beyond the joints, pressures 5 % beyond the rated ones."""
    angle, pressure = (
        (limits.lowest_angle, limits.lowest_pressure) if side < 0 else (limits.highest_angle, limits.highest_pressure)
    )
    ends = [joint.lower if side < 0 else joint.upper for joint in robot.joints]
    angles = tuple(jnp.asarray(end + side * 10 * deg if angle is None else angle) for end in ends)
    rated = [muscle.specimen.domain for muscle in robot.all_muscles]
    pressures = [
        (domain.pressure_min if side < 0 else domain.pressure_max) + side * 0.05 * domain.pressure_max
        for domain in rated
    ]
    stiffest = FINITE if limits.highest_stiffness is None else limits.highest_stiffness
    stiffness = (jnp.asarray(0.0 if side < 0 else stiffest),) * len(angles)
    measured = tuple(jnp.asarray(own if pressure is None else pressure) for own in pressures)
    measurement = RobotMeasurement(angles, measured, jnp.asarray(side * FINITE))
    return ControlSample({"angles": angles, "stiffness": stiffness}, measurement)


def _with_setpoints(controller: TrackingControl, setpoints: tuple[Setpoint, ...]) -> TrackingControl:
    """A controller with given setpoints in place of its reference."""
    return dataclasses.replace(controller, reference=_GivenSetpoints(setpoints))


def _wanted(
    controller: TrackingControl, state: PyTree, time: ArrayLike, measurement: RobotMeasurement, period: ArrayLike
) -> tuple[ArrayLike, ...]:
    """Angles and stiffness of all joints at a time [s]."""
    angles, stiffness = zip(*controller.reference.step(state[0], time, measurement, period)[1], strict=True)
    return *angles, *stiffness
