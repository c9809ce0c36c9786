"""What an identification found: the law, how well the data determine it, and how well it describes them."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

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
        By parameter, in SI; NaN where the parameter is at a bound. See `mckibben.identification.uncertainty`
        for what they assume.
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

    @property
    def estimates(self) -> dict[str, float]:
        """The parameters by name, in SI, linear ones first."""
        return {p.name: float(getattr(self.law, p.name)) for p in self.law.parameters()}

    @property
    def covariance(self) -> NDArray[np.float64]:
        """Shape (parameters, parameters), in products of SI units."""
        errors = np.array([self.standard_errors[name] for name in self.estimates])
        return self.correlations * np.outer(errors, errors)

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

    def report(self) -> str:
        """The fit as text: parameters in the units of publications, errors, correlations, warnings."""
        law = type(self.law)
        rows = [("parameter", "estimate", "standard error", "unit", "meaning")]
        for p in law.parameters():
            scale = factor(p.shown)
            error = self.standard_errors[p.name] / scale
            shown_error = f"{error:.2g}" if np.isfinite(error) else "at its bound"
            rows.append((p.name, f"{self.estimates[p.name] / scale:.6g}", shown_error, p.shown, p.meaning))
        levels = np.array(self.dataset.pressures) / bar
        lines = [
            f"{law.__name__}: {law.equation}",
            f"{self.dataset.specimen or 'unnamed specimen'}: {self.points_used} points used, "
            f"{self.points_slack} slack left out; {len(levels)} pressures {levels.min():g}..{levels.max():g} bar",
            f"domain: {self.law.domain}",
            "",
            *_table(rows),
            "",
            f"residuals: RMSE {self.rmse:.3g} N, maximum {self.max_error:.3g} N",
        ]
        if lopo := self.leave_one_pressure_out:
            lines.append(f"leaving one pressure out: RMSE {lopo.rmse:.3g} N, maximum {lopo.max_error:.3g} N")
        if pairs := self.strongest_correlations():
            lines.append("strongest correlations: " + ", ".join(f"{a}, {b} {r:+.4f}" for a, b, r in pairs))
        lines += [f"warning: {warning}" for warning in self.warnings]
        return "\n".join(lines)

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
