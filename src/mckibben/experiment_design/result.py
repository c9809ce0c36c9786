"""Result of an experiment plan: points, gains, and diagnostics of the prior data."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from mckibben.dataset import IsobaricDataset
from mckibben.dataset.schema import text_table
from mckibben.experiment_design.candidates import StateGrid
from mckibben.experiment_design.information import Floats, NoiseModel
from mckibben.experiment_design.prior import PriorData
from mckibben.experiment_design.quantities import QuantityOfInterest
from mckibben.muscle import ForceLaw
from mckibben.storage.files import atomic_write
from mckibben.units import bar, factor, percent

_SAME_PLACE = 0.1 * percent  # contractions closer than this count as one position
_UNCERTAIN = 2.0  # standard errors of the force, relative to the noise of a point
_LISTED = 6


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


@dataclass(frozen=True, eq=False)
class ExperimentPlan:
    """Result of `plan`.

    Standard errors [SI] are expected for a fit to all points, linearised in the parameters; infinite where
    undetermined. For several values they are the root of the mean variance; for several coefficients the geometric mean
    over the axes of their joint confidence region, of which only ratios are meaningful.

    Attributes
    ----------
    law
        Law about which the quantity is linearised: fitted or guessed.
    points
        In order of gain.
    error_now, error_after, error_even
        Standard error of the quantity with the prior data, with the plan, and with the best evenly spaced design of
        equal size (NaN if there is none).
    even_points
        That design: pressure [Pa], contraction [-], direction and repeat of each.
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
    error_even: float
    even_points: tuple[tuple[float, float, str, int], ...] = field(repr=False)
    value: float | None
    parameter_errors: Mapping[str, tuple[float, float]] = field(repr=False)
    noise: NoiseModel
    half_width: float | None
    diagnostics: tuple[str, ...]
    notes: tuple[str, ...]
    measured: IsobaricDataset = field(repr=False)
    map: ErrorMap = field(repr=False)
    target_states: Floats = field(repr=False)

    @property
    def unit(self) -> str:
        """Unit of the standard error; empty if only ratios are meaningful."""
        return self.quantity.unit(type(self.law))

    def summary(self) -> str:
        """Standard error now, after, and with evenly spaced points, as a sentence."""
        count = f"{len(self.points)} point{'s' if len(self.points) > 1 else ''}"
        no_even = np.isnan(self.error_even)
        if self.unit:
            value = "" if self.value is None else f" {self.value / factor(self.unit):.4g} {self.unit},"
            even = "" if no_even else f", after as many evenly spaced ones {self._error(self.error_even)}"
            now, after = self._error(self.error_now), self._error(self.error_after)
            return f"{self.quantity}:{value} standard error now {now}; after these {count} {after}{even}"
        if not np.isfinite(self.error_now):
            return f"{self.quantity}: not determined now; after these {count} {self._compared()}"
        even = "" if no_even else f", with evenly spaced ones to {self.error_even / self.error_now:.2f}"
        return (
            f"{self.quantity}: these {count} reduce the standard errors (geometric mean) to "
            f"{self.error_after / self.error_now:.2f} of the present ones{even}"
        )

    def rows(self) -> list[tuple[str, ...]]:
        """The points as text, headers first."""
        head = ("", "pressure", "contraction", "direction", "pass", "force", "standard error after it", "gain")
        return [
            head,
            *(
                (
                    str(i + 1),
                    f"{p.pressure / bar:.4g} bar",
                    f"{_contraction(p.contraction)} %",
                    p.direction or "either",
                    str(p.repeat + 1),
                    f"{p.force:.0f} N",
                    self._relative_error(p.standard_error),
                    f"{100 * p.gain:.3g} %",
                )
                for i, p in enumerate(self.points)
            ),
        ]

    def report(self) -> str:
        """The plan as text: points, standard errors, notes and diagnostics."""
        return "\n".join([*text_table(self.rows(), ()), "", self.summary(), *self.sentences()])

    def sentences(self) -> list[str]:
        """Notes and diagnostics, one per line."""
        return [*(f"note: {note}" for note in self.notes), *(f"diagnostic: {one}" for one in self.diagnostics)]

    def records(self) -> dict[str, Any]:
        """The results as plain data in shown units."""
        scale = factor(self.unit) if self.unit else 1.0
        law = type(self.law)
        return {
            "quantity": str(self.quantity),
            "law": law.__name__,
            "unit": self.unit,
            "value": None if self.value is None else self.value / scale,
            "standard_error_now": self.error_now / scale if self.unit else None,
            "standard_error_after": self.error_after / scale if self.unit else None,
            "standard_error_even": self.error_even / scale if self.unit else None,
            "ratio": self.error_after / self.error_now,
            "ratio_even": self.error_even / self.error_now,
            "points": [
                {
                    "pressure_bar": p.pressure / bar,
                    "contraction_percent": p.contraction / percent,
                    "direction": p.direction,
                    "repeat": p.repeat,
                    "expected_force_N": p.force,
                    "standard_error": p.standard_error / scale if self.unit else None,
                    "gain": p.gain,
                }
                for p in self.points
            ],
            "parameters": {
                p.name: {"now": now / factor(p.shown), "after": after / factor(p.shown), "unit": p.shown}
                for p, (now, after) in zip(law.parameters(), self.parameter_errors.values(), strict=True)
            },
            "noise_N": {"point": self.noise.point, "stroke": self.noise.stroke, "half_width": self.half_width},
            "diagnostics": list(self.diagnostics),
            "notes": list(self.notes),
        }

    def to_csv(self, path: str | os.PathLike[str]) -> None:
        """Write the points in test order; add a column ``force_N`` of measured forces to make it a data file."""
        ordered = sorted(range(len(self.points)), key=lambda i: _rig_order(self.points[i]))
        lines = ["pressure_bar,contraction_percent,direction,repeat,expected_N,rank"]
        for i in ordered:
            p = self.points[i]
            numbers = f"{p.pressure / bar:.9g},{p.contraction / percent:.9g}"
            lines.append(f"{numbers},{p.direction or 'unknown'},{p.repeat},{p.force:.1f},{i + 1}")
        with atomic_write(Path(path), overwrite=True) as part:
            part.write_text("\n".join(lines) + "\n", encoding="utf-8", newline="\n")

    def _compared(self) -> str:
        if not np.isfinite(self.error_after):
            return "not determined either"
        if np.isnan(self.error_even):
            return "determined"
        if not np.isfinite(self.error_even):
            return "determined, but not after as many evenly spaced ones"
        ratio = self.error_after / self.error_even
        return f"determined, with {ratio:.2f} of the standard errors of as many evenly spaced ones"

    def _relative_error(self, error: float) -> str:
        if self.unit or not np.isfinite(error):
            return self._error(error)
        return f"x {error / self.error_now:.3f}" if np.isfinite(self.error_now) else "determined"

    def _error(self, error: float) -> str:
        return f"{error / factor(self.unit):.3g} {self.unit}" if np.isfinite(error) else "not determined"


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
    found = []
    tied = np.zeros(len(names), bool)
    if free.shape[1]:
        share = np.abs(free).max(axis=1)
        tied = share > 0.05 * share.max()
        listed = ", ".join(name for name, part in zip(names, tied, strict=True) if part)
        rank = free.shape[1]
        found.append(
            f"not identifiable: {rank} combination{'s' if rank > 1 else ''} of {listed} affect no measured force"
        )
    with np.errstate(invalid="ignore"):
        vague = np.isfinite(errors) & (errors > np.abs(values)) & ~tied
    if vague.any():
        listed = ", ".join(name for name, part in zip(names, vague, strict=True) if part)
        found.append(f"{listed}: the standard error exceeds the value")
    return found


