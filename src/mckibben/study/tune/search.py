"""Search methods on the unit cube; each is deterministic for a seed."""

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

_LINE_SEARCH = 8  # evaluations along a direction: a chattering loop has huge slopes, on which it would not end
_STEP = 0.25
"""Initial step of CMA-ES, relative to each range."""


class Method(enum.Enum):
    """Search method.

    GRADIENT: L-BFGS-B from several starts; few runs, local.

    EVOLUTION: differential evolution; global, many runs.

    CMA: covariance matrix adaptation evolution strategy, between the two; needs the package cmaes
    (``pip install mckibben[tune]``).
    """

    GRADIENT = "gradient"
    EVOLUTION = "evolution"
    CMA = "cma"


_MIN_POPULATION = {Method.EVOLUTION: 5, Method.CMA: 4}


def check_method(method: Method, *, numbers: int, population: int) -> None:
    """Check that a method can be used.

    Raises
    ------
    ParameterError
        If its package is missing, or there are too few parameters or points of a generation.
    """
    if method is Method.CMA and importlib.util.find_spec("cmaes") is None:
        raise ParameterError("CMA-ES needs the package cmaes", remedy="pip install 'mckibben[tune]'")
    if method is Method.CMA and numbers < 2:
        raise ParameterError("CMA-ES needs at least two parameters", remedy="use gradient or evolution")
    least = _MIN_POPULATION.get(method, 1)
    if population < least:
        raise ParameterError(
            f"{method.value} with {population} points a generation", value=population, remedy=f"give at least {least}"
        )


def by_gradient(
    function: CostsAndGradients, first: Points, *, starts: int, iterations: int, seed: int, progress: Progress
) -> None:
    """L-BFGS-B from the first point and from Sobol points, side by side.

    References
    ----------
    R. H. Byrd, P. Lu, J. Nocedal and C. Zhu, "A limited memory algorithm for bound constrained optimization", SIAM J.
    Scientific Computing 16 (1995) 1190-1208; the implementation is `scipy.optimize.minimize`.
    """
    from scipy.optimize import minimize  # 0.3 s at import
    from scipy.stats import qmc

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # Sobol points need not be a power of two here
        others = qmc.Sobol(first.size, rng=seed).random(starts - 1) if starts > 1 else []
    steps, counting = [0] * starts, threading.Lock()

    def count(number: int, reached: int) -> None:
        with counting:  # so that progress never decreases
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
    """Run searches in threads and evaluate the points that all of them wait for together.

    Parameters
    ----------
    function
        Costs and gradients of points of shape (n, parameters).
    searches
        Each is called with a function that evaluates one point.

    Raises
    ------
    BaseException
        Exception of the function or a search, or an interruption, after all searches have ended.
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
        except BaseException as error:  # raised again by the caller
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
    except BaseException as error:  # end every search, also at an interruption
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
    """Differential evolution from random points and the first one.

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
    if done < generations:  # ended early: all costs are equal
        progress(1.0)


def by_cma(function: Costs, first: Points, *, population: int, generations: int, seed: int, progress: Progress) -> None:
    """CMA-ES from the first point, which replaces the first draw.

    References
    ----------
    N. Hansen, "The CMA evolution strategy: a tutorial", arXiv:1604.00772 (2016); the implementation is the package
    cmaes.
    """
    from cmaes import CMA

    bounds = np.tile([0.0, 1.0], (first.size, 1))
    strategy = CMA(mean=first, sigma=_STEP, bounds=bounds, population_size=population, seed=seed)
    for generation in range(generations):
        points = np.stack([strategy.ask() for _ in range(population)])
        points[0] = first if generation == 0 else points[0]
        strategy.tell(list(zip(points, function(points).tolist(), strict=True)))
        progress((generation + 1) / generations)
