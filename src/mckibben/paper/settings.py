"""Settings that the paper does not print: amplitudes, frequencies, setpoints, gains, initial states.

All of these are ours. Table 2 as printed has a static range of about +-10 deg and a stiffness range of 4 % at 0 deg, so
each setting comes in two geometries.
"""

from __future__ import annotations

import enum
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import resources
from typing import Any

from mckibben.scenario import Scenario, with_values


class StiffnessReference(enum.Enum):
    """Kind of desired stiffness in Figs. 7 and 8."""

    CONSTANT = "constant"
    STEP = "step"


@dataclass(frozen=True)
class Setting:
    """A geometry with its references and gains, as text with units, from settings.toml.

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
        Gains of the position and the stiffness loop, set by hand, for PID and as the base of BP.
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
    moderate: dict[str, str]
    angle_scale: str
    stiffness_scale: str
    rates: list[str]


def _text(name: str) -> str:
    return (resources.files("mckibben.paper") / name).read_text(encoding="utf-8")


SETTINGS = tuple(Setting(key=key, **table) for key, table in tomllib.loads(_text("settings.toml")).items())
AS_PRINTED, PRE_CONTRACTED = SETTINGS

STEP_TIME = "5 s"
LEARNING = "learning_rate: 3 1/s, momentum: 0.5, hidden: 6"
FREE, BOUND = 2.0, 1.1
"""Factor by which BP may change the gains: moderate gains, and tuned gains close to the stability limit."""


def pid_scenario(
    setting: Setting, reference: StiffnessReference, gains: Mapping[str, float] | None = None, *, name: str = "PID"
) -> Scenario:
    """Scenario of a PID run.

    Parameters
    ----------
    setting, reference
        Geometry, and kind of the desired stiffness.
    gains
        Gains in SI as of `gains_of`. Default: the moderate ones of the setting.
    name
        Controller in the name of the scenario.
    """
    return _with_gains(_scenario(setting, reference, name, **setting.moderate), gains)


def bp_scenario(
    setting: Setting,
    reference: StiffnessReference,
    gains: Mapping[str, float] | None = None,
    *,
    gain_ratio: float = FREE,
    name: str = "BP",
) -> Scenario:
    """Scenario of a BP run.

    Parameters
    ----------
    setting, reference, gains, name
        As for `pid_scenario`; the gains are the base of BP.
    gain_ratio
        Factor by which BP may change them.
    """
    learning = f"{LEARNING}, gain_ratio: {gain_ratio}, seed: 0"
    scales = (setting.amplitude, setting.angle_scale), (setting.constant, setting.stiffness_scale)
    loops = {
        loop: f"class: backprop, base: {{{base}}}, {learning}, signal_scale: {signal}, error_scale: {error}, "
        f"output_scale: {rate}"
        for (loop, base), (signal, error), rate in zip(setting.moderate.items(), scales, setting.rates, strict=True)
    }
    return _with_gains(_scenario(setting, reference, name, **loops), gains, ".base.")


def _with_gains(scenario: Scenario, gains: Mapping[str, float] | None, within: str = ".") -> Scenario:
    """Scenario with other gains; those of BP are fields `within` its loops."""
    named = {f"controller.{name.replace('.', within)}": gain for name, gain in (gains or {}).items()}
    return with_values(scenario, named) if named else scenario


def _scenario(setting: Setting, reference: StiffnessReference, name: str, position: str, stiffness: str) -> Scenario:
    """Scenario of `knee.yaml` with the sections of both loops."""
    desired = f"{{class: step, before: {setting.before}, after: {setting.after}, at: {STEP_TIME}}}"
    if reference is StiffnessReference.CONSTANT:
        desired = setting.constant
    values = {"reference": reference.value, "name": name, "position": position, "stiffness": stiffness}
    text = _text("knee.yaml").format(setting=setting, desired=desired, **values)
    return Scenario.parse(text, source="settings of the paper's simulations")


def gains_of(scenario: Scenario) -> dict[str, float]:
    """Gains of a PID scenario in SI, by loop and gain.

    >>> gains_of(pid_scenario(PRE_CONTRACTED, StiffnessReference.STEP))["position.kp"]
    200000.0
    """
    control: Any = scenario.control()
    return {
        f"{loop}.{gain}": float(getattr(getattr(control, loop), gain))
        for loop in ("position", "stiffness")
        for gain in ("kp", "ki", "kd")
    }
