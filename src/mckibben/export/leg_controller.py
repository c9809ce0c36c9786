"""Controller of a leg as C99, with a recorded run for checking it."""

from __future__ import annotations

import dataclasses
import os
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

import mckibben
from mckibben.codegen.source_module import SourceModule
from mckibben.control import Setpoint
from mckibben.errors import ExportError
from mckibben.export.controller import ControllerModule, is_real, units_of
from mckibben.export.controller_files import program_files
from mckibben.export.targets import Exported, check_name, write_exported
from mckibben.leg import JointwiseControl, LegMeasurement, LegPlant, LegReference, LegStart
from mckibben.leg.plant import LegState
from mckibben.numerics.batching import batched_program
from mckibben.numerics.compiled import compiled_as_given, numeric
from mckibben.simulation.problem import sampling_times


class _GivenSetpoints(LegReference):
    """Setpoints that the program receives in each period."""

    setpoints: tuple[Setpoint, ...]

    def init(self, measurement: LegMeasurement) -> tuple[()]:
        return ()

    def step(self, state: Any, time: Any, measurement: LegMeasurement, period: Any) -> tuple[Any, tuple[Setpoint, ...]]:
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

    Parameters
    ----------
    plant, start
        Plant and start of the recorded run.
    controller
        A `JointwiseControl`, such as `CoupledControl`. Its real numbers are parameters of the program.
    duration, control_period
        Duration of the recorded run, and control period [s].
    name
        Name of the program, an identifier.
    single
        32-bit instead of 64-bit numbers.

    Raises
    ------
    ExportError
        For a controller of another class, and for parts that C cannot express, before any file is written.
    FileError
        If the files exist, unless they may be overwritten.
    SimulationError
        If the duration is not a positive multiple of the control period.
    """
    if not isinstance(controller, JointwiseControl):
        message = f"a {type(controller).__name__} takes no setpoints of the joints"
        remedy = "give a JointwiseControl or a CoupledControl"
        raise ExportError(message, field="controller", value=type(controller).__name__, remedy=remedy)
    check_name(name)
    made = _module(plant.with_period(control_period), controller, start, name, duration, control_period)
    text = f"Controller of a leg, written by mckibben {mckibben.__version__}."
    files = program_files(made, name, "a leg", text, control_period, single=single)
    exported = Exported(files)
    write_exported(exported, out, overwrite=overwrite)
    return exported


def _module(
    plant: LegPlant, controller: JointwiseControl, start: LegStart, name: str, duration: float, period: float
) -> ControllerModule:
    """Program and recorded run of a controller."""
    plant, controller, initial = numeric((plant, controller.with_period(period), plant.begin(start)))
    joints = len(controller.controllers)
    zero = jnp.zeros(())
    given = dataclasses.replace(controller, reference=_GivenSetpoints((Setpoint(zero, zero),) * joints))
    numbers, fixed = eqx.partition(given, is_real)
    parameters = {"controller": numbers, "control_period": np.asarray(period)}

    def of(parameters: Any, setpoints: tuple[Setpoint, ...]) -> JointwiseControl:
        found = eqx.combine(parameters["controller"], fixed)
        return dataclasses.replace(found, reference=_GivenSetpoints(setpoints))

    def init(parameters: Any, measurement: LegMeasurement) -> dict[str, Any]:
        return {"state": of(parameters, ()).init(measurement)}

    def step(parameters: Any, state: Any, setpoint: Any, measurement: LegMeasurement) -> dict[str, Any]:
        setpoints = tuple(map(Setpoint, setpoint["angles"], setpoint["stiffness"]))
        controller = of(parameters, setpoints)
        state, commands = controller.step(state, jnp.zeros(()), measurement, parameters["control_period"])
        pressures = {f"pressure{number}": one for number, one in enumerate(commands, 1)}
        return {"state": state, "commands": pressures, "telemetry": controller.telemetry(state)}

    measurement = plant.sample(initial, 0.0)[1]
    state = jax.tree.map(lambda one: np.zeros(one.shape, one.dtype), jax.eval_shape(given.init, measurement))
    module = SourceModule(name, parameters, "controller.")
    module.add("init", "first state, from the first measurement", init, {"measurement": measurement})
    text = "one control period: new state, and commands from now on"
    setpoint = {"angles": (zero,) * joints, "stiffness": (zero,) * joints}
    module.add("step", text, step, {"state": state, "setpoint": setpoint, "measurement": measurement})
    muscles, of_joints = range(1, len(plant.muscles) + 1), range(joints)
    measured = [f"angles_{i}" for i in of_joints] + [f"pressures_{i - 1}" for i in muscles] + ["ground_force"]
    columns = (
        *(f"setpoint.angles_{i}" for i in of_joints),
        *(f"setpoint.stiffness_{i}" for i in of_joints),
        *(f"measurement.{one}" for one in measured),
        *(f"commands.pressure{i}" for i in muscles),
    )
    times = sampling_times(duration, period)
    substeps = plant.needed_substeps(start.angles, None, period)
    recorded = np.column_stack(_recorded(plant, controller, initial, times, period, substeps))
    first = [np.nan] * (2 * joints) + [float(one) for one in jax.tree.leaves(measurement)] + [np.nan] * len(muscles)
    units = {
        **{f"setpoint.angles.{i}": "rad" for i in of_joints},
        **{f"setpoint.stiffness.{i}": "N*m/rad" for i in of_joints},
        **{f"measurement.angles.{i}": "rad" for i in of_joints},
        **{f"measurement.pressures.{i - 1}": "Pa, gauge" for i in muscles},
        **{f"commands.pressure{i}": "Pa, gauge" for i in muscles},
        **{f"telemetry.stiffness_estimate_{i}": "N*m/rad" for i in of_joints},
        "measurement.ground_force": "N",
        "parameters.control_period": "s",
    }
    units |= units_of(parameters, "parameters")
    return ControllerModule(module, units, columns, np.vstack([first, recorded]), ())


@compiled_as_given
def _recorded(
    plant: LegPlant, controller: JointwiseControl, initial: LegState, times: Any, period: Any, substeps: Any
) -> tuple[Any, ...]:
    """Setpoints, measurements and commands of a run, each of shape (periods,)."""

    def next_period(states: Any, time: Any) -> Any:
        plant_state, measurement = plant.sample(states[0], period)
        setpoints = controller.reference.step(states[1][0], time, measurement, period)[1]
        state, commands = controller.step(states[1], time, measurement, period)
        following = plant.follow(plant_state, plant.clip_commands(commands), period, substeps)
        angles, stiffness = zip(*setpoints, strict=True)
        return (following, state), (*angles, *stiffness, *jax.tree.leaves(measurement), *commands)

    with batched_program():
        first = initial, controller.init(plant.sample(initial, 0.0)[1])
        return lax.scan(next_period, first, times)[1]
