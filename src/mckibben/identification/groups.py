"""Which points may have errors in common: those of a stroke, of a pressure, of a repeat, or none."""

from __future__ import annotations

import enum
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mckibben.dataset import IsobaricDataset
from mckibben.errors import IdentificationError


class Grouping(enum.Enum):
    """Points within a group may share an error; groups are independent of each other.

    Attributes
    ----------
    POINT
        Every plateau mean is its own group: the errors are independent, as the classical formula has it.
    STROKE
        The points of one pass at one pressure: same level, repeat and way (see `ways`), as far as these are recorded.
        What the zero of a force sensor, creep, or friction adds to a whole pass is then one error and not many.
    PRESSURE
        All points of a pressure level: as well what the passes at a level have in common, such as how the law misses
        the muscle there.
    REPEAT
        All points of one repeat of the whole test.
    """

    POINT = "point"
    STROKE = "stroke"
    PRESSURE = "pressure"
    REPEAT = "repeat"

    def counted(self, count: int) -> str:
        """Such as "1 stroke" or "26 strokes"."""
        return f"{count} {self.value}{'' if count == 1 else 's'}"


def group_labels(points: IsobaricDataset, grouping: Grouping) -> NDArray[np.int64]:
    """The number of each point's group, from 0 without gaps, shape (points,).

    Raises
    ------
    IdentificationError
        If the repeats are asked for and not recorded.

    Examples
    --------
    >>> points = IsobaricDataset.of(
    ...     pressure=[1e5, 1e5, 2e5, 2e5],
    ...     contraction=[0, 0.1, 0, 0.1],
    ...     force=[80, 40, 170, 90],
    ...     direction=["loading", "unloading", "loading", "loading"],
    ... )
    >>> group_labels(points, Grouping.STROKE), group_labels(points, Grouping.PRESSURE)
    (array([0, 1, 2, 2]), array([0, 0, 1, 1]))
    """
    if grouping is Grouping.POINT:
        return np.arange(len(points))
    columns: list[np.ndarray] = []
    if grouping in (Grouping.STROKE, Grouping.PRESSURE):
        columns.append(points.levels)
    if grouping in (Grouping.STROKE, Grouping.REPEAT) and "repeat" in points.table:
        columns.append(points.table["repeat"].to_numpy())
    if grouping is Grouping.STROKE:
        columns.append(ways(points))
    if not columns:
        raise IdentificationError(
            "the data do not say which repeat a point belongs to",
            remedy="record a column 'repeat', or group by stroke or by pressure",
        )
    return _numbered(columns)


def ways(points: IsobaricDataset) -> NDArray[np.str_]:
    """Which way each point was reached, shape (points,): what tells the passes at a level apart.

    That is its direction, or its phase where no direction is known at its level and repeat; empty where neither is.
    A point whose own is not known, as that at which a stroke begins after the muscle was filled, goes with the next
    point of its level and repeat that has one, or with the last: it is no pass of its own.

    Examples
    --------
    >>> points = IsobaricDataset.of(
    ...     pressure=[1e5, 1e5, 1e5, 2e5, 2e5],
    ...     contraction=[0, 0.1, 0, 0.1, 0.1],
    ...     force=[80, 40, 84, 90, 80],
    ...     direction=["", "unloading", "loading", "", ""],
    ...     phase=["filling", "", "", "filling", "venting"],
    ... )
    >>> ways(points).tolist()
    ['unloading', 'unloading', 'loading', 'filling', 'venting']
    """
    direction, phase = (
        points.table[name].to_numpy() if name in points.table else np.full(len(points), "", "<U9")
        for name in ("direction", "phase")
    )
    repeat = [points.table["repeat"].to_numpy()] if "repeat" in points.table else []
    cells = _numbered([points.levels, *repeat])
    has_direction = np.bincount(cells, direction != "") > 0
    order = np.argsort(cells, kind="stable")
    own, cell = np.where(has_direction[cells], direction, phase)[order], cells[order]
    place = np.arange(len(own))
    following = np.minimum.accumulate(np.where(own != "", place, len(own) - 1)[::-1])[::-1]
    preceding = np.maximum.accumulate(np.where(own != "", place, 0))
    source = np.where(cell[following] == cell, following, place)
    source = np.where(own[source] == "", preceding, source)
    found = np.empty_like(own)
    found[order] = np.where(cell[source] == cell, own[source], "")
    return found


def finest_recorded(points: IsobaricDataset) -> Grouping:
    """Strokes where a direction, a phase or a repeat is known, else pressures."""
    told_apart = bool(len(points.directions) or len(points.phases) or len(points.repeats))
    return Grouping.STROKE if told_apart else Grouping.PRESSURE


def _numbered(columns: Sequence[np.ndarray]) -> NDArray[np.int64]:
    """The number of each row among the distinct rows."""
    number = np.zeros(len(columns[0]), np.int64)
    for column in columns:  # one after the other, so that numbers of rows are sorted and not rows
        codes = np.unique(column, return_inverse=True)[1].reshape(-1)
        number = np.unique(number * (int(codes.max(initial=0)) + 1) + codes, return_inverse=True)[1].reshape(-1)
    return number
