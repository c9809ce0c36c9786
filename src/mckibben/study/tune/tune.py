"""Tuning of scenario parameters."""

from __future__ import annotations

import hashlib
import json
import math
import os
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any, Protocol, Self

import jax
import numpy as np
from numpy.typing import NDArray

from mckibben.errors import FileError, ParameterError, Problem
from mckibben.storage.files import atomic_write, file_lock, make_folder
from mckibben.study.parameters import Distribution, Known, SweptParameter, sweep_parameters, with_values
from mckibben.study.scenario import Scenario
from mckibben.study.tune.cost import Cost, as_written, at_bound
from mckibben.study.tune.problem import FAILED_COST, TuningProblem, problem
from mckibben.study.tune.search import Method, by_cma, by_evolution, by_gradient, check_method


@dataclass(frozen=True)
class Trial:
    """A point that was tried: its place, its cost, and the derivative of the cost there, if it was asked for."""

    point: tuple[float, ...]
    cost: float
    gradient: tuple[float, ...] | None = None


class TuningHistory:
    """Trials in the order in which they were made; with a path, in a file too, one line of JSON each.

    A line is on disk before the search goes on. A search repeats itself exactly, so one that was interrupted is started
    again: what it asks for is answered from the file until something is new.

    Parameters
    ----------
    path
        The file; None keeps trials in memory alone.
    about
        All that makes the trials what they are; the file's first line.
    numbers
        How many numbers are searched.
    slopes
        Whether trials have derivatives.
    resume
        Whether to take up the file of an interrupted search.

    Raises
    ------
    FileError
        If there is such a file and it is not to be taken up, or there is none, or it is about something else, or its
        lines are no trials of this search.
    """

    def __init__(
        self, path: Path | None, about: Mapping[str, Any], *, numbers: int, slopes: bool, resume: bool = False
    ) -> None:
        self._path, self._lock, self._numbers, self._slopes = path, threading.Lock(), numbers, slopes
        self._known: dict[tuple[float, ...], Trial] = {}
        if path is None:
            return
        if resume:
            self._read(path, about)
        elif path.exists():
            remedy = "go on with it (--resume), or choose another folder"
            raise FileError(str(path), [Problem("there is the history of a search already", remedy=remedy)])
        else:
            with atomic_write(path, overwrite=True) as part:
                part.write_text(json.dumps(about) + "\n", encoding="utf-8")

    @classmethod
    @contextmanager
    def kept(
        cls, path: Path | None, about: Mapping[str, Any], *, numbers: int, slopes: bool, resume: bool = False
    ) -> Iterator[Self]:
        """A history that no other process writes to; its folder is made if need be.

        Raises
        ------
        FileError
            As for the class, and if another process is at it.
        """
        if path is None:
            yield cls(None, about, numbers=numbers, slopes=slopes)
            return
        if resume:
            _check_there(path)
        else:
            make_folder(path.parent)
        with file_lock(path.with_name(f".{path.name}.lock"), "going on with this search"):
            yield cls(path, about, numbers=numbers, slopes=slopes, resume=resume)

    @property
    def trials(self) -> list[Trial]:
        """All of them."""
        return list(self._known.values())

    @property
    def best(self) -> Trial:
        """The trial that costs least; of equals the first by place, so that it does not matter who came first."""
        return min(self._known.values(), key=lambda trial: (trial.cost, trial.point))

    def find(self, point: NDArray[np.float64]) -> Trial | None:
        """The trial at exactly this point."""
        return self._known.get(tuple(point.tolist()))

    def add(self, trials: list[Trial]) -> None:
        """Keep trials."""
        with self._lock:
            new = [trial for trial in trials if trial.point not in self._known]
            for trial in new:
                self._known[trial.point] = trial
            if self._path is None or not new:
                return
            lines = [json.dumps({"point": t.point, "cost": t.cost, "gradient": t.gradient}) + "\n" for t in new]
            with self._path.open("a", encoding="utf-8") as file:
                file.write("".join(lines))
                file.flush()
                os.fsync(file.fileno())

    def _read(self, path: Path, about: Mapping[str, Any]) -> None:
        _check_there(path)
        content = path.read_bytes()
        complete = content[: content.rfind(b"\n") + 1]  # a line that was cut off is tried again
        first, *rest = complete.decode("utf-8", "replace").split("\n")
        try:
            found = dict(json.loads(first))
        except (ValueError, TypeError) as error:
            problem = Problem(f"it is no history of a search: {error}", line=1, remedy="choose another folder")
            raise FileError(str(path), [problem]) from None
        wanted = json.loads(json.dumps(about))
        differing = sorted(name for name in {*wanted, *found} if wanted.get(name) != found.get(name))
        if differing:
            problems = [Problem(_difference(name, found.get(name), wanted.get(name))) for name in differing]
            raise FileError(str(path), problems)
        problems = []
        for number, line in enumerate(rest[:-1], start=2):
            try:
                trial = self._trial(line)
            except ValueError as error:
                remedy = "remove the line: what it said is tried again"
                problems.append(Problem(f"it is no trial of this search: {error}", line=number, remedy=remedy))
            else:
                self._known[trial.point] = trial
        if problems:
            raise FileError(str(path), problems)
        if complete != content:
            with path.open("rb+") as file:
                file.truncate(len(complete))

    def _trial(self, line: str) -> Trial:
        """The trial of a line; a ValueError if it is none of this search."""
        said = json.loads(line)
        if not isinstance(said, dict) or {*said} != {"point", "cost", "gradient"}:
            raise ValueError("it has no point, cost and gradient")
        point = self._floats("point", said["point"])
        if not all(0 <= place <= 1 for place in point):
            raise ValueError("its point is outside the ranges")
        if not (_is_number(said["cost"]) and math.isfinite(said["cost"])):
            raise ValueError("its cost is no number")
        if not self._slopes:
            if said["gradient"] is not None:
                raise ValueError("it has a gradient")
            return Trial(point, float(said["cost"]))
        return Trial(point, float(said["cost"]), self._floats("gradient", said["gradient"]))

    def _floats(self, what: str, values: Any) -> tuple[float, ...]:
        if not (isinstance(values, list) and all(_is_number(value) for value in values)):
            raise ValueError(f"its {what} is no list of numbers")
        if len(values) != self._numbers:
            raise ValueError(f"its {what} has {len(values)} numbers, not {self._numbers}")
        return tuple(float(value) for value in values)


