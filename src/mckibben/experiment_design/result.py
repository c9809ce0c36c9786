"""Result of an experiment plan: points, gains, and diagnostics of the prior data."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from mckibben.dataset import IsobaricDataset
from mckibben.experiment_design.candidates import StateGrid
from mckibben.experiment_design.information import Floats, NoiseModel
from mckibben.experiment_design.quantities import QuantityOfInterest
from mckibben.muscle import ForceLaw
from mckibben.muscle.slopes import unphysical
from mckibben.result import Column, Remark, Result, TableColumns, column, row_columns, table
from mckibben.storage.files import atomic_write
from mckibben.units import bar, factor, percent


@dataclass(frozen=True)
class PlannedPoint:
    """One point to measure: state [Pa], [-], direction ("" for any), pass from 0, force by the law [N].

    `standard_error` [SI] is the error of the quantity after measuring this and all previous points, infinite while
    undetermined; `gain` is its relative reduction by this point, 0 to 1.
    """

    pressure: float = column("Pa", "pressure", "bar")
    contraction: float = column("1", "contraction", "%")
    direction: str = column(title="direction")
    repeat: int = column(title="pass")
    force: float = column("N", "force", digits=3)
    standard_error: float = column("", "standard error after it", digits=3)
    gain: float = column("1", "gain", "%", digits=3)


@dataclass(frozen=True, eq=False)
class ErrorMap:
    """Standard error of the law's force now and after the plan, shape (pressures, contractions) [N].

    Infinite where undetermined, NaN where nothing can be measured.
    """

    states: StateGrid
    now: Floats = field(repr=False)
    after: Floats = field(repr=False)


class ExperimentPlan(Result):
    """Result of `plan`.

    Standard errors [SI] are expected for a fit to all points, linearised in the parameters; infinite where
    undetermined. For several values they are the root of the mean variance.

    Attributes
    ----------
    law
        Law about which the quantity is linearised.
    points
        In order of gain.
    error_now, error_after
        Standard error of the quantity with the prior data, and with the plan.
    value
        Quantity by the law, in SI; None for several values.
    parameter_errors
        Standard error of each parameter, now and after, in SI.
    half_width
        Half width of the friction [N] from the fit; None if it is not an unknown or not determined.
    diagnostics, notes
        Limits of the prior data, and assumptions of the plan.
    measured
        Prior data, slack points included.
    target_states
        Shape (states, 2): contraction [-] and pressure [Pa] of the muscle at which the quantity is evaluated.
    """

    quantity: QuantityOfInterest
    law: ForceLaw
    points: tuple[PlannedPoint, ...]
    error_now: float
    error_after: float
    value: float | None
    parameter_errors: Mapping[str, tuple[float, float]]
    noise: NoiseModel
    half_width: float | None
    diagnostics: tuple[str, ...]
    notes: tuple[str, ...]
    measured: IsobaricDataset
    map: ErrorMap
    target_states: Floats

    figures = ("planned",)
    heading = "points to measure next"
    files = ("plan.csv",)

    @property
    def unit(self) -> str:
        """Unit of the standard error in texts."""
        return self.quantity.unit(type(self.law))[1]

    def verdict(self) -> str:
        """Standard error now and after, as a sentence."""
        count = f"{len(self.points)} point{'s' if len(self.points) > 1 else ''}"
        value = "" if self.value is None else f" {self.value / factor(self.unit):.4g} {self.unit},"
        now, after = (
            f"{error / factor(self.unit):.3g} {self.unit}" if np.isfinite(error) else "not determined"
            for error in (self.error_now, self.error_after)
        )
        return f"{self.quantity}:{value} standard error now {now}; after these {count} {after}"

    def remarks(self) -> list[Remark]:
        """Assumptions of the plan, and limits of the prior data."""
        fields = [("plan", text) for text in self.notes] + [("data", text) for text in self.diagnostics]
        remarks = [Remark.warning(field, text) for field, text in fields]
        if wrong := unphysical(self.law):
            remarks.append(
                Remark.severe("law", f"the law is not that of a muscle: {wrong}", "measure at more pressures")
            )
        return remarks

    def declared(self) -> TableColumns:
        """The points in order of gain, and the quantity with its standard errors, in its unit."""
        si, _ = self.quantity.unit(type(self.law))
        unit = partial(Column, si, shown=self.unit)
        points = row_columns(PlannedPoint, self.points)
        points["direction"] = points["direction"][0], [row.direction or "either" for row in self.points]
        points["repeat"] = points["repeat"][0], [row.repeat + 1 for row in self.points]
        points["standard_error"] = unit("standard error after it", digits=3), points["standard_error"][1]
        value = {} if self.value is None else {"value": (unit("value by the law"), self.value)}
        errors = {
            "error_now": (unit("standard error now", digits=3), self.error_now),
            "error_after": (unit("standard error after these points", digits=3), self.error_after),
        }
        return super().declared() | value | errors | points

    @table("standard errors of the parameters", detail=True)
    def parameters(self) -> TableColumns:
        """The standard errors of the parameters, now and after."""
        pairs = zip(type(self.law).parameters(), self.parameter_errors.values(), strict=True)
        errors = {p.name: (Column(p.unit, shown=p.shown, digits=3), list(pair)) for p, pair in pairs}
        return {"": (Column(), ["now", "after"])} | errors

    def write(self, folder: Path) -> None:
        """Write the points in test order; add a column ``force_N`` of measured forces to make it a data file."""
        lines = ["pressure_bar,contraction_percent,direction,repeat"]
        lines += [
            f"{p.pressure / bar:.9g},{p.contraction / percent:.9g},{p.direction or 'unknown'},{p.repeat}"
            for p in sorted(self.points, key=_rig_order)
        ]
        with atomic_write(folder / "plan.csv", overwrite=True) as temporary:
            temporary.write_text("\n".join(lines) + "\n", encoding="utf-8", newline="\n")


def _rig_order(point: PlannedPoint) -> tuple[Any, ...]:
    loading = point.direction == "loading"
    return point.repeat, point.pressure, loading, -point.contraction if loading else point.contraction
