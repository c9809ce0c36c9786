"""Identification of creep: the course of the force within plateaus of the pressure at fixed lengths.

The blocks of all plateaus, less what is free for each of them, are y = beta c(tau) + v t with an amplitude beta, the
column c of one time constant, and a common rate v such as that of sensor drift. Errors are correlated within plateaus.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from mckibben.dataset import Recording
from mckibben.dataset.segmentation import steady_segments
from mckibben.errors import IdentificationError
from mckibben.identification.estimator import (
    Floats,
    Ints,
    robust_errors,
    t_quantile,
)
from mckibben.muscle import MaxwellCreep, NoCreep
from mckibben.muscle.creep import retained_fraction
from mckibben.result import Remark, Result, column
from mckibben.units import kPa, percent

if TYPE_CHECKING:
    from scipy.interpolate import PchipInterpolator

_LARGEST = 0.5  # share of the form
_FEWEST_LEVELS = 2  # of the pressure at a length
_FEWEST_PLATEAUS = 2
_SURE = 6  # plateaus by which errors in common to one are known
_MOVED = 0.001  # change of the contraction between two lengths [-]
_LEVEL = 10 * kPa  # distance of two levels of the pressure
_PARTS = 20  # of a plateau: the valve settles in the first, and no time constant is shorter
_GRID = 61  # time constants of a search


class CreepFit(Result):
    """Creep within plateaus, or its absence; returned by `identify_pressure_creep`.

    Attributes
    ----------
    creep
        `MaxwellCreep` with a `pressure_share`; `NoCreep` if no creep is significant.
    p_value
        Upper bound of the probability of this reduction of the squares if there is no creep (test of the nested models,
        with errors that are correlated within plateaus). Creep is significant below `significance`.
    share, share_interval
        Share of the law that follows with a delay [-], and its 95 % interval; infinite where the data impose no bound
        on the time constant, with which it varies.
    time_constant, time_constant_interval
        Time constant [s] and its 95 % interval; 0 or infinite where the data impose no bound.
    residual
        Root mean square [N] of the residuals within plateaus, averaged to 16 blocks each.
    common_rate
        Rate of the force common to all plateaus, such as sensor drift [N/s].
    plateaus
        Number of plateaus used.
    notes
        Reasons not to rely on the results.
    """

    creep: MaxwellCreep | NoCreep
    p_value: float = column("1", "probability without creep", digits=2)
    share: float = column("1", "delayed share")
    share_interval: tuple[float, float]
    time_constant: float = column("s", "time constant", digits=3)
    time_constant_interval: tuple[float, float]
    residual: float = column("N", "RMS residual", digits=2)
    common_rate: float = column("N/s", "rate common to all plateaus", digits=2)
    plateaus: int = column("", "plateaus used")
    notes: tuple[Remark, ...] = ()

    @property
    def is_significant(self) -> bool:
        """True if creep is significant."""
        return isinstance(self.creep, MaxwellCreep)

    def verdict(self) -> str:
        """Return amplitude and time constant with their intervals."""
        if not self.is_significant:
            return f"no significant creep in {self.plateaus} plateaus (p = {self.p_value:.2g})"
        (low, high), (short, long) = self.share_interval, self.time_constant_interval
        span = f"{low / percent:.3g} .. {high / percent:.3g}" if math.isfinite(low) else "not determined"
        return (
            f"creep with a share of {self.share / percent:.3g} % ({span}) and a time constant of "
            f"{self.time_constant:.3g} s ({short:.3g} .. {long:.3g}), 95 % intervals in parentheses"
        )

    def remarks(self) -> Iterable[Remark]:
        """Return the notes."""
        return self.notes


def identify_pressure_creep(recordings: Recording | Sequence[Recording], *, significance: float = 0.01) -> CreepFit:
    r"""Identify the share of the force that follows steps of the pressure with a delay, at fixed lengths.

    Within plateau j of the pressure

    .. math:: F = a_j + b_j p + f(p) + \varphi \big(f(y) - f(p)\big) + v t, \qquad \dot y = \frac{p - y}{\tau}

    with a free line over the pressure per plateau, a rate v common to all, and the force f over the pressure at each
    length, interpolated between the means of the plateaus (docs/hysteresis.md).

    Parameters
    ----------
    recordings
        Recordings of isometric tests: each at one fixed length, or at several lengths one after another.
    significance
        Probability of creep that does not exist.

    Raises
    ------
    IdentificationError
        If there are fewer than two levels of the pressure at each length.

    Examples
    --------
    Steps between 1, 2 and 3 bar at 100 N/bar, of which 8 % follow with 4 s:

    >>> import numpy as np
    >>> time = np.arange(0, 120, 0.01)
    >>> pressure, delayed = 1e5 * (1 + np.array([0, 1, 2, 1, 0, 2])[(time // 20).astype(int)]), np.full(len(time), 1e5)
    >>> for k in range(1, len(time)):
    ...     delayed[k] = delayed[k - 1] + 0.01 / 4 * (pressure[k - 1] - delayed[k - 1])
    >>> noise = np.random.default_rng(1).normal(0, 0.2, len(time))
    >>> force = 1e-3 * (pressure + 0.08 * (delayed - pressure)) + noise
    >>> fit = identify_pressure_creep(Recording.of(time=time, pressure=pressure, force=force, contraction=0.05))
    >>> round(fit.share, 2), round(fit.time_constant, 1), fit.plateaus
    (0.08, 4.0, 6)
    """
    recordings = [recordings] if isinstance(recordings, Recording) else recordings
    delayed = DelayedForce.of([RecordedBins.of(recording, number) for number, recording in enumerate(recordings)])
    for _ in range(2):  # creep is left in the means of the plateaus
        delayed = delayed.corrected()
    share, rate, residuals = delayed.solution
    tau, (low, high) = delayed.time_constant, delayed.time_constant_interval
    error, freedom = delayed.error
    half = float(t_quantile(0.95, freedom)) * error if 0 < low and high < math.inf else math.inf
    significant, notes = delayed.p_value < significance, []
    if len(delayed.plateaus) < _SURE:
        text = f"{len(delayed.plateaus)} plateaus do not tell creep from a zero that wanders; the errors leave that out"
        notes.append(Remark.warning("plateaus", text, f"step the pressure up and down, {_SURE} times or more"))
    if significant and abs(share) > _LARGEST:
        text = f"the share of {share / percent:.3g} % is beyond the 50 % of the form"
        notes.append(Remark.warning("creep", text))
    if significant and half == math.inf:
        bounds = f"at least {low:.3g} s" if high == math.inf else f"at most {high:.3g} s"
        remedy = "record longer plateaus, sooner after the step, or more of them"
        notes.append(Remark.warning("time_constant", f"the time constant is not determined: {bounds}", remedy))
    return CreepFit(
        creep=MaxwellCreep(0.0, tau, pressure_share=min(max(share, -_LARGEST), _LARGEST)) if significant else NoCreep(),
        p_value=delayed.p_value,
        share=share,
        share_interval=(share - half, share + half),
        time_constant=tau,
        time_constant_interval=(low, high),
        residual=math.sqrt(float(residuals @ residuals / (delayed.root @ delayed.root))),
        common_rate=rate,
        plateaus=len(delayed.plateaus),
        notes=tuple(notes),
    )


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

    samples: Floats
    time: Floats
    pressure: Floats
    force: Floats
    contraction: Floats

    @classmethod
    def of(cls, recording: Recording, number: int, *, most: int = 20_000) -> RecordedBins:
        """Bins of a recording, of one sample or longer, so that there are at most `most`.

        Without contraction, each number of a recording is another length.
        """
        time = recording.time
        if not len(time) or not time[-1] > time[0]:
            raise IdentificationError("the time of a recording does not advance", remedy="check its time column")
        width = max(float(np.median(np.diff(time))), (time[-1] - time[0]) / most)
        bins = np.unique(np.floor((time - time[0]) / width * (1 + 1e-9)), return_inverse=True)[1]
        samples = np.bincount(bins).astype(float)
        contraction = np.full(len(time), -1.0 - number) if recording.contraction is None else recording.contraction
        columns = (time, recording.pressure, recording.force, contraction)
        return cls(samples, *(np.bincount(bins, column) / samples for column in columns))

    def plateaus(self, number: int, *, steady: float = 2 * kPa) -> list[PressurePlateau]:
        """Plateaus of the pressure at one length, with the direction of the step before each.

        In a plateau the pressure is within `steady` [Pa] of its middle. Of a recording of one plateau, into which the
        muscle is filled or vented, the first sample is the level before.
        """
        signals = [(self.pressure, steady), (self.contraction, _MOVED)]
        segments = steady_segments(signals, np.zeros(len(self.time), bool), _PARTS)
        before, plateaus = None, []
        for start, last in zip(segments.first.tolist(), segments.last.tolist(), strict=True):
            first = start + max(1, (last - start) // _PARTS)
            pressure = float(self.pressure[first:last].mean())
            step = 0.0 if before is None else pressure - before
            if before is None or abs(step) >= _LEVEL:
                contraction = float(self.contraction[first:last].mean())
                plateaus.append(PressurePlateau(number, first, last, contraction, float(np.sign(step))))
            before = pressure
        start = PressurePlateau(number, 0, 1, float(self.contraction[0]), 0.0)
        held = len(plateaus) == 1 and plateaus[0].first
        if held and abs(jump := float(self.pressure[plateaus[0].first] - self.pressure[0])) >= _LEVEL:
            return [start, plateaus[0]._replace(step=float(np.sign(jump)))]
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


def _block_edges(plateau: PressurePlateau, *, blocks: int = 16) -> Ints:
    """Edges of the blocks of a plateau, in bins; narrower at its start."""
    count = plateau.last - plateau.first
    return plateau.first + np.unique(np.rint(count * np.linspace(0, 1, blocks + 1) ** 2).astype(np.int64))


def _bins_of(bins: Sequence[RecordedBins], plateaus: Sequence[PressurePlateau], name: str) -> list[Floats]:
    """Values of the bins of each plateau, by the name of the signal."""
    return [getattr(bins[p.recording], name)[p.first : p.last] for p in plateaus]


def _interpolants(
    bins: Sequence[RecordedBins], plateaus: Sequence[PressurePlateau], forces: Floats
) -> list[PchipInterpolator | None]:
    """Force [N] over the levels of the pressure [Pa] at the length of each plateau; None with too few levels."""
    from scipy.interpolate import PchipInterpolator  # 0.3 s

    contraction = np.array([plateau.contraction for plateau in plateaus])
    pressure = np.array([values.mean() for values in _bins_of(bins, plateaus, "pressure")])
    steps = np.array([p.step for p in plateaus])
    interpolants: list[PchipInterpolator | None] = [None] * len(plateaus)
    for members in _clusters(contraction, _MOVED):
        levels = [members[cluster] for cluster in _clusters(pressure[members], _LEVEL)]
        if len(levels) >= _FEWEST_LEVELS:
            pressures = np.array([pressure[level].mean() for level in levels])
            interpolant = PchipInterpolator(pressures, _midway(levels, pressures, forces, steps))
            for k in members.tolist():
                interpolants[k] = interpolant
    return interpolants


def _clipped(interpolant: PchipInterpolator, pressure: Floats) -> Floats:
    """Force [N] over the pressure, constant outside the levels."""
    return interpolant(np.clip(pressure, interpolant.x[0], interpolant.x[-1]))


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
    """Plateaus of the pressure by length, and the least-squares fit of a share of the force that follows with a delay.

    Values are those of blocks of the plateaus, shape (blocks,), less their means and their parts affine in pressure.
    """

    bins: Sequence[RecordedBins]
    plateaus: Sequence[PressurePlateau]
    interpolants: Sequence[PchipInterpolator]

    @classmethod
    def of(cls, bins: Sequence[RecordedBins]) -> DelayedForce:
        """Plateaus of recordings; an `IdentificationError` if there are too few."""
        plateaus = [plateau for number, recorded in enumerate(bins) for plateau in recorded.plateaus(number)]
        means = np.array([values.mean() for values in _bins_of(bins, plateaus, "force")])
        interpolants = _interpolants(bins, plateaus, means)
        plateaus = [plateau for plateau, known in zip(plateaus, interpolants, strict=True) if known]
        if len(plateaus) < _FEWEST_PLATEAUS:
            message = f"{len(plateaus)} plateaus of the pressure, at lengths with at least {_FEWEST_LEVELS} levels"
            remedy = "step the pressure up and down over several levels at a fixed length, and wait at each"
            raise IdentificationError(message, value=len(plateaus), lower=_FEWEST_PLATEAUS, remedy=remedy)
        smoothed = [recorded.smoothed([p for p in plateaus if p.recording == n]) for n, recorded in enumerate(bins)]
        return cls(smoothed, plateaus, [interpolant for interpolant in interpolants if interpolant])

    @cached_property
    def owner(self) -> Ints:
        """Plateau of each block."""
        return np.repeat(np.arange(len(self.plateaus)), [len(_block_edges(p)) - 1 for p in self.plateaus])

    @cached_property
    def root(self) -> Floats:
        """Square root of the number of samples of each block: the root of its weight."""
        samples = (self.bins[p.recording].samples[: p.last] for p in self.plateaus)
        edges = (_block_edges(plateau)[:-1] for plateau in self.plateaus)
        return np.sqrt(np.concatenate([np.add.reduceat(*pair) for pair in zip(samples, edges, strict=True)]))

    @cached_property
    def grid(self) -> Floats:
        """Ascending time constants [s] of the search."""
        longest = max(float(np.ptp(time)) for time in _bins_of(self.bins, self.plateaus, "time"))
        return np.geomspace(longest / _PARTS, 5 * longest, _GRID)

    @cached_property
    def values(self) -> Floats:
        """Force [N] by block, without what is free for each plateau, times the root."""
        forces = zip(_bins_of(self.bins, self.plateaus, "force"), self.static, strict=True)
        return self.root * self._blocks([force - static for force, static in forces])

    @cached_property
    def static(self) -> list[Floats]:
        """Force [N] without delay in the bins of each plateau."""
        pressures = zip(self.interpolants, _bins_of(self.bins, self.plateaus, "pressure"), strict=True)
        return [_clipped(interpolant, pressure) for interpolant, pressure in pressures]

    @cached_property
    def line(self) -> Floats:
        """Time [s] by block, without what is free for each plateau, times the root."""
        return self.root * self._blocks(_bins_of(self.bins, self.plateaus, "time"))

    def columns(self, time_constants: Floats) -> Floats:
        """Columns of time constants [s], shape (blocks, time constants), times the root."""
        return self.root[:, None] * self._blocks(self._delayed(time_constants))

    def corrected(self) -> DelayedForce:
        """The same with levels without the creep that is left in the means of the plateaus."""
        delayed = self._delayed(np.array([self.time_constant]))
        left = np.array([self.solution[0] * float(values.mean()) for values in delayed])
        means = np.array([values.mean() for values in _bins_of(self.bins, self.plateaus, "force")])
        interpolants = _interpolants(self.bins, self.plateaus, means - left)
        return dataclasses.replace(self, interpolants=[interpolant for interpolant in interpolants if interpolant])

    @property
    def freedom(self) -> int:
        """Number of blocks less that of free parameters."""
        return max(len(self.owner) - 2 * len(self.plateaus) - 3, 1)

    @cached_property
    def grid_costs(self) -> Floats:
        """Sum of squares [N^2] at each time constant of the search."""
        return self._costs(self.grid)

    @cached_property
    def time_constant(self) -> float:
        """Least-squares time constant [s], from a grid and two finer ones."""
        grid, costs = self.grid, self.grid_costs
        for _ in range(2):
            at = int(np.argmin(costs))
            grid = np.geomspace(grid[max(at - 1, 0)], grid[min(at + 1, len(grid) - 1)], _GRID)
            costs = self._costs(grid)
        return float(grid[np.argmin(costs)])

    @cached_property
    def solution(self) -> tuple[float, float, Floats]:
        """Amplitude, rate [N/s], and residuals by block times the root [N]."""
        columns = self._jacobian[:, 1:]
        rate, amplitude = np.linalg.lstsq(columns, self.values, rcond=None)[0]
        return float(amplitude), float(rate), self.values - columns @ (rate, amplitude)

    @cached_property
    def errors(self) -> tuple[Floats, Floats]:
        """Standard errors of logarithm of the time constant, rate and amplitude, robust to those of a plateau.

        With their degrees of freedom, at least 1.
        """
        model = robust_errors(self._jacobian, self.solution[2], self.owner)
        variance, freedom = model.variance(np.eye(3))
        return np.sqrt(variance), np.maximum(freedom, 1.0)

    @property
    def error(self) -> tuple[float, float]:
        """Standard error of the amplitude and its degrees of freedom."""
        return float(self.errors[0][-1]), float(self.errors[1][-1])

    @cached_property
    def scale(self) -> float:
        """Variance [N^2] of independent errors with which the amplitude has its variance."""
        residuals, (_, triangle) = self.solution[2], np.linalg.qr(self._jacobian)
        independent = 1 / float(triangle[-1, -1]) ** 2  # of the last parameter
        return max(self.error[0] ** 2 / independent, float(residuals @ residuals) / self.freedom)

    @cached_property
    def p_value(self) -> float:
        """Upper bound of the probability of the reduction of the squares by creep, over all time constants.

        The time constant does not exist without creep: R. B. Davies, "Hypothesis testing when a nuisance parameter is
        present only under the alternative", Biometrika 74 (1987) 33-43. Its bound holds for squares of normal
        variables: each F statistic is replaced by the one of equal probability.
        """
        from scipy.special import chdtri, fdtrc

        without, residuals = self._without_line(self.values), self.solution[2]
        reductions = without @ without - np.append(self.grid_costs, residuals @ residuals)
        chances = fdtrc(1, self.error[1], np.maximum(reductions, 0) / self.scale)
        equivalents = chdtri(1, np.maximum(chances, 1e-300))
        variation = float(np.abs(np.diff(np.sqrt(equivalents[:-1]))).sum())
        return min(float(chances[-1]) + variation * math.exp(-equivalents[-1] / 2) / math.sqrt(2 * math.pi), 1.0)

    @cached_property
    def time_constant_interval(self) -> tuple[float, float]:
        """95 % interval of the time constant [s]; 0 or infinite where it leaves the time constants of the search."""
        half = float(t_quantile(0.95, self.errors[1][0])) * float(self.errors[0][0])
        low, high = (math.exp(math.log(self.time_constant) + side * half) for side in (-1, 1))
        return (low if low > self.grid[0] else 0.0), (high if high < self.grid[-1] else math.inf)

    def _costs(self, time_constants: Floats) -> Floats:
        values, columns = self._without_line(self.values), self._without_line(self.columns(time_constants))
        return values @ values - (values @ columns) ** 2 / np.sum(columns**2, axis=0)

    def _without_line(self, values: Floats) -> Floats:
        """Values by block, shape (blocks, ...), orthogonal to the line."""
        line = self.line / np.linalg.norm(self.line)
        return values - np.multiply.outer(line, line @ values)

    @cached_property
    def _jacobian(self) -> Floats:
        """Columns of the logarithm of the time constant, the rate and the amplitude."""
        small = 1e-3
        centre, after, before = self.columns(self.time_constant * np.exp([0.0, small, -small])).T
        amplitude = np.linalg.lstsq(np.column_stack([centre, self.line]), self.values, rcond=None)[0][0]
        return np.column_stack([amplitude * (after - before) / (2 * small), self.line, centre])

    def _delayed(self, time_constants: Floats) -> list[Floats]:
        """Derivative of the force of each bin of each plateau with respect to the share [N], (bins, time constants)."""
        lags = [recorded.lags(time_constants) for recorded in self.bins]
        pressures = _bins_of(self.bins, self.plateaus, "pressure")
        return [
            _clipped(interpolant, pressure[:, None] - lags[p.recording][p.first : p.last]) - static[:, None]
            for p, pressure, interpolant, static in zip(
                self.plateaus, pressures, self.interpolants, self.static, strict=True
            )
        ]

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
