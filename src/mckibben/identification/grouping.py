"""Groups of points that may share an error."""

from __future__ import annotations

import enum
from collections.abc import Sequence

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from mckibben.dataset import IsobaricDataset
from mckibben.dataset.preprocessing import held_loads
from mckibben.errors import IdentificationError
from mckibben.identification.estimator import Floats, Ints
from mckibben.muscle import ForceLaw, forces


class Grouping(enum.Enum):
    """Points that may share an error: each by itself, of one pass, or of one pressure level.

    A pass has one level, repeat and direction or phase, as far as recorded (docs/uncertainty.md).
    """

    POINT = "point"
    STROKE = "stroke"
    PRESSURE = "pressure"

    def counted(self, count: int) -> str:
        """Number of groups as text, such as "1 stroke" or "26 strokes"."""
        return f"{count} {self.value}{'' if count == 1 else 's'}"


RESOLUTION = 1e-3
"""Distance of contractions [-] that count as one."""


def held_values(points: IsobaricDataset) -> Floats:
    """Value that was held along the path of each point, shape (points,): the load [N], or else the pressure [Pa]."""
    loads = held_loads(points.table)
    return points.levels if loads is None else loads


def with_loads(points: IsobaricDataset) -> IsobaricDataset:
    """Points with the loads that were held as set forces: without friction, their forces are no levels."""
    loads = held_loads(points.table)
    return points if loads is None else IsobaricDataset(points.table.assign(set_force=("point", loads)))


def at_fixed_lengths(points: IsobaricDataset) -> bool:
    """Whether most points were filled or vented at a fixed length."""
    phases = points.table["phase"].to_numpy() if "phase" in points.table else np.empty(0, "<U9")
    return bool(2 * np.count_nonzero(phases != "") > len(points))


def holds(points: IsobaricDataset, order: Ints) -> Ints:
    """Number of the fixed length of each row in the order of the test, shape (points,).

    Points without a phase are the first of a length, if there are such: at others the frame yields to the force.
    """
    moved = np.abs(np.diff(points.contraction[order], prepend=points.contraction[order[:1]])) > RESOLUTION
    stepped = points.table["phase"].to_numpy()[order] != ""
    moved &= ~stepped | stepped.all()
    return np.cumsum(moved, dtype=np.int64)[np.argsort(order)]


def neighbours_apart(errors: Floats, points: IsobaricDataset) -> float:
    """RMS part of errors [N] that neighbours on a path do not share: noise, as the misfit of a law is continuous.

    A path is at one pressure or load or, where most points were filled or vented at a fixed length, at a contraction.
    J. von Neumann, Annals of Mathematical Statistics 12 (1941) 367.
    """
    held, place = held_values(points), points.contraction
    if at_fixed_lengths(points):
        held, place = np.round(place / RESOLUTION), points.levels
    order = np.lexsort((place, held))
    steps = np.diff(errors[order])[np.diff(held[order]) == 0]
    return float(np.sqrt(np.mean(steps**2) / 2)) if len(steps) else 0.0


def measured_weights(
    law: ForceLaw,
    points: IsobaricDataset,
    *,
    friction_slope: float | Floats = 0.0,
    scaled: bool = True,
    step: float = 1e-6,
) -> Floats:
    """Weights of residuals of the force [N] by which they are those of the measured quantity.

    They are `scaled` to a mean square of 1. Where the load is held, that is the contraction: its error times the slope
    of the law, by differences over a `step`, and of the friction [N] is that of the force. Else all are 1. Raises
    `IdentificationError` if the slope is 0 at a point.
    """
    if held_loads(points.table) is None:
        return np.ones(len(points))
    left, right = (forces(law, points.contraction + side, points.pressure) for side in (-step, step))
    slopes = np.abs(right - left) / (2 * step) + friction_slope
    if not np.all(slopes > 0):
        message = f"the force of {type(law).__name__} has no slope over the contraction at some of the points"
        raise IdentificationError(message, remedy="use another law")
    weights = 1 / slopes
    return weights / np.sqrt(np.mean(weights**2)) if scaled else weights


def group_labels(points: IsobaricDataset, grouping: Grouping) -> Ints:
    """Group number of each point, from 0 without gaps, shape (points,)."""
    if grouping is Grouping.POINT:
        return np.arange(len(points))
    columns: list[np.ndarray] = [held_values(points)]
    if grouping is Grouping.STROKE:
        columns += [points.table["repeat"].to_numpy()] if "repeat" in points.table else []
        columns.append(approach_labels(points))
    return row_numbers(columns)


def approach_labels(points: IsobaricDataset) -> NDArray[np.str_]:
    """Direction, or else phase, of each point's pass; an unlabelled point takes the next label of its level."""
    direction, phase = (
        points.table[name].to_numpy() if name in points.table else np.full(len(points), "", "<U9")
        for name in ("direction", "phase")
    )
    repeat = [points.table["repeat"].to_numpy()] if "repeat" in points.table else []
    cells = row_numbers([held_values(points), *repeat])
    has_direction = np.bincount(cells, direction != "") > 0
    own = pd.Series(np.where(has_direction[cells], direction, phase), dtype=object)
    following = own.mask(own == "").groupby(cells).bfill()
    return following.groupby(cells).ffill().fillna("").to_numpy(dtype="<U9")


def finest_grouping(points: IsobaricDataset) -> Grouping:
    """Strokes where a direction, a phase or a repeat is known, else pressures."""
    has_passes = bool(len(points.directions) or len(points.phases) or len(points.repeats))
    return Grouping.STROKE if has_passes else Grouping.PRESSURE


def row_numbers(columns: Sequence[np.ndarray]) -> Ints:
    """Number of each row among the sorted distinct rows."""
    numbers = pd.DataFrame(dict(enumerate(columns))).groupby([*range(len(columns))]).ngroup()
    return np.asarray(numbers, np.int64)
