"""Plateaus of the pressure in recordings at fixed lengths, and the lag of a delayed pressure."""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from mckibben.dataset import Recording
from mckibben.dataset.segmentation import steady_segments
from mckibben.errors import IdentificationError
from mckibben.identification.estimator import Floats, Ints
from mckibben.muscle.creep import retained_fraction
from mckibben.units import kPa

if TYPE_CHECKING:
    from scipy.interpolate import PchipInterpolator

FEWEST_LEVELS = 3
"""Fewest levels of the pressure at a length."""
MOVED = 0.001
"""Change of the contraction between two lengths [-]."""

_BINS = 20_000  # a recording is averaged to this number of bins at most
_BLOCKS = 16  # of a plateau, narrower at its start
_STEADY = 2 * kPa  # largest deviation of the pressure in a plateau from its middle
_SHORTEST = 20  # bins of a plateau
_SETTLING = 20  # parts of a plateau, of which the first is left out: the valve settles
_LEVEL = 10 * kPa  # distance of two levels of the pressure


class PressurePlateau(NamedTuple):
    """Bins of a steady pressure: recording, first and one past the last bin, contraction, and direction of the step."""

    recording: int
    first: int
    last: int
    contraction: float
    step: float


@dataclass(frozen=True, eq=False)
class RecordedBins:
    """Means of a recording over equal times, empty ones left out."""

    time: Floats
    pressure: Floats
    force: Floats
    contraction: Floats
    samples: Floats

    @classmethod
    def of(cls, recording: Recording) -> RecordedBins:
        time = recording.time
        intervals = np.sort(np.diff(time))
        if not len(intervals) or not time[-1] > time[0]:
            raise IdentificationError("the time of a recording does not advance", remedy="check its time column")
        at = np.searchsorted(np.cumsum(intervals), (time[-1] - time[0]) / 2)  # half of the time has shorter intervals
        width = max(float(intervals[at]), (time[-1] - time[0]) / _BINS)
        number = np.floor((time - time[0]) / width * (1 + 1e-9)).astype(np.int64)
        of = np.cumsum(np.diff(number, prepend=number[0]) > 0)
        samples = np.bincount(of).astype(float)
        contraction = recording.contraction
        columns = (
            time,
            recording.pressure,
            recording.force,
            np.zeros(len(time)) if contraction is None else contraction,
        )
        means = [np.bincount(of, column) / samples for column in columns]
        if contraction is None:
            means[3] = np.full(len(samples), math.nan)
        return cls(means[0], means[1], means[2], means[3], samples)

    def plateaus(self, number: int) -> list[PressurePlateau]:
        """Plateaus of the pressure at one length, with the direction of the step before each."""
        held = np.where(np.isfinite(self.contraction), self.contraction, 0.0)
        signals = [(self.pressure, _STEADY), (held, MOVED / 2)]
        found = steady_segments(signals, np.zeros(len(held), bool), _SHORTEST)
        before, plateaus = None, []
        for start, last in zip(found.first.tolist(), found.last.tolist(), strict=True):
            first = start + max(1, (last - start) // _SETTLING)
            pressure = float(self.pressure[first:last].mean())
            step = 0.0 if before is None else pressure - before
            if before is None or abs(step) >= _LEVEL:
                contraction = float(self.contraction[first:last].mean())
                plateaus.append(PressurePlateau(number, first, last, contraction, float(np.sign(step))))
            before = pressure
        return plateaus

    def smoothed(self, plateaus: Sequence[PressurePlateau]) -> RecordedBins:
        """The bins with the mean pressure of its block in each bin of a plateau, as noise would bias the lag."""
        pressure = self.pressure.copy()
        for one in plateaus:
            edges = block_edges(one)
            samples = self.samples[: one.last]
            means = np.add.reduceat(self.pressure[: one.last] * samples, edges[:-1])
            means /= np.add.reduceat(samples, edges[:-1])
            pressure[one.first : one.last] = np.repeat(means, np.diff(edges))
        return dataclasses.replace(self, pressure=pressure)


@functools.lru_cache(maxsize=8)
def pressure_lags(bins: RecordedBins, time_constants: tuple[float, ...]) -> Floats:
    """Lag of the delayed pressure behind the pressure [Pa], shape (bins, time constants)."""
    elapsed, taus = np.diff(bins.time)[:, None], np.array(time_constants)
    decay, added = np.exp(-elapsed / taus), np.diff(bins.pressure)[:, None] * retained_fraction(elapsed, taus)
    found = np.zeros((len(bins.time), len(taus)))
    for k in range(len(added)):
        np.multiply(found[k], decay[k], out=found[k + 1])
        found[k + 1] += added[k]
    return found


class LengthGroup(NamedTuple):
    """Plateaus at one length: their numbers, and the force [N] interpolated over the levels of the pressure."""

    contraction: float
    members: Ints
    interpolant: PchipInterpolator

    def force(self, pressure: Floats) -> Floats:
        """Force [N] over the pressure, constant outside the levels."""
        levels = self.interpolant.x
        return self.interpolant(np.clip(pressure, levels[0], levels[-1]))


def block_edges(plateau: PressurePlateau) -> Ints:
    """Edges of the blocks of a plateau, in bins; narrower at its start."""
    count = plateau.last - plateau.first
    return plateau.first + np.unique(np.rint(count * np.linspace(0, 1, _BLOCKS + 1) ** 2).astype(np.int64))


def mean_forces(bins: Sequence[RecordedBins], plateaus: Sequence[PressurePlateau]) -> Floats:
    """Mean force [N] of each plateau."""
    return np.array([bins[one.recording].force[one.first : one.last].mean() for one in plateaus])


def length_groups(
    bins: Sequence[RecordedBins], plateaus: Sequence[PressurePlateau], forces: Floats
) -> list[LengthGroup]:
    """Plateaus by length, those at lengths with too few levels of the pressure left out."""
    contraction = np.array(
        [one.contraction if math.isfinite(one.contraction) else -1.0 - one.recording for one in plateaus]
    )
    pressure = np.array([bins[one.recording].pressure[one.first : one.last].mean() for one in plateaus])
    from scipy.interpolate import PchipInterpolator  # 0.3 s

    steps = np.array([one.step for one in plateaus])
    groups = []
    for members in _clusters(contraction, MOVED):
        levels = [members[one] for one in _clusters(pressure[members], _LEVEL)]
        if len(levels) >= FEWEST_LEVELS:
            at = float(np.mean([plateaus[k].contraction for k in members]))
            pressures = np.array([pressure[one].mean() for one in levels])
            interpolant = PchipInterpolator(pressures, _midway(levels, pressures, forces, steps))
            groups.append(LengthGroup(at, members, interpolant))
    return groups


def _midway(levels: Sequence[Ints], pressures: Floats, forces: Floats, steps: Floats) -> Floats:
    """Force [N] at each level midway between filling and venting, also at levels that were reached in one way only."""

    def means(side: float) -> Floats:
        chosen = [forces[one[steps[one] == side]] for one in levels]
        return np.array([one.mean() if len(one) else math.nan for one in chosen])

    filling, venting = means(1.0), means(-1.0)
    half, known = (filling - venting) / 2, np.isfinite(filling - venting)
    half = np.interp(pressures, pressures[known], half[known]) if known.any() else np.zeros(len(levels))
    found = np.where(np.isfinite(filling), filling - half, venting + half)
    start = np.array([forces[one].mean() for one in levels])  # reached by no step
    return np.where(np.isfinite(found), found, start)


def _clusters(values: Floats, distance: float) -> list[Ints]:
    """Indices of values whose neighbours are closer than a distance."""
    order = np.argsort(values, kind="stable")
    return np.split(order, np.flatnonzero(np.diff(values[order]) > distance) + 1) if len(order) else []
