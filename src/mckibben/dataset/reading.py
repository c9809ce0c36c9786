"""Readers of measurement files that report all errors of a file at once."""

from __future__ import annotations

import os
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from mckibben.component.checks import check_number
from mckibben.dataset.formats import read_table
from mckibben.dataset.isobaric import IsobaricDataset
from mckibben.dataset.plausibility import check_points
from mckibben.dataset.preprocessing import preprocess
from mckibben.dataset.quantities import ColumnConverter, Decimal, OnCorrupt
from mckibben.dataset.recording import Recording
from mckibben.dataset.schema import written_by_us
from mckibben.errors import DatasetError, McKibbenWarning, Problem, RangeError
from mckibben.muscle import Specimen

_NEEDED = ("pressure", "contraction", "force")


def read_dataset(
    path: str | os.PathLike[str],
    *,
    columns: Mapping[str, str] | None = None,
    initial_length: float | None = None,
    specimen: str = "",
    slack_force: float | None = None,
    force_sign: int = 1,
    on_corrupt: OnCorrupt = "raise",
    decimal: Decimal = "",
) -> IsobaricDataset:
    """Read the points of isobaric tests from a file.

    A file named ``*.nc`` is NetCDF. Others are recognised by their first bytes: Excel (.xlsx), MATLAB (.mat), TDMS,
    HDF5, and text with a header and one row per point, delimited by comma, semicolon, tab or white space. Leading lines
    of a text may be comments; ``# key: value`` is read for `specimen`, `source`, `initial_length` and `slack_force`
    (both with a unit). Decimal commas are read unless the delimiter is a comma.

    Required are ``pressure_*`` (bar, kPa, MPa, Pa, mbar or psi; gauge), ``force_*`` (N or kN) and
    ``contraction_*`` (percent or ratio) or ``length_*`` (mm, m or cm). Read where present: ``direction`` (loading,
    unloading or a synonym; 1 and -1 are refused, as their meaning differs), ``phase``, ``repeat``, ``time_*`` (s, ms or
    min) and ``set_pressure_*``, which may have empty cells. ``Pressure [bar]``, ``p / kPa`` etc. are equivalent, as are
    units in a row under the header or in the properties of a channel. Other columns are listed in the attribute
    ``ignored_columns``.

    If the file does not give them, pressure levels are estimated from gaps between the pressures, directions and
    repeats from reversals of the contraction in row order, and the force of the slack muscle from its noise; the
    attribute ``preprocessing`` lists the estimates.

    Parameters
    ----------
    columns
        Header of the file to one of the names above: ``{"Druck [bar]": "pressure_bar"}``. In files with
        groups or structs: ``group/channel``, ``struct.field``, ``matrix(:,2)``, ``sheet/header``.
    initial_length
        Length of the deflated muscle [m]: required if the file has lengths but no contractions, inferred if it has
        both.
    specimen, slack_force
        Type of the muscle, and force [N] up to which it counts as slack. Default: from the file, or from the noise of
        the slack muscle, whose mean force is subtracted.
    force_sign
        -1 for a load cell that reads a pull as negative.
    on_corrupt
        "raise": a truncated row, or a cell without a number, is an error. "report": such rows are left out with a
        warning, and the attribute ``repairs`` lists them.
    decimal
        Decimal sign of texts, "." or ",". Default: of the first number that determines it; if there is none, a number
        such as 1.234 is an error, which gives both readings.

    Raises
    ------
    DatasetError
        With every problem of the file, its line and column; also if more than half of the rows are corrupt, or the
        points are impossible for a muscle: negative forces, or a wrong unit or initial length.
    RangeError
        If an argument is a text in place of a number in SI units, or `force_sign` is neither.

    Warns
    -----
    McKibbenWarning
        If forces, pressures or contractions are unusual for a muscle, or rows are left out.
    """
    _check_arguments(force_sign, decimal, initial_length=initial_length, slack_force=slack_force)
    path = Path(path)
    if path.suffix.lower() == ".nc":
        given = {"initial_length": initial_length, "specimen": specimen, "slack_force": slack_force}
        found = _from_netcdf(IsobaricDataset, path, columns, force_sign, given)
        return check_dataset(found, str(path), only_warn=True)
    mapping = {str(header).strip(): str(name) for header, name in (columns or {}).items()}
    file = ColumnConverter(read_table(path, mapping, decimal), mapping, initial_length, _NEEDED, decimal)
    attrs = file.attributes(path, specimen, slack_force)
    slack_known = slack_force is not None or "slack_force" in file.sheet.comments
    data, found = file.settle(path, file.columns(force_sign), on_corrupt)
    dataset = _made(IsobaricDataset, path, data, {"initial_length": file.initial_length, **attrs}, found)
    ours = written_by_us(file.sheet.names, file.sheet.comments)
    del file, data  # of a large file
    if ours:
        return check_dataset(dataset, str(path), only_warn=True)
    return check_dataset(IsobaricDataset(preprocess(dataset.table, slack_known=slack_known)), str(path))


def check_dataset(
    dataset: IsobaricDataset, source: str, specimen: Specimen | None = None, *, only_warn: bool = False
) -> IsobaricDataset:
    """Check a dataset; raises a `DatasetError` for points impossible for a muscle, and warns of unusual ones.

    With `only_warn`, impossible points cause warnings too: what this program wrote stays readable.
    """
    attrs = dataset.table.attrs
    found = check_points(
        dataset.pressure,
        dataset.contraction,
        dataset.force,
        attrs["slack_force"],
        attrs.get("initial_length"),
        specimen,
    )
    if found.problems and not only_warn:
        raise DatasetError(source, found.problems)
    for text in [*map(str, found.problems), *found.warnings]:
        warnings.warn(f"{source}: {text}", McKibbenWarning, stacklevel=3)
    return dataset


