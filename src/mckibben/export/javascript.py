"""Export of a controller as JavaScript."""

from __future__ import annotations

from pathlib import Path

import mckibben
from mckibben.codegen.javascript import write_js
from mckibben.export.controller import controller_functions, controller_program
from mckibben.export.targets import Exported
from mckibben.scenario import Scenario


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
