"""Validation: how far laws are from measured points, by pressure and direction, and at points held out."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mckibben.dataset import IsobaricDataset
from mckibben.errors import IdentificationError, RangeError
from mckibben.identification.fit import Fit
from mckibben.identification.fitting import identify
from mckibben.muscle import ForceLaw, forces
from mckibben.units import bar


@dataclass(frozen=True)
class ErrorStatistics:
    """The errors of one law over a group of points.

    Attributes
    ----------
    law
        Its name.
    pressure
        The level [Pa]; None for all.
    direction
        "loading" or "unloading"; None for all, or where it is not known.
    points
        How many.
    rmse, max_error
        Root of the mean square, and the largest without sign [N].
    bias
        Mean of law minus measured [N]: positive where the law reads too high.
    outside
        How many of the points lie outside the law's domain.
    """

    law: str
    pressure: float | None
    direction: str | None
    points: int
    rmse: float
    max_error: float
    bias: float
    outside: int


@dataclass(frozen=True)
class Validation:
    """Errors of laws at the taut points of a dataset.

    Attributes
    ----------
    errors
        For each law: over all points, over each direction, over each pressure, and over each pressure and
        direction.
    slack
        How many slack points were left out: a force is not measured there.
    specimen
        As the dataset says.
    """

    errors: tuple[ErrorStatistics, ...] = field(repr=False)
    slack: int
    specimen: str

    @property
    def laws(self) -> tuple[str, ...]:
        """The names of the laws."""
        return tuple(dict.fromkeys(e.law for e in self.errors))

    def of(self, law: str, *, pressure: float | None = None, direction: str | None = None) -> ErrorStatistics:
        """The errors of a law over all points, or at a pressure [Pa, met within 1 kPa], or in a direction.

        Raises
        ------
        RangeError
            If there are none.
        """
        for e in self.errors:
            same = e.pressure is pressure or (
                None not in (e.pressure, pressure) and abs((e.pressure or 0.0) - (pressure or 0.0)) <= 1e3
            )
            if e.law == law and e.direction == direction and same:
                return e
        raise RangeError(
            f"there are no errors of {law} at pressure {pressure} Pa, direction {direction}",
            value=pressure,
            unit="Pa",
            remedy=f"the laws are {', '.join(self.laws)}",
        )

    def records(self) -> list[dict[str, str | float | int | None]]:
        """One dictionary per group of points, for JSON or a table; SI units."""
        return [asdict(e) for e in self.errors]

    def report(self) -> str:
        """A table as text."""
        rows = [("law", "pressure", "direction", "points", "RMSE N", "max N", "bias N", "outside domain")]
        rows += [
            (
                e.law,
                "all" if e.pressure is None else f"{e.pressure / bar:.4g} bar",
                e.direction or "all",
                f"{e.points}",
                f"{e.rmse:.2f}",
                f"{e.max_error:.2f}",
                f"{e.bias:+.2f}",
                f"{e.outside}" if e.outside else "-",
            )
            for e in self.errors
        ]
        widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
        lines = [
            "  ".join(
                cell.ljust(width) if i in (0, 2) else cell.rjust(width)
                for i, (cell, width) in enumerate(zip(row, widths, strict=True))
            ).rstrip()
            for row in rows
        ]
        name = self.specimen or "unnamed specimen"
        return "\n".join([f"{name}: taut points; {self.slack} slack left out", *lines])

    def __str__(self) -> str:
        return self.report()


@dataclass(frozen=True)
class HoldOut:
    """A fit to one part of a dataset and its validation on the other.

    Attributes
    ----------
    fit
        To the points that were kept.
    validation
        On the points held out; its law is named as its type.
    """

    fit: Fit
    validation: Validation


def validate(
    laws: Fit | ForceLaw | Sequence[ForceLaw] | Mapping[str, ForceLaw], dataset: IsobaricDataset
) -> Validation:
    """Compare laws with the plateau means of the taut points.

    The laws are taken as they stand, inside and outside their domain; how many points are outside is counted.

    Parameters
    ----------
    laws
        One law or fit, or several: by name, or named by their type (with a number where a type comes twice).
    dataset
        Measured points.

    Returns
    -------
    Validation
        Errors over all points, by pressure, and where known by direction.

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
    means = dataset.plateau_means()
    points = means.taut
    if not named or not len(points):
        raise IdentificationError(
            f"{len(named)} laws and {len(points)} taut points ({len(means) - len(points)} slack) are nothing to "
            "compare",
            remedy="give at least one of each",
        )
    groups = list(_groups(points))
    errors: list[ErrorStatistics] = []
    for name, law in named.items():
        difference = forces(law, points.contraction, points.pressure) - points.force
        outside = ~np.asarray(law.domain.contains(points.contraction, points.levels))
        for pressure, direction, mask in groups:
            part = difference[mask]
            errors.append(
                ErrorStatistics(
                    law=name,
                    pressure=pressure,
                    direction=direction,
                    points=len(part),
                    rmse=float(np.sqrt(np.mean(part**2))),
                    max_error=float(np.abs(part).max()),
                    bias=float(part.mean()),
                    outside=int(outside[mask].sum()),
                )
            )
    return Validation(tuple(errors), len(means) - len(points), str(means.table.attrs["specimen"]))


def hold_out(
    law_type: type[ForceLaw],
    dataset: IsobaricDataset,
    *,
    pressures: ArrayLike | None = None,
    repeats: ArrayLike | None = None,
    directions: str | Sequence[str] | None = None,
) -> HoldOut:
    """Fit a law to a part of a dataset and validate it on the rest.

    Parameters
    ----------
    law_type
        Such as `ExponentialLaw`.
    dataset
        Measured points.
    pressures, repeats, directions
        What to hold out, as for `IsobaricDataset.split`. Where the pressures of a validation are among those
        of the identification, as in the paper, hold out both by pressure and by repeat: the first asks
        whether the law interpolates, the second whether the muscle repeats itself.

    Raises
    ------
    RangeError
        If that holds out nothing, or everything.
    IdentificationError
        If the rest cannot determine the law, or the part held out has no taut point.
    """
    train, held_out = dataset.plateau_means().split(pressures=pressures, repeats=repeats, directions=directions)
    fit = identify(law_type, train)
    return HoldOut(fit, validate({law_type.__name__: fit.law}, held_out))


def _named(laws: Sequence[ForceLaw]) -> dict[str, ForceLaw]:
    named: dict[str, ForceLaw] = {}
    types = [type(law).__name__ for law in laws]
    for i, (law, name) in enumerate(zip(laws, types, strict=True)):
        named[name if types.count(name) == 1 else f"{name} {types[: i + 1].count(name)}"] = law
    return named


def _groups(points: IsobaricDataset) -> Iterator[tuple[float | None, str | None, NDArray[np.bool_]]]:
    """All points, each direction, each pressure, each pressure with each direction; empty ones left out."""
    directions = points.table["direction"].to_numpy() if "direction" in points.table else None
    known = [str(d) for d in np.unique(directions)] if directions is not None else []
    levels = points.levels
    for pressure in (None, *points.pressures.tolist()):
        at = np.ones(len(points), bool) if pressure is None else levels == pressure
        yield pressure, None, at
        for direction in known:
            both = at & (directions == direction)
            if both.any():
                yield pressure, direction, both