def _check_there(path: Path) -> None:
    if not path.is_file():
        raise FileError(str(path), [Problem("there is no search to go on with", remedy="start it without --resume")])


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _difference(name: str, kept: Any, asked: Any) -> str:
    if len(str(kept)) + len(str(asked)) > 160:
        return f"it is a search that differs in {name}; nothing was changed"
    return f"it is a search with {name} {kept}, not {asked}; nothing was changed"


_MOST_SEED = 2**32 - 1  # what all methods take


@dataclass(frozen=True)
class TuningResult:
    """The outcome of a tuning.

    Attributes
    ----------
    values
        The numbers that were found, SI, by name; rounded to six digits in the unit in which they are written, unless
        that costs more.
    scenarios
        The scenarios with these numbers.
    cost, cost_before
        Of these, and of the first scenario's numbers in all scenarios (NaN where they were no allowed ones).
    evaluated
        How many points were tried.
    at_bound
        The names of numbers within 1 % of an end of their range: a wider range may hold better ones.
    trials
        All that was tried, in order.
    """

    values: dict[str, float]
    scenarios: tuple[Scenario, ...]
    cost: float
    cost_before: float
    evaluated: int
    at_bound: tuple[str, ...]
    trials: tuple[Trial, ...]


def tune(
    scenarios: Sequence[Scenario] | Scenario,
    over: Sequence[SweptParameter] | Mapping[str, Distribution],
    cost: Cost,
    *,
    method: Method = Method.GRADIENT,
    starts: int = 4,
    iterations: int = 30,
    population: int = 32,
    seed: int = 0,
    history: Path | None = None,
    resume: bool = False,
    known: Known = (),
    progress: Callable[[float], None] | None = None,
    least: Callable[[float], None] | None = None,
) -> Tuned:
    """Search numbers of scenarios, within ranges, for the least cost.

    Parameters
    ----------
    scenarios
        The runs that count, all at once; the search begins at the numbers of the first.
    over
        The numbers and their ranges, `Uniform` or `LogUniform`.
    cost
        Of the runs.
    method
        See `Method`.
    starts
        From how many points the gradient is followed; the first are the scenario's own numbers.
    iterations
        Steps of each descent, or generations.
    population
        Points a generation.
    seed
        Of the search; the same seed finds the same.
    history
        A file to keep every trial in; see `TuningHistory`.
    resume
        Go on with the search in that file.
    known
        TuningResult numbers of the plant that the controllers' models follow, "all" for all of them; none unless given.
    progress
        Called with the part that is done, 0 to 1; first when all that was asked for has been checked.
    least
        Called before `progress` with the least cost so far, once there is one.

    Raises
    ------
    ParameterError
        If a number is not in every scenario or has no range, the method cannot search so, the cost has no gradient to
        follow, or nothing that was tried has a cost.
    FileError
        If the history is there already, or is that of another search, is damaged, or another process goes on with it.
    """
    for name, count in (("starts", starts), ("iterations", iterations), ("population", population)):
        if isinstance(count, bool) or not isinstance(count, int) or count < 1:
            raise ParameterError(f"{name} is {count}", value=count, remedy="give a whole number from 1 up")
    if isinstance(seed, bool) or not isinstance(seed, int) or not 0 <= seed <= _MOST_SEED:
        raise ParameterError(f"seed is {seed}", value=seed, remedy=f"give a whole number, 0 to {_MOST_SEED}")
    several = [scenarios] if isinstance(scenarios, Scenario) else list(scenarios)
    ranges = sweep_parameters(several[0], over) if isinstance(over, Mapping) and several else list(over)  # type: ignore[arg-type]
    task = problem(several, ranges, cost, known)  # type: ignore[arg-type]
    check_method(method, numbers=len(task.over), population=population)
    if method is Method.GRADIENT:
        task.check_smooth()
    folder = Path() if history is None else history.parent
    about = {
        "kind": "tuning",
        "version": version("mckibben"),
        "scenarios or what they name": [(scenario.dumps(folder=folder), _digest(scenario)) for scenario in several],
        "parameters": [each.text for each in task.over],
        "known": known if known == "all" else sorted(known),
        "cost": cost.text,
        "gain margin": cost.gain_margin,
        "worst": cost.worst,
        "method": method.value,
        "seed": seed,
        **({} if method is Method.GRADIENT else {"population": population}),
    }
    slopes = method is Method.GRADIENT
    with TuningHistory.kept(history, about, numbers=len(task.over), slopes=slopes, resume=resume) as past:

        def report(part: float) -> None:
            if least and past.trials and past.best.cost < FAILED_COST:
                least(past.best.cost)
            if progress:
                progress(part)

        exact = _searched(task, past, method, starts, iterations, population, seed, report)
        return _tuned(task, past, exact)


