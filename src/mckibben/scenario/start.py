"""A scenario to start from, that of `mckibben new joint`, with stiffnesses that its joint can have."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from mckibben.codegen.templates import filled
from mckibben.config.document import read_document
from mckibben.errors import RangeError
from mckibben.joint import AntagonisticJoint, Load
from mckibben.scenario.scenario import Scenario
from mckibben.units import deg

_ANGLES = np.array([-10.0, 0.0, 10.0]) * deg  # of the sine in the template
UNKNOWN = {"low": "1 N*m/rad", "high": "1 N*m/rad", "valve": "ideal", "rough": "false", "uncertainty": "[]"}
"""Values of a text from which a joint is read first."""


def starting_text(values: Mapping[str, object]) -> str:
    """Return the text of a commented scenario; `values` are those of the template's marks."""
    return filled("joint.yaml", values, "mckibben.scenario")


def starting_stiffness(joint: AntagonisticJoint, load: Load) -> dict[str, str]:
    """Return two stiffnesses, `low` and `high`, that a joint has with a load at both ends of the motion and in between.

    Raises `RangeError` if there are none.
    """
    lowest, highest = joint.attainable_stiffness(_ANGLES, -load.gravity_torque(_ANGLES))
    low, high = float(np.max(lowest)), float(np.min(highest))
    if not low < high:
        text = "the muscles cannot hold the load at -10, 0 and 10 deg with any choice of the stiffness"
        remedy = "take stronger muscles, larger moment arms or a smaller load, or see `mckibben size`"
        raise RangeError(text, field="muscle", remedy=remedy)
    return {name: f"{low + part * (high - low):.3g} N*m/rad" for name, part in (("low", 0.4), ("high", 0.6))}


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
    texts += [f"joint.muscle{number}.strength=+-10 %" for number in (1, 2)]
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
