"""A plan: what to measure next, what it gains, and what the points at hand cannot see."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mckibben.dataset import IsobaricDataset
from mckibben.files import whole
from mckibben.muscle import ForceLaw
from mckibben.study.planning.candidates import States
from mckibben.study.planning.information import Spread
from mckibben.study.planning.quantities import Quantity, shown
from mckibben.units import bar, factor, percent


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
        with whole(Path(path)) as part:
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
