"""Tune every controller of a suite with the same budget, then let all of them do the same unseen runs."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import dataclass, field
from importlib.metadata import version
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import numpy as np
from numpy.typing import NDArray

from mckibben.control import Controller
from mckibben.errors import ParameterError
from mckibben.simulation import Batch, Metrics, Outcome, simulate_many
from mckibben.study.comparison.checking import filename
from mckibben.study.comparison.runs import Runs, draw
from mckibben.study.comparison.suite import Suite
from mckibben.study.parameters import Over, allowed, lanes
from mckibben.study.scenario import Scenario
from mckibben.study.tuning.cube import Numbers, as_written, at_bound, nominal_of, point_of, values_at
from mckibben.study.tuning.history import History, Trial
from mckibben.study.tuning.problem import LOST
from mckibben.study.tuning.search import Method, by_cma, check_method
from mckibben.study.tuning.searching import Generations

_TUNING = 0.98  # of the time that a controller takes


@dataclass(frozen=True, eq=False)
class Contest:
    """What came of a suite.

    Attributes
    ----------
    suite
        Which.
    runs
        The unseen ones.
    tuned
        What tuning found for each controller: numbers [SI] by name; nothing for one that was taken as it is.
    training_cost
        Of each controller that was tuned, with these numbers; and before, with those of the file.
    at_bound
        Numbers of each controller that tuning left at an end of their range.
    batches
        What each controller did in the runs.
    """

    suite: Suite
    runs: Runs
    tuned: dict[str, dict[str, float]]
    training_cost: dict[str, tuple[float, float]]
    at_bound: dict[str, tuple[str, ...]]
    batches: dict[str, Batch]

    @property
    def started(self) -> NDArray[np.bool_]:
        """Which runs any controller could begin: the others are no fault of theirs. Shape (runs,)."""
        return _began(next(iter(self.batches.values())))

    def metric(self, controller: str, name: str) -> Numbers:
        """A metric [SI] of each run that began; NaN where the controller lost it."""
        batch = self.batches[controller]
        return np.where(batch.lost, np.nan, batch.metrics[name])[self.started]

    def lost(self, controller: str) -> NDArray[np.bool_]:
        """Which of the runs that began the controller lost."""
        return self.batches[controller].lost[self.started]

    def cost(self, controller: str) -> Numbers:
        """The cost of each run that began; 1e6 where it was lost."""
        names = self.suite.cost.metrics
        cost = self.suite.cost({name: self.metric(controller, name) for name in names})
        return np.where(np.isfinite(cost), cost, LOST)

    def scenario(self, controller: str, run: int) -> Scenario:
        """A run alone, with the tuned controller."""
        return self.runs.scenario(controller, run, self.tuned[controller])


def compare(
    suite: Suite,
    *,
    folder: Path | None = None,
    resume: bool = False,
    progress: Callable[[str, float], None] | None = None,
) -> Contest:
    """Compare the controllers of a suite.

    Parameters
    ----------
    suite
        Which.
    folder
        Where to keep what tuning tries, a file for each controller; nothing is kept without one.
    resume
        Go on with what is kept there.
    progress
        Called with what is being done, and the part of all that is done, 0 to 1.

    Raises
    ------
    ParameterError
        If a controller has nothing to tune, no point that was tried has a cost, or no run can begin.
    FileError
        If there are histories already and they are not to be taken up, or they are of another suite.
    """
    training, unseen = (draw(suite, each.runs, each.seed) for each in (suite.tuning, suite.unseen))
    names = list(suite.controllers)
    tuned: dict[str, dict[str, float]] = {}
    costs: dict[str, tuple[float, float]] = {}
    bounds: dict[str, tuple[str, ...]] = {}
    batches: dict[str, Batch] = {}
    for number, name in enumerate(names):

        def told(what: str, part: float, name: str = name, number: int = number) -> None:
            if progress:
                progress(f"{name}: {what}", (number + part) / len(names))

        varied = suite.tuned_over(name)
        if varied:
            task = _Task(suite, name, varied, training)
            tuned[name], costs[name], bounds[name] = _searched(
                task, folder, resume, lambda part: told("tuning", _TUNING * part)
            )
        else:
            tuned[name], bounds[name] = {}, ()
        told("unseen runs", _TUNING)
        batches[name] = judged(unseen, name, tuned[name])
        if not _began(batches[name]).any():
            raise _none_begins("unseen")
    if progress:
        progress("done", 1.0)
    return Contest(suite, unseen, tuned, costs, bounds, batches)


def judged(runs: Runs, controller: str, values: dict[str, float]) -> Batch:
    """What a controller with these numbers [SI] does in the runs."""
    return _simulated(runs, _controller(runs, controller, {name: [value] for name, value in values.items()}), 1)


def _began(batch: Batch) -> NDArray[np.bool_]:
    """Which runs could begin, whatever their controller; shape (runs,)."""
    return np.array([outcome is not Outcome.NO_START for outcome in batch.outcomes])


def _none_begins(which: str) -> ParameterError:
    return ParameterError(
        f"none of the {which} runs can begin: no pressures hold their plants where their wishes start",
        remedy="wish for other angles at the start, or change the joint or its load",
    )


@dataclass(frozen=True, eq=False)
class _Task:
    """What is searched for a controller: its numbers within ranges, and what they cost on the training runs."""

    suite: Suite
    controller: str
    over: tuple[Over, ...]
    runs: Runs
    _scenario: Scenario = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "_scenario", self.suite.scenario(self.controller, next(iter(self.suite.wishes))))

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(each.name for each in self.over)

    @property
    def nominal(self) -> Numbers:
        """The numbers [SI] of the file, or the middle of their ranges."""
        return nominal_of(self.over, [each.address.nominal for each in self.over])

    def values(self, points: Numbers) -> Numbers:
        """Numbers [SI] at points of the unit cube, shape (n, numbers)."""
        return values_at(self.over, points)

    def point(self, values: Numbers) -> Numbers:
        """The point of numbers [SI], moved into the ranges."""
        return point_of(self.over, values)

    def costs(self, values: Numbers) -> Numbers:
        """The mean cost of rows of numbers [SI] over the training runs that can begin."""
        table = dict(zip(self.names, values.T, strict=True))
        good = allowed(self._scenario, table)
        if not good.any():
            return np.full(len(values), LOST)
        table = {name: np.where(good, column, column[np.argmax(good)]) for name, column in table.items()}
        control = _controller(self.runs, self.controller, table)
        batch = _simulated(self.runs, control, len(values), self.suite.cost.metrics)
        found = self.suite.cost({name: batch.metrics[name] for name in self.suite.cost.metrics})
        found = np.where(np.isfinite(found) & ~batch.lost, np.minimum(found, LOST), LOST)
        began = _began(batch)
        if not began.any():
            raise _none_begins("training")
        shape = (len(values), self.runs.count)
        total = np.sum(np.where(began, found, 0.0).reshape(shape), axis=1)
        return np.where(good, total / began.reshape(shape).sum(axis=1), LOST)

    def about(self) -> dict[str, Any]:
        """All that makes a trial what it is."""
        leaves = jax.tree.leaves((self.runs.plant, self.runs.reference, self._scenario.control()))
        content = repr([np.asarray(leaf).tolist() for leaf in leaves if eqx.is_array_like(leaf)])
        tuning = self.suite.tuning
        return {
            "kind": "comparison",
            "version": version("mckibben"),
            "controller": self.controller,
            "runs": hashlib.sha256(content.encode()).hexdigest(),
            "duration": self.suite.duration,
            "control period": self.suite.control_period,
            "substeps": self.suite.substeps,
            "parameters": [each.text for each in self.over],
            "cost": tuning.cost,
            "population": tuning.population,
            "starts": tuning.starts,
        }


def _searched(
    task: _Task, folder: Path | None, resume: bool, progress: Callable[[float], None]
) -> tuple[dict[str, float], tuple[float, float], tuple[str, ...]]:
    """The best numbers [SI], their cost and that of the file's, and which of them are at an end of their range."""
    tuning = task.suite.tuning
    check_method(Method.CMA, numbers=max(len(task.over), 2), population=tuning.population)
    path = None if folder is None else folder / f"{filename(task.controller)}.jsonl"
    resumed = resume and path is not None and path.exists()
    with History.kept(path, task.about(), numbers=len(task.over), slopes=False, resume=resumed) as past:
        tried = Generations(task, past, tuning.population)
        first = task.point(task.nominal)
        tried(first[None])
        places = np.random.default_rng(tuning.seed).random((tuning.starts, len(task.over)))
        for start in range(tuning.starts):
            _cma(
                tried,
                first if start == 0 else places[start],
                tuning.population,
                tuning.generations,
                tuning.seed + start,
                lambda part, start=start: progress((start + part) / tuning.starts),
            )
        best = past.best
        if best.cost >= LOST:
            raise ParameterError(
                f"{task.controller}: none of the {len(past.trials)} points that were tried came through a run",
                remedy="search other ranges, or begin with other gains",
            )
        rounded = as_written(task.over, task.values(np.array(best.point)[None])[0])
        found = past.find(task.point(rounded)) or _tried(tried, task, past, rounded)
        before = past.find(first)
        assert before is not None  # it was tried first
        values = dict(zip(task.names, rounded.tolist(), strict=True))
        return values, (found.cost, before.cost), at_bound(task.over, best.point)


