"""Datasets of isobaric tests."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mckibben.dataset.preprocessing import levels_of, with_slack_force
from mckibben.dataset.schema import VARIABLES, MeasuredTable, assemble, format_range, write_csv
from mckibben.errors import DatasetError, Problem, RangeError
from mckibben.result import draw
from mckibben.units import bar, percent

if TYPE_CHECKING:
    from mckibben.result import Figure

_LOWEST = 0.08 * bar  # highest pressure of a muscle test


def format_list(values: np.ndarray, most: int = 24) -> str:
    """Numbers or words as text, abbreviated if there are many.

    >>> format_list(np.arange(5.0), most=3)
    '0, 1, 2, ... (5 in all)'
    """
    shown = [value if isinstance(value, str) else f"{value:g}" for value in values[:most].tolist()]
    return ", ".join(shown) + (f", ... ({len(values)} in all)" if len(values) > most else "")


@dataclass(frozen=True, eq=False, repr=False)
class IsobaricDataset(MeasuredTable):
    """Points of isobaric tests: pressure, contraction and force.

    Made by `of` or `read_dataset`; two are equal where ``a.table.identical(b.table)``. A `DatasetError` lists variables
    that are missing, or of the wrong shape, unit or range.

    Attributes
    ----------
    table
        Along ``point``: ``pressure`` [Pa, gauge], ``contraction`` [-, positive = shorter], ``force`` [N];
        where known ``direction`` ("loading": being stretched; "unloading": shortening; empty: unknown), ``phase``
        ("filling" or "venting" at a fixed length, else empty), ``repeat``, ``time`` [s], ``set_pressure`` [Pa, NaN
        where unknown], ``set_force`` [N] and ``force_spread`` [N], the standard deviation over the samples of a
        point. Attributes: ``specimen``, ``source``,
        ``slack_force`` [N] and, where known, ``initial_length`` [m]; ``columns_read`` (a table of what each column of
        the source file was read as), ``ignored_columns`` and ``repairs``, if any.

    Examples
    --------
    >>> data = IsobaricDataset.of(
    ...     pressure=[1e5, 1e5, 2e5, 2e5], contraction=[0, 0.25, 0, 0.25], force=[81.7, 0, 174.0, 0]
    ... )
    >>> data
    <IsobaricDataset: 4 points (2 slack), 2 pressures 1..2 bar, contraction 0..25 %>
    >>> data.taut.at(2e5).force
    array([174.])
    """

    schema = VARIABLES

    @classmethod
    def of(
        cls,
        *,
        pressure: ArrayLike,
        contraction: ArrayLike,
        force: ArrayLike,
        direction: ArrayLike | None = None,
        phase: ArrayLike | None = None,
        repeat: ArrayLike | None = None,
        time: ArrayLike | None = None,
        set_pressure: ArrayLike | None = None,
        set_force: ArrayLike | None = None,
        force_spread: ArrayLike | None = None,
        specimen: str = "",
        initial_length: float | None = None,
        source: str = "",
        slack_force: float | None = None,
    ) -> Self:
        """Make a dataset from arrays in SI units; raises a `DatasetError` with every problem.

        Parameters
        ----------
        pressure, contraction, force
            Shape (points,): gauge pressure [Pa], contraction [-], axial pull [N].
        direction
            Shape (points,): "loading" or "unloading", empty where unknown.
        phase
            Shape (points,): "filling" or "venting" where the pressure was changed at a fixed length, else empty.
        repeat, time
            Shape (points,): integers from 0 up, and [s].
        set_pressure
            Shape (points,): nominal pressure [Pa], NaN where unknown.
        set_force
            Shape (points,): nominal load [N], held while the pressure changes, as by hanging weights.
        force_spread
            Shape (points,): standard deviation of the force over the samples of each point [N].
        specimen, source
            Type of the muscle, and source of the data.
        initial_length
            Length of the deflated muscle [m].
        slack_force
            Force [N] up to which the muscle counts as slack, above the noise of the rig. Default: from the noise of the
            slack muscle about 0 N, otherwise 0.
        """
        table = assemble({name: values for name, values in locals().items() if name in VARIABLES}, VARIABLES, "dataset")
        highest = float(table["pressure"].to_numpy().max(initial=0.0))
        if 0 < highest < _LOWEST and (set_pressure is None or (table["set_pressure"] > 0).any()):  # not all at 0 bar
            text = f"the highest pressure is {highest:.4g} Pa, too low for a muscle test"
            remedy = "check the unit: arrays are in Pa"
            problem = Problem(text, field="pressure", remedy=remedy, value=highest, unit="Pa")
            raise DatasetError("dataset", [problem])
        attrs = {"specimen": specimen, "source": source, "slack_force": 0.0 if slack_force is None else slack_force}
        found = cls(table.assign_attrs(attrs, initial_length=initial_length))
        return cls(with_slack_force(found.table)) if slack_force is None and len(found) else found

    @property
    def contraction(self) -> NDArray[np.float64]:
        """Contraction of each point [-], positive = shorter, read-only."""
        return self.table["contraction"].to_numpy()

    @property
    def slack(self) -> NDArray[np.bool_]:
        """Mask of points with a slack muscle, where the force is not determined by the muscle."""
        return self.force <= self.table.attrs["slack_force"]

    @property
    def taut(self) -> Self:
        """Points with a taut muscle."""
        return self.select(~self.slack)

    @property
    def levels(self) -> NDArray[np.float64]:
        """Nominal pressure of each point [Pa]: the set pressure, or the measured one where it is unknown."""
        return levels_of(self.table)

    @property
    def pressures(self) -> NDArray[np.float64]:
        """Distinct levels [Pa], ascending."""
        return np.unique(self.levels)

    @property
    def repeats(self) -> NDArray[np.int64]:
        """Distinct repeats, ascending; empty if not recorded."""
        return self._distinct("repeat")

    @property
    def directions(self) -> NDArray[np.str_]:
        """Distinct directions; empty if not recorded."""
        return self._distinct("direction")

    @property
    def phases(self) -> NDArray[np.str_]:
        """Distinct phases; empty if not recorded."""
        return self._distinct("phase")

    def __repr__(self) -> str:
        name = self.table.attrs["specimen"]
        slack = int(self.slack.sum())
        parts = [f"{len(self)} points" + (f" ({slack} slack)" if slack else "")]
        if len(self):
            levels, contraction = self.pressures / bar, self.contraction / percent
            count = f"{len(levels)} pressure{'s' if len(levels) > 1 else ''}"
            parts.append(f"{count} {format_range(levels)} bar")
            parts.append(f"contraction {format_range(contraction)} %")
        parts += [" and ".join(words) for words in (self.directions, self.phases) if len(words)]
        if len(self.repeats):
            parts.append(f"repeats {format_list(self.repeats)}")
        return f"<IsobaricDataset{f' {name!r}' if name else ''}: {', '.join(parts)}>"

    def plot(self) -> Figure:
        """Return a figure of the points, see `mckibben.report.isobaric`."""
        return draw("isobaric", self)

    def select(self, mask: ArrayLike) -> Self:
        """Points where `mask` (booleans, one per point) is true, in their order."""
        where = np.asarray(mask)
        if where.dtype != np.bool_ or where.shape != (len(self),):
            text = f"a mask of shape {where.shape} and type {where.dtype} cannot select from {len(self)} points"
            raise RangeError(text, remedy="give one boolean per point")
        return type(self)(self.table.isel(point=where))

    def at(self, pressures: ArrayLike, tolerance: float = 1e3) -> Self:
        """Points whose level [Pa] is within `tolerance` [Pa] of any of the given pressures [Pa].

        Raises a `RangeError` that names the available pressures if there is no point at one of them.
        """
        levels, wanted = self.levels, np.atleast_1d(np.asarray(pressures, float)).ravel()
        close = np.abs(levels[:, None] - wanted) <= tolerance
        if len(missing := wanted[~close.any(axis=0)]) or not len(wanted):
            text = f"there is no point at {format_list(missing / bar)} bar" if len(missing) else "no pressure is given"
            there = f"there are {format_list(np.unique(levels) / bar)} bar"
            raise RangeError(text, field="pressures", remedy=there)
        return self.select(close.any(axis=1))

    def to_csv(self, path: str | os.PathLike[str]) -> None:
        """Write the points as CSV in SI units atomically, with nine digits, as `read_dataset` reads them.

        The attributes are comment lines at the top; other variables are left out: `to_netcdf` keeps them.
        """
        write_csv(self.table, Path(path))

    def _distinct(self, name: str) -> Any:
        """Distinct values of a column but empty words, ascending; none without the column."""
        values = np.unique(self.table[name].to_numpy()) if name in self.table else np.empty(0, np.int64)
        return values[values != ""] if values.dtype.kind == "U" else values
