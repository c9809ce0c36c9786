"""Consistency of a suite: problems of parts that depend on each other, each with its place in the file."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial

from jaxtyping import PyTree

from mckibben.config.document import Document, Place, dotted
from mckibben.control import Step
from mckibben.errors import McKibbenError, ParameterError, Problem, ScenarioError, suggest
from mckibben.study.compare.settings import NOMINAL_JOINT, SuiteSettings
from mckibben.study.parameters import SweptParameter, parse_sweeps

Check = tuple[Place, Callable[[], object]]
"""A place in the document, and a call that raises what is wrong there."""


def filename(name: str) -> str:
    """Return a name as part of a path.

    >>> filename("Sliding mode, 2")
    'sliding-mode-2'
    """
    return re.sub(r"[^A-Za-z0-9]+", "-", name).strip("-").lower() or "controller"


def problems_of_suite(suite: SuiteSettings, document: Document) -> list[Problem]:
    """Return the problems of interdependent parts, at their lines in the document."""
    problems: list[Problem] = []
    for checks in (_checks_of_names, _checks_of_settings, _checks_of_variation, _checks_of_runs):
        for place, call in checks(suite):
            line, field = document.line(place), dotted(place)
            try:
                call()
            except ScenarioError as error:  # of a scenario that the suite makes
                problems += [
                    replace(p, message=f"{p.field}: {p.message}", line=line, field=field) for p in error.problems
                ]
            except McKibbenError as error:
                problems.append(Problem.of(error, line, field))
        if problems:  # the other checks need parts that are valid
            break
    return problems


def _checks_of_names(suite: SuiteSettings) -> Iterator[Check]:
    for key in ("other_joints", "references", "controllers"):
        for name in getattr(suite, key):
            yield (key, name), partial(_check_name, suite, key, name)
    yield ("valve",), suite.example


def _checks_of_settings(suite: SuiteSettings) -> Iterator[Check]:
    yield ("conditions",), partial(check_differs, suite)
    yield ("tuning", "cost"), partial(_check_cost, suite)
    for i, text in enumerate(suite.conditions):
        yield (
            ("conditions", i),
            partial(_check_within, suite.plant_sections, partial(parse_sweeps, [text], suite.example())),
        )
    for name, case in suite.references.items():
        for i, text in enumerate(case.over):
            read = partial(parse_sweeps, [text], suite.example(name))
            yield ("references", name, "over", i), partial(_check_within, ("reference",), read)
    tuning = suite.tuning
    named: list[tuple[Place, str]] = [(("true_model", i), name) for i, name in enumerate(suite.true_model)]
    named += [(("tuning", "untuned", i), name) for i, name in enumerate(tuning.untuned)]
    named += [(("tuning", "over", name), name) for name in tuning.over]
    for place, name in named:
        yield place, partial(_check_known, suite, name)


def _checks_of_variation(suite: PyTree) -> Iterator[Check]:
    yield ("conditions",), suite.conditions_over
    for name in suite.references:
        yield ("references", name, "over"), partial(suite.reference_over, name)


def _checks_of_runs(suite: SuiteSettings) -> Iterator[Check]:
    for name in suite.other_joints:
        yield ("other_joints", name), partial(_check_joint, suite, name)
    for name in suite.controllers:
        place = ("tuning", "over", name) if name in suite.tuning.over else ("controllers", name)
        yield place, partial(_check_within, ("controller", "controllers"), partial(suite.tuned_over, name))


def _check_name(suite: SuiteSettings, key: str, name: str, longest: int = 80) -> None:
    """Check that a name is one line, and its file name unique."""
    if not name.strip() or len(name) > longest or not name.isprintable():
        raise ParameterError(f"a name is one line of 1 to {longest} characters", remedy="give another")
    if key == "other_joints" and name == NOMINAL_JOINT:
        raise ParameterError(f"{name!r} is the name of the suite's own joint", remedy="give another")
    same = next(other for other in getattr(suite, key) if filename(other) == filename(name))
    if same != name:
        raise ParameterError(f"would be kept in the same file as {same!r}", remedy="give it another name")


def check_differs(suite: SuiteSettings) -> None:
    """Raise `ParameterError` if all runs of a suite are identical."""
    several = len(suite.references) > 1 or any(case.over for case in suite.references.values())
    if not (several or suite.conditions or suite.has_noise or suite.other_joints):
        raise ParameterError("all runs are identical", remedy="give conditions, or `over` of a reference")


def _check_cost(suite: SuiteSettings) -> None:
    """Check that every run has a value of each metric."""
    steps = all(isinstance(case.reference.stiffness, Step) for case in suite.references.values())
    if "coupling" in suite.cost.metrics and not steps:
        remedy = "leave it out, or let all references step"
        raise ParameterError("coupling is defined for stiffness steps only", remedy=remedy)


def _check_joint(suite: PyTree, name: str) -> None:
    """Check that the conditions apply to the joint's plant as well."""
    parse_sweeps([text for text in suite.conditions if suite.has(name, text)], suite.example(joint=name))
    suite.example(joint=name).plant()


def _check_known(suite: SuiteSettings, name: str) -> None:
    if name not in suite.controllers:
        raise ParameterError(f"there is no controller {name!r}", remedy=suggest(name, list(suite.controllers)))


def _check_within(sections: tuple[str, ...], read: Callable[[], Sequence[SweptParameter]]) -> None:
    """Check that parameters are in sections of a scenario."""
    for swept in read():
        if swept.name.split(".")[0] not in sections:
            whole = sections[0] if sections[0] in ("controller", "reference") else "plant"
            raise ParameterError(
                f"{swept.name} is not a parameter of the {whole}",
                remedy=f"give a parameter of {', '.join(sections)}: conditions vary the plant, `over` the reference",
            )
