"""Export of a controller as C99 and as JavaScript.

With the C come a recorded run, and a program that replays it, compares the commands and times the steps.
"""

from __future__ import annotations

import hashlib
from pathlib import Path

from mckibben.codegen.c import write_c
from mckibben.codegen.javascript import write_js
from mckibben.codegen.source_module import element_names
from mckibben.export.containment.limits import Limits
from mckibben.export.controller import controller_functions, controller_module, controller_program
from mckibben.export.evaluation import find_function
from mckibben.export.targets import Exported, filled
from mckibben.scenario import Scenario
from mckibben.scenario.robot import RobotScenario
from mckibben.version import __version__

_TOLERANCES = "1e-9", "1e-4"  # tolerance of a command in 64 and 32 bits, relative to the largest one


def c_files(
    scenario: Scenario | RobotScenario, name: str, folder: Path, *, single: bool = False, limits: Limits | None = None
) -> Exported:
    """The controller of a scenario as C99, with a program that checks it.

    Raises `ExportError` for an operation that C cannot express, and for a robot without a controller.

    Parameters
    ----------
    name
        Name of the program, and prefix of its functions.
    folder
        Folder of the export, to which paths in the scenario are relative.
    single
        Whether numbers have 32 bits; the setpoint, and what depends on it alone, keep 64.
    limits
        Limits of its samples.
    """
    program, text = controller_module(scenario, name, limits), scenario.dumps(folder=folder)
    comment = (
        f"Controller of the scenario {scenario.name!r}, written by mckibben {__version__}.\n"
        f"SHA-256 of scenario.yaml: {hashlib.sha256(text.encode()).hexdigest()}"
    )
    sources = write_c(program.module, comment, single=single, wide=("setpoint",), units=program.units)
    table = [",".join(program.columns), *(",".join(f"{number:.17g}" for number in row) for row in program.recording)]
    columns, worst_case = [column.split(".") for column in program.columns], program.module.worst_case("step")
    values = {
        "name": name,
        "title": f'the scenario "{scenario.name}"',
        "rows": len(program.recording),
        "columns": columns,
        "first_command": [part for part, _ in columns].index("commands"),
        "real": "float" if single else "double",
        "tolerance": _TOLERANCES[single],
        "seconds": f"{scenario.control_period!r}",
        "left_out": program.left_out,
        "worst_case": ", ".join(f"{number} {kind}" for kind, number in worst_case.items()),
    }
    files = {f"{name}.h": sources.header, f"{name}.c": sources.source, "replay.csv": "\n".join(table) + "\n"}
    files |= {template: filled(template, values) for template in ("README.md", "replay.c", "Makefile")}
    return Exported({**files, "scenario.yaml": text}, program.left_out, worst_case, period=scenario.control_period)


def js_files(scenario: Scenario | RobotScenario, name: str, folder: Path, *, limits: Limits | None = None) -> Exported:
    """The controller of a scenario as a script for pages and Node.

    Raises `ExportError` for operations that need 64-bit integers, such as random numbers.
    """
    module, left_out = controller_program(controller_functions(scenario, limits), name)
    period = scenario.control_period
    step = find_function(module.functions, "step")

    def members(argument: str) -> str:
        return ", ".join(name.partition(".")[2] for name in element_names(argument, step.arguments[argument]))

    comment = (
        f"Controller of the scenario {scenario.name!r}, written by mckibben {__version__}.\n"
        f"  const self = {name}.defaults();\n"
        f"  {name}.init(self, {period!r}, measurement); // once: period [s], first measurement\n"
        f"  const {{commands, telemetry}} = {name}.step(self, setpoint, measurement); // in each period\n"
        f"measurement: {{{members('measurement')}}}, setpoint: {{{members('setpoint')}}}; rad, Pa (gauge), N*m/rad.\n"
        f"After changing self.parameters call {name}.prepare(self)."
    )
    files: dict[str, str | bytes] = {f"{name}.js": write_js(module, comment)}
    return Exported({**files, "scenario.yaml": scenario.dumps(folder=folder)}, left_out, module.worst_case("step"))
