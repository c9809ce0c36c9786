"""A plan: next points, their gain, and what the measured points cannot determine."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mckibben.dataset import IsobaricDataset
from mckibben.experiment_design.candidates import States
from mckibben.experiment_design.information import Spread
from mckibben.experiment_design.quantities import Quantity, in_words, shown
from mckibben.muscle import ForceLaw
from mckibben.storage.files import atomic_write
from mckibben.units import bar, factor, percent

_SAME = 0.1 * percent  # contractions that are nearer are one place
_VAGUE = 2.0  # a force is vague where its standard error is so many times that of a single point
_NAMED = 6


def about_coverage(points: IsobaricDataset, measured: IsobaricDataset, states: States) -> list[str]:
    """What was never measured: ends of the range, slack pressures, directions, repeats, times.

    Parameters
    ----------
    points
        The taut points.
    measured
        All of them.
    states
        Those that can be measured.
    """
    said = []
    dead = [p for p in measured.pressures if measured.slack[measured.levels == p].all()]
    if dead:
        listed = ", ".join(f"{p / bar:.4g}" for p in dead[:_NAMED]) + (" ..." if len(dead) > _NAMED else "")
        said.append(f"at {listed} bar all points are slack: they do not say how strong the muscle is there")
    if not len(points):
        return [*said, "no point is taut: nothing is known of the force but that it is small"]
    said += _ends(points, states)
    table = measured.table
    directions = list(measured.directions)
    if not directions:
        said.append(
            "directions are not recorded: whether friction is in the forces cannot be seen, and the plan takes them "
            "for free of it"
        )
    elif len(directions) == 1:
        other = "unloading" if directions[0] == "loading" else "loading"
        said.append(
            f"all points are {directions[0]}: the data at hand cannot tell friction from force; measure {other} too"
        )
    keys = [np.round(points.contraction / _SAME), points.levels]
    keys += [np.unique(points.table["direction"].to_numpy(), return_inverse=True)[1]] if directions else []
    if len(np.unique(np.stack(keys), axis=1).T) == len(points):
        said.append("nothing was measured twice: what the law misses and what the rig scatters cannot be told apart")
    if "time" not in table:
        said.append("times are not recorded: drift and creep cannot be seen")
    return said


def about_parameters(
    names: Sequence[str],
    combinations: NDArray[np.float64],
    values: NDArray[np.float64],
    errors: NDArray[np.float64],
) -> list[str]:
    """Which parameters the points do not determine, together or alone.

    Parameters
    ----------
    names
        Of the parameters, friction included.
    combinations
        Shape (parameters, combinations), each in units of 1 N: what leaves all measured forces as they are.
    values, errors
        Shape (parameters,): estimates and standard errors; infinite where there is none.
    """
    said = []
    tied = np.zeros(len(names), bool)
    if combinations.shape[1]:
        share = np.abs(combinations).max(axis=1)
        tied = share > 0.05 * share.max()
        count = combinations.shape[1]
        which = ", ".join(name for name, part in zip(names, tied, strict=True) if part)
        ways = "one way" if count == 1 else f"{count} ways"
        said.append(f"{which} can change together, in {ways}, and leave all measured forces as they are")
    with np.errstate(invalid="ignore"):
        vague = np.isfinite(errors) & (errors > np.abs(values)) & ~tied
    if vague.any():
        which = ", ".join(name for name, part in zip(names, vague, strict=True) if part)
        said.append(f"{which}: the standard error is larger than the value")
    return said


def about_force(states: States, errors: NDArray[np.float64], point: float) -> list[str]:
    """Where the force that the law predicts is hardly known.

    Parameters
    ----------
    states
        Those that can be measured.
    errors
        Shape (pressures, contractions): standard error of the law's force [N]; infinite where it is not determined.
    point
        That of a single point [N].
    """
    allowed = states.allowed
    unknown, vague = allowed & np.isinf(errors), allowed & np.isfinite(errors) & (errors > _VAGUE * point)
    said = []
    if unknown.any():
        part = np.count_nonzero(unknown) / np.count_nonzero(allowed)
        said.append(f"at {100 * part:.0f} % of the states that can be measured the law has no determined force")
    if vague.any():
        part = np.count_nonzero(vague) / np.count_nonzero(allowed)
        row, column = np.unravel_index(np.argmax(np.where(vague, errors, 0)), errors.shape)
        where = in_words(float(states.contractions[column]), float(states.pressures[row]))
        said.append(
            f"at {_share(part)} of the states that can be measured the force is uncertain by more than {_VAGUE:g} "
            f"times a single point's {point:.2g} N; worst, {errors[row, column]:.3g} N, at {where}"
        )
    return said


def _ends(points: IsobaricDataset, states: States) -> list[str]:
    """Where the range that can be measured goes on and the points do not."""
    rows, columns = states.places.T
    said = []
    step = float(np.diff(states.contractions[:2]).sum()) if len(states.contractions) > 1 else 0.0
    low, high = points.contraction.min(), points.contraction.max()
    first, last = states.contractions[columns].min(), states.contractions[columns].max()
    if first < low - max(step, _SAME):
        stretched = " (the muscle stretched beyond its length)" if first < 0 <= low else ""
        said.append(
            f"no point below {low / percent:.3g} % contraction, where {first / percent:.3g} % is allowed{stretched}"
        )
    if last > high + max(step, _SAME):
        said.append(
            f"no taut point above {high / percent:.3g} % contraction, where {last / percent:.3g} % can be reached"
        )
    low, high = points.levels.min(), points.levels.max()
    first, last = states.pressures[rows].min(), states.pressures[rows].max()
    step = float(np.diff(states.pressures[:2]).sum()) if len(states.pressures) > 1 else 0.0
    if first < low - max(step, 1e3):
        said.append(f"no taut point below {low / bar:.3g} bar, where the law has a force down to {first / bar:.3g} bar")
    if last > high + max(step, 1e3):
        said.append(f"no point above {high / bar:.3g} bar, where {last / bar:.3g} bar is allowed")
    return said


def _share(part: float) -> str:
    return f"{100 * part:.0f} %" if part >= 0.01 else "under 1 %"


@dataclass(frozen=True)
class PlannedPoint:
    """One point to measure.

    Attributes
    ----------
    pressure, contraction
        Where [Pa], [-].
    direction
        "loading" or "unloading": the way on which to come there; empty where it does not matter.
    repeat
        From 0; a point that is in the plan twice belongs to two passes.
    force
        What the law expects there [N].
    standard_error
        Of the quantity once this point and all before it are measured, in SI; infinite while it is not determined.
    gain
        The share of the standard error that this point takes off, from 0 to 1; 1 for that which makes it finite.
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
    """The standard error of the law's force over contraction and pressure.

    Attributes
    ----------
    states
        Where.
    now, after
        Shape (pressures, contractions) [N]: with the points at hand, and with those of the plan; infinite where it is
        not determined, NaN where nothing can be measured.
    """

    states: States
    now: NDArray[np.float64] = field(repr=False)
    after: NDArray[np.float64] = field(repr=False)


