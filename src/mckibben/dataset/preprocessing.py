"""Preprocessing of measured points: pressure levels, passes of loading and unloading, force of the slack muscle.

Only quantities that a dataset does not record are estimated. The methods suit any data: gaps between sorted pressures,
reversals of the contraction in row order, and the mode of the lowest forces with the spread below it, out of reach of a
taut muscle's forces.
"""

from __future__ import annotations

import itertools
import warnings
from collections.abc import Iterator
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mckibben.component.calls import user_level
from mckibben.dataset.schema import format_range
from mckibben.errors import McKibbenWarning
from mckibben.units import bar, percent

if TYPE_CHECKING:
    import xarray as xr

Floats = NDArray[np.float64]
Ints = NDArray[np.int_]
Bools = NDArray[np.bool_]

_FEWEST = 3  # points at a level, and readings at a floor
_STRAY = 0.02  # of the points, or one: pressures far from all levels, which are errors
_MOST_LEVELS, _MOST_RUNS = 10_000, 100_000  # beyond which levels and passes are not looked for, as they take long
_SEPARATION = 2.5  # smallest ratio of gaps between levels to gaps within
_ONE_LEVEL = 0.01  # of the highest pressure: a narrower range is scatter about one level
_STEPS = (1.0, 0.5, 0.25, 0.2, 0.1, 0.05, 0.02, 0.01, 0.005, 0.001)  # bar, of nominal pressures
_REVERSAL = 0.1  # of the range of contractions: a smaller reversal is noise
_LOWEST_FORCES = 0.15  # of the range of forces, searched for the slack muscle
_FEWEST_SLACK = 5
_OUTSIDE = 4.0  # standard deviations of the noise
_FAR = 8.0  # standard deviations: a point farther above slack ones is not noise
_TAIL = 0.8  # share of slack points without a taut point at a larger contraction; the rest may be friction
_UPPERMOST = 0.95  # share of the slack muscle's readings, above which there may be friction
_DEPENDENT = 0.5  # of the variance: force explained by contraction and pressure
_SURELY = 0.9  # the same, of few points, whose noise may explain much of it by chance
_PULLING = 0.05  # significance of the share of steps between slack points that go the way of a taut muscle's force
_SAME_LENGTH = 0.1 * percent
_NO_PRESSURE = 0.05 * bar
_NO_SLACK = "no slack muscle is recognised: the zero of the load cell is not estimated"
_QUIET = 0.01  # of the range of forces: largest noise of slack points that are recognised by a gap above them
_MANY = 20  # points for quadratic terms
_NORMAL = ((0.6827, 1.0), (0.9545, 2.0))  # share of a normal distribution within so many standard deviations


def preprocess(table: xr.Dataset, *, slack_known: bool, files: Ints | None = None) -> xr.Dataset:
    """Table with unknown levels, directions, repeats and slack force estimated; `preprocessing` lists the estimates.

    `files` numbers the file of each point; no stroke extends across two.
    """
    table, notes = _with_set_pressures(table)
    table, found = _with_passes(table, files)
    notes += found
    if not slack_known:
        table, found = without_offset(table)
        notes += found
    return with_notes(table, notes)


def _with_set_pressures(table: xr.Dataset) -> tuple[xr.Dataset, list[str]]:
    """Table with the nominal pressures of its levels, and a note; unchanged if it has some or shows no levels."""
    pressure = table["pressure"].to_numpy()
    if "set_pressure" in table or (labels := group_pressures(pressure, _most_strays(pressure))) is None:
        return table, []
    nominal, scatter = nominal_pressures(pressure, labels)
    shown = format_range(nominal / bar)
    plural = "s" if len(nominal) > 1 else ""
    note = f"{len(nominal)} pressure level{plural} ({shown} bar), about which pressures scatter by {scatter:.2g} bar"
    return table.assign(set_pressure=("point", np.where(labels < 0, np.nan, nominal[labels]))), [note]


def _with_passes(table: xr.Dataset, files: Ints | None) -> tuple[xr.Dataset, list[str]]:
    """Table with directions and repeats, and a note; unchanged if it has directions or shows no reversals."""
    if "direction" in table:
        return table, []
    values, groups = np.unique(_levels(table), return_inverse=True)
    grouped = 2 * len(values) <= len(groups) and len(values) <= _MOST_LEVELS
    if (found := passes(groups if grouped else 0 * groups, table["contraction"].to_numpy(), files)) is None:
        return table, []
    direction, repeat = found
    table = table.assign(direction=("point", direction))
    each = ""
    if grouped and repeat.any() and "repeat" not in table:
        table = table.assign(repeat=("point", repeat))
        each = f"{repeat.max() + 1} of each per level, "
    return table, [f"passes of loading and unloading, {each}from the order of the rows"]


