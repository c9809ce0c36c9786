"""Tuning of scenario parameters: search for the lowest cost, every trial kept in the study's file."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import jax
import numpy as np

from mckibben.component.calls import checked_call
from mckibben.errors import ParameterError
from mckibben.notebook import Progress, notebook_progress, silent
from mckibben.scenario import ModelFollows, Scenario, with_values
from mckibben.simulation.software import engine_of_job, software
from mckibben.storage.store import STUDY, Store, open_store
from mckibben.study.parameters import Distribution, SweptParameter, Table, sweep_parameters
from mckibben.study.parameters.sampling import check_count
from mckibben.study.tune.cost import Cost, parse_cost
from mckibben.study.tune.objective import FAILED_COST, UNSTABLE_COST, TuningProblem
from mckibben.study.tune.result import TuneResult
from mckibben.study.tune.search import SEARCHES, Method, Search, Vector, check_population
from mckibben.study.tune.space import parse_ranges
from mckibben.study.tune.trials import Trials

FORMAT = "mckibben tuning"
DEFAULT_COST, DEFAULT_MARGIN = "angle_rmse/0.1 deg + stiffness_rmse/0.1 N*m/rad", 1.5
KEPT_MARGIN = 0.2
"""Disk margin that a search keeps by default: gains off by 1.2, phases by 11 deg."""
_MAX_SEED = 2**32 - 1


@checked_call
def tune(
    scenarios: Sequence[Scenario] | Scenario,
    over: Sequence[SweptParameter] | Sequence[str] | str | Mapping[str, Distribution] = (),
    cost: Cost | str | None = None,
    *,
    method: Method | Search | str = Method.CMA,
    iterations: int = 30,
    population: int = 32,
    seed: int = 0,
    out: str | os.PathLike[str] | None = None,
    resume: bool = False,
    model_follows: ModelFollows = (),
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
        Parameters and their ranges, `Uniform` or `LogUniform`, or texts (or one) as for `mckibben tune`.
    cost
        Cost of the runs, or its text, which has no margins. Default: that of `mckibben tune`, with its margins. A disk
        margin of None is 99 % of that of the first gains, at most 0.2.
    method
        Search method, its name, or a `Search` of yours.
    iterations
        Generations, or steps of the simplex.
    population
        Points per generation.
    seed
        Seed of the search.
    out, resume
        Folder of the study, whose file study.sqlite keeps every trial, and whether to continue its search. Default:
        nothing is kept.
    model_follows
        Tuned plant parameters that the controllers' models follow, "all" for all of them. Default: none.
    conditions
        Values [SI] of other parameters by name, such as a `sample` of them: every trial is simulated under all rows,
        and the cost combines them like scenarios.
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
    for name, count in (("iterations", iterations), ("population", population)):
        check_count(name, count, 1, 10**9)
    check_count("seed", seed, 0, _MAX_SEED)
    search = Method(method) if isinstance(method, str) or not callable(method) else method
    problem = _problem(scenarios, over, cost, model_follows, conditions)
    if problem.cost.disk_margin is None:
        margin = problem.kept_margin(KEPT_MARGIN)
        problem = replace(problem, cost=replace(problem.cost, disk_margin=margin))
    if search is Method.CMA:
        check_population(population)
    report = progress or notebook_progress() or silent
    with open_store(None if out is None else Path(out) / STUDY, resume=resume) as store:
        problem = replace(problem, engine=_engine(problem, engine, store))
        job = store.job(_about(problem, search, seed, population, Path() if out is None else Path(out)))
        trials = Trials(job, problem.space, 1 if search is Method.LOCAL else population, problem.evaluate)

        def step(part: float) -> None:
            known_trials = trials.all
            lowest = min((trial.cost for trial in known_trials), default=FAILED_COST)
            what = "searching" if len(known_trials) > trials.first else "compiling"
            report(f"{what}, lowest cost {lowest:.4g}" if lowest < FAILED_COST else what, part)

        step(0.0)
        first = problem.space.point(problem.space.nominal)
        run = SEARCHES[search] if isinstance(search, Method) else search
        run(trials.costs, first, population=population, generations=iterations, seed=seed, progress=step)
        report("evaluating", 1.0)
        return _result(problem, trials)


def _problem(
    scenarios: Sequence[Scenario] | Scenario,
    over: Any,
    cost: Cost | str | None,
    model_follows: ModelFollows,
    conditions: Table | None,
) -> TuningProblem:
    """Return the problem of the arguments of `tune`."""
    several = [scenarios] if isinstance(scenarios, Scenario) else list(scenarios)
    swept: Any = [over] if isinstance(over, str) else list(over)
    if isinstance(over, Mapping) and several:
        swept = sweep_parameters(several[0], over)
    elif several and all(isinstance(text, str) for text in swept):
        swept = parse_ranges(swept, several[0])
    if not isinstance(cost, Cost):
        margins: Any = {"gain_margin": DEFAULT_MARGIN, "disk_margin": None} if cost is None else {}
        cost = parse_cost(DEFAULT_COST if cost is None else cost, **margins)
    problem = TuningProblem.of(several, swept, cost, model_follows, conditions)
    if all(name.startswith("controller.") for name in problem.space.names):
        for scenario in several:
            scenario.initial(scenario.plant())  # raises what no gains can mend
    return problem


def _engine(problem: TuningProblem, engine: str, store: Store) -> str:
    """Return the engine of all trials: one for those that are kept, so that they do not depend on the machine."""
    if store.path is None:
        return engine
    begun = store.about()
    return engine_of_job(problem.engines_used, begun and begun.get("software"), engine)


def _about(problem: TuningProblem, search: Method | Search, seed: int, population: int, folder: Path) -> dict[str, Any]:
    """Return all that determines the trials, for JSON."""
    cost, model_follows = problem.cost, problem.model_follows
    return {
        "format": FORMAT,
        "software": software(problem.engine),
        "scenarios": [scenario.dumps(folder=folder) for scenario in problem.scenarios],
        "digest of models": [_digest(scenario) for scenario in problem.scenarios],
        "parameters": [tuned.text for tuned in problem.space.swept],
        "model_follows": model_follows if model_follows == "all" else sorted(model_follows),
        "cost": cost.text,
        "gain_margin": cost.gain_margin,
        "delay_margin": cost.delay_margin,
        "disk_margin": cost.disk_margin,
        "percentile": cost.percentile,
        "conditions": {name: np.asarray(column).tolist() for name, column in problem.conditions.items()},
        "method": search.value if isinstance(search, Method) else f"{search.__module__}.{search.__qualname__}",
        "seed": seed,
        "population": population,
    }


def _digest(scenario: Scenario) -> str:
    """Digest of all numbers of a run, including the files and catalog entries that the scenario names."""
    leaves = jax.tree.leaves((scenario.plant(), scenario.control(), scenario.reference()))
    return hashlib.sha256(repr([np.asarray(leaf).tolist() for leaf in leaves]).encode()).hexdigest()


def _result(problem: TuningProblem, trials: Trials) -> TuneResult:
    """Return the best trial, with values rounded for files."""
    space, best, count = problem.space, trials.best, len(trials.all)
    _check_success(problem, best.cost, count)
    point = np.array(best.point)
    values, before = space.values(point[None])[0], trials.cost(space.nominal)
    rounded, cost = _rounded(space.rounded(values), values, best.cost, before, trials.cost)
    named = dict(zip(space.names, rounded.tolist(), strict=True))
    return TuneResult(
        values=named,
        before=problem.scenarios,
        scenarios=tuple(
            with_values(scenario, named, model_follows=problem.model_follows) for scenario in problem.scenarios
        ),
        cost=cost,
        cost_before=before if before < FAILED_COST else float("nan"),
        evaluated=count,
        at_bound=space.at_bound(point),
        trials=tuple(trials.all),
        disk_margin=problem.cost.disk_margin or 0.0,
        conditions=problem.conditions,
    )


def _rounded(
    rounded: Vector, exact: Vector, lowest: float, before: float, cost: Callable[[Vector], float]
) -> tuple[Vector, float]:
    """Return six digits of values and their cost, unless that raises the cost by 0.1 %, or above the initial cost."""
    limit = lowest * (1 + 1e-3)
    if before > lowest * (1 - 1e-9):
        limit = min(limit, max(before, lowest))
    after = cost(rounded)
    return (rounded, after) if after <= limit else (exact, lowest)


def _check_success(problem: TuningProblem, lowest: float, count: int) -> None:
    """Raise `ParameterError` if no trial has a cost, or the disk margin."""
    if lowest >= FAILED_COST:
        raise ParameterError(
            f"none of the {count} evaluated points has a cost: their values are not valid together, "
            "their runs fail, or a metric is not defined for them",
            remedy="search other ranges, by another method or with another cost",
        )
    wanted = problem.cost.disk_margin
    if wanted and lowest >= UNSTABLE_COST:
        raise ParameterError(
            f"none of the {count} evaluated points has a disk margin of {wanted:g} in all scenarios and "
            f"conditions; the best has {wanted * (2 - lowest / UNSTABLE_COST):.3g}",
            field="disk_margin",
            value=wanted,
            remedy="search lower gains, allow more iterations, or ask for less",
        )
