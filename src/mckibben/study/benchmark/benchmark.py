"""Controllers tuned with one budget and compared on the same unseen runs."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from dataclasses import dataclass, field
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

import equinox as eqx
import jax
import numpy as np
from numpy.typing import NDArray

from mckibben.control import Controller
from mckibben.errors import ParameterError
from mckibben.simulation import Batch, Metrics, Outcome, simulate_many
from mckibben.simulation.metrics import METRICS
from mckibben.study.benchmark.runs import Runs, draw
from mckibben.study.benchmark.suite import Suite, filename
from mckibben.study.parameters import Over, allowed, lanes
from mckibben.study.scenario import Scenario
from mckibben.study.sweep.result import spearman
from mckibben.study.tune.cost import Numbers, as_written, at_bound, nominal_of, point_of, values_at
from mckibben.study.tune.problem import LOST
from mckibben.study.tune.search import Method, by_cma, check_method
from mckibben.study.tune.tune import Generations, History, Trial

if TYPE_CHECKING:
    import xarray as xr


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
        return np.where(batch.failed, np.nan, batch.metrics[name])[self.started]

    def lost(self, controller: str) -> NDArray[np.bool_]:
        """Which of the runs that began the controller lost."""
        return self.batches[controller].failed[self.started]

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
        object.__setattr__(self, "_scenario", self.suite.scenario(self.controller, next(iter(self.suite.references))))

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
        found = np.where(np.isfinite(found) & ~batch.failed, np.minimum(found, LOST), LOST)
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
    scenario = runs.suite.scenario(controller, next(iter(runs.suite.references)))
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


MAIN = ("angle_rmse", "stiffness_rmse")
"""The errors that are set against those of the first controller."""
_RESAMPLED = 2000
_AT_ONCE = 2_000_000  # numbers
_SHOWN = {metric: name for name, (metric, _, _) in METRICS.items()}
_UNIT = {metric: unit for metric, _, unit in METRICS.values()}


def standing(contest: Contest) -> dict[str, Any]:
    """The statistics of a contest, as JSON has them.

    Parameters
    ----------
    contest
        What `compare` gave.

    Returns
    -------
    numbers
        ``suite``; ``runs``, of which ``not_begun`` no controller could begin; ``order``: controllers by their median
        cost. ``controllers``, by name: ``lost`` runs; ``metrics`` under the names and in the units in which they are
        shown: ``median`` and ``percentile_95`` over the runs that were not lost, and how many ``runs`` have a number;
        ``against_first``: for both errors the ratio of the medians, and the interval in which 95 % of 2000 resamplings
        of the runs lie; ``settled``: in how many ``runs`` the stiffness settled after its step, ``of`` how many that
        have one and were not lost; ``by_wish`` and ``by_joint``: medians of both errors; ``depends_on``: Spearman's
        rank correlation of both errors with each condition; ``tuned``: numbers [SI]; ``training_cost`` before and
        after; ``at_bound``.
    """
    names = list(contest.batches)
    median_cost = {name: float(np.median(contest.cost(name))) for name in names}
    return {
        "suite": contest.suite.name,
        "cost": contest.suite.tuning.cost,
        "runs": contest.runs.count,
        "not_begun": int((~contest.started).sum()),
        "order": sorted(names, key=lambda name: median_cost[name]),
        "controllers": {name: _of(contest, name, median_cost[name]) for name in names},
    }


def table_of(contest: Contest) -> xr.Dataset:
    """All runs of all controllers, along ``controller`` and ``run``: metrics and outcomes; along ``run`` the draws."""
    import xarray as xr

    batches = contest.batches
    names = list(batches)
    table: dict[str, Any] = {
        name: (("controller", "run"), np.stack([batches[each].metrics[name] for each in names]))
        for name in Metrics._fields
    }
    codes = np.stack([batches[each].table["outcome"].to_numpy() for each in names])
    flags = {key: batches[names[0]].table["outcome"].attrs[key] for key in ("flag_values", "flag_meanings")}
    table["outcome"] = (("controller", "run"), codes, flags)
    table["joint"] = ("run", np.array(contest.runs.joint, dtype=str))
    table["wish"] = ("run", np.array(contest.runs.wish, dtype=str))
    for name, values in contest.runs.conditions.items():
        table[name] = ("run", values)
    for wish, columns in contest.runs.wished.items():
        rows = np.array([each == wish for each in contest.runs.wish])
        for name, values in columns.items():
            column = table.get(name, ("run", np.full(contest.runs.count, np.nan)))[1]
            column[rows] = values
            table[name] = ("run", column)
    found = xr.Dataset(table, coords={"controller": names}, attrs={"title": contest.suite.name})
    found.attrs["tuned"] = json.dumps(contest.tuned)
    return found


def keep_table(contest: Contest, path: Path) -> None:
    """Write `table_of` to a NetCDF file, which appears whole or not at all."""
    from mckibben.dataset.schema import write_netcdf

    write_netcdf(table_of(contest), path)


def _of(contest: Contest, name: str, median_cost: float) -> dict[str, Any]:
    first = next(iter(contest.batches))
    wishes, joints = (np.array(each)[contest.started] for each in (contest.runs.wish, contest.runs.joint))
    errors = {metric: contest.metric(name, metric) for metric in MAIN}
    cost = contest.training_cost.get(name)
    stepped = np.isfinite(contest.metric(name, "coupling"))
    settled = stepped & np.isfinite(contest.metric(name, "stiffness_settling"))
    return {
        "lost": int(contest.lost(name).sum()),
        "median_cost": median_cost,
        "metrics": {_SHOWN[metric]: _spread(contest.metric(name, metric), _UNIT[metric]) for metric in Metrics._fields},
        "settled": {"runs": int(settled.sum()), "of": int(stepped.sum())},
        "against_first": {_SHOWN[metric]: _ratio(errors[metric], contest.metric(first, metric)) for metric in MAIN},
        "by_wish": _by(wishes, errors),
        "by_joint": _by(joints, errors),
        "depends_on": {
            condition: {_SHOWN[metric]: _correlation(values[contest.started], errors[metric]) for metric in MAIN}
            for condition, values in contest.runs.conditions.items()
            if condition != "sensors.seed"
        },
        "tuned": contest.tuned[name],
        "training_cost": None if cost is None else {"tuned": cost[0], "before": cost[1]},
        "at_bound": list(contest.at_bound[name]),
    }


def _spread(values: NDArray[np.float64], unit: float) -> dict[str, Any] | None:
    values = values[np.isfinite(values)] / unit
    if not values.size:
        return None
    median, high = np.percentile(values, [50, 95])
    return {"median": float(median), "percentile_95": float(high), "runs": int(values.size)}


def _ratio(values: NDArray[np.float64], first: NDArray[np.float64]) -> dict[str, float]:
    """Of the medians, lost runs counting as endless errors; and what resampling the runs makes of it."""
    values, first = (np.where(np.isfinite(each), each, np.inf) for each in (values, first))
    generator, ratios = np.random.default_rng(0), np.empty(0)
    with np.errstate(invalid="ignore", divide="ignore"):
        ratio = np.median(values) / np.median(first)
        while ratios.size < _RESAMPLED:  # some at once, as memory allows
            some = min(_RESAMPLED - ratios.size, max(_AT_ONCE // values.size, 1))
            rows = generator.integers(0, values.size, (some, values.size))
            found = np.median(values[rows], axis=1) / np.median(first[rows], axis=1)
            ratios = np.append(ratios, found)
    ratios = ratios[~np.isnan(ratios)]  # of two that are endless
    low, high = np.percentile(ratios, [2.5, 97.5], method="nearest") if ratios.size else (np.nan, np.nan)
    return {"ratio": float(ratio), "low": float(low), "high": float(high)}


def _by(groups: NDArray[Any], errors: dict[str, NDArray[np.float64]]) -> dict[str, dict[str, float | None]]:
    def median(values: NDArray[np.float64]) -> float | None:
        values = values[np.isfinite(values)]
        return float(np.median(values)) if values.size else None

    found = {}
    for group in dict.fromkeys(groups.tolist()):
        chosen = {metric: median(values[groups == group]) for metric, values in errors.items()}
        found[group] = {_SHOWN[m]: None if v is None else v / _UNIT[m] for m, v in chosen.items()}
    return dict(sorted(found.items()))


def _correlation(condition: NDArray[Any], error: NDArray[np.float64]) -> float | None:
    """Lost runs stand behind all others."""
    found = spearman(condition, np.where(np.isfinite(error), error, np.inf))
    return float(found) if np.isfinite(found) else None
