"""What is wrong with a suite whose parts are all right by themselves."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import jax

from mckibben.errors import McKibbenError, ParameterError, Problem
from mckibben.study.parameters import Over, read_over, read_overs
from mckibben.study.scenario import Scenario
from mckibben.study.scenario.document import Document, dotted
from mckibben.study.scenario.part import suggest
from mckibben.study.scenario.reference import SignalSpec

if TYPE_CHECKING:
    from mckibben.study.comparison.suite import Suite

_OF_PLANT = ("joint", "load", "valve", "sensors", "disturbance")
_LONGEST_NAME = 80


def filename(name: str) -> str:
    """A name as part of a path.

    >>> filename("Sliding mode, 2")
    'sliding-mode-2'
    """
    return re.sub(r"[^A-Za-z0-9]+", "-", name).strip("-").lower() or "controller"


def problems_of_suite(suite: Suite, document: Document, believed: str) -> list[Problem]:
    """What is wrong with parts that have to do with one another.

    Parameters
    ----------
    suite, document
        The suite, and the document that it was read from.
    believed
        The name of its own joint, which no other may have.
    """
    found: list[Problem] = []

    def look(place: tuple[str | int, ...], check: Callable[[], object]) -> None:
        try:
            check()
        except McKibbenError as error:
            found.append(Problem(str(error), document.line(place), dotted(place)))

    for key, reserved in (("other_joints", believed), ("wishes", ""), ("controllers", "")):
        for name in getattr(suite, key):
            look((key, name), lambda name=name, reserved=reserved: _check_name(name, reserved))
    for name in suite.controllers:
        look(("controllers", name), lambda name=name: _check_controller(suite, name))
    if found:  # no scenario can be made of it
        return found
    look(("conditions",), lambda: _check_differs(suite))
    look(("tuning", "cost"), lambda: _check_cost(suite))
    for i, text in enumerate(suite.conditions):
        look(("conditions", i), lambda text=text: _about_plant(read_over(text, suite.example())))
    if not found:
        look(("conditions",), suite.conditions_over)
    for name, wish in suite.wishes.items():
        for key in ("angle", "stiffness"):
            place = ("wishes", name, "reference", key)
            look(place, lambda key=key, wish=wish: _plain(getattr(wish.reference, key)))
        before = len(found)
        for i, text in enumerate(wish.over):
            look(("wishes", name, "over", i), lambda name=name, text=text: _about_wish(text, suite.example(name)))
        if len(found) == before:
            look(("wishes", name, "over"), lambda name=name: suite.wish_over(name))
    for key, names in (("over", list(suite.tuning.over)), ("untuned", suite.tuning.untuned)):
        for i, name in enumerate(names):
            place = ("tuning", key, name if key == "over" else i)
            look(place, lambda name=name: _check_known(suite, name))
    if not found:
        for name in suite.other_joints:
            look(("other_joints", name), lambda name=name: _check_joint(suite, name))
        for name in suite.controllers:
            place = ("tuning", "over", name) if name in suite.tuning.over else ("controllers", name)
            look(place, lambda name=name: _about_controller(suite.tuned_over(name)))
    return found


def _check_name(name: str, reserved: str) -> None:
    if not name.strip() or len(name) > _LONGEST_NAME or not name.isprintable():
        raise ParameterError(f"a name is one line of 1 to {_LONGEST_NAME} characters", remedy="give another")
    if name == reserved:
        raise ParameterError(f"{name!r} is the name of the suite's own joint", remedy="give another")


def _check_controller(suite: Suite, name: str) -> None:
    """Its model has the friction that it is to make up for, and what is kept of it has a file of its own."""
    spec = suite.controllers[name]
    if spec.friction_compensation and not (spec.model or suite.joint).has_friction:
        raise ParameterError(
            "has friction_compensation, but no muscle of its model has friction",
            remedy="give the muscles of the model `friction`, or leave the compensation out",
        )
    same = next(other for other in suite.controllers if filename(other) == filename(name))
    if same != name:
        raise ParameterError(f"would be kept in the same file as {same!r}", remedy="give it another name")


def _check_differs(suite: Suite) -> None:
    wish, *others = suite.wishes.values()
    if not (others or wish.over or suite.conditions or suite.sensors or suite.other_joints):
        raise ParameterError("nothing differs from run to run", remedy="give conditions, or a wish `over` something")


def _check_cost(suite: Suite) -> None:
    """A metric that a run has no number for would make it a lost one."""
    steps = all(wish.reference.stiffness.step is not None for wish in suite.wishes.values())
    if "coupling" in suite.cost.metrics and not steps:
        raise ParameterError("coupling is of steps of the stiffness", remedy="leave it out, or let all wishes step")


def _check_joint(suite: Suite, name: str) -> None:
    """Runs of all joints are computed together: the same conditions, specimens and kinds of law."""
    scenario, believed = suite.example(joint=name), suite.example()
    read_overs(suite.conditions, scenario)
    if jax.tree.structure(scenario.plant()) != jax.tree.structure(believed.plant()):
        raise ParameterError(
            "differs from the suite's own joint in more than numbers",
            remedy="give both the same specimens, kinds of law and parts",
        )


def _check_known(suite: Suite, name: str) -> None:
    if name not in suite.controllers:
        raise ParameterError(f"there is no controller {name!r}", remedy=suggest(name, list(suite.controllers)))


def _about_plant(one: Over) -> None:
    if one.name.split(".")[0] not in _OF_PLANT:
        raise ParameterError(
            f"{one.name} is nothing of the plant", remedy=f"a condition is a number of {', '.join(_OF_PLANT)}"
        )


def _about_wish(text: str, scenario: Scenario) -> None:
    one = read_over(text, scenario)
    if not one.name.startswith("reference."):
        raise ParameterError(f"{one.name} is nothing of the wish", remedy="put it among the conditions")


def _about_controller(over: tuple[Over, ...]) -> None:
    for one in over:
        if not one.name.startswith("controller."):
            raise ParameterError(
                f"{one.name} is nothing of the controller", remedy="tune numbers that begin with `controller.`"
            )


def _plain(signal: SignalSpec[Any]) -> None:
    if signal.samples is not None:
        raise ParameterError("samples cannot be compared on", remedy="give a constant, step, sine or multisine")
