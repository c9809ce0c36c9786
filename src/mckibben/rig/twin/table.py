"""A force law as a table: a rig asks for one force at a time, hundreds of thousands of times."""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import RectBivariateSpline

from mckibben.errors import RangeError
from mckibben.muscle import Muscle, forces
from mckibben.units import bar, percent

_BEYOND = 3 * percent  # of contraction, on both sides of what the specimen may be put through
_HIGHEST = 11 * bar
_CELLS = (320, 88)  # of contraction and of pressure
_WIDEST = (-0.2, 0.6)
_ROUGH = 0.5  # N

# Powers of a cell's coordinate from value and slope at its two ends: the cubic through them.
_HERMITE = np.array([[1, 0, 0, 0], [0, 0, 1, 0], [-3, 3, -2, -1], [2, -2, 1, 1]], float)


@dataclass(frozen=True)
class ForceTable:
    """The force of a law over contraction and pressure, a bicubic spline; below 0 it is 0 (slack).

    Attributes
    ----------
    contraction, pressure
        Where it begins and ends [-], [Pa]; outside it has the force of its edge.
    error
        The largest distance [N] from the law, in the middle of the cells where the muscle is taut.
    """

    contraction: tuple[float, float]
    pressure: tuple[float, float]
    error: float
    _cells: NDArray[np.float64]  # shape (contractions, pressures, 16)

    def force(self, contraction: float, pressure: float) -> float:
        """The force [N] at a contraction [-] and a gauge pressure [Pa]."""
        (first, last), (low, high) = self.contraction, self.pressure
        rows, columns = _CELLS
        x = (contraction - first) / (last - first) * rows
        y = (pressure - low) / (high - low) * columns
        x, y = min(max(x, 0.0), rows - 1e-9), min(max(y, 0.0), columns - 1e-9)
        i, j = int(x), int(y)
        x, y = x - i, y - j
        a0, a1, a2, a3, b0, b1, b2, b3, c0, c1, c2, c3, d0, d1, d2, d3 = self._cells[i, j].tolist()
        force = (
            ((d3 * y + d2) * y + d1) * y
            + d0
        ) * x + ((c3 * y + c2) * y + c1) * y + c0  # fmt: skip
        force = force * x + ((b3 * y + b2) * y + b1) * y + b0
        force = force * x + ((a3 * y + a2) * y + a1) * y + a0
        return force if force > 0 else 0.0


def force_table(muscle: Muscle) -> ForceTable:
    """The table of a muscle's law; made once for each.

    Raises
    ------
    RangeError
        If the law is too rough for a table, or not finite over the specimen's range.
    """
    bare = Muscle(muscle.specimen, muscle.law)
    try:
        return _kept(bare)
    except TypeError:  # numbers of it are arrays, which cannot be looked up
        return _made(bare)


def _made(muscle: Muscle) -> ForceTable:
    domain = muscle.specimen.domain
    first = max(float(domain.contraction_min) - _BEYOND, _WIDEST[0])
    last = min(float(domain.contraction_max) + _BEYOND, _WIDEST[1])
    x, y = (np.linspace(*ends, cells + 1) for ends, cells in zip(((first, last), (0.0, _HIGHEST)), _CELLS, strict=True))
    middle_x, middle_y = ((axis[1:] + axis[:-1]) / 2 for axis in (x, y))
    at = forces(muscle.law, x[:, None], y)
    between = forces(muscle.law, middle_x[:, None], middle_y)
    if not np.isfinite(at).all():
        raise RangeError(
            f"the law of {muscle.specimen.name} has no finite force somewhere within {first / percent:.0f}.."
            f"{last / percent:.0f} % and 0..{_HIGHEST / bar:g} bar",
            remedy="give the specimen a narrower range",
        )
    spline = RectBivariateSpline(x, y, at)
    error = float(np.abs(spline(middle_x, middle_y) - between)[between > 0].max(initial=0.0))
    if error > _ROUGH:
        raise RangeError(
            f"the law of {muscle.specimen.name} is too rough: a table of it is {error:.2g} N out", value=error, unit="N"
        )
    return ForceTable((first, last), (0.0, _HIGHEST), error, _coefficients(spline, x, y))


_kept = functools.lru_cache(maxsize=8)(_made)


def _coefficients(spline: RectBivariateSpline, x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
    """Of each cell, by powers of its coordinates 0..1; shape (len(x) - 1, len(y) - 1, 16)."""
    wide, high = x[1] - x[0], y[1] - y[0]
    corners = np.empty((len(x) - 1, len(y) - 1, 4, 4))
    for dx in (0, 1):
        for dy in (0, 1):
            values = spline(x, y, dx=dx, dy=dy) * wide**dx * high**dy
            for row in (0, 1):
                for column in (0, 1):
                    there = values[row : len(x) - 1 + row, column : len(y) - 1 + column]
                    corners[:, :, 2 * dx + row, 2 * dy + column] = there
    cells = np.einsum("ri,abij,cj->abrc", _HERMITE, corners, _HERMITE)
    return np.ascontiguousarray(cells.reshape(len(x) - 1, len(y) - 1, 16))
