"""The record of a test to its dataset, a chunk at a time."""

from __future__ import annotations

import os
from collections.abc import Sequence

import numpy as np

from mckibben.dataset import IsobaricDataset
from mckibben.errors import DatasetError, Problem
from mckibben.rig.bench import Bench
from mckibben.rig.plateaus import Point, points
from mckibben.rig.record import Event, Rows, passages


def recorded_points(folder: str | os.PathLike[str]) -> list[Point]:
    """The points of a record, in the order of their numbers, each once.

    Raises
    ------
    DatasetError
        As `passages` does.
    """
    return points(one for one in passages(folder) if isinstance(one, Event))


def assemble(folder: str | os.PathLike[str], bench: Bench, *, source: str = "") -> IsobaricDataset:
    """The dataset of a record: one row a point, with its samples.

    It takes the memory of the dataset, and of a chunk. The samples are float32, as they were recorded; where points
    have different numbers of them the dataset has none, and its means are those of all.

    Parameters
    ----------
    folder
        Of the record.
    bench
        Whose calibrations turn volts into forces and pressures.
    source
        What the dataset says of itself.

    Raises
    ------
    DatasetError
        If the record cannot be read, has no points, or rows that a point needs are not there.
    """
    kept = [point for point in recorded_points(folder) if point.keep]
    if not kept:
        raise DatasetError(str(folder), [Problem("holds no point yet", remedy="resume it")])
    counts = {point.samples for point in kept}
    shape = (len(kept), max(counts))
    force, pressure = np.full(shape, np.nan, np.float32), np.full(shape, np.nan, np.float32)
    _fill(folder, kept, {"force": force, "pressure": pressure})
    for name, samples in (("force", force), ("pressure", pressure)):
        _to_si(samples, bench, name)
    there = np.count_nonzero(~np.isnan(force), axis=1)
    if len(missing := np.flatnonzero(there != [point.samples for point in kept])):
        point = kept[missing[0]]
        problem = f"of the {point.samples} samples of point {point.number} {there[missing[0]]} are there"
        raise DatasetError(str(folder), [Problem(problem)])
    same = len(counts) == 1
    mean = np.mean if same else np.nanmean
    means = [mean(samples, axis=1, dtype=np.float64) for samples in (force, pressure)]
    return IsobaricDataset.of(
        pressure=means[1],
        contraction=[point.contraction for point in kept],
        force=means[0],
        direction=_words([point.direction for point in kept]),
        phase=_words([point.phase for point in kept]),
        repeat=[point.repeat for point in kept],
        time=[point.time for point in kept],
        set_pressure=[point.set_pressure for point in kept],
        force_samples=force if same else None,
        pressure_samples=pressure if same else None,
        specimen=bench.specimen.name,
        initial_length=float(bench.specimen.initial_length),
        source=source,
        slack_force=bench.slack_force,
    )


def _fill(folder: str | os.PathLike[str], kept: Sequence[Point], into: dict[str, np.ndarray]) -> None:
    """Copy the samples of each point from the rows of the record."""
    order = sorted(range(len(kept)), key=lambda index: kept[index].first)
    waiting = 0
    for one in passages(folder):
        if not isinstance(one, Rows):
            continue
        end = one.first + len(one.columns["time"])
        for index in order[waiting:]:
            point = kept[index]
            if point.first >= end:
                break
            wanted = range(point.first, point.first + point.rows, point.every)
            # those of the point's samples that are in this chunk
            begin = max(0, -(-(one.first - point.first) // point.every))
            stop = min(point.samples, -(-(end - point.first) // point.every))
            if stop > begin:
                rows = slice(wanted[begin] - one.first, wanted[stop - 1] - one.first + 1, point.every)
                for name, samples in into.items():
                    samples[index, begin:stop] = one.columns[name][rows]
        while waiting < len(order) and kept[order[waiting]].first + kept[order[waiting]].rows <= end:
            waiting += 1


def _to_si(samples: np.ndarray, bench: Bench, name: str) -> None:
    """Volts to newtons or pascals in place, some rows at a time."""
    calibration = bench.calibrations[name]
    for start in range(0, len(samples), 256):
        part = samples[start : start + 256]
        part[:] = calibration.si(part)


def _words(words: list[str]) -> list[str] | None:
    return words if any(words) else None
