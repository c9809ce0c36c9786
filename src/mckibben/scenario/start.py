"""A scenario to start from, that of `mckibben new joint`, with stiffnesses that its joint can have."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mckibben.codegen.templates import filled
from mckibben.component.schema import parse_component
from mckibben.config.document import read_document
from mckibben.errors import RangeError
from mckibben.joint import AntagonisticJoint, Load
from mckibben.muscle import Muscle
from mckibben.scenario.scenario import Scenario
from mckibben.units import GRAVITY, deg, kPa, mm, quantity, show

_ANGLES = np.array([-10.0, 0.0, 10.0]) * deg  # of the sine in the template
_INTEGRAL = 8.0  # rad/s
_EXTENSION = 30 * mm  # of the spring of an axis, at position 0
UNKNOWN = {"low": "1 N*m/rad", "high": "1 N*m/rad", "valve": "ideal", "rough": "false", "uncertainty": "[]"}
"""Values of a text from which a joint is read first."""


def starting_text(values: Mapping[str, object], template: str = "joint") -> str:
    """Return the text of a commented scenario; `values` are those of the template's marks."""
    return filled(f"{template}.yaml", values, "mckibben.scenario")


def axis_text(values: Mapping[str, object], muscle: Muscle, against: str, folder: Path) -> str:
    """Return the text of an axis in a folder, for a muscle against a `spring`, a `weight` or another `muscle`.

    `values` are those of the template's marks for a joint; numbers suit the muscle. Raises `RangeError` if it has no
    force in the middle of its motion.
    """
    values = {"opposite": values["muscle"], **values, **_axis_values(muscle, against)}
    unknown = {"valve": "", "uncertainty": "", "position_gains": "", "stiffness_gains": ""}
    text, place = starting_text(values | unknown, "axis"), {"source": "the new axis", "folder": folder}
    joint = parse_component(AntagonisticJoint, text, key="joint", **place)
    load = parse_component(Load, text, key="load", **place)
    values |= laboratory(joint) | _axis_gains(joint, load)
    if against == "muscle":
        motion = np.array([-1.0, 0.0, 1.0]) * quantity(str(values["amplitude"]), "m")
        values |= starting_stiffness(joint, load, motion)
    return starting_text(values, "axis")


def _axis_values(muscle: Muscle, against: str) -> dict[str, str]:
    """Values of the template of an axis.

    At position 0 the muscle is 10 % shorter than without pressure, and holds spring or weight at half its highest
    pressure; the motion is 2 % of its length.
    """
    length, pressure = float(muscle.specimen.initial_length), float(muscle.domain.pressure_max) / 2
    force, amplitude = float(muscle.tension(0.1, pressure)), show(0.02 * length, "mm", 2)
    if force <= 0:
        text = "the muscle has no force at 10 % of contraction and half its highest pressure"
        raise RangeError(text, field="muscle", remedy="give another muscle")
    rest = show(0.9 * length, "mm", 4)
    values = {"lengths": f"rest_length2: {rest}", "mass": "2 kg", "incline": "0 deg", "amplitude": amplitude}
    if against == "weight":
        mass = show(force / GRAVITY, "kg", 2)
        return values | {"what": "a muscle lifts a weight", "opposite": "none", "mass": mass, "incline": "90 deg"}
    if against == "muscle":
        lengths = f"rest_length1: {rest}, {values['lengths']}"
        return values | {"what": "a mass between two muscles", "lengths": lengths}
    rate, free = show(force / _EXTENSION, "N/mm", 2), 120 * mm
    spring = f"{{class: return_spring, rate: {rate}, free_length: {show(free, 'mm')}}}"
    lengths = f"rest_length1: {show(free + _EXTENSION, 'mm')}, {values['lengths']}"
    return values | {"what": "a muscle pulls a mass against a spring", "lengths": lengths, "opposite": spring}


