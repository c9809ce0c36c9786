"""Which points may have errors in common: those of a stroke, of a pressure, of a repeat, or none."""

from __future__ import annotations

import enum

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
        The points of one pass at one pressure: same level, direction and repeat, as far as these are recorded. What the
        zero of a force sensor, creep, or friction adds to a whole pass is then one error and not many.
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
    if grouping is Grouping.STROKE and "direction" in points.table:
        columns.append(points.table["direction"].to_numpy())
    if grouping in (Grouping.STROKE, Grouping.REPEAT) and "repeat" in points.table:
        columns.append(points.table["repeat"].to_numpy())
    if not columns:
        raise IdentificationError(
            "the data do not say which repeat a point belongs to",
            remedy="record a column 'repeat', or group by stroke or by pressure",
        )
    codes = np.stack([np.unique(column, return_inverse=True)[1].reshape(-1) for column in columns], axis=1)
    return np.unique(codes, axis=0, return_inverse=True)[1].reshape(-1)


def finest_recorded(points: IsobaricDataset) -> Grouping:
    """Strokes where a direction or repeat is recorded, else pressures."""
    told_apart = "direction" in points.table or "repeat" in points.table
    return Grouping.STROKE if told_apart else Grouping.PRESSURE
