"""Identification of the pressure threshold of a muscle: the dead band of its bladder."""

from __future__ import annotations

import functools
import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from mckibben.dataset import IsobaricDataset
from mckibben.errors import IdentificationError
from mckibben.identification.estimator import Floats, bounded_minimum, common_error, profile_interval, t_quantile
from mckibben.identification.fit import Fit
from mckibben.identification.fitting import identify
from mckibben.identification.grouping import finest_grouping, group_labels
from mckibben.identification.least_squares import FitProblem, Solution, grid_search, solve
from mckibben.identification.outliers import find_outliers, without_outliers
from mckibben.identification.smooth import SMOOTH_LAWS
from mckibben.muscle import ForceLaw
from mckibben.muscle.threshold import ThresholdLaw, effective_pressure
from mckibben.result import Remark, Result, column
from mckibben.units import bar, kPa, show


class ThresholdFit(Result):
    """Pressure threshold of a law, or its absence; returned by `identify_threshold`.

    Attributes
    ----------
    fit
        Fit of the law to the points: at the pressures above the threshold if it is significant, else without one.
    law
        `ThresholdLaw` with the fitted law, or the law alone if no threshold is significant.
    threshold, interval
        Estimate [Pa] and its 95 % profile interval, with 0 where the data do not exclude a law without a threshold, and
        infinity where they impose no upper bound.
    p_value
        Probability of at least this reduction of the squares without a threshold (F test of the nested models, with
        errors common to a stroke or a pressure). The threshold is significant below `significance`.
    residual, residual_without
        Root mean square error [N] with the threshold and without one.
    notes
        Reasons not to rely on the result.
    """

    fit: Fit
    law: ForceLaw
    threshold: float = column("Pa", "pressure threshold", "bar", digits=3)
    interval: tuple[float, float]
    p_value: float = column("1", "probability without a threshold", digits=2)
    residual: float = column("N", "RMSE with it", digits=3)
    residual_without: float = column("N", "RMSE without it", digits=3)
    notes: tuple[Remark, ...]

    def effective(self, dataset: IsobaricDataset) -> IsobaricDataset:
        """Plateau means of a dataset at the pressures that the law sees."""
        return _shifted(dataset, self.threshold) if self.is_significant else dataset

    @property
    def is_significant(self) -> bool:
        """True if the threshold is significant."""
        return isinstance(self.law, ThresholdLaw)

    def verdict(self) -> str:
        """Return the threshold and its interval, or that there is none."""
        if not self.is_significant:
            return f"no significant threshold (p = {self.p_value:.2g}): the law is fitted without one"
        low, high = self.interval
        upper = "unbounded" if high == math.inf else show(high, "bar", 3)
        return f"pressure threshold {show(self.threshold, 'bar', 3)}, 95 % interval {low / bar:.3g} .. {upper}"

    def remarks(self) -> Iterable[Remark]:
        """Return the notes."""
        return self.notes


