"""Tuning of one controller of a comparison."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mckibben.errors import ParameterError
from mckibben.scenario import ModelFollows, StudiedScenario, batched, valid_rows
from mckibben.simulation import LEAST_DISK_MARGIN, Batch
from mckibben.simulation.software import software
from mckibben.storage.store import Store
from mckibben.study.compare.runs import Runs, draw, evaluate, started
from mckibben.study.compare.statistics import (
    FAILED_RUNS,
    TRADED,
    best_trial,
    front,
    least_failing,
    median,
    stiffness_limit,
    trial_at_air,
)
from mckibben.study.compare.suite import ControllerSuite
from mckibben.study.parameters.uncertainty import sensor_noise
from mckibben.study.study import Table, digest
from mckibben.study.tune.cost import mean_of_joints
from mckibben.study.tune.objective import FAILED_COST, UNSTABLE_COST, USE, with_use, with_valid
from mckibben.study.tune.search import Costs, Vector, by_cma
from mckibben.study.tune.space import SearchSpace
from mckibben.study.tune.trials import Evaluated, Trial, Trials, first_runs


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

    suite: ControllerSuite
    controller: str
    space: SearchSpace
    runs: Runs
    air: float | None = None  # median [m^3] of the last search; None: that of the best trial so far
    wrapped: Mapping[str, float] = field(default_factory=dict)  # tuned values [SI] of controllers that it wraps
    engine: str = "auto"

    @cached_property
    def _scenario(self) -> StudiedScenario:
        return self.suite.scenario(self.controller)

    def begin(self, store: Store) -> ControllerTuning:
        """Return the tuning with an engine; all trials have the integration steps that its nominal values need."""
        table = self._table(self.space.nominal[None])
        valid = valid_rows(self._scenario, table).all()

        def simulate(engine: str) -> list[Batch]:
            run = partial(evaluate, self.runs, self.controller, table, metrics=self._metrics, engine=engine)
            return [run()] if valid else []

        engine, batches = first_runs(store, simulate, self.controller)
        if self.suite.timing["substeps"] is not None or not batches:
            return replace(self, engine=engine)
        suite = self.suite.with_substeps(batches[0].needed_substeps(self._scenario.accuracy))
        return replace(self, runs=replace(self.runs, suite=suite), engine=engine)

    def _table(self, values: Vector) -> Table:
        return dict(zip(self.space.names, values.T, strict=True))

    def evaluate(self, values: Vector) -> Evaluated:
        """Return mean cost and median metrics of rows of values [SI] over the training runs that can start."""
        table = self._table(values)
        good = valid_rows(self._scenario, table)
        if not good.any():
            return Evaluated(np.full(len(values), FAILED_COST))
        valid = with_valid(table, good)
        batch = evaluate(self.runs, self.controller, valid, metrics=self._metrics, engine=self.engine)
        begun = started(batch)
        costs = self.suite.cost({name: batch.metrics[name] for name in self.suite.cost.metrics})
        usable = np.isfinite(costs) & batch.usable
        costs = np.where(begun, np.where(usable, np.minimum(costs, FAILED_COST), FAILED_COST), 0.0)
        means = np.sum(costs.reshape(len(values), -1), axis=1) / begun.reshape(len(values), -1).sum(axis=1)
        means = self._with_use(means, valid, batch, begun.reshape(len(values), -1)[0])
        least = self._least_margins(valid, len(values))
        kept = good & (least >= LEAST_DISK_MARGIN)
        costs = np.where(kept, means, UNSTABLE_COST * (2 - least / LEAST_DISK_MARGIN))
        rows = zip(self._medians(batch, begun, len(values)), kept, strict=True)
        medians = [numbers if usable else None for numbers, usable in rows]
        return Evaluated(np.where(good, costs, FAILED_COST), medians)

    def _with_use(self, means: Vector, table: Table, batch: Batch, begun: NDArray[np.bool_], most: int = 4) -> Vector:
        """Mean costs, higher where the noise of the sensors moves valves and air too much in the first runs."""
        if not sensor_noise(self.suite.example()):
            return means
        rows = np.flatnonzero(begun)[:most]
        ideal = evaluate(self.runs.without_noise(rows), self.controller, table, metrics=tuple(USE), engine=self.engine)
        noisy = {name: self._by_set(batch, name, len(means))[:, rows].mean(axis=1) for name in USE}
        return with_use(means, noisy, {name: self._by_set(ideal, name, len(means)).mean(axis=1) for name in USE})

    @staticmethod
    def _by_set(batch: Batch, name: str, sets: int) -> NDArray[np.float64]:
        return mean_of_joints(batch.metrics[name]).reshape(sets, -1)

    def _least_margins(self, table: Table, count: int, most: int = 8) -> NDArray[np.float64]:
        """Least disk margins of rows of values [SI] on the first plants of the training runs, those of all controllers.

        Plants that no gains hold are left out.
        """
        conditions = {n: c[:most] for n, c in self.runs.groups[0].conditions.items() if not n.startswith("sensors.")}
        plants = max(map(len, conditions.values()), default=1)
        columns = {name: np.repeat(column, plants) for name, column in table.items()}
        columns |= {name: np.tile(column, count) for name, column in conditions.items()}
        scenario = self.suite.scenario(self.controller, joint=self.runs.groups[0].joint)
        follows: ModelFollows = "all" if self.controller in self.suite.true_model else ()
        margins = batched(scenario, columns, model_follows=follows).disk_margins(4).reshape(count, plants)
        return np.nan_to_num(np.fmin.reduce(margins, axis=1), nan=-1.0)

    def _medians(self, batch: Batch, begun: NDArray[np.bool_], rows: int) -> Iterator[dict[str, float] | None]:
        """Medians in which errors of failed runs are infinite, the air over the others, and the failed runs."""
        columns = [begun & batch.usable, begun, *(mean_of_joints(batch.metrics[name]) for name in TRADED)]
        for usable, ran, *values in zip(*(column.reshape(rows, -1) for column in columns), strict=True):
            *errors, air = values
            finite = [np.where(usable, error, np.inf)[ran] for error in errors]
            medians = [float(np.median(column)) for column in (*finite, air[usable])] if usable.any() else [np.inf]
            failed = {FAILED_RUNS: float((ran & ~usable).sum())}
            yield dict(zip(TRADED, medians, strict=True)) | failed if np.isfinite(medians).all() else None

    @property
    def _metrics(self) -> tuple[str, ...]:
        return tuple(dict.fromkeys((*self.suite.cost.metrics, *TRADED, *USE)))

    def about(self) -> dict[str, object]:
        """Everything that determines the trials."""
        tuning = self.suite.tuning
        groups = [(group.rows, *group.parts) for group in self.runs.groups]
        return {
            "software": software(self.engine),
            "controller": self.controller,
            "digest of runs": digest((groups, self._scenario.control())),
            **self.suite.timing,
            "parameters": [tuned.text for tuned in self.space.swept],
            "cost": tuning.cost,
            "population": tuning.population,
            "starts": self.suite.tuning.starts,
            "candidates": tuning.candidates,
            **({"wrapped": dict(self.wrapped)} if self.wrapped else {}),
        }

    def run(self, store: Store, progress: Callable[[float], None]) -> TunedController:
        """Search for the least cost from each start, then for the least angle error at equal air.

        Raises `ParameterError` if all trials failed.
        """
        return self.begin(store)._search(store, progress)

    def _search(self, store: Store, progress: Callable[[float], None]) -> TunedController:
        """Run the searches with a known engine."""
        tuning, space = self.suite.tuning, self.space
        trials = Trials(store.job(self.about(), self.controller), space, tuning.population, self.evaluate)
        first = space.point(space.nominal)
        trials.costs(first[None])
        searched: list[Trial] = []  # a continued study may hold others

        def tried(points: Vector) -> list[Trial]:
            new = trials.at(points)
            searched.extend(new)
            return new

        def costs(points: Vector) -> Vector:
            return np.array([trial.cost for trial in tried(points)])

        def search(function: Costs, start: Vector, number: int) -> None:
            by_cma(
                function,
                start,
                seed=tuning.seed + number,
                population=tuning.population,
                generations=tuning.generations,
                progress=lambda fraction: progress((number + fraction) / (tuning.starts + 1)),
            )

        for number, points in enumerate(self._candidates(first)):
            several = tuning.candidates or (number == 0 and len(points) > 1)
            search(costs, points[np.argmin(costs(points))] if several else points[0], number)
        air = median(best_trial(searched), "air") if self.air is None else self.air
        if np.isfinite(air) and (points_at_air := front(searched)):
            begin = trial_at_air(searched, air) or points_at_air[0]
            error = partial(
                error_at_air,
                air=air,
                stiffness=stiffness_limit(searched),
                failed=min(median(trial, FAILED_RUNS) for trial in least_failing(searched)),
            )
            search(
                lambda points: np.array(list(map(error, tried(points)))),
                np.array(begin.point),
                self.suite.tuning.starts,
            )
        if trials.best.cost >= FAILED_COST:
            message = f"{self.controller}: all {len(trials.all)} trials failed"
            raise ParameterError(message, remedy="search other ranges, or start from other gains")
        finalists = self.finalists(searched)
        best = min(finalists or searched, key=lambda trial: (trial.metrics is None, trial.order))
        values = self.values(best)
        cost, before = trials.costs(np.stack([space.point(np.array(list(values.values()))), first])).tolist()
        return TunedController(values, (cost, before), space.at_bound(best.point), tuple(trials.all), finalists)

    def _candidates(self, first: Vector) -> NDArray[np.float64]:
        """Points from which the searches start, shape (starts, candidates, parameters)."""
        tuning, space = self.suite.tuning, self.space
        inner = [i for i, name in enumerate(space.names) if name in self.wrapped]
        size = self.suite.tuning.starts, max(tuning.candidates, 2 if inner else 1), len(space)
        candidates = np.random.default_rng(tuning.seed).random(size)
        candidates[0, 0] = first
        if inner:  # the others nominal in one candidate, random in the others
            pairs = zip(space.names, space.nominal, strict=True)
            candidates[0, 1] = begin = space.point(np.array([self.wrapped.get(name, value) for name, value in pairs]))
            candidates[0][1::2, inner] = begin[inner]
        return candidates

    def finalists(self, trials: Sequence[Trial]) -> tuple[Trial, ...]:
        """The trials of least cost, evaluated on further runs; empty if the suite has no finalists."""
        tuning = self.suite.tuning
        if not tuning.finalists:
            return ()
        distinct = {tuple(self.values(trial).values()): trial for trial in reversed(trials)}
        chosen = dict(sorted(distinct.items(), key=lambda item: item[1].order)[: tuning.finalists])
        further = replace(self, runs=draw(self.runs.suite, tuning.finalist_runs, tuning.finalist_seed))
        return tuple(further.evaluate(np.array(list(chosen))).trials(np.array([t.point for t in chosen.values()])))

    def values(self, trial: Trial) -> dict[str, float]:
        """Values [SI] of a trial by name, rounded to six digits."""
        rounded = self.space.rounded(self.space.values(np.array(trial.point)[None])[0])
        return dict(zip(self.space.names, rounded.tolist(), strict=True))


def error_at_air(trial: Trial, *, air: float, stiffness: float, failed: float, penalty: float = 10.0) -> float:
    """Angle error [rad] of a trial, with a penalty on more air [m^3], stiffness error [N*m/rad] or failed runs.

    The penalty is relative to the excess of air or stiffness error.
    """
    if trial.metrics is None or median(trial, FAILED_RUNS) > failed:
        return FAILED_COST
    excess = max(median(trial, "air") / air - 1, 0) + max(median(trial, "stiffness_rmse") / stiffness - 1, 0)
    return median(trial, "angle_rmse") * (1 + penalty * excess)
