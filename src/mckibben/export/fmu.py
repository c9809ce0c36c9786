"""FMUs of the plant and of the controller of a scenario.

Each is a `FunctionalUnit`: functions of a state and of inputs, from which `fmi` makes the archive.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import jax
from jaxtyping import PyTree

from mckibben.codegen.source_module import SourceModule
from mckibben.component.columns import attributes
from mckibben.export.containment.limits import Limits
from mckibben.export.controller import controller_functions, parts_of, units_of
from mckibben.export.fmi import fmu
from mckibben.export.functional_unit import FunctionalUnit
from mckibben.export.plant import plant_unit
from mckibben.export.targets import Exported
from mckibben.scenario import Scenario
from mckibben.scenario.robot import RobotScenario


def plant_fmu(scenario: Scenario | RobotScenario, name: str, folder: Path) -> Exported:
    """The plant for model exchange and co-simulation: commands and external torques in, motion and forces out.

    Raises `ExportError` for parts that C cannot express, without FMPy, and for a robot without a controller. Sensors,
    disturbances and the delay of the commands are omitted.
    """
    plant, _, initial = parts_of(scenario)
    unit = plant_unit(plant, initial, name, scenario.control_period, scenario.needed_substeps())
    unit = replace(unit, joints=scenario.joint_names, muscles=scenario.muscle_names)
    left_out = []
    if not unit.model_exchange:
        left_out.append(f"model exchange: a {type(plant.valve).__name__} switches at steps of the integration")
    if not plant.has_ideal_io:
        left_out.append("sensors and disturbance: connect your own to the angles, the pressures and the torques")
    if plant.command_delay is not None:
        left_out.append("delay of the commands: give one to the signals of the inputs")
    content, missing = fmu(unit, scenario.dumps(folder=folder))
    return Exported({f"{name}.fmu": content}, (*left_out, *missing))


def controller_fmu(
    scenario: Scenario | RobotScenario, name: str, folder: Path, *, limits: Limits | None = None
) -> Exported:
    """The controller for co-simulation with steps of the control period.

    Inputs that are not finite, out of range or frozen leave the state as it is, and end in a vent. Raises `ExportError`
    as `plant_fmu`.
    """
    source = controller_functions(scenario, limits)
    module = SourceModule(name, source.parameters, "controller.")
    inputs = {"setpoint": source.setpoint, "measurement": source.measurement}

    def step(parameters: PyTree, state: PyTree, inputs: PyTree) -> dict[str, PyTree]:
        return source.contained(parameters, state, inputs["setpoint"], inputs["measurement"])

    def results(parameters: PyTree, state: PyTree, inputs: PyTree) -> dict[str, PyTree]:
        done = step(parameters, state, inputs)
        commands = {f"command{number}": command for number, command in enumerate(done["commands"].values(), 1)}
        return {"results": jax.tree.map(lambda number: number.astype(float), commands | done["telemetry"])}

    def init(parameters: PyTree, inputs: PyTree) -> dict[str, PyTree]:
        return {"state": source.start(parameters, inputs["measurement"])}

    def advance(parameters: PyTree, state: PyTree, inputs: PyTree) -> dict[str, PyTree]:
        return {"state": step(parameters, state, inputs)["state"]}

    both = {"state": source.state, "inputs": inputs}
    module.add("init", "first state, from the first measurement", init, {"inputs": inputs})
    module.add("evaluate", "commands from now on", results, both)
    module.add("advance", "state after a control period", advance, both)
    columns = next(f for f in module.functions if f.name == "evaluate").results["results"]
    kind = scenario.joint_type
    labels = {member.path: attributes(member.path.split(".")[0], kind) for member in columns}
    units = {f"results.{path}": label.get("units", "") for path, label in labels.items()}
    units |= units_of(module, joint_type=kind)
    if (plant := scenario.plant()).valve.direct:
        units |= {f"results.command{number}": "" for number, _ in enumerate(plant.muscles, 1)}
    title = f"Controller of the scenario {scenario.name!r}"
    names = {"joints": scenario.joint_names, "muscles": scenario.muscle_names}
    unit = FunctionalUnit(module, title, scenario.control_period, units, sampled=True, **names)
    content, missing = fmu(unit, scenario.dumps(folder=folder))
    return Exported({f"{name}.fmu": content}, tuple(missing))
