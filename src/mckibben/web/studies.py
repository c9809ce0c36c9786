"""Tuning and comparison of controllers for the page Tune, within its budget."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mckibben.errors import ParameterError
from mckibben.scenario import Scenario, list_parameters, with_values
from mckibben.study.compare import Suite, compare
from mckibben.study.compare.result import FAILED, failed_runs, left_out_at_air
from mckibben.study.compare.suite import EvaluationSettings, TuningSettings
from mckibben.study.tune import Method, parse_cost, parse_ranges, tune
from mckibben.study.tune.margin import DISK_MARGIN
from mckibben.study.tune.objective import UNSTABLE_COST
from mckibben.study.tune.tune import DEFAULT_COST, DEFAULT_MARGIN
from mckibben.web.workbench import CONTROLLERS, chosen_kinds, parse, steps_of, with_section

MOST_STEPS = 5e9
"""Most integration steps of a study of the page."""
MOST_RUNS, MOST_GENERATIONS, MOST_ITERATIONS, MOST_SEED = 512, 30, 60, 2**31 - 1
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


@dataclass(frozen=True)
class Tuned:
    """Result of a tuning: parameters, metrics before and after, costs of the trials, scenario, and the kept margin.

    `text` is that of the scenario before.
    """

    text: str
    cost_before: float
    cost: float
    change: str
    costs: np.ndarray
    parameters: list[tuple[str, str, str]]
    metrics: list[tuple[str, str, str]]
    scenario: Scenario
    disk_margin: float
    remarks: list[str]


@dataclass(frozen=True)
class Compared:
    """Result of a comparison: table, that at no more air than the scenario's controller, errors, tuned scenarios.

    The errors are median and 95th percentile of the angle error [deg]; `text` is that of the scenario.
    """

    text: str
    headers: tuple[str, ...]
    rows: list[tuple[str, ...]]
    at_equal_air: list[tuple[str, ...]]
    errors: dict[str, tuple[float, float]]
    scenarios: dict[str, Scenario]
    remarks: list[str]


def _lines(text: str) -> list[str]:
    return [one.strip() for one in text.splitlines() if one.strip()]


def _check_budget(scenario: Scenario, runs: float) -> None:
    steps = runs * steps_of(scenario)
    if steps > MOST_STEPS:
        message = f"the study has {steps:.2g} integration steps, more than {MOST_STEPS:.2g}"
        remedy = "use fewer runs or a shorter duration, or use the command line"
        raise ParameterError(message, value=steps, upper=MOST_STEPS, remedy=remedy)


def tuned(text: str, request: TuningRequest, folder: Path, progress: Progress) -> Tuned:
    """Tune a scenario as `mckibben tune` does."""
    progress("compiling", 0.0)
    scenario = parse(text, folder)
    ranges = parse_ranges(_lines(request.over), scenario)
    method = Method.CMA if request.method == AUTOMATIC else Method(request.method)
    try:
        margin = float(request.disk_margin) if request.disk_margin.strip() else None
    except ValueError:
        message = f"disk margin: {request.disk_margin!r:.60} is not a number"
        raise ParameterError(message, field="disk_margin", remedy=f"give one such as {DISK_MARGIN}") from None
    runs = 2 if method is Method.LOCAL else _POPULATION
    _check_budget(scenario, 2 * request.iterations * runs)
    found = tune(
        scenario,
        ranges,
        parse_cost(request.cost, gain_margin=request.gain_margin, disk_margin=margin),
        method=method,
        iterations=request.iterations,
        population=_POPULATION,
        seed=request.seed,
        progress=progress,
    )
    progress("runs before and after", 1.0)
    (after,), ((old, new),) = found.scenarios, found.effects
    parameters = [
        (
            each.name,
            "-" if (nominal := each.parameter.nominal) is None else each.parameter.show(nominal),
            each.parameter.show(found.values[each.name]),
        )
        for each in ranges
    ]
    metrics = [(title, _number(old[name]), _number(new[name])) for name, title in _TITLES.items()]
    costs = np.array([trial.cost for trial in found.trials])
    remarks = [f"{remark.text}; {remark.remedy}" if remark.remedy else remark.text for remark in found.remarks()]
    return Tuned(
        text,
        found.cost_before,
        found.cost,
        found.verdict(),
        costs,
        parameters,
        metrics,
        after,
        found.disk_margin,
        remarks,
    )


def compared(text: str, request: ComparisonRequest, folder: Path, progress: Progress) -> Compared:
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
    numbers = found.numbers
    headers = ("controller", "angle RMSE [°]", "95 %", "stiffness RMSE [N·m/rad]", "95 %", "air [L]", FAILED)
    spreads = [(name, what) for name in ("angle_rmse_deg", "stiffness_rmse") for what in ("median", "percentile_95")]
    shown = {name: name for name in suite.controllers} | {"scenario": own or "that of the scenario"}

    def row(name: str, each: dict[str, Any]) -> tuple[str, ...]:
        return shown[name], *(_cell(each, *one) for one in (*spreads, ("air_L", "median"))), failed_runs(each)

    rows, errors = [], {}
    for name in numbers["order"]:
        each = numbers["controllers"][name]
        rows.append(row(name, each))
        if (spread := each["metrics"]["angle_rmse_deg"]) is not None:
            errors[shown[name]] = spread["median"], spread["percentile_95"]
    at_air = numbers["at_air_of_first"] or {"controllers": {}}
    reference = next(iter(suite.references))
    scenarios = {
        title: with_values(suite.scenario(name, reference), found.tuned[name]) for name, title in shown.items()
    }
    remarks = [
        f"{shown[name]}: at a bound of the range: {', '.join(each['at_bound'])}"
        for name, each in numbers["controllers"].items()
        if each["at_bound"]
    ]
    if numbers["no_start"]:
        remarks.append(f"{numbers['no_start']} runs were infeasible: no static equilibrium at their start")
    equal = [row(*each) for each in at_air["controllers"].items()]
    remarks += filter(None, [left_out_at_air(numbers, shown)])
    return Compared(text, headers, rows, equal, errors, scenarios, [*remarks, *scenario.joint.remarks])


def _number(value: float) -> str:
    return "-" if np.isnan(value) else f"{value:.3g}"


def _cell(found: dict[str, Any], metric: str, what: str) -> str:
    spread = found["metrics"][metric]
    return "-" if spread is None else f"{spread[what]:.3g}"


def best_so_far(costs: Sequence[float] | np.ndarray) -> np.ndarray:
    """Lowest cost up to each trial; NaN until a trial has one."""
    lowest = np.minimum.accumulate(np.asarray(costs, float))
    return np.where(lowest < UNSTABLE_COST, lowest, np.nan)
