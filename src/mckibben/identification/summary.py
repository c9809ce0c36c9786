"""Points of a fit: their summary, domain and outliers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from mckibben.dataset import IsobaricDataset
from mckibben.errors import printable
from mckibben.identification.estimator import Floats
from mckibben.muscle import Domain
from mckibben.result import Remark
from mckibben.units import percent, show

CONTRACTION_NOISE = 0.1 * percent
"""Error of a contraction [-] that counts as measurement noise."""


@dataclass(frozen=True)
class LeaveOnePressureOut:
    """Leave-one-pressure-out cross-validation: each pressure is predicted by the fit to all others.

    Errors [N] over all points, and RMSE [N] by pressure [Pa].
    """

    rmse: float
    max_error: float
    by_pressure: Mapping[float, float] = field(repr=False)

    def misfit(self, pressure: ArrayLike, *, edge_freedom: float = 5.0) -> tuple[Floats, Floats]:
        """Mean square error of the law [N^2] to be expected at pressures [Pa], and its degrees of freedom.

        Between the pressures it is that of the inner ones, each left out. Beyond the lowest or the highest one it is at
        least the error there, when that pressure was left out and thus predicted from its neighbour, in proportion to
        the distance from the data. One block says little about another: with `edge_freedom` degrees of freedom, 95 % of
        the blocks beyond the data are covered in the sets of the catalog (docs/results/intervals.md).

        Examples
        --------
        2 N in between, 3 N at 1 bar as predicted from 2 bar; at 0 bar, twice as far from the data as at 0.5 bar:

        >>> left_out = LeaveOnePressureOut(2.5, 4.0, {1e5: 3.0, 2e5: 2.0, 3e5: 2.0, 4e5: 2.5})
        >>> left_out.misfit([2.5e5, 0.5e5, 0.0])
        (array([4., 4., 9.]), array([inf, inf,  5.]))
        """
        pressure, levels = np.asarray(pressure, float), sorted(self.by_pressure)
        squares = np.array([self.by_pressure[level] ** 2 for level in levels])
        below = (levels[0] - pressure) / (levels[1] - levels[0])
        above = (pressure - levels[-1]) / (levels[-1] - levels[-2])
        inner = squares[1:-1].mean() if len(levels) > 2 else squares.mean()
        beyond = np.maximum(below, 0) ** 2 * squares[0] + np.maximum(above, 0) ** 2 * squares[-1]
        return np.maximum(inner, beyond), np.where(beyond > inner, edge_freedom, np.inf)


@dataclass(frozen=True)
class DatasetSummary:
    """Dataset of a fit: its attributes, and the ascending levels [Pa] of the points used."""

    specimen: str
    source: str
    pressures: tuple[float, ...]

    @classmethod
    def of(cls, points: IsobaricDataset) -> DatasetSummary:
        """Summary of the points used."""
        attrs = points.table.attrs
        return cls(printable(str(attrs["specimen"])), printable(str(attrs["source"])), tuple(points.pressures.tolist()))


@dataclass(frozen=True)
class Outlier:
    """Point that an identification leaves out.

    Attributes
    ----------
    row
        Number of the point in the dataset, from 1; of the plateaus, if it has samples.
    pressure, contraction, force
        Measured pressure [Pa], contraction [-] and force [N].
    expected
        Force [N] from the surface through all other points.
    place
        Its line in the file from which it was read, as text; its row in a dataset of arrays.
    """

    row: int
    pressure: float
    contraction: float
    force: float
    expected: float
    place: str = ""

    def __str__(self) -> str:
        where = f"{show(self.pressure, 'bar', 4)} and {self.contraction / percent:.4g} %"
        place = self.place or f"row {self.row}"
        return f"{place}: {show(self.force, 'N', 4)} at {where}, where {show(self.expected, 'N', 4)} is expected"


KEEP_OUTLIERS = "to keep such points, give robust=False (command line: --keep-outliers)"


def left_out(outliers: Sequence[Outlier]) -> list[Remark]:
    """Remarks on points that an identification leaves out: the first, and the places of the others."""
    text = "left out: off the smooth surface through the other points; check it"
    remarks = [Remark.warning("force", f"{text}: {outlier}", KEEP_OUTLIERS) for outlier in outliers[:1]]
    if others := [outlier.place or f"row {outlier.row}" for outlier in outliers[1:]]:
        remarks.append(Remark.warning("force", f"left out, off that surface too: {', '.join(others)}"))
    return remarks


def domain_of(points: IsobaricDataset) -> Domain:
    """Range of contractions and pressure levels of the points; measured pressures replace levels that they miss."""
    contraction, pressure = points.contraction, points.pressure if off_levels(points) else points.levels
    return Domain(float(contraction.min()), float(contraction.max()), float(pressure.min()), float(pressure.max()))


def off_levels(points: IsobaricDataset, *, small: float = 0.05) -> float:
    """Largest distance [Pa] of a measured pressure from its level; 0 up to a `small` share of the range of levels."""
    farthest = float(np.abs(points.levels - points.pressure).max())
    return farthest if farthest > small * float(np.ptp(points.levels)) else 0.0
