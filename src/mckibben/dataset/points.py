"""Points extracted from a recording, saturated samples, and counts of all samples by use."""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mckibben.component.calls import user_level
from mckibben.dataset.checks import questions_of
from mckibben.dataset.faults import LOST, RecordedSignals, changes_at_once, places
from mckibben.dataset.isobaric import IsobaricDataset
from mckibben.dataset.preprocessing import held_loads, with_notes, with_passes, without_offset
from mckibben.dataset.schema import OF_FILE, WORDS
from mckibben.dataset.segmentation import alternation, runs
from mckibben.dataset.table import open_problems
from mckibben.errors import DatasetError, McKibbenWarning
from mckibben.result import Remark, Result, column
from mckibben.units import show

if TYPE_CHECKING:
    import xarray as xr

    from mckibben.dataset.recipe import Recipe

_AT_REST = "the force jumps at constant pressure and length"
_LEVELS = "saturation", "pressure"  # the highest repeats where it is held
_SCATTER = 0.1  # of the largest force, as by friction
_LEAST = 10  # samples in a row
_LONGER = 10  # times the usual value in the channel
_JITTER = 0.25  # share of second differences that change sign: 0.73 in white noise
_ROUNDING = 1e-9  # of the range
_SHARE = 0.2  # of the samples of a stretch, at a detected end


def saturated_samples(values: NDArray[np.float64]) -> dict[str, NDArray[np.bool_]]:
    """Samples at the ends of a channel's range.

    Parameters
    ----------
    values
        Shape (samples,). Only a noisy channel has ends: a simulated one may stand still.

    Returns
    -------
    dict
        Masks of shape (samples,), "floor" and "ceiling": runs of at least ten extremes, ten times the usual length,
        and samples with a fifth of such neighbours.

    Examples
    --------
    >>> noise = np.random.default_rng(0).normal(size=400)
    >>> masks = saturated_samples(np.append(noise, np.full(50, 4.0)))
    >>> [(end, bool(mask[400:].all())) for end, mask in masks.items()]
    [('ceiling', True)]
    """
    from scipy.ndimage import uniform_filter1d  # 50 ms, of recordings alone

    if len(values) < _LEAST:
        return {}
    starts, lengths = runs(values)
    heights = values[starts]
    masks: dict[str, NDArray[np.bool_]] = {}
    low, high = heights.min(), heights.max()
    inside = (heights != low) & (heights != high)
    bend = np.diff(heights[inside], 2)
    bend[np.abs(bend) <= _ROUNDING * np.ptp(heights)] = 0
    if alternation(bend) <= _JITTER:
        return {}
    usual = np.median(np.repeat(lengths[inside], lengths[inside]))  # of the samples
    for end, value in (("floor", low), ("ceiling", high)):
        longest = int(lengths[heights == value].max())
        if longest >= max(_LEAST, _LONGER * usual):
            masks[end] = at_end = values == value
            share = uniform_filter1d(at_end.astype(np.float64), 2 * _LEAST + 1, mode="constant")
            masks[end] = at_end | (share >= _SHARE)
    return masks


class ExtractedPoints(Result):
    """Points extracted from a recording (for `identify`), with an account of all samples.

    Attributes
    ----------
    time, pressure, contraction, force, force_spread
        Mean of each point, shape (points,): [s], gauge [Pa], [-], [N], and standard deviation of the force [N].
    samples
        Number of samples of each point, shape (points,).
    approach
        Direction of the last motion before each point, or filling or venting where the length did not change.
    dataset
        The points as they are fitted.
    counts
        Number of samples by use or reason for exclusion; they sum to the length of the recording.
    notes
        Gaps, sensor saturation, the zero of the load cell, and what no muscle does.
    recipe
        How the recording was read, written to recipe.yaml.
    """

    figures: ClassVar = ("points",)
    files: ClassVar = ("points.csv", "points.nc", "recipe.yaml")

    time: NDArray[np.float64] = column("s", "time", digits=5)
    pressure: NDArray[np.float64] = column("Pa", "pressure", "bar", digits=5)
    contraction: NDArray[np.float64] = column("1", "contraction", "percent")
    force: NDArray[np.float64] = column("N", "force", digits=5)
    force_spread: NDArray[np.float64] = column("N", "spread", digits=2)
    samples: NDArray[np.int64] = column("", "samples")
    approach: list[str] = column("", "direction")
    dataset: IsobaricDataset
    counts: Mapping[str, int]
    notes: tuple[str, ...]
    recipe: Recipe | None = None

    def verdict(self) -> str:
        """Return the numbers of points and samples."""
        return f"{len(self.samples)} points from {format_counts(self.counts)}"

    def remarks(self) -> Iterable[Remark]:
        """Return the notes."""
        return [Remark.warning("samples", note) for note in self.notes]

    def write(self, folder: Path) -> None:
        """Write the points as CSV and, with spread and attributes, as NetCDF; and the recipe."""
        self.dataset.to_csv(folder / "points.csv")
        self.dataset.to_netcdf(folder / "points.nc")
        if self.recipe is not None:
            self.recipe.to_yaml(folder / "recipe.yaml")