def _axis_gains(joint: AntagonisticJoint, load: Load) -> dict[str, str]:
    """PID gains of position and, of two muscles, of stiffness, whose integral has a bandwidth of 8 rad/s.

    By the forces and stiffnesses that differential pressure and co-contraction give at position 0, at rest.
    """
    first, second = joint.pressures_for(0.0, -load.gravity_torque(0.0), None)

    def change(sign: float) -> tuple[float, float]:
        """Changes of force and stiffness by the pressure of muscle 2 and, with a sign, of muscle 1."""
        low, high = (joint.torque_and_stiffness(0.0, (first + sign * step, second + step)) for step in (-kPa, kPa))
        return float(high[0] - low[0]) / (2 * kPa), float(high[1] - low[1]) / (2 * kPa)

    def gains(size: float, *units: str) -> str:
        values = zip(("kp", "ki", "kd"), (0.1, _INTEGRAL, 0.0), units, strict=True)
        return f"{{{', '.join(f'{name}: {show(value * size, unit, 2)}' for name, value, unit in values)}}}"

    stiffness = float(joint.stiffness(0.0, (first, second)) + load.gravity_stiffness(0.0))
    found = {"position_gains": gains(stiffness / change(-1.0)[0], "bar/mm", "bar/(mm*s)", "bar*s/mm")}
    units = "bar/(N/mm)", "bar/(N*s/mm)", "bar*s/(N/mm)"
    return found | {"stiffness_gains": "" if any(joint.springs) else gains(1 / change(1.0)[1], *units)}


def starting_stiffness(joint: AntagonisticJoint, load: Load, angles: NDArray = _ANGLES) -> dict[str, str]:
    """Return two stiffnesses, `low` and `high`, that a joint has with a load at angles [rad] of the motion.

    Default: at both ends of that of `mckibben new joint`, and in between. Raises `RangeError` if there are none.
    """
    lowest, highest = joint.attainable_stiffness(angles, -load.gravity_torque(angles))
    low, high, kind = float(np.max(lowest)), float(np.min(highest)), joint.joint_type
    if not low < high:
        where = ", ".join(kind.show(angle, "deg") for angle in angles)
        text = f"the muscles cannot hold the load at {where} with any choice of the stiffness"
        remedy = "take stronger muscles, larger moment arms or a smaller load, or see `mckibben size`"
        raise RangeError(text, field="muscle", remedy=remedy)
    parts = ("low", 0.4), ("high", 0.6)
    return {name: kind.show(low + part * (high - low), "N*m/rad", 3) for name, part in parts}


def laboratory(joint: AntagonisticJoint) -> dict[str, str]:
    """Return valve and uncertainty of a laboratory, and the compensation of friction, that suit a joint's muscles.

    Muscles of unknown volume have a valve without flow.
    """
    rough = [number for number, muscle in enumerate(joint.muscles, start=1) if muscle.has_friction]
    valve, varied = "{time_constant: 30 ms}", "valve.time_constant=20..45 ms"
    if all(muscle.specimen.has_volume for muscle in joint.muscles):
        valve = "{from: festo-vppe-6, supply: 7 bar, time_constant: 30 ms, dead_volume: 5 cm^3}"
        varied = "valve.supply=6.5..7.5 bar"
    texts = ["load.mass=+-20 %", "command_delay=2..6 ms", varied]
    pulling = [number for number, muscle in enumerate(joint.muscles, start=1) if muscle.law.pulls]
    texts += [f"joint.muscle{number}.strength=+-10 %" for number in pulling]
    texts += [f"joint.muscle{number}.friction.half_width=+-30 %" for number in rough]
    uncertainty = "".join(f"\n  - {text}" for text in texts)
    return {"valve": valve, "rough": "true" if rough else "false", "uncertainty": uncertainty}


def starting_scenario(joint: AntagonisticJoint, load: object, sections: Mapping[str, object]) -> Scenario:
    """Return the scenario of a joint and its load, with `sections` in place of those of the template.

    Errors are those of `AntagonisticJoint.scenario`.
    """
    values: dict[str, object] = dict.fromkeys(("file", "muscle", "rest_length"), "")
    values["name"] = joint.muscle2.specimen.name
    fields = _sections(values | UNKNOWN | laboratory(joint))
    del fields["uncertainty"]  # of a pendulum
    fields |= {"joint": joint, "load": load, **sections}
    if "reference" in sections:
        return Scenario(**{key: field for key, field in fields.items() if key != "start" or key in sections})
    read = Scenario(**fields)
    known = _sections(values | UNKNOWN | starting_stiffness(read.joint, read.load))
    return read.replace(**{key: known[key] for key in ("reference", "start") if key not in sections})


def _sections(values: Mapping[str, object]) -> dict[str, Any]:
    return dict(read_document(starting_text(values)).data)  # type: ignore[arg-type]  # a mapping
