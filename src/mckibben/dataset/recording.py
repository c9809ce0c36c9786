"""Raw recordings of a rig: pressure, force and contraction against time."""

from __future__ import annotations

import os
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import Self

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray

from mckibben.dataset.isometric import isometric
from mckibben.dataset.points import ExtractedPoints
from mckibben.dataset.schema import RECORDED, assemble, format_range, load_validated, normalize, write_netcdf
from mckibben.dataset.segmentation import plateaus
from mckibben.errors import DatasetError
from mckibben.units import bar, kPa, percent


@dataclass(frozen=True, eq=False, repr=False)
class Recording:
    """Samples of a test in the order of time, made by `of` or `read_recording`.

    Points are extracted by `plateaus`, where pressure and contraction were constant, or by `isometric`, where a muscle
    of a fixed length was filled and vented.

    Attributes
    ----------
    table
        Along ``sample``: ``time`` [s], ``pressure`` [Pa, gauge], ``force`` [N]; where known ``contraction`` [-] and
        ``set_pressure`` [Pa]. Attributes as those of `IsobaricDataset`.

    Raises
    ------
    DatasetError
        If a variable is missing, of the wrong shape or unit, or not finite.

    Examples
    --------
    >>> time = np.arange(0, 8, 0.01)
    >>> record = Recording.of(
    ...     time=time, pressure=np.where(time < 4, 2e5, 3e5), force=np.where(time < 4, 50, 90.0), contraction=0.1
    ... )
    >>> record
    <Recording: 800 samples in 7.99 s, 2..3 bar, 50..90 N, contraction 10 %>
    >>> record.plateaus().dataset.force
    array([50., 90.])
    """

    table: xr.Dataset

    def __post_init__(self) -> None:
        table, problems = normalize(self.table, RECORDED)
        if problems:
            raise DatasetError("recording", problems)
        object.__setattr__(self, "table", table)

    @classmethod
    def of(
        cls,
        *,
        time: ArrayLike,
        pressure: ArrayLike,
        force: ArrayLike,
        contraction: ArrayLike | None = None,
        set_pressure: ArrayLike | None = None,
        specimen: str = "",
        initial_length: float | None = None,
        source: str = "",
        slack_force: float = 0.0,
    ) -> Self:
        """Make a recording from arrays in SI units; raises a `DatasetError` with every problem.

        Parameters
        ----------
        time, pressure, force
            Shape (samples,): [s], gauge [Pa], [N]. Arrays of float64 are not copied.
        contraction, set_pressure
            Shape (samples,), or one number for all: [-], [Pa].
        specimen, initial_length, source, slack_force
            As for `IsobaricDataset.of`.
        """
        length = np.size(time)
        variables = {"time": time, "pressure": pressure, "force": force}
        for name, values in (("contraction", contraction), ("set_pressure", set_pressure)):
            variables[name] = np.full(length, values) if values is not None and np.ndim(values) == 0 else values
        table, problems = assemble(variables, RECORDED)
        if problems:
            raise DatasetError("recording", problems)
        attrs = {"specimen": specimen, "source": source, "slack_force": slack_force, "initial_length": initial_length}
        return cls(table.assign_attrs(attrs))

    @property
    def time(self) -> NDArray[np.float64]:
        """Time of each sample [s], read-only."""
        return self.table["time"].to_numpy()

    @property
    def pressure(self) -> NDArray[np.float64]:
        """Gauge pressure [Pa], read-only."""
        return self.table["pressure"].to_numpy()

    @property
    def force(self) -> NDArray[np.float64]:
        """Axial pull [N], read-only."""
        return self.table["force"].to_numpy()

    @property
    def contraction(self) -> NDArray[np.float64] | None:
        """Contraction [-], read-only; None where it was not recorded."""
        return self.table["contraction"].to_numpy() if "contraction" in self.table else None

    def __len__(self) -> int:
        return self.table.sizes["sample"]

    def __repr__(self) -> str:
        name = self.table.attrs["specimen"]
        parts = [f"{len(self)} samples"]
        if len(self):
            parts[0] += f" in {np.ptp(self.time):.4g} s"
            parts += [f"{format_range(self.pressure / bar)} bar", f"{format_range(self.force)} N"]
            if self.contraction is not None:
                parts.append(f"contraction {format_range(self.contraction / percent)} %")
        return f"<Recording{f' {name!r}' if name else ''}: {', '.join(parts)}>"

    def _repr_html_(self) -> str:
        return f"<p>{escape(repr(self))}</p>{self.table._repr_html_()}"

    def plateaus(
        self,
        *,
        pressure_tolerance: float = 2 * kPa,
        contraction_tolerance: float = 0.1 * percent,
        force_tolerance: float | None = None,
        dwell: float = 1.0,
        settle: float = 0.0,
        level_tolerance: float = 10 * kPa,
        gap: float | None = None,
    ) -> ExtractedPoints:
        """Points of the steady segments: means of pressure, contraction and force.

        Parameters
        ----------
        pressure_tolerance, contraction_tolerance, force_tolerance
            A segment is steady while means over a twentieth of `dwell` stay within this [Pa], [-], [N] of its middle.
            The force, which may creep, is looked at only where a tolerance is given.
        dwell
            A segment is steady for at least so long [s].
        settle
            Its beginning that is left out of the means [s], besides a twentieth of `dwell` at either end.
        level_tolerance
            Plateau pressures that follow each other closer than this [Pa] belong to one level, whose mean (in whole
            kPa) is the set pressure of them all; unless the record has set pressures.
        gap
            Samples further apart than this [s] are not joined; 10 times the usual interval unless given.

        Returns
        -------
        ExtractedPoints
            The dataset has ``force_spread`` and ``time`` (the middle of each segment). ``direction`` is that of the
            last motion before a plateau; where the length did not change, ``phase`` says whether the muscle was filled
            or vented.

        Raises
        ------
        RangeError
            If an argument has no meaning, the contraction is not known, or nothing was steady for so long; the error
            says what was left out and why.
        """
        return plateaus(
            self.table,
            pressure_tolerance=pressure_tolerance,
            contraction_tolerance=contraction_tolerance,
            force_tolerance=force_tolerance,
            dwell=dwell,
            settle=settle,
            level_tolerance=level_tolerance,
            gap=gap,
        )

    def isometric(
        self,
        levels: ArrayLike | None = None,
        *,
        count: int = 12,
        contraction: float | None = None,
        contraction_tolerance: float = 0.5 * percent,
        band: float | None = None,
        reversal: float = 10 * kPa,
        gap: float | None = None,
    ) -> ExtractedPoints:
        """Points at given pressures of a recording at a fixed length, separately for each filling and venting.

        At each level the force is that of a least-squares line through the samples with a pressure near it; nothing
        needs to be steady.

        Parameters
        ----------
        levels, count
            Pressures [Pa]; `count` evenly spaced ones inside the range of the recording unless given.
        contraction
            Contraction of the test [-]; the recorded one unless given.
        contraction_tolerance
            Largest deviation of a recorded contraction from its median [-]; samples beyond are left out.
        band
            Largest deviation of a sample's pressure from its level [Pa]; unless given, half the least distance between
            levels, and at most a fortieth of their range.
        reversal
            Pressure has reversed when it is this far [Pa] from its last extreme; samples in between belong to neither
            phase, as there the muscle rests or friction has not reversed yet.
        gap
            As for `plateaus`.

        Returns
        -------
        ExtractedPoints
            The dataset has ``phase`` ("filling" or "venting"), ``repeat`` (the filling or venting's number, from 0),
            ``set_pressure`` (the level) and ``force_spread`` (about the line); no direction.

        Raises
        ------
        RangeError
            If an argument has no meaning, the contraction is not known, or no level was passed.
        """
        return isometric(
            self.table,
            levels=levels,
            count=count,
            contraction=contraction,
            contraction_tolerance=contraction_tolerance,
            band=band,
            reversal=reversal,
            gap=gap,
        )

    def to_netcdf(self, path: str | os.PathLike[str]) -> None:
        """Write all samples to a NetCDF-4 file atomically."""
        write_netcdf(self.table, Path(path))

    @classmethod
    def from_netcdf(cls, path: str | os.PathLike[str]) -> Self:
        """Read a file that `to_netcdf` wrote; raises a `DatasetError` if it is missing or no recording."""
        return load_validated(Path(path), cls)
