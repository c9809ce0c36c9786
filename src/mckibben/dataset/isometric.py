"""Phases of a recording at a fixed length, and force over pressure in each filling and venting."""

from __future__ import annotations

import warnings
from collections import Counter
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mckibben.component.calls import user_level
from mckibben.dataset.points import SampleAccount
from mckibben.dataset.segmentation import steady_segments
from mckibben.errors import McKibbenWarning, RangeError
from mckibben.units import bar

if TYPE_CHECKING:
    import xarray as xr

LEAST = 3  # samples of a point
FASTEST = 2.0  # s for the range of the pressure: a lag of 50 ms between sensor and muscle is 2.5 % of it
REVERSAL = 20  # parts of the range of the pressure
_NAMED = 8  # pressures listed in a message
_SMOOTHED = 2000  # maximum number of means used to find the reversals of the pressure
BAND = 40  # parts of the range of the levels


def held_contraction(
    table: xr.Dataset, contraction: float | None, tolerance: float, account: SampleAccount
) -> NDArray[np.float64]:
    """Contraction [-] of each sample: one for all, or one between two gaps, as of files of several lengths."""
    if "contraction" not in table:
        if contraction is None:
            remedy = (
                "give contraction (command line: --contraction '10 %'), at which the muscle was held; if file names "
                "give the lengths, read them with from_name (command line: --from-name 'L{length_mm}')"
            )
            raise RangeError("the contraction is unknown", remedy=remedy)
        return np.full(table.sizes["sample"], float(contraction))
    values = table["contraction"].to_numpy()
    middle = float(np.median(values))
    parts = np.split(values, np.flatnonzero(account.broken))
    medians = np.array([np.median(part) for part in parts])
    measured = any(np.ptp(part) for part in parts)  # not given
    if measured and (np.abs(medians - middle) <= tolerance).all():
        medians[:] = middle
    wrong = medians if contraction is None else medians[~(np.abs(medians - contraction) <= tolerance)]
    if contraction is not None and len(wrong):
        held = float(wrong[0])
        raise RangeError(
            f"the recording was made at contraction {held:.4g}, not {contraction:g}",
            value=contraction,
            lower=held - tolerance,
            upper=held + tolerance,
        )
    found = medians[np.cumsum(account.broken)]
    moved = np.abs(values - found) > tolerance
    if 2 * int(moved.sum()) > len(values):
        raise RangeError(
            f"the length was not fixed: contraction {values.min():.4g} to {values.max():.4g}",
            remedy="use plateaus, or cut the recording to a part of constant length",
        )
    account.assign_reason(moved, "at another length")
    return found if contraction is None else np.full(len(values), float(contraction))


def pressure_levels(pressure: NDArray[np.float64], levels: ArrayLike | None, count: int) -> NDArray[np.float64]:
    """The given levels, or `count` evenly spaced ones inside the range of the pressure [Pa]."""
    if levels is not None:
        wanted = np.unique(np.asarray(levels, np.float64).ravel())
        if not len(wanted) or not np.isfinite(wanted).all():
            raise RangeError("levels must be finite pressures", value=levels, unit="Pa")
        return wanted
    if count < 1:
        raise RangeError(f"{count} levels were requested", value=count, lower=1)
    if not len(pressure):
        return np.zeros(1)
    low, high = float(pressure.min()), float(pressure.max())
    # half a step inside: samples at the ends of the range lie on one side only
    return low + (high - low) * (np.arange(count) + 0.5) / count


class Phases(NamedTuple):
    """Phases of a recording: number by sample (-1 at reversal or rest); direction and repeat by phase."""

    of: NDArray[np.int64]
    rising: NDArray[np.bool_]
    repeat: NDArray[np.int64]

    def at_contraction(self, held: NDArray[np.float64]) -> tuple[Phases, NDArray[np.float64]]:
        """Phases with repeats counted at each contraction, given by sample; and the contraction by phase."""
        numbers, first = np.unique(self.of, return_index=True)
        by_phase = held[first[numbers >= 0]]
        seen: Counter[tuple[float, bool]] = Counter()
        repeat = []
        for key in zip(by_phase.tolist(), self.rising.tolist(), strict=True):
            repeat.append(seen[key])
            seen[key] += 1
        return self._replace(repeat=np.array(repeat, np.int64)), by_phase


