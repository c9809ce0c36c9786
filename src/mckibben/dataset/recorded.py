"""Files of raw samples to a `Recording`."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from mckibben.dataset.formats import read_sheet
from mckibben.dataset.quantities import OnCorrupt, Quantities
from mckibben.dataset.recording import Recording
from mckibben.errors import DatasetError, Problem

_KEPT = ("time", "pressure", "force", "contraction", "set_pressure")
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
    on_corrupt: OnCorrupt = "raise",
) -> Recording:
    """Read a raw record of a rig from a file of any kind that `read_dataset` reads, by the same names of columns.

    Needed are a pressure and a force. The time may be a column, come from `sample_rate`, or from the waveforms of a
    TDMS file. A length becomes a contraction by the initial length. A file named ``*.nc`` is one that
    `Recording.to_netcdf` wrote.

    Parameters
    ----------
    path, columns, initial_length, specimen, slack_force
        As for `read_dataset`.
    contraction
        At which the muscle was held [-], where the file has neither contractions nor lengths.
    sample_rate
        Of a file without times [Hz].
    on_corrupt
        As for `read_dataset`. The time of samples that are left out remains: they leave a gap.

    Raises
    ------
    DatasetError
        With every problem of the file, its line and column.

    Warns
    -----
    McKibbenWarning
        As `read_dataset`.
    """
    path = Path(path)
    if path.suffix.lower() == ".nc":
        return _from_netcdf(path, columns, initial_length, contraction, specimen, slack_force)
    mapping = {str(header).strip(): str(name) for header, name in (columns or {}).items()}
    sheet = read_sheet(path, mapping)
    file = Quantities(sheet, mapping, initial_length, ("pressure", "force"))
    attrs = file.attributes(path, specimen, slack_force)
    data = {name: values for name, values in file.columns().items() if name in _KEPT}
    file.ignored += [
        sheet.channels[file.places[name][0]].name for name in file.places if name not in (*_KEPT, "length")
    ]
    if "time" not in data and "pressure" in data:
        step = sheet.interval if sample_rate is None else 1 / sample_rate if sample_rate > 0 else None
        if step is None or not np.isfinite(step):
            file.problems.append(Problem("no column for time, and no sample rate", remedy=_RATE_REMEDY))
        else:
            # by the number of the row: one that is left out keeps its place
            rows = np.asarray(file.lines, np.float64)
            data["time"] = (rows - (rows[0] if len(rows) else 0)) * step
    elif sample_rate is not None and "time" in data:
        file.problems.append(Problem("sample_rate is given, and the file has times", remedy="leave sample_rate out"))
    if contraction is not None and "contraction" in data:
        remedy = "leave contraction out"
        file.problems.append(Problem("contraction is given, and the file has its own", remedy=remedy))
    data, found = file.settle(path, data, on_corrupt)
    if contraction is not None:
        data["contraction"] = np.full(len(data["pressure"]), contraction)
    try:
        recording = Recording.of(**data, initial_length=file.initial_length, **attrs)
    except DatasetError as error:  # what an argument brought in
        raise DatasetError(str(path), error.problems) from None
    return Recording(recording.table.assign_attrs(found)) if found else recording


def _from_netcdf(
    path: Path,
    columns: Mapping[str, str] | None,
    initial_length: float | None,
    contraction: float | None,
    specimen: str,
    slack_force: float | None,
) -> Recording:
    if columns:
        raise DatasetError(str(path), [Problem("columns cannot be renamed in NetCDF", remedy="leave columns out")])
    recording = Recording.from_netcdf(path)
    given = {"initial_length": initial_length, "specimen": specimen or None, "slack_force": slack_force}
    table = recording.table.assign_attrs({name: value for name, value in given.items() if value is not None})
    if contraction is not None:
        if "contraction" in table:
            message = "contraction is given, and the file has its own"
            raise DatasetError(str(path), [Problem(message, remedy="leave contraction out")])
        table = table.assign(contraction=("sample", np.full(len(recording), contraction)))
    return Recording(table)