Kind = TypeVar("Kind", IsobaricDataset, Recording)


def _made(
    kind: type[Kind], path: Path, data: Mapping[str, Any], attrs: Mapping[str, Any], found: Mapping[str, str]
) -> Kind:
    """Dataset or recording from the columns of a file; an argument error names the file."""
    try:
        made = kind.of(**data, **attrs)
    except DatasetError as error:
        raise DatasetError(str(path), error.problems) from None
    return kind(made.table.assign_attrs(found)) if found else made


def _check_arguments(force_sign: int, decimal: str, **numbers: object) -> None:
    """Raise `RangeError` for texts in place of numbers, and for an invalid sign."""
    if decimal not in ("", ".", ","):
        remedy = "give decimal='.' or decimal=',' (command line: --decimal)"
        raise RangeError(f"decimal is {decimal!r}", field="decimal", value=decimal, remedy=remedy)
    check_number("reading", **numbers)
    if force_sign not in (1, -1):
        remedy = "give 1 or -1 (command line: --force-sign)"
        raise RangeError(f"force_sign is {force_sign!r}", field="force_sign", value=force_sign, remedy=remedy)


def _from_netcdf(
    kind: type[Kind], path: Path, columns: Mapping[str, str] | None, force_sign: int, given: Mapping[str, Any]
) -> Kind:
    """Dataset or recording of a NetCDF file, with the given sign and attributes."""
    if columns:
        raise DatasetError(str(path), [Problem("columns cannot be renamed in NetCDF", remedy="leave columns out")])
    found = kind.from_netcdf(path)
    changes = {name: value for name, value in given.items() if value not in (None, "")}
    if force_sign < 0:
        found = kind(found.table.assign(force=-found.table["force"]))
    return kind(found.table.assign_attrs(changes)) if changes else found


_KEPT = ("time", "pressure", "force", "contraction", "set_pressure")
_OWN_CONTRACTION = "contraction is given, but the file has its own"
_RATE_REMEDY = "give sample_rate (command line: --sample-rate '1000 Hz'), or a column time_s, time_ms or time_min"


def read_recording(
    path: str | os.PathLike[str],
    *,
    columns: Mapping[str, str] | None = None,
    initial_length: float | None = None,
    contraction: float | None = None,
    sample_rate: float | None = None,
    specimen: str = "",
    slack_force: float | None = None,
    force_sign: int = 1,
    on_corrupt: OnCorrupt = "raise",
    decimal: Decimal = "",
) -> Recording:
    """Read a raw recording from a file of any format of `read_dataset`, with its columns and arguments.

    Required are pressure and force. The time is a column, or follows from `sample_rate` or the waveforms of a TDMS
    file. A length is converted to a contraction. A file named ``*.nc`` was written by `Recording.to_netcdf`.

    Parameters
    ----------
    contraction
        Contraction of the test [-], if the file has neither contractions nor lengths.
    sample_rate
        Sample rate [Hz] of a file without times.
    on_corrupt, decimal
        As for `read_dataset`. Omitted samples leave a gap in time.

    Raises
    ------
    DatasetError, RangeError
        As `read_dataset`, with the same warnings.
    """
    ratios_and_rates = {"contraction": contraction, "sample_rate": sample_rate}
    _check_arguments(force_sign, decimal, initial_length=initial_length, slack_force=slack_force, **ratios_and_rates)
    path = Path(path)
    if path.suffix.lower() == ".nc":
        given = {"initial_length": initial_length, "specimen": specimen, "slack_force": slack_force}
        found = _from_netcdf(Recording, path, columns, force_sign, given)
        if contraction is None:
            return found
        if "contraction" in found.table:
            raise DatasetError(str(path), [Problem(_OWN_CONTRACTION, remedy="leave contraction out")])
        return Recording(found.table.assign(contraction=("sample", np.full(len(found), contraction))))
    mapping = {str(header).strip(): str(name) for header, name in (columns or {}).items()}
    sheet = read_table(path, mapping, decimal)
    file = ColumnConverter(sheet, mapping, initial_length, ("pressure", "force"), decimal)
    attrs = file.attributes(path, specimen, slack_force)
    data = {name: values for name, values in file.columns(force_sign).items() if name in _KEPT}
    file.ignored += [
        sheet.channels[file.places[name][0]].name for name in file.places if name not in (*_KEPT, "length")
    ]
    if "time" not in data and "pressure" in data:
        step = sheet.interval if sample_rate is None else 1 / sample_rate if sample_rate > 0 else None
        if step is None or not np.isfinite(step):
            file.problems.append(Problem("no column for time, and no sample rate", remedy=_RATE_REMEDY))
        else:
            # by row number: omitted rows keep their time
            rows = file.line_numbers().astype(np.float64)
            data["time"] = (rows - (rows[0] if len(rows) else 0)) * step
    elif sample_rate is not None and "time" in data:
        file.problems.append(Problem("sample_rate is given, but the file has times", remedy="leave sample_rate out"))
    if contraction is not None and "contraction" in data:
        file.problems.append(Problem(_OWN_CONTRACTION, remedy="leave contraction out"))
    data, found = file.settle(path, data, on_corrupt)
    if contraction is not None:
        data["contraction"] = np.full(len(data["pressure"]), contraction)
    return _made(Recording, path, data, {"initial_length": file.initial_length, **attrs}, found)
