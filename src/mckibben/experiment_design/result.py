"""Result of an experiment plan: points, gains, and diagnostics of the prior data."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from mckibben.dataset import IsobaricDataset
from mckibben.experiment_design.candidates import StateGrid
from mckibben.experiment_design.information import Floats, NoiseModel
from mckibben.experiment_design.prior import PriorData
from mckibben.experiment_design.quantities import QuantityOfInterest
from mckibben.muscle import ForceLaw
from mckibben.result import Column, Listing, Remark, Result
from mckibben.storage.files import atomic_write
from mckibben.units import bar, factor, percent

_UNCERTAIN = 2.0  # standard errors of the force, relative to the noise of a point


@dataclass(frozen=True)
class PlannedPoint:
    """One point to measure: state [Pa], [-], direction ("" for any), pass from 0, force by the law [N].

    `standard_error` [SI] is the error of the quantity after measuring this and all previous points, infinite while
    undetermined; `gain` is its relative reduction by this point, 0 to 1.
    """

    pressure: float
    contraction: float
    direction: str
    repeat: int
    force: float
    standard_error: float
    gain: float


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
        Law about which the quantity is linearised: fitted or guessed.
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
        return [
            *(Remark.warning("plan", text) for text in self.notes),
            *(Remark.warning("data", text) for text in self.diagnostics),
        ]

    def listings(self) -> list[Listing]:
        """Points in order of gain, and the standard errors of the parameters."""
        si, _ = self.quantity.unit(type(self.law))
        rows = self.points
        columns: dict[str, tuple[Column, Any]] = {
            "pressure": (Column("Pa", shown="bar"), [row.pressure for row in rows]),
            "contraction": (Column("1", shown="%"), [row.contraction for row in rows]),
            "direction": (Column(), [row.direction or "either" for row in rows]),
            "pass": (Column(), [row.repeat + 1 for row in rows]),
            "force": (Column("N", digits=3), [row.force for row in rows]),
            "standard error after it": (Column(si, shown=self.unit, digits=3), [row.standard_error for row in rows]),
            "gain": (Column("1", shown="%", digits=3), [row.gain for row in rows]),
        }
        parameters = type(self.law).parameters()
        errors = {
            p.name: (Column(p.unit, shown=p.shown, digits=3), list(pair))
            for p, pair in zip(parameters, self.parameter_errors.values(), strict=True)
        }
        state = {"": (Column(), ["now", "after"])}
        return [
            Listing("points to measure next", columns),
            Listing("standard errors of the parameters", state | errors, detail=True),
        ]

    def write(self, folder: Path) -> None:
        """Write the points in test order; add a column ``force_N`` of measured forces to make it a data file."""
        ordered = sorted(range(len(self.points)), key=lambda i: _rig_order(self.points[i]))
        lines = ["pressure_bar,contraction_percent,direction,repeat"]
        for i in ordered:
            p = self.points[i]
            numbers = f"{p.pressure / bar:.9g},{p.contraction / percent:.9g}"
            lines.append(f"{numbers},{p.direction or 'unknown'},{p.repeat}")
        with atomic_write(folder / "plan.csv", overwrite=True) as part:
            part.write_text("\n".join(lines) + "\n", encoding="utf-8", newline="\n")


def _rig_order(point: PlannedPoint) -> tuple[Any, ...]:
    loading = point.direction == "loading"
    return point.repeat, point.pressure, loading, -point.contraction if loading else point.contraction


def _contraction(value: float) -> str:
    """A contraction in percent, rounded to the resolution of a rig."""
    return f"{round(value / percent, 3) + 0.0:.4g}"


def diagnostics(prior: PriorData, free: Floats, errors: Floats, maps: ErrorMap) -> tuple[str, ...]:
    """Sentences on the limits of the prior data; `free`: combinations of unknowns that do not change any force."""
    values = np.array(
        [*(float(getattr(prior.law, name)) for name in prior.parameters), *[prior.half_width] * prior.friction]
    )
    return (
        *_parameter_diagnostics(prior.names, free, values, errors),
        *_force_diagnostics(maps.states, maps.now, prior.noise.point),
        *_coverage_diagnostics(prior.points, prior.measured, maps.states),
    )


def _parameter_diagnostics(names: list[str], free: Floats, values: Floats, errors: Floats) -> list[str]:
    texts = []
    tied = np.zeros(len(names), bool)
    if free.shape[1]:
        share = np.abs(free).max(axis=1)
        tied = share > 0.05 * share.max()
        listed = ", ".join(name for name, part in zip(names, tied, strict=True) if part)
        rank = free.shape[1]
        texts.append(
            f"not identifiable: {rank} combination{'s' if rank > 1 else ''} of {listed} affect no measured force"
        )
    with np.errstate(invalid="ignore"):
        vague = np.isfinite(errors) & (errors > np.abs(values)) & ~tied
    if vague.any():
        listed = ", ".join(name for name, part in zip(names, vague, strict=True) if part)
        texts.append(f"{listed}: the standard error exceeds the value")
    return texts


def _force_diagnostics(states: StateGrid, errors: Floats, noise: float) -> list[str]:
    allowed = states.allowed
    unknown, uncertain = allowed & np.isinf(errors), allowed & np.isfinite(errors) & (errors > _UNCERTAIN * noise)
    texts = []
    if unknown.any():
        part = np.count_nonzero(unknown) / np.count_nonzero(allowed)
        texts.append(f"at {part:.0%} of the measurable states the force of the law is not determined")
    if uncertain.any():
        row, column = np.unravel_index(np.argmax(np.where(uncertain, errors, 0)), errors.shape)
        where = f"{_contraction(states.contractions[column])} % and {states.pressures[row] / bar:.4g} bar"
        texts.append(
            f"the standard error of the force exceeds {_UNCERTAIN:g} times the noise of a point, {noise:.2g} N; "
            f"largest {errors[row, column]:.3g} N at {where}"
        )
    return texts


def _coverage_diagnostics(points: IsobaricDataset, measured: IsobaricDataset, states: StateGrid) -> list[str]:
    """Missing ends of the range, and missing directions."""
    texts = []
    if not len(points):
        return [*texts, "no point is taut: the force is not determined anywhere"]
    rows, columns = states.places.T
    texts += _range_diagnostics(points.contraction, states.contractions[columns], "%", percent)
    texts += _range_diagnostics(points.levels, states.pressures[rows], "bar", bar)
    directions = list(measured.directions)
    if not directions:
        texts.append("directions are not recorded: friction cannot be identified, and the plan assumes none")
    elif len(directions) == 1:
        other = "unloading" if directions[0] == "loading" else "loading"
        texts.append(f"all points are {directions[0]}: friction is not distinguished from force; measure {other} too")
    return texts


def _range_diagnostics(measured: Floats, allowed: Floats, unit: str, size: float) -> list[str]:
    """Measurable range beyond the taut points, by more than a step of the rig."""
    steps = np.diff(np.unique(allowed))
    step = float(steps.min(initial=np.inf)) if steps.size else 0.0
    texts = []
    for name, end, sign in (("below", np.min, -1.0), ("above", np.max, 1.0)):
        known, possible = float(end(measured)), float(end(allowed))
        if sign * (possible - known) > step:
            shown = [f"{round(value / size, 3) + 0.0:.4g} {unit}" for value in (known, possible)]
            texts.append(f"no taut point {name} {shown[0]}, where {shown[1]} is allowed")
    return texts