@dataclass(frozen=True, eq=False)
class Plan:
    """What to measure next; `plan` makes it.

    Standard errors are what theory expects of a fit to all points, linear in the parameters; of several numbers they
    are the root of the mean variance. Of several coefficients they are the geometric mean over the axes of their joint
    region, of which only ratios have a meaning.

    Attributes
    ----------
    quantity
        What is to become sure.
    law
        The law that the plan is made about: fitted, or guessed.
    points
        In the order of what each gains.
    now, after
        Standard error of the quantity with the points at hand, and with those of the plan, in SI; infinite where it is
        not determined.
    even
        The same with as many evenly spaced points instead: of several such layouts the best for the quantity; infinite
        where none determines it, NaN where there are not enough states for one.
    even_points
        Those: pressure [Pa], contraction [-], direction and repeat of each.
    value
        The quantity by the law, in SI; None where it is several numbers.
    parameter_errors
        By parameter: its standard error now and after, in SI.
    spread
        How points scatter.
    half_width
        Of the friction between the directions [N], by the fit; None where it is not in the plan or not known.
    unseen
        Sentences: what the points at hand cannot tell.
    notes
        Sentences: what the plan rests on.
    measured
        The points at hand, slack ones included where they are known.
    map
        Of the force.
    target_states
        Shape (states, 2): contraction [-] and pressure [Pa] of the muscle that the quantity is about.
    """

    quantity: Quantity
    law: ForceLaw
    points: tuple[PlannedPoint, ...]
    now: float
    after: float
    even: float
    even_points: tuple[tuple[float, float, str, int], ...] = field(repr=False)
    value: float | None
    parameter_errors: Mapping[str, tuple[float, float]] = field(repr=False)
    spread: Spread
    half_width: float | None
    unseen: tuple[str, ...]
    notes: tuple[str, ...]
    measured: IsobaricDataset = field(repr=False)
    map: ErrorMap = field(repr=False)
    target_states: NDArray[np.float64] = field(repr=False)

    @property
    def unit(self) -> str:
        """In which the standard error of the quantity is shown; empty where only ratios have a meaning."""
        return self.quantity.unit(type(self.law))

    def summary(self) -> str:
        """The standard error now, after, and with evenly spaced points, as a sentence."""
        count = f"{len(self.points)} point{'s' if len(self.points) > 1 else ''}"
        texts = [self._error(x) for x in (self.now, self.after)]
        evenly = "" if np.isnan(self.even) else f", after as many evenly spaced ones {self._error(self.even)}"
        if self.unit:
            value = "" if self.value is None else f" {shown(self.value, self.unit):.4g} {self.unit},"
            return f"{self.quantity}:{value} standard error now {texts[0]}; after these {count} {texts[1]}{evenly}"
        if not np.isfinite(self.now):
            return f"{self.quantity}: not determined now; after these {count} {self._against_even()}"
        evenly = "" if np.isnan(self.even) else f", with evenly spaced ones to {self.even / self.now:.2f}"
        return (
            f"{self.quantity}: with these {count} the standard errors shrink to {self.after / self.now:.2f} of what "
            f"they are (geometric mean){evenly}"
        )

    def rows(self) -> list[tuple[str, ...]]:
        """The points as text, headers first: where, and what each gains once those before it are measured."""
        head = ("", "pressure", "contraction", "direction", "pass", "force", "standard error then", "gain")
        return [
            head,
            *(
                (
                    str(i + 1),
                    f"{p.pressure / bar:.4g} bar",
                    f"{p.contraction / percent:.4g} %",
                    p.direction or "either",
                    str(p.repeat + 1),
                    f"{p.force:.0f} N",
                    self._then(p.standard_error),
                    f"{100 * p.gain:.3g} %",
                )
                for i, p in enumerate(self.points)
            ),
        ]

    def report(self) -> str:
        """The plan as text: the points with what each gains, the standard error before and after, what is not seen."""
        rows = self.rows()
        widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
        lines = ["  ".join(cell.rjust(width) for cell, width in zip(row, widths, strict=True)) for row in rows]
        return "\n".join([*lines, "", self.summary(), *self.sentences()])

    def sentences(self) -> list[str]:
        """What the plan rests on, and what the points at hand cannot tell, one a line."""
        return [*(f"note: {note}" for note in self.notes), *(f"not seen: {sentence}" for sentence in self.unseen)]

    def records(self) -> dict[str, Any]:
        """Everything as plain numbers in the units in which they are shown, as for JSON."""
        scale = factor(self.unit) if self.unit else 1.0
        law = type(self.law)
        return {
            "quantity": str(self.quantity),
            "law": law.__name__,
            "unit": self.unit,
            "value": None if self.value is None else self.value / scale,
            "standard_error_now": self.now / scale if self.unit else None,
            "standard_error_after": self.after / scale if self.unit else None,
            "standard_error_even": self.even / scale if self.unit else None,
            "ratio": self.after / self.now,
            "ratio_even": self.even / self.now,
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
            "spread_N": {"point": self.spread.point, "stroke": self.spread.stroke, "half_width": self.half_width},
            "not_seen": list(self.unseen),
            "notes": list(self.notes),
        }

    def to_csv(self, path: str | os.PathLike[str]) -> None:
        """Write the points in the order of a test: by pass and pressure, shortening and then stretching.

        Headers are those of data files. With a column ``force_N`` and what was measured in it, the file is one.
        """
        ordered = sorted(range(len(self.points)), key=lambda i: _rig_order(self.points[i]))
        lines = ["pressure_bar,contraction_percent,direction,repeat,expected_N,rank"]
        for i in ordered:
            p = self.points[i]
            numbers = f"{p.pressure / bar:.9g},{p.contraction / percent:.9g}"
            lines.append(f"{numbers},{p.direction or 'unknown'},{p.repeat},{p.force:.1f},{i + 1}")
        with atomic_write(Path(path), overwrite=True) as part:
            part.write_text("\n".join(lines) + "\n", encoding="utf-8", newline="\n")

    def _against_even(self) -> str:
        if not np.isfinite(self.after):
            return "not determined either"
        if np.isnan(self.even):
            return "determined"
        if not np.isfinite(self.even):
            return "determined, after as many evenly spaced ones not"
        return f"determined, {self.after / self.even:.2f} of the standard errors with as many evenly spaced ones"

    def _then(self, error: float) -> str:
        if not np.isfinite(error):
            return "not determined"
        if self.unit:
            return self._error(error)
        return f"x {error / self.now:.3f}" if np.isfinite(self.now) else "determined"

    def _error(self, error: float) -> str:
        if not np.isfinite(error):
            return "not determined"
        return f"{shown(error, self.unit):.3g} {self.unit}"


def _rig_order(point: PlannedPoint) -> tuple[Any, ...]:
    loading = point.direction == "loading"
    return point.repeat, point.pressure, loading, -point.contraction if loading else point.contraction
