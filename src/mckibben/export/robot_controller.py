"""Controller of a robot as C99, with a recorded run for checking it."""

from __future__ import annotations

import dataclasses
import os

import jax
import jax.numpy as jnp
from jaxtyping import ArrayLike, PyTree

import mckibben
from mckibben.containment import ControlSample
from mckibben.containment.functions import functions_of
from mckibben.containment.limits import FINITE, Limits
from mckibben.control import Setpoint
from mckibben.errors import ExportError
from mckibben.export.controller import ControllerModule, recorded, stepping_module
from mckibben.export.controller_files import program_files
from mckibben.export.targets import Exported, check_name
from mckibben.numerics.compiled import numeric
from mckibben.robot import RobotMeasurement, RobotPlant, RobotReference, RobotStart, TrackingControl
from mckibben.simulation.problem import sampling_times


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


def export_robot_controller(
    plant: RobotPlant,
    controller: TrackingControl,
    start: RobotStart,
    out: str | os.PathLike[str],
    *,
    duration: float,
    control_period: float,
    name: str = "controller",
    single: bool = False,
    overwrite: bool = False,
) -> Exported:
    """Write a controller of all joints of a robot as C99 into a folder; its inputs are setpoints and measurements.

    `make check` there replays a run of the plant with the controller's own reference, and times the steps.

    Raises `ExportError` for a controller of another class, and for parts that C cannot express, before any file is
    written; `FileError` if the files exist, unless they may be overwritten; `SimulationError` if the duration is not a
    positive multiple of the control period.

    Parameters
    ----------
    plant, start, duration
        Plant, start and duration [s] of the recorded run.
    controller
        A `JointwiseControl` or a `ComputedTorque`, whose real numbers are parameters of the program.
    control_period
        Period [s] of the program, a constant.
    name
        Name of the program, an identifier.
    single
        Whether numbers have 32 bits.
    """
    if not isinstance(controller, TrackingControl):
        message = f"a {type(controller).__name__} takes no setpoints of the joints"
        remedy = "give a JointwiseControl or a ComputedTorque"
        raise ExportError(message, field="controller", value=type(controller).__name__, remedy=remedy)
    check_name(name)
    made = _module(plant.with_period(control_period), controller, start, name, duration, control_period)
    text = f"Controller of a robot, written by mckibben {mckibben.__version__}."
    exported = Exported(program_files(made, name, "a robot", text, control_period, single=single))
    exported.save(out, force=overwrite)
    return exported


def _module(
    plant: RobotPlant, controller: TrackingControl, start: RobotStart, name: str, duration: float, period: float
) -> ControllerModule:
    """Program and recorded run of a controller."""
    plant, controller, initial = numeric((plant, controller.with_period(period), plant.begin(start)))
    zeros = (jnp.zeros(()),) * len(plant.robot.joints)
    example, setpoint = _with_setpoints(controller, ()), {"angles": zeros, "stiffness": zeros}

    def applied(controller: TrackingControl, setpoint: PyTree) -> tuple[TrackingControl, ArrayLike]:
        setpoints = tuple(map(Setpoint, setpoint["angles"], setpoint["stiffness"]))
        return _with_setpoints(controller, setpoints), jnp.zeros(())

    sample = ControlSample(setpoint, plant.sample(initial, 0.0)[1])
    lowest, highest = (jax.tree.map(lambda _, bound=bound: bound, sample) for bound in (-FINITE, FINITE))
    limits = Limits().containment(plant, lowest, highest)
    source = functions_of(plant, example, initial, period, setpoint, limits, applied)
    times, substeps = sampling_times(duration, period), plant.needed_substeps(start.angles, None, period)
    return recorded(source, stepping_module(name, source), controller, times, substeps, _wanted)


def _with_setpoints(controller: TrackingControl, setpoints: tuple[Setpoint, ...]) -> TrackingControl:
    """A controller with given setpoints in place of its reference."""
    return dataclasses.replace(controller, reference=_GivenSetpoints(setpoints))


def _wanted(
    controller: TrackingControl, state: PyTree, time: ArrayLike, measurement: RobotMeasurement, period: ArrayLike
) -> tuple[ArrayLike, ...]:
    """Angles and stiffness of all joints at a time [s]."""
    angles, stiffness = zip(*controller.reference.step(state[0], time, measurement, period)[1], strict=True)
    return *angles, *stiffness
