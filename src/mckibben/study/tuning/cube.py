"""Numbers within ranges as points of the unit cube, one axis a number: 0 and 1 are the ends of its range."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mckibben.study.parameters import Over
from mckibben.units import quantity

Numbers = NDArray[np.float64]

_DIGITS = 6  # of numbers that are written down
_AT_BOUND = 0.01  # of the range


def values_at(over: Sequence[Over], points: Numbers) -> Numbers:
    """The numbers [SI] at points, both of shape (n, numbers)."""
    return np.stack([each.spread.at(points[:, i]) for i, each in enumerate(over)], axis=1)


def point_of(over: Sequence[Over], values: Numbers) -> Numbers:
    """The point of numbers [SI] of shape (numbers,), moved into the ranges."""
    return np.array([float(each.spread.quantile(value)) for each, value in zip(over, values, strict=True)])


def nominal_of(over: Sequence[Over], nominal: Sequence[float | int | None]) -> Numbers:
    """Numbers [SI] as they stand in a file; where one does not, the middle of its range."""
    middle = values_at(over, np.full((1, len(over)), 0.5))[0]
    return np.array([m if n is None else float(n) for n, m in zip(nominal, middle, strict=True)])


def as_written(over: Sequence[Over], values: Numbers) -> Numbers:
    """Numbers [SI] with as many digits as are written down, in the unit in which they are, within the ranges."""
    written = [
        round(value) if each.address.whole else quantity(each.address.show(value, _DIGITS), each.address.unit)
        for each, value in zip(over, values, strict=True)
    ]
    return np.array(written).clip(*np.array([each.spread.ends for each in over]).T)


def at_bound(over: Sequence[Over], point: Sequence[float] | Numbers) -> tuple[str, ...]:
    """The names of numbers within 1 % of an end of their range."""
    return tuple(each.name for each, at in zip(over, point, strict=True) if min(at, 1 - at) < _AT_BOUND)
