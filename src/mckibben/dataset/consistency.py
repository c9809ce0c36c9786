"""Consistency of measured points: rows, levels and labels that contradict the others."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from mckibben.dataset.isobaric import IsobaricDataset
from mckibben.units import bar, percent

Floats = NDArray[np.float64]
Rows = NDArray[np.intp]

_OFF_SET = 0.2  # of the highest pressure: a set pressure that is not the measured one
_LEVEL = 0.05  # of the highest pressure: pressures compared with each other
_STROKE = 0.5  # of the range of contractions: a level that covers less may follow a spring
_FEWEST = 8  # points at levels with different contractions
_RISING = 0.7  # correlation of force and contraction at constant pressure
_TOLERANCE = 0.25  # of the force that a tenth of the points exceed: more than friction and creep
_NOISE = 0.05  # of the largest force
_SAME = 0.1 * percent  # contraction
_LOOP = 2.0  # usual steps of the force from contraction to contraction, which friction adds to
_AGAINST = 3  # points that an outlier contradicts
_SHARE = 0.1  # of the points: more are not single errors
_MOST = 1000  # points at a level that are compared in pairs
_NAMED = 5  # points named in a warning
_UNSTRETCHED = 2 * percent  # contraction of a muscle that does not pull without pressure
_NEAR = 0.5 * percent  # contraction at which a muscle pulls as soon as there is pressure
_VENTED = 0.2 * bar  # lowest pressure of a muscle that should pull
_DEAD_BAND = 0.4  # of the step above the lowest pressure
_MOVED = 0.2 * percent  # contraction from point to point
_PAIRS = 3  # of points per direction
_REVERSED = 0.9  # of these pairs


def contradictions(dataset: IsobaricDataset) -> Iterator[str]:
    """Warnings about points that contradict each other."""
    if not (len(dataset) and dataset.force.max() > 0 and dataset.pressure.max() > 0):
        return
    yield from _set_pressures(dataset)
    if (slack := dataset.table.attrs["slack_force"]) >= dataset.force.max():
        yield f"slack_force: all forces are up to the {slack:g} N at which the muscle counts as slack; give a lower one"
    levels = _levels(dataset.pressure)
    rising = list(_rising_forces(dataset, levels))
    yield from rising or _outliers(dataset, levels)
    yield from _pressure_offset(dataset, levels)
    yield from _directions(dataset, levels)


def _levels(pressure: Floats) -> list[Rows]:
    """Rows of about the same pressure, from the lowest pressure up."""
    bins = np.round(pressure / (_LEVEL * pressure.max()))
    order = np.argsort(bins, kind="stable")
    return np.split(order, np.flatnonzero(np.diff(bins[order])) + 1)


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


def _outliers(dataset: IsobaricDataset, levels: Sequence[Rows]) -> Iterator[str]:
    """Warning about single points that contradict those of their pressure, or that pull without pressure."""
    pressure, contraction, force = dataset.pressure, dataset.contraction, dataset.force
    tolerance = max(_TOLERANCE * float(np.quantile(force, 0.9)), _NOISE * float(force.max()))
    vented = (pressure <= _LEVEL / 2 * pressure.max()) & (force > tolerance) & (contraction > _UNSTRETCHED)
    found = set(np.flatnonzero(vented).tolist())
    for rows in levels:
        found |= set(rows[_against_others(contraction[rows], force[rows], tolerance)].tolist())
    found = sorted(found)
    if found and len(found) <= _SHARE * len(force):
        shown = ", ".join(
            f"{at + 1} ({pressure[at] / bar:.3g} bar, {contraction[at] / percent:.3g} %, {force[at]:.4g} N)"
            for at in found[:_NAMED]
        )
        more = f" and {len(found) - _NAMED} more" if len(found) > _NAMED else ""
        yield (
            f"force: {len(found)} of {len(force)} points contradict the others, which pull less at a larger "
            f"contraction or less pressure: point {shown}{more}; check these rows, or leave them out"
        )


def _against_others(contraction: Floats, force: Floats, tolerance: float) -> list[int]:
    """Fewest points at one pressure without which the force falls with the contraction."""
    if not _AGAINST < len(force) <= _MOST:
        return []
    steps = np.abs(np.diff(force[np.argsort(contraction, kind="stable")]))
    tolerance = max(tolerance, _LOOP * float(np.median(steps)))
    against = contraction[:, None] <= contraction + _SAME
    against &= force[:, None] < force - tolerance
    against |= against.T
    counts, found = against.sum(axis=1), []
    while counts.max() >= _AGAINST:
        found.append(int(np.argmax(counts)))
        counts -= against[found[-1]]
        counts[found[-1]] = 0
    return found


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
