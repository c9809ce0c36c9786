r"""Fit of one Maxwell element to the course of the force within plateaus.

The blocks of all plateaus, less the mean of their plateau, are :math:`y = \beta\, c(\tau) + v t` with an amplitude
beta, the column c of one time constant, and a common rate v such as that of sensor drift. Errors are correlated within
plateaus.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from mckibben.identification.estimator import ClusterRobustErrors, Floats, Ints, profile_interval, t_quantile

_FINE = 41  # time constants between two of the grid
GRID = 61
"""Number of time constants of a search."""


@dataclass(frozen=True, eq=False)
class RelaxationFit:
    """Least-squares fit of an amplitude, a common rate and a time constant to blocks of plateaus.

    Attributes
    ----------
    values, line
        Force [N] and time [s] by block, shape (blocks,), without what is free for each plateau.
    weight, owner
        Weight and plateau of each block.
    columns
        Function of time constants [s], shape (m,), that returns the columns, shape (blocks, m).
    grid
        Ascending time constants [s] of the search.
    removed
        Number of directions that are free for each plateau, such as its mean.
    """

    values: Floats = field(repr=False)
    line: Floats = field(repr=False)
    weight: Floats = field(repr=False)
    owner: Ints = field(repr=False)
    columns: Callable[[Floats], Floats]
    grid: Floats
    removed: int

    @property
    def freedom(self) -> int:
        """Number of blocks less that of free parameters."""
        return max(len(self.owner) - self.removed * (int(self.owner.max()) + 1) - 3, 1)

    @cached_property
    def grid_costs(self) -> Floats:
        """Sum of squares [N^2] at each time constant of the search."""
        return self._costs(self.grid)

    @cached_property
    def time_constant(self) -> float:
        """Least-squares time constant [s]: from a grid, a finer one, and a parabola."""
        at = int(np.argmin(self.grid_costs))
        fine = np.geomspace(self.grid[max(at - 1, 0)], self.grid[min(at + 1, len(self.grid) - 1)], _FINE)
        costs = self._costs(fine)
        at = int(np.argmin(costs))
        if not 0 < at < _FINE - 1:
            return float(fine[at])
        before, here, after = costs[at - 1 : at + 2]
        bend = before - 2 * here + after
        shift = (before - after) / (2 * bend) if bend > 0 else 0.0
        return float(fine[at] * (fine[1] / fine[0]) ** shift)

    @cached_property
    def solution(self) -> tuple[float, float, Floats, float]:
        """Amplitude, rate [N/s], residuals [N] by block, and sum of their squares."""
        values, residuals, cost = self.least_squares(self._jacobian[:, :2])
        return float(values[0]), float(values[1]), residuals, cost

    def least_squares(self, columns: Floats) -> tuple[Floats, Floats, float]:
        """Coefficients of columns, shape (blocks, k), residuals, and the weighted sum of their squares."""
        root = np.sqrt(self.weight)
        values = np.linalg.lstsq(columns * root[:, None], self.values * root, rcond=None)[0]
        residuals = self.values - columns @ values
        return np.asarray(values, np.float64), residuals, float(self.weight @ residuals**2)

    def errors(self, columns: Floats, residuals: Floats) -> tuple[Floats, Floats]:
        """Variances of the coefficients of columns and their degrees of freedom, errors correlated in a plateau."""
        root = np.sqrt(self.weight)
        model = ClusterRobustErrors.of(columns * root[:, None], residuals * root, self.owner)
        variance, freedom = model.variance(np.eye(columns.shape[1]))
        return variance, np.maximum(freedom, 1.0)

    @cached_property
    def error(self) -> tuple[float, float, float]:
        """Standard errors of the amplitude and of the logarithm of the time constant, and degrees of freedom."""
        variance, freedom = self.errors(self._jacobian, self.solution[2])
        return math.sqrt(variance[0]), math.sqrt(variance[2]), float(freedom[0])

    @cached_property
    def inflation(self) -> float:
        """Variance of the amplitude with errors correlated in plateaus, in that of independent ones; at least 1."""
        columns = self._jacobian[:, :2]
        information = (columns * self.weight[:, None]).T @ columns
        independent = np.linalg.pinv(information)[0, 0] * self.solution[3] / self.freedom
        return max(1.0, float(self.errors(columns, self.solution[2])[0][0]) / independent)

    @cached_property
    def p_value(self) -> float:
        """Upper bound of the probability of the reduction of the squares by creep, over all time constants.

        The time constant does not exist without creep: R. B. Davies, "Hypothesis testing when a nuisance parameter is
        present only under the alternative", Biometrika 74 (1987) 33-43. Its bound holds for squares of normal
        variables: each F statistic is replaced by the one of equal probability.
        """
        from scipy.special import chdtri, fdtrc

        scale = self.solution[3] / self.freedom * self.inflation
        without = self.least_squares(self.line[:, None])[2]
        statistics = np.maximum(without - np.append(self.grid_costs, self.solution[3]), 0) / scale
        chances = fdtrc(1, self.error[2], statistics)
        equivalents = chdtri(1, np.maximum(chances, 1e-300))
        variation = float(np.abs(np.diff(np.sqrt(equivalents[:-1]))).sum())
        return min(float(chances[-1]) + variation * math.exp(-equivalents[-1] / 2) / math.sqrt(2 * math.pi), 1.0)

    @cached_property
    def time_constant_interval(self) -> tuple[float, float]:
        """95 % profile interval of the time constant [s]; 0 or infinite where the data impose no bound."""
        least, place = self.solution[3], int(np.searchsorted(self.grid, self.time_constant))
        grid, costs = (
            np.insert(values, place, here)
            for values, here in ((self.grid, self.time_constant), (self.grid_costs, least))
        )
        roots = np.sqrt(np.maximum(costs / least - 1, 0) * self.freedom / self.inflation)
        limit = float(t_quantile(0.95, self.error[2]))
        low, high = profile_interval(np.log(grid), roots, limit, place, -math.inf)
        return math.exp(low), math.exp(high)

    def root_mean_square(self, values: Floats) -> float:
        """Weighted root mean square of values by block."""
        return math.sqrt(float(np.average(values**2, weights=self.weight)))

    def _costs(self, time_constants: Floats) -> Floats:
        columns = self.columns(time_constants).T
        return np.array([self.least_squares(np.column_stack([column, self.line]))[2] for column in columns])

    @cached_property
    def _jacobian(self) -> Floats:
        """Columns of amplitude, rate and logarithm of the time constant."""
        small = 1e-3
        centre, after, before = self.columns(self.time_constant * np.exp([0.0, small, -small])).T
        amplitude = self.least_squares(np.column_stack([centre, self.line]))[0][0]
        return np.column_stack([centre, self.line, amplitude * (after - before) / (2 * small)])