def extracted_points(
    table: xr.Dataset,
    account: SampleAccount,
    samples: NDArray[np.int64],
    accept: Sequence[str] = (),
    **columns: ArrayLike | None,
) -> ExtractedPoints:
    """Points of a recording's table.

    The offset of the load cell is subtracted, unless the slack force is known.

    Parameters
    ----------
    samples
        Shape (points,): number of samples of each point.
    accept
        Topics of questions that are answered with yes.
    columns
        Columns of the dataset and ``force_spread``, each of shape (points,).

    Raises
    ------
    DatasetError
        With the questions that remain.
    """
    spread = np.asarray(columns.pop("force_spread"), np.float64)
    attrs = {name: value for name, value in table.attrs.items() if name not in (*OF_FILE, "preprocessing")}
    points = IsobaricDataset.of(**columns, **attrs).table  # type: ignore[arg-type]
    points = points.assign(force_spread=("point", spread)).assign_attrs(table.attrs)
    notes = [*account.notes, *account.lost]
    for text in account.lost:
        warnings.warn(text, McKibbenWarning, stacklevel=user_level())
    if not points.attrs["slack_force"]:
        points, more = without_offset(points)
        points, notes = with_notes(points, more), notes + more
    if held_loads(points) is not None:  # then the direction is that of the contraction, whatever moved last
        points = points.drop_vars(["direction", "phase"], errors="ignore")
        points, more = with_passes(points, np.zeros(len(spread), np.int64))
        points, notes = with_notes(points, more), notes + more
    dataset = IsobaricDataset(points)
    asked = []
    for query in questions_of(dataset, np.arange(len(dataset)), scatter=_SCATTER):
        at = "" if query.problem.line is None else f", at {points['time'].to_numpy()[query.problem.line]:.6g} s"
        asked.append(query._replace(problem=replace(query.problem, message=query.problem.message + at, line=None)))
    asked = [query for query in asked if query.topic != "rows" and (query.topic, query.problem.field) != _LEVELS]
    if problems := open_problems(asked, accept) if len(dataset) else []:
        raise DatasetError(dataset.table.attrs["source"] or "recording", problems)
    notes += [query.problem.message for query in asked]
    words = [points[name].to_numpy() if name in points else np.full(len(dataset), "") for name in WORDS]
    return ExtractedPoints(
        points["time"].to_numpy(),
        dataset.pressure,
        dataset.contraction,
        dataset.force,
        spread,
        samples,
        [str(direction or phase or "-") for direction, phase in zip(*words, strict=True)],
        dataset,
        account.counts(),
        tuple(notes),
    )


