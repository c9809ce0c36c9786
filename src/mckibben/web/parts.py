"""Parts of a scenario that the page of runs offers: what each choice changes, and which one a scenario has."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping
from typing import NamedTuple

import equinox as eqx
import numpy as np

from mckibben import catalog
from mckibben.component.schema import replaced
from mckibben.muscle import MaxwellSlip, NoFriction
from mckibben.scenario import Scenario
from mckibben.units import mm
from mckibben.web.workbench import OFFERED, START, with_section


class Choice(NamedTuple):
    """Select of a part of a scenario.

    Attributes
    ----------
    options
        Its labels.
    choose
        The scenario with the part of a label.
    chosen
        Label of a scenario's part; None if the page does not offer it.
    """

    options: tuple[str, ...]
    choose: Callable[[Scenario, str], Scenario]
    chosen: Callable[[Scenario], str | None]


def _section(key: str, sections: Mapping[str, str]) -> Choice:
    """Choice of a section of a scenario, by its key, from its texts by label."""

    @functools.cache
    def component(name: str) -> object:
        return getattr(Scenario.parse(with_section(START, sections[name], (key,))), key)

    def chosen(scenario: Scenario) -> str | None:
        now = getattr(scenario, key)
        alike = [name for name in sections if _kind(component(name)) == _kind(now)]
        equal = [name for name in alike if eqx.tree_equal(component(name), now)]
        return equal[0] if equal else alike[0] if len(alike) == 1 else None

    return Choice(tuple(sections), lambda scenario, name: scenario.replace(**{key: component(name)}), chosen)


def _kind(component: object) -> tuple[type, type]:
    """Class of a component and, of a controller, of its loop of the angle."""
    return type(component), type(getattr(component, "position", None))


def _signal(name: str, unit: str) -> Choice:
    """Choice of a reference; levels of the angle are fixed, those of the stiffness about its present mean."""
    signals = OFFERED["signals"]

    def choose(scenario: Scenario, kind: str) -> Scenario:
        times = np.linspace(0.0, scenario.duration, 200)
        mean = 0.0 if name == "angle" else float(np.mean([scenario.signals.stiffness(time) for time in times]))
        spans = {"at": 0.0, "low": -8.0, "high": 8.0, "half": 10.0}
        if name == "stiffness":
            spans = {"at": mean, "low": 0.9 * mean, "high": 1.1 * mean, "half": 0.1 * mean}
        section = signals[kind].format(**{level: f"{value:.3g} {unit}" for level, value in spans.items()})
        signal = getattr(Scenario.parse(with_section(START, section, ("reference", name))).signals, name)
        return scenario.replace(reference=replaced(scenario.signals, {name: signal}))

    def chosen(scenario: Scenario) -> str | None:
        kind = type(getattr(scenario.signals, name)).__name__.lower()
        return kind if kind in signals else None

    return Choice(tuple(signals), choose, chosen)


def _friction() -> Choice:
    """Friction of both muscles."""
    options = {"none": NoFriction(), "Maxwell slip": MaxwellSlip(half_width=6.0, presliding_length=0.5 * mm)}

    def choose(scenario: Scenario, name: str) -> Scenario:
        muscles = {
            key: replaced(getattr(scenario.joint, key), {"friction": options[name]}) for key in ("muscle1", "muscle2")
        }
        return scenario.replace(joint=replaced(scenario.joint, muscles))

    def chosen(scenario: Scenario) -> str | None:
        kinds = {type(muscle.friction) for muscle in (scenario.joint.muscle1, scenario.joint.muscle2)}
        return next((name for name, friction in options.items() if kinds == {type(friction)}), None)

    return Choice(tuple(options), choose, chosen)


def _valves() -> dict[str, str]:
    """Sections of the catalog's valves with a supply, and the settings that a maker leaves open."""
    left_open = {"SwitchingValves": ", period: 10 ms", "PressureRegulator": ", time_constant: 30 ms"}
    classes = {name: catalog.valve_section(name)["class"] for name in catalog.names("valves")}
    return {name: f"{{from: {name}, supply: 7 bar{left_open.get(kind, '')}}}" for name, kind in classes.items()}


_PID = START[START.index("  position") : START.index("reference")]
CHOICES: Mapping[str, Choice] = {
    "controller": _section("controller", {"two PID loops": _PID, **OFFERED["controllers"]}),
    "angle reference": _signal("angle", "deg"),
    "stiffness reference": _signal("stiffness", "N*m/rad"),
    "friction of the muscles": _friction(),
    "load": _section("load", OFFERED["load"]),
    "friction of the joint": _section("friction", OFFERED["friction"]),
    "valves": _section("valve", OFFERED["valve"] | _valves()),
    "sensors": _section("sensors", OFFERED["sensors"]),
    "disturbance": _section("disturbance", OFFERED["disturbance"]),
}
"""Choices by label; the first three are those of the controller, the others of the plant."""
