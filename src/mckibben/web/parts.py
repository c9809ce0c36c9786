"""Parts of a plant that the page of runs offers: what each choice changes in a scenario, and which one it has."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping
from typing import NamedTuple

import equinox as eqx

from mckibben import catalog
from mckibben.component.schema import replaced
from mckibben.muscle import MaxwellSlip, NoFriction
from mckibben.scenario import Scenario
from mckibben.units import mm
from mckibben.web.workbench import START, with_section


class Choice(NamedTuple):
    """Options of a select, the scenario with one of them, and the option of a scenario; None if it has another part."""

    options: tuple[str, ...]
    choose: Callable[[Scenario, str], Scenario]
    chosen: Callable[[Scenario], str | None]


def _section(key: str, sections: Mapping[str, str]) -> Choice:
    """A section of a scenario, from its text."""

    @functools.cache
    def component(name: str) -> object:
        return getattr(Scenario.parse(with_section(START, sections[name], (key,))), key)

    def chosen(scenario: Scenario) -> str | None:
        now = getattr(scenario, key)
        alike = [name for name in sections if type(component(name)) is type(now)]
        equal = [name for name in alike if eqx.tree_equal(component(name), now)]
        return equal[0] if equal else alike[0] if len(alike) == 1 else None

    return Choice(tuple(sections), lambda scenario, name: scenario.replace(**{key: component(name)}), chosen)


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
    """Sections of valves; those of the catalog with a supply, and the settings that a maker leaves open."""
    left_open = {"SwitchingValves": ", period: 10 ms", "PressureRegulator": ", time_constant: 30 ms"}
    sections = {"ideal": "ideal", "first order": "{time_constant: 20 ms}"}
    for name in catalog.names("valves"):
        settings = left_open.get(catalog.valve_section(name)["class"], "")
        sections[name] = f"{{from: {name}, supply: 7 bar{settings}}}"
    return sections


CHOICES: Mapping[str, Choice] = {
    "friction of the muscles": _friction(),
    "load": _section(
        "load", {"shank and foot": "knee-table-2", "pendulum": "{class: pendulum, mass: 0.5 kg, length: 200 mm}"}
    ),
    "friction of the joint": _section(
        "friction", {"none": "none", "presliding": "{torque: 0.3 N*m, presliding: 0.5 deg}"}
    ),
    "valves": _section("valve", _valves()),
    "sensors": _section(
        "sensors", {"perfect": "perfect", "encoder and noise": "{encoder: 0.088 deg, pressure_noise: 2 kPa}"}
    ),
    "disturbance": _section(
        "disturbance", {"none": "none", "pulses": "{height: 0.5 N*m, width: 100 ms, interval: 1 s, start: 500 ms}"}
    ),
}
"""Choices by label."""
