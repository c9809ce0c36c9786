"""What the table of an isobaric dataset holds, and the check that a table does."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from mckibben.errors import Problem

VACUUM = -101325.0
"""The lowest gauge pressure there is [Pa]: absolute zero below a standard atmosphere."""

WORDS: Mapping[str, tuple[str, ...]] = {"direction": ("loading", "unloading"), "phase": ("filling", "venting")}
"""The variables that hold words, and these; an empty text is a point of which it is not known."""


class Variable(NamedTuple):
    """One variable of the table."""

    unit: str
    long_name: str
    required: bool = False
    dims: tuple[str, ...] = ("point",)


VARIABLES: Mapping[str, Variable] = {
    "pressure": Variable("Pa", "gauge pressure", required=True),
    "contraction": Variable("1", "contraction, positive when shorter", required=True),
    "force": Variable("N", "axial pull", required=True),
    "direction": Variable("1", "loading (being stretched) or unloading (shortening)"),
    "phase": Variable("1", "filling or venting at a fixed length"),
    "repeat": Variable("1", "number of the repeat"),
    "time": Variable("s", "time since the start of the test"),
    "set_pressure": Variable("Pa", "nominal gauge pressure"),
    "force_samples": Variable("N", "axial pull, raw samples", dims=("point", "sample")),
    "pressure_samples": Variable("Pa", "gauge pressure, raw samples", dims=("point", "sample")),
    "force_spread": Variable("N", "standard deviation of the force over the samples"),
}


def conform(table: xr.Dataset) -> tuple[xr.Dataset, list[Problem]]:
    """Bring a table to the one form that an `IsobaricDataset` holds.

    Columns become float64 (`repeat` int64, `direction` and `phase` text) and read-only; float32 samples stay so, and
    samples are not copied. Every variable gets its `units` and `long_name`, the table its four attributes.
    Variables that are not ours pass through.

    Returns
    -------
    table
        In that form; of use only where there are no problems.
    problems
        All that is wrong, each with the name of its variable or attribute.
    """
    problems = list(_structure(table))
    if problems:
        return table, problems
    columns: dict[str, tuple[tuple[str, ...], np.ndarray, dict[str, str]]] = {}
    for name, variable in VARIABLES.items():
        if name in table:
            values = _settled(name, table[name].to_numpy())
            problems += _values(name, values)
            columns[name] = (variable.dims, values, {"units": variable.unit, "long_name": variable.long_name})
    attrs = dict(table.attrs)
    for name in ("specimen", "source"):
        attrs[name] = str(attrs.get(name, ""))
    for name, default in (("slack_force", 0.0), ("initial_length", None)):
        value = attrs.get(name, default)
        if value is None:
            attrs.pop(name, None)
            continue
        number = _finite(value)
        if number is None:
            problems.append(Problem(f"{value!r} is not a finite number", field=name))
        elif name == "initial_length" and number <= 0:
            problems.append(Problem(f"{number:g} m is not above 0", field=name))
        else:
            attrs[name] = number
    if not problems:
        table = table.assign(columns)
        table.attrs = attrs
    return table, problems


def assemble(variables: Mapping[str, ArrayLike]) -> tuple[xr.Dataset, list[Problem]]:
    """Make a table of array-likes by name.

    Returns
    -------
    table
        Empty if there are problems.
    problems
        The variables whose shapes do not go together.
    """
    arrays: dict[str, np.ndarray] = {}
    problems: list[Problem] = []
    for name, values in variables.items():
        try:
            arrays[name] = np.asarray(values)
        except ValueError:
            problems.append(Problem("has rows of unequal length", field=name))
    points = arrays["pressure"].size if "pressure" in arrays else 0
    found = (_shape_problem(name, array.shape, points) for name, array in arrays.items())
    problems += [problem for problem in found if problem is not None]
    counts = {array.shape[1] for array in arrays.values() if array.ndim == 2}
    if not problems and len(counts) > 1:
        problems.append(Problem("has another number of samples than force_samples", field="pressure_samples"))
    if problems:
        return xr.Dataset(), problems
    return xr.Dataset({name: (VARIABLES[name].dims, array) for name, array in arrays.items()}), []


def _shape_problem(name: str, shape: tuple[int, ...], points: int) -> Problem | None:
    dims = VARIABLES[name].dims
    if len(shape) != len(dims):
        return Problem(f"has {len(shape)} dimensions instead of {len(dims)} ({', '.join(dims)})", field=name)
    if shape[0] != points:
        return Problem(f"has {shape[0]} values for {points} points", field=name)
    if len(shape) == 2 and not shape[1]:
        return Problem("has no samples", field=name)
    return None


def _structure(table: xr.Dataset) -> Iterator[Problem]:
    points = table.sizes.get("point", 0)
    for name, variable in VARIABLES.items():
        if name not in table:
            if variable.required:
                yield Problem("is missing", field=name)
            continue
        array = table[name]
        problem = _shape_problem(name, array.shape, points)
        if problem is None and array.dims != variable.dims:
            problem = Problem(f"has dimensions {array.dims} instead of {variable.dims}", field=name)
        if problem is not None:
            yield problem
        elif array.size and array.dtype.kind not in ("UOT" if name in WORDS else "fiu"):
            what = " and ".join(WORDS.get(name, ("numbers",)))
            yield Problem(f"holds something else than {what}", field=name)
        if (unit := array.attrs.get("units", variable.unit)) != variable.unit:
            yield Problem(f"is in {unit!r}", field=name, remedy=f"give it in {variable.unit!r}")


def _settled(name: str, values: np.ndarray) -> np.ndarray:
    if name.endswith("_samples"):
        settled = values.view() if values.dtype == np.float32 else np.asarray(values, np.float64).view()
    elif name in WORDS:
        settled = np.array(values, dtype="<U9") if _words(name, values) else np.array(values, dtype=str)
    elif name == "repeat" and np.all(np.isfinite(values) & (values == np.round(values))):
        settled = np.array(values, dtype=np.int64)
    else:
        settled = np.array(values, dtype=np.float64)
    settled.setflags(write=False)
    return settled


def _words(name: str, values: np.ndarray) -> bool:
    return bool(np.isin(values.astype(str), [*WORDS[name], ""]).all())


def _values(name: str, values: np.ndarray) -> Iterator[Problem]:
    if name in WORDS:
        if (bad := ~np.isin(values, [*WORDS[name], ""])).any():
            yield _first(bad, values, name, "is neither " + " nor ".join(map(repr, WORDS[name])))
        return
    finite = np.isfinite(values)
    if name == "set_pressure":
        finite |= np.isnan(values)  # not known for this point
    if not finite.all():
        yield _first(~finite, values, name, "is not finite")
    if "pressure" in name and (bad := values < VACUUM).any():
        yield _first(bad, values, name, f"is below {VACUUM:g} Pa, the gauge pressure of a vacuum")
    if name == "contraction" and (bad := finite & (np.abs(values) >= 1)).any():
        yield _first(bad, values, name, "is not between -1 and 1", "contraction is a ratio: divide percent by 100")
    if name == "repeat" and (bad := finite & ((values < 0) | (values != np.round(values)))).any():
        yield _first(bad, values, name, "is not an integer from 0 up")


def _first(bad: np.ndarray, values: np.ndarray, name: str, what: str, remedy: str = "") -> Problem:
    at = tuple(int(index) for index in np.argwhere(bad)[0])
    count = int(bad.sum())
    more = f" (and {count - 1} more)" if count > 1 else ""
    value = values[at].item()
    shown = f"{value:g}" if isinstance(value, float) else repr(value)
    return Problem(f"{shown} at point {at[0]} {what}{more}", field=name, remedy=remedy)


def _finite(value: object) -> float | None:
    try:
        number = float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError, OverflowError):
        return None
    return number if math.isfinite(number) else None


def spanned(values: np.ndarray) -> str:
    """From the least to the largest of some values, as text.

    >>> spanned(np.array([1.0, 2.5])), spanned(np.array([3.0, 3.0]))
    ('1..2.5', '3')
    """
    low, high = f"{values.min():.4g}", f"{values.max():.4g}"
    return low if low == high else f"{low}..{high}"