def _searched(
    task: TuningProblem,
    past: TuningHistory,
    method: Method,
    starts: int,
    iterations: int,
    population: int,
    seed: int,
    report: Callable[[float], None],
) -> Callable[[NDArray[np.float64]], float]:
    """Search; the answer gives the cost of any numbers [SI]."""
    report(0.0)
    if method is Method.GRADIENT:
        found = _Descents(task, past, starts)
        first = task.point(task.nominal)
        by_gradient(found, first, starts=starts, iterations=iterations, seed=seed, progress=report)
        return found.exact
    tried = Generations(task, past, population)
    first = task.point(task.nominal)
    search = by_cma if method is Method.CMA else by_evolution
    search(tried, first, population=population, generations=iterations, seed=seed, progress=report)
    return tried.exact


def _tuned(task: TuningProblem, past: TuningHistory, exact: Callable[[NDArray[np.float64]], float]) -> Tuned:
    """The best of what was tried, in numbers that can be written down."""
    if past.best.cost >= FAILED_COST:
        raise ParameterError(
            f"none of the {len(past.trials)} points that were tried has a cost: their numbers are not allowed "
            "together, their runs did not stay finite, or a metric is not defined for them",
            remedy="search other ranges, from more starts, by another method or with another cost",
        )
    best = np.array(past.best.point)
    values = task.values(best[None])[0]
    rounded = as_written(task.over, values)
    before = exact(task.nominal)
    most = past.best.cost * (1 + 1e-3)
    if before > past.best.cost * (1 - 1e-9):  # rounding is not to make worse what was good
        most = min(most, max(before, past.best.cost))
    cost_after = exact(rounded)
    if cost_after > most:  # where six digits are too few, all are kept
        rounded, cost_after = values, past.best.cost
    named = dict(zip(task.names, rounded.tolist(), strict=True))
    return TuningResult(
        values=named,
        scenarios=tuple(with_values(scenario, named, known=task.known) for scenario in task.scenarios),
        cost=cost_after,
        cost_before=before if before < FAILED_COST else float("nan"),
        evaluated=len(past.trials),
        at_bound=at_bound(task.over, best),
        trials=tuple(past.trials),
    )


