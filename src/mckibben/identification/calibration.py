"""Calibration of intervals on left-out blocks: prediction by conformal scores, and the variance of a law's misfit.

The score of a left-out point is its error, relative to the standard deviation that the fit to all others predicts for
it (docs/uncertainty.md). A quantile of the scores replaces that of Student's t.

References
----------
J. Lei, M. G'Sell, A. Rinaldo, R. Tibshirani and L. Wasserman, "Distribution-free predictive inference for regression",
J. American Statistical Association 113 (2018) 1094-1111; V. Vovk, "Cross-conformal predictors", Annals of Mathematics
and Artificial Intelligence 74 (2015) 9-28.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from mckibben.identification.intervals import check_level
from mckibben.identification.regression import (
    NotIdentifiableError,
    Regression,
    contraction_blocks,
    cross_validate,
    pressure_blocks,
)
from mckibben.identification.smooth import surface
from mckibben.identification.uncertainty import Floats

_FEWEST = 20  # left-out points of a kind: a quantile of 95 % needs them
_NEAREST = 1e-3  # distance of a new point from measured ones
_SIGNIFICANT = 0.01  # probability of a misfit of a right law


@dataclass(frozen=True, eq=False)
class IntervalCalibration:
    """Scores of left-out points, and the misfit of the law.

    Attributes
    ----------
    pressure, contraction
        Ascending scores at left-out pressures and at left-out inner contractions; empty if there are too few.
    levels, measured
        Ascending pressure levels [Pa] and contractions [-] of the points.
    misfit
        Variance [N^2] of the law's systematic error at left-out points, and its degrees of freedom; 0 if the scatter
        about the law is that about a smooth surface.
    apart
        Smallest distance of left-out points from the levels and from the contractions of the others, 1 in the middle
        between two: from there on, a point counts as one of a new pressure or contraction.
    """

    pressure: Floats = field(repr=False)
    contraction: Floats = field(repr=False)
    levels: Floats = field(repr=False)
    measured: Floats = field(repr=False)
    misfit: tuple[float, float]
    apart: tuple[float, float] = (1.0, 1.0)

    @classmethod
    def of(cls, regression: Regression) -> IntervalCalibration:
        """Calibration of a regression; its law is fitted once for each block left out."""
        points = regression.points
        found = pressure_blocks(points)[0]
        kinds = np.full(len(points), "") if found is None else found.astype(str), contraction_blocks(points)
        pressure, contraction = (_left_out(regression, labels) for labels in kinds)
        levels, measured = points.levels, points.contraction
        apart = (
            _apart(points.pressure, levels, kinds[0], pressure.blocks),
            _apart(measured, measured, kinds[1], contraction.blocks),
        )
        misfit = _misfit(regression, pressure)
        return cls(pressure.scores, contraction.scores, np.unique(levels), np.unique(measured), misfit, apart)

    def quantile(self, level: float, contraction: Floats, pressure: Floats, students: float) -> Floats | None:
        """Half widths of prediction intervals in standard deviations (docs/uncertainty.md); None without enough scores.

        Where there are too few scores for the level, that of Student's t, `students`, or the largest score.
        """
        check_level(level)
        if len(self.pressure) < _FEWEST:
            return None
        new_pressure, new_contraction = (_quantile(one, level, students) for one in (self.pressure, self.contraction))
        distances = _distance(pressure, self.levels), _distance(contraction, self.measured)
        across, along = (np.minimum(one / least, 1.0) for one, least in zip(distances, self.apart, strict=True))
        at_level = (1 - along) * min(new_pressure, new_contraction) + along * new_contraction
        between = (1 - along) * new_pressure + along * max(new_pressure, new_contraction)
        return (1 - across) * at_level + across * between


def _distance(values: Floats, measured: Floats) -> Floats:
    """Distance of values from ascending measured ones: 0 at one, 1 in the middle between two, and at most 1."""
    above = np.clip(np.searchsorted(measured, values), 1, max(len(measured) - 1, 1))
    low, high = measured[above - 1], measured[np.minimum(above, len(measured) - 1)]
    apart = np.minimum(np.abs(values - low), np.abs(values - high))
    return np.clip(2 * apart / np.maximum(high - low, np.finfo(float).eps), 0.0, 1.0)


def _apart(values: Floats, measured: Floats, labels: NDArray[np.str_], blocks: Sequence[str]) -> float:
    """Smallest distance of the values of a left-out block from the measured ones of the others."""
    each = [labels == one for one in blocks]
    least = [_distance(values[own], np.unique(measured[~own])).min() for own in each if not own.all()]
    return max(min(least, default=1.0), _NEAREST)


@dataclass(frozen=True, eq=False)
class _LeftOut:
    scores: Floats  # ascending
    square: float  # mean square error [N^2], less the variance of the fit
    blocks: list[str]


def _left_out(regression: Regression, labels: NDArray[np.str_]) -> _LeftOut:
    """Scores at the blocks without which the law is determined."""
    scores: list[float] = []
    squares: list[float] = []
    blocks: list[str] = []
    for block in np.unique(labels).tolist():
        if block == "":
            continue
        only = np.where(labels == block, labels, "")
        try:
            found = cross_validate(regression.problem, regression.solution, only, regression.refit)
        except NotIdentifiableError:
            continue
        out = np.isfinite(found.residuals) & np.isfinite(found.scatter_variance)
        if not out.any():
            continue
        force = regression.points.force[out] - found.residuals[out]
        variance = found.law_variance[out] + found.scatter_variance[out] * regression.relative_variance(force)
        scores += (np.abs(found.residuals[out]) / np.sqrt(variance)).tolist()
        squares += (found.residuals[out] ** 2 - found.law_variance[out]).tolist()
        blocks.append(block)
    return _LeftOut(np.sort(scores), float(np.mean(squares)) if squares else 0.0, blocks)


def _quantile(scores: Floats, level: float, students: float) -> float:
    """Conformal quantile of ascending scores: the smallest that holds for one more point at this level."""
    rank = int(np.ceil(level * (len(scores) + 1)))
    if len(scores) < _FEWEST or rank > len(scores):
        return float(max(students, scores.max(initial=0.0)))
    return float(scores[rank - 1])


def _misfit(regression: Regression, left_out: _LeftOut) -> tuple[float, float]:
    """Variance of the misfit: that of left-out errors beyond the scatter about a smooth surface (lack of fit)."""
    from scipy.special import fdtrc

    scatter, points = _surface_scatter(regression), regression.points
    if scatter is None or len(left_out.blocks) < 2:
        return 0.0, np.inf
    pure, freedom = scatter
    solution = regression.solution
    squares = float(solution.residuals @ solution.residuals)
    own_freedom = len(points) - solution.effective_parameters
    extra = own_freedom - freedom
    if extra < 1 or not pure > 0:  # the surface has no more freedom than the law
        return 0.0, np.inf
    ratio = (squares - pure * freedom) / extra / pure
    if not ratio > 0 or fdtrc(extra, freedom, ratio) > _SIGNIFICANT:
        return 0.0, np.inf
    return max(left_out.square - pure, 0.0), float(len(left_out.blocks))


def _surface_scatter(regression: Regression) -> tuple[float, float] | None:
    """Variance of the points about a smooth surface [N^2], and its degrees of freedom; None without support."""
    found = surface(regression.points)
    if found is None:
        return None
    model, hyperparameters = found
    residuals, effective = model.conditional(hyperparameters)
    freedom = len(residuals) - effective
    return (float(residuals @ residuals) / freedom, freedom) if freedom >= 1 else None