def _levels(table: xr.Dataset) -> Floats:
    """Set pressure of each point, or the measured one where it is unknown."""
    measured = table["pressure"].to_numpy()
    nominal = table.get("set_pressure", table["pressure"]).to_numpy()
    return np.where(np.isnan(nominal), measured, nominal)


def without_offset(table: xr.Dataset) -> tuple[xr.Dataset, list[str]]:
    """Table with the slack muscle's force subtracted, and a note; unchanged, with a note, if it is not detected."""
    if (slack := _slack_of(table)) is None:
        return table, [_NO_SLACK] if table["force"].min() > 0 else []
    if not slack.sure:
        _warn_of_offset(slack)
        return table, []
    note = f"{slack}; this offset is subtracted, and forces up to {slack.limit:.3g} N count as slack"
    return table.assign(force=table["force"] - slack.offset).assign_attrs(slack_force=slack.limit), [note]


def with_slack_force(table: xr.Dataset) -> xr.Dataset:
    """Table with the slack force from noise about 0 N, and a note; 0 N if there is none."""
    if (slack := _slack_of(table)) is None:
        return table
    if slack.offset > _OUTSIDE * slack.noise or not slack.sure:
        _warn_of_offset(slack)
        return table
    limit = max(slack.offset + slack.limit, 0.0)
    return with_notes(table.assign_attrs(slack_force=limit), [f"{slack}; forces up to {limit:.3g} N count as slack"])


def _warn_of_offset(slack: Slack) -> None:
    text = (
        f"the lowest forces, {slack.offset:.3g} +- {slack.noise:.2g} N at {slack.points} points, count as taut; if the "
        "muscle is slack there, subtract the zero error of the load cell, otherwise give slack_force=0.0 (command "
        "line: --slack-force '0 N')"
    )
    warnings.warn(text, McKibbenWarning, stacklevel=user_level())


def _slack_of(table: xr.Dataset) -> Slack | None:
    contraction, force = (table[name].to_numpy() for name in ("contraction", "force"))
    levels = _levels(table)
    groups = np.unique(levels, return_inverse=True)[1]
    loading = table["direction"].to_numpy() == "loading" if "direction" in table else 0
    return slack_force(force, contraction, levels, 2 * groups + loading)


def with_notes(table: xr.Dataset, notes: list[str]) -> xr.Dataset:
    """Table with more notes in `preprocessing`."""
    before = table.attrs.get("preprocessing", "").splitlines()
    return table.assign_attrs(preprocessing="\n".join([*before, *notes])) if notes else table


def _most_strays(pressure: Floats) -> int:
    return max(1, int(_STRAY * len(pressure)))


def group_pressures(pressure: Floats, most_strays: int = 0) -> Ints | None:
    """Level of each measured pressure, ascending from 0; None if pressures repeat exactly or form no groups.

    Uses the finest grouping in which gaps between levels exceed both the width of levels and the gaps within them.
    At most `most_strays` points may be far from all levels, such as typing errors; theirs is -1.
    """
    if 0 < np.ptp(pressure) < _ONE_LEVEL * pressure.max() and len(pressure) >= _FEWEST:
        return np.zeros(len(pressure), int)
    order = np.argsort(pressure)
    gaps = np.diff(pressure[order])
    ranked = np.sort(gaps)[::-1]
    most = len(pressure) // _FEWEST  # levels
    wider = np.flatnonzero(ranked[: most - 1] > _SEPARATION * ranked[1:most]) if most > 1 else []
    for last in wider[::-1]:
        starts = np.append(0, np.flatnonzero(gaps >= ranked[last]) + 1)
        counts = np.diff(starts, append=len(order))
        width = np.max(pressure[order[starts + counts - 1]] - pressure[order[starts]])
        full = counts >= _FEWEST
        if counts[~full].sum() > most_strays or ranked[last] < width:
            continue
        labels = np.empty(len(pressure), int)
        labels[order] = np.repeat(np.where(full, np.cumsum(full) - 1, -1), counts)
        return labels if width else None
    return None