def _force_diagnostics(states: StateGrid, errors: Floats, noise: float) -> list[str]:
    allowed = states.allowed
    unknown, uncertain = allowed & np.isinf(errors), allowed & np.isfinite(errors) & (errors > _UNCERTAIN * noise)
    found = []
    if unknown.any():
        part = np.count_nonzero(unknown) / np.count_nonzero(allowed)
        found.append(f"at {100 * part:.0f} % of the measurable states the force of the law is not determined")
    if uncertain.any():
        part = np.count_nonzero(uncertain) / np.count_nonzero(allowed)
        share = f"{100 * part:.0f} %" if part >= 0.01 else "under 1 %"
        row, column = np.unravel_index(np.argmax(np.where(uncertain, errors, 0)), errors.shape)
        where = f"{_contraction(states.contractions[column])} % and {states.pressures[row] / bar:.4g} bar"
        found.append(
            f"at {share} of the measurable states the standard error of the force exceeds {_UNCERTAIN:g} times the "
            f"noise of a point, {noise:.2g} N; largest {errors[row, column]:.3g} N at {where}"
        )
    return found


def _coverage_diagnostics(points: IsobaricDataset, measured: IsobaricDataset, states: StateGrid) -> list[str]:
    """Missing ends of the range, slack pressures, and missing directions, repeats and times."""
    found = []
    slack = [p for p in measured.pressures if measured.slack[measured.levels == p].all()]
    if slack:
        listed = ", ".join(f"{p / bar:.4g}" for p in slack[:_LISTED]) + (" ..." if len(slack) > _LISTED else "")
        found.append(f"at {listed} bar all points are slack and carry no information on the force")
    if not len(points):
        return [*found, "no point is taut: the force is not determined anywhere"]
    found += _range_diagnostics(points, states)
    directions = list(measured.directions)
    if not directions:
        found.append("directions are not recorded: friction cannot be identified, and the plan assumes none")
    elif len(directions) == 1:
        other = "unloading" if directions[0] == "loading" else "loading"
        found.append(f"all points are {directions[0]}: friction is not distinguished from force; measure {other} too")
    keys = [np.round(points.contraction / _SAME_PLACE), points.levels]
    keys += [np.unique(points.table["direction"].to_numpy(), return_inverse=True)[1]] if directions else []
    if len(np.unique(np.stack(keys), axis=1).T) == len(points):
        found.append("no repeated points: model error is not distinguished from noise")
    if "time" not in measured.table:
        found.append("times are not recorded: drift and creep cannot be identified")
    return found


def _range_diagnostics(points: IsobaricDataset, states: StateGrid) -> list[str]:
    """Measurable range beyond the points."""
    rows, columns = states.places.T
    found = []
    step = max(float(np.diff(states.contractions[:2]).sum()), _SAME_PLACE)
    low, high = points.contraction.min(), points.contraction.max()
    first, last = states.contractions[columns].min(), states.contractions[columns].max()
    if first < low - step:
        stretched = " (the muscle stretched beyond its length)" if first < 0 <= low else ""
        found.append(
            f"no point below {_contraction(low)} % contraction, where {_contraction(first)} % is allowed{stretched}"
        )
    if last > high + step:
        found.append(f"no taut point above {_contraction(high)} % contraction, where {_contraction(last)} % is allowed")
    low, high = points.levels.min(), points.levels.max()
    first, last = states.pressures[rows].min(), states.pressures[rows].max()
    step = max(float(np.diff(states.pressures[:2]).sum()), 1e3)
    if first < low - step:
        found.append(
            f"no taut point below {low / bar:.3g} bar, where the law has a force down to {first / bar:.3g} bar"
        )
    if last > high + step:
        found.append(f"no point above {high / bar:.3g} bar, where {last / bar:.3g} bar is allowed")
    return found
