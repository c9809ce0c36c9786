"""The ways to look for the least cost in the unit cube; each repeats itself exactly for the same seed."""

from __future__ import annotations

import enum
import importlib.util
import threading
import warnings
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from mckibben.errors import ParameterError

Points = NDArray[np.float64]
Costs = Callable[[Points], NDArray[np.float64]]
CostsAndGradients = Callable[[Points], tuple[NDArray[np.float64], Points]]
Progress = Callable[[float], None]

_LINE_SEARCH = 8  # points along a direction: where a loop chatters the slope is huge, and more would find no end
_STEP = 0.25
"""The first step of CMA-ES, as a part of each range."""


class Method(enum.Enum):
    """How to search.

    GRADIENT: L-BFGS-B from several starts. Few runs, and the exact end of a valley; finds the nearest valley of each
    start.

    EVOLUTION: differential evolution. Looks everywhere, needs many runs.

    CMA: the covariance matrix adaptation evolution strategy. Between the two; needs the package cmaes
    (``pip install mckibben[tune]``).
    """

    GRADIENT = "gradient"
    EVOLUTION = "evolution"
    CMA = "cma"


_LEAST = {Method.EVOLUTION: 5, Method.CMA: 4}
"""Points a generation."""


def check_method(method: Method, *, numbers: int, population: int) -> None:
    """Look whether a method can search, before anything is kept of its search.

    Raises
    ------
    ParameterError
        If its package is missing, or it needs more numbers to search, or more points a generation.
    """
    if method is Method.CMA and importlib.util.find_spec("cmaes") is None:
        raise ParameterError("CMA-ES needs the package cmaes", remedy="pip install 'mckibben[tune]'")
    if method is Method.CMA and numbers < 2:
        raise ParameterError("CMA-ES needs at least two numbers to search", remedy="use gradient or evolution")
    least = _LEAST.get(method, 1)
    if population < least:
        raise ParameterError(
            f"{method.value} with {population} points a generation", value=population, remedy=f"give at least {least}"
        )


def by_gradient(
    function: CostsAndGradients, first: Points, *, starts: int, iterations: int, seed: int, progress: Progress
) -> None:
    """L-BFGS-B from the first point, and from points spread over the cube; all descend side by side.

    References
    ----------
    R. H. Byrd, P. Lu, J. Nocedal and C. Zhu, "A limited memory algorithm for bound constrained optimization", SIAM J.
    Scientific Computing 16 (1995) 1190-1208; the implementation is `scipy.optimize.minimize`.
    """
    from scipy.optimize import minimize  # 0.3 s at import
    from scipy.stats import qmc

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the balance of a power of two does not matter here
        others = qmc.Sobol(first.size, rng=seed).random(starts - 1) if starts > 1 else []
    steps, counting = [0] * starts, threading.Lock()

    def count(number: int, reached: int) -> None:
        with counting:  # else a search may report less than another just has
            steps[number] = reached
            progress(sum(steps) / (starts * iterations))

    def descend(number: int, start: Points, ask: Callable[[Points], tuple[float, Points]]) -> None:
        minimize(
            ask,
            start,
            jac=True,
            method="L-BFGS-B",
            bounds=[(0.0, 1.0)] * start.size,
            callback=lambda _: count(number, steps[number] + 1),
            options={"maxiter": iterations, "maxls": _LINE_SEARCH},
        )
        count(number, iterations)

    side_by_side(function, [(lambda ask, i=i, x=x: descend(i, x, ask)) for i, x in enumerate([first, *others])])


def side_by_side(
    function: CostsAndGradients, searches: list[Callable[[Callable[[Points], tuple[float, Points]]], None]]
) -> None:
    """Run searches that each ask for one point at a time; what all of them wait for is computed together.

    Parameters
    ----------
    function
        Costs and gradients of points of shape (n, numbers).
    searches
        Each is called with a function that answers for one point.

    Raises
    ------
    BaseException
        What the function or a search raised, or an interruption; all searches have ended then.
    """
    meeting = threading.Condition()
    asked: dict[int, Points] = {}
    answers: dict[int, tuple[float, Points]] = {}
    active = set(range(len(searches)))
    failures: list[BaseException] = []

    def ask(number: int, point: Points) -> tuple[float, Points]:
        with meeting:
            asked[number] = np.array(point)
            meeting.notify_all()
            meeting.wait_for(lambda: number in answers or failures)
            if failures:
                raise failures[0]
            return answers.pop(number)

    def search(number: int) -> None:
        try:
            searches[number](lambda point: ask(number, point))
        except BaseException as error:  # handed on to the caller
            failures.append(error)
        finally:
            with meeting:
                active.discard(number)
                meeting.notify_all()

    threads = [threading.Thread(target=search, args=(i,), daemon=True) for i in range(len(searches))]
    for thread in threads:
        thread.start()
    try:
        while True:
            with meeting:
                meeting.wait_for(lambda: set(asked) == active or failures)
                if failures or not active:
                    break
                numbers = sorted(asked)
                points = np.stack([asked.pop(number) for number in numbers])
            costs, gradients = function(points)
            found = [(float(cost), slope) for cost, slope in zip(costs, gradients, strict=True)]
            with meeting:
                answers.update(zip(numbers, found, strict=True))
                meeting.notify_all()
    except BaseException as error:  # every search has to end, at an interruption too
        failures.insert(0, error)
    with meeting:
        meeting.notify_all()
    for thread in threads:
        thread.join()
    if failures:
        raise failures[0]


def by_evolution(
    function: Costs, first: Points, *, population: int, generations: int, seed: int, progress: Progress
) -> None:
    """Differential evolution from points spread over the cube, the first among them.

    References
    ----------
    R. Storn and K. Price, "Differential evolution", J. Global Optimization 11 (1997) 341-359; the implementation is
    `scipy.optimize.differential_evolution`.
    """
    from scipy.optimize import differential_evolution  # 0.3 s at import

    done = 0

    def stepped(*_: object) -> None:
        nonlocal done
        done += 1
        progress(min(done / generations, 1.0))

    differential_evolution(
        lambda columns: function(columns.T),
        [(0.0, 1.0)] * first.size,
        x0=first,
        init=np.random.default_rng(seed).uniform(0.0, 1.0, (population, first.size)),  # type: ignore[arg-type]
        maxiter=generations,
        vectorized=True,
        updating="deferred",
        polish=False,
        tol=0.0,
        rng=seed,
        callback=stepped,
    )
    if done < generations:  # all points cost the same
        progress(1.0)


def by_cma(function: Costs, first: Points, *, population: int, generations: int, seed: int, progress: Progress) -> None:
    """CMA-ES from the first point, which is tried itself in place of the first draw.

    References
    ----------
    N. Hansen, "The CMA evolution strategy: a tutorial", arXiv:1604.00772 (2016); the implementation is the package
    cmaes, which optuna's sampler stands on as well. (That one no longer lets a search begin at chosen numbers.)
    """
    from cmaes import CMA

    bounds = np.tile([0.0, 1.0], (first.size, 1))
    strategy = CMA(mean=first, sigma=_STEP, bounds=bounds, population_size=population, seed=seed)
    for generation in range(generations):
        points = np.stack([strategy.ask() for _ in range(population)])
        points[0] = first if generation == 0 else points[0]
        strategy.tell(list(zip(points, function(points).tolist(), strict=True)))
        progress((generation + 1) / generations)
