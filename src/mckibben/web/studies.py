"""Tuning and comparison of controllers for the page Tune, within its budget."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mckibben.errors import ParameterError
from mckibben.report import benchmark_errors, tuning
from mckibben.result import Listing, Remark, Result
from mckibben.scenario import Scenario, list_parameters, with_values
from mckibben.study.compare import BenchmarkResult, Suite, compare
from mckibben.study.compare.statistics import FAILED, failed_runs, left_out_at_air, statistics
from mckibben.study.compare.suite import EvaluationSettings, TuningSettings
from mckibben.study.parameters import SweptParameter
from mckibben.study.tune import Method, TuningResult, parse_cost, parse_ranges, tune
from mckibben.study.tune.margin import DISK_MARGIN, UNSTABLE, lost_margin, metrics_and_margins
from mckibben.study.tune.tune import DEFAULT_COST, DEFAULT_MARGIN
from mckibben.web.results import Presented, text_listing
from mckibben.web.workbench import CONTROLLERS, chosen_kinds, parse, steps_of, with_section

MOST_STEPS = 5e9
"""Most integration steps of a study of the page."""
MOST_RUNS, MOST_GENERATIONS, MOST_STARTS, MOST_ITERATIONS, MOST_SEED = 512, 30, 8, 60, 2**31 - 1
_TRAINING, _POPULATION = 16, 8
_TITLES = {
    "angle_rmse_deg": "angle RMSE [°]",
    "stiffness_rmse": "stiffness RMSE [N·m/rad]",
    "coupling_deg": "coupling [°]",
    "air_L": "air [L]",
    "gain": "least gain margin",
    "phase_deg": "least phase margin [°]",
    "delay_ms": "least delay margin [ms]",
    "disk": "least disk margin",
}

_ERRORS = {
    "angle RMSE [°]": ("angle_rmse_deg", "median"),
    "95 %": ("angle_rmse_deg", "percentile_95"),
    "stiffness RMSE [N·m/rad]": ("stiffness_rmse", "median"),
    "95 % of it": ("stiffness_rmse", "percentile_95"),
    "air [L]": ("air_L", "median"),
}
"""Metric and statistic by column of a comparison."""

Progress = Callable[[str, float], None]

AUTOMATIC = "automatic"
"""The default method of `tune`."""


@dataclass
class TuningRequest:
    """Input of a tuning; `over` has one parameter and its range per line, all gains if empty.

    The disk margin is that of the first gains if empty.
    """

    cost: str = DEFAULT_COST
    gain_margin: float = DEFAULT_MARGIN
    over: str = ""
    method: str = AUTOMATIC
    starts: int = 2
    iterations: int = 20
    seed: int = 0
    disk_margin: str = ""


@dataclass
class ComparisonRequest:
    """Input of a comparison; `conditions` has one parameter and its range per line, at first those `suggested`."""

    controllers: tuple[str, ...] = ("two PID loops", "model inversion (decoupling)")
    conditions: str = ""
    runs: int = 64
    generations: int = 10
    suggested: str = ""

    def suggest(self, scenario: Scenario) -> None:
        """Replace the suggested conditions by those of a scenario: another mass or inertia of its load."""
        before, name = self.suggested, f"load.{scenario.load.adapted_mass or 'inertia'}"
        known = any(one.name == name for one in list_parameters(scenario))
        self.suggested = f"{name}=+-30 %" if known else ""
        if self.conditions == before:
            self.conditions = self.suggested


class Tuned(Result):
    """Tuning of a scenario, as the page shows it: gains and metrics before and after.

    `text` is that of the scenario before, `scenario` the tuned one.
    """

    text: str
    scenario: Scenario
    tuning: TuningResult
    over: Sequence[SweptParameter]
    metrics: tuple[dict[str, float], dict[str, float]]

    def verdict(self) -> str:
        """Change of the cost."""
        return f"Tuned: {self.tuning.change}, {len(self.tuning.trials)} points evaluated"

    def remarks(self) -> list[Remark]:
        """Faults of the tuned scenario, and the disk margin that was kept."""
        tuning, (old, new) = self.tuning, self.metrics
        kept = (
            f"the search kept a disk margin of at least {tuning.disk_margin:g} at four points of the run; the least "
            "margins below cover more points and frequencies and may be smaller"
        )
        texts = [*filter(None, [tuning.invalid_before]), *self.scenario.joint.remarks, *filter(None, [tuning.remark])]
        remarks = [Remark.warning("scenario", text) for text in texts]
        if tuning.at_bound:
            text = f"at a bound of the range: {', '.join(tuning.at_bound)}"
            remarks.append(Remark.warning("over", text, "consider a wider range"))
        if lost := lost_margin(old["disk"], new["disk"]):
            remedy = f"raise the gain margin, or give a disk margin, such as {DISK_MARGIN}"
            remarks.append(Remark.warning("disk_margin", lost, remedy))
        if new["disk"] == 0:
            remarks.append(Remark.severe("disk_margin", UNSTABLE))
        return [*remarks, Remark.note("disk_margin", kept if tuning.disk_margin else "the search kept no disk margin")]

    def listings(self) -> list[Listing]:
        """Parameters and metrics before and after."""
        old, new = self.metrics
        parameters = [
            (
                one.name,
                "-" if (nominal := one.parameter.nominal) is None else one.parameter.show(nominal),
                one.parameter.show(self.tuning.values[one.name]),
            )
            for one in self.over
        ]
        metrics = [(title, _number(old[name]), _number(new[name])) for name, title in _TITLES.items()]
        return [
            text_listing("", ("parameter", "before", "tuned"), parameters),
            text_listing("", ("metric", "before", "tuned"), metrics),
        ]


class Compared(Result):
    """Comparison of controllers, as the page shows it; `text` is that of the scenario, `titles` of its controllers."""

    text: str
    found: BenchmarkResult
    numbers: dict[str, Any]
    titles: dict[str, str]
    scenarios: dict[str, Scenario]

    def verdict(self) -> str:
        """How the controllers were compared."""
        return "Compared on the same unseen runs, each controller tuned with the same budget"

    def remarks(self) -> list[Remark]:
        """Gains at bounds, infeasible runs, and controllers without gains at equal air."""
        numbers = self.numbers
        texts = [
            f"{self.titles[name]}: at a bound of the range: {', '.join(controller['at_bound'])}"
            for name, controller in numbers["controllers"].items()
            if controller["at_bound"]
        ]
        if numbers["no_start"]:
            texts.append(f"{numbers['no_start']} runs were infeasible: no static equilibrium at their start")
        texts += filter(None, [left_out_at_air(numbers, self.titles)])
        joint = next(iter(self.scenarios.values())).joint
        return [Remark.warning("controllers", text) for text in (*texts, *joint.remarks)]

    def listings(self) -> list[Listing]:
        """Errors of the controllers, and those at no more air than the scenario's controller."""
        controllers = self.numbers["controllers"]
        tables = {"": {name: controllers[name] for name in self.numbers["order"]}}
        if at_air := self.numbers["at_air_of_first"]:
            title = "with gains that take no more air than the scenario's controller in the training runs"
            tables[title] = at_air["controllers"]
        return [
            text_listing(title, ("controller", *_ERRORS, FAILED), [self._row(*item) for item in errors.items()])
            for title, errors in tables.items()
        ]

    def _row(self, name: str, errors: dict[str, Any]) -> tuple[str, ...]:
        spreads = [(errors["metrics"][metric], statistic) for metric, statistic in _ERRORS.values()]
        cells = ("-" if spread is None else f"{spread[statistic]:.3g}" for spread, statistic in spreads)
        return self.titles[name], *cells, failed_runs(errors)


