"""Relaxation of the force within plateaus, and fits of a Maxwell element to it."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mckibben.dataset import IsobaricDataset
from mckibben.errors import IdentificationError
from mckibben.identification.loading_path import LoadingPaths
from mckibben.muscle.creep import remaining

BLOCKS = 16
"""To so many the samples of a plateau are averaged: an exponential is smooth."""

_SAME = 0.05  # s: times of points are hardly better


@dataclass(frozen=True, eq=False)
class TimedLoadingPaths:
    """The moves of a test in time: what an arm is drawn along.

    Attributes
    ----------
    strokes
        The ways.
    moving, before
        Shape (points, ways): the time of the move to each point, and from the end of the last one to the end of this
        [s].
    slack
        Shape (points, ways).
    dwell
        From the end of a move to the first sample [s].
    """

    strokes: LoadingPaths
    moving: NDArray[np.float64] = field(repr=False)
    before: NDArray[np.float64] = field(repr=False)
    slack: NDArray[np.bool_] = field(repr=False)
    dwell: float

    @classmethod
    def of(cls, means: IsobaricDataset, dwell: float, speed: float, acquisition: float) -> TimedLoadingPaths:
        """Those of plateau means, with the times [s] of a wait and of the samples, and the speed [m/s].

        Raises
        ------
        IdentificationError
            As `LoadingPaths.of`, or if all that takes longer than there is between two points.
        """
        if len(means.directions) < 2:
            raise IdentificationError(
                "the dataset has not both directions: then a sensor that drifts looks like creep",
                remedy="measure while stretching and while shortening, and give the direction of each point",
            )
        strokes = LoadingPaths.of(means)
        moving = np.abs(strokes.travel) / speed
        before = moving + dwell + acquisition
        if "time" in means.table:
            time = means.table["time"].to_numpy()[strokes.place]
            apart = np.diff(time, axis=0, prepend=time[:1])
            real = np.arange(len(time))[:, None] < strokes.counts
            real[0] = False
            lacking = float((moving + dwell + acquisition - apart)[real].max(initial=-math.inf))
            if lacking > _SAME:
                raise IdentificationError(
                    f"move, wait and samples take {lacking:.3g} s longer than there is between two points",
                    value=lacking,
                    unit="s",
                    remedy="check interval, dwell, speed and the times of the points",
                )
            before = np.where(real, apart, before)
        return cls(strokes, moving, before, means.slack[strokes.place], dwell)

    @property
    def longest(self) -> float:
        """The time of the longest way [s]."""
        return float(self.before.sum(axis=0).max())

    @property
    def sides(self) -> NDArray[np.float64]:
        """Shape (rows,): 1 where the last move was a stretch, -1 a shortening, 0 where there was none."""
        return self.strokes.scattered(np.sign(np.where(np.abs(self.strokes.travel) > 1e-9, self.strokes.travel, 0.0)))

    def at_bound(self, time_constant: float) -> NDArray[np.float64]:
        """The stretch [m] that an arm holds at the first sample, shape (rows,)."""
        carried = np.exp(-self.before / time_constant)
        added = self.strokes.travel * remaining(self.moving, time_constant)
        at_bound = np.empty_like(added)
        now = np.zeros(added.shape[1])
        for k in range(len(added)):
            now = np.where(self.slack[k], 0.0, now * carried[k] + added[k])
            at_bound[k] = now
        return self.strokes.scattered(at_bound) * math.exp(-self.dwell / time_constant)

    def stiffness(self, means: IsobaricDataset, used: NDArray[np.bool_]) -> float:
        """Of the muscle [N/m]: the median of force per length over the moves between used points."""
        place = self.strokes.place
        travel = self.strokes.travel[1:]
        both = used[place][1:] & used[place][:-1] & (np.abs(travel) > 1e-9)
        return float(np.median(np.diff(means.force[place], axis=0)[both] / travel[both]))


class RelaxationCurves(NamedTuple):
    """The samples of each plateau, averaged in blocks, less their mean.

    Attributes
    ----------
    values
        Shape (rows, blocks), in the unit of the samples.
    weight
        Shape (blocks,): the part of the samples that is in each.
    edges
        Shape (blocks,): the first sample of each.
    times
        Shape (samples,) [s].
    """

    values: NDArray[np.float64]
    weight: NDArray[np.float64]
    edges: NDArray[np.int64]
    times: NDArray[np.float64]

    @classmethod
    def of(cls, samples: NDArray, interval: float) -> RelaxationCurves:
        """Of raw samples, shape (rows, samples), so many seconds apart."""
        count = samples.shape[1]
        edges = np.unique(np.linspace(0, count, min(BLOCKS, count) + 1).astype(np.int64))
        sizes = np.diff(edges)
        blocks = np.add.reduceat(samples, edges[:-1], axis=1, dtype=np.float64) / sizes
        weight = sizes / count
        return cls(blocks - (blocks @ weight)[:, None], weight, edges[:-1], np.arange(count) * interval)

    @property
    def duration(self) -> float:
        """From the first sample to the last [s]."""
        return float(self.times[-1])

    def blocks(self, course: NDArray[np.float64]) -> NDArray[np.float64]:
        """A course over the samples, averaged in the same way, less its mean."""
        blocks = np.add.reduceat(course, self.edges) / (self.weight * len(self.times))
        return blocks - blocks @ self.weight

    @property
    def slopes(self) -> NDArray[np.float64]:
        """Of the straight line through each plateau [N/s], shape (rows,)."""
        line = self.blocks(self.times)
        return self.values @ (self.weight * line) / (line**2 @ self.weight)


_LEVEL = 3.84  # the 95 % point of chi-square with one degree of freedom
_GRID = 61


@dataclass(frozen=True, eq=False)
class MaxwellElementFit:
    """An arm along the moves of a test, and what it leaves of the courses of the plateaus."""

    courses: RelaxationCurves
    moves: TimedLoadingPaths

    def numbers(self, tau: float, used: NDArray[np.bool_]) -> tuple[float, float]:
        """The stiffness [N/m] of an arm of a time constant [s], 0 at least, and the common rate [N/s]."""
        return self._solved(tau, used)[:2]

    def cost(self, tau: float, used: NDArray[np.bool_]) -> float:
        """The sum of the squared residuals of the plateaus, each a mean over its samples [N^2]."""
        return self._solved(tau, used)[2]

    def stiffness_error(self, tau: float, used: NDArray[np.bool_]) -> float:
        """The standard error of the stiffness [N/m] of an arm of a given time constant [s]."""
        columns, residuals = self._left(tau, used)
        return math.sqrt(_covariance(columns, residuals, self.courses.weight)[0][0, 0])

    def time_constant(self, used: NDArray[np.bool_], lower: float, upper: float) -> float:
        """The one with the least squares, from a grid and then exactly."""
        grid = np.linspace(math.log(lower), math.log(upper), _GRID)
        at = int(np.argmin([self.cost(math.exp(log_tau), used) for log_tau in grid]))
        from scipy.optimize import minimize_scalar  # 0.1 s, which no import of the package should wait for

        found = minimize_scalar(
            lambda log_tau: self.cost(math.exp(log_tau), used),
            bounds=(float(grid[max(at - 1, 0)]), float(grid[min(at + 1, _GRID - 1)])),
            method="bounded",
            options={"xatol": 1e-6},
        )
        return math.exp(float(found.x))  # type: ignore[attr-defined]

    def uncertainty(self, tau: float, used: NDArray[np.bool_]) -> tuple[dict[str, float], float, float]:
        """Standard errors of stiffness and time constant, their correlation, and how much correlation in plateaus adds.

        The last is a ratio of variances, that of the time constant.
        """
        small = 1e-4
        after, before = (self._by_stiffness(tau * math.exp(sign * small)) for sign in (1, -1))
        columns, residuals = self._left(tau, used)
        by_log_tau = self.numbers(tau, used)[0] * (after - before)[used] / (2 * small)
        every = np.concatenate([columns, by_log_tau[..., None]], axis=-1)
        covariance, simple = _covariance(every, residuals, self.courses.weight)
        spread = np.sqrt(np.diag(covariance))
        errors = {"stiffness": float(spread[0]), "time_constant": float(spread[2]) * tau}
        return errors, float(covariance[0, 2] / (spread[0] * spread[2])), float(covariance[2, 2] / simple[2, 2])

    def between(
        self, tau: float, used: NDArray[np.bool_], lower: float, upper: float, excess: float
    ) -> tuple[float, float]:
        """The interval of 95 % of the time constant by its profile; 0 or infinity where it has no end."""
        least = self.cost(tau, used)
        freedom = int(used.sum()) * (len(self.courses.weight) - 1) - 3

        def distance(log_tau: float) -> float:
            """From the best one, in standard errors."""
            more = max(self.cost(math.exp(log_tau), used) / least - 1, 0.0) * freedom
            return math.sqrt(more / max(excess, 1.0)) - math.sqrt(_LEVEL)

        from scipy.optimize import brentq

        ends: list[float] = []
        for end, none in ((lower, 0.0), (upper, math.inf)):
            if distance(math.log(end)) <= 0:
                ends.append(none)
                continue
            near, far = math.log(tau), math.log(end)
            steps = np.linspace(near, far, _GRID)
            first = next(k for k in range(1, _GRID) if distance(steps[k]) > 0)
            ends.append(math.exp(brentq(distance, steps[first - 1], steps[first], xtol=1e-4)))  # type: ignore[arg-type]
        return ends[0], ends[1]

    def _by_stiffness(self, tau: float) -> NDArray[np.float64]:
        return self.moves.at_bound(tau)[:, None] * self.courses.blocks(np.exp(-self.courses.times / tau))

    def _solved(self, tau: float, used: NDArray[np.bool_]) -> tuple[float, float, float]:
        """Stiffness, common rate and cost: the normal equations of columns that are products of plateau and block."""
        values, weight = self.courses.values[used], self.courses.weight
        at_bound, decay, line = (
            self.moves.at_bound(tau)[used],
            self.courses.blocks(np.exp(-self.courses.times / tau)),
            self._line,
        )
        size1 = math.sqrt(at_bound @ at_bound * (decay**2 @ weight))
        size2 = math.sqrt(len(at_bound) * (line**2 @ weight))
        wanted1 = at_bound @ (values @ (weight * decay)) / size1 if size1 > 0 else 0.0
        wanted2 = float((values @ (weight * line)).sum()) / size2
        common = at_bound.sum() * ((decay * line) @ weight) / (size1 * size2) if size1 > 0 else 0.0
        first = (wanted1 - common * wanted2) / (1 - common**2) if abs(common) < 1 else 0.0
        first = max(float(first), 0.0)  # no arm pushes on in the direction of the move
        second = wanted2 - common * first
        cost = (
            float((values**2 @ weight).sum())
            - (2 * first * wanted1 + 2 * second * wanted2)
            + (first**2 + second**2 + 2 * common * first * second)
        )
        return (first / size1 if size1 > 0 else 0.0), float(second / size2), float(cost)

    def _left(self, tau: float, used: NDArray[np.bool_]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Columns, shape (plateaus, blocks, 2), and residuals, shape (plateaus, blocks)."""
        values = self.courses.values[used]
        columns = np.stack([self._by_stiffness(tau)[used], np.broadcast_to(self._line, values.shape)], axis=-1)
        return columns, values - columns @ np.array(self.numbers(tau, used))

    @property
    def _line(self) -> NDArray[np.float64]:
        return self.courses.blocks(self.courses.times)


def _covariance(
    columns: NDArray[np.float64], residuals: NDArray[np.float64], weight: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Of the numbers: with the residuals of a plateau correlated in whatever way, and with independent ones."""
    plateaus, blocks, count = columns.shape
    size = np.sqrt(np.einsum("pbi,pbi,b->i", columns, columns, weight))
    scaled = columns / size
    bread = np.linalg.pinv(np.einsum("pbi,pbj,b->ij", scaled, scaled, weight))
    score = np.einsum("pbi,pb,b->pi", scaled, residuals, weight)
    spread = float((residuals**2 @ weight).sum()) / (plateaus * (blocks - 1) - count)
    correlated = bread @ (score.T @ score) @ bread * plateaus / (plateaus - count)
    return correlated / np.outer(size, size), bread * spread / np.outer(size, size)
