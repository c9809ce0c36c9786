"""Consistency of measured points: rows, levels and labels that contradict the others."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from mckibben.dataset.isobaric import IsobaricDataset
from mckibben.units import bar

Floats = NDArray[np.float64]

_OFF_SET = 0.2  # of the highest pressure: a set pressure that is not the measured one


def contradictions(dataset: IsobaricDataset) -> Iterator[str]:
    """Warnings about points that contradict each other."""
    if len(dataset) and dataset.force.max() > 0 and dataset.pressure.max() > 0:
        yield from _set_pressures(dataset)


def _set_pressures(dataset: IsobaricDataset) -> Iterator[str]:
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
