"""Preprocessing of measured points: pressure levels, passes of loading and unloading, force of the slack muscle.

Only quantities that a dataset does not record are estimated: levels from gaps between sorted pressures, passes from
reversals of the contraction in row order, and the force of the slack muscle from the lowest forces.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from mckibben.component.calls import user_level
from mckibben.dataset.schema import format_range
from mckibben.dataset.segmentation import steady_segments, usual_interval
from mckibben.errors import McKibbenWarning
from mckibben.units import bar, kPa

if TYPE_CHECKING:
    import xarray as xr

Floats = NDArray[np.float64]
Ints = NDArray[np.int_]

_DWELLS = 1, 5, 25  # s: at a pressure, as it may rise slowly between two
_LEVEL = 10 * kPa  # pressures closer than this are of one level
_MOST = 100  # points of a stroke
_STROKES, _TOTAL = 1_000, 20_000  # strokes that are read, and about as many points in all
_FEWEST = 3  # points of a level, and of a pass on average
POINTS = "mckibben points"
"""Command for samples most of which rest."""
_NOISE = 4.0  # standard deviations of the noise that count as slack


def preprocess(table: xr.Dataset, *, slack_known: bool, files: Ints) -> tuple[xr.Dataset, Ints]:
    """Table with unknown levels, directions, repeats and slack force estimated; `preprocessing` lists the estimates.

    Samples over time are left out where the pressure changes between levels, and averaged along long strokes.

    Parameters
    ----------
    slack_known
        Whether the table's slack force holds; otherwise it and the offset of the load cell are estimated.
    files
        Shape (points,): number of the file of each point; no stroke extends across two.

    Returns
    -------
    Table, and the (first) row of each of its points in the table given, shape (points,).
    """
    table, rows, notes = _at_held_pressures(table)
    table, more = _with_set_pressures(table)
    notes += more
    table, more = with_passes(table, files[rows])
    notes += more + _rests(table)
    table, strokes, more = _thinned(table)
    notes, rows = notes + more, rows[strokes]
    if not slack_known:
        table, more = without_offset(table)
        notes += more
    samples = table.sizes["point"]
    table, first = _averaged(table, files[rows])
    if len(first) < samples:
        slack = np.count_nonzero(table["force"] <= table.attrs["slack_force"])
        notes.append(f"{samples} samples are averaged to {len(first)} points, of which {slack} are slack")
    return with_notes(table, notes), rows[first]


def pressure_levels(pressure: Floats, tolerance: float = _LEVEL) -> Floats:
    """Level of each measured pressure [Pa]: mean [whole kPa] of the pressures that follow each other closely.

    Parameters
    ----------
    pressure
        Shape (points,) [Pa].
    tolerance
        Sorted pressures that are farther apart than this are of two levels [Pa]; a level that spans more than three
        times as much is a sweep, whose points have no level: NaN.

    Examples
    --------
    >>> pressure_levels(np.array([1.01e5, 2e5, 0.996e5])).tolist()
    [100000.0, 200000.0, 100000.0]
    """
    return np.round(level_means(pressure, tolerance) / kPa) * kPa


def level_means(values: Floats, tolerance: float) -> Floats:
    """As `pressure_levels`, of any quantity: means of the values that follow each other closely, NaN in a sweep."""
    order = np.argsort(values)
    ranked = values[order]
    first = np.flatnonzero(np.diff(ranked, prepend=-np.inf) > tolerance)
    sizes = np.diff(first, append=len(ranked))
    narrow = ranked[first + sizes - 1] - ranked[first] <= 3 * tolerance
    means = np.empty(len(ranked))
    means[order] = np.repeat(np.where(narrow, np.add.reduceat(ranked, first) / sizes, np.nan), sizes)
    return means


def _at_held_pressures(table: xr.Dataset) -> tuple[xr.Dataset, Ints, list[str]]:
    """Samples over time at pressures that are held, their rows and a note, if most under pressure are; else all.

    In between the pressure changes, and belongs to no level.
    """
    rate, pressure = sample_rate(table), table["pressure"].to_numpy()
    rows = np.arange(len(pressure))
    counts = np.unique(pressure_levels(pressure), return_counts=True, equal_nan=False)[1]
    if not rate or "set_pressure" in table or counts.min(initial=_FEWEST) >= _FEWEST:
        return table, rows, []
    under = pressure > _LEVEL
    for seconds in _DWELLS:
        held = np.zeros(len(pressure), bool)
        segments = steady_segments([(pressure, _LEVEL)], restarts(table), int(seconds * rate))
        for first, last in zip(segments.first, segments.last, strict=True):
            held[first:last] = True
        held[held] = np.isfinite(pressure_levels(pressure[held]))  # no slow sweep
        if 2 * np.count_nonzero(held & under) > np.count_nonzero(under):
            break
    else:
        return table, rows, []
    note = f"{np.count_nonzero(~held)} samples between pressures that are held are left out"
    return table.isel(point=held), rows[held], [note]


def _thinned(table: xr.Dataset) -> tuple[xr.Dataset, Ints, list[str]]:
    """Samples over time of at most `_STROKES` strokes, evenly chosen by repeat, their rows, and a note."""
    rows = np.arange(table.sizes["point"])
    if not sample_rate(table) or "repeat" not in table or "direction" not in table:
        return table, rows, []
    strokes = np.count_nonzero(_begins(table, ("repeat", "direction")))
    if (step := -(-strokes // _STROKES)) < 2:
        return table, rows, []
    rows = np.flatnonzero(table["repeat"] % step == 0)
    of = f"{strokes:,} strokes of {table.sizes['point']:,} samples"
    return table.isel(point=rows), rows, [f"{of}: one repeat in {step} is read, {len(rows):,} samples"]


def _averaged(table: xr.Dataset, files: Ints) -> tuple[xr.Dataset, Ints]:
    """Means of successive samples over time, at most `_MOST` of a stroke or 20 times as many, fewer of many strokes.

    A fit of more points takes longer, and rates from the differences of single samples are noise.
    """
    first = np.arange(table.sizes["point"])
    if not sample_rate(table):
        return table, first
    names = [name for name in ("set_pressure", "set_force", "direction", "repeat") if name in table]
    begins = np.flatnonzero(_begins(table, names, files))
    most = min(_MOST if "direction" in table else 20 * _MOST, max(_TOTAL // len(begins), _TOTAL // _STROKES))
    sizes = np.diff(np.append(begins, len(first)))
    run = -(-np.repeat(sizes, sizes) // most)  # samples of a mean
    first = first[(first - np.repeat(begins, sizes)) % run == 0]
    counts = np.diff(np.append(first, len(files)))
    means = {
        name: ("point", np.add.reduceat(table[name].to_numpy(), first) / counts)
        for name in ("time", "pressure", "contraction", "force")
    }
    return table.isel(point=first).assign(means), first


def _begins(table: xr.Dataset, names: Sequence[str], *others: NDArray[np.generic]) -> NDArray[np.bool_]:
    """Mask of the points at which a variable, or another column, differs from the point before."""
    columns = pd.DataFrame(dict(enumerate([*(table[name].to_numpy() for name in names), *others]))).fillna(-1.0)
    return (columns != columns.shift()).any(axis=1).to_numpy()


def sample_rate(table: xr.Dataset) -> float:
    """Rate of samples over time [Hz]; 0 for points that were taken one by one, or without times."""
    interval = usual_interval(np.diff(table["time"].to_numpy()))[0] if "time" in table else 0.0
    return 1 / interval if 0 < interval <= 1 / _FEWEST else 0.0


def contraction_rate(table: xr.Dataset) -> Floats | None:
    """Rate of the contraction [1/s] of each point by differences along its stroke, shape (points,).

    NaN at the ends of strokes, where the muscle may have reversed in between; None without times or directions, and of
    points that are means, which were measured at rest.
    """
    if "time" not in table or "direction" not in table or "force_spread" in table:
        return None
    time, contraction = table["time"].to_numpy(), table["contraction"].to_numpy()
    rate = np.full(len(time), np.nan)
    ends = _begins(table, ["direction"], levels_of(table)) | (np.diff(time, prepend=-np.inf) <= 0)
    for rows in np.split(np.arange(len(time)), np.flatnonzero(ends)):
        if len(rows) > 2:
            rate[rows[1:-1]] = np.gradient(contraction[rows], time[rows])[1:-1]
    resting = np.abs(rate) < 1e-3 * np.nanmax(np.abs(rate), initial=0.0)
    return np.where(resting, 0.0, rate)


def restarts(table: xr.Dataset) -> NDArray[np.bool_]:
    """Mask of the points before which the clock was set back."""
    time = table["time"].to_numpy()
    return np.diff(time, prepend=time[:1]) < 0


def _with_set_pressures(table: xr.Dataset) -> tuple[xr.Dataset, list[str]]:
    """Table with set pressures of levels of three or more points, and a note; unchanged if few points have one."""
    pressure = table["pressure"].to_numpy()
    levels = pressure_levels(pressure)
    nominal, counts = np.unique(levels[np.isfinite(levels)], return_counts=True)
    exact = len(np.unique(pressure)) == len(nominal)
    nominal, counts = nominal[counts >= _FEWEST], counts[counts >= _FEWEST]
    unheld = exact or 2 * counts.sum() <= len(pressure) or held_loads(table) is not None
    if "set_pressure" in table or unheld:
        return table, []
    levels = np.where(np.isin(levels, nominal), levels, np.nan)
    scatter = float(np.nanstd(pressure - levels)) / bar
    plural = "s" if len(nominal) > 1 else ""
    shown = format_range(nominal / bar)
    note = f"{len(nominal)} pressure level{plural} ({shown} bar), about which pressures scatter by {scatter:.2g} bar"
    return table.assign(set_pressure=("point", levels)), [note]


def with_passes(table: xr.Dataset, files: Ints) -> tuple[xr.Dataset, list[str]]:
    """Table with directions and repeats, and a note; unchanged if it has directions or shows no reversals."""
    if "direction" in table:
        return table, []
    loads = held_loads(table)
    of = "level" if loads is None else "load"
    values, groups = np.unique(levels_of(table) if loads is None else loads, return_inverse=True)
    grouped = 2 * len(values) <= len(groups)
    strokes = passes(groups if grouped else 0 * groups, table["contraction"].to_numpy(), files)
    if strokes is None:
        return table, []
    direction, repeat = strokes
    table = table.assign(direction=("point", direction))
    per_level = ""
    if grouped and repeat.any() and "repeat" not in table:
        table = table.assign(repeat=("point", repeat))
        per_level = f"{repeat.max() + 1} of each per {of}, "
    return table, [f"passes of loading and unloading, {per_level}from the order of the rows"]


def _rests(table: xr.Dataset) -> list[str]:
    """Note on samples over time most of which rest, and on the command for them."""
    if not (rate := sample_rate(table)):
        return []
    signals = [(table["pressure"].to_numpy(), 2 * kPa), (table["contraction"].to_numpy(), 1e-3)]
    segments = steady_segments(signals, restarts(table), int(rate))
    share = float(np.sum(segments.last - segments.first)) / table.sizes["point"]
    text = f"{share:.0%} of the samples rest, in {len(segments.first)} plateaus: identify their means, by {POINTS}"
    return [text] if share > 0.5 else []


def held_loads(table: xr.Dataset) -> Floats | None:
    """Load [N] that is held along the path of each point, as by hanging weights, shape (points,); None if none is.

    It is the set force or, without one, the level of forces that repeat to 1 % of the largest: few, each at three
    points or more, and over more pressures than a level has.
    """
    if "set_force" in table and np.isfinite(table["set_force"]).all():
        return np.asarray(table["set_force"].to_numpy())
    force, pressure = table["force"].to_numpy(), table["pressure"].to_numpy()
    levels = level_means(force, 0.01 * np.abs(force).max(initial=0.0))
    distinct, counts = np.unique(levels, return_counts=True)
    if not np.isfinite(levels).all() or counts.min(initial=len(levels)) < _FEWEST:
        return None
    spans = (np.ptp(pressure[levels == level]) for level in distinct)
    return levels if len(distinct) < len(np.unique(levels_of(table))) and min(spans) > 3 * _LEVEL else None


def levels_of(table: xr.Dataset) -> Floats:
    """Set pressure of each point, or the measured one where it is unknown."""
    measured = table["pressure"].to_numpy()
    nominal = table.get("set_pressure", table["pressure"]).to_numpy()
    return np.where(np.isnan(nominal), measured, nominal)


def passes(groups: Ints, contraction: Floats, files: Ints | None = None) -> tuple[NDArray[np.str_], Ints] | None:
    """Direction and repeat of each point from reversals of the contraction per group; None without reversals.

    Parameters
    ----------
    groups
        Shape (points,): number of the pressure of each point.
    contraction
        Shape (points,): [-], in the order of the test.
    files
        Shape (points,): number of the file of each point.

    Returns
    -------
    tuple or None
        Direction, "loading" or "unloading", and repeat from 0, of shape (points,). None if most points are of groups
        with one way only, or less than three points per way.

    Examples
    --------
    >>> direction, repeat = passes(np.zeros(8, int), np.array([0.0, 0.1, 0.2, 0.3, 0.25, 0.2, 0.1, 0.0]))
    >>> direction[[0, 3, 4, 7]].tolist()
    ['unloading', 'unloading', 'loading', 'loading']
    """
    direction, repeat = np.zeros(len(groups), "<U9"), np.zeros(len(groups), int)
    reversing = count = 0
    order = np.argsort(groups, kind="stable")
    levels = np.split(order, np.flatnonzero(np.diff(groups[order])) + 1) if len(order) else []
    for rows in levels:
        ends = np.flatnonzero(np.diff(files[rows])) + 1 if files is not None else []
        runs = [(part[run], word) for part in np.split(rows, ends) for run, word in one_way_parts(contraction[part])]
        reversing += len(rows) * (len(runs) > 1)
        count += len(runs)
        strokes = {"loading": 0, "unloading": 0}
        for points, word in runs:
            direction[points], repeat[points] = word, strokes[word]
            strokes[word] += 1
    return (direction, repeat) if 2 * reversing > len(groups) and _FEWEST * count <= len(groups) else None


def one_way_parts(values: Floats, reversal: float = 0.1) -> list[tuple[slice, str]]:
    """Parts in which the contraction rises ("unloading") or falls ("loading").

    A move back by less than `reversal`, a share of the range, is noise.

    Examples
    --------
    >>> one_way_parts(np.array([0.0, 0.1, 0.2, 0.19, 0.1]))
    [(slice(0, 3, None), 'unloading'), (slice(3, 5, None), 'loading')]
    """
    parts: list[tuple[slice, str]] = []
    if not (threshold := reversal * np.ptp(values)):
        return parts
    words, rows = {1: "unloading", -1: "loading"}, values.tolist()
    start, extreme, way = 0, 0, 0
    for row, value in enumerate(rows):
        ahead = value - rows[extreme]
        if way * ahead > 0:
            extreme = row
        elif abs(ahead) > threshold:
            if way:
                parts.append((slice(start, extreme + 1), words[way]))
                start = extreme + 1
            extreme, way = row, 1 if ahead > 0 else -1
    return [*parts, (slice(start, len(rows)), words[way])]


def without_offset(table: xr.Dataset) -> tuple[xr.Dataset, list[str]]:
    """Table with the slack muscle's force subtracted, and notes.

    Without a slack muscle, the table is unchanged, and if no force is 0, a note says that the zero is not known, unless
    weights hung.
    """
    if (slack := _slack_of(table)) is None:
        unknown = "no slack muscle is recognised: the zero of the load cell is not estimated"
        return table, [unknown] if table["force"].min() > 0 and held_loads(table) is None else []
    note = f"{slack}; this offset is subtracted, and forces up to {slack.limit:.3g} N count as slack"
    return table.assign(force=table["force"] - slack.offset).assign_attrs(slack_force=slack.limit), [note]


def with_slack_force(table: xr.Dataset) -> xr.Dataset:
    """Table with the slack force from noise about 0 N, and a note; 0 N if none, and a warning of an offset."""
    if (slack := _slack_of(table)) is None:
        return table
    if slack.offset > slack.limit:
        text = (
            f"the lowest forces, {slack.offset:.3g} +- {slack.noise:.2g} N at {slack.points} points, count as taut; if "
            "the muscle is slack there, subtract the zero error of the load cell, otherwise give slack_force=0.0 "
            "(command line: --read 'slack_force=0 N')"
        )
        warnings.warn(text, McKibbenWarning, stacklevel=user_level())
        return table
    limit = max(slack.offset + slack.limit, 0.0)
    return with_notes(table.assign_attrs(slack_force=limit), [f"{slack}; forces up to {limit:.3g} N count as slack"])


def with_notes(table: xr.Dataset, notes: list[str]) -> xr.Dataset:
    """Table with more notes in `preprocessing`."""
    before = table.attrs.get("preprocessing", "").splitlines()
    return table.assign_attrs(preprocessing="\n".join([*before, *notes])) if notes else table


class Slack(NamedTuple):
    """Force of the slack muscle: zero offset and standard deviation of the noise [N], and points that show them."""

    offset: float
    noise: float
    points: int

    @property
    def limit(self) -> float:
        """Largest force that counts as slack, above the offset [N]."""
        return _NOISE * self.noise

    def __str__(self) -> str:
        return f"slack muscle: a force of {self.offset:.3g} +- {self.noise:.2g} N"


def _slack_of(table: xr.Dataset) -> Slack | None:
    if held_loads(table) is not None:
        return None
    levels = levels_of(table)
    levels = np.where(np.isnan(grouped := pressure_levels(levels)), levels, grouped)
    strokes = np.unique(levels, return_inverse=True)[1]
    if "direction" in table:
        strokes = 2 * strokes + (table["direction"].to_numpy() == "loading")
    return slack_force(table["force"].to_numpy(), table["contraction"].to_numpy(), levels, strokes)


def slack_force(
    force: Floats, contraction: Floats, pressure: Floats, strokes: Ints, *, lowest: float = 0.15, fewest: int = 5
) -> Slack | None:
    """Force of the slack muscle, which depends neither on the contraction nor on the pressure; None if not detectable.

    The mode of the lowest forces is the offset, and the forces below it give the noise. They are slack if they are at
    two pressures or more and change neither with the contraction nor from stroke to stroke, or are without pressure,
    and lie beyond the taut points of their strokes.

    Parameters
    ----------
    force, contraction, pressure
        Shape (points,) [N], [-], [Pa].
    strokes
        Number of the stroke of each point.
    lowest
        Share of the range of forces in which the slack muscle is looked for.
    fewest
        Smallest number of slack points.
    """
    near = np.sort(force[force <= force.min(initial=np.inf) + lowest * np.ptp(force)]) if len(force) else force
    if len(near) < fewest or near[0] == force.max():
        return None
    offset = half_sample_mode(near)
    for _ in range(2):
        noise = float(np.sqrt(np.mean((near[near <= offset] - offset) ** 2)))
        offset = float(np.median(near[np.abs(near - offset) <= _NOISE * noise]))
    if not noise:  # readings that are cut off at the offset
        above = (force - offset)[_beyond(force == offset, contraction, strokes)]
        noise = float(np.sqrt(np.mean(above[above > 0] ** 2))) if (above > 0).sum() > 1 else 0.0
    slack = np.abs(force - offset) <= _NOISE * noise
    points = int(np.count_nonzero(slack))
    if points < fewest or not noise or _NOISE * noise > lowest * np.ptp(force):
        return None
    beyond = _beyond(slack, contraction, strokes)
    if (slack & beyond).sum() < 0.8 * beyond.sum():
        return None
    vented = pressure[slack].max() <= 0.05 * bar
    level = len(np.unique(pressure[slack])) > 1 and not _depends(force[slack], contraction[slack], strokes[slack])
    return Slack(offset, noise, points) if vented or level else None


def _depends(force: Floats, contraction: Floats, strokes: Ints) -> bool:
    """Whether the force changes with the contraction within strokes, or between them; also if too few points tell."""
    counts = np.bincount(strokes)
    x, y = (values - (np.bincount(strokes, values) / np.maximum(counts, 1))[strokes] for values in (contraction, force))
    freedom = len(force) - np.count_nonzero(counts) - 1
    if freedom < 2 or np.ptp(x) < 1e-3:
        return True
    residual = y @ y - (x @ y) ** 2 / (x @ x)
    return bool(residual < 0.5 * (y @ y) or residual / freedom < 0.5 * np.var(force, ddof=1))


def _beyond(marked: NDArray[np.bool_], contraction: Floats, strokes: Ints) -> NDArray[np.bool_]:
    """Points at or beyond the least contraction of a marked point of their stroke."""
    least = np.full(strokes.max() + 1, np.inf)
    np.minimum.at(least, strokes[marked], contraction[marked])
    return np.asarray(contraction >= least[strokes])


def half_sample_mode(values: Floats) -> float:
    """Mode of sorted values by repeated halving.

    The densest half of the values is kept until three are left (Robertson and Cryer, J. American Statistical Ass. 69
    (1974) 1012).

    >>> half_sample_mode(np.array([0.0, 0.1, 5.0, 5.4, 5.8]))
    5.4
    """
    while len(values) > 3:
        half = (len(values) + 1) // 2
        start = int(np.argmin(values[half - 1 :] - values[: len(values) - half + 1]))
        values = values[start : start + half]
    return float(values.mean() if len(values) < 3 else np.median(values))
