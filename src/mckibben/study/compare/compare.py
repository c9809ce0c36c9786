"""Benchmark of controllers: tuned with one budget, compared on the same evaluation runs."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import numpy as np
from numpy.typing import ArrayLike, NDArray

from mckibben import notebook
from mckibben.control import Controller
from mckibben.errors import ParameterError
from mckibben.notebook import Progress, html_table, notebook_progress, silent
from mckibben.numerics.batching import lanes_of
from mckibben.scenario import Scenario, batched, run_scenario, valid_rows
from mckibben.simulation import Batch, Metrics, Outcome, SimulationResult, simulate_many
from mckibben.simulation.outcome import OUTCOMES
from mckibben.simulation.software import engine_of_job, software
from mckibben.study.compare.runs import Group, Runs, draw, merged
from mckibben.study.compare.statistics import (
    FAILED_RUNS,
    MAIN,
    SHOWN,
    TRADED,
    air_of,
    fewest_failed,
    front,
    statistics,
    stiffness_limit,
    trial_at_air,
)
from mckibben.study.compare.suite import Suite, filename
from mckibben.study.tune.objective import FAILED_COST
from mckibben.study.tune.search import Costs, Method, SearchSpace, Vector, by_cma, check_method
from mckibben.study.tune.tune import Evaluated, Evaluator, Trial, TuningHistory, kept_software

_TUNING = 0.98  # share of a controller's time
_PENALTY = 10.0  # penalty on the angle error, relative to the excess of air or stiffness error


@dataclass(frozen=True, eq=False, repr=False)
class BenchmarkResult:
    """Result of a benchmark, by controller.

    `at_air` is the evaluation at equal air: for each controller, the trial of lowest angle error on its Pareto front
    with no more air than the tuned first controller, by medians of the training runs; None if the first is not tuned.
    """

    suite: Suite
    runs: Runs  # of the evaluation
    tuned: dict[str, dict[str, float]]  # values [SI] by name; empty for an untuned controller
    training_cost: dict[str, tuple[float, float]]  # on the training runs, after and before tuning
    at_bound: dict[str, tuple[str, ...]]  # parameters at an end of their range
    batches: dict[str, Batch]  # results in the evaluation runs
    trials: dict[str, tuple[Trial, ...]] = field(default_factory=dict)  # with medians of the training runs
    at_air: BenchmarkResult | None = None
    finalists: dict[str, tuple[Trial, ...]] = field(
        default_factory=dict
    )  # trials with the medians of their further runs

    def __repr__(self) -> str:
        return f"<BenchmarkResult: {', '.join(self.batches)} on {self.runs.count} runs>"

    def median_run(self, controllers: Sequence[str]) -> tuple[int, dict[str, SimulationResult]]:
        """Return the run with the first controller's median angle error, and the results of some controllers in it."""
        errors = self.metric(next(iter(self.batches)), "angle_rmse")
        order = np.argsort(errors)  # NaN last
        run = int(np.flatnonzero(self.started)[order[np.isfinite(errors).sum() // 2]])
        scenarios = {name: self.runs.scenario(name, run, self.tuned.get(name)) for name in controllers}
        return run, {name: run_scenario(scenario) for name, scenario in scenarios.items()}

    def plot(self) -> Any:
        """Return a figure of the errors of all controllers, see `mckibben.report.benchmark_errors`."""
        return notebook.draw("benchmark_errors", self)

    def _repr_html_(self) -> str:
        numbers = statistics(self)
        rows = []
        for name in numbers["order"]:
            found = numbers["controllers"][name]
            medians = [found["metrics"][SHOWN[metric]] for metric in MAIN]
            cells = ["-" if each is None else f"{each['median']:.3g}" for each in medians]
            rows.append((name, *cells, str(found["diverged"])))
        return html_table(repr(self), ("controller", *(SHOWN[metric] for metric in MAIN), "diverged"), rows)

    @property
    def started(self) -> NDArray[np.bool_]:
        """Mask of the runs that could start, independent of the controller. Shape (runs,)."""
        return _started(next(iter(self.batches.values())))

    def metric(self, controller: str, name: str) -> Vector:
        """A metric [SI] of each run that started; NaN where the run diverged."""
        return self.of(self.batches[controller], name)

    def of(self, batch: Batch, name: str) -> Vector:
        """A metric [SI] in the results of a controller."""
        return np.where(batch.usable, batch.metrics[name], np.nan)[self.started]

    def diverged(self, controller: str) -> NDArray[np.bool_]:
        """Mask of the runs that started and diverged."""
        return self.batches[controller].failed[self.started]

    def oscillates(self, controller: str) -> NDArray[np.bool_]:
        """Mask of the runs that ended in a limit cycle."""
        return _ended(self.batches[controller], Outcome.LIMIT_CYCLE)[self.started]

    def cost(self, controller: str) -> Vector:
        """Cost of each run that started; 1e6 where the run diverged."""
        names = self.suite.cost.metrics
        cost = self.suite.cost({name: self.metric(controller, name) for name in names})
        return np.where(np.isfinite(cost), cost, FAILED_COST)

    def training_air(self, controller: str) -> float:
        """Median air [m^3] of a tuned controller in the training runs; NaN if unknown."""
        finalists = self.finalists.get(controller) or self.trials.get(controller, ())
        best = min(finalists, key=lambda trial: (trial.cost, trial.point), default=None)
        known = (each.metrics for each in self.trials.get(controller, ()) if best and each.point == best.point)
        return (next(known, None) or {}).get("air", np.nan)

    def scenario(self, controller: str, run: int) -> Scenario:
        """Scenario of one run with the tuned controller."""
        return self.runs.scenario(controller, run, self.tuned[controller])


def compare(
    suite: Suite, *, folder: Path | None = None, resume: bool = False, progress: Progress | None = None
) -> BenchmarkResult:
    """Tune the controllers of a suite and compare them on its evaluation runs.

    Raises `ParameterError` if a controller has nothing to tune, no trial succeeds, or no run can start; `FileError` as
    for `tune`.

    Parameters
    ----------
    folder, resume
        Folder for the tuning histories, one file per controller, and whether to continue existing ones.
    progress
        Called with the current step and the completed fraction, 0 to 1. Default: a progress bar in notebooks.
    """
    progress = progress or notebook_progress()
    training = draw(suite, suite.tuning.runs, suite.tuning.seed)
    evaluation = draw(suite, suite.evaluation.runs, suite.evaluation.seed)
    names = list(suite.controllers)
    result, at_air = (BenchmarkResult(suite, evaluation, {}, {}, {}, {}) for _ in range(2))
    for number, name in enumerate(names):

        def report(task: str, part: float, name: str = name, number: int = number) -> None:
            if progress:
                progress(f"{name} ({number + 1} of {len(names)}): {task}", (number + part) / len(names))

        swept = suite.tuned_over(name)
        result.tuned[name], result.at_bound[name] = {}, ()
        if swept:
            air = None if number == 0 else result.training_air(names[0])
            wrapped = suite.tuned_inside(name, result.tuned)
            task = ControllerTuning(suite, name, SearchSpace(swept), training, air, wrapped)
            report("tuning", 0.0)
            tuned = task.run(folder, resume, lambda part: report("tuning", _TUNING * part))
            result.tuned[name], result.training_cost[name], result.at_bound[name] = tuned[:3]
            result.trials[name], result.finalists[name] = tuned[3:]
            trial = trial_at_air(result.trials[name], result.training_air(names[0]))
            if trial is not None:
                at_air.tuned[name] = task.values(trial)
        report("evaluation runs, the last part", _TUNING)
        for each in (result, at_air):
            if name in each.tuned:
                each.batches[name] = evaluate(evaluation, name, each.tuned[name])
        if not _started(result.batches[name]).any():
            raise _none_starts("evaluation")
    if progress:
        progress("done", 1.0)
    return replace(result, at_air=at_air) if at_air.batches else result


def evaluate(
    runs: Runs, controller: str, values: Mapping[str, ArrayLike], *, metrics: Sequence[str] = Metrics._fields
) -> Batch:
    """Simulate the runs with a controller of given values [SI], or all runs for each of several sets of values."""
    table = {name: np.atleast_1d(np.asarray(value)) for name, value in values.items()}
    return _simulated_all(runs, controller, table, max(map(len, table.values()), default=1), tuple(metrics))


def _ended(batch: Batch, outcome: Outcome) -> NDArray[np.bool_]:
    """Mask of the runs with an outcome. Shape (runs,)."""
    return batch["outcome"] == OUTCOMES.index(outcome)


def _started(batch: Batch) -> NDArray[np.bool_]:
    """Mask of the runs that could start. Shape (runs,)."""
    return ~_ended(batch, Outcome.NO_START)


def _none_starts(runs: str) -> ParameterError:
    return ParameterError(
        f"none of the {runs} runs can start: no pressures hold their plants at the start of their references",
        remedy="give references that start at other angles, or change the joint or its load",
    )


@dataclass(frozen=True, eq=False)
class ControllerTuning:
    """Tuning of one controller on training runs: for lowest cost, then for lowest angle error at equal air."""

    suite: Suite
    controller: str
    space: SearchSpace
    runs: Runs
    air: float | None = None  # median [m^3] of the last search; None: that of the best trial so far
    wrapped: Mapping[str, float] = field(default_factory=dict)  # tuned values [SI] of controllers that it wraps

    @cached_property
    def _scenario(self) -> Scenario:
        return self.suite.scenario(self.controller, next(iter(self.suite.references)))

    @cached_property
    def _nominal(self) -> dict[str, NDArray[np.float64]]:
        """Table of the nominal values; empty if they are not valid."""
        table = dict(zip(self.space.names, self.space.nominal[:, None], strict=True))
        return table if valid_rows(self._scenario, table).all() else {}

    _given: dict[str, Runs] = field(default_factory=dict, repr=False)

    def _training(self, engine: str) -> Runs:
        """The runs with the integration steps that the nominal values need, which all trials have."""
        if engine not in self._given:
            self._given[engine] = self.runs
            if self.suite.substeps is None and self._nominal:
                batch = _simulated_all(self.runs, self.controller, self._nominal, 1, ("angle_rmse",), engine)
                suite = self.suite.model_copy(update={"substeps": int(batch["substeps"].max())})
                self._given[engine] = replace(self.runs, suite=suite)
        return self._given[engine]

    @property
    def _starts(self) -> int:
        return self.suite.tuning.starts_of.get(self.controller, self.suite.tuning.starts)

    def evaluate(self, values: Vector, engine: str = "auto") -> Evaluated:
        """Mean cost and median metrics of rows of values [SI] over the training runs that can start."""
        table = dict(zip(self.space.names, values.T, strict=True))
        good = valid_rows(self._scenario, table)
        if not good.any():
            return Evaluated(np.full(len(values), FAILED_COST))
        table = {name: np.where(good, column, column[np.argmax(good)]) for name, column in table.items()}
        batch = _simulated_all(self._training(engine), self.controller, table, len(values), self._metrics, engine)
        started, shape = _started(batch), (len(values), self.runs.count)
        if not started.any():
            raise _none_starts("training")

        def costs_of(batch: Batch) -> Vector:
            found = self.suite.cost({name: batch.metrics[name] for name in self.suite.cost.metrics})
            kept = np.isfinite(found) & batch.usable
            found = np.where(kept, np.minimum(found, FAILED_COST), FAILED_COST)
            return np.sum(np.where(started, found, 0.0).reshape(shape), axis=1) / started.reshape(shape).sum(axis=1)

        costs = costs_of(batch)
        if margin := self.suite.tuning.delay_margin:
            delayed = self._training(engine).delayed(margin)
            late = _simulated_all(delayed, self.controller, table, len(values), self._metrics, engine)
            costs = np.maximum(costs, costs_of(late))
        costs = np.where(good, costs, FAILED_COST)
        started, usable = started.reshape(shape), batch.usable.reshape(shape)
        columns = {name: batch.metrics[name].reshape(shape) for name in TRADED}

        def medians(row: int) -> dict[str, float] | None:
            """Medians in which errors of failed runs are infinite, the air over the others, and the failed runs."""
            begun, kept = started[row], (started & usable)[row]
            if not good[row] or not kept.any():
                return None
            errors = {name: np.where(kept, columns[name][row], np.inf)[begun] for name in MAIN}
            values = {**errors, "air": columns["air"][row][kept]}
            found = {name: float(np.median(column)) for name, column in values.items()}
            if not np.isfinite(list(found.values())).all():
                return None
            return {**found, FAILED_RUNS: float((begun & ~kept).sum())}

        return Evaluated(costs, metrics=[medians(row) for row in range(len(values))])

    def _engines_used(self) -> set[str]:
        """Engines of the runs with the nominal values."""
        used = set()
        for group in self.runs.groups if self._nominal else ():
            control = _controller(self.runs, group, self.controller, self._nominal, 1)
            used.add(_simulated(self.suite, group, control, 1, self._metrics, "auto").engine)
        return used

    @property
    def _metrics(self) -> tuple[str, ...]:
        return tuple(dict.fromkeys((*self.suite.cost.metrics, *TRADED)))

    def about(self, engine: str = "auto") -> dict[str, Any]:
        """Everything that determines the trials."""
        parts = [(group.rows, group.plant, group.reference) for group in self.runs.groups]
        leaves = jax.tree.leaves((parts, self._scenario.control()))
        content = repr([np.asarray(leaf).tolist() for leaf in leaves if eqx.is_array_like(leaf)])
        tuning = self.suite.tuning
        return {
            "software": software(engine),
            "controller": self.controller,
            "runs": hashlib.sha256(content.encode()).hexdigest(),
            **self.suite.timing,
            "parameters": [each.text for each in self.space.swept],
            "cost": tuning.cost,
            "population": tuning.population,
            "starts": self._starts,
            "candidates": tuning.candidates,
            "delay_margin": tuning.delay_margin,
            **({"wrapped": dict(self.wrapped)} if self.wrapped else {}),
        }

    def run(
        self, folder: Path | None, resume: bool, progress: Callable[[float], None]
    ) -> tuple[dict[str, float], tuple[float, float], tuple[str, ...], tuple[Trial, ...], tuple[Trial, ...]]:
        """Best values [SI], their cost and the nominal cost, parameters at a bound, all trials, and the finalists."""
        tuning, space = self.suite.tuning, self.space
        check_method(Method.CMA, numbers=max(len(space), 2), population=tuning.population)
        path = None if folder is None else folder / f"{filename(self.controller)}.journal"
        resume = resume and path is not None and path.exists()
        engine = "auto"
        if path is not None:
            engine = engine_of_job(self._engines_used, kept_software(path) if resume else None)
        evaluate = partial(self.evaluate, engine=engine)
        with TuningHistory.open(path, self.about(engine), resume=resume) as past:
            costs = Evaluator(space, past, tuning.population, evaluate).costs
            first = space.point(space.nominal)
            costs(first[None])
            tuned = [i for i, name in enumerate(space.names) if name in self.wrapped]
            size = self._starts, max(tuning.candidates, 2 if tuned else 1), len(space)
            candidates = np.random.default_rng(tuning.seed).random(size)
            candidates[0, 0] = first
            if tuned:  # the others nominal in one candidate, random in the others
                given = [self.wrapped.get(name, value) for name, value in zip(space.names, space.nominal, strict=True)]
                candidates[0, 1] = begin = space.point(np.array(given))
                candidates[0][1::2, tuned] = begin[tuned]
            searched: list[Trial] = []  # by cost: a continued history may contain others

            def trials(points: Vector) -> list[Trial]:
                costs(points)
                return [trial for point in points if (trial := past.find(point)) is not None]

            def searched_costs(points: Vector) -> Vector:
                searched.extend(trials(points))
                return costs(points)

            def report(part: float, number: int) -> None:
                progress((number + part) / (self._starts + 1))

            for number, points in enumerate(candidates):
                several = tuning.candidates or (tuned and number == 0)
                start = points[np.argmin(searched_costs(points))] if several else points[0]
                self._search(searched_costs, start, tuning.seed + number, partial(report, number=number))
            air, stiffness = air_of(searched) if self.air is None else self.air, stiffness_limit(searched)
            failed = fewest_failed(searched)
            if np.isfinite(air) and (found := front(searched)):
                begin = trial_at_air(searched, air) or found[0][0]

                def errors_at_air(points: Vector) -> Vector:
                    several = trials(points)
                    searched.extend(several)
                    return np.array([_error_at_air(trial, air, stiffness, failed) for trial in several])

                self._search(
                    errors_at_air,
                    np.array(begin.point),
                    tuning.seed + self._starts,
                    partial(report, number=self._starts),
                )
            if past.best.cost >= FAILED_COST:
                raise ParameterError(
                    f"{self.controller}: all {len(past.trials)} trials failed",
                    remedy="search other ranges, or start from other gains",
                )
            finalists = self.finalists(searched, engine)
            best = min(finalists or searched, key=lambda trial: (trial.cost, trial.point))
            values = self.values(best)
            (cost,), (before,) = costs(space.point(np.array(list(values.values())))[None]), costs(first[None])
            return values, (float(cost), float(before)), space.at_bound(best.point), tuple(past.trials), finalists

    def finalists(self, trials: Sequence[Trial], engine: str = "auto") -> tuple[Trial, ...]:
        """The trials of least cost, evaluated on further runs; empty if the suite has no finalists."""
        tuning = self.suite.tuning
        if not tuning.finalists:
            return ()
        known = {tuple(self.values(trial).values()): trial for trial in reversed(trials)}
        chosen = dict(sorted(known.items(), key=lambda one: (one[1].cost, one[1].point))[: tuning.finalists])
        task = replace(self, runs=draw(self.suite, tuning.finalist_runs, tuning.finalist_seed), _given={})
        costs, _, metrics = task.evaluate(np.array(list(chosen)), engine)
        each = zip(chosen.values(), costs.tolist(), metrics or len(chosen) * [None], strict=True)
        return tuple(Trial(trial.point, cost, metrics=medians) for trial, cost, medians in each)

    def values(self, trial: Trial) -> dict[str, float]:
        """Values [SI] of a trial by name, rounded to six digits."""
        rounded = self.space.rounded(self.space.values(np.array(trial.point)[None])[0])
        return dict(zip(self.space.names, rounded.tolist(), strict=True))

    def _search(self, costs: Costs, start: Vector, seed: int, progress: Callable[[float], None]) -> None:
        tuning, count = self.suite.tuning, start.size
        by_cma(
            lambda points: costs(points[:, :count]),
            start if count >= 2 else np.append(start, 0.5),  # CMA-ES needs two parameters: add one without effect
            seed=seed,
            population=tuning.population,
            generations=tuning.generations,
            progress=progress,
        )


def _error_at_air(trial: Trial, air: float, stiffness: float, failed: float) -> float:
    """Angle error [rad] of a trial, with a penalty on more air [m^3], stiffness error [N*m/rad] or failed runs."""
    if trial.metrics is None or trial.metrics.get(FAILED_RUNS, 0.0) > failed:
        return FAILED_COST
    excess = max(trial.metrics["air"] / air - 1, 0) + max(trial.metrics["stiffness_rmse"] / stiffness - 1, 0)
    return trial.metrics["angle_rmse"] * (1 + _PENALTY * excess)


def _controller(runs: Runs, group: Group, controller: str, table: dict[str, Any], sets: int) -> Controller:
    """A controller with sets of values, each used in all runs of a group: arrays of shape (sets * runs,)."""
    suite, reference = runs.suite, next(iter(runs.suite.references))
    columns = {name: np.repeat(np.asarray(column), group.count) for name, column in table.items()}
    if controller not in suite.true_model:
        scenario = suite.scenario(controller, reference)
        return (batched(scenario, columns) if columns else scenario).control()
    parts = []
    for joint in dict.fromkeys(group.joint):
        own = np.flatnonzero([name == joint for name in group.joint])
        lanes = _lanes(own, group.count, sets)
        conditions = runs.conditions_of(joint, group.rows[own])
        values = {name: np.tile(column, sets) for name, column in conditions.items()}
        values |= {name: column[lanes] for name, column in columns.items()}
        scenario = suite.scenario(controller, reference, joint)
        parts.append((lanes, (batched(scenario, values, known="all") if values else scenario).control()))
    return merged(parts, group.count * sets)


def _lanes(rows: NDArray[np.int64], count: int, sets: int) -> NDArray[np.int64]:
    """Indices of selected runs, repeated for sets of values."""
    return (np.arange(sets)[:, None] * count + rows).ravel()


def _tiled(tree: Any, sets: int) -> Any:
    """A batch of runs repeated for sets of values; leaves that do not vary are unchanged."""
    _, varying = lanes_of(tree)
    return jax.tree.map(
        lambda leaf, varies: np.tile(leaf, (sets, *[1] * (np.ndim(leaf) - 1))) if varies else leaf, tree, varying
    )


def _simulated_all(
    runs: Runs, controller: str, table: dict[str, Any], sets: int, metrics: tuple[str, ...], engine: str = "auto"
) -> Batch:
    """Simulate all runs with sets of values [SI], one group of runs after the other."""
    batches, lanes = [], []
    for group in runs.groups:
        control = _controller(runs, group, controller, table, sets)
        batches.append(_simulated(runs.suite, group, control, sets, metrics, engine))
        lanes.append(_lanes(group.rows, runs.count, sets))
    if len(batches) == 1:
        return batches[0]
    import xarray as xr

    whole: Any = xr.concat([batch.table for batch in batches], "run")
    return Batch(whole.isel(run=np.argsort(np.concatenate(lanes))))


def _simulated(
    suite: Suite, group: Group, controller: Controller, sets: int, metrics: tuple[str, ...], engine: str
) -> Batch:
    """Simulate the runs of a group with a controller of sets of values."""
    plant, reference = (_tiled(part, sets) for part in (group.plant, group.reference))
    return simulate_many(plant, controller, reference, **suite.timing, metrics=metrics, engine=engine, progress=silent)
