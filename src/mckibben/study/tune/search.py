"""Search methods: CMA-ES, and a local refinement."""

from __future__ import annotations

import enum
import itertools
from collections.abc import Callable
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from mckibben.errors import ParameterError, quoted, suggest

Vector: TypeAlias = NDArray[np.float64]
Costs: TypeAlias = Callable[[Vector], Vector]
"""Costs of points of the unit cube, shape (n, parameters)."""
Search: TypeAlias = Callable[..., object]
"""Search method, called with `Costs` and the first point, and by keyword with `population`, `generations`, `seed` and
`progress`, which takes the completed fraction."""

_STEP, _LOCAL_STEP = 0.25, 0.05  # initial steps of CMA-ES and of the refinement, relative to each range
_MIN_POPULATION = 4


class Method(enum.Enum):
    """Search method.

    CMA: covariance matrix adaptation evolution strategy.

    LOCAL: refinement of the given values by the simplex of Nelder and Mead; few runs.
    """

    CMA = "cma"
    LOCAL = "local"

    @classmethod
    def _missing_(cls, value: object) -> None:
        known = [method.value for method in cls]
        remedy = suggest(value, known) if isinstance(value, str) else f"give one of {', '.join(known)}"
        raise ParameterError(f"method is {quoted(value)}", field="method", value=value, remedy=remedy)


def check_population(population: int) -> None:
    """Raise `ParameterError` for fewer points per generation than CMA-ES needs."""
    if population < _MIN_POPULATION:
        message = f"CMA-ES with {population} points per generation"
        raise ParameterError(message, value=population, remedy=f"give at least {_MIN_POPULATION}")


def by_cma(
    costs: Costs,
    first: Vector,
    *,
    population: int,
    generations: int,
    seed: int,
    progress: Callable[[float], object],
) -> None:
    """Search by CMA-ES (Hansen, arXiv:1604.00772) from the first point, which replaces the first draw."""
    from cmaes import CMA

    count = first.size
    mean = first if count > 1 else np.append(first, 0.5)  # it needs two parameters: the second is without effect
    bounds = np.tile([0.0, 1.0], (mean.size, 1))
    strategy = CMA(mean=mean, sigma=_STEP, bounds=bounds, population_size=population, seed=seed)
    for generation in range(generations):
        points = np.stack([strategy.ask() for _ in range(population)])
        points[0] = mean if generation == 0 else points[0]
        strategy.tell(list(zip(points, costs(points[:, :count]).tolist(), strict=True)))
        progress((generation + 1) / generations)


def by_simplex(
    costs: Costs,
    first: Vector,
    *,
    population: int,
    generations: int,
    seed: int,
    progress: Callable[[float], object],
) -> None:
    """Refine the first point by the simplex of Nelder and Mead (Computer J. 7 (1965) 308), inside the unit cube."""
    from scipy.optimize import minimize  # 0.3 s at import

    steps = itertools.count(1)
    sides = np.where(first < 0.5, _LOCAL_STEP, -_LOCAL_STEP) * np.eye(first.size)
    minimize(
        lambda point: costs(point[None])[0],
        first,
        method="Nelder-Mead",
        bounds=[(0.0, 1.0)] * first.size,
        callback=lambda _: progress(min(next(steps) / generations, 1.0)),
        options={"maxiter": generations, "initial_simplex": np.vstack([first, first + sides])},
    )


SEARCHES: dict[Method, Search] = {Method.CMA: by_cma, Method.LOCAL: by_simplex}
