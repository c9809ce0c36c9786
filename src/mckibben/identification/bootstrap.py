"""Block bootstrap: refits to whole repeats, strokes or pressures drawn with replacement.

A refit weights each point by how often its block was drawn, so nothing is recompiled. It starts from the fit to all
points and from the other local minima over the shape parameters, and keeps the best.

References
----------
A. Davison and D. Hinkley, "Bootstrap Methods and their Application", Cambridge 1997, sections 2.4 and 3.8;
T. Hesterberg, "What teachers should know about the bootstrap", The American Statistician 69 (2015) 371-386, for the
expanded percentile interval.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from mckibben.errors import IdentificationError, RangeError
from mckibben.identification.fit import Fit
from mckibben.identification.intervals import Interval, t_quantile
from mckibben.identification.least_squares import FitProblem, Solution, grid_costs, solve
from mckibben.identification.monotone import monotone
from mckibben.identification.regression import Regression
from mckibben.identification.uncertainty import (
    CONDITION_LIMIT,
    Bools,
    Floats,
    Grouping,
    Ints,
    condition_number,
    finest_grouping,
    group_labels,
)
from mckibben.muscle import ForceLaw

_FEWEST_BLOCKS = 8  # with fewer, the draws are too few and too similar
_MOST_FAILED = 0.1
_OTHER_MINIMA = 4
_APART = 1e-3  # in the unit cube: closer positions count as one minimum
_BETTER = 1e-6  # relative improvement in cost required of another minimum
_CENTRAL = (0.15865525393145707, 0.8413447460685429)  # one standard deviation to each side of a normal distribution
_HEAVY_TAILS = 2.0  # standard deviation over half the central range: 1 for normal draws, 1.5 for t with 3 degrees
_ENOUGH = 50  # fewest draws to judge the tails


@dataclass(frozen=True, eq=False)
class Bootstrap:
    """Refits to resampled blocks.

    Attributes
    ----------
    law, at_bound
        Fit to all points, and mask of its parameters at a bound, shape (parameters,), which have no errors or
        intervals.
    draws
        Shape (refits, parameters), in SI, in the order of the law's parameters.
    failed
        Number of draws that did not determine the law and were repeated.
    """

    law: ForceLaw
    by: Grouping
    blocks: int
    draws: Floats = field(repr=False)
    failed: int
    at_bound: Bools = field(repr=False)

    @property
    def standard_errors(self) -> dict[str, float]:
        """By parameter, in SI: half the central 68 % range of the draws, times sqrt(G/(G - 1)) for G blocks.

        For normal draws this is their standard deviation; a few outliers hardly affect it. NaN at a bound.
        """
        errors = np.where(self.at_bound, np.nan, self._deviation(self.draws))
        return dict(zip(self._names, errors.tolist(), strict=True))

    @property
    def warnings(self) -> tuple[str, ...]:
        """Parameters whose distribution has tails too heavy for a standard error."""
        if len(self.draws) < _ENOUGH:
            return ()
        total, central = np.std(self.draws, axis=0, ddof=1) * self._correction, self._deviation(self.draws)
        heavy = [
            f"{name} ({width / error:.2g} times)"
            for name, width, error, out in zip(self._names, total, central, self.at_bound, strict=True)
            if not out and width > _HEAVY_TAILS * error
        ]
        if not heavy:
            return ()
        return (
            "the draws have heavy tails: their standard deviation is far above the stated standard error, for "
            f"{', '.join(heavy)}; look at the draws, and rely on intervals or a profile",
        )

    def intervals(self, level: float = 0.95) -> dict[str, Interval]:
        """Expanded percentile intervals (Hesterberg) by parameter, in SI; NaN at a bound."""
        from scipy.special import ndtr

        z = float(t_quantile(level, self.blocks - 1)) * self._correction
        ends = np.where(self.at_bound, np.nan, np.quantile(self.draws, [float(ndtr(-z)), float(ndtr(z))], axis=0)).T
        return {name: Interval(*one) for name, one in zip(self._names, ends.tolist(), strict=True)}

    @property
    def _correction(self) -> float:
        return float(np.sqrt(self.blocks / (self.blocks - 1)))

    def _deviation(self, draws: Floats) -> Floats:
        lower, upper = np.quantile(draws, _CENTRAL, axis=0)
        return (upper - lower) / 2 * self._correction

    @property
    def _names(self) -> list[str]:
        return [p.name for p in type(self.law).parameters()]


def bootstrap(fit: Fit, refits: int = 500, *, seed: int = 0, by: Grouping | None = None) -> Bootstrap:
    """Refit the law of a `Fit` to blocks of its points drawn with replacement.

    Parameters
    ----------
    by
        Kind of block. Default: repeats of the test if there are at least eight; else strokes, where directions, phases
        or repeats are known; else pressures.

    Raises
    ------
    IdentificationError
        If there are fewer than eight blocks, or a tenth of the draws do not determine the law.
    RangeError
        If there are fewer than two refits.
    """
    if refits < 2:
        raise RangeError(
            f"{refits} refits do not give a distribution", value=refits, lower=2, remedy="use several hundred"
        )
    regression = fit.require_regression()
    by, labels = _blocks(regression, by)
    blocks = int(labels.max()) + 1
    generator = np.random.default_rng(seed)
    starts = _starts(regression)
    draws: list[Floats] = []
    failed = 0
    while len(draws) < refits:
        counts = generator.multinomial(blocks, np.full(blocks, 1 / blocks)).astype(np.float64)
        found = _refit(regression.problem.weighted(counts[labels]), starts)
        if found.converged and condition_number(found.triangle[:, ~regression.at_bound]) < CONDITION_LIMIT:
            sloped = monotone(found, fit.law.domain) if regression.problem.prior is not None else None
            draws.append((sloped or found).values)
            continue
        failed += 1
        if failed > _MOST_FAILED * refits:
            raise IdentificationError(
                f"{failed} of {len(draws) + failed} draws of {by.counted(blocks)} do not determine "
                f"{type(fit.law).__name__}",
                value=failed,
                upper=_MOST_FAILED * refits,
                remedy="measure at more pressures or repeat the test, or rely on Fit.intervals",
            )
    return Bootstrap(fit.law, by, blocks, np.array(draws), failed, regression.at_bound)


def _starts(regression: Regression) -> list[Floats]:
    """Position of the fit in the unit cube, then other local minima, best first."""
    from scipy.ndimage import minimum_filter  # takes 0.1 s to import

    problem, starts = regression.problem, [regression.solution.position]
    axes = len(starts[0])
    if not axes:
        return starts
    grid = problem.cube.grid()
    costs = grid_costs(problem, grid)
    per_axis = (round(len(grid) ** (1 / axes)),) * axes
    lowest = costs == minimum_filter(costs.reshape(per_axis), size=3, mode="nearest").ravel()
    bottoms = np.flatnonzero(lowest & np.isfinite(costs))
    for i in bottoms[np.argsort(costs[bottoms], kind="stable")][: _OTHER_MINIMA + 1]:
        found = solve(problem, grid[i])
        if found.converged and all(np.abs(found.position - known).max() > _APART for known in starts):
            starts.append(found.position)
    return starts


def _refit(problem: FitProblem, starts: list[Floats]) -> Solution:
    """Best solution from several starts; the first of equally good ones."""
    best, *others = sorted((solve(problem, start) for start in starts), key=lambda found: not found.converged)
    for other in others:
        if other.converged and other.cost < (1 - _BETTER) * best.cost:
            best = other
    return best


def _blocks(regression: Regression, by: Grouping | None) -> tuple[Grouping, Ints]:
    points = regression.points
    if by is None:
        by = Grouping.REPEAT if len(points.repeats) >= _FEWEST_BLOCKS else finest_grouping(points)
    labels = group_labels(points, by)
    blocks = int(labels.max()) + 1
    if blocks < _FEWEST_BLOCKS:
        message = f"{by.counted(blocks)} are too few to draw from"
        remedy = "repeat the test, or rely on Fit.intervals, which allows for few groups"
        raise IdentificationError(message, value=blocks, lower=_FEWEST_BLOCKS, remedy=remedy)
    return by, labels
