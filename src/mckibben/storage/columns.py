"""Samples over time in CSV files with a header of names and units, such as ``time_s,angle_deg``."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from mckibben.errors import Problem, ScenarioError, UnitError
from mckibben.units import factor

if TYPE_CHECKING:
    import pandas as pd


def read_columns(
    path: Path, units_of: Callable[[list[str]], Mapping[str, str]], *, largest: float = 64 * 2**20
) -> tuple[NDArray[np.float64], dict[str, NDArray[np.float64]]]:
    r"""Read columns titled NAME_UNIT of a CSV file with rising times.

        >>> from tempfile import TemporaryDirectory
        >>> with TemporaryDirectory() as folder:
        ...     path = Path(folder) / "reference.csv"
        ...     _ = path.write_text("time_ms,force_kN\n0,1\n500,2")
        ...     times, columns = read_columns(path, lambda titles: {"force": "N"})
        >>> times, columns["force"]
        (array([0. , 0.5]), array([1000., 2000.]))

    Parameters
    ----------
    units_of
        Names and units of the columns to read, for the titles of a file.
    largest
        Size of the largest file that is read [bytes].

    Returns
    -------
    times, columns
        Times [s], shape (samples,), and the values of the columns by name, in the units asked for.

    Raises
    ------
    ScenarioError
        With the line of each row that lacks a finite number or does not follow in time, or the missing columns.
    """
    import pandas as pd  # slow

    try:
        if path.stat().st_size > largest:
            raise ScenarioError(str(path), [Problem(f"is larger than {largest / 2**20:g} MiB")])
        table = pd.read_csv(path, encoding="utf-8-sig", dtype=str, index_col=False, skip_blank_lines=False)
    except (OSError, ValueError) as error:  # pandas' errors are ValueErrors
        raise ScenarioError(str(path), [Problem(f"cannot be read: {error}", remedy="give a CSV file")]) from None
    titles = [str(title).strip() for title in table.columns]
    units = {"time": "s", **units_of(titles)}
    problems: list[Problem] = []
    numbers = {name: _column(table.set_axis(titles, axis=1), name, unit, problems) for name, unit in units.items()}
    if problems:
        raise ScenarioError(str(path), problems)
    rows = pd.DataFrame(numbers)[table.notna().any(axis=1)]
    whole = np.isfinite(rows.to_numpy(float)).all(axis=1)
    complete = rows[whole]
    behind = complete.index[complete["time"] <= complete["time"].cummax().shift()]
    problems = [
        Problem(f"does not hold {len(units)} finite numbers", line + 2)
        for line in rows.index.to_numpy()[~whole].tolist()
    ]
    problems += [Problem("the time does not rise", line + 2, remedy="sort the rows") for line in behind]
    if rows.empty:
        problems.append(Problem("holds no samples"))
    if problems:
        raise ScenarioError(str(path), sorted(problems, key=lambda problem: problem.line or 0))
    times, *columns = (rows[name].to_numpy(float) for name in units)
    return times, dict(zip(list(units)[1:], columns, strict=True))


def _column(table: pd.DataFrame, name: str, unit: str, problems: list[Problem]) -> pd.Series:
    """Numbers of the column of a quantity, in a unit; NaN for other texts."""
    import pandas as pd

    titles = [title for title in table.columns if title.startswith(f"{name}_")]
    if len(titles) != 1:
        what = "has several columns" if titles else "has no column"
        problems.append(Problem(f"{what} {name}_...", 1, remedy=f"title one column {name}_{unit}"))
        return pd.Series(dtype=float)
    try:
        return pd.to_numeric(table[titles[0]], errors="coerce") * factor(titles[0][len(name) + 1 :], unit)
    except UnitError as error:
        problems.append(Problem.of(error, 1, titles[0]))
        return pd.Series(dtype=float)
