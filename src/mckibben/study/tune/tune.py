"""Tuning of scenario parameters: search for the lowest cost, every trial kept in the study's file."""

from __future__ import annotations

import os
import time
from collections.abc import Mapping, Sequence
from datetime import timedelta
from pathlib import Path
from typing import Any

import numpy as np

from mckibben.component.calls import checked_call
from mckibben.errors import ParameterError, suggest
from mckibben.notebook import Progress, notebook_progress, silent
from mckibben.scenario import ModelFollows, StudiedScenario, with_values
from mckibben.simulation import LEAST_DISK_MARGIN
from mckibben.simulation.software import software
from mckibben.storage.store import STUDY, open_store
from mckibben.study.parameters import Distribution, SweptParameter, Table
from mckibben.study.parameters.sampling import check_count
from mckibben.study.scenarios import begun_settings
from mckibben.study.study import digest
from mckibben.study.tune.cost import Cost, parse_cost
from mckibben.study.tune.objective import FAILED_COST, UNSTABLE_COST, TuningProblem
from mckibben.study.tune.result import TuneResult
from mckibben.study.tune.search import SEARCHES, Search, Vector, by_cma
from mckibben.study.tune.trials import Trial, Trials

FORMAT = "mckibben tuning"
COST: Mapping[str, Any] = {
    "cost": "angle_rmse/0.1 deg + stiffness_rmse/0.1 N*m/rad",
    "gain_margin": 1.0,
    "disk_margin": LEAST_DISK_MARGIN,
    "percentile": None,
}
"""Text and options of the default cost."""


def cost_of(scenario: StudiedScenario, begun: Mapping[str, Any], **given: Any) -> Cost:
    """Return a cost from its text, `cost`, and options of `Cost`; those that are None are of a begun search, or `COST`.

    In the units of a scenario's joint, and without the stiffness of one muscle alone.

    >>> from mckibben.scenario import Scenario
    >>> scenario = Scenario.read("examples/pre-contracted-step-pid.yaml")
    >>> cost_of(scenario, {"gain_margin": 2.0}, cost="angle_rmse", disk_margin=0.4)
    Cost(terms=(Term(metric='angle_rmse', scale=1.0, weight=1.0),), gain_margin=2.0, percentile=None, disk_margin=0.4)
    """
    given = {name: value for name, value in given.items() if value is not None}
    kind, scales = scenario.joint_type, {"angle_rmse": "deg"}
    scales |= {"stiffness_rmse": "N*m/rad"} if scenario.follows_stiffness else {}
    usual = " + ".join(f"{name}/0.1 {kind.shown(unit)}" for name, unit in scales.items())
    text, *values = ({**COST, "cost": usual, **begun, **given}[name] for name in COST)
    return parse_cost(text, kind, **dict(zip([*COST][1:], values, strict=True)))


@checked_call
def tune(
    scenarios: Sequence[StudiedScenario] | StudiedScenario,
    over: Sequence[SweptParameter] | Sequence[str] | str | Mapping[str, Distribution] | None = None,
    cost: Cost | str | None = None,
    *,
    method: Search | str | None = None,
    iterations: int = 30,
    population: int | None = None,
    seed: int | None = None,
    out: str | os.PathLike[str] | None = None,
    resume: bool = False,
    model_follows: ModelFollows | None = None,
    conditions: Table | None = None,
    engine: str = "auto",
    progress: Progress | None = None,
) -> TuneResult:
    """Search scenario parameters within ranges for the lowest cost.

    Parameters
    ----------
    scenarios
        Scenarios whose costs are combined; the search starts at the values of the first.
    over
        Parameters and their ranges, `Uniform` or `LogUniform`, or texts (or one) as for `mckibben tune`. Default: all
        gains.
    cost
        Cost of the runs, or its text. Default: that of `mckibben tune`. Gains keep the disk margin of the cost at four
        points of each run and, in the result, at twenty; where none do, the result has those of the largest margin or,
        where all are unstable, of the least spectral radius, and is not `ok`.
    method
        "cma" (CMA-ES, the default), "local" (refinement of the given values), or a `Search` of yours.
    iterations
        Generations, or steps of the simplex.
    population
        Points per generation (default: 16).
    seed
        Seed of the search (default: 0).
    out, resume
        Folder of the study, whose file study.sqlite keeps every trial, and whether to continue its search: arguments
        left out are then those of the search. Default: nothing is kept.
    model_follows
        Tuned plant parameters that the controllers' models follow, "all" for all of them. Default: none.
    conditions
        Values [SI] of other parameters by name, such as a `sample` of them: every trial is simulated under all rows,
        the cost combines them like scenarios, and the disk margin holds for all of them. Default: extremes of the
        uncertainty of the scenario or, without one, of 10 % of strength, 20 % of mass and 2 ms of delay; for a cost
        without a disk margin the nominal plant.
    engine
        As for `simulate_many`; one engine computes all trials. Default: that of the continued search, or "auto".
    progress
        Called with the current step and the completed fraction, 0 to 1, first after all arguments have been checked.
        Default: a progress bar in notebooks.

    Raises
    ------
    ParameterError
        If a parameter is not in every scenario or has no range, or no trial succeeded.
    FileError
        If `out` has a study and `resume` is not set; with `resume`, if it has none or another one; if another process
        is using it; or if the disk is full.
    """
    begun = begun_settings(out, FORMAT, resume=resume)
    method, population = method or begun.get("method", "cma"), population or begun.get("population", 16)
    seed = begun.get("seed", 0) if seed is None else seed
    if not callable(method) and method not in SEARCHES:
        remedy = suggest(str(method), list(SEARCHES))
        raise ParameterError(f"method is {method!r:.60}", field="method", value=method, remedy=remedy)
    search = SEARCHES[method] if isinstance(method, str) else method
    check_count("iterations", iterations, 1, 10**9)
    check_count("population", population, 4 if search is by_cma else 1, 10**9)
    check_count("seed", seed, 0, 2**32 - 1)
    first = scenarios if isinstance(scenarios, StudiedScenario) else next(iter(scenarios), None)
    if first is None:
        raise ParameterError("nothing to tune", remedy="give a scenario")
    asked = TuningProblem.of(
        scenarios,
        begun.get("parameters", ()) if over is None else over,
        cost_of(first, begun) if cost is None else cost,
        begun.get("model_follows", ()) if model_follows is None else model_follows,
        begun.get("conditions") if conditions is None else conditions,
    )
    report = progress or notebook_progress() or silent
    report("simulating the values of the file", 0.0)
    with open_store(None if out is None else Path(out) / STUDY, resume=resume) as store:
        problem = asked.begin(store, engine)
        about = {"method": method if isinstance(method, str) else f"{search.__module__}.{search.__qualname__}"}
        job = store.job(_about(asked, problem, store.folder) | about | {"seed": seed, "population": population})
        batch = 1 if method == "local" else population
        trials = Trials(job, problem.space, batch, problem.evaluate)

        def step(fraction: float) -> None:
            lowest = min((trial.cost for trial in trials.all), default=FAILED_COST)
            report(f"searching, lowest cost {lowest:.4g}" if lowest < FAILED_COST else "searching", fraction)

        first = problem.space.point(problem.space.nominal)
        trials.costs(first[None])  # compiles the programs
        begun_at = time.monotonic()
        problem.evaluate(np.repeat(problem.space.nominal[None], batch, axis=0))
        seconds = timedelta(seconds=round(iterations * (time.monotonic() - begun_at)))
        report(f"searching {iterations} x {batch} points, about {seconds}", 0.0)
        search(trials.costs, first, population=population, generations=iterations, seed=seed, progress=step)
        report("evaluating", 1.0)
        return _result(asked, problem, trials, batch)


