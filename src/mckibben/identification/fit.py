"""What an identification found: the law, how well the data determine it, and how well it describes them."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mckibben.errors import IdentificationError
from mckibben.identification.intervals import (
    ForceIntervals,
    Interval,
    Regression,
    RobustErrors,
    force_intervals,
    parameter_interval,
)
from mckibben.identification.uncertainty import Grouping
from mckibben.muscle import ForceLaw
from mckibben.units import bar, factor


@dataclass(frozen=True)
class LeaveOnePressureOut:
    """Errors at pressures that the fit had not seen.

    For each pressure the whole law, its shape included, is fitted to the points of all others. By whole
    pressures and not by single points, because the neighbours of a point on its own curve all but give it
    away.

    Attributes
    ----------
    rmse, max_error
        Over all held-out points together [N].
    by_pressure
        RMSE [N] at each held-out pressure [Pa].
    """

    rmse: float
    max_error: float
    by_pressure: Mapping[float, float] = field(repr=False)


@dataclass(frozen=True)
class DatasetSummary:
    """Which data a fit is based on.

    Attributes
    ----------
    specimen, source
        As the dataset says.
    pressures
        The levels [Pa] of the points used, ascending.
    """

    specimen: str
    source: str
    pressures: tuple[float, ...]


@dataclass(frozen=True, eq=False)
class Fit:
    """A force law identified from data; `identify` makes it, `from_yaml` reads it.

    Attributes
    ----------
    law
        The law with the estimates; its domain is the range of the points used.
    standard_errors
        By parameter, in SI; NaN where the parameter is at a bound. These are the classical ones, which take the
        points as independent: see `mckibben.identification.uncertainty`, and `robust` for better ones.
    correlations
        Shape (parameters, parameters), in the order of `estimates`.
    rmse
        Root of the mean squared residual over the points used [N].
    max_error
        The largest residual, without sign [N].
    points_used, points_slack
        Plateaus that the fit rests on, and those left out because the muscle was slack.
    leave_one_pressure_out
        Errors at unseen pressures; None where they cannot be had, and a warning then says why.
    warnings
        Sentences: what a reader should know before trusting the numbers.
    dataset
        Which data.
    residuals
        Shape (points_used,): measured minus fitted force [N], in the order of the taut points of the
        dataset; None in a fit that was read from a file.
    robust
        Standard errors for points that may share an error, as the points of a stroke do: what the intervals rest on.
        None where too few groups of points are there to have them; a warning then says why.
    evidence
        The points and the solution at them, from which bands, profiles and bootstraps are made; None in a fit that
        was read from a file.
    """

    law: ForceLaw
    standard_errors: Mapping[str, float]
    correlations: NDArray[np.float64] = field(repr=False)
    rmse: float
    max_error: float
    points_used: int
    points_slack: int
    leave_one_pressure_out: LeaveOnePressureOut | None
    warnings: tuple[str, ...]
    dataset: DatasetSummary
    residuals: NDArray[np.float64] | None = field(default=None, repr=False)
    robust: RobustErrors | None = field(default=None, repr=False)
    regression: Regression | None = field(default=None, repr=False)

    @property
    def estimates(self) -> dict[str, float]:
        """The parameters by name, in SI, linear ones first."""
        return {p.name: float(getattr(self.law, p.name)) for p in self.law.parameters()}

    @property
    def covariance(self) -> NDArray[np.float64]:
        """Shape (parameters, parameters), in products of SI units."""
        errors = np.array([self.standard_errors[name] for name in self.estimates])
        return self.correlations * np.outer(errors, errors)

    def intervals(self, level: float = 0.95, *, by: Grouping | None = None) -> dict[str, Interval]:
        """By parameter, in SI: an interval that holds the true value in this share of data sets.

        Parameters
        ----------
        level
            That share.
        by
            Points that may share an error; `Regression.default_grouping` unless given:
            those of a stroke, or of a pressure where strokes are not known. ``Grouping.POINT`` gives the classical
            intervals.

        Raises
        ------
        IdentificationError
            If there are no such groups, or the fit was read from a file that does not keep what is asked for.
        """
        errors, freedom = self._errors(by)
        return {
            name: parameter_interval(value, errors[name], freedom[name], level)
            for name, value in self.estimates.items()
        }

    def force_intervals(
        self, contraction: ArrayLike, pressure: ArrayLike, *, level: float = 0.95, by: Grouping | None = None
    ) -> ForceIntervals:
        """The force of the law [N] with its uncertainty, and where a further measurement would lie.

        Parameters
        ----------
        contraction, pressure
            Where [-], [Pa]; they broadcast.
        level, by
            As for `intervals`; the intervals hold point by point, not for a whole curve at once.

        Returns
        -------
        ForceIntervals
            Of the law, which may turn negative where the muscle is slack. It holds the force of the muscle if the law
            is of the right kind: how far a wrong one is from the muscle is not in it.

        Raises
        ------
        IdentificationError
            As `intervals`; and if the fit was read from a file, which does not keep the points.
        """
        return force_intervals(self.law, self.require_regression(), contraction, pressure, level=level, by=by)

    def require_regression(self) -> Regression:
        """What the fit rests on.

        Raises
        ------
        IdentificationError
            If the fit was read from a file, which does not keep the points.
        """
        if self.regression is None:
            raise IdentificationError(
                f"this fit of {type(self.law).__name__} was read from a file, which does not keep its points",
                remedy="identify it again from the data",
            )
        return self.regression

    def _errors(self, by: Grouping | None) -> tuple[Mapping[str, float], Mapping[str, float]]:
        """Standard errors and degrees of freedom by parameter."""
        if self.robust and by in (None, self.robust.by):
            return self.robust.standard_errors, self.robust.degrees_of_freedom
        if by in (None, Grouping.POINT):
            free = sum(not np.isnan(error) for error in self.standard_errors.values())
            return self.standard_errors, dict.fromkeys(self.standard_errors, float(self.points_used - free))
        found = self.require_regression().robust_errors(by)
        return found.standard_errors, found.degrees_of_freedom

    def strongest_correlations(self, count: int = 3) -> list[tuple[str, str, float]]:
        """The pairs of parameters that the data tell apart worst, worst first."""
        names = list(self.estimates)
        pairs = [
            (names[i], names[j], float(self.correlations[i, j]))
            for i in range(len(names))
            for j in range(i + 1, len(names))
            if np.isfinite(self.correlations[i, j])
        ]
        return sorted(pairs, key=lambda pair: -abs(pair[2]))[:count]

    def report(self, level: float = 0.95) -> str:
        """The fit as text: parameters in the units of publications, errors, intervals, correlations, warnings."""
        law = type(self.law)
        errors, intervals = self._errors(None)[0], self.intervals(level)
        share = f"{100 * level:g} % interval"
        rows = [("parameter", "estimate", "standard error", "unit", share, "meaning")]
        for p in law.parameters():
            scale = factor(p.shown)
            error, (low, high) = errors[p.name] / scale, intervals[p.name]
            known = bool(np.isfinite(error))
            rows.append(
                (
                    p.name,
                    f"{self.estimates[p.name] / scale:.6g}",
                    f"{error:.2g}" if known else "at its bound",
                    p.shown,
                    f"{low / scale:.5g} .. {high / scale:.5g}" if known else "-",
                    p.meaning,
                )
            )
        levels = np.array(self.dataset.pressures) / bar
        lines = [
            f"{law.__name__}: {law.equation}",
            f"{self.dataset.specimen or 'unnamed specimen'}: {self.points_used} points used, "
            f"{self.points_slack} slack left out; {len(levels)} pressures {levels.min():g}..{levels.max():g} bar",
            f"domain: {self.law.domain}",
            "",
            *_table(rows),
            self._said_of_errors(),
            "",
            f"residuals: RMSE {self.rmse:.3g} N, maximum {self.max_error:.3g} N",
        ]
        if lopo := self.leave_one_pressure_out:
            lines.append(f"leaving one pressure out: RMSE {lopo.rmse:.3g} N, maximum {lopo.max_error:.3g} N")
        if pairs := self.strongest_correlations():
            lines.append("strongest correlations: " + ", ".join(f"{a}, {b} {r:+.4f}" for a, b, r in pairs))
        lines += [f"warning: {warning}" for warning in self.warnings]
        return "\n".join(lines)

    def _said_of_errors(self) -> str:
        if self.robust is None:
            return "standard errors: classical, as if the errors of all points were independent"
        ratios = [
            e / self.standard_errors[n] for n, e in self.robust.standard_errors.items() if self.standard_errors[n]
        ]
        freedom = list(self.robust.degrees_of_freedom.values())
        return (
            f"standard errors: the points of a {self.robust.by.value} may share an error "
            f"({self.robust.by.counted(self.robust.groups)}; CR2, {np.nanmin(freedom):.1f}..{np.nanmax(freedom):.1f} "
            f"degrees of freedom); {np.nanmin(ratios):.2g}..{np.nanmax(ratios):.2g} times the classical ones"
        )

    def to_yaml(self, path: str | os.PathLike[str]) -> None:
        """Write all but the residuals to a file for people and `from_yaml`; numbers come back exactly."""
        from mckibben.identification.storage import write_fit

        write_fit(self, Path(path))

    @classmethod
    def from_yaml(cls, path: str | os.PathLike[str]) -> Fit:
        """Read what `to_yaml` wrote.

        Raises
        ------
        ScenarioError
            With every problem of the file and its line.
        """
        from mckibben.identification.storage import read_fit

        return read_fit(Path(path))


def _table(rows: list[tuple[str, ...]]) -> list[str]:
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    return [
        "  ".join(
            cell.rjust(width) if 1 <= i <= 2 else cell.ljust(width)
            for i, (cell, width) in enumerate(zip(row, widths, strict=True))
        ).rstrip()
        for row in rows
    ]
