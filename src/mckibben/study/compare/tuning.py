"""Tuning of one controller of a comparison."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import numpy as np
from numpy.typing import NDArray

from mckibben.errors import ParameterError
from mckibben.scenario import Scenario, valid_rows
from mckibben.simulation import Batch
from mckibben.simulation.software import engine_of_job, software
from mckibben.storage.store import Store
from mckibben.study.compare.evaluation import engines_used, simulate_runs
from mckibben.study.compare.result import started
from mckibben.study.compare.runs import Runs, draw
from mckibben.study.compare.statistics import (
    FAILED_RUNS,
    MAIN,
    TRADED,
    air_of,
    fewest_failed,
    front,
    stiffness_limit,
    trial_at_air,
)
from mckibben.study.compare.suite import Suite
from mckibben.study.tune.objective import FAILED_COST, with_valid
from mckibben.study.tune.search import Costs, Vector, by_cma, check_population
from mckibben.study.tune.space import SearchSpace
from mckibben.study.tune.trials import Evaluated, Trial, Trials

_PENALTY = 10.0  # penalty on the angle error, relative to the excess of air or stiffness error


class TunedController(NamedTuple):
    """Best values [SI] by name, their cost and the nominal one, parameters at a bound, all trials, and finalists."""

    values: dict[str, float]
    cost: tuple[float, float]
    at_bound: tuple[str, ...]
    trials: tuple[Trial, ...]
    finalists: tuple[Trial, ...]


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

    _stepped: dict[str, Runs] = field(default_factory=dict, repr=False)

    def _training(self, engine: str) -> Runs:
        """The runs with the integration steps that the nominal values need, which all trials have."""
        if engine not in self._stepped:
            self._stepped[engine] = self.runs
            if self.suite.substeps is None and self._nominal:
                batch = simulate_runs(self.runs, self.controller, self._nominal, 1, ("angle_rmse",), engine)
                suite = self.suite.model_copy(update={"substeps": int(batch["substeps"].max())})
                self._stepped[engine] = replace(self.runs, suite=suite)
        return self._stepped[engine]

    @property
    def _starts(self) -> int:
        return self.suite.tuning.starts_of.get(self.controller, self.suite.tuning.starts)

    def evaluate(self, values: Vector, engine: str = "auto") -> Evaluated:
        """Return mean cost and median metrics of rows of values [SI] over the training runs that can start."""
        table = dict(zip(self.space.names, values.T, strict=True))
        good = valid_rows(self._scenario, table)
        if not good.any():
            return Evaluated(np.full(len(values), FAILED_COST))
        table, training = with_valid(table, good), self._training(engine)
        batch = simulate_runs(training, self.controller, table, len(values), self._metrics, engine)
        begun = started(batch)
        if not begun.any():
            raise none_starts("training")
        costs = self._mean_costs(batch, begun)
        if margin := self.suite.tuning.delay_margin:
            late = simulate_runs(training.delayed(margin), self.controller, table, len(values), self._metrics, engine)
            costs = np.maximum(costs, self._mean_costs(late, begun))
        metrics = self._medians(batch, begun)
        return Evaluated(
            np.where(good, costs, FAILED_COST),
            metrics=[medians if valid else None for medians, valid in zip(metrics, good, strict=True)],
        )

    def _mean_costs(self, batch: Batch, begun: NDArray[np.bool_]) -> Vector:
        """Mean cost of each row of values over the runs that begun."""
        costs = self.suite.cost({name: batch.metrics[name] for name in self.suite.cost.metrics})
        usable = np.isfinite(costs) & batch.usable
        costs = np.where(begun, np.where(usable, np.minimum(costs, FAILED_COST), FAILED_COST), 0.0)
        return np.sum(costs.reshape(-1, self.runs.count), axis=1) / begun.reshape(-1, self.runs.count).sum(axis=1)

    def _medians(self, batch: Batch, begun: NDArray[np.bool_]) -> Iterator[dict[str, float] | None]:
        """Medians in which errors of failed runs are infinite, the air over the others, and the failed runs."""
        by_row = [(begun & batch.usable), begun, *(batch.metrics[name] for name in TRADED)]
        for usable, ran, *columns in zip(*(column.reshape(-1, self.runs.count) for column in by_row), strict=True):
            traded = dict(zip(TRADED, columns, strict=True))
            values = {name: np.where(usable, traded[name], np.inf)[ran] for name in MAIN}
            values["air"] = traded["air"][usable]
            medians = {name: float(np.median(column)) for name, column in values.items()} if usable.any() else {}
            finite = medians and np.isfinite(list(medians.values())).all()
            yield {**medians, FAILED_RUNS: float((ran & ~usable).sum())} if finite else None

    def _engines_used(self) -> set[str]:
        """Engines of the runs with the nominal values."""
        return engines_used(self.runs, self.controller, self._nominal, self._metrics) if self._nominal else set()

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
            "digest of runs": hashlib.sha256(content.encode()).hexdigest(),
            **self.suite.timing,
            "parameters": [tuned.text for tuned in self.space.swept],
            "cost": tuning.cost,
            "population": tuning.population,
            "starts": self._starts,
            "candidates": tuning.candidates,
            "delay_margin": tuning.delay_margin,
            **({"wrapped": dict(self.wrapped)} if self.wrapped else {}),
        }

    def run(self, store: Store, progress: Callable[[float], None]) -> TunedController:
        """Search for the least cost from each start, then for the least angle error at equal air."""
        tuning, space = self.suite.tuning, self.space
        check_population(tuning.population)
        engine = "auto"
        if store.path is not None:
            begun = store.about(self.controller)
            engine = engine_of_job(self._engines_used, begun and begun["software"])
        job = store.job(self.about(engine), self.controller)
        trials = Trials(job, space, tuning.population, partial(self.evaluate, engine=engine))
        first = space.point(space.nominal)
        trials.costs(first[None])
        searched: list[Trial] = []  # a continued study may hold others

        def costs(points: Vector) -> Vector:
            searched.extend(trials.at(points))
            return trials.costs(points)

        def search(function: Costs, start: Vector, number: int) -> None:
            by_cma(
                function,
                start,
                seed=tuning.seed + number,
                population=tuning.population,
                generations=tuning.generations,
                progress=lambda part: progress((number + part) / (self._starts + 1)),
            )

        for number, points in enumerate(self._candidates(first)):
            several = tuning.candidates or (number == 0 and len(points) > 1)
            search(costs, points[np.argmin(costs(points))] if several else points[0], number)
        air, stiffness = air_of(searched) if self.air is None else self.air, stiffness_limit(searched)
        failed = fewest_failed(searched)
        if np.isfinite(air) and (points_at_air := front(searched)):
            begin = trial_at_air(searched, air) or points_at_air[0][0]

            def errors_at_air(points: Vector) -> Vector:
                new = trials.at(points)
                searched.extend(new)
                return np.array([_error_at_air(trial, air, stiffness, failed) for trial in new])

            search(errors_at_air, np.array(begin.point), self._starts)
        if trials.best.cost >= FAILED_COST:
            message = f"{self.controller}: all {len(trials.all)} trials failed"
            raise ParameterError(message, remedy="search other ranges, or start from other gains")
        finalists = self.finalists(searched, engine)
        best = min(finalists or searched, key=lambda trial: (trial.cost, trial.point))
        values = self.values(best)
        cost, before = trials.costs(np.stack([space.point(np.array(list(values.values()))), first])).tolist()
        return TunedController(values, (cost, before), space.at_bound(best.point), tuple(trials.all), finalists)

    def _candidates(self, first: Vector) -> NDArray[np.float64]:
        """Points from which the searches start, shape (starts, candidates, parameters)."""
        tuning, space = self.suite.tuning, self.space
        inner = [i for i, name in enumerate(space.names) if name in self.wrapped]
        size = self._starts, max(tuning.candidates, 2 if inner else 1), len(space)
        candidates = np.random.default_rng(tuning.seed).random(size)
        candidates[0, 0] = first
        if inner:  # the others nominal in one candidate, random in the others
            pairs = zip(space.names, space.nominal, strict=True)
            candidates[0, 1] = begin = space.point(np.array([self.wrapped.get(name, value) for name, value in pairs]))
            candidates[0][1::2, inner] = begin[inner]
        return candidates

    def finalists(self, trials: Sequence[Trial], engine: str = "auto") -> tuple[Trial, ...]:
        """The trials of least cost, evaluated on further runs; empty if the suite has no finalists."""
        tuning = self.suite.tuning
        if not tuning.finalists:
            return ()
        known = {tuple(self.values(trial).values()): trial for trial in reversed(trials)}
        chosen = dict(sorted(known.items(), key=lambda item: (item[1].cost, item[1].point))[: tuning.finalists])
        task = replace(self, runs=draw(self.suite, tuning.finalist_runs, tuning.finalist_seed), _stepped={})
        costs, metrics = task.evaluate(np.array(list(chosen)), engine)
        rows = zip(chosen.values(), costs.tolist(), metrics or len(chosen) * [None], strict=True)
        return tuple(Trial(trial.point, cost, metrics=medians) for trial, cost, medians in rows)

    def values(self, trial: Trial) -> dict[str, float]:
        """Values [SI] of a trial by name, rounded to six digits."""
        rounded = self.space.rounded(self.space.values(np.array(trial.point)[None])[0])
        return dict(zip(self.space.names, rounded.tolist(), strict=True))


def none_starts(runs: str) -> ParameterError:
    """Return the error of a suite none of whose runs can start."""
    return ParameterError(
        f"none of the {runs} runs can start: no pressures hold their plants at the start of their references",
        remedy="give references that start at other angles, or change the joint or its load",
    )


def _error_at_air(trial: Trial, air: float, stiffness: float, failed: float) -> float:
    """Angle error [rad] of a trial, with a penalty on more air [m^3], stiffness error [N*m/rad] or failed runs."""
    if trial.metrics is None or trial.metrics.get(FAILED_RUNS, 0.0) > failed:
        return FAILED_COST
    excess = max(trial.metrics["air"] / air - 1, 0) + max(trial.metrics["stiffness_rmse"] / stiffness - 1, 0)
    return trial.metrics["angle_rmse"] * (1 + _PENALTY * excess)
