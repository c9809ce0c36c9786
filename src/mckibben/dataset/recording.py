"""A raw record of a rig: pressure and force against time, and where it is known the contraction."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Self

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray

from mckibben.dataset.isometric import isometric
from mckibben.dataset.points import ExtractedPoints
from mckibben.dataset.schema import VACUUM, held_in, spanned, write_netcdf
from mckibben.dataset.segmentation import plateaus
from mckibben.errors import DatasetError, Problem
from mckibben.units import bar, kPa, percent

_VARIABLES: Mapping[str, tuple[str, str]] = {
    "time": ("s", "time"),
    "pressure": ("Pa", "gauge pressure"),
    "force": ("N", "axial pull"),
    "contraction": ("1", "contraction, positive when shorter"),
    "set_pressure": ("Pa", "nominal gauge pressure"),
}
_NEEDED = ("time", "pressure", "force")


@dataclass(frozen=True, eq=False, repr=False)
class Recording:
    """Samples of a test in the order in which they were taken.

    Make one with `of` or `read_recording`. It becomes points by `plateaus`, where pressure and contraction were
    held, or by `isometric`, where a muscle of a fixed length was filled and vented.

    Attributes
    ----------
    table
        Along ``sample``: ``time`` [s], ``pressure`` [Pa, gauge], ``force`` [N]; where known ``contraction`` [-] and
        ``set_pressure`` [Pa]. Attributes as those of `IsobaricDataset`.

    Raises
    ------
    DatasetError
        If a variable is missing, of the wrong shape or unit, or holds what is no finite number.

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
        table, problems = _conform(self.table)
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
        """Make a recording from arrays in SI units.

        Parameters
        ----------
        time, pressure, force
            Shape (samples,): [s], gauge [Pa], [N]. Arrays of float64 are not copied: do not write to them after.
        contraction, set_pressure
            Shape (samples,), or one number for all: [-], [Pa].
        specimen, initial_length, source, slack_force
            As for `IsobaricDataset.of`.

        Raises
        ------
        DatasetError
            With all that is wrong.
        """
        given = {"time": time, "pressure": pressure, "force": force}
        given |= {"contraction": contraction, "set_pressure": set_pressure}
        arrays = {name: np.asarray(values) for name, values in given.items() if values is not None}
        count = arrays["time"].size
        for name in ("contraction", "set_pressure"):
            if name in arrays and arrays[name].ndim == 0:
                arrays[name] = np.full(count, arrays[name])
        problems = [
            Problem(f"has shape {array.shape} where time has ({count},)", field=name)
            for name, array in arrays.items()
            if array.shape != (count,)
        ]
        if problems:
            raise DatasetError("recording", problems)
        attrs = {"specimen": specimen, "source": source, "slack_force": slack_force, "initial_length": initial_length}
        return cls(xr.Dataset({name: ("sample", array) for name, array in arrays.items()}, attrs=attrs))

    @property
    def time(self) -> NDArray[np.float64]:
        """When each sample was taken [s], read-only."""
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
            parts += [f"{spanned(self.pressure / bar)} bar", f"{spanned(self.force)} N"]
            if self.contraction is not None:
                parts.append(f"contraction {spanned(self.contraction / percent)} %")
        return f"<Recording{f' {name!r}' if name else ''}: {', '.join(parts)}>"

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
        """The steady segments of the record, a point each: means of pressure, contraction and force.

        Parameters
        ----------
        pressure_tolerance, contraction_tolerance, force_tolerance
            A segment is steady while means over a twentieth of `dwell` stay within this [Pa], [-], [N] of its
            middle. A force that creeps is no reason to drop a plateau: it is looked at only where a tolerance is given.
        dwell
            A segment is steady for at least so long [s].
        settle
            Its beginning that is left out of the means [s]; below `dwell`. A twentieth of `dwell` is left out at either
            end anyhow: friction changes sides in the first instant of a motion.
        level_tolerance
            Plateau pressures that follow each other closer than this [Pa] belong to one level, whose mean (in whole
            kPa) is the set pressure of them all; unless the record has set pressures.
        gap
            Samples further apart than this [s] are not joined; 10 times the usual interval unless given.

        Returns
        -------
        Points
            The dataset has ``force_spread`` and ``time`` (the middle of each segment). ``direction`` is that of the
            last motion before a plateau; where the length did not change since the plateau before it, the direction is
            not known (it is no loading or unloading), and ``phase`` says whether the muscle was filled or vented.

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
        """Points at given pressures of a record at a fixed length, apart for each filling and venting.

        Nothing needs to be steady. At each level the force is the value of a straight line through the samples whose
        pressure is near it.

        Parameters
        ----------
        levels
            Pressures [Pa]; `count` evenly spaced ones inside the range of the record unless given.
        count
            Of these, how many.
        contraction
            At which the muscle was held [-]; what the record says unless given.
        contraction_tolerance
            How far a recorded contraction may be from its median [-]; samples beyond are left out.
        band
            Samples within this [Pa] of a level belong to it: half the least distance between levels, but at most a
            fortieth of their range, unless given.
        reversal
            A pressure has turned when it is this far [Pa] from its last extreme; what lies between belongs to neither
            phase, as there the muscle rests, or friction is still on the other side.
        gap
            As for `plateaus`.

        Returns
        -------
        Points
            The dataset has ``phase`` ("filling" or "venting"), ``repeat`` (the filling or venting's number, from 0),
            ``set_pressure`` (the level) and ``force_spread`` (about the line), and no direction: a muscle of a fixed
            length is neither being stretched nor shortening, and on which side of the loop it is hangs on the pressure.

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
        """Write all samples to a NetCDF-4 file, which appears whole or not at all."""
        write_netcdf(self.table, Path(path))

    @classmethod
    def from_netcdf(cls, path: str | os.PathLike[str]) -> Self:
        """Read a file that `to_netcdf` wrote.

        Raises
        ------
        DatasetError
            If the file is not there, is no NetCDF file, or does not hold a recording.
        """
        return held_in(Path(path), cls)


def _conform(table: xr.Dataset) -> tuple[xr.Dataset, list[Problem]]:
    """A table in the one form that a recording holds, and all that is wrong with it."""
    problems = [Problem("is missing", field=name) for name in _NEEDED if name not in table]
    columns: dict[str, tuple[str, np.ndarray, dict[str, str]]] = {}
    for name, (unit, long_name) in _VARIABLES.items():
        if name not in table:
            continue
        array = table[name]
        if array.dims != ("sample",) or array.dtype.kind not in "fiu":
            problems.append(Problem("is no column of numbers along sample", field=name))
            continue
        if (said := array.attrs.get("units", unit)) != unit:
            problems.append(Problem(f"is in {said!r}", field=name, remedy=f"give it in {unit!r}"))
        values = np.asarray(array.to_numpy(), np.float64).view()
        values.setflags(write=False)
        problems += _values(name, values)
        columns[name] = "sample", values, {"units": unit, "long_name": long_name}
    attrs = dict(table.attrs)
    for name in ("specimen", "source"):
        attrs[name] = str(attrs.get(name, ""))
    attrs.setdefault("slack_force", 0.0)
    if attrs.get("initial_length") is None:
        attrs.pop("initial_length", None)
    for name in ("slack_force", "initial_length"):
        value = attrs.get(name, 1.0)
        if not isinstance(value, (int, float, np.number)) or not math.isfinite(value):
            problems.append(Problem(f"{value!r} is not a finite number", field=name))
        elif name == "initial_length" and value <= 0:
            problems.append(Problem(f"{value:g} m is not above 0", field=name))
    if not problems:
        table = table.assign(columns)
        table.attrs = attrs
    return table, problems


def _values(name: str, values: NDArray[np.float64]) -> list[Problem]:
    wrong = {"is not finite": ~np.isfinite(values) & ~(np.isnan(values) & (name == "set_pressure"))}
    if name.endswith("pressure"):
        wrong[f"is below {VACUUM:g} Pa, the gauge pressure of a vacuum"] = values < VACUUM
    if name == "contraction":
        wrong["is not between -1 and 1; contraction is a ratio: divide percent by 100"] = np.abs(values) >= 1
    problems = []
    for what, bad in wrong.items():
        if (count := int(bad.sum())) > 0:
            more = f" (and {count - 1} more)" if count > 1 else ""
            at = int(np.argmax(bad))
            problems.append(Problem(f"{values[at]:g} at sample {at} {what}{more}", field=name))
    return problems
