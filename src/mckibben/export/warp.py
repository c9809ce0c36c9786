"""A joint or a robot for MuJoCo Warp: MJCF, and its muscles as a module of Warp with parameters for each world."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import jax
from jaxtyping import PyTree

from mckibben.codegen.source_module import Function
from mckibben.codegen.warp import write_warp
from mckibben.export.mjcf import COMMAND_DELAY, mujoco_model, plant_and_start
from mckibben.export.muscle_plugin import NO_CONTROLLER, PluginMuscle
from mckibben.export.targets import Exported, filled
from mckibben.muscle import Muscle
from mckibben.plant import JointPlant
from mckibben.robot import RobotPlant, RobotScenario
from mckibben.scenario import Scenario


def warp_files(scenario: Scenario | RobotScenario, name: str, folder: Path) -> Exported:
    """The plant of a scenario as MJCF, and its muscles for MuJoCo Warp.

    Raises `ExportError` for parts that MuJoCo cannot represent.
    """
    plant, start, timestep = plant_and_start(scenario)
    made = warp_plant(plant, name, timestep, start, scenario.name)
    return Exported({**made.contents, "scenario.yaml": scenario.dumps(folder=folder)}, made.left_out)


def warp_plant(plant: JointPlant | RobotPlant, name: str, timestep: float, start: PyTree, title: str = "") -> Exported:
    """MJCF and module of a plant, which starts in a state, for time steps [s]; its commands may be delayed."""
    xml, module, muscles, names, omitted = mujoco_model(_with_strengths(plant), name, timestep, start, plugin=False)
    left_out = (NO_CONTROLLER, *(part for part in omitted if part != COMMAND_DELAY))
    numbers = range(1, len(muscles) + 1)
    before = [sum(muscle.anchors for muscle in muscles[: number - 1]) for number in numbers]
    functions = {function.name: function for function in module.functions}
    values = {
        "title": (title or name).replace("\\", "/").replace('"""', "'"),
        "name": name,
        "left_out": left_out,
        "delay": repr(float(plant.command_delay or 0.0)),
        "functions": write_warp(module),
        "kernels": "".join(map(partial(_kernels, functions), muscles, numbers, before)),
        "actuators": repr(names),
        "pressures": repr(tuple(muscle.activations - 1 if muscle.pressurized else -1 for muscle in muscles)),
        "anchors": repr(tuple(muscle.anchors for muscle in muscles)),
        "dynamics": ", ".join(f"dynamics{number}" for number in numbers),
        "forces": ", ".join(f"forces{number}" for number in numbers),
    }
    return Exported({f"{name}.xml": xml, f"{name}_warp.py": filled("warp-muscles.txt", values)}, left_out)


def _with_strengths(plant: PyTree) -> PyTree:
    """A plant whose muscles have their strength as a number, a parameter."""
    known = lambda part: isinstance(part, Muscle)  # noqa: E731
    numbered = lambda part: replace(part, strength=1.0) if known(part) and part.strength is None else part  # noqa: E731
    return jax.tree.map(numbered, plant, is_leaf=known)


def _kernels(functions: Mapping[str, Function], muscle: PluginMuscle, number: int, anchor: int) -> str:
    """Kernels of a muscle, whose anchors begin at a column of those of all muscles."""
    columns = ["first", *(f"rest + {place}" for place in range(muscle.activations - 1))]
    places = {
        "act": [f"act[world, {column}]" for column in columns],
        "anchors": [f"anchors[world, {anchor + place}]" for place in range(muscle.anchors)],
    }
    single = {
        "length": "length[world, actuator]",
        "velocity": "velocity[world, actuator]",
        "command": f"command[world, {number - 1}]",
    }

    def call(name: str) -> str:
        inputs = [
            single.get(member.name) or places[member.name][place]
            for members in functions[name].arguments.values()
            for member in members
            for place in range(member.size)
        ]
        return f"{name}({', '.join(['model', 'world', *inputs])})"

    def assigned(name: str, targets: Mapping[str, Sequence[str]], condition: str = "") -> str:
        """Statements that store the results of a function."""
        if name not in functions:
            return ""
        (members,) = functions[name].results.values()
        stored = [targets[member.name][place] for member in members for place in range(member.size)]
        results = [f"r{place}" for place in range(len(stored))]
        lines = [f"{', '.join(results)} = {call(name)}"]
        lines += [f"{target} = {result}" for target, result in zip(stored, results, strict=True)]
        lines = [f"if {condition}:", *(f"    {line}" for line in lines)] if condition else lines
        return "\n".join(f"    {line}" for line in lines)

    values = {
        "k": str(number),
        "index": str(number - 1),
        "settled": assigned(f"settled{number}", places, "later"),
        "unset": assigned(f"unset{number}", places, "begun"),
        "rates": assigned(f"rates{number}", {"act": [f"act_dot[world, {column}]" for column in columns]}),
        "force": f"    force[world, actuator] = {call(f'force{number}')}",
    }
    return filled("warp-muscle.txt", values)