def split_phases(pressure: NDArray[np.float64], broken: NDArray[np.bool_], reversal: float) -> Phases:
    """Split a recording at the reversals of its pressure, using means over 1/2000 of its length."""
    size = max(1, len(pressure) // _SMOOTHED)
    edges = np.arange(0, max(1, len(pressure) - size + 1), size)
    bounds = np.append(edges, len(pressure))
    means = np.add.reduceat(pressure, edges) / np.diff(bounds)
    gaps = np.logical_or.reduceat(broken, edges)
    of = np.full(len(means), -1, np.int64)
    rising: list[bool] = []

    def close(start: int, end: int, up: bool) -> None:
        away = np.abs(means[start : end + 1] - means[start]) >= reversal
        if away.any():  # before that, the muscle rests, or friction still has the sign of the last phase
            of[start + int(np.argmax(away)) : end + 1] = len(rising)
            rising.append(up)

    start, top, bottom, sign = 0, 0, 0, 0  # sign: +1 while rising, -1 while falling, 0 if uncertain
    for i in range(1, len(means)):
        if gaps[i]:
            close(start, top if sign > 0 else bottom, sign > 0)
            start = top = bottom = i
            sign = 0
            continue
        top = i if means[i] > means[top] else top
        bottom = i if means[i] < means[bottom] else bottom
        if sign >= 0 and means[top] - means[i] >= reversal:
            if sign > 0:
                close(start, top, True)
            start, sign, bottom = top, -1, i
        elif sign <= 0 and means[i] - means[bottom] >= reversal:
            if sign < 0:
                close(start, bottom, False)
            start, sign, top = bottom, 1, i
    close(start, top if sign > 0 else bottom, sign > 0)
    filling = np.array(rising, bool)
    up = np.cumsum(filling) - 1
    repeat = np.where(filling, up, np.arange(len(filling)) - up - 1)
    return Phases(np.repeat(of, np.diff(bounds)), filling, repeat)


_HOLDS = 2  # levels inside the range of a phase that make it a staircase
_HOLD = 50  # parts of a phase: the shortest hold
_HELD = 200  # parts of the range of a phase: the tolerance of a hold
_INSIDE = 0.05  # of the range of a phase, from its ends


class Holds(NamedTuple):
    """Levels at which a pressure was held inside of its range [Pa], samples of each hold, and of the whole."""

    levels: NDArray[np.float64]
    held: NDArray[np.int64]
    samples: int

    @property
    def named(self) -> str:
        """Levels as text."""
        named = ", ".join(f"{each / bar:.3g}" for each in self.levels[:_NAMED])
        return f"{len(self.levels)} levels ({named}{' ...' if len(self.levels) > _NAMED else ''} bar)"

    def remedy(self, interval: float) -> str:
        """Remedy, for samples at an interval [s]."""
        dwell = 0.5 * float(np.median(self.held)) * interval
        return f"plateaus(dwell={dwell:.2g}) (command line: leave out --isometric, --dwell '{dwell:.2g} s')"


def _holds(pressure: NDArray[np.float64]) -> Holds:
    """Holds of the pressure inside of its range."""
    low, high = float(pressure.min()), float(pressure.max())
    none = np.zeros(len(pressure), bool)
    found = steady_segments([(pressure, (high - low) / _HELD)], none, max(2, len(pressure) // _HOLD))
    means = np.array([pressure[a:b].mean() for a, b in zip(found.first, found.last, strict=True)])
    inside = (means > low + _INSIDE * (high - low)) & (means < high - _INSIDE * (high - low))
    return Holds(means[inside], (found.last - found.first)[inside], len(pressure))


def refuse_staircase(pressure: NDArray[np.float64], phases: Phases, interval: float) -> None:
    """Raise a `RangeError` if the pressure was held at intermediate levels in most phases of a recording.

    Warn if it was held at levels inside its range most of the time: phases end at an overshoot.
    """
    parts = [_holds(pressure[phases.of == number]) for number in range(len(phases.rising))]
    steps = [part for part in parts if len(part.levels) >= _HOLDS]
    whole = _holds(pressure)
    samples = sum(part.samples for part in steps)
    if 2 * samples > np.count_nonzero(phases.of >= 0):
        levels, held = (np.concatenate([part[i] for part in steps]) for i in (0, 1))
        found = Holds(levels, held, samples)
        raise RangeError(
            f"the pressure was held at {found.named}; the transients in between are not points",
            remedy=found.remedy(interval),
        )
    if len(whole.levels) >= _HOLDS and 2 * whole.held.sum() > whole.samples:
        warnings.warn(
            f"the pressure was held most of the time, at {whole.named}; the transients in between are not points: "
            f"{whole.remedy(interval)}",
            McKibbenWarning,
            stacklevel=user_level(),
        )


def named_cells(where: NDArray[np.bool_], levels: NDArray[np.float64], phases: Phases) -> str:
    """Levels and their phases, as text, where a mask of shape (phases, levels) is true."""
    parts = []
    for level in np.flatnonzero(where.any(axis=0))[:_NAMED]:
        numbers = np.flatnonzero(where[:, level])
        names = [f"{'filling' if phases.rising[n] else 'venting'} {phases.repeat[n]}" for n in numbers[:2]]
        more = f" and {len(numbers) - 2} more" if len(numbers) > 2 else ""
        parts.append(f"{levels[level] / bar:.4g} bar by {', '.join(names)}{more}")
    return "; ".join(parts) + ("; ..." if np.count_nonzero(where.any(axis=0)) > _NAMED else "")


class Lines(NamedTuple):
    """Least-squares lines of force over pressure at offset 0, shape (groups,); NaN where a group is empty."""

    samples: NDArray[np.int64]
    force: NDArray[np.float64]
    spread: NDArray[np.float64]
    time: NDArray[np.float64]
    below: NDArray[np.float64]
    above: NDArray[np.float64]

    def rate(self, interval: float) -> NDArray[np.float64]:
        """Mean rate of the pressure in each group [Pa/s]."""
        with np.errstate(invalid="ignore", divide="ignore"):
            return (self.above - self.below) / (self.samples * interval)


def lines_through(
    group: NDArray[np.int64],
    offset: NDArray[np.float64],
    force: NDArray[np.float64],
    time: NDArray[np.float64],
    groups: int,
) -> Lines:
    """Lines through samples by group, and the lowest and highest offset [Pa] of each."""
    samples = np.bincount(group, minlength=groups)

    def mean(values: NDArray[np.float64]) -> NDArray[np.float64]:
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.bincount(group, values, minlength=groups) / samples

    x, y = mean(offset), mean(force)
    dx, dy = offset - x[group], force - y[group]
    xx, xy = mean(dx * dx), mean(dx * dy)
    slope = np.divide(xy, xx, out=np.zeros(groups), where=xx > 0)
    below, above = np.full(groups, np.inf), np.full(groups, -np.inf)
    np.minimum.at(below, group, offset)
    np.maximum.at(above, group, offset)
    return Lines(samples, y - slope * x, np.sqrt(mean((dy - slope[group] * dx) ** 2)), mean(time), below, above)
