"""Regression of a fit: error models, cross-validation and force intervals, computed on demand."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mckibben.dataset import IsobaricDataset
from mckibben.dataset.preprocessing import pressure_levels
from mckibben.identification.estimator import (
    CONDITION_LIMIT,
    Bools,
    ClusterRobustErrors,
    ErrorModel,
    Floats,
    IndependentErrors,
    IntervalEstimate,
    Ints,
    condition_number,
)
from mckibben.identification.grouping import RESOLUTION, Grouping, finest_grouping, group_labels
from mckibben.identification.least_squares import FitProblem, Solution, solve
from mckibben.units import percent


@dataclass(frozen=True)
class RobustErrors:
    """Cluster-robust standard errors [SI] and degrees of freedom by parameter; NaN at a bound."""

    by: Grouping
    groups: int
    standard_errors: Mapping[str, float] = field(repr=False)
    degrees_of_freedom: Mapping[str, float] = field(repr=False)


@dataclass(frozen=True, eq=False)
class ForceIntervals:
    """Intervals of the force at new pressures and contractions (confidence), and of a plateau mean there (prediction).

    In N, for the same muscle and rig. Systematic errors of the rig are in neither.
    """

    confidence: IntervalEstimate
    prediction: IntervalEstimate


@dataclass(frozen=True, eq=False)
class CrossValidation:
    """Errors [N] at blocks of points, each predicted by the fit to all others; NaN for points outside all blocks."""

    residuals: Floats = field(repr=False)
    by_block: Mapping[float | str, float]

    @property
    def rmse(self) -> float:
        """RMSE over all blocks [N]."""
        return float(np.sqrt(np.nanmean(self.residuals**2)))

    @property
    def max_error(self) -> float:
        """Largest absolute error [N]."""
        return float(np.nanmax(np.abs(self.residuals)))

    def within(self, mask: Bools) -> CrossValidation:
        """Errors at the points of a mask, shape (points,), by the same blocks."""
        return CrossValidation(np.where(mask, self.residuals, np.nan), self.by_block)


class NotIdentifiableError(Exception):
    """Raised if the points outside a block do not determine the law."""

    def __init__(self, block: float | str, reason: str) -> None:
        super().__init__(reason)
        self.block, self.reason = block, reason


def pressure_blocks(points: IsobaricDataset, *, most: int = 8, fewest: int = 5) -> tuple[Floats | None, str]:
    """Pressure level [Pa] of each point, or the median of its block; None and the reason if unavailable.

    A block is one level. If all pressures differ, it is a cluster of them or, if there is none, a part of the range: at
    most `most` blocks, with `fewest` points on average.
    """
    levels = points.levels
    count = len(np.unique(levels))
    if count < 3:
        return None, "without one of two pressures or fewer, the others show no law"
    if 2 * count <= len(points):
        return levels, ""
    blocks = pressure_levels(levels)
    if np.isfinite(blocks).all() and 1 < len(np.unique(blocks)) <= len(points) // 3:
        return blocks, ""
    number = min(len(points) // fewest, most)
    if number < 2:
        return None, f"the {len(points)} points have {count} different pressures; record the set pressure of each point"
    edges = np.linspace(levels.min(), levels.max(), number + 1)[1:-1]
    part = np.searchsorted(edges, levels, side="right")
    medians = {block: np.median(levels[part == block]) for block in np.unique(part).tolist()}
    return np.array([medians[block] for block in part.tolist()]), ""


def contraction_blocks(points: IsobaricDataset, *, most: int = 8) -> NDArray[np.str_]:
    """Label of the contraction block of each point; "" in the outermost blocks, which would require extrapolation.

    A block is one contraction, or several neighbours if there are more than `most`.
    """
    rounded = np.round(points.contraction / RESOLUTION).astype(int)
    values, number, counts = np.unique(rounded, return_inverse=True, return_counts=True)
    blocks = min(len(values), most)
    if blocks < len(values):
        number = ((np.cumsum(counts) - counts / 2) * blocks / len(points)).astype(int)[number]
    labels = np.full(len(points), "", "<U24")
    for block in range(1, blocks - 1):
        own = number == block
        if own.any():
            low, high = rounded[own].min() * RESOLUTION / percent, rounded[own].max() * RESOLUTION / percent
            labels[own] = f"{low:.1f} %" if low == high else f"{low:.1f}..{high:.1f} %"
    return labels


Refit = Callable[[Bools], Solution]
"""Identification method: solution for the selected points."""


def cross_validate(
    problem: FitProblem, full: Solution, blocks: ArrayLike, refit: Refit | None = None
) -> CrossValidation:
    """Predict each block from a fit of the law, shape included, to all other blocks.

    Parameters
    ----------
    problem, full
        Problem and its solution for all points.
    blocks
        Label of the block of each point, shape (points,); those of "" are in no block.
    refit
        Identification method for a mask of points. Default: `solve` from the shape of the full solution.

    Raises
    ------
    NotIdentifiableError
        If the other blocks do not determine the law, or it has no force at the points of the block.
    """
    blocks = np.asarray(blocks)
    residuals = np.full(len(blocks), np.nan)
    by_block: dict[float | str, float] = {}
    for block in np.unique(blocks).tolist():
        if block == "":
            continue
        out = blocks == block
        if np.count_nonzero(~out) <= (len(problem.names) if refit is None else len(problem.law_type.shape_parameters)):
            raise NotIdentifiableError(block, "too few points are left to fit")
        solution = solve(problem.subset(~out), full.position) if refit is None else refit(~out)
        if not (solution.converged and condition_number(solution.triangle[:, ~solution.at_bound]) < CONDITION_LIMIT):
            raise NotIdentifiableError(block, "the law is not determined")
        everything = solution.problem.subset(np.ones(len(blocks), bool))
        rows = everything.columns_and_residuals(solution.values)[:, : len(blocks)]
        residuals[out] = rows[-1, out] / problem.weights[: len(blocks)][out]
        if not np.isfinite(residuals[out]).all():
            raise NotIdentifiableError(block, "the law's force is undefined there")
        by_block[block] = float(np.sqrt(np.mean(residuals[out] ** 2)))
    return CrossValidation(residuals, by_block)


@dataclass(frozen=True, eq=False)
class Regression:
    """Points of a fit and the least-squares solution.

    Attributes
    ----------
    points
        Taut points of the fit.
    problem, solution
        Least-squares problem of these points, and its solution.
    at_bound
        Mask of the parameters at a bound of their range, shape (parameters,).
    refit
        Identification method for other points, if the law is chosen by them; None: the same law.
    """

    points: IsobaricDataset = field(repr=False)
    problem: FitProblem = field(repr=False)
    solution: Solution = field(repr=False)
    at_bound: Bools = field(repr=False)
    refit: Refit | None = field(default=None, repr=False)

    @property
    def free(self) -> Ints:
        """Indices of the parameters not at a bound."""
        return np.flatnonzero(~self.at_bound)

    @cached_property
    def default_grouping(self) -> tuple[Grouping, str]:
        """Grouping by measurement conditions, never by the residuals, which would invalidate the intervals."""
        if self.at_bound.all():
            return Grouping.POINT, "all parameters are at a bound, so none has an error"
        by = finest_grouping(self.points)
        labels = group_labels(self.points, by)
        count = int(labels.max()) + 1
        if count < 5:
            return Grouping.POINT, f"{by.counted(count)} are too few to estimate a common error"
        if 2 * count > len(labels):
            return Grouping.POINT, (
                f"the {len(labels)} points are at {by.counted(count)}, hardly two each; "
                "record the set pressure of each point where the measured one differs"
            )
        if self._cluster_robust.decisive:
            return Grouping.POINT, f"one {by.value} alone determines a parameter"
        return by, ""

    def cross_validated(self, kind: str, blocks: ArrayLike) -> CrossValidation:
        """`cross_validate`, computed once per kind of block, such as "pressure"."""
        if kind not in self._cross_validations:
            self._cross_validations[kind] = cross_validate(self.problem, self.solution, blocks, self.refit)
        return self._cross_validations[kind]

    @cached_property
    def error_model(self) -> ErrorModel:
        """Error model of the free parameters, for errors in common by the `default_grouping`."""
        if self.default_grouping[0] is not Grouping.POINT:
            return self._cluster_robust
        residuals, jacobian = self.solution.augmented
        return IndependentErrors.of(jacobian[:, self.free], residuals)

    @cached_property
    def robust_errors(self) -> RobustErrors | None:
        """Cluster-robust standard errors of the parameters; None for independent points."""
        by, names = self.default_grouping[0], self.problem.names
        if by is Grouping.POINT:
            return None
        errors, freedom = np.full((2, len(names)), np.nan)
        variance, freedom[self.free] = self.error_model.variance(np.eye(len(self.free)))
        errors[self.free] = np.sqrt(variance)
        return RobustErrors(
            by,
            int(group_labels(self.points, by).max()) + 1,
            dict(zip(names, errors.tolist(), strict=True)),
            dict(zip(names, freedom.tolist(), strict=True)),
        )

    @cached_property
    def _cross_validations(self) -> dict[str, CrossValidation]:
        return {}

    @cached_property
    def _cluster_robust(self) -> ClusterRobustErrors:
        residuals, jacobian = self.solution.augmented
        labels = group_labels(self.points, finest_grouping(self.points))
        return ClusterRobustErrors.of(jacobian[:, self.free], residuals, labels)