def nominal_pressures(pressure: Floats, labels: Ints) -> tuple[Floats, float]:
    """Pressure of each level [Pa], rounded within its scatter, and the scatter [bar]."""
    parts = [pressure[labels == label] / bar for label in range(labels.max() + 1)]
    means, spreads = np.array([part.mean() for part in parts]), np.array([part.std(ddof=1) for part in parts])
    scatter = float(np.sqrt(np.mean(spreads**2)))
    for step in _STEPS:
        nominal = np.round(means / step) * step + 0.0  # not -0
        if (np.abs(nominal - means) <= np.maximum(spreads, scatter)).all() and (np.diff(nominal) > 0).all():
            return np.round(nominal, 3) * bar, scatter
    return means * bar, scatter


_LEAST_PART = 256  # rows looked at together, and then twice as many each time


def passes(groups: Ints, contraction: Floats, files: Ints | None = None) -> tuple[NDArray[np.str_], Ints] | None:
    """Direction and repeat of each point from reversals of the contraction per group; None without reversals."""
    direction, repeat = np.zeros(len(groups), "<U9"), np.zeros(len(groups), int)
    reversing = count = 0
    order = np.argsort(groups, kind="stable")
    levels = np.split(order, np.flatnonzero(np.diff(groups[order])) + 1) if len(order) else []
    most = min(len(groups) // _FEWEST, _MOST_RUNS)
    for rows in levels:
        ends = np.flatnonzero(np.diff(files[rows])) + 1 if files is not None else []
        found = ((one[part], word) for one in np.split(rows, ends) for part, word in one_way_parts(contraction[one]))
        runs = list(itertools.islice(found, most + 1))  # more are too many
        reversing += len(runs) > 1
        count += len(runs)
        if count > most:
            return None
        strokes = {"loading": 0, "unloading": 0}
        for part, word in runs:
            direction[part], repeat[part] = word, strokes[word]
            strokes[word] += 1
    return (direction, repeat) if 2 * reversing > len(levels) else None


def one_way_parts(values: Floats) -> Iterator[tuple[slice, Literal["loading", "unloading"]]]:
    """Parts in which the contraction rises (unloading) or falls (loading), ignoring noise."""
    threshold = _REVERSAL * np.ptp(values)
    if not threshold:
        return
    start, extreme = 0, _first_beyond(np.abs(values - values[0]), threshold)
    rising = bool(values[extreme] > values[0])
    upwards, downwards = np.asarray(values), -np.asarray(values)
    while (turn := _turn(upwards if rising else downwards, extreme, threshold)) is not None:
        extreme, beyond = turn
        yield slice(start, extreme + 1), "unloading" if rising else "loading"
        start, extreme, rising = extreme + 1, beyond, not rising
    yield slice(start, len(values)), "unloading" if rising else "loading"


def _first_beyond(distances: Floats, threshold: float) -> int:
    """First place with a distance above the threshold, which is below half of the largest."""
    return int(np.argmax(distances > threshold))


def _turn(values: Floats, begin: int, threshold: float) -> tuple[int, int] | None:
    """First place of a maximum from `begin` on, and the first place that is below it by more than a threshold."""
    extreme, size = begin, _LEAST_PART
    while begin < len(values):
        part = values[begin : begin + size]
        highest = np.maximum.accumulate(np.maximum(part, values[extreme]))
        below = np.flatnonzero(highest - part > threshold)
        seen = part[: below[0] + 1] if below.size else part
        if seen.max() > values[extreme]:
            extreme = begin + int(np.argmax(seen))
        if below.size:
            return extreme, begin + int(below[0])
        begin, size = begin + size, 2 * size
    return None


class Slack(NamedTuple):
    """Force of the slack muscle: zero offset and standard deviation of the noise [N], and number of points."""

    offset: float
    noise: float
    points: int
    limit: float
    """Largest force that counts as slack, above the offset [N]."""
    sure: bool
    """Whether a taut muscle would exert less force there, or none."""

    def __str__(self) -> str:
        return f"slack muscle: {self.points} points with a force of {self.offset:.3g} +- {self.noise:.2g} N"


def slack_force(force: Floats, contraction: Floats, pressure: Floats, passes: Ints) -> Slack | None:
    """Force of the slack muscle, which does not depend on the contraction; None if not detectable.

    The mode of the lowest forces is the offset; the forces below it, none of them taut, give the noise. Where few
    points have no clear mode, they are those below a wide gap.
    """
    lowest = np.sort(force[force <= force.min() + _LOWEST_FORCES * np.ptp(force)])
    if len(lowest) < _FEWEST_SLACK or not np.ptp(force):
        return None
    *below_gap, number = _below_gap(force) or (0,)
    for estimate in (_clipped(force, contraction, passes) or _mode(lowest), below_gap):
        if not estimate:
            continue
        offset, noise = estimate
        slack = np.abs(force - offset) <= _OUTSIDE * noise
        points = np.count_nonzero(slack)
        by_gap = estimate is below_gap or points == number
        if points < _FEWEST_SLACK:
            continue
        if offset == noise == 0:  # of a model, or as a program has set them
            return None
        behind = contraction[slack] >= _largest_taut(force > offset + _OUTSIDE * noise, contraction, pressure)[slack]
        scatter = _OUTSIDE * noise > _LOWEST_FORCES * np.ptp(force)  # of taut points, not noise
        if scatter or behind.mean() < _TAIL:
            continue
        if _explained(force[slack], contraction[slack], pressure[slack]) > (_SURELY if by_gap else _DEPENDENT):
            continue
        above_taut = _above_taut(force, contraction, pressure, slack, _OUTSIDE * noise)
        if _are_taut(force, contraction, pressure, passes, slack, above_taut=above_taut, by_gap=by_gap):
            continue
        above = (force - offset)[_beyond(slack, contraction, passes)]
        limit = max(_OUTSIDE * noise, float(above[above <= _FAR * noise].max(initial=0.0)))
        no_pull = abs(offset) <= _OUTSIDE * noise / points**0.5 or pressure[slack].max() <= _NO_PRESSURE
        return Slack(offset, noise, int(points), limit, sure=bool(no_pull or above_taut is not False))
    return None


def _are_taut(
    force: Floats,
    contraction: Floats,
    pressure: Floats,
    passes: Ints,
    slack: Bools,
    *,
    above_taut: bool | None,
    by_gap: bool,
) -> bool:
    """Whether the lowest forces, `slack`, are those of a taut muscle."""
    if np.ptp(contraction[slack]) <= _SAME_LENGTH:
        return not above_taut
    if by_gap:  # strokes that end at one force are there at one length each
        groups = (contraction[slack & (passes == stroke)] for stroke in np.unique(passes[slack]))
        return all(np.ptp(group) <= _SAME_LENGTH for group in groups)
    return _pulls(force[slack], contraction[slack], pressure[slack], passes[slack])


def _mode(lowest: Floats) -> tuple[float, float]:
    """Mode of ascending forces, and the noise from those below it."""
    offset, noise = half_sample_mode(lowest), 0.0
    for _ in range(20):
        below = np.sort(offset - lowest[lowest <= offset])
        before, noise = noise, max(float(np.quantile(below, share)) / size for share, size in _NORMAL)
        near = lowest[np.abs(lowest - offset) <= _OUTSIDE * noise]
        offset = float(np.median(near))
        if noise == before:
            break
    return offset, noise


def _below_gap(force: Floats) -> tuple[float, float, int] | None:
    """Mean, standard deviation and number of the lowest forces, below the first wide gap; None without one."""
    ranked = np.sort(force)
    above = ranked - ranked[0]
    counts = np.arange(1, len(ranked))
    totals, squares = (np.cumsum(above[:-1] ** power) for power in (1, 2))
    noise = np.sqrt(np.maximum(squares - totals**2 / counts, 0.0) / np.maximum(counts - 1, 1))
    wide = (np.diff(ranked) > _FAR * noise) & (noise > 0) & (noise <= _QUIET * above[-1]) & (counts >= _FEWEST_SLACK)
    if not wide.any():
        return None
    first = int(np.argmax(wide))
    return float(ranked[0] + totals[first] / counts[first]), float(noise[first]), int(counts[first])


def _clipped(force: Floats, contraction: Floats, passes: Ints) -> tuple[float, float] | None:
    """Offset and noise of slack-muscle readings clipped at a floor, from a censored normal distribution.

    With few readings the floor is the offset, and those above it beyond one at the floor are noise.
    """
    from scipy.special import ndtri

    floor = force.min()
    if np.count_nonzero(force == floor) < _FEWEST:
        return None
    for first in (2, 1):  # the second reading at the floor, as one may be a lost reading, or with few points the first
        beyond = _beyond(force == floor, contraction, passes, first)
        if min(np.count_nonzero(force == floor), np.count_nonzero(force[beyond] == floor)) < _FEWEST_SLACK:
            continue
        ranked = np.sort(force[beyond])
        share = (np.arange(len(ranked)) + 0.5) / len(ranked)
        used = (ranked > floor) & (share < _UPPERMOST)
        if np.count_nonzero(used) >= _FEWEST_SLACK:
            noise, offset = np.polyfit(ndtri(share[used]), ranked[used], 1)
            return float(offset), float(noise)
    above = force[_beyond(force == floor, contraction, passes, 1)] - floor
    noisy = above[above > 0]
    clipped = len(above) - len(noisy) >= len(above) / 3  # about half, and not the least of all readings
    return (float(floor), float(np.sqrt(np.mean(noisy**2)))) if clipped and len(noisy) > 1 else None


def _beyond(marked: Bools, contraction: Floats, passes: Ints, first: int = 2) -> Bools:
    """Points from the second marked one (or another one) of each pass on, in order of contraction."""
    order = np.lexsort((contraction, passes))
    found, starts = np.cumsum(marked[order]), np.flatnonzero(np.diff(passes[order], prepend=-1))
    sizes = np.diff(np.append(starts, len(order)))
    counts = np.add.reduceat(marked[order].astype(int), starts)
    before = np.repeat(np.cumsum(counts) - counts, sizes)
    needed = np.repeat(np.clip(counts, 1, first), sizes)
    beyond = np.empty(len(order), bool)
    beyond[order] = found - before >= needed
    return beyond


def _largest_taut(taut: Bools, contraction: Floats, pressure: Floats) -> Floats:
    """Largest contraction of a taut point at or below the pressure of each point."""
    levels, level = np.unique(pressure, return_inverse=True)
    largest = np.full(len(levels), -np.inf)
    np.maximum.at(largest, level[taut], contraction[taut])
    return np.maximum.accumulate(largest)[level]


def _above_taut(force: Floats, contraction: Floats, pressure: Floats, slack: Bools, margin: float) -> bool | None:
    """Whether the lowest forces are above those of a taut muscle there, from higher pressures; None if unknown.

    The force of a taut muscle is about linear in the pressure and quadratic in the contraction.
    """
    low, high = contraction[slack].min() - _SAME_LENGTH, contraction[slack].max() + _SAME_LENGTH
    taut = ~slack & (pressure > pressure[slack].max()) & (low <= contraction) & (contraction <= high)
    lengths = len(np.unique(np.round(contraction[taut] / _SAME_LENGTH)))
    polynomial = np.vander((contraction - low) / (high - low), min(max(lengths, 1), 3))
    columns = np.hstack([polynomial, polynomial * (pressure / bar)[:, None]])
    found, _, rank, _ = np.linalg.lstsq(columns[taut], force[taut])
    if rank < len(found):
        return None
    return bool(np.mean((force - columns @ found)[slack]) > margin)


def _pulls(force: Floats, contraction: Floats, pressure: Floats, passes: Ints) -> bool:
    """Whether forces fall with the contraction or rise with the pressure; also if too few steps tell."""
    from scipy.special import bdtrc

    count, taut = 0, 0
    lengths = np.round(contraction / _SAME_LENGTH)
    for group, along, sign in ((passes, contraction, -1), (lengths, pressure, 1)):
        order = np.lexsort((along, group))
        steps = (np.diff(group[order]) == 0) & (np.diff(along[order]) > 0)
        count += np.count_nonzero(steps)
        taut += np.count_nonzero(sign * np.diff(force[order])[steps] > 0)
    return bool(count < _FEWEST_SLACK or bdtrc(taut - 1, count, 0.5) < _PULLING)


def _explained(force: Floats, contraction: Floats, pressure: Floats) -> float:
    """Adjusted coefficient of determination of the force by contraction and pressure."""
    x, y = ((each - each.mean()) / (np.ptp(each) or 1.0) for each in (contraction, pressure))
    terms = [x, y, x * y, x * x, y * y][: 5 if len(x) >= _MANY else 2]
    columns = np.column_stack([np.ones(len(x)), *terms])
    rest = force - columns @ np.linalg.lstsq(columns, force)[0]
    rank = np.linalg.matrix_rank(columns)
    return 1 - float(rest.var() / (force.var() or 1.0)) * (len(x) - 1) / max(len(x) - rank, 1)


def half_sample_mode(values: Floats) -> float:
    """Mode of sorted values by repeated halving (Robertson and Cryer, J. American Statistical Ass. 69 (1974) 1012)."""
    while len(values) > 3:
        half = (len(values) + 1) // 2
        start = int(np.argmin(values[half - 1 :] - values[: len(values) - half + 1]))
        values = values[start : start + half]
    return float(values.mean() if len(values) < 3 else np.median(values))
