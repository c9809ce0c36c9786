"""Inverse table of a test at constant loads: the pressure that holds a load at a contraction, as measured."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable
from pathlib import Path
from typing import ClassVar

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from mckibben.component.calls import checked_call
from mckibben.dataset import IsobaricDataset
from mckibben.dataset.preprocessing import held_loads
from mckibben.errors import IdentificationError
from mckibben.identification.estimator import Floats
from mckibben.result import Remark, Result, column
from mckibben.storage.files import atomic_write
from mckibben.units import show
from mckibben.version import __version__


class InverseTable(Result):
    """Pressure over contraction, load and direction; returned by `inverse_table`.

    Attributes
    ----------
    load, direction, contraction, pressure
        Points of the curves of all loads [N] and directions, shape (points,): gauge pressures [Pa] over ascending
        contractions [-].
    rmse
        RMSE of the pressure [Pa] at points that are left out: of one repeat after the other, or every fifth point.
    load_rmse
        The same at inner loads that are left out [Pa]; NaN with fewer than three loads.
    directed
        Whether the directions were known; else both have the mean pressures.
    """

    files: ClassVar = ("inverse.csv", "inverse.h")

    load: Floats = column("N", "load")
    direction: np.ndarray = column("", "direction")
    contraction: Floats = column("1", "contraction", "percent", digits=5)
    pressure: Floats = column("Pa", "pressure", "bar", digits=5)
    rmse: float = column("Pa", "RMSE at held-out points", "bar", digits=3, default=np.nan)
    load_rmse: float = column("Pa", "RMSE at held-out loads", "bar", digits=3, default=np.nan)
    directed: bool = True

    def verdict(self) -> str:
        """Return loads and error."""
        loads = ", ".join(f"{load:.4g}" for load in np.unique(self.load))
        return f"pressure over contraction at {loads} N: {show(self.rmse, 'bar', 3)} at held-out points (RMSE)"

    def remarks(self) -> Iterable[Remark]:
        """Return a warning of unknown directions."""
        if not self.directed:
            text = "the directions are not known: the pressures are the same for shortening and lengthening"
            yield Remark.warning(
                "direction", text, "give the direction of each point, or rows in the order of the test"
            )

    def pressure_for(self, contraction: ArrayLike, load: ArrayLike, direction: str) -> Floats:
        """Return the gauge pressure [Pa] at contractions [-] and loads [N], linear in both; they broadcast.

        NaN off the measured curves. The `direction` is "unloading" (shortening) or "loading" (lengthening).
        """
        contraction, load = np.broadcast_arrays(np.asarray(contraction, float), np.asarray(load, float))
        pressure, loads, curves = np.full(load.shape, np.nan), np.unique(self.load), []
        for held in loads:
            rows = (self.load == held) & (self.direction == direction)
            curve = self.contraction[rows], self.pressure[rows]
            curves.append(np.interp(contraction, *curve, left=np.nan, right=np.nan) if rows.any() else pressure)
        for low, high, below, above in zip(loads, loads[1:], curves, curves[1:], strict=False):
            share = (load - low) / (high - low)
            pressure = np.where((share > 0) & (share < 1), (1 - share) * below + share * above, pressure)
        return np.select([load == held for held in loads], curves, pressure)

    def write(self, folder: Path) -> None:
        """Write the table as CSV, and as a C header with its interpolation, with six digits."""
        from mckibben.codegen.templates import filled  # 25 ms

        names = {"load": "load_N", "contraction": "contraction_ratio", "pressure": "pressure_Pa"}
        columns = {name: getattr(self, name) for name in ("load", "direction", "contraction", "pressure")}
        columns |= {name: np.array([float(f"{value:.6g}") for value in columns[name]]) for name in names}
        loads, row = np.unique(columns["load"], return_inverse=True)
        starts = np.searchsorted(2 * row + (self.direction == "loading"), np.arange(2 * len(loads) + 1))
        values = {"loads": loads.tolist(), "starts": starts.tolist(), "rmse": f"{self.rmse:.3g}"}
        values |= {name: columns[name].tolist() for name in ("contraction", "pressure")}
        header = filled("inverse.h", values | {"version": __version__}, "mckibben.identification")
        table = pd.DataFrame(columns).rename(columns=names).to_csv(index=False)
        for name, text in zip(self.files, (table, header), strict=True):
            with atomic_write(folder / name, overwrite=True) as sibling:
                sibling.write_text(text, encoding="utf-8")


@checked_call
def inverse_table(dataset: IsobaricDataset, *, folds: int = 5) -> InverseTable:
    """Pressure over contraction, load and direction, directly from the points of a test at constant loads.

    At a load, the pressure rises with the contraction in both directions: each curve is the monotone function nearest
    to its points (isotonic regression: R. Barlow et al., "Statistical Inference under Order Restrictions", Wiley 1972),
    linear in between. Also one load gives a table, though no force law.

    Parameters
    ----------
    folds
        Number of parts that are left out in turn, without repeats.

    Raises
    ------
    IdentificationError
        If the loads are not known.

    Examples
    --------
    >>> table = inverse_table(
    ...     IsobaricDataset.of(
    ...         pressure=[1e5, 2e5, 3e5, 4e5] * 2,
    ...         contraction=[0.02, 0.1, 0.15, 0.18, 0.04, 0.12, 0.16, 0.18],
    ...         force=[100.0] * 8,
    ...         direction=["unloading"] * 4 + ["loading"] * 4,
    ...     )
    ... )
    >>> table.pressure_for([0.06, 0.1], 100.0, "unloading")
    array([150000., 200000.])
    """
    loads = held_loads(dataset.table)
    if loads is None:
        remedy = "give the loads (set_force_N), or rows in the order of the test"
        raise IdentificationError("the loads that were held are not known", remedy=remedy)
    points = pd.DataFrame({"load": loads, "contraction": dataset.contraction, "pressure": dataset.pressure})
    points["part"] = dataset.table["repeat"].to_numpy() if len(dataset.repeats) > 1 else np.arange(len(points)) % folds
    if known := "direction" in dataset.table:
        points["direction"] = dataset.table["direction"].to_numpy()
    else:
        points = pd.concat([points.assign(direction=word) for word in ("unloading", "loading")], ignore_index=True)
    inner = points["load"].where((points["load"] > loads.min()) & (points["load"] < loads.max())).to_numpy()
    errors = {"rmse": _held_out(points, points["part"].to_numpy()), "load_rmse": _held_out(points, inner)}
    return dataclasses.replace(_table(points), directed=known, **errors)


def _held_out(points: pd.DataFrame, parts: np.ndarray) -> float:
    """RMSE [Pa] at points of parts that are left out in turn, as far as the others predict them; those of NaN stay."""
    squares = []
    for part in np.unique(parts[~np.isnan(parts)]):
        table = _table(points[parts != part])
        for word, out in points[parts == part].groupby("direction"):
            predicted = table.pressure_for(out["contraction"], out["load"], str(word))
            squares.append((predicted - out["pressure"].to_numpy()) ** 2)
    squares = np.concatenate([*squares, np.empty(0)])
    return float(np.sqrt(np.nanmean(squares))) if np.isfinite(squares).any() else np.nan


def _table(points: pd.DataFrame) -> InverseTable:
    """Table of points, without errors; curves by ascending load, unloading first."""
    from scipy.optimize import isotonic_regression  # takes 0.3 s to import

    curves = []
    for (load, word), rows in points.sort_values("contraction", kind="stable").groupby(["load", "direction"]):
        level = pd.Series(isotonic_regression(rows["pressure"]).x, rows.index, name="pressure")
        mean = rows["contraction"].groupby(level).mean()
        curves.append((word != "unloading", load, np.full(len(mean), load), np.full(len(mean), word), mean, mean.index))
    curves = sorted(curves, key=lambda curve: (curve[1], curve[0]))
    load, word, contraction, pressure = (np.concatenate(column) for column in list(zip(*curves, strict=True))[2:])
    return InverseTable(load, word, contraction, pressure)
