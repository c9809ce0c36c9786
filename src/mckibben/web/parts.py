"""Parts of a scenario that the page of runs offers: what each choice changes, and which one a scenario has."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import equinox as eqx
import numpy as np

from mckibben import catalog
from mckibben.component.schema import replaced
from mckibben.control import Reference
from mckibben.muscle import MaxwellSlip, NoFriction
from mckibben.scenario import StudiedScenario
from mckibben.units import deg, mm
from mckibben.web.workbench import LEG, OFFERED, START, read_text, with_section


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
    choose: Callable[[StudiedScenario, str], StudiedScenario]
    chosen: Callable[[StudiedScenario], str | None]


def _section(key: str, sections: Mapping[str, str], within: str = START, **others: object) -> Choice:
    """Choice of a section of a scenario from its texts by label, read within a text; it sets other parts, too."""

    @functools.cache
    def component(name: str) -> object:
        return getattr(read_text(with_section(within, sections[name], (key,))), key)

    def chosen(scenario: StudiedScenario) -> str | None:
        now = getattr(scenario, key)
        alike = [name for name in sections if _kind(component(name)) == _kind(now)]
        equal = [name for name in alike if eqx.tree_equal(component(name), now)]
        return equal[0] if equal else alike[0] if len(alike) == 1 else None

    return Choice(tuple(sections), lambda scenario, name: scenario.replace(**{key: component(name)}, **others), chosen)


def _kind(component: object) -> tuple[object, ...]:
    """Class of a component and, of a controller, of its loops; whether it is a spring."""
    loops = (type(getattr(component, name, None)) for name in ("position", "feedback"))
    return type(component), *loops, getattr(component, "impedance", False)


def _signal(joint: str, name: str, unit: str, size: float) -> Choice:
    """Choice of a reference of a joint, "" of an unnamed one; its levels are about its present mean."""
    signals = OFFERED["signals"]

    def current(scenario: StudiedScenario) -> Reference:
        return scenario.references()[joint] if joint else scenario.references()

    def choose(scenario: StudiedScenario, kind: str) -> StudiedScenario:
        times, signal = np.linspace(0.0, scenario.timing["duration"], 200), getattr(current(scenario), name)
        mean = round(float(np.mean([signal(time) for time in times])) / size, 6)
        half = 0.1 * mean if name == "stiffness" else 3.0 if joint else 10.0
        step = half if name == "stiffness" else 0.8 * half
        levels = {"at": mean, "low": mean - step, "high": mean + step, "half": half}
        section = signals[kind].format(**{level: f"{value:.3g} {unit}" for level, value in levels.items()})
        reference_part = getattr(read_text(with_section(START, section, ("reference", name))).references(), name)
        reference = replaced(current(scenario), {name: reference_part})
        return scenario.replace(reference=scenario.references() | {joint: reference} if joint else reference)

    def chosen(scenario: StudiedScenario) -> str | None:
        kind = type(getattr(current(scenario), name)).__name__.lower()
        return kind if kind in signals else None

    return Choice(tuple(signals), choose, chosen)


def _friction() -> Choice:
    """Friction of both muscles."""
    options = {"none": NoFriction(), "Maxwell slip": MaxwellSlip(half_width=6.0, presliding_length=0.5 * mm)}

    def choose(scenario: Any, name: str) -> StudiedScenario:
        muscles = {
            key: replaced(getattr(scenario.joint, key), {"friction": options[name]}) for key in ("muscle1", "muscle2")
        }
        return scenario.replace(joint=replaced(scenario.joint, muscles))

    def chosen(scenario: Any) -> str | None:
        kinds = {type(muscle.friction) for muscle in (scenario.joint.muscle1, scenario.joint.muscle2)}
        return next((name for name, friction in options.items() if kinds == {type(friction)}), None)

    return Choice(tuple(options), choose, chosen)


def _valves() -> dict[str, str]:
    """Sections of the catalog's valves with a supply, and the settings that a maker leaves open."""
    left_open = {"SwitchingValves": ", period: 10 ms", "PressureRegulator": ", time_constant: 30 ms"}
    classes = {name: catalog.valve_section(name)["class"] for name in catalog.names("valves")}
    return {name: f"{{from: {name}, supply: 7 bar{left_open.get(kind, '')}}}" for name, kind in classes.items()}


_PID = START[START.index("  position") : START.index("reference")]
_CONTROLLERS = (
    _section("controller", {"two PID loops": _PID, **OFFERED["controllers"]}),
    _section("controller", OFFERED["controllers of all joints"], LEG, controllers={}),
)
"""Those of a joint, and of several."""
_PLANT: Mapping[str, tuple[str, Choice]] = {
    "friction of the muscles": ("joint", _friction()),
    "load": ("load", _section("load", OFFERED["load"])),
    "friction of the joint": ("friction", _section("friction", OFFERED["friction"])),
    "valves": ("valve", _section("valve", OFFERED["valve"] | _valves())),
    "sensors": ("sensors", _section("sensors", OFFERED["sensors"])),
    "disturbance": ("disturbance", _section("disturbance", OFFERED["disturbance"])),
}
"""Key of the part, and its choice, by label."""


def plant_choices(scenario: StudiedScenario) -> dict[str, Choice]:
    """Choices of the parts of the plant that a scenario has, by label."""
    fields = type(scenario).model_fields
    return {label: choice for label, (key, choice) in _PLANT.items() if key in fields}


def control_choices(scenario: StudiedScenario) -> dict[str, Choice]:
    """Choices of the controller, and of the references of each joint, by label; that of a point has none."""
    joints = scenario.joint_names
    choices = {"controller": _CONTROLLERS[bool(joints)]}
    if joints and scenario.references() is not getattr(scenario, "reference", None):
        return choices
    units = (("angle", "deg", deg), ("stiffness", "N*m/rad", 1.0))
    return choices | {
        f"{name} reference of {joint}".removesuffix(" of "): _signal(joint, name, unit, size)
        for joint in joints or ("",)
        for name, unit, size in units
    }
