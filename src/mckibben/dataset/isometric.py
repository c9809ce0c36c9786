"""Points of a recording at a fixed length: force at given pressures, separately for filling and venting."""

from __future__ import annotations

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray

from mckibben.dataset.points import ExtractedPoints, SampleAccount, check_positive, extracted_points, format_counts
from mckibben.errors import RangeError
from mckibben.units import bar, kPa

_LEAST = 3  # samples of a point
_SMOOTHED = 2000  # means by which the turns of the pressure are found: at most so many
_BAND = 40  # parts of the range of the levels


def isometric(
    table: xr.Dataset,
    *,
    levels: ArrayLike | None,
    count: int,
    contraction: float | None,
    contraction_tolerance: float,
    band: float | None,
    reversal: float,
    gap: float | None,
) -> ExtractedPoints:
    """`Recording.isometric` for the recording's table."""
    check_positive("reversal", reversal, "Pa")
    check_positive("contraction_tolerance", contraction_tolerance, "1")
    time, pressure, force = (table[name].to_numpy() for name in ("time", "pressure", "force"))
    if not len(time):
        raise RangeError("the recording has no samples")
    account = SampleAccount(table, gap)
    held = _held(table, contraction, contraction_tolerance, account)
    usable = account.of < 0
    wanted = _levels(pressure[usable], levels, count)
    spacing = np.diff(wanted).min() if len(wanted) > 1 else np.inf
    if band is None:
        band = float(min(spacing / 2, np.ptp(wanted) / _BAND)) if len(wanted) > 1 else 10 * kPa
    check_positive("band", band, "Pa")
    if 2 * band > spacing * (1 + 1e-9):
        raise RangeError(
            f"bands of {band:g} Pa around levels {spacing:g} Pa apart overlap", value=band, upper=spacing / 2, unit="Pa"
        )
    phases = _phases(pressure, account.broken, reversal)
    account.assign_reason(phases.of < 0, "at rest or turning")
    usable = account.of < 0

    nearest = np.clip(np.searchsorted(wanted, pressure), 1, len(wanted) - 1) if len(wanted) > 1 else 0
    if len(wanted) > 1:
        nearest = np.where(pressure - wanted[nearest - 1] < wanted[nearest] - pressure, nearest - 1, nearest)
    offset = pressure - wanted[nearest]
    near = usable & (np.abs(offset) <= band)
    account.assign_reason(usable & ~near, "between levels")
    cell = (phases.of * len(wanted) + nearest)[near]
    sums = _Lines.through(cell, offset[near], force[near], time[near], len(phases.rising) * len(wanted))
    account.assign_reason(near, "used")

    good = (sums.samples >= _LEAST) & (sums.below < 0) & (sums.above > 0)
    index = np.flatnonzero(good)
    few = np.flatnonzero(~good)
    account.of[np.flatnonzero(near)[~good[cell]]] = -1
    account.assign_reason(near, "too few at a level")
    for number, rising in enumerate(phases.rising):
        missed = [wanted[i % len(wanted)] for i in few if i // len(wanted) == number]
        if missed:
            what = f"{'filling' if rising else 'venting'} {phases.repeat[number]}"
            shown = ", ".join(f"{level / bar:g}" for level in missed[:8]) + (" ..." if len(missed) > 8 else "")
            account.notes.append(f"{what} does not pass {shown} bar")
    if not len(index):
        counts = account.counts("between levels")
        raise RangeError(
            "no level is passed\n  " + format_counts(counts, account.notes).replace("\n", "\n  "),
            remedy="give levels inside the range of the pressure, a wider band, or a smaller reversal",
        )
    phase_of, level_of = index // len(wanted), wanted[index % len(wanted)]
    return extracted_points(
        table,
        account,
        "between levels",
        sums.samples[index],
        pressure=level_of,
        contraction=np.full(len(index), held),
        force=sums.force[index],
        phase=np.where(phases.rising, "filling", "venting")[phase_of],
        repeat=phases.repeat[phase_of],
        time=sums.time[index],
        set_pressure=level_of,
        force_spread=sums.spread[index],
    )


def _held(table: xr.Dataset, contraction: float | None, tolerance: float, account: SampleAccount) -> float:
    """Contraction of the test [-]."""
    if "contraction" not in table:
        if contraction is None:
            raise RangeError(
                "the contraction is not known", remedy="give contraction=..., at which the muscle was held"
            )
        return float(contraction)
    values = table["contraction"].to_numpy()
    held = float(np.median(values))
    if contraction is not None and not abs(contraction - held) <= tolerance:
        raise RangeError(
            f"the recording was made at contraction {held:.4g}, not {contraction:g}",
            value=contraction,
            lower=held - tolerance,
            upper=held + tolerance,
        )
    moved = np.abs(values - held) > tolerance
    if 2 * int(moved.sum()) > len(values):
        raise RangeError(
            f"the length was not fixed: contraction {values.min():.4g} to {values.max():.4g}",
            remedy="use plateaus, or cut the recording to a part of one length",
        )
    account.assign_reason(moved, "at another length")
    return held if contraction is None else float(contraction)


def _levels(pressure: NDArray[np.float64], levels: ArrayLike | None, count: int) -> NDArray[np.float64]:
    if levels is not None:
        wanted = np.unique(np.asarray(levels, np.float64).ravel())
        if not len(wanted) or not np.isfinite(wanted).all():
            raise RangeError("levels are no finite pressures", value=levels, unit="Pa")
        return wanted
    if count < 1:
        raise RangeError(f"{count} levels are none", value=count, lower=1)
    if not len(pressure):
        return np.zeros(1)
    low, high = float(pressure.min()), float(pressure.max())
    # half a step inside: at the ends of the range there are samples on one side only
    return low + (high - low) * (np.arange(count) + 0.5) / count


class _Phases:
    """Phases of a recording: number by sample (-1 at reversal or rest); direction and repeat by phase."""

    def __init__(self, of: NDArray[np.int64], rising: NDArray[np.bool_]) -> None:
        self.of = of
        self.rising = rising
        up = np.cumsum(rising) - 1
        self.repeat = np.where(rising, up, np.arange(len(rising)) - up - 1)


def _phases(pressure: NDArray[np.float64], broken: NDArray[np.bool_], reversal: float) -> _Phases:
    """Split a recording at the reversals of its pressure, by means over a two-thousandth of it."""
    size = max(1, len(pressure) // _SMOOTHED)
    edges = np.arange(0, max(1, len(pressure) - size + 1), size)
    bounds = np.append(edges, len(pressure))
    means = np.add.reduceat(pressure, edges) / np.diff(bounds)
    gaps = np.logical_or.reduceat(broken, edges)
    of = np.full(len(means), -1, np.int64)
    rising: list[bool] = []

    def close(start: int, end: int, up: bool) -> None:
        away = np.abs(means[start : end + 1] - means[start]) >= reversal
        if away.any():  # before, the muscle rests, or friction is that of the last phase
            of[start + int(np.argmax(away)) : end + 1] = len(rising)
            rising.append(up)

    start, top, bottom, sign = 0, 0, 0, 0  # sign: +1 while rising, -1 while falling, 0 while neither is sure
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
    return _Phases(np.repeat(of, np.diff(bounds)), np.array(rising, bool))


class _Lines:
    """Least-squares lines of force over pressure, one for each group of samples, at offset 0."""

    def __init__(self, samples: NDArray[np.int64], force: NDArray[np.float64]) -> None:
        self.samples = samples
        self.force = force
        self.spread = self.time = self.below = self.above = np.zeros(len(samples))

    @classmethod
    def through(
        cls,
        group: NDArray[np.int64],
        offset: NDArray[np.float64],
        force: NDArray[np.float64],
        time: NDArray[np.float64],
        groups: int,
    ) -> _Lines:
        """Fit the lines; shape (groups,) each, NaN where a group is empty."""
        samples = np.bincount(group, minlength=groups)

        def mean(values: NDArray[np.float64]) -> NDArray[np.float64]:
            with np.errstate(invalid="ignore", divide="ignore"):
                return np.bincount(group, values, minlength=groups) / samples

        x, y = mean(offset), mean(force)
        dx, dy = offset - x[group], force - y[group]
        xx, xy = mean(dx * dx), mean(dx * dy)
        slope = np.divide(xy, xx, out=np.zeros(groups), where=xx > 0)
        lines = cls(samples, y - slope * x)
        lines.spread = np.sqrt(mean((dy - slope[group] * dx) ** 2))
        lines.time = mean(time)
        lines.below, lines.above = np.full(groups, np.inf), np.full(groups, -np.inf)
        np.minimum.at(lines.below, group, offset)
        np.maximum.at(lines.above, group, offset)
        return lines
