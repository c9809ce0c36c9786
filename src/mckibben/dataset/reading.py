"""Files of measurements to an `IsobaricDataset`, with all that is wrong in a file said at once."""

from __future__ import annotations

import os
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mckibben.dataset.cells import decimal_sign, read_numbers
from mckibben.dataset.columns import lay_out, recognise
from mckibben.dataset.isobaric import IsobaricDataset
from mckibben.dataset.schema import VACUUM
from mckibben.dataset.sheet import Sheet, read_sheet
from mckibben.dataset.writing import unplain
from mckibben.errors import DatasetError, McKibbenWarning, Problem, UnitError
from mckibben.units import factor, quantity

_LENGTH_REMEDY = "give initial_length (command line: --initial-length '180 mm')"
_LENGTH_ROUNDING = 0.5e-3, 0.002  # m and parts of the initial length: a rule's and a printed table's

_PLAUSIBLE = -0.1, 0.5  # contractions of any muscle

_DIRECTIONS = {
    "loading": ("loading", "load", "stretching", "lengthening"),
    "unloading": ("unloading", "unload", "shortening"),
}
_DIRECTION_OF = {word: direction for direction, words in _DIRECTIONS.items() for word in words}


def read_dataset(
    path: str | os.PathLike[str],
    *,
    columns: Mapping[str, str] | None = None,
    initial_length: float | None = None,
    specimen: str = "",
    slack_force: float | None = None,
) -> IsobaricDataset:
    """Read the points of isobaric tests from a file.

    A file named ``*.nc`` is NetCDF, any other UTF-8 text with a header and one row per point, in cells parted
    by comma, semicolon or tab. Leading lines may be comments; of these ``# key: value`` is read for
    `specimen`, `source`, `initial_length` and `slack_force` (both with a unit). Decimal commas are read where
    the delimiter is no comma.

    Needed are ``pressure_*`` (bar, kPa, MPa, Pa, mbar or psi; gauge), ``force_*`` (N or kN) and
    ``contraction_*`` (percent or ratio) or ``length_*`` (mm, m or cm). Read where present: ``direction``,
    ``repeat``, ``time_*`` (s or ms) and ``set_pressure_*``, which may have empty cells. Other columns are
    named in the attribute ``ignored_columns``.

    Parameters
    ----------
    path
        The file.
    columns
        From a header of the file to one of the names above: ``{"Druck [bar]": "pressure_bar"}``.
    initial_length
        Length of the deflated muscle [m]: needed where the file has lengths and no contractions, and taken
        from the two where it has both.
    specimen
        The make of the muscle; if empty, what the file says.
    slack_force
        A force up to this [N] means that the muscle was slack; if not given, what the file says, or 0.

    Returns
    -------
    IsobaricDataset
        In SI units, the points in the order of the file.

    Raises
    ------
    DatasetError
        With every problem of the file, its line and column.

    Warns
    -----
    McKibbenWarning
        If pressures in Pa never exceed 100, or contractions in percent 0.5: the unit may be wrong. If contractions lie
        where no muscle gets: the initial length, the unit of the lengths or the sign may be.

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
    sheet = read_sheet(path, known=lambda header: header in mapping or recognise(header) is not None)
    file = _Reading(sheet, mapping, initial_length)
    attrs = file.attributes(path, specimen, slack_force)
    data = file.numbers()
    direction = file.directions()
    if file.problems:
        raise DatasetError(str(path), sorted(file.problems, key=lambda problem: problem.line or 0))
    try:
        dataset = IsobaricDataset.of(**data, direction=direction, initial_length=file.initial_length, **attrs)
    except DatasetError as error:  # what an argument brought in
        raise DatasetError(str(path), error.problems) from None
    for text in file.suspicions + _implausible(dataset.contraction):
        warnings.warn(f"{path}: {text}", McKibbenWarning, stacklevel=2)
    ignored = ", ".join(file.ignored)
    return IsobaricDataset(dataset.table.assign_attrs(ignored_columns=ignored)) if ignored else dataset


def _implausible(contraction: NDArray[np.float64]) -> list[str]:
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


class _Reading:
    """One file on its way from cells to SI columns; `problems` and `suspicions` gather as it goes."""

    def __init__(self, sheet: Sheet, mapping: Mapping[str, str], initial_length: float | None) -> None:
        self.sheet = sheet
        self.initial_length = initial_length
        layout = lay_out(sheet.header, sheet.header_line, mapping)
        self.places = layout.places
        self.ignored = layout.ignored
        self.problems = layout.problems + sheet.problems
        self.suspicions: list[str] = []
        self.cells = list(zip(*sheet.rows, strict=True)) or [()] * len(sheet.header)
        numeric = [index for index, column in self.places.values() if column.quantity != "direction"]
        self.decimal = decimal_sign([self.cells[index] for index in numeric], sheet.lines, sheet.delimiter)

    def attributes(self, path: Path, specimen: str, slack_force: float | None) -> dict[str, Any]:
        """The attributes from the comments, where no argument is given instead."""
        comments = self.sheet.comments
        found: dict[str, float] = {}
        for key, unit in (("initial_length", "m"), ("slack_force", "N")):
            line, text = comments.get(key, (0, ""))
            try:
                found |= {key: quantity(text, unit)} if text else {}
            except UnitError as error:
                self._problem(str(error), line, key)
        if self.initial_length is None:
            self.initial_length = found.get("initial_length")
        return {
            "specimen": specimen or unplain(comments.get("specimen", (0, ""))[1]),
            "source": unplain(comments["source"][1]) if "source" in comments else path.name,
            "slack_force": found.get("slack_force", 0.0) if slack_force is None else slack_force,
        }

    def numbers(self) -> dict[str, NDArray[np.float64]]:
        """The columns of numbers in SI units, with lengths turned into contractions."""
        data = {name: self._numbers(name) for name in self.places if name != "direction"}
        if (length := data.pop("length", None)) is not None:
            if "contraction" in data:
                self._compare(data["contraction"], length)
            else:
                data["contraction"] = self._contraction(length)
        return data

    def directions(self) -> NDArray[np.str_] | None:
        """The directions in our words, if the file has them."""
        if "direction" not in self.places:
            return None
        cells = self.cells[self.places["direction"][0]]
        meaning = {text: _DIRECTION_OF.get(text.strip().lower(), "") for text in set(cells)}
        for line, text in zip(self.sheet.lines, cells, strict=True):
            if not meaning[text]:
                shown = repr(text.strip()[:40]) if text.strip() else "an empty cell"
                remedy = "write loading (being stretched) or unloading (shortening)"
                self._problem(f"{shown} is not a direction", line, "direction", remedy)
        return np.array([meaning[text] for text in cells], dtype="<U9")

    def _problem(self, message: str, line: int | None, name: str, remedy: str = "") -> None:
        """Record a problem in the column of a quantity, or with an attribute."""
        field = self.sheet.header[self.places[name][0]] if name in self.places else name
        self.problems.append(Problem(message, line=line, field=field, remedy=remedy))

    def _numbers(self, name: str) -> NDArray[np.float64]:
        index, column = self.places[name]
        header = self.sheet.header[index]
        values, problems = read_numbers(
            self.cells[index],
            self.sheet.lines,
            field=header,
            decimal=self.decimal,
            may_be_empty=name == "set_pressure",
        )
        self.problems += problems
        with np.errstate(over="ignore"):
            si = values * factor(column.unit) if column.unit else values
        unit = f" {column.unit}" if column.unit else ""
        self._refuse(name, values, np.isinf(si), f"{{:g}}{unit} is too large")
        if column.quantity.endswith("pressure"):
            vacuum = f"a vacuum ({VACUUM / factor(column.unit):.5g}{unit}, gauge)"
            self._refuse(name, values, si < VACUUM, f"{{:g}}{unit} is below {vacuum}")
            if column.unit == "Pa" and 0 < np.nanmax(np.abs(si), initial=0.0) <= 100:
                self.suspicions.append(f"{header} never exceeds 100 Pa; if these are bar, name it {name}_bar")
        elif name == "contraction" and column.unit == "ratio":
            remedy = "this looks like percent: name the column contraction_percent"
            self._refuse(name, values, np.abs(si) >= 1, "{:g} is not between -1 and 1", remedy)
        elif name == "contraction":
            self._refuse(name, values, np.abs(si) >= 1, "{:g} % is not between -100 and 100 %")
            if np.nanmax(np.abs(values), initial=0.0) <= 0.5 and len(np.unique(values)) > 3:
                meant = "if these are ratios, name it contraction_ratio"
                self.suspicions.append(f"{header} never exceeds 0.5 %; {meant}")
        elif name == "length":
            self._refuse(name, values, si <= 0, f"{{:g}}{unit} is not above 0")
        elif name == "repeat":
            # beyond 2**53 a float no longer tells one integer from the next
            wrong = (si < 0) | (si != np.round(si)) | (si > 2**53)
            self._refuse(name, values, wrong & ~np.isnan(si), "{:g} is not an integer from 0 up")
        return si

    def _refuse(
        self, name: str, values: NDArray[np.float64], bad: NDArray[np.bool_], message: str, remedy: str = ""
    ) -> None:
        for row in np.flatnonzero(bad):
            self._problem(message.format(values[row]), self.sheet.lines[row], name, remedy)

    def _contraction(self, length: NDArray[np.float64]) -> NDArray[np.float64]:
        initial = self.initial_length
        if initial is None or not (np.isfinite(initial) and initial > 0):
            what = "is needed for lengths" if initial is None else f"{initial:g} m is not a positive length"
            self._problem(what, None, "initial_length", _LENGTH_REMEDY)
            return length
        contraction = 1 - length / initial
        for row in np.flatnonzero((np.abs(contraction) >= 1) & (length > 0)):
            times = f"{length[row]:g} m is {length[row] / initial:.3g} times the initial length"
            self._problem(times, self.sheet.lines[row], "length", "check its unit and initial_length")
        return contraction

    def _compare(self, contraction: NDArray[np.float64], length: NDArray[np.float64]) -> None:
        """Find the initial length that contractions and lengths agree on, and the rows that do not."""
        usable = np.isfinite(contraction) & np.isfinite(length) & (np.abs(contraction) < 1) & (length > 0)
        if not usable.any():
            return
        agreed = round(float(np.median(length[usable] / (1 - contraction[usable]))), 9)
        rounding, relative = _LENGTH_ROUNDING
        tolerance = max(rounding, relative * agreed)
        if self.initial_length is None:
            self.initial_length = agreed
        elif not abs(self.initial_length - agreed) <= tolerance:
            text = f"{self.initial_length:g} m is given, but lengths and contractions agree on {agreed:g} m"
            self._problem(text, None, "initial_length")
        expected = agreed * (1 - contraction)
        for row in np.flatnonzero(usable & (np.abs(length - expected) > tolerance)):
            given = f"{length[row]:g} m does not go with contraction {contraction[row]:g}"
            self._problem(f"{given} of {agreed:g} m: {expected[row]:.4g} m would", self.sheet.lines[row], "length")