def identify_threshold(
    law_type: type[ForceLaw], dataset: IsobaricDataset, *, robust: bool = True, significance: float = 0.01
) -> ThresholdFit:
    """Fit a law with a pressure threshold, and test the significance of the threshold.

    The threshold is searched; at each value, the law is fitted to the taut points at their effective pressures
    (`ThresholdLaw`). A law with a free offset absorbs a threshold far below all pressures: only points near it, such as
    stretched plateaus at low pressures, determine it.

    Parameters
    ----------
    law_type, robust
        As for `identify`.
    dataset
        Points, some of them at low pressures.
    significance
        Probability of a threshold that does not exist.

    Raises
    ------
    IdentificationError
        If the law has deviations with a prior, which absorb a threshold, or as by `identify`.

    Examples
    --------
    >>> from mckibben import catalog
    >>> from mckibben.muscle import ExponentialLaw
    >>> law = ThresholdLaw(catalog.law("lei-mas-10-180n"), threshold=0.4 * bar)
    >>> pressure, contraction = map(np.ravel, np.meshgrid(np.arange(13) * 0.25 * bar, np.linspace(-0.03, 0.1, 9)))
    >>> force = np.asarray(law.force(contraction, pressure)) + np.random.default_rng(1).normal(0, 0.5, 117)
    >>> data = IsobaricDataset.of(pressure=pressure, contraction=contraction, force=force, slack_force=2.0)
    >>> round(identify_threshold(ExponentialLaw, data).threshold / bar, 3)
    0.399
    """
    if law_type in SMOOTH_LAWS:
        raise IdentificationError(
            f"the deviations of {law_type.__name__} absorb a threshold", remedy="choose a law without them"
        )
    plain = identify(law_type, dataset, robust=robust)
    means = dataset.plateau_means()
    points = without_outliers(means, find_outliers(means) if robust else ()).taut
    profile = _Profile(law_type, points)
    grid = profile.grid()
    without, solutions = profile.solution(0.0), [profile.solution(threshold) for threshold in grid]
    reached = [solution.cost for solution in solutions]
    at = int(np.argmin(reached))
    lower, upper = np.log(grid[[max(at - 1, 0), min(at + 1, len(grid) - 1)]])
    threshold = math.exp(bounded_minimum(lambda log: profile.solution(math.exp(log)).cost, lower, upper, 1e-4))
    best = profile.solution(threshold)
    freedom, inflation = profile.inflation(threshold, best)
    scale = best.cost / max(len(points) - len(best.values) - 1, 1) * inflation
    costs = np.array([without.cost, *reached])
    from scipy.special import fdtrc

    ratio = max(without.cost - best.cost, 0.0) / scale
    p_value = float(fdtrc(1, freedom, ratio))
    rise = scale * float(t_quantile(0.95, freedom)) ** 2
    interval = profile_interval(np.append(0.0, grid), costs, (threshold, best.cost), rise, 0.0)
    significant = p_value < significance
    fit, law, notes = plain, plain.law, list[Remark]()
    if significant:
        fit = identify(law_type, _shifted(dataset, threshold), robust=robust)
        law = ThresholdLaw(law=fit.law, threshold=threshold)  # type: ignore[call-issue]
    if inflation > 1e3:  # the variance is that of an error common to one group
        text = "the points of one pressure determine the threshold"
        notes.append(Remark.warning("threshold", text, "measure at several low pressures"))
    return ThresholdFit(
        fit=fit,
        law=law,
        threshold=threshold,
        interval=interval,
        p_value=p_value,
        residual=_root_mean_square(best.residuals),
        residual_without=_root_mean_square(without.residuals),
        notes=tuple(notes),
    )


@dataclass(frozen=True, eq=False)
class _Profile:
    """Least-squares fits of a law to points, for given thresholds."""

    law_type: type[ForceLaw]
    points: IsobaricDataset

    @functools.cached_property
    def start(self) -> Floats:
        """Shape of the law without a threshold, from which all fits start."""
        return grid_search(FitProblem.of(self.law_type, self.points))

    def grid(self, *, lowest: float = 1 * kPa, highest: float = 0.5, count: int = 40) -> Floats:
        """Thresholds [Pa] of the search, from the `lowest` to the share `highest` of the highest pressure."""
        return np.geomspace(lowest, highest * float(self.points.pressure.max()), count)

    def solution(self, threshold: float) -> Solution:
        """Solution at the effective pressures of a threshold [Pa]; 0 is none."""
        return solve(FitProblem.of(self.law_type, self._points(threshold)), self.start)

    def inflation(self, threshold: float, best: Solution, *, step: float = 1e-3) -> tuple[float, float]:
        """Degrees of freedom of the variance of the threshold, and its ratio to that of independent points.

        Errors are common to a stroke, or to a pressure where strokes are not known; the ratio is at least 1.
        The derivative by the threshold is a difference quotient over a relative `step` on both sides.
        """
        step = step * threshold
        later, earlier = (
            FitProblem.of(self.law_type, self._points(threshold + sign * step)).response(best.values)[0]
            for sign in (1, -1)
        )
        slope = (earlier - later)[: len(self.points)] / (2 * step)
        columns = np.column_stack([best.jacobian[:, ~best.at_bound], slope])
        labels = group_labels(self.points, finest_grouping(self.points))
        return common_error(columns, best.residuals, labels, max(len(self.points) - columns.shape[1], 1))

    def _points(self, threshold: float) -> IsobaricDataset:
        return _shifted(self.points, threshold) if threshold > 0 else self.points


def _shifted(dataset: IsobaricDataset, threshold: float) -> IsobaricDataset:
    """Plateau means of a dataset at their effective pressures."""
    table = dataset.plateau_means().table
    names = [name for name in ("pressure", "set_pressure") if name in table]
    return IsobaricDataset(
        table.assign({name: ("point", effective_pressure(table[name].to_numpy(), threshold)) for name in names})
    )


def _root_mean_square(residuals: Floats) -> float:
    return math.sqrt(float(np.mean(residuals**2)))