def _digest(scenario: Scenario) -> str:
    """Of all numbers that runs are made of: files that the scenario names, and the catalog, are in it."""
    leaves = jax.tree.leaves((scenario.plant(), scenario.control(), scenario.reference()))
    return hashlib.sha256(repr([np.asarray(leaf).tolist() for leaf in leaves]).encode()).hexdigest()


class _Descents:
    """Costs and gradients at points, from the history or from runs; always as many runs at once."""

    def __init__(self, task: TuningProblem, past: TuningHistory, starts: int) -> None:
        self._task, self._past, self._starts = task, past, starts

    def __call__(self, points: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        new = np.array([point for point in points if self._past.find(point) is None])
        if new.size:
            values = _padded(self._task.values(new), self._starts)
            costs, slopes = self._task.costs_and_gradients(values)
            gradients = self._task.to_unit(values, slopes)
            found = zip(new, costs.tolist(), gradients.tolist(), strict=False)
            self._past.add([Trial(tuple(point.tolist()), cost, tuple(slope)) for point, cost, slope in found])
        known = [self._past.find(point) for point in points]
        return np.array([t.cost for t in known]), np.array([t.gradient for t in known])  # type: ignore[union-attr]

    def exact(self, values: NDArray[np.float64]) -> float:
        """The cost of numbers [SI], which may lie outside their ranges."""
        return float(self._task.costs_and_gradients(_padded(values[None], self._starts))[0][0])


class Costed(Protocol):
    """What is searched in generations."""

    def values(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """The numbers [SI] at points, both of shape (n, numbers)."""
        ...

    def costs(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """The cost of each row of numbers [SI]."""
        ...


class Generations:
    """The costs of points, from the history or from runs; always as many runs at once, for one compiled program."""

    def __init__(self, task: Costed, past: TuningHistory, population: int) -> None:
        self._task, self._past, self._population = task, past, population

    def __call__(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        known = [self._past.find(point) for point in points]
        new = np.array([point for point, trial in zip(points, known, strict=True) if trial is None])
        for start in range(0, len(new), self._population):
            some = new[start : start + self._population]
            costs = self._costs(self._task.values(some))
            self._past.add([Trial(tuple(p.tolist()), float(c)) for p, c in zip(some, costs, strict=True)])
        return np.array([self._past.find(point).cost for point in points])  # type: ignore[union-attr]

    def exact(self, values: NDArray[np.float64]) -> float:
        """The cost of numbers [SI], which may lie outside their ranges."""
        return float(self._costs(values[None])[0])

    def _costs(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        return self._task.costs(_padded(values, self._population))[: len(values)]


def _padded(rows: NDArray[np.float64], count: int) -> NDArray[np.float64]:
    """The rows, and the last of them again up to a count: programs are compiled for one number of runs."""
    return np.concatenate([rows, np.repeat(rows[-1:], count - len(rows), axis=0)])
