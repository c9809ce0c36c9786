"""Controller of a leg as C99, with a recorded run for checking it."""

from __future__ import annotations

import dataclasses
import os

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import ArrayLike, PyTree

import mckibben
from mckibben.control import Setpoint
from mckibben.errors import ExportError
from mckibben.export.controller import ControllerModule, recorded, stepping_module, units_of
from mckibben.export.controller_files import program_files
from mckibben.export.plant import is_real
from mckibben.export.targets import Exported, check_name
from mckibben.leg import JointwiseControl, LegMeasurement, LegPlant, LegReference, LegStart
from mckibben.numerics.compiled import numeric
from mckibben.simulation.problem import sampling_times


class _GivenSetpoints(LegReference):
    """Setpoints that the program receives in each period."""

    setpoints: tuple[Setpoint, ...]

    def init(self, measurement: LegMeasurement) -> tuple[()]:
        return ()

    def step(
        self, state: PyTree, time: ArrayLike, measurement: LegMeasurement, period: ArrayLike
    ) -> tuple[PyTree, tuple[Setpoint, ...]]:
        return (), self.setpoints


def export_leg_controller(
    plant: LegPlant,
    controller: JointwiseControl,
    start: LegStart,
    out: str | os.PathLike[str],
    *,
    duration: float,
    control_period: float,
    name: str = "controller",
    single: bool = False,
    overwrite: bool = False,
) -> Exported:
    """Write a controller of all joints of a leg as C99 into a folder; its inputs are setpoints and measurements.

    `make check` there replays a run of the plant with the controller's own reference, and times the steps.

    Raises `ExportError` for a controller of another class, and for parts that C cannot express, before any file is
    written; `FileError` if the files exist, unless they may be overwritten; `SimulationError` if the duration is not a
    positive multiple of the control period.

    `plant`, `start` and `duration` [s] are those of the recorded run. The real numbers of the controller, such as a
    `CoupledControl`, are parameters of the program, 32-bit if `single`. Its name is an identifier.
    """
    if not isinstance(controller, JointwiseControl):
        message = f"a {type(controller).__name__} takes no setpoints of the joints"
        remedy = "give a JointwiseControl or a CoupledControl"
        raise ExportError(message, field="controller", value=type(controller).__name__, remedy=remedy)
    check_name(name)
    made = _module(plant.with_period(control_period), controller, start, name, duration, control_period)
    text = f"Controller of a leg, written by mckibben {mckibben.__version__}."
    exported = Exported(program_files(made, name, "a leg", text, control_period, single=single))
    exported.save(out, force=overwrite)
    return exported


def _module(
    plant: LegPlant, controller: JointwiseControl, start: LegStart, name: str, duration: float, period: float
) -> ControllerModule:
    """Program and recorded run of a controller."""
    plant, controller, initial = numeric((plant, controller.with_period(period), plant.begin(start)))
    joints = len(controller.controllers)
    zero = jnp.zeros(())
    example = dataclasses.replace(controller, reference=_GivenSetpoints((Setpoint(zero, zero),) * joints))
    numbers, fixed = eqx.partition(example, is_real)
    parameters = {"controller": numbers, "control_period": np.asarray(period)}

    def of(parameters: PyTree, setpoints: tuple[Setpoint, ...]) -> JointwiseControl:
        controller = eqx.combine(parameters["controller"], fixed)
        return dataclasses.replace(controller, reference=_GivenSetpoints(setpoints))

    def init(parameters: PyTree, measurement: LegMeasurement) -> dict[str, PyTree]:
        return {"state": of(parameters, ()).init(measurement)}

    def step(parameters: PyTree, state: PyTree, setpoint: PyTree, measurement: LegMeasurement) -> dict[str, PyTree]:
        setpoints = tuple(map(Setpoint, setpoint["angles"], setpoint["stiffness"]))
        controller = of(parameters, setpoints)
        state, commands = controller.step(state, jnp.zeros(()), measurement, parameters["control_period"])
        pressures = {f"pressure{number}": command for number, command in enumerate(commands, 1)}
        return {"state": state, "commands": pressures, "telemetry": controller.telemetry(state)}

    measurement = plant.sample(initial, 0.0)[1]
    state = jax.tree.map(lambda leaf: np.zeros(leaf.shape, leaf.dtype), jax.eval_shape(example.init, measurement))
    setpoint = {"angles": (zero,) * joints, "stiffness": (zero,) * joints}
    module = stepping_module(name, parameters, init, step, state, setpoint, measurement)
    muscles, of_joints = range(1, len(plant.muscles) + 1), range(joints)
    measured = [f"angles_{i}" for i in of_joints] + [f"pressures_{i - 1}" for i in muscles] + ["ground_force"]
    columns = (
        *(f"setpoint.angles_{i}" for i in of_joints),
        *(f"setpoint.stiffness_{i}" for i in of_joints),
        *(f"measurement.{name}" for name in measured),
        *(f"commands.pressure{i}" for i in muscles),
    )
    times = sampling_times(duration, period)
    substeps = plant.needed_substeps(start.angles, None, period)
    recording = recorded(plant, controller, times, initial, period, substeps, _wanted)
    return ControllerModule(module, units_of(module, "Pa, gauge"), columns, recording, ())


def _wanted(
    controller: JointwiseControl, state: PyTree, time: ArrayLike, measurement: LegMeasurement, period: ArrayLike
) -> tuple[ArrayLike, ...]:
    """Angles and stiffness of all joints at a time [s]."""
    angles, stiffness = zip(*controller.reference.step(state[0], time, measurement, period)[1], strict=True)
    return *angles, *stiffness
