"""Validation and cross-validation of force laws."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from mckibben.component.calls import checked_call
from mckibben.dataset import IsobaricDataset
from mckibben.dataset.preprocessing import held_loads
from mckibben.errors import IdentificationError, RangeError, printable
from mckibben.identification.estimator import Bools
from mckibben.identification.fit import Fit
from mckibben.muscle import ForceLaw, forces
from mckibben.result import Result, TableColumns, column, row_columns, table


@dataclass(frozen=True)
class ErrorStatistics:
    """Error statistics [N] of one law over a group of points.

    Attributes
    ----------
    pressure, direction
        Level [Pa], and "loading" or "unloading"; None for all, or if unknown.
    bias
        Mean of predicted minus measured force [N].
    outside
        Number of points outside the law's domain.
    """

    law: str = column()
    pressure: float | None = column("Pa", "pressure", "bar")
    direction: str | None = column()
    points: int = column()
    rmse: float = column("N", "RMSE")
    max_error: float = column("N", "largest")
    bias: float = column("N", "bias")
    outside: int = column("", "outside the domain")


class Validation(Result):
    """Errors of laws at the taut points of a dataset.

    Per law: over all points, per direction, and but for tests at constant loads per pressure, and per pressure and
    direction.
    """

    errors: tuple[ErrorStatistics, ...]
    slack: int = column("", "slack points left out")
    specimen: str

    @property
    def laws(self) -> tuple[str, ...]:
        """Names of the laws."""
        return tuple(dict.fromkeys(e.law for e in self.errors))

    def of(self, law: str, *, pressure: float | None = None, direction: str | None = None) -> ErrorStatistics:
        """Errors over all points, at a pressure [Pa, within 1 kPa], or in a direction; a `RangeError` if none."""
        for e in self.errors:
            same = e.pressure == pressure or (e.pressure and pressure and abs(e.pressure - pressure) <= 1e3)
            if e.law == law and e.direction == direction and same:
                return e
        message = f"there are no errors of {law} at pressure {pressure} Pa, direction {direction}"
        raise RangeError(message, value=pressure, unit="Pa", remedy=f"the laws are {', '.join(self.laws)}")

    def verdict(self) -> str:
        """Return the error of each law over all points."""
        errors = ", ".join(f"{law} {self.of(law).rmse:.3g} N" for law in self.laws)
        return f"RMSE at the taut points of {self.specimen or 'an unnamed specimen'}: {errors}"

    @table("errors")
    def error_rows(self) -> TableColumns:
        """Return the errors, a row per law, pressure and direction; without a pressure or direction: over all."""
        return row_columns(ErrorStatistics, self.errors)


@checked_call
def validate(
    laws: Fit | ForceLaw | Sequence[ForceLaw] | Mapping[str, ForceLaw], dataset: IsobaricDataset
) -> Validation:
    """Compare laws with the taut points, inside and outside each law's domain.

    Several laws are given by name, or named by their class (numbered if a class occurs twice).

    Raises
    ------
    IdentificationError
        If there is no law, or no taut point.

    Examples
    --------
    Eq. 3 belongs to another specimen of the same size:

    >>> from mckibben import catalog
    >>> validation = validate(
    ...     {"Eq. 3": catalog.law("lei-mas-10-180n")}, catalog.dataset("dmsp-10-250-martens2017")
    ... )
    >>> round(validation.of("Eq. 3").bias)
    64
    """
    if isinstance(laws, Fit):
        laws = laws.law
    if isinstance(laws, ForceLaw):
        laws = [laws]
    named = dict(laws) if isinstance(laws, Mapping) else _named(laws)
    points = dataset.taut
    if not named or not len(points):
        raise IdentificationError(
            f"{len(named)} laws and {len(points)} taut points ({len(dataset) - len(points)} slack) cannot be compared",
            remedy="give at least one of each",
        )
    groups = list(_groups(points))
    errors: list[ErrorStatistics] = []
    for name, law in named.items():
        difference = forces(law, points.contraction, points.pressure) - points.force
        outside = ~np.asarray(law.domain.contains(points.contraction, points.levels))
        for pressure, direction, mask in groups:
            part = difference[mask]
            sizes = float(np.sqrt(np.mean(part**2))), float(np.abs(part).max()), float(part.mean())
            errors.append(ErrorStatistics(name, pressure, direction, len(part), *sizes, int(outside[mask].sum())))
    return Validation(tuple(errors), len(dataset) - len(points), printable(str(dataset.table.attrs["specimen"])))


def _named(laws: Sequence[ForceLaw]) -> dict[str, ForceLaw]:
    """Laws by the names of their classes, numbered where several are of one class."""
    types = [type(law).__name__ for law in laws]
    names = [name if types.count(name) == 1 else f"{name} {types[:i].count(name) + 1}" for i, name in enumerate(types)]
    return dict(zip(names, laws, strict=True))


def _groups(points: IsobaricDataset) -> Iterator[tuple[float | None, str | None, Bools]]:
    """Masks of all points, each direction, each pressure, each pressure and direction; empty ones left out."""
    directions = points.table["direction"].to_numpy() if "direction" in points.table else None
    known = [str(d) for d in np.unique(directions)] if directions is not None else []
    levels = points.levels
    pressures = points.pressures.tolist() if held_loads(points.table) is None else []  # weights have no levels
    for pressure in (None, *pressures):
        at = np.ones(len(points), bool) if pressure is None else levels == pressure
        yield pressure, None, at
        for direction in known:
            both = at & (directions == direction)
            if both.any():
                yield pressure, direction, both