def _cma(
    tried: Generations, first: Numbers, population: int, generations: int, seed: int, progress: Callable[[float], None]
) -> None:
    if first.size >= 2:
        by_cma(tried, first, population=population, generations=generations, seed=seed, progress=progress)
        return
    # CMA-ES needs two numbers: a second one that does nothing.
    by_cma(
        lambda points: tried(points[:, :1]),
        np.append(first, 0.5),
        population=population,
        generations=generations,
        seed=seed,
        progress=progress,
    )


def _tried(tried: Generations, task: _Task, past: History, values: Numbers) -> Trial:
    point = task.point(values)
    tried(point[None])
    found = past.find(point)
    assert found is not None
    return found


def _controller(runs: Runs, controller: str, table: dict[str, Any]) -> Controller:
    """A controller with sets of numbers, each in all runs: arrays of shape (sets * runs,) where they are."""
    scenario = runs.suite.scenario(controller, next(iter(runs.suite.wishes)))
    if not table:
        return scenario.control()
    columns = {name: np.repeat(np.asarray(column), runs.count) for name, column in table.items()}
    return lanes(scenario, columns).control()


def _simulated(runs: Runs, controller: Controller, sets: int, metrics: tuple[str, ...] = Metrics._fields) -> Batch:
    def tiled(leaf: Any) -> Any:
        return np.tile(leaf, sets) if eqx.is_array_like(leaf) and np.ndim(leaf) == 1 else leaf

    suite = runs.suite
    plant, reference = jax.tree.map(tiled, (runs.plant, runs.reference)) if sets > 1 else (runs.plant, runs.reference)
    return simulate_many(
        plant,
        controller,
        reference,
        duration=suite.duration,
        control_period=suite.control_period,
        substeps=suite.substeps,
        metrics=metrics,
    )
