"""Relaxation curves of the force within plateaus, and the fit of a Maxwell element to them."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mckibben.dataset import IsobaricDataset
from mckibben.errors import IdentificationError
from mckibben.identification.estimator import Bools, Floats, Ints, minimum_near
from mckibben.identification.loading_path import LoadingPaths
from mckibben.muscle.creep import retained_fraction

_BLOCKS = 16  # blocks to which the samples of a plateau are averaged: an exponential is smooth
_CLOCK_ERROR = 0.05  # s, of the times of points


@dataclass(frozen=True, eq=False)
class TimedLoadingPaths:
    """Loading paths with the durations of moves and plateaus [s]."""

    paths: LoadingPaths
    moving: Floats = field(repr=False)
    before: Floats = field(repr=False)
    slack: Bools = field(repr=False)
    dwell: float

    @classmethod
    def of(cls, means: IsobaricDataset, dwell: float, speed: float, acquisition: float) -> TimedLoadingPaths:
        """Paths of plateau means, with dwell and duration of the samples [s], and speed of the moves [m/s]."""
        if len(means.directions) < 2:
            raise IdentificationError(
                "the dataset lacks one direction: sensor drift cannot be distinguished from creep",
                remedy="measure while stretching and while shortening, and give the direction of each point",
            )
        paths = LoadingPaths.of(means)
        moving = np.abs(paths.displacement) / speed
        before = moving + dwell + acquisition
        if "time" in means.table:
            time = means.table["time"].to_numpy()[paths.place]
            elapsed = np.diff(time, axis=0, prepend=time[:1])
            real = np.arange(len(time))[:, None] < paths.counts
            real[0] = False
            lacking = float((before - elapsed)[real].max(initial=-math.inf))
            if lacking > _CLOCK_ERROR:
                message = f"move, wait and samples take {lacking:.3g} s longer than the time between two points"
                remedy = "check interval, dwell, speed and the times of the points"
                raise IdentificationError(message, value=lacking, unit="s", remedy=remedy)
            before = np.where(real, elapsed, before)
        return cls(paths, moving, before, means.slack[paths.place], dwell)

    @property
    def longest(self) -> float:
        """Duration of the longest path [s]."""
        return float(self.before.sum(axis=0).max())

    @property
    def sides(self) -> Floats:
        """Sign of the last move, shape (rows,): 1 stretching, -1 shortening, 0 none."""
        displacement = self.paths.displacement
        return self.paths.scattered(np.sign(np.where(np.abs(displacement) > 1e-9, displacement, 0.0)))

    def deflection(self, time_constant: float) -> Floats:
        """Deflection [m] of a Maxwell element's spring at the first sample, shape (rows,)."""
        decay = np.exp(-self.before / time_constant)
        added = self.paths.displacement * retained_fraction(self.moving, time_constant)
        deflections = np.empty_like(added)
        now = np.zeros(added.shape[1])
        for k in range(len(added)):
            now = np.where(self.slack[k], 0.0, now * decay[k] + added[k])
            deflections[k] = now
        return self.paths.scattered(deflections) * math.exp(-self.dwell / time_constant)

    def stiffness(self, means: IsobaricDataset, used: Bools) -> float:
        """Median stiffness of the muscle over the moves between used points [N/m]."""
        place = self.paths.place
        displacement = self.paths.displacement[1:]
        both = used[place][1:] & used[place][:-1] & (np.abs(displacement) > 1e-9)
        return float(np.median(np.diff(means.force[place], axis=0)[both] / displacement[both]))


class RelaxationCurves(NamedTuple):
    """Samples of each plateau, averaged in blocks, less their mean."""

    values: Floats
    weight: Floats
    edges: Ints
    times: Floats

    @classmethod
    def of(cls, samples: NDArray, interval: float) -> RelaxationCurves:
        """Curves of raw samples, shape (rows, samples), at a sampling interval [s]."""
        count = samples.shape[1]
        edges = np.unique(np.linspace(0, count, min(_BLOCKS, count) + 1).astype(np.int64))
        sizes = np.diff(edges)
        blocks = np.add.reduceat(samples, edges[:-1], axis=1, dtype=np.float64) / sizes
        weight = sizes / count
        return cls(blocks - (blocks @ weight)[:, None], weight, edges[:-1], np.arange(count) * interval)

    @property
    def duration(self) -> float:
        """Time from the first sample to the last [s]."""
        return float(self.times[-1])

    def blocks(self, curve: Floats) -> Floats:
        """Curve over the samples, averaged in the same blocks, less its mean."""
        blocks = np.add.reduceat(curve, self.edges) / (self.weight * len(self.times))
        return blocks - blocks @ self.weight

    @property
    def slopes(self) -> Floats:
        """Slope of the least-squares line through each plateau [N/s], shape (rows,)."""
        line = self.blocks(self.times)
        return self.values @ (self.weight * line) / (line**2 @ self.weight)


_CHI_SQUARE = 3.84  # 95 % point with one degree of freedom
_GRID = 61


