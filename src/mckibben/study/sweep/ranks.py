"""Quantiles and rank correlations of columns of any length, exact and in bounded memory."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from tempfile import SpooledTemporaryFile
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]
Pieces = Callable[[], Iterator[Floats]]
"""A column in pieces, from its start at each call."""

_BUCKET = 1 << 20  # values that are sorted at once
_MOST_BUCKETS = 50  # of each kind: their files are open together, and systems allow 256
_SAMPLE = 1 << 16  # values that determine the bounds
_IN_MEMORY = 1 << 18  # bytes of a bucket that is not written to the disk
_PIECE = 1 << 16  # ranks that are looked up at once


class RankedColumn:
    """Values without NaN, distributed by size over temporary files that are small enough to be sorted."""

    # Values that equal one of the `_bounds` between the buckets are only counted, so that repeated ones fill no bucket:
    # the buckets 1, 3, ... are those of equal values.

    def __init__(self, pieces: Pieces, most: int) -> None:
        """Read a column of at most so many values."""
        self._pieces, self.count = pieces, 0
        sampled, chance = [np.empty(0)], np.random.default_rng(0)  # every k-th Sobol point is not a random sample
        for piece in pieces():
            self.count += len(piece)
            size = min(len(piece), -(-len(piece) * _SAMPLE // max(most, 1)))
            sampled.append(piece[chance.integers(0, max(len(piece), 1), size)])
        sample = np.sort(np.concatenate(sampled))
        buckets = min(_MOST_BUCKETS, -(-self.count // _BUCKET))
        self._bounds = np.unique(sample[np.arange(1, buckets) * len(sample) // max(buckets, 1)])
        self._sizes = np.zeros(2 * len(self._bounds) + 1, np.int64)
        self._values = [_file() for _ in self._sizes[::2]]
        for piece in pieces():
            numbers = self._numbers(piece)
            self._sizes += np.bincount(numbers, minlength=len(self._sizes))
            for number in np.unique(numbers[numbers % 2 == 0]):
                self._values[number // 2].write(piece[numbers == number].tobytes())
        self._below = self._sizes.cumsum() - self._sizes
        self._ranks: list[Any] = []

    def _numbers(self, values: Floats) -> NDArray[np.int64]:
        """Bucket of each value."""
        return np.searchsorted(self._bounds, values, "left") + np.searchsorted(self._bounds, values, "right")

    def quantile(self, share: float) -> float:
        """Quantile with linear interpolation, as that of `numpy.quantile`."""
        place = share * (self.count - 1)
        low = math.floor(place)
        one, other = self._at(low), self._at(min(low + 1, self.count - 1))
        part = place - low
        return other - (other - one) * (1 - part) if part >= 0.5 else one + (other - one) * part

    def _at(self, place: int) -> float:
        """The value at a place, from 0, of the sorted column."""
        number = int(np.searchsorted(self._below, place, "right")) - 1
        if number % 2:
            return float(self._bounds[number // 2])
        place -= self._below[number]
        return float(np.partition(_content(self._values[number // 2]), place)[place])

    def ranks(self) -> Iterator[Floats]:
        """Ranks less their mean, in the pieces of the column; equal values have their mean rank."""
        if not self._ranks:
            for number in range(0, len(self._sizes), 2):
                values = _content(self._values[number // 2])
                order = np.argsort(values)
                ordered, found = values[order], np.empty(len(values))
                for start in range(0, len(values), _PIECE):
                    piece = ordered[start : start + _PIECE]
                    ends = np.searchsorted(ordered, piece, "left") + np.searchsorted(ordered, piece, "right")
                    found[order[start : start + _PIECE]] = self._below[number] + (ends - self.count) / 2
                self._ranks.append(_file())
                self._ranks[-1].write(found.tobytes())
        for file in self._ranks:
            file.seek(0)
        for piece in self._pieces():
            numbers = self._numbers(piece)
            found = self._below[numbers] + (self._sizes[numbers] - self.count) / 2
            for number in np.unique(numbers[numbers % 2 == 0]):
                here = numbers == number
                found[here] = np.frombuffer(self._ranks[number // 2].read(8 * np.count_nonzero(here)))
            yield found


def rank_correlation(one: RankedColumn, other: RankedColumn) -> float:
    """Spearman's rank correlation of two columns of the same runs, with mean ranks for ties; NaN if one is constant."""
    products = np.zeros(3)
    for x, y in zip(one.ranks(), other.ranks(), strict=True):
        products += np.sum(x**2), np.sum(y**2), np.sum(x * y)
    size = np.sqrt(products[0] * products[1])
    return float(products[2] / size) if size > 0 else math.nan


def spearman(x: ArrayLike, y: ArrayLike) -> float:
    """Spearman's rank correlation of two columns, with mean ranks for ties; NaN if one is constant or has NaN."""
    columns = [np.asarray(values, float) for values in (x, y)]
    if any(np.isnan(column).any() for column in columns):
        return math.nan
    return rank_correlation(*(RankedColumn(lambda column=column: iter([column]), len(column)) for column in columns))


def _file() -> Any:
    return SpooledTemporaryFile(_IN_MEMORY)


def _content(file: Any) -> Floats:
    file.seek(0)
    return np.frombuffer(file.read())
