"""Least-squares fit of a share of the force that follows the pressure with a delay, to plateaus of the pressure."""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from mckibben.errors import IdentificationError
from mckibben.identification.estimator import ClusterRobustErrors, Floats, Ints, profile_interval, t_quantile
from mckibben.identification.pressure_plateaus import (
    FEWEST_LEVELS,
    MOVED,
    LengthGroup,
    PressurePlateau,
    RecordedBins,
    block_edges,
    length_groups,
    mean_forces,
    pressure_lags,
)
from mckibben.units import percent

_FEWEST_PLATEAUS = 6
_BINS, _PARTS = 10, 20  # shortest time constant, in bins, and as a part of the longest plateau
_COARSE, _FINE = 61, 41  # time constants of a search, and between two of them
_STRUCTURED, _LEAST_PART = 1e-3, 0.05  # p-value, and part of the creep, of a dependence that is reported
_FURTHER = 4.0  # ratio to the time constant of further ones that are tested


@dataclass(frozen=True)
class CreepStructure:
    """Dependence that the residuals of a fit of creep show, and that its form lacks.

    Attributes
    ----------
    quantity
        "contraction", "pressure", "direction" (filling, venting) or "time" (more than one time constant).
    part
        Root mean square of the dependent part, relative to that of the fitted creep [-].
    p_value
        Probability of at least this much if the form is right.
    """

    quantity: str
    part: float
    p_value: float

    def describe(self) -> str:
        """Dependence as text."""
        found = "the relaxation has more than one time constant"
        if self.quantity != "time":
            found = f"the share depends on the {self.quantity}"
        return (
            f"the residuals are structured: {found}, which the form of the creep lacks "
            f"({self.part / percent:.2g} % of the creep, p = {self.p_value:.1g})"
        )


class ShareSolution(NamedTuple):
    """Share [-] and rate [N/s], residuals [N] by block, and the weighted sum of their squares."""

    values: tuple[float, float]
    residuals: Floats
    cost: float


