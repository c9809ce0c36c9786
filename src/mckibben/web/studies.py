"""Tuning and comparison of controllers for the page Tune."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from mckibben.errors import ParameterError
from mckibben.scenario import Scenario
from mckibben.study.compare import Suite, compare
from mckibben.study.compare.suite import EvaluationSettings, TuningSettings
from mckibben.study.tune import parse_cost, parse_ranges, tune
from mckibben.study.tune.tune import COST
from mckibben.web.results import Presented
from mckibben.web.workbench import CONTROLLERS, chosen_kinds, parse, with_section

_TRAINING, _POPULATION = 16, 8
Progress = Callable[[str, float], None]


@dataclass
class TuningRequest:
    """Input of a tuning, as `mckibben tune` has it.

    Attributes
    ----------
    cost
        Sum of metrics, each divided by its scale.
    gain_margin
        Factor on the gains up to which the cost is covered [-].
    over
        One parameter and its range per line; all gains if empty.
    method, iterations, seed
        Search, its generations or steps, and its seed.
    disk_margin
        Least disk margin [-]; 0 for none.
    """

    cost: str = COST["cost"]
    gain_margin: float = COST["gain_margin"]
    over: str = ""
    method: str = "cma"
    iterations: int = 20
    seed: int = 0
    disk_margin: float = COST["disk_margin"]


@dataclass
class ComparisonRequest:
    """Input of a comparison.

    Attributes
    ----------
    controllers
        Kinds to compare with, keys of `CONTROLLERS`.
    conditions
        One parameter and its range per line. If empty, those of `Suite.of` vary: the strength of each muscle, and the
        masses of the load.
    runs, generations
        Unseen runs, and generations of each search.
    """

    controllers: tuple[str, ...] = ("two PID loops", "model inversion (decoupling)")
    conditions: str = ""
    runs: int = 64
    generations: int = 10


class Study(NamedTuple):
    """Result of a study.

    Attributes
    ----------
    presented
        What is shown.
    text
        The scenario that was studied.
    scenarios
        Scenarios that can be run, by name: the tuned one, or the best of each controller.
    """

    presented: Presented
    text: str
    scenarios: dict[str, Scenario]


def _lines(text: str) -> list[str]:
    return [line.strip() for line in text.splitlines() if line.strip()]


def tuned(text: str, request: TuningRequest, folder: Path, progress: Progress) -> Study:
    """Tune a scenario as `mckibben tune` does.

    Parameters
    ----------
    text, folder
        Scenario, and the folder of its files.
    request
        Input of the page.
    progress
        Called with step and part; whatever it raises ends the study.

    Raises
    ------
    McKibbenError
        For mistakes of text or request.
    """
    progress("compiling", 0.0)
    scenario = parse(text, folder)
    ranges = parse_ranges(_lines(request.over), scenario)
    result = tune(
        scenario,
        ranges,
        parse_cost(request.cost, gain_margin=request.gain_margin, disk_margin=request.disk_margin),
        method=request.method,
        iterations=request.iterations,
        population=_POPULATION,
        seed=request.seed,
        progress=progress,
    )
    progress("runs before and after", 1.0)
    return Study(Presented.of(result), text, {"tuned": result.scenarios[0]})


def compared(text: str, request: ComparisonRequest, folder: Path, progress: Progress) -> Study:
    """Compare the controller of a scenario with other kinds as `mckibben compare` does, on its joint and reference.

    Arguments are as for `tuned`. Raises `ParameterError` if there is no other kind.
    """
    progress("compiling", 0.0)
    scenario = parse(text, folder)
    own = chosen_kinds(scenario)["controller"]
    kinds = [name for name in request.controllers if name != own]
    if not kinds:
        raise ParameterError("there is no controller to compare with", remedy=f"choose one other than {own}")
    sections = [(name, with_section(text, CONTROLLERS[name], ("controller",))) for name in kinds]
    others = {name: parse(section, folder).controller for name, section in sections}
    tuning = TuningSettings(runs=_TRAINING, starts=1, generations=request.generations, population=_POPULATION, seed=99)
    evaluation = EvaluationSettings(runs=request.runs, seed=1)
    varied = {"conditions": conditions} if (conditions := tuple(_lines(request.conditions))) else {}
    suite = Suite.of(scenario, others, tuning=tuning, evaluation=evaluation, **varied)
    result = compare(suite, progress=progress)
    progress("statistics", 1.0)
    scenarios = {name: suite.tuned_scenario(name, result.tuned[name]) for name in suite.controllers}
    return Study(Presented.of(result), text, scenarios)
