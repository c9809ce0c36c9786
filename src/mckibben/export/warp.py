"""A joint or a robot for MuJoCo Warp: MJCF, and its muscles as a module of Warp with parameters for each world."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import jax
from jaxtyping import PyTree

from mckibben.codegen.source_module import Function, SourceModule
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
    model, delay = mujoco_model(_with_strengths(plant), name, timestep, start, plugin=False), plant.command_delay
    left_out = (NO_CONTROLLER, *(part for part in model.left_out if part != COMMAND_DELAY))
    text = warp_muscles(model.module, model.muscles, model.names, title or name, float(delay or 0.0), left_out)
    return Exported({f"{name}.xml": model.xml, f"{name}_warp.py": text}, left_out)


def _with_strengths(plant: PyTree) -> PyTree:
    """A plant whose muscles have their strength as a number, a parameter."""
    known = lambda part: isinstance(part, Muscle)  # noqa: E731
    numbered = lambda part: replace(part, strength=1.0) if known(part) and part.strength is None else part  # noqa: E731
    return jax.tree.map(numbered, plant, is_leaf=known)


def warp_muscles(
    module: SourceModule,
    muscles: Sequence[PluginMuscle],
    names: Sequence[str],
    title: str,
    delay: float,
    left_out: tuple[str, ...],
) -> str:
    """Text of the module of Warp for the muscles of a model.

    Parameters
    ----------
    muscles, names
        States of the muscles, and the names of their actuators.
    title
        Name in the description of the module.
    delay
        Delay of the commands [s].
    left_out
        Parts that the description lists as omitted.
    """
    numbers = range(1, len(muscles) + 1)
    before = [sum(muscle.anchors for muscle in muscles[: number - 1]) for number in numbers]
    functions = {function.name: function for function in module.functions}
    kernels = map(partial(_kernels, functions), muscles, numbers, before)
    return filled(
        "warp-muscles.txt",
        {
            "title": title.replace("\\", "/").replace('"""', "'"),
            "name": module.name,
            "left_out": left_out,
            "delay": repr(delay),
            "functions": write_warp(module),
            "kernels": "".join(kernels),
            "actuators": repr(tuple(names)),
            "pressures": repr(tuple(muscle.activations - 1 if muscle.pressurized else -1 for muscle in muscles)),
            "anchors": repr(tuple(muscle.anchors for muscle in muscles)),
            "dynamics": ", ".join(f"dynamics{number}" for number in numbers),
            "forces": ", ".join(f"forces{number}" for number in numbers),
        },
    )


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