@dataclass(frozen=True, eq=False)
class DelayedShareFit:
    """Blocks of plateaus, and the least-squares fit of a delayed share and a common rate to them."""

    bins: Sequence[RecordedBins]
    plateaus: Sequence[PressurePlateau]
    groups: Sequence[LengthGroup]
    owner: Ints  # plateau of each block
    weight: Floats  # samples of each block
    longest: float  # duration of the longest plateau [s]
    shortest: float  # time between two bins [s]

    @classmethod
    def of(cls, bins: Sequence[RecordedBins]) -> DelayedShareFit:
        plateaus = [one for number, each in enumerate(bins) for one in each.plateaus(number)]
        groups = length_groups(bins, plateaus, mean_forces(bins, plateaus))
        used = sorted(int(k) for group in groups for k in group.members)
        if len(used) < _FEWEST_PLATEAUS:
            message = f"{len(used)} plateaus of the pressure, at lengths with at least {FEWEST_LEVELS} levels"
            remedy = "step the pressure up and down over several levels at a fixed length, and wait at each"
            raise IdentificationError(message, value=len(used), lower=_FEWEST_PLATEAUS, remedy=remedy)
        place = {k: number for number, k in enumerate(used)}
        plateaus = [plateaus[k] for k in used]
        groups = [one._replace(members=np.array([place[int(k)] for k in one.members])) for one in groups]
        bins = [each.smoothed([one for one in plateaus if one.recording == number]) for number, each in enumerate(bins)]
        edges = [block_edges(one) for one in plateaus]
        owner = np.repeat(np.arange(len(edges)), [len(one) - 1 for one in edges])
        weight = np.concatenate(
            [
                np.add.reduceat(bins[one.recording].samples[: one.last], edge[:-1])
                for one, edge in zip(plateaus, edges, strict=True)
            ]
        )
        spans = [bins[one.recording].time[one.last - 1] - bins[one.recording].time[one.first] for one in plateaus]
        shortest = min(float(np.median(np.diff(each.time))) for each in bins)
        return cls(bins, plateaus, groups, owner, weight, float(max(spans)), shortest)

    def _blocks(self, values: Sequence[Floats]) -> Floats:
        """Values of the bins by block, (blocks, ...), without the mean and the part affine in pressure of a plateau."""
        parts = []
        for one, each in zip(self.plateaus, values, strict=True):
            bins, edges = self.bins[one.recording], block_edges(one)[:-1]
            samples = bins.samples[: one.last]
            sizes = np.add.reduceat(samples, edges)
            pressure = np.add.reduceat(bins.pressure[: one.last] * samples, edges) / sizes
            weighted = (each.T * samples[one.first :]).T
            means = (np.add.reduceat(weighted, edges - one.first).T / sizes).T
            for direction in (np.ones(len(sizes)), pressure - np.average(pressure, weights=sizes)):
                scale = float(sizes @ direction**2)
                if scale > 0:
                    means = means - np.multiply.outer(direction, (sizes * direction) @ means / scale)
            parts.append(means)
        return np.concatenate(parts)

    def _by_plateau(self, compute: Callable[[LengthGroup, RecordedBins, slice, int], Floats]) -> list[Floats]:
        """Values of the bins of each plateau, from its group and its slice of bins."""
        found: dict[int, Floats] = {}
        for group in self.groups:
            for k in group.members.tolist():
                one = self.plateaus[k]
                found[k] = compute(group, self.bins[one.recording], slice(one.first, one.last), one.recording)
        return [found[k] for k in range(len(self.plateaus))]

    @property
    def values(self) -> Floats:
        """Force [N] less that of the interpolated levels, by block."""
        return self._blocks(
            self._by_plateau(lambda group, bins, at, _: bins.force[at] - group.force(bins.pressure[at]))
        )

    @property
    def line(self) -> Floats:
        """Time [s] by block."""
        return self._blocks(self._by_plateau(lambda _, bins, at, __: bins.time[at]))

    def columns(self, time_constants: Floats) -> Floats:
        """Derivative of the force with respect to the share [N] by block, shape (blocks, time constants)."""
        return self._blocks(self._delayed(time_constants))

    def column(self, tau: float) -> Floats:
        return self.columns(np.array([tau]))[:, 0]

    def _delayed(self, time_constants: Floats) -> list[Floats]:
        lags = [pressure_lags(each, tuple(time_constants.tolist())) for each in self.bins]

        def delayed(group: LengthGroup, bins: RecordedBins, at: slice, recording: int) -> Floats:
            pressure = bins.pressure[at, None]
            return group.force(pressure - lags[recording][at]) - group.force(pressure)

        return self._by_plateau(delayed)

    def corrected(self, tau: float) -> DelayedShareFit:
        """The fit with levels without the creep that is left in the means of the plateaus."""
        share = self.solve(tau).values[0]
        left = np.array([share * float(one.mean()) for one in self._delayed(np.array([tau]))])
        means = mean_forces(self.bins, self.plateaus)
        return dataclasses.replace(self, groups=length_groups(self.bins, self.plateaus, means - left))

    @property
    def grid(self) -> Floats:
        """Time constants [s] of the search; with quicker ones the noise of the pressure passes for creep."""
        return np.geomspace(max(_BINS * self.shortest, self.longest / _PARTS), 5 * self.longest, _COARSE)

    @functools.cached_property
    def grid_costs(self) -> Floats:
        """Sum of the squares at each time constant of the search."""
        return self.costs(self.grid)

    def search(self) -> float:
        """Least-squares time constant [s]."""
        grid = self.grid
        at = int(np.argmin(self.grid_costs))
        finer = np.geomspace(grid[max(at - 1, 0)], grid[min(at + 1, _COARSE - 1)], _FINE)
        return float(finer[np.argmin(self.costs(finer))])

    def costs(self, time_constants: Floats) -> Floats:
        columns, values, line = self.columns(time_constants), self.values, self.line
        return np.array([_least_squares(np.column_stack([c, line]), values, self.weight)[2] for c in columns.T])

    def solve(self, tau: float) -> ShareSolution:
        values, residuals, cost = _least_squares(
            np.column_stack([self.column(tau), self.line]), self.values, self.weight
        )
        return ShareSolution((float(values[0]), float(values[1])), residuals, cost)

    def _jacobian(self, tau: float) -> Floats:
        """Columns of share, rate and logarithm of the time constant."""
        small = 1e-3
        centre, after, before = self.columns(tau * np.exp([0.0, small, -small])).T
        share = self.solve(tau).values[0]
        return np.column_stack([centre, self.line, share * (after - before) / (2 * small)])

    def error(self, tau: float) -> tuple[float, float]:
        """Standard error of the share with errors that are correlated within plateaus, and its degrees of freedom."""
        variance, freedom = self._variance(self._jacobian(tau), self.solve(tau).residuals, 0)
        return math.sqrt(variance), freedom

    def _variance(self, columns: Floats, residuals: Floats, index: int) -> tuple[float, float]:
        """Variance of one coefficient, and its degrees of freedom."""
        root = np.sqrt(self.weight)
        errors = ClusterRobustErrors.of(columns * root[:, None], residuals * root, self.owner)
        variance, freedom = errors.variance(np.eye(columns.shape[1])[index : index + 1])
        return float(variance[0]), max(float(freedom[0]), 1.0)

    def inflation(self, tau: float) -> float:
        """Variance of the share with errors correlated within plateaus, in that of independent errors; at least 1."""
        columns, solution = self._jacobian(tau)[:, :2], self.solve(tau)
        information = (columns * self.weight[:, None]).T @ columns
        independent = np.linalg.pinv(information)[0, 0] * solution.cost / self.freedom
        return max(1.0, self._variance(columns, solution.residuals, 0)[0] / independent)

    @property
    def freedom(self) -> int:
        return max(len(self.owner) - 2 * len(self.plateaus) - 3, 1)

    def p_value(self, tau: float, inflation: float) -> float:
        """Upper bound of the probability of the reduction of the squares by a share, over all time constants.

        The time constant does not exist without creep: R. B. Davies, "Hypothesis testing when a nuisance parameter is
        present only under the alternative", Biometrika 74 (1987) 33-43. Its bound holds for squares of normal
        variables: each F statistic is replaced by the one of equal probability.
        """
        from scipy.special import chdtri, fdtrc

        cost = self.solve(tau).cost
        without = _least_squares(self.line[:, None], self.values, self.weight)[2]
        statistics = np.maximum(without - self.grid_costs, 0) / (cost / self.freedom) / inflation
        highest = max(without - cost, 0.0) / (cost / self.freedom) / inflation
        freedom = self.error(tau)[1]
        single = float(fdtrc(1, freedom, highest))
        equivalents = chdtri(1, np.maximum(fdtrc(1, freedom, np.append(statistics, highest)), 1e-300))
        variation, equivalent = float(np.abs(np.diff(np.sqrt(equivalents[:-1]))).sum()), float(equivalents[-1])
        return min(single + variation * math.exp(-equivalent / 2) / math.sqrt(2 * math.pi), 1.0)

    def time_constant_interval(self, tau: float, inflation: float) -> tuple[float, float]:
        """95 % profile interval of the time constant; 0 or infinite where the data impose no bound."""
        limit = float(t_quantile(0.95, self.error(tau)[1]))
        least, place = self.solve(tau).cost, int(np.searchsorted(self.grid, tau))
        grid, costs = (np.insert(one, place, here) for one, here in ((self.grid, tau), (self.grid_costs, least)))
        roots = np.sqrt(np.maximum(costs / least - 1, 0) * self.freedom / inflation)
        low, high = profile_interval(np.log(grid), roots, limit, place, -math.inf)
        return math.exp(low), math.exp(high)

    def structure(self, tau: float) -> tuple[CreepStructure, ...]:
        """Significant dependences of the residuals, with errors correlated within plateaus."""
        from scipy.special import fdtrc

        base, solution = self._jacobian(tau), self.solve(tau)
        creep, scale = base[:, 0], self.root_mean_square(solution.values[0] * base[:, 0])
        further = {
            name: creep[:, None] * (one - one.mean())[self.owner][:, None] for name, one in self._conditions().items()
        }
        further["time"] = self.columns(np.array([tau / _FURTHER, tau * _FURTHER]))
        found = []
        for name, columns in further.items():
            every = np.column_stack([base, columns])
            values, residuals, _ = _least_squares(every, self.values - base[:, :2] @ solution.values, self.weight)
            chances = []
            for index in range(base.shape[1], every.shape[1]):
                variance, freedom = self._variance(every, residuals, index)
                chances.append(float(fdtrc(1, freedom, values[index] ** 2 / variance)))
            p_value = min(1.0, len(chances) * min(chances))
            part = self.root_mean_square(every[:, 2:] @ values[2:]) / scale
            if p_value < _STRUCTURED and part > _LEAST_PART:
                found.append(CreepStructure(name, part, p_value))
        return tuple(sorted(found, key=lambda one: -one.part))

    def _conditions(self) -> dict[str, Floats]:
        """Quantities of the plateaus on which the share may depend, where they differ."""
        contraction = np.array([one.contraction for one in self.plateaus])
        pressure = np.array([self.bins[one.recording].pressure[one.first : one.last].mean() for one in self.plateaus])
        conditions = {"contraction": contraction, "pressure": pressure}
        conditions["direction"] = np.array([one.step for one in self.plateaus])
        return {
            name: (one - one.min()) / np.ptp(one)
            for name, one in conditions.items()
            if np.isfinite(one).all() and np.ptp(one) > (MOVED if name == "contraction" else 0)
        }

    def root_mean_square(self, values: Floats) -> float:
        return math.sqrt(float(np.average(values**2, weights=self.weight)))


def _least_squares(columns: Floats, values: Floats, weight: Floats) -> tuple[Floats, Floats, float]:
    """Coefficients, residuals, and the weighted sum of their squares."""
    root = np.sqrt(weight)
    found = np.linalg.lstsq(columns * root[:, None], values * root, rcond=None)[0]
    residuals = values - columns @ found
    return np.asarray(found, np.float64), residuals, float(weight @ residuals**2)