@dataclass(frozen=True, eq=False)
class MaxwellElementFit:
    """Least-squares fit of a Maxwell element and a common drift rate to relaxation curves."""

    curves: RelaxationCurves
    paths: TimedLoadingPaths

    def stiffness_and_rate(self, tau: float, used: Bools) -> tuple[float, float]:
        """Stiffness [N/m], at least 0, and common rate [N/s] for a time constant [s]."""
        stiffness, rate = self._fit(tau, used)[1].tolist()
        return stiffness, rate

    def cost(self, tau: float, used: Bools) -> float:
        """Sum over the plateaus of the mean squared residual [N^2]."""
        return float((self._fit(tau, used)[2] ** 2 @ self.curves.weight).sum())

    def stiffness_error(self, tau: float, used: Bools) -> float:
        """Standard error of the stiffness [N/m] at a given time constant [s]."""
        columns, _, residuals = self._fit(tau, used)
        return math.sqrt(_covariance(columns, residuals, self.curves.weight)[0][0, 0])

    def time_constant(self, used: Bools, lower: float, upper: float) -> float:
        """Least-squares time constant [s]: from a grid, then refined."""
        grid = np.linspace(math.log(lower), math.log(upper), _GRID).tolist()

        def cost(log_tau: float) -> float:
            return self.cost(math.exp(log_tau), used)

        return math.exp(minimum_near(cost, grid, list(map(cost, grid)), 1e-6))

    def uncertainty(self, tau: float, used: Bools) -> tuple[dict[str, float], float]:
        """Standard errors of stiffness and time constant, and the variance inflation."""
        small = 1e-4
        after, before = (self._by_stiffness(tau * math.exp(sign * small)) for sign in (1, -1))
        columns, found, residuals = self._fit(tau, used)
        by_log_tau = found[0] * (after - before)[used] / (2 * small)
        every = np.concatenate([columns, by_log_tau[..., None]], axis=-1)
        covariance, classical = _covariance(every, residuals, self.curves.weight)
        deviations = np.sqrt(np.diag(covariance))
        errors = {"stiffness": float(deviations[0]), "time_constant": float(deviations[2]) * tau}
        return errors, float(covariance[2, 2] / classical[2, 2])

    def time_constant_interval(
        self, tau: float, used: Bools, lower: float, upper: float, inflation: float
    ) -> tuple[float, float]:
        """95 % profile interval of the time constant; 0 or infinite where the data impose no bound."""
        from scipy.optimize import brentq

        least = self.cost(tau, used)
        freedom = int(used.sum()) * (len(self.curves.weight) - 1) - 3

        def excess(log_tau: float) -> float:
            worse = max(self.cost(math.exp(log_tau), used) / least - 1, 0.0) * freedom
            return math.sqrt(worse / max(inflation, 1.0)) - math.sqrt(_CHI_SQUARE)

        ends: list[float] = []
        for end, open_end in ((lower, 0.0), (upper, math.inf)):
            if excess(math.log(end)) <= 0:
                ends.append(open_end)
                continue
            steps = np.linspace(math.log(tau), math.log(end), _GRID)
            first = next(k for k in range(1, _GRID) if excess(steps[k]) > 0)
            ends.append(math.exp(brentq(excess, steps[first - 1], steps[first], xtol=1e-4)))  # type: ignore[arg-type]
        return ends[0], ends[1]

    def _by_stiffness(self, tau: float) -> Floats:
        return self.paths.deflection(tau)[:, None] * self.curves.blocks(np.exp(-self.curves.times / tau))

    def _fit(self, tau: float, used: Bools) -> tuple[Floats, Floats, Floats]:
        """Columns (plateaus, blocks, 2), stiffness and common rate, and residuals (plateaus, blocks)."""
        values, root = self.curves.values[used], np.sqrt(self.curves.weight)
        line = np.broadcast_to(self.curves.blocks(self.curves.times), values.shape)
        columns = np.stack([self._by_stiffness(tau)[used], line], axis=-1)
        weighted, target = (columns * root[:, None]).reshape(-1, 2), (values * root).ravel()
        found: Any = np.linalg.lstsq(weighted, target, rcond=None)[0]
        if found[0] < 0:  # a passive element has no negative stiffness
            found = np.array([0.0, weighted[:, 1] @ target / (weighted[:, 1] @ weighted[:, 1])])
        return columns, found, values - columns @ found


def _covariance(columns: Floats, residuals: Floats, weight: Floats) -> tuple[Floats, Floats]:
    """Covariance with residuals correlated within plateaus, and with independent ones."""
    plateaus, blocks, count = columns.shape
    size = np.sqrt(np.einsum("pbi,pbi,b->i", columns, columns, weight))
    scaled = columns / size
    bread = np.linalg.pinv(np.einsum("pbi,pbj,b->ij", scaled, scaled, weight))
    score = np.einsum("pbi,pb,b->pi", scaled, residuals, weight)
    variance = float((residuals**2 @ weight).sum()) / (plateaus * (blocks - 1) - count)
    correlated = bread @ (score.T @ score) @ bread * plateaus / (plateaus - count)
    return correlated / np.outer(size, size), bread * variance / np.outer(size, size)
