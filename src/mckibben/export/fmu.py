"""FMUs of the plant and of the controller of a scenario.

Each is a `FunctionalUnit`: functions of a state and of inputs, from which `fmi` makes the archive.
"""

from __future__ import annotations

from pathlib import Path

import jax
import numpy as np
from jaxtyping import PyTree

from mckibben.codegen.source_module import SourceModule
from mckibben.component.columns import attributes
from mckibben.export.containment.limits import Limits
from mckibben.export.controller import controller_functions, units_of
from mckibben.export.fmi import fmu
from mckibben.export.functional_unit import FunctionalUnit
from mckibben.export.plant import plant_unit
from mckibben.export.targets import Exported
from mckibben.joint import Measurement
from mckibben.scenario import Scenario
from mckibben.simulation.problem import sampled

_NUMBER = np.zeros(())


def plant_fmu(scenario: Scenario, name: str, folder: Path) -> Exported:
    """The plant for model exchange and co-simulation: commands and an external torque in, motion and forces out.

    Raises `ExportError` for parts that C cannot express, and without FMPy. Sensors, disturbances and the delay of the
    commands are omitted.
    """
    plant = scenario.plant()
    unit = plant_unit(plant, scenario.initial(plant), name, scenario.control_period, scenario.needed_substeps())
    left_out = []
    if not unit.model_exchange:
        left_out.append(f"model exchange: a {type(plant.valve).__name__} switches at steps of the integration")
    if not plant.has_ideal_io:
        left_out.append("sensors and disturbance: connect your own to the angle, the pressures and the torque")
    if plant.command_delay is not None:
        left_out.append("delay of the commands: give one to the signals of the inputs")
    content, missing = fmu(unit, scenario.dumps(folder=folder))
    return Exported({f"{name}.fmu": content}, (*left_out, *missing))


def controller_fmu(scenario: Scenario, name: str, folder: Path, *, limits: Limits | None = None) -> Exported:
    """The controller for co-simulation with steps of the control period.

    Inputs that are not finite, out of range or frozen leave the state as it is, and end in a vent.
    """
    source = controller_functions(scenario, limits)
    module = SourceModule(name, source.parameters, "controller.")
    inputs = {
        "setpoint": {"angle": _NUMBER, "stiffness": _NUMBER},
        "measurement": {"angle": _NUMBER, "pressure1": _NUMBER, "pressure2": _NUMBER},
    }

    def measured(inputs: PyTree) -> Measurement:
        at = inputs["measurement"]
        return source.measurement._replace(angle=at["angle"], pressures=(at["pressure1"], at["pressure2"]))

    def step(parameters: PyTree, state: PyTree, inputs: PyTree) -> dict[str, PyTree]:
        setpoint = source.setpoint._replace(**inputs["setpoint"])
        return source.contained(parameters, state, setpoint, measured(inputs))

    def results(parameters: PyTree, state: PyTree, inputs: PyTree) -> dict[str, PyTree]:
        done = step(parameters, state, inputs)
        commands = {f"command{number}": done["commands"][f"pressure{number}"] for number in (1, 2)}
        return {"results": jax.tree.map(lambda number: number.astype(float), commands | done["telemetry"])}

    def init(parameters: PyTree, inputs: PyTree) -> dict[str, PyTree]:
        return {"state": source.start(parameters, measured(inputs))}

    def advance(parameters: PyTree, state: PyTree, inputs: PyTree) -> dict[str, PyTree]:
        return {"state": step(parameters, state, inputs)["state"]}

    both = {"state": source.state, "inputs": inputs}
    module.add("init", "first state, from the first measurement", init, {"inputs": inputs})
    module.add("evaluate", "commands from now on", results, both)
    module.add("advance", "state after a control period", advance, both)
    setpoints = sampled(scenario.reference(), scenario.duration, scenario.control_period)[1]
    pressure1, pressure2 = source.measurement.pressures
    starts = {
        "setpoint.angle": setpoints.angle[0],
        "setpoint.stiffness": setpoints.stiffness[0],
        "measurement.angle": source.measurement.angle,
        "measurement.pressure1": pressure1,
        "measurement.pressure2": pressure2,
    }
    columns = next(f for f in module.functions if f.name == "evaluate").results["results"]
    telemetry = {f"results.{member.path}": attributes(member.path).get("units", "") for member in columns}
    unit = FunctionalUnit(
        module,
        f"Controller of the scenario {scenario.name!r}",
        scenario.control_period,
        {path: float(value) for path, value in starts.items()},
        units_of(module) | telemetry,
        sampled=True,
    )
    content, missing = fmu(unit, scenario.dumps(folder=folder))
    return Exported({f"{name}.fmu": content}, tuple(missing))
