"""Whether a fit left a pattern in its residuals: then the law misses something that the muscle does."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mckibben.dataset import IsobaricDataset
from mckibben.units import percent

_FEWEST_PAIRS = 10
_SIGNIFICANT = 2.0  # standard deviations of the correlation of independent residuals
_SAME_CONTRACTION = 0.1 * percent


@dataclass(frozen=True)
class Structure:
    """How alike the residuals of neighbouring points are.

    Attributes
    ----------
    along_contraction, along_pressure
        Correlation of neighbours on the same curve, and of neighbours at the same contraction (to 0.1 %) on
        neighbouring curves: 0 for independent errors, near 1 for a pattern; None for fewer than ten pairs.
    pairs_contraction, pairs_pressure
        How many neighbours there are.
    """

    along_contraction: float | None
    along_pressure: float | None
    pairs_contraction: int
    pairs_pressure: int

    @property
    def pattern(self) -> str:
        r"""In which direction a pattern is left, as text; empty where there is none.

        A correlation counts from twice the standard deviation that it has for independent residuals,
        :math:`1/\sqrt{pairs}`.
        """
        found = [
            name
            for name, correlation, pairs in (
                ("contraction", self.along_contraction, self.pairs_contraction),
                ("pressure", self.along_pressure, self.pairs_pressure),
            )
            if correlation is not None and correlation > _SIGNIFICANT / np.sqrt(pairs)
        ]
        return " and ".join(found)


def beyond_directions(residuals: NDArray[np.float64], points: IsobaricDataset) -> NDArray[np.float64]:
    """Residuals [N] without the mean of each direction (and phase): that is friction, and no fault of a static law."""
    rest = np.array(residuals, float)
    for name in ("direction", "phase"):
        if name in points.table:
            labels = points.table[name].to_numpy()
            for label in filter(None, np.unique(labels).tolist()):
                rest[labels == label] -= np.nanmean(rest[labels == label])
    return rest


def structure_of(points: IsobaricDataset, residuals: NDArray[np.float64]) -> Structure:
    """The structure of residuals [N], shape (points,).

    Examples
    --------
    >>> pressure, contraction = (values.ravel() for values in np.meshgrid(np.arange(1, 7) * 1e5, np.arange(8) / 40))
    >>> points = IsobaricDataset.of(pressure=pressure, contraction=contraction, force=np.ones(48))
    >>> found = structure_of(points, np.cos(20 * contraction))
    >>> round(found.along_contraction, 2), round(found.along_pressure, 2), found.pattern
    (0.9, 1.0, 'contraction and pressure')
    """
    residuals = beyond_directions(residuals, points)
    passes = np.zeros(len(points), np.int64)
    for name in ("direction", "phase", "repeat"):
        if name in points.table:
            codes = np.unique(points.table[name].to_numpy(), return_inverse=True)[1].reshape(-1)
            passes = passes * (int(codes.max()) + 1) + codes
    levels = np.unique(points.levels, return_inverse=True)[1].reshape(-1)
    places = np.round(points.contraction / _SAME_CONTRACTION)
    curve, curve_pairs = _neighbours(residuals, (passes, levels), points.contraction)
    place, place_pairs = _neighbours(residuals, (passes, places), points.levels)
    return Structure(curve, place, curve_pairs, place_pairs)


def _neighbours(
    residuals: NDArray[np.float64], within: tuple[NDArray, NDArray], along: NDArray[np.float64]
) -> tuple[float | None, int]:
    """The correlation of points next to each other along something, within groups; and how many pairs there are."""
    order = np.lexsort((along, within[1], within[0]))
    same = np.ones(len(order) - 1, bool)
    for group in within:
        same &= group[order][1:] == group[order][:-1]
    pairs = int(np.count_nonzero(same))
    if pairs < _FEWEST_PAIRS:
        return None, pairs
    first, second = residuals[order][:-1][same], residuals[order][1:][same]
    scale = float(np.sqrt((first @ first) * (second @ second)))
    return (float(first @ second) / scale if scale > 0 else 0.0), pairs
