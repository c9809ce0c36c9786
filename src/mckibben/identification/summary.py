"""Points of a fit: their summary, domain and outliers."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from mckibben.dataset import IsobaricDataset
from mckibben.dataset.preprocessing import held_loads
from mckibben.errors import printable
from mckibben.identification.estimator import Floats
from mckibben.muscle import Domain
from mckibben.result import Remark
from mckibben.units import percent, show

if TYPE_CHECKING:
    from scipy.spatial import ConvexHull

CONTRACTION_NOISE = 0.1 * percent
"""Error of a contraction [-] that counts as measurement noise."""


@dataclass(frozen=True)
class LeaveOnePressureOut:
    """Cross-validation by pressure or, of a test at constant loads, by load: each is predicted from all others.

    Attributes
    ----------
    rmse, max_error
        Errors over all points [N], but for those of an end that the other levels do not determine.
    by_level
        RMSE [N] by pressure [Pa] or load [N].
    rates
        RMSE at the lowest and the highest level, per distance from the hull of the other points, or from the range of
        the other loads, relative to that of all [N].
    noise
        Part of the RMSE that neighbours along a path do not share [N].
    """

    rmse: float
    max_error: float
    by_level: Mapping[float, float] = field(repr=False)
    rates: tuple[float, float]
    noise: float = 0.0

    def misfit(self, distance: ArrayLike, side: ArrayLike = 0, *, edge_freedom: float = 5.0) -> tuple[Floats, Floats]:
        """Mean square error of a point [N^2] at distances from the hull of the points, and its degrees of freedom.

        Inside of the hull it is that of all levels, each left out. Outside it is at least the square of the distance
        (`hull_distance`, `load_distance`) times the rate: the first on side -1, the second on side 1, else the larger
        one. One level
        says little about another: with `edge_freedom` degrees of freedom, 95 % of the blocks beyond the data are
        covered in the sets of the catalog (docs/results/intervals.md).

        Examples
        --------
        2 N inside; 3 N at the lowest level, a quarter of the range from the others:

        >>> by_level = {1e5: 3.0, 2e5: 1.0, 3e5: 1.0, 4e5: 2.0}
        >>> LeaveOnePressureOut(2.0, 4.0, by_level, rates=(12.0, 10.0)).misfit([0.0, 0.125, 0.25], -1)
        (array([4., 4., 9.]), array([inf, inf,  5.]))
        """
        rate = np.array([max(self.rates), *reversed(self.rates)])[np.asarray(side)]
        inside, beyond = self.rmse**2, (rate * np.asarray(distance)) ** 2
        return np.maximum(inside, beyond), np.where(beyond > inside, edge_freedom, np.inf)


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
        Number of the point in the dataset, from 1.
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
    """Remarks on points that an identification leaves out: the first, and the places of the others; and on slack ones.

    Where the surface through the other points is below 0, the muscle is slack.
    """
    slack = [outlier for outlier in outliers if outlier.expected <= 0]
    outliers = [outlier for outlier in outliers if outlier.expected > 0]
    text = "left out: off the smooth surface through the other points; check it"
    remarks = [Remark.warning("force", f"{text}: {outlier}", KEEP_OUTLIERS) for outlier in outliers[:1]]
    if others := _places(outliers[1:]):
        remarks.append(Remark.warning("force", f"left out, off that surface too: {others}"))
    if slack:
        force = show(float(np.mean([outlier.force for outlier in slack])), "N", 3)
        text = (
            f"left out: slack, by the surface through the other points ({_places(slack)}); the load cell shows {force}"
        )
        remarks.append(Remark.warning("force", text, ZERO_REMEDY))
    return remarks


def _places(outliers: Sequence[Outlier]) -> str:
    return ", ".join(outlier.place or f"row {outlier.row}" for outlier in outliers)


ZERO_REMEDY = (
    "record five or more points of the slack muscle, vented or shortened, from which the zero is estimated; a known "
    "error E of the zero is subtracted by a column '1*x-E force_N'"
)


def zero_remarks(means: IsobaricDataset, rmse: float) -> Iterator[Remark]:
    """Remarks on the zero of the load cell, of points that a law fits with an RMSE [N]: a muscle never pushes."""
    lowest = float(means.force.min())
    if lowest < -max(means.table.attrs["slack_force"], 4 * rmse):
        text = f"forces are down to {show(lowest, 'N', 3)}, but a muscle never pushes: the zero of the load cell is off"
        yield Remark.warning("force", text, ZERO_REMEDY)
    elif not means.slack.any() and held_loads(means.table) is None:
        text = "no point of a slack muscle shows the zero of the load cell, whose error would shift all forces"
        yield Remark.note("force", text, ZERO_REMEDY)


def size_remarks(
    points: IsobaricDataset, residuals: Floats, weights: Floats, *, far: float = 2.0, smallest: float = 0.005
) -> Iterator[Remark]:
    """Remark on weighted residuals far above the others, and above a load cell's error, a share of the largest force.

    Far is a multiple of the limit of a normal distribution (1 %, Bonferroni), as the misfit of a law is not normal.
    """
    from scipy.special import ndtri

    sizes, limit = np.abs(weights * residuals), float(ndtri(1 - 0.005 / len(residuals)))
    usual = np.sqrt(np.mean(sizes[sizes <= limit * np.sqrt(np.mean(sizes**2))] ** 2))
    large = np.abs(residuals) > smallest * points.force.max()
    if beyond := int(np.count_nonzero(large & (sizes > far * limit * usual))):
        worst = int(sizes.argmax())
        where = f"{show(float(points.pressure[worst]), 'bar', 4)} and {points.contraction[worst] / percent:.4g} %"
        size = f"the largest {show(float(residuals[worst]), 'N', 3)}, {sizes[worst] / usual:.3g} times those of others"
        text = f"{beyond} of {len(sizes)} residuals are far above the others: {size}, at {where}"
        remedy = "check these rows, such as those at reversals, or see how other laws fit (mk.rank, or --law all)"
        yield Remark.warning("max_error", text, remedy)


def domain_of(points: IsobaricDataset, measured: IsobaricDataset | None = None) -> Domain:
    """Range of contractions and pressure levels of the points; measured pressures replace levels that they miss.

    With all `measured` points, the slack ones included, also their hull within this range, unless it is the range. Both
    have the digits by which points outside are told.
    """
    low, high = (_rounded(bound(places_of(points), axis=0)) for bound in (np.min, np.max))
    box = Domain(*(float(end) for ends in zip(low, high, strict=True) for end in ends))
    if measured is None or (low == high).any():
        return box
    corners = np.clip(_rounded(places_of(measured)), low, high)
    hull = _hull((corners - low) / (high - low))
    if hull.volume > 1 - CONTRACTION_NOISE:
        return box
    contractions, pressures = corners[hull.vertices].T.tolist()
    return dataclasses.replace(box, hull_contractions=tuple(contractions), hull_pressures=tuple(pressures))


def _rounded(places: Floats) -> Floats:
    """Contractions and pressures, shape (..., 2), to 1e-10 and 0.1 mPa."""
    return np.stack([places[..., 0].round(10), places[..., 1].round(4)], axis=-1)


def hull_distance(domain: Domain, places: Floats, corners: Floats | None = None) -> Floats:
    """Distance of places from the hull of a domain or of other corners, relative to its ranges; 0 inside.

    Corners and places are contractions and pressures, of shape (..., 2).
    """
    low, high = np.array([[domain.contraction_min, domain.pressure_min], [domain.contraction_max, domain.pressure_max]])
    if corners is None:
        corners = np.transpose([domain.hull_contractions, domain.hull_pressures])
    corners = (corners - low) / (high - low) if len(corners) else np.array([[0, 0], [0, 1], [1, 1], [1, 0]])
    sides = _hull(corners).equations  # of unit normals
    return np.maximum(np.max((places - low) / (high - low) @ sides[:, :2].T + sides[:, 2], axis=1), 0.0)


def load_distance(force: Floats, loads: Floats) -> Floats:
    """Distance of forces from the range of loads; 0 inside. All in N."""
    return np.maximum(np.maximum(loads.min() - force, force - loads.max()), 0.0)


def _hull(points: Floats) -> ConvexHull:
    from scipy.spatial import ConvexHull  # takes 0.1 s to import

    return ConvexHull(points)


def places_of(points: IsobaricDataset) -> Floats:
    """Contraction and pressure level of points, shape (points, 2)."""
    return np.column_stack([points.contraction, points.pressure if off_levels(points) else points.levels])


def off_levels(points: IsobaricDataset, *, small: float = 0.05) -> float:
    """Largest distance [Pa] of a measured pressure from its level; 0 up to a `small` share of the range of levels."""
    farthest = float(np.abs(points.levels - points.pressure).max())
    return farthest if farthest > small * float(np.ptp(points.levels)) else 0.0
