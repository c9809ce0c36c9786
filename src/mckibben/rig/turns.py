"""Where a test turns round, friction is on its way from one side to the other: such points show neither side."""

from __future__ import annotations

import numpy as np

from mckibben.dataset import IsobaricDataset
from mckibben.errors import RangeError
from mckibben.units import mm


def away_from_turns(dataset: IsobaricDataset, *, travel: float = 2 * mm) -> IsobaricDataset:
    """The points of a dataset that lie at least a travel beyond the start of their stroke.

    Parameters
    ----------
    dataset
        Its points need a direction, and its specimen an initial length.
    travel
        How far the muscle has to have moved since it turned [m].

    Raises
    ------
    RangeError
        If directions or the initial length are not known.
    """
    table = dataset.table
    if "direction" not in table or "initial_length" not in table.attrs:
        raise RangeError(
            "turning points are known only where a dataset has directions and an initial length",
            remedy="give both, or keep all points",
        )
    levels, contraction = dataset.levels, dataset.contraction
    directions = table["direction"].to_numpy()
    repeats = table["repeat"].to_numpy() if "repeat" in table else np.zeros(len(dataset), int)
    keep = np.ones(len(dataset), bool)
    for level, repeat, direction in {*zip(levels, repeats, directions, strict=True)}:
        stroke = (levels == level) & (repeats == repeat) & (directions == direction)
        start = contraction[stroke].max() if direction == "loading" else contraction[stroke].min()
        keep[stroke] = np.abs(contraction[stroke] - start) * table.attrs["initial_length"] >= travel - 1e-9
    return dataset.select(keep)
