"""Bootstrap in blocks: the fit repeated on whole repeats, strokes or pressures drawn anew.

Each refit keeps the points where they are and counts them as often as their block was drawn, so that nothing is
compiled anew. It starts at the fit to all, and at the bottom of every other valley that a grid over the shape shows;
the best of what is reached counts, so that a draw is in another valley only where its points lie better there.

References
----------
A. Davison and D. Hinkley, "Bootstrap Methods and their Application", Cambridge 1997, sections 2.4 and 3.8;
T. Hesterberg, "What teachers should know about the bootstrap", The American Statistician 69 (2015) 371-386, for the
wider percentiles.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mckibben.errors import IdentificationError, RangeError
from mckibben.identification.fit import Fit
from mckibben.identification.intervals import (
    Interval,
    IntervalEstimate,
    Regression,
    check_level,
    law_forces,
    t_quantile,
)
from mckibben.identification.problem import FitProblem, Solution
from mckibben.identification.solvers import project, solve_between_bounds, solve_by_projection
from mckibben.identification.uncertainty import (
    CONDITION_LIMIT,
    Grouping,
    condition_number,
    finest_grouping,
    group_labels,
)
from mckibben.muscle import ForceLaw

FEWEST_BLOCKS = 8
"""Of blocks drawn with replacement: with fewer, the draws are too few and too alike."""
_MOST_FAILED = 0.1
_VALLEYS = 4  # besides that of the fit; those further up are left out
_APART = 1e-3  # in the unit cube: nearer positions are of one valley
_BETTER = 1e-6  # of the cost: by less, a valley is no better than that of the fit
_MIDDLE = (0.15865525393145707, 0.8413447460685429)  # of a normal distribution: one standard deviation to each side
_TAILS = 2.0  # standard deviation over half the middle range: 1 for normal draws, 1.5 for those of t with 3 degrees
_ENOUGH = 50  # draws to tell tails by


@dataclass(frozen=True, eq=False)
class Bootstrap:
    """Refits to blocks drawn anew.

    Attributes
    ----------
    law
        The fit to all points.
    by, blocks
        What was drawn, and from how many.
    draws
        Shape (refits, parameters), in SI, in the order of the law's parameters.
    failed
        Draws that left the law undetermined, and were drawn again.
    held
        Shape (parameters,): those that the fit to all has at a bound. They have no errors and no intervals.
    """

    law: ForceLaw
    by: Grouping
    blocks: int
    draws: NDArray[np.float64] = field(repr=False)
    failed: int
    at_bound: NDArray[np.bool_] = field(repr=False)

    @property
    def standard_errors(self) -> dict[str, float]:
        """By parameter, in SI: half the range of the middle 68 % of the draws, times sqrt(G/(G - 1)) for G blocks.

        For normal draws that is their standard deviation; outliers, named by `warnings`, have little effect.
        NaN where the parameter is at a bound.
        """
        errors = np.where(self.at_bound, np.nan, self._spread(self.draws))
        return dict(zip(self._names, errors.tolist(), strict=True))

    @property
    def warnings(self) -> tuple[str, ...]:
        """Sentences: of which parameters some draws lie so far off that no standard error describes them."""
        if len(self.draws) < _ENOUGH:
            return ()
        widths, spread = np.std(self.draws, axis=0, ddof=1) * self._correction, self._spread(self.draws)
        far = [
            f"{name} ({width / error:.2g} times)"
            for name, width, error, out in zip(self._names, widths, spread, self.at_bound, strict=True)
            if not out and width > _TAILS * error
        ]
        if not far:
            return ()
        return (
            "a few draws lie far off: with them the standard deviation is far above the standard error given, for "
            f"{', '.join(far)}; look at the draws, and rely on intervals or a profile",
        )

    def intervals(self, level: float = 0.95) -> dict[str, Interval]:
        """By parameter, in SI: percentiles of the draws, taken wider as Hesterberg has it for few blocks.

        NaN where the parameter is at a bound.
        """
        lower, upper = (np.where(self.at_bound, np.nan, ends) for ends in self._percentiles(self.draws, level))
        return {name: Interval(*ends) for name, *ends in zip(self._names, lower.tolist(), upper.tolist(), strict=True)}

    def force_intervals(self, contraction: ArrayLike, pressure: ArrayLike, *, level: float = 0.95) -> IntervalEstimate:
        """The force of the law [N] at contractions [-] and pressures [Pa], with percentiles of the refitted laws."""
        value = law_forces(type(self.law), [list(self._estimates)], contraction, pressure)[0]
        forces = law_forces(type(self.law), self.draws, contraction, pressure)
        lower, upper = self._percentiles(forces, level)
        return IntervalEstimate(
            level, value, self._spread(forces), np.full_like(value, self.blocks - 1.0), lower, upper
        )

    @property
    def _correction(self) -> float:
        return float(np.sqrt(self.blocks / (self.blocks - 1)))

    def _spread(self, draws: NDArray[np.float64]) -> NDArray[np.float64]:
        lower, upper = np.t_quantile(draws, _MIDDLE, axis=0)
        return (upper - lower) / 2 * self._correction

    def _percentiles(self, draws: NDArray[np.float64], level: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        from scipy.special import ndtr

        check_level(level)
        reach = float(t_quantile(level, self.blocks - 1)) * self._correction
        lower, upper = np.t_quantile(draws, [float(ndtr(-reach)), float(ndtr(reach))], axis=0)
        return lower, upper

    @property
    def _names(self) -> list[str]:
        return [p.name for p in type(self.law).parameters()]

    @property
    def _estimates(self) -> NDArray[np.float64]:
        return np.array([float(getattr(self.law, name)) for name in self._names])


def bootstrap(fit: Fit, refits: int = 500, *, seed: int = 0, by: Grouping | None = None) -> Bootstrap:
    """Repeat a fit on blocks of its points, drawn with replacement.

    Parameters
    ----------
    fit
        As `identify` returned it.
    refits
        How many.
    seed
        The same seed gives the same draws.
    by
        What is drawn. Unless said, whole repeats of the test if there are at least eight; else strokes, where
        directions, phases or repeats are known; else pressures; of these, too, there must be eight.

    Raises
    ------
    IdentificationError
        If there are too few blocks to draw from, or a tenth of the draws leave the law undetermined.
    RangeError
        If there are fewer than two refits.
    """
    if refits < 2:
        raise RangeError(f"{refits} refits have no spread", value=refits, lower=2, remedy="take some hundreds")
    regression = fit.require_regression()
    by, labels = _blocks(regression, by)
    blocks = int(labels.max()) + 1
    generator = np.random.default_rng(seed)
    starts = _starts(regression)
    draws: list[NDArray[np.float64]] = []
    failed = 0
    while len(draws) < refits:
        counts = generator.multinomial(blocks, np.full(blocks, 1 / blocks)).astype(np.float64)
        found = _refit(regression.problem.weighing(counts[labels]), starts, regression.solution.values)
        if found.converged and condition_number(found.jacobian[:, ~regression.at_bound]) < CONDITION_LIMIT:
            draws.append(found.values)
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


def _starts(regression: Regression) -> list[NDArray[np.float64]]:
    """Positions in the unit cube: that of the fit, then the bottoms of other valleys, best first."""
    from scipy.ndimage import minimum_filter  # 0.1 s, which no import of the package should wait for

    problem, starts = regression.problem, [regression.solution.position]
    axes = len(starts[0])
    if not axes:
        return starts
    grid = np.array(list(problem.cube.grid()))
    costs = np.array([project(problem, position).cost for position in grid])
    per_axis = (round(len(grid) ** (1 / axes)),) * axes
    lowest = costs == minimum_filter(costs.reshape(per_axis), size=3, mode="nearest").ravel()
    bottoms = np.flatnonzero(lowest & np.isfinite(costs))
    for i in bottoms[np.argsort(costs[bottoms], kind="stable")][: _VALLEYS + 1]:
        found = solve_by_projection(problem, grid[i])
        if found.converged and all(np.abs(found.position - known).max() > _APART for known in starts):
            starts.append(found.position)
    return starts


def _refit(problem: FitProblem, starts: list[NDArray[np.float64]], values: NDArray[np.float64]) -> Solution:
    """The best of what is reached from several positions; if nothing is, the trust region goes on from the values."""
    reached = [found for start in starts if (found := solve_by_projection(problem, start)).converged]
    if not reached:
        return solve_between_bounds(problem, values)
    best, *others = reached
    for other in others:
        if _cost(other) < (1 - _BETTER) * _cost(best):
            best = other
    return best


def _cost(solution: Solution) -> float:
    return float(solution.residuals @ solution.residuals)


def _blocks(regression: Regression, by: Grouping | None) -> tuple[Grouping, NDArray[np.int64]]:
    points = regression.points
    if by is None:
        by = Grouping.REPEAT if len(points.repeats) >= FEWEST_BLOCKS else finest_grouping(points)
    labels = group_labels(points, by)
    blocks = int(labels.max()) + 1
    if blocks < FEWEST_BLOCKS:
        raise IdentificationError(
            f"{by.counted(blocks)} are too few to draw from",
            value=blocks,
            lower=FEWEST_BLOCKS,
            remedy="repeat the test, or rely on Fit.intervals, which knows how little few groups say",
        )
    return by, labels
