"""Export of a controller as C99 and as JavaScript."""

from __future__ import annotations

import hashlib
from importlib.resources import files
from pathlib import Path
from string import Template

import mckibben
from mckibben.codegen.c import comment_text, write_c
from mckibben.codegen.javascript import write_js
from mckibben.export.controller import controller_functions, controller_module, controller_program
from mckibben.export.targets import Exported
from mckibben.scenario import Scenario

_TOLERANCES = "1e-9", "1e-4"  # tolerance of a command in 64 and 32 bits, relative to the largest one


def c_files(scenario: Scenario, name: str, folder: Path, *, single: bool = False) -> Exported:
    """The controller of a scenario as C99, with a program that checks it and a sketch for microcontrollers."""
    made = controller_module(scenario, name)
    module, text = made.module, scenario.dumps(folder=folder)
    version = mckibben.__version__
    comment = (
        f"Controller of the scenario {scenario.name!r}, written by mckibben {version}.\n"
        f"SHA-256 of scenario.yaml: {hashlib.sha256(text.encode()).hexdigest()}"
    )
    title = comment_text(" ".join(scenario.name.split()))
    sources = write_c(module, comment, single=single, wide=("setpoint",), units=made.units)
    table = [",".join(made.columns), *(",".join(f"{number:.17g}" for number in row) for row in made.recording)]
    left_out = "".join(f"- {one}\n" for one in made.left_out)
    values = {
        "name": name,
        "title": scenario.name,
        "version": version,
        "real": "float" if single else "double",
        "rows": str(len(made.recording)),
        "columns": str(len(made.columns)),
        "tolerance": _TOLERANCES[single],
        "period": f"{scenario.control_period * 1e3:g} ms",
        "microseconds": f"{scenario.control_period * 1e6:.0f}",
        "left_out": f"\nNot in this program:\n\n{left_out}" if left_out else "",
    }
    files = {
        f"{name}.h": sources.header,
        f"{name}.c": sources.source,
        "scenario.yaml": text,
        "replay.csv": "\n".join(table) + "\n",
        "README.md": filled("README.md", values),
        "replay.c": filled("replay.c", values),
        "Makefile": filled("Makefile", values),
        f"sketch/{name}/{name}.ino": filled("sketch.ino", {**values, "title": title}),
        f"sketch/{name}/{name}.h": sources.header,
        f"sketch/{name}/{name}.c": sources.source,
    }
    return Exported(files, made.left_out)


def js_files(scenario: Scenario, name: str, folder: Path) -> Exported:
    """The controller of a scenario as a script for pages and Node."""
    module, left_out = controller_program(controller_functions(scenario), name)
    period = f"{scenario.control_period * 1e3:g} ms"
    comment = (
        f"Controller of the scenario {scenario.name!r}, written by mckibben {mckibben.__version__}.\n"
        f"  const self = {name}.defaults();\n"
        f"  {name}.init(self, measurement); // once, from the first measurement\n"
        f"  const {{commands}} = {name}.step(self, setpoint, measurement); // every {period}\n"
        "measurement: {angle, pressures_0, pressures_1}, setpoint: {angle, stiffness}; rad, Pa (gauge), N*m/rad.\n"
        f"After changing self.parameters call {name}.prepare(self)."
    )
    return Exported({f"{name}.js": write_js(module, comment), "scenario.yaml": scenario.dumps(folder=folder)}, left_out)


def filled(template: str, values: dict[str, str]) -> str:
    """Text of a filled-in template."""
    return Template((files("mckibben.export") / "templates" / template).read_text()).substitute(values)
