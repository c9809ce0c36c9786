"""Where a test turns round, friction is on its way from one side to the other: such points show neither side."""

from __future__ import annotations

import numpy as np

from mckibben.dataset import IsobaricDataset
from mckibben.errors import RangeError
from mckibben.units import mm


def away_from_turns(dataset: IsobaricDataset, *, travel: float = 2 * mm) -> IsobaricDataset:
    """The points of a dataset that lie at least a travel from both ends of their stroke, in both directions.

    Friction adds to the force in one direction and takes from it in the other, so that a law fitted to both runs
    between them. Near a turn that balance is missing: just after it friction still has the sign of before, and where
    those points alone were left out the other direction would stand there alone. So both are left out.

    Parameters
    ----------
    dataset
        Its points need a direction, and its specimen an initial length.
    travel
        How far from the turns the points have to be [m].

    Raises
    ------
    RangeError
        If directions or the initial length are not known, or no point would be left.
    """
    table = dataset.table
    if "direction" not in table or "initial_length" not in table.attrs:
        raise RangeError(
            "turning points are known only where a dataset has directions and an initial length",
            remedy="give both, or keep all points",
        )
    levels, contraction = dataset.levels, dataset.contraction
    repeats = table["repeat"].to_numpy() if "repeat" in table else np.zeros(len(dataset), int)
    margin = travel / table.attrs["initial_length"] - 1e-9
    keep = np.ones(len(dataset), bool)
    for level, repeat in {*zip(levels, repeats, strict=True)}:
        stroke = (levels == level) & (repeats == repeat)
        ends = contraction[stroke].min(), contraction[stroke].max()
        keep[stroke] = (contraction[stroke] - ends[0] >= margin) & (ends[1] - contraction[stroke] >= margin)
    if not keep.any():
        raise RangeError(
            f"no point lies {travel / mm:g} mm from both ends of its stroke, which is all the points of one pressure",
            remedy="give a shorter travel, or the nominal pressures (set_pressure) where measured ones scatter",
        )
    return dataset.select(keep)
