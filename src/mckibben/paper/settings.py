"""Settings that the paper does not print: amplitudes, frequencies, setpoints, gains, initial states.

All of these are ours. Table 2 as printed has a static range of about +-10 deg and a stiffness range of 4 % at 0 deg, so
each setting comes in two geometries.
"""

from __future__ import annotations

import enum
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from mckibben.scenario import Scenario, with_values


class StiffnessReference(enum.Enum):
    """Kind of desired stiffness in Figs. 7 and 8."""

    CONSTANT = "constant"
    STEP = "step"


@dataclass(frozen=True)
class Gains:
    """Moderate gains of the two PID loops, as text with units; base of both methods."""

    position: str
    stiffness: str


@dataclass(frozen=True)
class Setting:
    """A geometry with its references and gains, as text with units.

    Parameters
    ----------
    name, key
        Name in reports, and in files.
    connectors
        Length of the connectors, 190 mm in Table 2.
    amplitude
        Amplitude of the desired angle, a sine of 0.5 Hz.
    constant, before, after
        Desired stiffness: constant, or a step after 5 s.
    start
        Stiffness of the equilibrium at 0 deg in which runs start.
    moderate
        Gains set by hand, for PID and as the base of BP.
    angle_scale, stiffness_scale, rates
        Scales of the errors and outputs of BP; a tenth of the errors is the scale of the cost of tuning.
    """

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


def pid_scenario(
    setting: Setting, reference: StiffnessReference, gains: Mapping[str, float] | None = None, *, name: str = "PID"
) -> Scenario:
    """Scenario of a PID run with gains as of `gains_of`; default: moderate gains."""
    base = setting.moderate
    scenario = _scenario(setting, reference, name, f"{{{base.position}}}", f"{{{base.stiffness}}}")
    return _with_gains(scenario, gains)


def bp_scenario(
    setting: Setting,
    reference: StiffnessReference,
    gains: Mapping[str, float] | None = None,
    *,
    gain_ratio: float = FREE,
    name: str = "BP",
) -> Scenario:
    """Scenario of a BP run with the same base gains."""
    learning = f"{LEARNING}, gain_ratio: {gain_ratio}, seed: 0"
    position = (
        f"{{class: backprop, base: {{{setting.moderate.position}}}, {learning}, signal_scale: {setting.amplitude}, "
        f"error_scale: {setting.angle_scale}, output_scale: {setting.rates[0]}}}"
    )
    stiffness = (
        f"{{class: backprop, base: {{{setting.moderate.stiffness}}}, {learning}, signal_scale: {setting.constant}, "
        f"error_scale: {setting.stiffness_scale}, output_scale: {setting.rates[1]}}}"
    )
    return _with_gains(_scenario(setting, reference, name, position, stiffness), gains, ".base.")


def _with_gains(scenario: Scenario, gains: Mapping[str, float] | None, within: str = ".") -> Scenario:
    """Scenario with other gains; those of BP are fields `within` its loops."""
    named = {f"controller.{name.replace('.', within)}": gain for name, gain in (gains or {}).items()}
    return with_values(scenario, named) if named else scenario


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


def gains_of(scenario: Scenario) -> dict[str, float]:
    """Gains of a PID scenario in SI, by loop and gain, such as "position.kp"."""
    control: Any = scenario.control()
    return {
        f"{loop}.{gain}": float(getattr(getattr(control, loop), gain))
        for loop in ("position", "stiffness")
        for gain in ("kp", "ki", "kd")
    }
