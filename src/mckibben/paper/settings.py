"""Settings that the paper does not print: amplitudes, frequencies, setpoints, gains, initial states.

All of these are ours. Table 2 as printed has a static range of about +-10 deg and a stiffness range of 4 % at 0 deg, so
each setting comes in two geometries.
"""

from __future__ import annotations

import enum
import re
from dataclasses import dataclass
from typing import Any

from mckibben.scenario import Scenario


class StiffnessReference(enum.Enum):
    """Kind of desired stiffness in Figs. 7 and 8."""

    CONSTANT = "constant"
    STEP = "step"


@dataclass(frozen=True)
class Gains:
    """Gains of the two PID loops, as text with units; base of both methods."""

    position: str
    stiffness: str


@dataclass(frozen=True)
class Setting:
    """A geometry with its references and gains, as text with units."""

    name: str
    key: str
    connectors: str
    amplitude: str
    constant: str
    before: str
    after: str
    start: str
    moderate: Gains
    angle_scale: str
    stiffness_scale: str
    rates: tuple[str, str]


AS_PRINTED = Setting(
    name="as printed",
    key="as_printed",
    connectors="190 mm",
    amplitude="2 deg",
    constant="72.5 N*m/rad",
    before="72 N*m/rad",
    after="73 N*m/rad",
    start="71.5 N*m/rad",
    moderate=Gains(
        position="kp: 2 bar/rad, ki: 60 bar/(rad*s), kd: 0.4 bar*s/rad",
        stiffness="kp: -1.5 bar/(N*m/rad), ki: -100 bar*rad/(N*m*s), kd: 0 bar*s/(N*m/rad)",
    ),
    angle_scale="0.2 deg",
    stiffness_scale="0.5 N*m/rad",
    rates=("10 bar/s", "10 bar/s"),
)

PRE_CONTRACTED = Setting(
    name="pre-contracted",
    key="pre_contracted",
    connectors="208 mm",
    amplitude="10 deg",
    constant="15 N*m/rad",
    before="13 N*m/rad",
    after="17 N*m/rad",
    start="12 N*m/rad",
    moderate=Gains(
        position="kp: 2 bar/rad, ki: 60 bar/(rad*s), kd: 0.4 bar*s/rad",
        stiffness="kp: 0.08 bar/(N*m/rad), ki: 5 bar*rad/(N*m*s), kd: 0 bar*s/(N*m/rad)",
    ),
    angle_scale="1 deg",
    stiffness_scale="1 N*m/rad",
    rates=("10 bar/s", "1 bar/s"),
)

SETTINGS = (AS_PRINTED, PRE_CONTRACTED)

STEP_TIME = "5 s"
LEARNING = "learning_rate: 3 1/s, momentum: 0.5, hidden: 6"
FREE, BOUND = 2.0, 1.1
"""Factor by which BP may change the gains: moderate gains, and tuned gains close to the stability limit."""


def doubled(gains: Gains) -> Gains:
    """Twice the gains of the position loop."""
    return Gains(re.sub(r": (\S+)", lambda gain: f": {2 * float(gain[1]):g}", gains.position), gains.stiffness)


def pid_scenario(
    setting: Setting, reference: StiffnessReference, gains: Gains | None = None, *, name: str = "PID"
) -> Scenario:
    """Scenario of a PID run; default: moderate gains."""
    gains = gains or setting.moderate
    return _scenario(setting, reference, name, f"{{{gains.position}}}", f"{{{gains.stiffness}}}")


def bp_scenario(
    setting: Setting,
    reference: StiffnessReference,
    gains: Gains | None = None,
    *,
    gain_ratio: float = FREE,
    name: str = "BP",
) -> Scenario:
    """Scenario of a BP run with the same base gains."""
    gains = gains or setting.moderate
    learning = f"{LEARNING}, gain_ratio: {gain_ratio}, seed: 0"
    position = (
        f"{{class: backprop, base: {{{gains.position}}}, {learning}, signal_scale: {setting.amplitude}, "
        f"error_scale: {setting.angle_scale}, output_scale: {setting.rates[0]}}}"
    )
    stiffness = (
        f"{{class: backprop, base: {{{gains.stiffness}}}, {learning}, signal_scale: {setting.constant}, "
        f"error_scale: {setting.stiffness_scale}, output_scale: {setting.rates[1]}}}"
    )
    return _scenario(setting, reference, name, position, stiffness)


def _scenario(setting: Setting, reference: StiffnessReference, name: str, position: str, stiffness: str) -> Scenario:
    desired = (
        setting.constant
        if reference is StiffnessReference.CONSTANT
        else f"{{class: step, before: {setting.before}, after: {setting.after}, at: {STEP_TIME}}}"
    )
    return Scenario.parse(
        f"""
name: {setting.name} knee, {reference.value} stiffness, {name}
joint:
  geometry: {{from: knee-table-2, connector_length: {setting.connectors}}}
  muscle: {{specimen: MAS-10-180N-AA-MC-O, law: lei-mas-10-180n}}
load: knee-table-2
valve: {{time_constant: 20 ms}}
controller:
  position: {position}
  stiffness: {stiffness}
reference:
  angle: {{class: sine, amplitude: {setting.amplitude}, frequency: 0.5 Hz}}
  stiffness: {desired}
start: {{angle: 0 deg, stiffness: {setting.start}}}
duration: 10 s
control_period: 1 ms
substeps: 4
""",
        source="settings of the paper's simulations",
    )


def gains_of(scenario: Scenario) -> Gains:
    """Gains of a PID scenario, as text that parses back to the last bit."""
    control: Any = scenario.control()
    position, stiffness = control.position, control.stiffness

    def text(loop: Any, *units: str) -> str:
        gains = zip(("kp", "ki", "kd"), units, strict=True)
        return ", ".join(f"{name}: {float(getattr(loop, name))!r} {unit}" for name, unit in gains)

    return Gains(
        position=text(position, "Pa/rad", "Pa/(rad*s)", "Pa*s/rad"),
        stiffness=text(stiffness, "Pa/(N*m/rad)", "Pa*rad/(N*m*s)", "Pa*s/(N*m/rad)"),
    )
