"""Plateaus of the pressure in recordings at fixed lengths, and the force that follows the pressure with a delay."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from mckibben.dataset import Recording
from mckibben.dataset.segmentation import steady_segments
from mckibben.errors import IdentificationError
from mckibben.identification.estimator import Floats, Ints
from mckibben.identification.relaxation import GRID, RelaxationFit
from mckibben.muscle.creep import retained_fraction
from mckibben.units import kPa

if TYPE_CHECKING:
    from scipy.interpolate import PchipInterpolator

_FEWEST_LEVELS = 3  # of the pressure at a length
_FEWEST_PLATEAUS = 6
_MOVED = 0.001  # change of the contraction between two lengths [-]
_LEAST_BINS, _PARTS = 10, 20  # shortest time constant, in bins, and as a part of the longest plateau

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
        signals = [(self.pressure, _STEADY), (held, _MOVED / 2)]
        segments = steady_segments(signals, np.zeros(len(held), bool), _SHORTEST)
        before, plateaus = None, []
        for start, last in zip(segments.first.tolist(), segments.last.tolist(), strict=True):
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
        for plateau in plateaus:
            edges = _block_edges(plateau)
            samples = self.samples[: plateau.last]
            means = np.add.reduceat(self.pressure[: plateau.last] * samples, edges[:-1])
            means /= np.add.reduceat(samples, edges[:-1])
            pressure[plateau.first : plateau.last] = np.repeat(means, np.diff(edges))
        return dataclasses.replace(self, pressure=pressure)

    def lags(self, time_constants: Floats) -> Floats:
        """Lag of the delayed pressure behind the pressure [Pa], shape (bins, time constants)."""
        elapsed = np.diff(self.time)[:, None]
        decay = np.exp(-elapsed / time_constants)
        added = np.diff(self.pressure)[:, None] * retained_fraction(elapsed, time_constants)
        lags = np.zeros((len(self.time), len(time_constants)))
        for k in range(len(added)):
            np.multiply(lags[k], decay[k], out=lags[k + 1])
            lags[k + 1] += added[k]
        return lags


class LengthGroup(NamedTuple):
    """Plateaus at one length: their numbers, and the force [N] interpolated over the levels of the pressure."""

    contraction: float
    members: Ints
    interpolant: PchipInterpolator

    def force(self, pressure: Floats) -> Floats:
        """Force [N] over the pressure, constant outside the levels."""
        levels = self.interpolant.x
        return self.interpolant(np.clip(pressure, levels[0], levels[-1]))


def _block_edges(plateau: PressurePlateau) -> Ints:
    """Edges of the blocks of a plateau, in bins; narrower at its start."""
    count = plateau.last - plateau.first
    return plateau.first + np.unique(np.rint(count * np.linspace(0, 1, _BLOCKS + 1) ** 2).astype(np.int64))


def _mean_forces(bins: Sequence[RecordedBins], plateaus: Sequence[PressurePlateau]) -> Floats:
    """Mean force [N] of each plateau."""
    return np.array([bins[p.recording].force[p.first : p.last].mean() for p in plateaus])


def _length_groups(
    bins: Sequence[RecordedBins], plateaus: Sequence[PressurePlateau], forces: Floats
) -> list[LengthGroup]:
    """Plateaus by length, those at lengths with too few levels of the pressure left out."""
    contraction = np.array([p.contraction if math.isfinite(p.contraction) else -1.0 - p.recording for p in plateaus])
    pressure = np.array([bins[p.recording].pressure[p.first : p.last].mean() for p in plateaus])
    from scipy.interpolate import PchipInterpolator  # 0.3 s

    steps = np.array([p.step for p in plateaus])
    groups = []
    for members in _clusters(contraction, _MOVED):
        levels = [members[cluster] for cluster in _clusters(pressure[members], _LEVEL)]
        if len(levels) >= _FEWEST_LEVELS:
            at = float(np.mean([plateaus[k].contraction for k in members]))
            pressures = np.array([pressure[level].mean() for level in levels])
            interpolant = PchipInterpolator(pressures, _midway(levels, pressures, forces, steps))
            groups.append(LengthGroup(at, members, interpolant))
    return groups


def _midway(levels: Sequence[Ints], pressures: Floats, forces: Floats, steps: Floats) -> Floats:
    """Force [N] at each level midway between filling and venting, also at levels that were reached in one way only."""

    def means(side: float) -> Floats:
        chosen = [forces[level[steps[level] == side]] for level in levels]
        return np.array([values.mean() if len(values) else math.nan for values in chosen])

    filling, venting = means(1.0), means(-1.0)
    half, known = (filling - venting) / 2, np.isfinite(filling - venting)
    half = np.interp(pressures, pressures[known], half[known]) if known.any() else np.zeros(len(levels))
    middle = np.where(np.isfinite(filling), filling - half, venting + half)
    start = np.array([forces[level].mean() for level in levels])  # reached by no step
    return np.where(np.isfinite(middle), middle, start)


def _clusters(values: Floats, distance: float) -> list[Ints]:
    """Indices of values whose neighbours are closer than a distance."""
    order = np.argsort(values, kind="stable")
    return np.split(order, np.flatnonzero(np.diff(values[order]) > distance) + 1) if len(order) else []


@dataclass(frozen=True, eq=False)
class DelayedForce:
    """Plateaus of the pressure by length, and the force that follows a delayed pressure."""

    bins: Sequence[RecordedBins]
    plateaus: Sequence[PressurePlateau]
    groups: Sequence[LengthGroup]

    @classmethod
    def of(cls, bins: Sequence[RecordedBins]) -> DelayedForce:
        """Plateaus of recordings; an `IdentificationError` if there are too few."""
        plateaus = [plateau for number, recorded in enumerate(bins) for plateau in recorded.plateaus(number)]
        groups = _length_groups(bins, plateaus, _mean_forces(bins, plateaus))
        used = sorted(int(k) for group in groups for k in group.members)
        if len(used) < _FEWEST_PLATEAUS:
            message = f"{len(used)} plateaus of the pressure, at lengths with at least {_FEWEST_LEVELS} levels"
            remedy = "step the pressure up and down over several levels at a fixed length, and wait at each"
            raise IdentificationError(message, value=len(used), lower=_FEWEST_PLATEAUS, remedy=remedy)
        place = {k: number for number, k in enumerate(used)}
        plateaus = [plateaus[k] for k in used]
        groups = [group._replace(members=np.array([place[int(k)] for k in group.members])) for group in groups]
        smoothed = [recorded.smoothed([p for p in plateaus if p.recording == n]) for n, recorded in enumerate(bins)]
        return cls(smoothed, plateaus, groups)

    def fit(self) -> RelaxationFit:
        """Fit of the share of the force that follows with a delay."""
        edges = [_block_edges(plateau) for plateau in self.plateaus]
        weight = [
            np.add.reduceat(self.bins[plateau.recording].samples[: plateau.last], edge[:-1])
            for plateau, edge in zip(self.plateaus, edges, strict=True)
        ]
        owner = np.repeat(np.arange(len(edges)), [len(edge) - 1 for edge in edges])
        times = [self.bins[p.recording].time[p.first : p.last] for p in self.plateaus]
        longest = float(max(time[-1] - time[0] for time in times))
        shortest = min(float(np.median(np.diff(recorded.time))) for recorded in self.bins)
        # With quicker time constants, the noise of the pressure passes for creep.
        grid = np.geomspace(max(_LEAST_BINS * shortest, longest / _PARTS), 5 * longest, GRID)
        values = self._blocks(
            self._by_plateau(lambda group, bins, at, _: bins.force[at] - group.force(bins.pressure[at]))
        )
        return RelaxationFit(
            values,
            self._blocks(times),
            np.concatenate(weight),
            owner,
            lambda time_constants: self._blocks(self._delayed(time_constants)),
            grid,
            removed=2,
        )

    def corrected(self, fit: RelaxationFit) -> DelayedForce:
        """The same with levels without the creep that is left in the means of the plateaus."""
        delayed = self._delayed(np.array([fit.time_constant]))
        left = np.array([fit.solution[0] * float(values.mean()) for values in delayed])
        means = _mean_forces(self.bins, self.plateaus)
        return dataclasses.replace(self, groups=_length_groups(self.bins, self.plateaus, means - left))

    def conditions(self) -> dict[str, Floats]:
        """Quantities of the plateaus on which the share may depend, from 0 to 1, where they differ."""
        conditions = {
            "contraction": np.array([p.contraction for p in self.plateaus]),
            "pressure": np.array([self.bins[p.recording].pressure[p.first : p.last].mean() for p in self.plateaus]),
            "direction": np.array([p.step for p in self.plateaus]),
        }
        return {
            name: (values - values.min()) / np.ptp(values)
            for name, values in conditions.items()
            if np.isfinite(values).all() and np.ptp(values) > (_MOVED if name == "contraction" else 0)
        }

    def _delayed(self, time_constants: Floats) -> list[Floats]:
        """Derivative of the force of each bin of each plateau with respect to the share [N], (bins, time constants)."""
        lags = [recorded.lags(time_constants) for recorded in self.bins]

        def delayed(group: LengthGroup, bins: RecordedBins, at: slice, recording: int) -> Floats:
            pressure = bins.pressure[at, None]
            return group.force(pressure - lags[recording][at]) - group.force(pressure)

        return self._by_plateau(delayed)

    def _by_plateau(self, compute: Callable[[LengthGroup, RecordedBins, slice, int], Floats]) -> list[Floats]:
        """Values of the bins of each plateau, from its group and its slice of bins."""
        values: dict[int, Floats] = {}
        for group in self.groups:
            for k in group.members.tolist():
                p = self.plateaus[k]
                values[k] = compute(group, self.bins[p.recording], slice(p.first, p.last), p.recording)
        return [values[k] for k in range(len(self.plateaus))]

    def _blocks(self, values: Sequence[Floats]) -> Floats:
        """Values of the bins by block, (blocks, ...), without the mean and the part affine in pressure of a plateau."""
        parts = []
        for plateau, own in zip(self.plateaus, values, strict=True):
            bins, edges = self.bins[plateau.recording], _block_edges(plateau)[:-1]
            samples = bins.samples[: plateau.last]
            sizes = np.add.reduceat(samples, edges)
            pressure = np.add.reduceat(bins.pressure[: plateau.last] * samples, edges) / sizes
            weighted = (own.T * samples[plateau.first :]).T
            means = (np.add.reduceat(weighted, edges - plateau.first).T / sizes).T
            for direction in (np.ones(len(sizes)), pressure - np.average(pressure, weights=sizes)):
                scale = float(sizes @ direction**2)
                if scale > 0:
                    means = means - np.multiply.outer(direction, (sizes * direction) @ means / scale)
            parts.append(means)
        return np.concatenate(parts)
