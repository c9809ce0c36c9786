"""Which points are at given pressures, repeats or directions."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mckibben.errors import RangeError
from mckibben.units import bar


def near(levels: NDArray[np.float64], pressures: ArrayLike, tolerance: float = 1e3) -> NDArray[np.bool_]:
    """The points whose level is within `tolerance` of any of the pressures, all in Pa.

    Raises
    ------
    RangeError
        If there is no point at one of the pressures.
    """
    wanted = np.atleast_1d(np.asarray(pressures, dtype=np.float64)).ravel()
    close = np.abs(levels[:, None] - wanted) <= tolerance
    if len(missing := wanted[~np.any(close, axis=0)]):
        raise RangeError(
            f"there is no point at {listed(missing / bar)} bar",
            value=float(missing[0]),
            unit="Pa",
            remedy=f"the pressures are {listed(np.unique(levels) / bar)} bar" if len(levels) else "",
        )
    return np.asarray(np.any(close, axis=1))


def among(column: np.ndarray, values: ArrayLike, name: str) -> NDArray[np.bool_]:
    """The points whose entry in a column is one of the values; an empty column is one that is not recorded.

    Raises
    ------
    RangeError
        If one of the values is not in the column, or none is given.
    """
    wanted = np.atleast_1d(np.asarray(values)).ravel()
    present = np.unique(column)
    if missing := sorted(set(wanted.tolist()) - set(present.tolist())):
        raise RangeError(
            f"there is no point of {name} {', '.join(map(str, missing))}",
            value=missing[0],
            remedy=f"the {name}s are {listed(present)}" if len(present) else f"no {name} is recorded",
        )
    if not len(wanted):
        raise RangeError(f"no {name} is given", remedy=f"the {name}s are {listed(present)}" if len(present) else "")
    return np.asarray(np.isin(column, wanted))


def listed(values: np.ndarray, most: int = 24) -> str:
    """Numbers or words as text, the first of them where there are many."""
    shown = [value if isinstance(value, str) else f"{value:g}" for value in values[:most].tolist()]
    return ", ".join(shown) + (f", ... ({len(values)} in all)" if len(values) > most else "")
