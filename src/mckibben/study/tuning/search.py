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
    steps = [0] * starts

    def descend(number: int, start: Points, ask: Callable[[Points], tuple[float, Points]]) -> None:
        def stepped(_: object) -> None:
            steps[number] += 1
            progress(sum(steps) / (starts * iterations))

        minimize(
            ask,
            start,
            jac=True,
            method="L-BFGS-B",
            bounds=[(0.0, 1.0)] * start.size,
            callback=stepped,
            options={"maxiter": iterations},
        )
        steps[number] = iterations
        progress(sum(steps) / (starts * iterations))

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
    """
    meeting = threading.Condition()
    asked: dict[int, Points] = {}
    answers: dict[int, tuple[float, Points] | BaseException] = {}
    active = set(range(len(searches)))
    failures: list[BaseException] = []

    def ask(number: int, point: Points) -> tuple[float, Points]:
        with meeting:
            asked[number] = np.array(point)
            meeting.notify_all()
            meeting.wait_for(lambda: number in answers)
            answer = answers.pop(number)
        if isinstance(answer, BaseException):
            raise answer
        return answer

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
    while True:
        with meeting:
            meeting.wait_for(lambda: set(asked) == active)
            if not active:
                break
            numbers = sorted(asked)
            points = np.stack([asked.pop(number) for number in numbers])
        try:
            costs, gradients = function(points)
            found: list[tuple[float, Points] | BaseException] = [
                (float(cost), slope) for cost, slope in zip(costs, gradients, strict=True)
            ]
        except BaseException as error:  # every search has to end, an interruption included
            found = [error] * len(numbers)
        with meeting:
            answers.update(zip(numbers, found, strict=True))
            meeting.notify_all()
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


def by_cma(function: Costs, first: Points, *, population: int, generations: int, seed: int, progress: Progress) -> None:
    """CMA-ES from the first point.

    Raises
    ------
    ParameterError
        If its package is missing, or there is only one number to search, or less than four points a generation.

    References
    ----------
    N. Hansen, "The CMA evolution strategy: a tutorial", arXiv:1604.00772 (2016); the implementation is the package
    cmaes, which optuna's sampler stands on as well. (That one no longer lets a search begin at chosen numbers.)
    """
    if importlib.util.find_spec("cmaes") is None:
        raise ParameterError("CMA-ES needs the package cmaes", remedy="pip install 'mckibben[tune]'")
    if first.size < 2:
        raise ParameterError("CMA-ES needs at least two numbers to search", remedy="use gradient or evolution")
    if population < 4:
        raise ParameterError(f"CMA-ES with {population} points a generation", remedy="give at least 4")
    from cmaes import CMA

    bounds = np.tile([0.0, 1.0], (first.size, 1))
    strategy = CMA(mean=first, sigma=_STEP, bounds=bounds, population_size=population, seed=seed)
    for generation in range(generations):
        points = np.stack([strategy.ask() for _ in range(population)])
        strategy.tell(list(zip(points, function(points).tolist(), strict=True)))
        progress((generation + 1) / generations)
