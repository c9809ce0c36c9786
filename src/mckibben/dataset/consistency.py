"""Consistency of measured points: rows, levels and labels that contradict the others."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from mckibben.component.calls import user_level
from mckibben.dataset.isobaric import IsobaricDataset
from mckibben.dataset.plausibility import LARGEST_FORCE, REPEATED, UNEQUAL, check_points, resolution
from mckibben.dataset.preprocessing import strays
from mckibben.errors import DatasetError, McKibbenWarning, Problem
from mckibben.muscle import Specimen
from mckibben.units import bar, percent

Floats = NDArray[np.float64]
Rows = NDArray[np.intp]

_OFF_SET = 0.2  # of the highest pressure: a set pressure that is not the measured one
_LEVEL = 0.05  # of a pressure, and of the highest: pressures compared with each other
_STROKE = 0.5  # of the range of contractions: a level that covers less may follow a spring
_FEWEST = 8  # points at levels with different contractions
_RISING = 0.7  # correlation of force and contraction at constant pressure
_TOLERANCE = 0.25  # of the force that a tenth of the points exceed: more than friction and creep
_NOISE = 0.05  # of the largest force
_SAME = 0.1 * percent  # contraction
_LOOP = 2.0  # usual distances between loading and unloading
_BESIDE, _FAR_ABOVE = 0.25, 2.0  # of the range of contractions; ratio of forces per pressure
_PRESSURIZED = 0.25  # of the largest pressure: at less, most of the force may be that of stretched rubber
_SHORTEST_STROKE, _LONGEST_REACH = 5 * percent, 45 * percent  # contractions of a line that is extrapolated
_LEAST_LEVELS, _PROPORTIONAL = 3, 1.15  # pressures, and largest ratio of contraction per pressure
_APART = 1.4  # ratio of pressures at which contractions are compared
_AGAINST = 3  # points that an outlier contradicts
_STILL = 0.1  # of the largest change of contraction: smaller ones may be noise
_SHARE = 0.1  # of the points: more are not single errors
_MOST, _NAMED = 1000, 5  # points at a level that are compared in pairs, and those named in a warning
_HELD = 0.2  # of the rows: forces that repeat although the muscle moved
_VARIED = 1 / 6  # of the rows: different forces of a test that is not isotonic
_COARSE = 10  # steps of the resolution of the force, below which equal forces are rounded ones
_ESTIMATED = 5  # slack points, from which the offset of the load cell is estimated
_EQUAL, _OFFSET = 0.01, 0.02  # of the largest force: spread and least mean of forces that show an offset
_FLAT = 0.25  # of the mean slope before: slope of the force of a slack muscle
_UNSTRETCHED = 2 * percent  # contraction of a muscle that does not pull without pressure
_NEAR = 0.5 * percent  # contraction at which a muscle pulls as soon as there is pressure
_VENTED = 0.2 * bar  # lowest pressure of a muscle that should pull
_DEAD_BAND = 0.4  # of the step above the lowest pressure
_ATMOSPHERE = (0.75 * bar, 1.6 * bar)  # pressure at which the force of a muscle may begin if pressures are absolute
_LOWEST_ABSOLUTE = 0.7 * bar  # of the atmosphere, at 3,000 m
_TAUT, _UPPER = 0.15, 0.6  # of the largest force, and of the range of contractions: points whose force is compared
_CERTAIN = 2.5  # standard errors
_WITHOUT_PRESSURE = (0.05, 0.6)  # of the largest force: force at all contractions, extrapolated to no pressure
_ALIKE = 1.5  # largest over least of these forces, if they are an offset
_TOP, _MORE, _SHORTER = 0.97, 1.15, 0.1  # of the largest force; ratio of pressures; of the range of contractions
_MUCH_SHORTER = (0.25, 2.5 * percent)  # of the range of contractions, and contraction
_ENOUGH = 100_000  # points, of which the line is determined well
_MOVED = 0.2 * percent  # contraction from point to point
_PAIRS = 3  # of points per direction
_REVERSED = 0.9  # of these pairs
_FASTER = 1.5  # ratio of speeds of strokes, above which their forces are not compared


def check_dataset(
    dataset: IsobaricDataset,
    source: str,
    specimen: Specimen | None = None,
    *,
    only_warn: bool = False,
    measured: NDArray[np.float64] | None = None,
) -> IsobaricDataset:
    """Check a dataset; raises a `DatasetError` for points impossible for a muscle, and warns of unusual ones.

    With `only_warn`, impossible points cause warnings too: what this program wrote stays readable. `measured` are the
    forces before an offset was subtracted.
    """
    attrs = dataset.table.attrs
    found = check_points(
        dataset.pressure,
        dataset.contraction,
        dataset.force,
        attrs["slack_force"],
        attrs.get("initial_length"),
        specimen,
        measured,
        dict(set.intersection(*(set(one.units.items()) for one in dataset.lines))) if dataset.lines else {},
        dataset.place,
    )
    if found.problems and not only_warn:
        stray = [Problem(text, field="pressure") for text in _far_from_levels(dataset)]
        raise DatasetError(source, stray + [one for one in found.problems if not stray or one.field != "pressure"])
    for text in [*map(str, found.problems), *found.warnings, *(() if found.problems else contradictions(dataset))]:
        warnings.warn(f"{source}: {text}", McKibbenWarning, stacklevel=user_level())
    return dataset


def contradictions(dataset: IsobaricDataset) -> Iterator[str]:
    """Warnings about points that contradict each other."""
    if not (len(dataset) and dataset.force.max() > 0 and dataset.pressure.max() > 0):
        return
    yield from _set_pressures(dataset)
    yield from map("pressure: {}".format, _far_from_levels(dataset))
    if (slack := dataset.table.attrs["slack_force"]) >= dataset.force.max():
        yield f"slack_force: all forces are up to the {slack:g} N at which the muscle counts as slack; give a lower one"
    levels = _levels(dataset.pressure)
    rising = list(_rising_forces(dataset, levels))
    yield from rising or _outliers(dataset, levels)
    yield from _reach(dataset, levels)
    yield from _exchanged(dataset, levels)
    yield from _counted(dataset)
    yield from _unequal_forces(dataset)
    yield from _held_forces(dataset)
    yield from _saturated(dataset)
    slack = list(_few_slack_points(dataset))
    yield from slack
    yield from list(_pressure_offset(dataset, levels)) or _offsets(dataset, known=bool(slack))
    yield from _directions(dataset, levels)


def _levels(pressure: Floats) -> list[Rows]:
    """Rows of about the same pressure, from the lowest pressure up."""
    bins = np.round(pressure / (_LEVEL * pressure.max()))
    order = np.argsort(bins, kind="stable")
    return np.split(order, np.flatnonzero(np.diff(bins[order])) + 1)


def _speeds(dataset: IsobaricDataset) -> NDArray[np.intp]:
    """Number of each point's speed and direction, where friction may grow with the speed; 0 for equal or unknown ones.

    Points where strokes of different speeds reverse have negative numbers of their own: friction reverses there.
    """
    table, speeds, ends = dataset.table, np.zeros(len(dataset)), []
    if not {"time", "direction", "repeat"} <= {*map(str, table)}:
        return speeds.astype(np.intp)
    keys = np.unique(table["direction"], return_inverse=True)[1], table["repeat"].to_numpy(), dataset.levels
    order = np.lexsort(keys)
    for rows in np.split(order, np.flatnonzero(np.diff(np.stack(keys)[:, order]).any(axis=0)) + 1):
        travel, time = np.ptp(dataset.contraction[rows]), np.ptp(table["time"].to_numpy()[rows])
        speeds[rows] = travel / time if time > 0 else 0.0
        ends += [rows.min(), rows.max()]
    distinct = np.unique(speeds)
    number = np.append(0, np.cumsum(distinct[1:] > _FASTER * distinct[:-1]))[np.searchsorted(distinct, speeds)]
    if number.any():
        number = 2 * number + (table["direction"].to_numpy() == "loading")
        number[ends] = -1 - np.arange(len(ends))
    return number


def _set_pressures(dataset: IsobaricDataset) -> Iterator[str]:
    """Warning about set pressures far from the measured ones."""
    if "set_pressure" not in dataset.table:
        return
    asked, measured = dataset.table["set_pressure"].to_numpy(), dataset.pressure
    off = np.flatnonzero(np.abs(asked - measured) > _OFF_SET * measured.max())
    if len(off):
        at = off[0]
        yield (
            f"set_pressure: {len(off)} of {len(asked)} set pressures are far from the measured ones, first "
            f"{asked[at] / bar:.3g} bar at {measured[at] / bar:.3g} bar; check the unit, or leave the column out"
        )


def _far_from_levels(dataset: IsobaricDataset) -> Iterator[str]:
    """Message on single pressures far from the levels of all other points."""
    if len(rows := strays(dataset.pressure, dataset.levels)):
        named = ", ".join(
            f"{dataset.place(at)} ({dataset.pressure[at] / bar:.4g} bar)" for at in rows[:_NAMED].tolist()
        )
        verb = "is" if len(rows) == 1 else f"({len(rows)} in all) are"
        yield f"{named} {verb} far from the levels of all other points; correct these rows, or leave them out"


def _rising_forces(dataset: IsobaricDataset, levels: Sequence[Rows]) -> Iterator[str]:
    """Warning if the force rises with the contraction at constant pressure."""
    stroke = np.ptp(dataset.contraction)
    wide = [rows for rows in levels if np.ptp(dataset.contraction[rows]) >= _STROKE * stroke > 0]
    if sum(map(len, wide)) < _FEWEST:
        return
    x, y = (
        np.concatenate([values[rows] - values[rows].mean() for rows in wide])
        for values in (dataset.contraction, dataset.force)
    )
    if x @ y > _RISING * np.sqrt((x @ x) * (y @ y)) > 0:
        yield (
            "contraction: the force rises with the contraction at constant pressure, but a muscle pulls less the "
            "shorter it is; check the sign (positive = shorter), for displacements give the other direction: "
            "displacement='lengthening' or 'shortening' (command line: --displacement)"
        )


def _reach(dataset: IsobaricDataset, levels: Sequence[Rows]) -> Iterator[str]:
    """Warning if the force would end at a contraction that no muscle reaches.

    It is a convex function of the contraction: a line through its points ends at a smaller one.
    """
    contraction, force, stroke = dataset.contraction, dataset.force, np.ptp(dataset.contraction)
    rows = max(levels, key=lambda rows: (np.ptp(contraction[rows]) >= _STROKE * stroke) * force[rows].mean())
    if len(rows) < _FEWEST // 2 or np.ptp(contraction[rows]) < max(_STROKE * stroke, _SHORTEST_STROKE):
        return
    slope, start = np.polyfit(contraction[rows], force[rows], 1)
    if slope < 0 and -slope * np.ptp(contraction[rows]) > _TAUT * start and -start / slope > _LONGEST_REACH:
        yield (
            f"contraction: the force would end at {-start / slope / percent:.2g} %, but muscles contract by 20 to "
            "35 %; check the unit and initial_length (command line: --initial-length), and the zero of the load cell"
        )


def _exchanged(dataset: IsobaricDataset, levels: Sequence[Rows]) -> Iterator[str]:
    """Warning if the contraction without load is proportional to the pressure, as the force at full length is.

    That of a thin muscle is nearly the same at all pressures; thick ones have forces that are no contractions [%].
    """
    contraction, force = dataset.contraction, dataset.force
    free = [rows[np.argmin(force[rows])] for rows in levels if force[rows].min() <= _NOISE * force.max()]
    pressure, reached = dataset.pressure[free], contraction[free]
    if (
        force.max() > _LONGEST_REACH / percent
        or len(free) < _LEAST_LEVELS
        or not pressure.min() > 0
        or pressure.max() < _APART * pressure.min()
    ):
        return
    ratio = reached / pressure
    if ratio.min() > 0 and ratio.max() < _PROPORTIONAL * ratio.min():
        yield (
            "contraction: without load it is proportional to the pressure, as the force of a muscle at its full length "
            "is; check whether the columns of force and contraction are exchanged"
        )


def _outliers(dataset: IsobaricDataset, levels: Sequence[Rows]) -> Iterator[str]:
    """Warning about single points that contradict those of their pressure, or that pull without pressure."""
    pressure, contraction, force = dataset.pressure, dataset.contraction, dataset.force
    tolerance = max(_TOLERANCE * float(np.quantile(force, 0.9)), _NOISE * float(force.max()))
    vented = _alone_at_the_top(pressure, contraction, force)
    vented |= (pressure <= _LEVEL / 2 * pressure.max()) & (force > tolerance) & (contraction > _UNSTRETCHED)
    found = set(np.flatnonzero(vented).tolist())
    speeds = _speeds(dataset)
    for part in [levels] if len(force) <= _MOST else [[rows] for rows in levels if len(rows) <= _MOST]:
        for speed in np.unique(speeds[speeds >= 0]):
            if alike := [rows for each in part if len(rows := each[speeds[each] == speed])]:
                found |= _against_others(contraction, force, alike)
    single = len(found) <= _SHARE * len(force)
    if found and (single or len(found) >= _AGAINST):
        first = sorted(found)[:_NAMED]
        shown = ", ".join(
            f"{dataset.place(at)} ({pressure[at] / bar:.3g} bar, {contraction[at] / percent:.3g} %, {force[at]:.4g} N)"
            for at in first
        )
        more = f" and {len(found) - _NAMED} more" if len(found) > _NAMED else ""
        yield (
            f"force: {len(found)} of {len(force)} points contradict the others: the force should rise with the "
            f"pressure and fall with the contraction, which it does not at {shown}{more}; "
            + ("check these rows, or leave them out" if single else "they may be of another muscle, unit or sensor")
        )


def _alone_at_the_top(pressure: Floats, contraction: Floats, force: Floats) -> NDArray[np.bool_]:
    """True for a row whose force per pressure is far above all others at about its contraction or a smaller one."""
    near = np.flatnonzero((pressure > _PRESSURIZED * pressure.max()) & (force > 0))
    found, share = np.zeros(len(force), bool), force[near] / pressure[near]
    if len(near) >= _FEWEST:
        at = near[np.argmax(share)]
        others = share[(near != at) & (contraction[near] <= contraction[at] + _BESIDE * np.ptp(contraction))]
        found[at] = len(others) > 1 and share.max() > _FAR_ABOVE * others.max()
    return found


def _against_others(contraction: Floats, force: Floats, levels: Sequence[Rows]) -> set[int]:
    """Fewest points without which the force falls with the contraction, and rises from level to level."""
    rows = np.concatenate(levels)
    level = np.repeat(np.arange(len(levels)), list(map(len, levels)))
    largest = np.maximum.accumulate([np.quantile(force[each], 0.9) for each in levels])
    loops = np.maximum(_TOLERANCE * np.minimum(largest, np.quantile(force, 0.9)), _NOISE * force.max())
    widths, shares = _LOOP * np.transpose([_friction(contraction[each], force[each]) for each in levels])
    eps, pull = contraction[rows], force[rows]
    tolerance = np.maximum(np.maximum(loops, widths)[level][:, None], shares[level][:, None] * pull)
    less = (pull - pull[:, None]) / tolerance  # twice the tolerance counts twice
    against = np.clip(less, 0, 2).astype(np.int64) * ((eps[:, None] <= eps + _SAME) & (level[:, None] >= level))
    against += against.T
    counts, found = against.sum(axis=1), set()
    while counts.max() >= _AGAINST:
        at = int(np.argmax(counts))
        found.add(int(rows[at]))
        counts -= against[at]
        counts[at] = 0
    return found


def _friction(contraction: Floats, force: Floats) -> tuple[float, float]:
    """Usual distance of the force [N] from the line through the points next to it in contraction, and its share."""
    order = np.argsort(contraction, kind="stable")
    eps, pull = contraction[order], force[order]
    if len(eps) < 3:
        return 0.0, 0.0
    span = eps[2:] - eps[:-2]
    weight = np.divide(eps[1:-1] - eps[:-2], span, out=np.full(len(span), 0.5), where=span > 0)
    distance = np.abs(pull[1:-1] - (1 - weight) * pull[:-2] - weight * pull[2:])
    taut = pull[1:-1] > _TAUT * force.max()
    share = np.median(distance[taut] / pull[1:-1][taut]) if taut.any() else 0.0
    return float(np.median(distance)), float(share)


def _held_forces(dataset: IsobaricDataset) -> Iterator[str]:
    """Warning if many forces repeat the one before although the muscle moved."""
    force, change = dataset.force, np.diff(dataset.force)
    moved = np.abs(np.diff(dataset.contraction)) > _MOVED
    moved &= np.minimum(force[1:], force[:-1]) > _NOISE * force.max()
    held = moved & (change == 0)
    longest = int(np.bincount(np.cumsum(change != 0)[held]).max(initial=0))  # of one value
    if longest <= _PAIRS and not held.sum() > max(_HELD * moved.sum(), _PAIRS):
        return
    others = np.abs(change[moved & ~held])
    rounded = not others.size or np.median(others) <= _COARSE * resolution(force)
    if not rounded and len(np.unique(force)) > _VARIED * len(force):
        yield (
            f"force: {held.sum()} of {moved.sum()} forces repeat the row before, although the muscle moved: a channel "
            "with a lower rate may hold its last value; leave these rows out"
        )


def _counted(dataset: IsobaricDataset) -> Iterator[str]:
    """Warning if the pressure rises by one step from row to row, as a spreadsheet counts, while the muscle moves."""
    moves, steps = np.diff(dataset.contraction), np.diff(dataset.pressure)
    large = moves[np.abs(moves) > _STILL * np.abs(moves).max(initial=0.0)]
    reversals = int(np.count_nonzero(np.diff(np.sign(large))))
    equal = steps.any() and np.allclose(steps, steps[0], rtol=1e-6, atol=0)
    if equal and reversals >= _AGAINST and np.ptp(dataset.contraction) > _SHORTEST_STROKE:
        yield (
            f"pressure: each of {len(steps)} rows has {steps[0] / bar:.3g} bar more than the one before, although the "
            f"muscle reversed {reversals} times: a spreadsheet may have counted it up"
        )


def _unequal_forces(dataset: IsobaricDataset) -> Iterator[str]:
    """Warning if forces at the same pressure and contraction differ by more than friction and creep."""
    contraction, force, pressure = dataset.contraction, dataset.force, dataset.pressure
    places = np.round(pressure / (REPEATED * pressure.max())), np.round(contraction / _SAME)
    bins = np.stack([_speeds(dataset), *places])
    order = np.lexsort(bins)
    starts = np.append(0, np.flatnonzero(np.any(np.diff(bins[:, order]), axis=0)) + 1)
    counts = np.diff(starts, append=len(order))
    high, low = np.maximum.reduceat(force[order], starts), np.minimum.reduceat(force[order], starts)
    several = (counts > 1) & (high > _TAUT * force.max())
    own, overall = UNEQUAL
    apart = np.flatnonzero(several & (high - low > np.maximum(own * high, overall * force.max())))
    if len(apart) >= _AGAINST and 2 * len(apart) >= several.sum():
        first = apart[0]
        at = order[starts[first]]
        yield (
            f"force: {low[first]:.4g} to {high[first]:.4g} N at {pressure[at] / bar:.3g} bar and "
            f"{contraction[at] / percent:.3g} %, and as different at {len(apart) - 1} of {several.sum() - 1} other "
            "places: a sensor may be stuck, or the rows may come from several muscles"
        )


def _saturated(dataset: IsobaricDataset) -> Iterator[str]:
    """Warning if the largest force is reached at a much larger contraction, or one at much less pressure, too."""
    contraction, force, pressure = dataset.contraction, dataset.force, dataset.pressure
    top = np.flatnonzero(force >= _TOP * force.max())
    if len(top) > _MOST or len(top) == len(force):  # one load for all
        return
    shorter, stroke = contraction[top, None] - contraction[top], np.ptp(contraction)
    weaker = (pressure[top] > _MORE * pressure[top, None]) & (shorter > _SHORTER * stroke)
    as_much = (1 + _LEVEL) * pressure[top] >= pressure[top, None]
    weaker |= as_much & (shorter > max(_MUCH_SHORTER[0] * stroke, _MUCH_SHORTER[1]))
    if weaker.any():
        at, other = (top[row] for row in np.argwhere(weaker)[0])
        yield (
            f"force: {len(top)} forces are within 3 % of the largest, {force.max():.4g} N, at points as different as "
            f"{pressure[at] / bar:.3g} bar and {contraction[at] / percent:.3g} %, and {pressure[other] / bar:.3g} bar "
            f"and {contraction[other] / percent:.3g} %: the sensor or its amplifier may be saturated; "
            f"leave such rows out{LARGEST_FORCE}"
        )


def _few_slack_points(dataset: IsobaricDataset) -> Iterator[str]:
    """Warning of slack points that are too few for the estimate of an offset.

    Their force is equal at different contractions of a level, or at the largest contractions of different levels, while
    the points next to them differ, and no force is lower.
    """
    contraction, force = dataset.contraction, dataset.force
    largest = float(force.max())
    nominal = dataset.table.get("set_pressure", dataset.table["pressure"]).fillna(0).to_numpy()
    levels = _levels(nominal if nominal.max() > 0 else dataset.pressure)
    ordered = [rows[np.argsort(contraction[rows], kind="stable")] for rows in levels if len(rows) > 2]
    found = [rows[-count:] for rows in ordered if (count := _flat(contraction[rows], force[rows], _EQUAL * largest))]
    if not found and 1 < len(ordered) < _ESTIMATED:
        last, before = (np.array([rows[at] for rows in ordered]) for at in (-1, -2))
        if np.ptp(force[last]) <= _EQUAL * largest and np.ptp(force[before]) > _OFFSET * largest:
            found = [last]
    at = np.concatenate(found) if found else np.array([], np.intp)
    mean = float(force[at].mean()) if len(at) else 0.0
    lowest = mean <= force.min() + _EQUAL * largest  # as a muscle never pushes
    if lowest and mean > max(_OFFSET * largest, dataset.table.attrs["slack_force"]):
        yield (
            f"force: the force at the {len(at)} largest contractions is about {mean:.3g} N at each: if the muscle is "
            "slack there, this is the offset of the load cell, which is not subtracted, as an estimate needs at least "
            f"{_ESTIMATED} slack points; measure more of them, or subtract the offset in the file"
        )


def _flat(contraction: Floats, force: Floats, tolerance: float) -> int:
    """Number of last points, in order of contraction, with equal forces after a fall; 0 if there are none or many."""
    starts = np.flatnonzero(np.diff(contraction, prepend=-np.inf) > _SAME)
    if len(starts) < 3:
        return 0
    counts = np.diff(np.append(starts, len(force)))
    eps, pull = (np.add.reduceat(values, starts) / counts for values in (contraction, force))
    for count in range(min(_ESTIMATED, len(eps)) - 1, 1, -1):
        slope = (pull[0] - pull[-count]) / (eps[-count] - eps[0])
        if np.ptp(pull[-count:]) <= min(_FLAT * slope * (eps[-1] - eps[-count]), tolerance):
            return int(counts[-count:].sum())
    return 0


def _pressure_offset(dataset: IsobaricDataset, levels: Sequence[Rows]) -> Iterator[str]:
    """Warning if the force at the smallest contraction begins at the lowest pressure, which is not 0."""
    contraction, force = dataset.contraction, dataset.force
    near = contraction <= _NEAR
    longest = [rows[near[rows]] for rows in levels if near[rows].any()]
    if len(longest) < 3 or len(levels[0]) < _PAIRS or not near[levels[0]].any():
        return
    at = np.array([dataset.pressure[rows].mean() for rows in longest])
    pull = np.array([force[rows].mean() for rows in longest])
    slope, start = np.polyfit(at[1:], pull[1:], 1)
    slack = max(dataset.table.attrs["slack_force"], _NOISE / 2 * float(force.max()))
    dead = at[0] + _DEAD_BAND * (at[1] - at[0])
    apart = at[1] - at[0] > 2 * _LEVEL * at[-1]
    if apart and at[0] >= _VENTED and force[levels[0]].max() <= slack < pull[1] and slope > 0 and -start / slope < dead:
        yield (
            f"pressure: the muscle is slack at the lowest pressure, {at[0] / bar:.3g} bar, and pulls from there on; "
            "pressures may be absolute or have an offset: they are read as gauge pressures"
        )


def _offsets(dataset: IsobaricDataset, *, known: bool) -> Iterator[str]:
    """Warning if forces begin at about the pressure of the atmosphere, or, if not `known`, are not 0 without pressure.

    The force of a taut muscle is linear in the pressure: least squares with p (a + b eps + c eps^2) + d + e eps.
    """
    contraction, force, pressure = dataset.contraction, dataset.force, dataset.pressure
    stroke = np.ptp(contraction)
    used = force > max(_TAUT * force.max(), dataset.table.attrs["slack_force"])
    used &= contraction <= contraction.min() + _UPPER * stroke
    used = np.flatnonzero(used)[:: 1 + len(used) // _ENOUGH]
    p, eps = pressure[used] / bar, (contraction[used] - contraction.min()) / (stroke or 1.0)
    terms = [p, np.ones(len(p)), eps, p * eps, p * eps**2][: 5 if stroke else 2]
    if contraction.min() > _NEAR or len(p) <= len(terms) or p.max() <= 0:
        return
    if len(np.unique(np.round(p / (_LEVEL * p.max())))) < 3:
        return
    design = np.stack(terms, axis=1)
    found = np.linalg.lstsq(design, force[used])[0]
    slope, start = found[:2]
    if slope <= 0:
        return
    begin = -start / slope
    residual = force[used] - design @ found
    covariance = np.linalg.pinv(design.T @ design) * (residual @ residual) / (len(p) - len(terms))
    gradient = np.array([begin, 1.0]) / slope
    error = np.sqrt(gradient @ covariance[:2, :2] @ gradient)
    low, high = _ATMOSPHERE
    near = low <= (begin + error) * bar and (begin - error) * bar <= high
    if pressure.min() >= _LOWEST_ABSOLUTE and near and begin > _CERTAIN * error:
        yield (
            f"pressure: the force at the initial length begins at about {begin:.2g} bar; either the muscle needs this "
            "pressure before it pulls, or the pressures are absolute: they are read as gauge pressures"
        )
    ends = np.stack([np.ones(2), [0.0, eps.max()]])[: len(terms) - 1]  # of the contractions, without pressure
    pulls = found[1:3] @ ends
    errors = np.sqrt(np.einsum("ie,ij,je->e", ends, covariance[1:3, 1:3], ends))
    low, high = _WITHOUT_PRESSURE
    above = np.all(pulls > np.maximum(low * force.max(), _CERTAIN * errors))
    alike = pulls.max() - errors.max() < _ALIKE * pulls.min()
    if not known and above and alike and pulls.max() < high * force.max():
        yield (
            f"force: without pressure, a force of about {pulls.mean():.3g} N would remain at all contractions: "
            "this may be an offset of the load cell or the pressures, or friction if all points are of one direction"
        )


def _directions(dataset: IsobaricDataset, levels: Sequence[Rows]) -> Iterator[str]:
    """Warning if the contraction grows in loading, and falls in unloading, from row to row."""
    if "direction" not in dataset.table:
        return
    label = dataset.table["direction"].to_numpy()
    steps = {"loading": [], "unloading": []}
    for rows in levels:
        change, same = np.diff(dataset.contraction[rows]), label[rows][1:] == label[rows][:-1]
        for word, found in steps.items():
            found += change[same & (label[rows][1:] == word) & (np.abs(change) > _MOVED)].tolist()
    grows, falls = np.array(steps["loading"]) > 0, np.array(steps["unloading"]) < 0
    if min(len(grows), len(falls)) >= _PAIRS and min(grows.mean(), falls.mean()) > _REVERSED:
        yield (
            "direction: the contraction grows in loading and falls in unloading; loading is being stretched, unloading "
            "is shortening: exchange the words"
        )
