"""Outliers among measured points: points that contradict the smooth surface through all others.

The surface is Eq. 2 with smooth deviations (`SmoothLaw`), so that the misfit of a force law does not count.
Each point is tested by its externally studentised residual, that of the fit without it, one point after the other (of
thousands, one in a thousand at once); the last significant one is the last outlier, because outliers may mask each
other. Where the surface itself misfits, neighbours of the point are off it, too: an outlier stands out from them.

References
----------
B. Rosner, "Percentage points for a generalized ESD many-outlier procedure", Technometrics 25 (1983) 165-172; R. Cook
and S. Weisberg, "Residuals and Influence in Regression", Chapman and Hall 1982, section 2.2.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from mckibben.dataset import IsobaricDataset
from mckibben.identification.estimator import Bools, Floats
from mckibben.identification.least_squares import FitProblem, grid_search, solve
from mckibben.identification.mixed_model import MixedModel
from mckibben.identification.smooth import Deviations
from mckibben.identification.summary import CONTRACTION_NOISE, Outlier
from mckibben.muscle import ExponentialLaw


@functools.lru_cache(maxsize=1)  # of several laws
def find_outliers(
    means: IsobaricDataset,
    *,
    significance: float = 0.01,
    smallest: float = 0.005,
    most: float = 0.05,
    ahead: int = 2,
    fewest: int = 12,
) -> tuple[Outlier, ...]:
    """Outliers among the taut points of a dataset, in the order of its rows.

    Parameters
    ----------
    means
        Points; directions and phases, if any, each have an offset from the surface.
    significance
        Probability of any outlier among good points (Bonferroni).
    smallest
        Smallest error of an outlier, relative to the largest force: that of a load cell.
    most
        Largest share of outliers: more are not isolated errors, and none is left out.
    ahead
        Number of further points that are tested after the last significant one.
    fewest
        Number of points below which none is tested.

    Examples
    --------
    >>> from mckibben import catalog
    >>> data = catalog.dataset("festo-tool-10mm")
    >>> force = data.force.copy()
    >>> force[30] *= 1.12
    >>> [outlier.row for outlier in find_outliers(IsobaricDataset(data.table.assign(force=("point", force))))]
    [31]
    """
    points = means.taut
    rows = np.flatnonzero(~means.slack)
    measured = points.force
    remaining, outlying, pending = np.ones(len(points), bool), [], []
    limit, together = max(1, int(most * len(points))), max(1, len(points) // 1000)  # at once, of thousands
    starts: Sequence[Floats] = ()
    least = np.maximum(smallest * float(measured.max(initial=0.0)), _loop_widths(points))
    while np.count_nonzero(remaining) >= fewest and len(outlying) + len(pending) < limit + ahead:
        tested = _test(points, remaining, least[remaining], starts)
        if tested is None:
            break
        errors, sizes = tested.errors, tested.sizes
        starts = (tested.hyperparameters,) if tested.hyperparameters.size else ()
        order = np.argsort(-sizes, kind="stable")[:together]
        if not sizes[order[0]]:  # no error is large enough
            break
        significant = order[[tested.stands_out(i, significance) for i in order.tolist()]]
        worst = significant if significant.size else order[:1]
        at = np.flatnonzero(remaining)[worst]
        pending += zip(at.tolist(), errors[worst].tolist(), strict=True)
        remaining[at] = False
        if significant.size:
            outlying, pending = [*outlying, *pending], []
        elif len(pending) == ahead:
            break
    if len(outlying) > limit:
        return ()
    return tuple(
        Outlier(
            int(rows[i]) + 1,
            float(points.pressure[i]),
            float(points.contraction[i]),
            float(measured[i]),
            float(measured[i]) - error,
            means.place(int(rows[i])),
        )
        for i, error in sorted(outlying)
    )


def without_outliers(means: IsobaricDataset, outliers: Sequence[Outlier]) -> IsobaricDataset:
    """Dataset without the rows of the outliers."""
    rows = [outlier.row for outlier in outliers]
    return means.select(~np.isin(np.arange(len(means)) + 1, rows)) if rows else means


class _Tested(NamedTuple):
    """Surface through points, its errors [N] at each without it, and their studentised sizes, 0 for small errors."""

    points: IsobaricDataset
    model: MixedModel
    hyperparameters: Floats
    errors: Floats
    sizes: Floats

    def stands_out(self, at: int, significance: float, *, nearest: int = 8, ratio: float = 2.0) -> bool:
        """Whether a residual is significant, and larger than a `ratio` of those of the `nearest` points without it."""
        from scipy.special import stdtrit

        limit = float(stdtrit(self.model.freedom - 1, 1 - significance / (2 * len(self.sizes))))  # Bonferroni
        if self.sizes[at] <= limit:
            return False
        others = np.arange(len(self.sizes)) != at
        residuals = self.model.select(others).deleted_residuals(self.hyperparameters)[1]
        axes = [axis / (np.ptp(axis) or 1.0) for axis in (self.points.contraction, self.points.pressure)]
        distances = np.sum([(axis - axis[at])[others] ** 2 for axis in axes], axis=0)
        around = np.argsort(distances, kind="stable")[:nearest]
        return bool(self.sizes[at] > ratio * np.abs(residuals[around]).max())


def _test(
    points: IsobaricDataset, remaining: Bools, smallest: Floats, starts: Sequence[Floats], *, surface_points: int = 28
) -> _Tested | None:
    """Test of the remaining points; None with small errors of Eq. 2 or few points.

    Fewer than `surface_points` are compared with Eq. 2 alone. An error that a small one of the contraction explains is
    that of its measurement.
    """
    eq2 = FitProblem.of(ExponentialLaw, points).subset(remaining)
    base, used = solve(eq2, grid_search(eq2)), points.select(remaining)
    moved = replace(eq2, contraction=eq2.contraction + CONTRACTION_NOISE).response(base.values)[0]
    smallest = np.maximum(smallest, np.abs(moved - base.residuals))
    if not np.any(np.abs(base.residuals) > smallest):
        return None
    surface = len(used) >= surface_points and bool(np.ptp(used.contraction)) and bool(np.ptp(used.pressure))
    if surface:
        deviations = Deviations.of(points, base)
        model = deviations.prior.model(*deviations.columns(base))
        model = MixedModel(np.hstack([model.fixed, _passes(used)]), model.random, model.residuals, model.scales)
        hyperparameters = model.estimate(starts or deviations.prior.starts, deviations.prior.bounds)[0]
    else:
        residuals, columns = base.augmented
        none = np.empty((0, 0))
        model = MixedModel(columns, np.empty((len(used), 0)), residuals, lambda _: (np.empty(0), none))
        hyperparameters = np.empty(0)
    if model.freedom < 3:
        return None
    errors, statistics = model.deleted_residuals(hyperparameters)
    variance = 1 + _scatter_growth(used.force - model.residuals, errors) * used.force**2
    sizes = np.where(np.abs(errors) > smallest, np.abs(statistics) * np.sqrt(np.mean(variance) / variance), 0.0)
    return _Tested(used, model, hyperparameters, errors, sizes)


def _scatter_growth(force: Floats, errors: Floats) -> float:
    """Ratio c [1/N^2] of a variance of errors [N] proportional to 1 + c F^2, by maximum likelihood.

    0 if the slope of the squared errors is not significant (5 %; R. Koenker, J. Econometrics 17 (1981) 107-112).
    """
    from scipy.special import stdtr

    square, largest, freedom = errors**2, float(np.max(force**2)), len(force) - 2
    relative = force**2 / largest
    slope = float(np.corrcoef(relative, square)[0, 1]) if np.ptp(relative) and np.ptp(square) else 0.0
    if stdtr(freedom, -slope * np.sqrt(freedom / max(1 - slope**2, np.finfo(float).tiny))) >= 0.05:
        return 0.0

    def deviance(growth: float) -> float:
        shape = 1 + growth * relative
        return float(len(square) * np.log(np.mean(square / shape)) + np.log(shape).sum())

    return min(np.geomspace(1e-3, 1e5, 200).tolist(), key=deviance) / largest


def _loop_widths(points: IsobaricDataset) -> Floats:
    """Distance [N] of loading from unloading, affine in the force: friction leaves points between; 0 for one way."""
    if len(points.directions) < 2:
        return np.zeros(len(points))
    eq2 = FitProblem.of(ExponentialLaw, points)
    base = solve(eq2, grid_search(eq2))
    loading = _passes(points)[:, :1] * np.column_stack([np.ones(len(points)), points.force])
    columns = np.hstack([base.jacobian, loading])
    lengths = np.linalg.norm(columns, axis=0)
    coefficients = np.linalg.lstsq(columns / lengths, base.residuals, rcond=None)[0] / lengths
    return np.abs(coefficients[-2] + coefficients[-1] * points.force)


def _passes(points: IsobaricDataset) -> Floats:
    """Indicator columns of the directions and phases: their difference is friction."""
    columns = [
        (points.table[name].to_numpy() == word).astype(float)
        for name, words in (("direction", points.directions), ("phase", points.phases))
        for word in words
    ]
    return np.column_stack(columns) if columns else np.empty((len(points), 0))
