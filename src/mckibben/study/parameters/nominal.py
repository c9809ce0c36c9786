"""What a number is that the file leaves to the catalog or to a default: looked up where it is built."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

from mckibben.study.scenario import PIDSpec, Scenario

_ATTRIBUTES = {
    "poles": "feedback",
    "sliding": "feedback",
    "velocity_observer": "observer",
    "disturbance_observer": "observer",
}
"""What parts of the file are called where they are built."""


def defaults_of(scenario: Scenario) -> Callable[[tuple[str, ...]], float | int | None]:
    """The values, in SI, of numbers that a scenario does not give, by all keys on the way to each.

    What has to be built to know them is built once. None for a starting stiffness: it is then amid what the plant can
    hold.
    """
    return functools.partial(_default, scenario, functools.cache(scenario.control))


def _default(scenario: Scenario, control: Callable[[], Any], place: tuple[str, ...]) -> float | int | None:
    from mckibben.study.scenario import building

    key = place[-1]
    if key == "strength":  # of a muscle: that of its law
        return 1.0
    match place[:-1]:
        case ("load",):
            return getattr(building.build_load(scenario.load), key)
        case ("joint", *_):
            return getattr(building.build_geometry(scenario.joint), key)
        case ("controller", "model", *_):
            model = scenario.controller.model or scenario.joint
            return getattr(building.build_geometry(model), key)
        case ("controller", "decoupling" | "predictive", *inner):
            owner = control()
            for name in inner:
                owner = getattr(owner, _ATTRIBUTES.get(name, name))
            return getattr(owner, key)
        case ("controller", "inverse_model", *inner):
            owner = control()
            for name in inner:
                owner = getattr(owner, name)
            return getattr(owner, key)
        case ("controller", name, _):
            loop = building.build_loop(getattr(scenario.controller, name))
            owner = getattr(loop, "base", loop) if key in PIDSpec.model_fields else loop
            return getattr(owner, key)
        case ("reference", name, _):
            return getattr(building.build_signal(getattr(scenario.signals, name), name), key)
        case _:
            return None
