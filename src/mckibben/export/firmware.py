"""Firmware of a joint: its controller on a board, the drivers of its parts, and the serial protocol."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import equinox as eqx
import jax
import numpy as np
from jaxtyping import PyTree

from mckibben.codegen import templates
from mckibben.codegen.c import comment_text, write_c
from mckibben.codegen.source_module import SourceModule
from mckibben.errors import ExportError
from mckibben.export.controller import controller_functions, stepping_module, units_of
from mckibben.export.hardware import Hardware
from mckibben.export.targets import Exported
from mckibben.numerics.compiled import numeric
from mckibben.rig.compiled import vented_angle
from mckibben.rig.simulated.joint import rated_commands
from mckibben.scenario import Scenario
from mckibben.serial_protocol import LONGEST, VERSION, CommandSource, FaultCode, FirmwareState, Hello, MessageKind
from mckibben.version import __version__

_ENUMS = {"KIND": MessageKind, "STATE": FirmwareState, "CODE": FaultCode, "SOURCE": CommandSource}
"""Enumerations of the protocol by their prefixes in C."""
_CONVERTERS = {"uno_r4": (5.0, 14), "teensy4": (3.3, 12), "esp32": (3.3, 12), "stm32": (3.3, 12)}
"""Reference [V] and bits of the analog inputs of each board."""


def link_files() -> dict[str, str]:
    """Codec of the serial protocol as C99."""
    enums = [{"prefix": prefix, "members": list(members)} for prefix, members in _ENUMS.items()]
    return _filled(("link.h", "link.c"), {"protocol": VERSION, "longest": LONGEST, "enums": enums})


def firmware_files(scenario: Scenario, name: str, folder: Path, *, hardware: Hardware) -> Exported:
    """Project of a board: a sketch of its Arduino core, or C with a simulated joint for this computer.

    A muscle without air, such as a spring, needs neither sensor nor valve. Raises `ExportError` for a missing part.
    """
    air = [high > 0 for _, high in rated_commands(scenario.plant())]
    parts = [[f"{kind}{i}" for i, takes in enumerate(air, start=1) if takes] for kind in ("pressure", "valve")]
    needed = ("board",) if hardware.board == "host" else ("board", "angle", *parts[0], *parts[1], "vent")
    for field in needed:
        if getattr(hardware, field) is None:
            message, remedy = f"the firmware needs {field}", f"give {field} in the hardware file"
            raise ExportError(message, field=field, remedy=remedy)
    source, text = controller_functions(scenario, hardware.limits), scenario.dumps(folder=folder)
    module = stepping_module("controller", source)
    comment = f"Controller of the scenario {scenario.name!r}, written by mckibben {__version__}."
    program = write_c(module, comment, single=hardware.single, wide=("setpoint",), units=units_of(module, "Pa, gauge"))
    channels = [("angle", "rad"), ("pressure1", "Pa"), ("pressure2", "Pa"), *[("force", "N")] * bool(hardware.force)]
    hello = Hello(
        f"mckibben {__version__} {hardware.board}",
        round(source.period * 1e6),
        scenario.digest,
        channels,
        [("valve1", "Pa"), ("valve2", "Pa")],
        [("angle", "rad"), ("stiffness", "N*m/rad")],
    )
    values = {
        **{field: getattr(hardware, field) for field in ("board", "angle", "vent", "force")},
        "air": air,
        "pressures": [hardware.pressure1, hardware.pressure2],
        "valves": [hardware.valve1, hardware.valve2],
        "volts": _CONVERTERS.get(str(hardware.board), (0, 0))[0],
        "bits": _CONVERTERS.get(str(hardware.board), (0, 0))[1],
        "title": comment_text(" ".join(scenario.name.split())),
        "real": "float" if hardware.single else "double",
        "period": repr(source.period),
        "microseconds": hello.period,
        "silence": round(hardware.silence * 1e6),
        "measurements": [channel for channel, _ in channels],
        "hello": list(hello.pack()),
    }
    files = {"controller.h": program.header, "controller.c": program.source, **link_files()}
    files |= _filled(("firmware.h", "firmware.c"), values)
    left_out: tuple[str, ...] = ()
    if hardware.board == "host":
        files |= _filled(("host.c", "simulated.c", "simulated.h", "host.mk"), values)
        files["Makefile"] = files.pop("host.mk")
        left_out = ("delay of the commands",) if source.plant.command_delay is not None else ()
        files |= dict(zip(("plant.h", "plant.c"), write_c(_plant(scenario, source.period)), strict=True))
    else:
        files[f"{name}.ino"] = _filled(("board.ino",), values)["board.ino"]
    folder_name = f"{name}/" if hardware.board != "host" else ""  # a sketch stands in a folder of its name
    contents = {f"{folder_name}{path}": content for path, content in files.items()}
    return Exported(
        {**contents, "scenario.yaml": text}, left_out, module.worst_case("step"), period=scenario.control_period
    )


def _plant(scenario: Scenario, period: float) -> SourceModule:
    """Simulated joint with ideal sensors: `init`, hanging without pressure, and `advance` by a control period.

    The joint that advances has a weight [kg] on its limb, at a distance [m].
    """
    hanging = vented_angle(scenario.plant())
    plant, substeps, zeros = numeric(scenario.plant().with_ideal_io()), scenario.needed_substeps(), (np.zeros(()),) * 2
    numbers, fixed = eqx.partition(plant, eqx.is_inexact_array_like)
    module, state = SourceModule("plant", numbers), jax.tree.map(np.asarray, plant.init_state(hanging, (0.0, 0.0)))

    def init(parameters: PyTree) -> dict[str, PyTree]:
        return {"state": eqx.combine(parameters, fixed).init_state(hanging, (0.0, 0.0))}

    def advance(parameters: PyTree, state: PyTree, commands: PyTree, weight: PyTree) -> dict[str, PyTree]:
        plant = eqx.combine(parameters, fixed)
        plant = dataclasses.replace(plant, load=plant.load.with_weight(weight["mass"], weight["distance"]))
        return {"state": plant.advance(state, plant.clip_commands(commands), period, substeps)}

    inputs = {"state": state, "commands": zeros, "weight": {"mass": zeros[0], "distance": zeros[0]}}
    module.add("init", "state at rest without pressure", init, {})
    module.add("advance", "state after a control period", advance, inputs)
    return module


def _filled(names: tuple[str, ...], values: dict[str, object]) -> dict[str, str]:
    """Templates of this package with values."""
    values = {"version": __version__, **values}
    return {name: templates.filled(name, values, "mckibben.export") for name in names}