def _lines(text: str) -> list[str]:
    return [one.strip() for one in text.splitlines() if one.strip()]


def _check_budget(scenario: Scenario, runs: float) -> None:
    steps = runs * steps_of(scenario)
    if steps > MOST_STEPS:
        message = f"the study has {steps:.2g} integration steps, more than {MOST_STEPS:.2g}"
        remedy = "use fewer runs or a shorter duration, or use the command line"
        raise ParameterError(message, value=steps, upper=MOST_STEPS, remedy=remedy)


def tuned(text: str, request: TuningRequest, folder: Path, progress: Progress) -> Presented:
    """Tune a scenario as `mckibben tune` does."""
    progress("compiling", 0.0)
    scenario = parse(text, folder)
    ranges = parse_ranges(_lines(request.over), scenario)
    method = None if request.method == AUTOMATIC else Method(request.method)
    try:
        margin = float(request.disk_margin) if request.disk_margin.strip() else None
    except ValueError:
        message = f"disk margin: {request.disk_margin!r:.60} is not a number"
        raise ParameterError(message, field="disk_margin", remedy=f"give one such as {DISK_MARGIN}") from None
    runs = request.starts * (1 + len(ranges)) if method is Method.GRADIENT else _POPULATION
    _check_budget(scenario, 2 * request.iterations * runs)
    found = tune(
        scenario,
        ranges,
        parse_cost(request.cost, gain_margin=request.gain_margin, disk_margin=margin),
        method=method,
        starts=request.starts,
        iterations=request.iterations,
        population=_POPULATION,
        seed=request.seed,
        progress=progress,
    )
    progress("runs before and after", 1.0)
    (after,) = found.scenarios
    old, new = ({**metrics, **margins} for metrics, margins in map(metrics_and_margins, (scenario, after)))
    return Presented.of(Tuned(text, after, found, ranges, (old, new)), tuning(found))


def compared(text: str, request: ComparisonRequest, folder: Path, progress: Progress) -> Presented:
    """Compare the controller of a scenario with other kinds as `mckibben compare` does, on its joint and reference."""
    progress("compiling", 0.0)
    scenario = parse(text, folder)
    own = chosen_kinds(scenario)["controller"]
    kinds = [name for name in request.controllers if name != own]
    if not kinds:
        raise ParameterError("there is no controller to compare with", remedy=f"choose one other than {own}")
    sections = [(name, with_section(text, CONTROLLERS[name], ("controller",))) for name in kinds]
    others: dict[str, Any] = {name: parse(each, folder).controller for name, each in sections}
    suite = Suite.of(
        scenario,
        others,
        conditions=tuple(_lines(request.conditions)),
        tuning=TuningSettings(
            runs=_TRAINING, starts=1, generations=request.generations, population=_POPULATION, seed=99
        ),
        evaluation=EvaluationSettings(runs=request.runs, seed=1),
    )
    trials = 2 * request.generations * _POPULATION  # two searches: for the lowest cost, and at equal air
    _check_budget(scenario, len(suite.controllers) * (trials * _TRAINING + 2 * request.runs))
    found = compare(suite, progress=progress)
    progress("statistics", 1.0)
    numbers = statistics(found)
    titles = {name: name for name in suite.controllers} | {"scenario": own or "that of the scenario"}
    reference = next(iter(suite.references))
    scenarios = {
        title: with_values(suite.scenario(name, reference), found.tuned[name]) for name, title in titles.items()
    }
    return Presented.of(Compared(text, found, numbers, titles, scenarios), benchmark_errors(found))


def _number(value: float) -> str:
    return "-" if np.isnan(value) else f"{value:.3g}"
