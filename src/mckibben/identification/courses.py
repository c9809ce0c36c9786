"""How the force moves while the muscle stands: samples of plateaus in blocks, and what an arm has left at each."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mckibben.dataset import IsobaricDataset
from mckibben.errors import IdentificationError
from mckibben.identification.strokes import Strokes
from mckibben.muscle.creep import remaining

BLOCKS = 16
"""To so many the samples of a plateau are averaged: an exponential is smooth."""

_SAME = 0.05  # s: times of points are hardly better


@dataclass(frozen=True, eq=False)
class Moves:
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

    strokes: Strokes
    moving: NDArray[np.float64] = field(repr=False)
    before: NDArray[np.float64] = field(repr=False)
    slack: NDArray[np.bool_] = field(repr=False)
    dwell: float

    @classmethod
    def of(cls, means: IsobaricDataset, dwell: float, speed: float, acquisition: float) -> Moves:
        """Those of plateau means, with the times [s] of a wait and of the samples, and the speed [m/s].

        Raises
        ------
        IdentificationError
            As `Strokes.of`, or if all that takes longer than there is between two points.
        """
        if len(means.directions) < 2:
            raise IdentificationError(
                "the dataset has not both directions: then a sensor that drifts looks like creep",
                remedy="measure while stretching and while shortening, and give the direction of each point",
            )
        strokes = Strokes.of(means)
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

    def held(self, time_constant: float) -> NDArray[np.float64]:
        """The stretch [m] that an arm holds at the first sample, shape (rows,)."""
        carried = np.exp(-self.before / time_constant)
        added = self.strokes.travel * remaining(self.moving, time_constant)
        held = np.empty_like(added)
        now = np.zeros(added.shape[1])
        for k in range(len(added)):
            now = np.where(self.slack[k], 0.0, now * carried[k] + added[k])
            held[k] = now
        return self.strokes.scattered(held) * math.exp(-self.dwell / time_constant)

    def stiffness(self, means: IsobaricDataset, used: NDArray[np.bool_]) -> float:
        """Of the muscle [N/m]: the median of force per length over the moves between used points."""
        place = self.strokes.place
        travel = self.strokes.travel[1:]
        both = used[place][1:] & used[place][:-1] & (np.abs(travel) > 1e-9)
        return float(np.median(np.diff(means.force[place], axis=0)[both] / travel[both]))


class Courses(NamedTuple):
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
    def of(cls, samples: NDArray, interval: float) -> Courses:
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
