"""Consistency of a suite: problems of parts that depend on each other, each with its place in the file."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

from mckibben.config.document import Document, dotted
from mckibben.control import Step
from mckibben.errors import McKibbenError, ParameterError, Problem, ScenarioError, suggest
from mckibben.study.parameters import SweptParameter, parse_sweeps

if TYPE_CHECKING:
    from mckibben.study.compare.suite import Suite

_OF_PLANT = ("joint", "load", "valve", "sensors", "disturbance", "friction", "command_delay")
_LONGEST_NAME = 80


def filename(name: str) -> str:
    """A name as part of a path: "Sliding mode, 2" becomes "sliding-mode-2"."""
    return re.sub(r"[^A-Za-z0-9]+", "-", name).strip("-").lower() or "controller"


Place = tuple[str | int, ...]
Check = tuple[Place, Callable[[], object]]
"""A place in the document, and a call that raises what is wrong there."""


def problems_of_suite(suite: Suite, document: Document, nominal: str) -> list[Problem]:
    """Return the problems of interdependent parts; `nominal` is the name of the suite's own joint."""
    problems: list[Problem] = []
    for checks in (
        _checks_of_names,
        _checks_of_settings,
        _checks_of_variation,
        _checks_of_runs,
    ):  # each needs the ones before
        for place, call in checks(suite, nominal):
            problems += _problems_at(place, document, call)
        if problems:
            break
    return problems


def _checks_of_names(suite: Suite, nominal: str) -> Iterator[Check]:
    for key, reserved in (("other_joints", nominal), ("references", ""), ("controllers", "")):
        for name in getattr(suite, key):
            yield (key, name), partial(_check_name, name, reserved)
    for name in suite.controllers:
        yield ("controllers", name), partial(_check_controller, suite, name)
    yield ("valve",), suite.example


def _checks_of_settings(suite: Suite, nominal: str) -> Iterator[Check]:
    yield ("conditions",), partial(check_differs, suite)
    yield ("tuning", "cost"), partial(_check_cost, suite)
    for i, text in enumerate(suite.conditions):
        yield ("conditions", i), partial(_check_within, _OF_PLANT, partial(parse_sweeps, [text], suite.example()))
    for name, case in suite.references.items():
        for i, text in enumerate(case.over):
            read = partial(parse_sweeps, [text], suite.example(name))
            yield ("references", name, "over", i), partial(_check_within, ("reference",), read)
    for i, name in enumerate(suite.true_model):
        yield ("true_model", i), partial(_check_known, suite, name)
    for i, name in enumerate(suite.tuning.untuned):
        yield ("tuning", "untuned", i), partial(_check_known, suite, name)
    for name in (*suite.tuning.over, *suite.tuning.starts_of):
        key = "over" if name in suite.tuning.over else "starts_of"
        yield ("tuning", key, name), partial(_check_known, suite, name)


def _checks_of_variation(suite: Suite, nominal: str) -> Iterator[Check]:
    yield ("conditions",), suite.conditions_over
    for name in suite.references:
        yield ("references", name, "over"), partial(suite.reference_over, name)


def _checks_of_runs(suite: Suite, nominal: str) -> Iterator[Check]:
    for name in suite.other_joints:
        yield ("other_joints", name), partial(_check_joint, suite, name)
    for name in suite.controllers:
        place = ("tuning", "over", name) if name in suite.tuning.over else ("controllers", name)
        yield place, partial(_check_within, ("controller",), partial(suite.tuned_over, name))


def problems_of_setup(suite: Suite, name: str, document: Document) -> list[Problem]:
    """Problems of the suite of a setup alone."""
    own = suite.of_setup(name)

    def check() -> None:
        _check_name(name, "")
        parse_sweeps(own.conditions, own.example())
        for controller in own.controllers:
            own.tuned_over(controller)

    return _problems_at(("setups", name), document, check)


def _problems_at(place: tuple[str | int, ...], document: Document, call: Callable[[], object]) -> list[Problem]:
    """The problems at a place of a document that a call raises, if any."""
    try:
        call()
    except ScenarioError as error:  # of a scenario that the suite makes
        return [
            replace(
                problem, message=f"{problem.field}: {problem.message}", line=document.line(place), field=dotted(place)
            )
            for problem in error.problems
        ]
    except McKibbenError as error:
        return [Problem.of(error, document.line(place), dotted(place))]
    return []


def _check_name(name: str, reserved: str) -> None:
    if not name.strip() or len(name) > _LONGEST_NAME or not name.isprintable():
        raise ParameterError(f"a name is one line of 1 to {_LONGEST_NAME} characters", remedy="give another")
    if name == reserved:
        raise ParameterError(f"{name!r} is the name of the suite's own joint", remedy="give another")


def _check_controller(suite: Suite, name: str) -> None:
    """Check that its file name is unique."""
    same = next(other for other in suite.controllers if filename(other) == filename(name))
    if same != name:
        raise ParameterError(f"would be kept in the same file as {same!r}", remedy="give it another name")


def check_differs(suite: Suite) -> None:
    """Raise `ParameterError` if all runs of a suite are identical."""
    first, *others = suite.references.values()
    if not (others or first.over or suite.conditions or suite.has_noise or suite.other_joints):
        raise ParameterError("all runs are identical", remedy="give conditions, or `over` of a reference")


def _check_cost(suite: Suite) -> None:
    """Check that every run has a value of each metric."""
    steps = all(isinstance(case.reference.stiffness, Step) for case in suite.references.values())
    if "coupling" in suite.cost.metrics and not steps:
        raise ParameterError(
            "coupling is defined for stiffness steps only", remedy="leave it out, or let all references step"
        )


def _check_joint(suite: Suite, name: str) -> None:
    """Check that the conditions apply to the joint's plant as well."""
    parse_sweeps([text for text in suite.conditions if suite.has(name, text)], suite.example(joint=name))
    suite.example(joint=name).plant()


def _check_known(suite: Suite, name: str) -> None:
    if name not in suite.controllers:
        raise ParameterError(f"there is no controller {name!r}", remedy=suggest(name, list(suite.controllers)))


def _check_within(sections: tuple[str, ...], read: Callable[[], Sequence[SweptParameter]]) -> None:
    """Check that parameters are in sections of a scenario."""
    for swept in read():
        if swept.name.split(".")[0] not in sections:
            whole = {"reference": "the reference", "controller": "the controller"}.get(sections[0], "the plant")
            raise ParameterError(
                f"{swept.name} is not a parameter of {whole}",
                remedy=f"give a parameter of {', '.join(sections)}: conditions vary the plant, `over` the reference",
            )
