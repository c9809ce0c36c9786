"""Files of measurements to an `IsobaricDataset`, with all that is wrong in a file said at once."""

from __future__ import annotations

import os
import warnings
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mckibben.dataset.formats import read_sheet
from mckibben.dataset.isobaric import IsobaricDataset
from mckibben.dataset.quantities import OnCorrupt, Quantities
from mckibben.errors import DatasetError, McKibbenWarning, Problem

_NEEDED = ("pressure", "contraction", "force")
_PLAUSIBLE = -0.1, 0.5  # contractions of any muscle


def read_dataset(
    path: str | os.PathLike[str],
    *,
    columns: Mapping[str, str] | None = None,
    initial_length: float | None = None,
    specimen: str = "",
    slack_force: float | None = None,
    on_corrupt: OnCorrupt = "raise",
) -> IsobaricDataset:
    """Read the points of isobaric tests from a file.

    A file named ``*.nc`` is NetCDF. Others are known by their first bytes: Excel (.xlsx), MATLAB (.mat), TDMS, HDF5,
    and text with a header and one row per point, in cells parted by comma, semicolon, tab or white space. Leading
    lines of a text may be comments; of these ``# key: value`` is read for `specimen`, `source`, `initial_length` and
    `slack_force` (both with a unit). Decimal commas are read where the delimiter is no comma.

    Needed are ``pressure_*`` (bar, kPa, MPa, Pa, mbar or psi; gauge), ``force_*`` (N or kN) and
    ``contraction_*`` (percent or ratio) or ``length_*`` (mm, m or cm). Read where present: ``direction``, ``phase``,
    ``repeat``, ``time_*`` (s, ms or min) and ``set_pressure_*``, which may have empty cells. ``Pressure [bar]``,
    ``p / kPa`` and the like say the same, as do units in a row under the header or in the properties of a channel.
    Other columns are named in the attribute ``ignored_columns``.

    Parameters
    ----------
    path
        The file.
    columns
        From a header of the file to one of the names above: ``{"Druck [bar]": "pressure_bar"}``. In files with
        groups or structs: ``group/channel``, ``struct.field``, ``matrix(:,2)``, ``sheet/header``.
    initial_length
        Length of the deflated muscle [m]: needed where the file has lengths and no contractions, and taken
        from the two where it has both.
    specimen
        The make of the muscle; if empty, what the file says.
    slack_force
        A force up to this [N] means that the muscle was slack; if not given, what the file says, or 0.
    on_corrupt
        "raise": a row that is cut off, or a cell that holds no number, is an error. "report": such rows are left out,
        a warning counts them, and the attribute ``repairs`` names every one.

    Returns
    -------
    IsobaricDataset
        In SI units, the points in the order of the file.

    Raises
    ------
    DatasetError
        With every problem of the file, its line and column. If more than half of the rows are corrupt, also under
        "report".

    Warns
    -----
    McKibbenWarning
        If pressures in Pa never exceed 100, or contractions in percent 0.5: the unit may be wrong. If contractions lie
        where no muscle gets: the initial length, the unit of the lengths or the sign may be. If rows are left out.

    Notes
    -----
    A direction is loading (also load, stretching, lengthening) or unloading (unload, shortening). The numbers
    1 and -1 are refused: which is which is a convention (Hunt 2017 has +1 for shortening), and the sign of
    the hysteresis hangs on it.
    """
    path = Path(path)
    if path.suffix.lower() == ".nc":
        return _from_netcdf(path, columns, initial_length, specimen, slack_force)
    mapping = {str(header).strip(): str(name) for header, name in (columns or {}).items()}
    file = Quantities(read_sheet(path, mapping), mapping, initial_length, _NEEDED)
    attrs = file.attributes(path, specimen, slack_force)
    data, found = file.settle(path, file.columns(), on_corrupt)
    try:
        dataset = IsobaricDataset.of(**data, initial_length=file.initial_length, **attrs)
    except DatasetError as error:  # what an argument brought in
        raise DatasetError(str(path), error.problems) from None
    for text in _implausible(dataset.contraction):
        warnings.warn(f"{path}: {text}", McKibbenWarning, stacklevel=2)
    return IsobaricDataset(dataset.table.assign_attrs(found)) if found else dataset


def _implausible(contraction: NDArray[np.float64]) -> list[str]:
    if not len(contraction):
        return []
    low, high = float(contraction.min()), float(contraction.max())
    if low >= _PLAUSIBLE[0] and high <= _PLAUSIBLE[1]:
        return []
    return [
        f"contractions reach from {low * 100:.3g} to {high * 100:.3g} %, and a muscle stretches by a few percent and "
        "shortens by 25 to 35; check the initial length, the unit of the lengths, and the sign (positive = shorter)"
    ]


def _from_netcdf(
    path: Path,
    columns: Mapping[str, str] | None,
    initial_length: float | None,
    specimen: str,
    slack_force: float | None,
) -> IsobaricDataset:
    if columns:
        raise DatasetError(str(path), [Problem("columns cannot be renamed in NetCDF", remedy="leave columns out")])
    dataset = IsobaricDataset.from_netcdf(path)
    given = {"initial_length": initial_length, "specimen": specimen or None, "slack_force": slack_force}
    changes = {name: value for name, value in given.items() if value is not None}
    return IsobaricDataset(dataset.table.assign_attrs(changes)) if changes else dataset
