"""Search methods: CMA-ES, and a local refinement."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

Vector: TypeAlias = NDArray[np.float64]
Costs: TypeAlias = Callable[[Vector], Vector]
"""Costs of points of the unit cube, shape (n, parameters)."""
Search: TypeAlias = Callable[..., object]
"""Search method, called with `Costs` and the first point, and by keyword with `population`, `generations`, `seed` and
`progress`, which takes the completed fraction."""


def by_cma(
    costs: Costs,
    first: Vector,
    *,
    population: int,
    generations: int,
    seed: int,
    progress: Callable[[float], object],
    step: float = 0.25,
) -> None:
    """Search by CMA-ES (Hansen, arXiv:1604.00772) from the first point, which replaces the first draw.

    It ends before its last generation where the points or their costs agree (section B.3 there).

    Parameters
    ----------
    costs
        Costs of points of the unit cube, shape (n, parameters).
    first
        First point, shape (parameters,).
    population, generations
        Points per generation, and number of generations.
    seed
        Seed of the draws; a longer search begins with the points of a shorter one.
    progress
        Called with the completed fraction, 0 to 1.
    step
        Initial standard deviation as a share of each range.
    """
    from cmaes import CMA

    count = first.size
    mean = first if count > 1 else np.append(first, 0.5)  # it needs two parameters: the second is without effect
    bounds = np.tile([0.0, 1.0], (mean.size, 1))
    strategy = CMA(mean=mean, sigma=step, bounds=bounds, population_size=population, seed=seed)
    for generation in range(generations):
        points = np.stack([strategy.ask() for _ in range(population)])
        points[0] = mean if generation == 0 else points[0]
        strategy.tell(list(zip(points, costs(points[:, :count]).tolist(), strict=True)))
        progress((generation + 1) / generations)
        if strategy.should_stop():
            break


def by_simplex(
    costs: Costs,
    first: Vector,
    *,
    population: int,
    generations: int,
    seed: int,
    progress: Callable[[float], object],
    step: float = 0.05,
) -> None:
    """Refine the first point by the simplex of Nelder and Mead (Computer J. 7 (1965) 308), inside the unit cube.

    The edges of the first simplex are a share `step` of each range.
    """
    from scipy.optimize import minimize  # 0.3 s at import

    steps = itertools.count(1)
    sides = np.where(first < 0.5, step, -step) * np.eye(first.size)
    minimize(
        lambda point: costs(point[None])[0],
        first,
        method="Nelder-Mead",
        bounds=[(0.0, 1.0)] * first.size,
        callback=lambda _: progress(min(next(steps) / generations, 1.0)),
        options={"maxiter": generations, "initial_simplex": np.vstack([first, first + sides])},
    )


SEARCHES: dict[str, Search] = {"cma": by_cma, "local": by_simplex}
"""Search methods by name: CMA-ES, and the simplex of Nelder and Mead around the given values, with few runs."""
