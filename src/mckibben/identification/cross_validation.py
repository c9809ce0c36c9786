"""Errors at whole blocks of points that a fit has not seen: pressures, directions, repeats.

By whole blocks and not by single points, because the neighbours of a point on its own curve all but give it away.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mckibben.dataset import IsobaricDataset
from mckibben.identification.problem import FitProblem, Solution
from mckibben.identification.solvers import solve
from mckibben.identification.uncertainty import CONDITION_LIMIT, condition_number

MOST_BLOCKS = 200


@dataclass(frozen=True, eq=False)
class CrossValidation:
    """Errors of the points of each block, of the fit to all others.

    Attributes
    ----------
    residuals
        Shape (points,): measured minus predicted force [N]; NaN for points of no block, which were never left out.
    by_block
        RMSE [N] of each block.
    """

    residuals: NDArray[np.float64] = field(repr=False)
    by_block: Mapping[float | str, float]

    @property
    def rmse(self) -> float:
        """Over all blocks together [N]."""
        return float(np.sqrt(np.nanmean(self.residuals**2)))

    @property
    def max_error(self) -> float:
        """The largest, without sign [N]."""
        return float(np.nanmax(np.abs(self.residuals)))


def pressure_blocks(points: IsobaricDataset) -> tuple[NDArray[np.float64] | None, str]:
    """The level [Pa] of each point, or None and why pressures cannot be left out.

    Where no nominal pressures are recorded and the measured ones scatter, each point would be a block of its own.
    """
    levels = points.levels
    count = len(np.unique(levels))
    if count < 2:
        return None, "there is one pressure only"
    if count > MOST_BLOCKS or 2 * count > len(points):
        return None, (
            f"the {len(points)} points have {count} different pressures, hardly two the same; record the set pressure "
            "of each point"
        )
    return levels, ""


class NotIdentifiableError(Exception):
    """Without a block, what is left does not determine the law; it holds the block."""

    def __init__(self, block: float | str, reason: str) -> None:
        super().__init__(reason)
        self.block, self.reason = block, reason


def cross_validate(problem: FitProblem, full: Solution, blocks: ArrayLike) -> CrossValidation:
    """Fit the whole law, its shape included, to the points of all blocks but one; for each block.

    Parameters
    ----------
    problem
        Of all points.
    full
        Its solution; each refit starts at its shape.
    blocks
        Shape (points,): numbers or texts, the same for the points of a block; an empty text for points of none.

    Raises
    ------
    UndeterminedError
        If the rest of the points does not determine the law.
    """
    blocks = np.asarray(blocks)
    residuals = np.full(len(blocks), np.nan)
    by_block: dict[float | str, float] = {}
    for block in np.unique(blocks).tolist():
        if block == "":
            continue
        out = blocks == block
        if np.count_nonzero(~out) <= len(problem.names):
            raise NotIdentifiableError(block, "too few are left to fit")
        rest = problem.keeping(~out)
        solution = solve(rest, full.position)
        free = solution.jacobian[:, ~parameters_at_bound(rest, solution)]
        if not (solution.converged and condition_number(free) < CONDITION_LIMIT):
            raise NotIdentifiableError(block, "the law is not determined")
        residuals[out], _ = problem.keeping(out).response(solution.values)
        if not np.isfinite(residuals[out]).all():
            raise NotIdentifiableError(block, "the law has no force at them")
        by_block[block] = float(np.sqrt(np.mean(residuals[out] ** 2)))
    return CrossValidation(residuals, by_block)


def parameters_at_bound(problem: FitProblem, solution: Solution) -> NDArray[np.bool_]:
    """Which parameters lie at a bound of their range, shape (parameters,)."""
    return np.concatenate([np.zeros(problem.linear, bool), problem.cube.at_bound(solution.position)])