def _about(asked: TuningProblem, problem: TuningProblem, folder: Path) -> dict[str, object]:
    """Return all that determines the cost of a point, for JSON."""
    cost, model_follows = problem.cost, problem.model_follows
    models = [(scenario.plant(), scenario.control(), scenario.references()) for scenario in asked.scenarios]
    return {
        "format": FORMAT,
        "software": software(problem.engine),
        "scenarios": [scenario.dumps(folder=folder) for scenario in asked.scenarios],
        "digest of models": digest(models),
        "parameters": [tuned.text for tuned in problem.space.swept],
        "model_follows": model_follows if model_follows == "all" else sorted(model_follows),
        "cost": cost.text,
        "gain_margin": cost.gain_margin,
        "disk_margin": problem.disk_margin,
        "percentile": cost.percentile,
        "conditions": {name: np.asarray(column).tolist() for name, column in problem.conditions.items()},
    }


def _result(asked: TuningProblem, problem: TuningProblem, trials: Trials, batch: int) -> TuneResult:
    """Return the best trial, with values of six digits unless that raises the cost by 0.1 %, or above the first one."""
    space = problem.space

    def cost_of(values: Vector) -> float:
        same = np.repeat(values[None], batch, axis=0)  # as many as in the search: one program
        return float(problem.run_costs(same)[0])

    if trials.best.cost >= FAILED_COST:
        raise ParameterError(
            f"none of the {len(trials.all)} evaluated points has a cost: their values are not valid together, "
            "their runs fail, or a metric is not defined for them",
            remedy="search other ranges, by another method or with another cost",
        )
    best, margin, limit = _with_margin(problem, trials, batch)
    values, before = space.values(np.array([best.point]))[0], cost_of(space.nominal)
    rounded, cost = space.rounded(values), cost_of(values)
    after = cost_of(rounded)
    if after <= min(1.001 * cost, max(before, cost) if before > cost * (1 - 1e-9) else np.inf):
        values, cost = rounded, after
    named = dict(zip(space.names, values.tolist(), strict=True))
    follows = problem.model_follows
    return TuneResult(
        values=named,
        before=asked.scenarios,
        scenarios=tuple(with_values(scenario, named, model_follows=follows) for scenario in asked.scenarios),
        cost=cost if cost < FAILED_COST else float("nan"),
        cost_before=before if before < FAILED_COST else float("nan"),
        evaluated=len(trials.all),
        least_disk=margin,
        limit=limit,
        change=problem.change_needed(values) if margin < problem.disk_margin else "",
        disk_margin=problem.disk_margin,
        at_bound=space.at_bound(best.point),
        trials=tuple(trials.all),
        conditions=problem.conditions,
    )


def _with_margin(problem: TuningProblem, trials: Trials, most: int) -> tuple[Trial, float, str]:
    """Best trial that keeps the disk margin at twenty points of the runs, its margin, and what limits that.

    Of the `most` best trials; if none of them keeps it, the one of largest margin.
    """
    if not problem.disk_margin:
        return trials.best, np.nan, ""
    largest: tuple[Trial, float, str] | None = None
    for trial in sorted(trials.all, key=lambda trial: trial.order)[:most]:
        margin, limit = problem.margin_limit(problem.space.values(np.array([trial.point]))[0])
        if largest is None or margin > largest[1]:
            largest = trial, margin, limit
        if margin >= problem.disk_margin or trial.cost >= UNSTABLE_COST:
            break
    assert largest is not None  # there are trials
    return largest