class SampleAccount:
    """Use of each sample, or reason for its exclusion; the first reason counts.

    Gaps and steps back of the clock, and samples at the ends of the pressure's and force's ranges, are found at once.

    Attributes
    ----------
    of
        Shape (samples,): index in `reasons`, or -1.
    broken, back
        Shape (samples,): samples after a gap; and indices of those at which the clock was set back.
    interval
        Usual sampling interval [s].
    signals
        Signals, with their faults.
    notes, lost
        Findings, and samples lost to faults, as text.
    """

    def __init__(self, table: xr.Dataset) -> None:
        self.table, self.time = table, table["time"].to_numpy()
        self.reasons: list[str] = ["used"]
        self.of = np.full(table.sizes["sample"], -1, np.int8)
        self.notes: list[str] = []
        self.lost: list[str] = []
        self.signals = RecordedSignals(table)
        self.interval, self.broken = self.signals.interval, self._breaks()
        for name in ("pressure", "force"):
            self._ends(name)
        for name, parts in self.signals.stuck.items():
            self.lose(parts, f"the {name} is stuck")

    def assign_reason(self, where: NDArray[np.bool_] | NDArray[np.int64] | slice, reason: str) -> None:
        """Assign a reason to samples that do not have one yet."""
        if reason not in self.reasons:
            self.reasons.append(reason)
        part = self.of[where]
        self.of[where] = np.where(part < 0, self.reasons.index(reason), part)

    def ask(self, accept: Sequence[str]) -> None:
        """Raise a `DatasetError` with the questions about signals that no topic of `accept` answers."""
        asked = self.signals.questions()
        if problems := open_problems(asked, accept):
            raise DatasetError(self.table.attrs["source"] or "recording", problems)
        self.notes += [query.problem.message for query in asked]

    def lose(self, parts: Sequence[slice], reason: str) -> None:
        """Leave out samples of a fault, with a note that is also a warning."""
        if parts := [part for part in parts if (self.of[part] < 0).any()]:
            for part in parts:
                self.assign_reason(part, reason)
            self.lost.append(f"{LOST}, as {reason}: {places(self.time, parts)}")

    def sound(self, first: NDArray[np.int64], last: NDArray[np.int64], edge: int, most: float) -> NDArray[np.bool_]:
        """Mask of plateaus without a fault; the samples of others are left out.

        Parameters
        ----------
        first, last
            Shape (plateaus,): first and one past the last sample.
        edge
            Samples at either end that are not used.
        most
            Change of the force that pressure and length within their tolerances explain [N].
        """
        force, spans = self.signals.values["force"], [*map(slice, first, last)]
        back = np.any((self.back > first[:, None] - 3 * edge) & (self.back < last[:, None] + 3 * edge), axis=1)
        parts = (force[span.start + edge : span.stop - edge] for span in spans)
        moved = np.array([changes_at_once(part, self.signals.size, most) for part in parts], bool)
        self.lose([span for span, lost in zip(spans, back, strict=True) if lost], "the clock went back")
        self.lose([span for span, lost in zip(spans, moved & ~back, strict=True) if lost], _AT_REST)
        return ~(back | moved)

    def counts(self) -> dict[str, int]:
        """Number of samples by reason; samples without one are not steady."""
        self.assign_reason(self.of < 0, "not steady")
        sizes = np.bincount(self.of, minlength=len(self.reasons))
        return {reason: int(n) for reason, n in zip(self.reasons, sizes, strict=True) if n or reason == "used"}

    def _breaks(self) -> NDArray[np.bool_]:
        """Samples after a gap or a backward clock step."""
        time, steps, broken = self.time, np.diff(self.time), np.zeros(len(self.time), bool)
        self.back = np.flatnonzero(steps < 0) + 1
        for what, where in (("gap", self.signals.gaps), ("clock went back", steps < 0)):
            if where.any():
                spans = [slice(at, at + 2) for at in np.flatnonzero(where)]
                self.notes.append(f"{what}: {places(time, spans)}; segments end there")
                broken[1:] |= where
        if still := int(np.count_nonzero(steps == 0)):
            self.notes.append(f"{still} of {len(time)} samples have the time of the one before: durations are inexact")
        return broken

    def _ends(self, name: str) -> None:
        """Leave out saturated samples."""
        values = self.table[name].to_numpy()
        for end, where in saturated_samples(values).items():
            value = values.min() if end == "floor" else values.max()
            unit = "bar" if name == "pressure" else "N"
            saturated = f"{name} is saturated at {show(float(value), unit)}, the {end} of its channel"
            self.notes.append(f"{saturated}: {int(where.sum())} samples are left out")
            self.assign_reason(where, f"at the {end} of {name}")


def format_counts(counts: Mapping[str, int]) -> str:
    """Counts as text."""
    return f"{sum(counts.values())} samples: {', '.join(f'{count} {reason}' for reason, count in counts.items())}"
