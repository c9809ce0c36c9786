"""Firmware of a joint or robot: its controller on a board, the drivers of its parts, and the serial protocol."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Sequence
from itertools import compress
from pathlib import Path
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import PyTree

from mckibben.codegen import templates
from mckibben.codegen.c import comment_text, write_c
from mckibben.codegen.source_module import SourceModule, element_names
from mckibben.errors import ExportError
from mckibben.export.controller import controller_functions, stepping_module, units_of
from mckibben.export.evaluation import find_function
from mckibben.export.hardware import AngleSensor, Hardware, PressureSensor, RegulatorOutput
from mckibben.export.targets import Exported
from mckibben.numerics.compiled import numeric
from mckibben.rig.channels import Channels
from mckibben.rig.compiled import rated_commands, starting_state, vented_state
from mckibben.scenario import Scenario
from mckibben.scenario.robot import RobotScenario
from mckibben.serial_protocol import (
    DESCRIBED,
    LONGEST,
    VERSION,
    CommandSource,
    FaultCode,
    FirmwareState,
    Hello,
    MessageKind,
    Sample,
    pack_numbers,
)
from mckibben.version import __version__

_ENUMS = {"KIND": MessageKind, "STATE": FirmwareState, "CODE": FaultCode, "SOURCE": CommandSource}
"""Enumerations of the protocol by their prefixes in C."""
_CONVERTERS = {"uno_r4": (5.0, 14), "teensy4": (3.3, 12), "esp32": (3.3, 12), "stm32": (3.3, 12)}
"""Reference [V] and bits of the analog inputs of each board."""


_OF_A_JOINT = "angle", "pressure1", "pressure2", "valve1", "valve2"
"""Parts of a joint without a name."""


def link_files(longest: int = LONGEST) -> dict[str, str]:
    """Codec of the serial protocol as C99, for messages with bodies of up to a number of bytes."""
    enums = [{"prefix": prefix, "members": list(members)} for prefix, members in _ENUMS.items()]
    return _filled(("link.h", "link.c"), {"protocol": VERSION, "longest": longest, "enums": enums})


def firmware_files(scenario: Scenario | RobotScenario, name: str, folder: Path, *, hardware: Hardware) -> Exported:
    """Project of a board: a sketch of its Arduino core, or C with simulated joints for this computer.

    A muscle without air, such as a spring, needs neither sensor nor valve. Raises `ExportError` for a missing part, and
    for angle sensors that share an address.
    """
    plant, names = scenario.plant(), Channels.of(scenario)
    air = [high > 0 for _, high in rated_commands(plant)]
    parts = BoardParts.of(hardware, names, air)
    source, text = controller_functions(scenario, hardware.limits), scenario.dumps(folder=folder)
    module = stepping_module("controller", source)
    comment = f"Controller of the scenario {scenario.name!r}, written by mckibben {__version__}."
    program = write_c(
        module,
        comment,
        single=hardware.single,
        wide=("setpoint",),
        units=units_of(module, "Pa, gauge", scenario.joint_type),
    )
    angles, pressures = names.by_joint("angle"), names.by_muscle("pressure")
    unit = scenario.joint_type.unit
    channels = [(channel, unit("rad")) for channel in angles] + [(channel, "Pa") for channel in pressures]
    channels += [("force", "N")] * bool(hardware.force)
    hello = Hello(
        f"mckibben {__version__} {hardware.board}",
        round(source.period * 1e6),
        scenario.digest,
        channels,
        [(channel, "Pa") for channel in names.valves],
        [
            *((angle, unit("rad")) for angle in angles),
            *((stiffness, unit("N*m/rad")) for stiffness in names.by_joint("stiffness")),
        ],
    )
    sample = Sample(0, 0, 0, 0, 0, 0, (0.0,) * (len(channels) + len(names.muscles)))
    longest = max(DESCRIBED, len(sample.pack()), len(pack_numbers((0.0,) * len(hello.setpoints))))
    step = find_function(module.functions, "step").arguments
    measured, setpoints = (
        [element.partition(".")[2] for element in element_names(part, step[part])]
        for part in ("measurement", "setpoint")
    )
    converter = _CONVERTERS.get(str(hardware.board), (0, 0))
    values = {
        **parts._asdict(),
        **{field: getattr(hardware, field) for field in ("board", "vent", "force")},
        "kinds": [angle.sensor for angle in parts.angles if angle],
        "air": air,
        "measured": measured,
        "readings": len(angles) + len(pressures),
        "setpoints": setpoints,
        "volts": converter[0],
        "bits": converter[1],
        "title": comment_text(" ".join(scenario.name.split())),
        "real": "float" if hardware.single else "double",
        "period": repr(source.period),
        "microseconds": hello.period,
        "silence": round(hardware.silence * 1e6),
        "measurements": [channel for channel, _ in channels],
        "hello": list(map(list, hello.pack())),
    }
    files = {"controller.h": program.header, "controller.c": program.source, **link_files(longest)}
    files |= _filled(("firmware.h", "firmware.c"), values)
    left_out = ["force on the foot: measured as 0"] * ("ground_force" in measured and plant.mechanism.has_contacts)
    if hardware.board == "host":
        moving = _plant(scenario, source.period)
        values |= {"weight": not names.is_named, "plant_angles": _angles(moving)}
        files |= _filled(("host.c", "simulated.c", "simulated.h", "host.mk"), values)
        files["Makefile"] = files.pop("host.mk")
        left_out += ["delay of the commands"] * (source.plant.command_delay is not None)
        files |= dict(zip(("plant.h", "plant.c"), write_c(moving), strict=True))
    else:
        files[f"{name}.ino"] = _filled(("board.ino",), values)["board.ino"]
    folder_name = f"{name}/" if hardware.board != "host" else ""  # a sketch stands in a folder of its name
    contents = {f"{folder_name}{path}": content for path, content in files.items()}
    return Exported(
        {**contents, "scenario.yaml": text}, tuple(left_out), module.worst_case("step"), period=scenario.control_period
    )


class BoardParts(NamedTuple):
    """Sensors and valves of a board in the order of its channels; None for one that is not needed."""

    angles: Sequence[AngleSensor | None]
    pressures: Sequence[PressureSensor | None]
    valves: Sequence[RegulatorOutput | None]

    @classmethod
    def of(cls, hardware: Hardware, names: Channels, air: Sequence[bool]) -> BoardParts:
        """Parts in a file; `ExportError` for one that is missing, left over, or not told from others by its address."""
        ends = {"angle": names.joints, "pressure": names.muscles, "valve": names.muscles}
        named = {kind: [f"{kind}{'s' * names.is_named}{end}" for end in suffixes] for kind, suffixes in ends.items()}
        given = {name: getattr(hardware, name) for name in _OF_A_JOINT if getattr(hardware, name) is not None}
        for kind in ends:
            given |= {f"{kind}s.{name}": part for name, part in getattr(hardware, f"{kind}s").items()}
        choices = [name for channels in named.values() for name in channels]
        for name in sorted(given.keys() - {*choices}):
            message, remedy = f"{name} belongs to no joint or muscle", f"choose from {', '.join(choices)}"
            raise ExportError(message, field=name, remedy=remedy)
        filled = [name for kind in ("pressure", "valve") for name in compress(named[kind], air)]
        given |= {name: getattr(hardware, name) for name in ("board", "vent")}
        needed = ["board"] if hardware.board == "host" else ["board", *named["angle"], *filled, "vent"]
        for name in needed:
            if given.get(name) is None:
                remedy = f"give {name} in the hardware file"
                raise ExportError(f"the firmware needs {name}", field=name, remedy=remedy)
        parts = cls(*([given.get(name) for name in channels] for channels in named.values()))
        parts.check_addresses()
        return parts

    def check_addresses(self) -> None:
        """Raise `ExportError` for angle sensors that their addresses do not tell apart."""
        places = [angle.channel for angle in self.angles if angle and angle.sensor == "as5600"]
        if len(places) > 1 and (None in places or len({*places}) < len(places)):
            remedy = "give each the channel of a TCA9548A, or use quadrature encoders"
            raise ExportError("all AS5600 have one address on their bus", field="channel", remedy=remedy)


def _angles(module: SourceModule) -> list[str]:
    """Members of the state of a plant that are the angles of its joints."""
    return [member.name for member in module.state if re.fullmatch(r"position(\.angles\.\d+)?", member.path)]


def _plant(scenario: Scenario | RobotScenario, period: float) -> SourceModule:
    """Simulated joints with ideal sensors: `init`, hanging without pressure, and `advance` by a control period.

    A joint that advances has a weight [kg] on its limb, at a distance [m]; a robot has none.
    """
    plant, substeps = scenario.plant().with_ideal_io(), scenario.needed_substeps()
    hanging = jax.tree.map(np.asarray, vented_state(plant, starting_state(scenario, plant)))
    plant = numeric(plant)
    numbers, fixed = eqx.partition(plant, eqx.is_inexact_array_like)
    module, zero = SourceModule("plant", numbers), np.zeros(())

    def init(parameters: PyTree) -> dict[str, PyTree]:
        return {"state": jax.tree.map(jnp.asarray, hanging)}

    def advance(parameters: PyTree, state: PyTree, commands: PyTree, weight: PyTree = None) -> dict[str, PyTree]:
        plant = eqx.combine(parameters, fixed)
        if weight is not None:
            load = plant.load.with_weight(weight["mass"], weight["distance"])
            plant = dataclasses.replace(plant, load=load)
        return {"state": plant.advance(state, plant.clip_commands(commands), period, substeps)}

    inputs = {"state": hanging, "commands": (zero,) * len(plant.muscles)}
    if not scenario.joint_names:
        inputs |= {"weight": {"mass": zero, "distance": zero}}
    module.add("init", "state at rest without pressure", init, {})
    module.add("advance", "state after a control period", advance, inputs)
    return module


def _filled(names: tuple[str, ...], values: dict[str, object]) -> dict[str, str]:
    """Templates of this package with values."""
    values = {"version": __version__, **values}
    return {name: templates.filled(name, values, "mckibben.export") for name in names}
