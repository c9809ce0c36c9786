"""Result of an identification: the law, the uncertainty of its parameters, and its errors."""

from __future__ import annotations

import os
import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from mckibben.component.calls import CheckedCalls, checked_call, user_level
from mckibben.dataset import IsobaricDataset
from mckibben.dataset.preprocessing import held_loads
from mckibben.errors import DomainWarning, IdentificationError, Problem, ScenarioError
from mckibben.identification.estimator import (
    Floats,
    Interval,
    check_level,
    t_interval,
    t_quantile,
)
from mckibben.identification.least_squares import design_matrix
from mckibben.identification.regression import ForceIntervals, Regression, RobustErrors
from mckibben.identification.storage import read_fields, write_fit
from mckibben.identification.summary import DatasetSummary, LeaveOnePressureOut, Outlier, hull_distance, load_distance
from mckibben.muscle import ForceLaw, forces
from mckibben.muscle.base import check_point
from mckibben.result import Column, Listing, Remark, Result, Severity, column, draw, number, table
from mckibben.units import factor

if TYPE_CHECKING:
    from mckibben.result import Figure


def warning_texts(notes: Iterable[Remark]) -> list[str]:
    """Texts of remarks that are not mere details."""
    shown = [note for note in notes if note.severity is not Severity.NOTE]
    return [f"{note.text}; {note.remedy}" if note.remedy else note.text for note in shown]


def data_remarks(points: IsobaricDataset) -> Iterator[Remark]:
    """Yield notes on the reading of the points, and on a missing length, which scenarios need."""
    if points.table.attrs.get("initial_length") is None:
        text = "no muscle.yaml for scenarios, since the initial length is unknown"
        yield Remark.note("initial_length", text, "give --initial-length")
    for text in points.table.attrs.get("preprocessing", "").splitlines():
        yield Remark.note("data", text)


def parameter_listing(
    shown: Mapping[str, tuple[str, str, str]],
    estimates: Mapping[str, float],
    errors: Mapping[str, float],
    intervals: Mapping[str, tuple[float, float]],
    level: float = 0.95,
) -> Listing:
    """Table of parameters, by name those in shown units: shown unit, unit of the numbers, and meaning."""
    sizes = {name: factor(unit, own) for name, (unit, own, _) in shown.items()}
    columns: dict[str, tuple[Column, Sequence[object]]] = {
        "parameter": (Column(), list(shown)),
        "estimate": (Column(digits=6), [estimates[name] / size for name, size in sizes.items()]),
        "standard error": (Column(digits=2), [errors[name] / size for name, size in sizes.items()]),
        f"{100 * level:g} % from": (Column(digits=5), [intervals[name][0] / size for name, size in sizes.items()]),
        "to": (Column(digits=5), [intervals[name][1] / size for name, size in sizes.items()]),
        "unit": (Column(), [unit for unit, *_ in shown.values()]),
        "meaning": (Column(), [meaning for *_, meaning in shown.values()]),
    }
    return Listing("parameters", columns)


class Fit(Result, metaclass=CheckedCalls):
    """Force law identified from data, by `identify`.

    Attributes
    ----------
    law
        Law with the estimates; its domain is the range of the points used.
    standard_errors
        Classical standard errors by parameter, in SI, for independent points; NaN where the parameter is at a bound.
    correlations
        Shape (parameters, parameters), in the order of `estimates`.
    rmse, max_error
        Root mean square and largest absolute residual [N].
    leave_one_pressure_out
        Cross-validation errors; None if unavailable, as a note explains.
    notes, dataset
        Reasons not to rely on the results, and summary of the data.
    residuals
        Shape (points_used,): measured minus fitted force [N]; None if read from a file without points.
    robust
        Cluster-robust standard errors, the basis of the intervals; None with too few groups, as a note explains.
    regression
        Points and least-squares solution; None if read from a file without points.
    outliers
        Points left out because they are off the smooth surface through the others.
    """

    suggestions: ClassVar[Mapping[str, str]] = {
        "force": "predict(contraction, pressure)",
        "simulate": "Scenario.simulate(), with the fit's file as the law of a muscle",
        "summary": "to_text()",
        "parameters": "estimates",
        "muscle": "mk.Muscle(specimen, fit.law); a fit by `mk.identify` gives one",
    }

    law: ForceLaw
    standard_errors: Mapping[str, float]
    correlations: Floats
    rmse: float = column("N", "root mean square residual", digits=3)
    max_error: float = column("N", "largest residual", digits=3)
    points_used: int = column("", "points used")
    points_slack: int = column("", "slack points left out")
    leave_one_pressure_out: LeaveOnePressureOut | None
    notes: tuple[Remark, ...]
    dataset: DatasetSummary
    residuals: Floats | None = None
    robust: RobustErrors | None = None
    regression: Regression | None = None
    outliers: tuple[Outlier, ...] = ()

    @property
    def estimates(self) -> dict[str, float]:
        """Parameters by name, in SI, linear ones first."""
        return {p.name: float(getattr(self.law, p.name)) for p in self.law.parameters()}

    @property
    def robust_covariance(self) -> Floats:
        """Covariance with the robust standard errors, if available; 0 for parameters at a bound."""
        errors = np.array([self._errors[0][name] for name in self.estimates])
        return np.nan_to_num(self.correlations * np.outer(errors, errors))

    def draws(self, rng: np.random.Generator, count: int) -> dict[str, Floats]:
        """Return draws of the parameters by name, from a normal distribution with the `robust_covariance`."""
        covariance = self.robust_covariance
        known = np.diag(covariance) > 0
        draws = np.tile(np.array(list(self.estimates.values())), (count, 1))
        draws[:, known] += rng.multivariate_normal(np.zeros(known.sum()), covariance[np.ix_(known, known)], count)
        return dict(zip(self.estimates, draws.T, strict=True))

    @checked_call
    def predict(self, contraction: ArrayLike, pressure: ArrayLike) -> Floats:
        """Return the force [N] at contractions [-] and gauge pressures [Pa], never below 0; the arguments broadcast.

        Warns outside the domain of the fit; `force_intervals` gives the uncertainty.
        """
        contraction, pressure = map(np.asarray, check_point(contraction, pressure))  # type: ignore[arg-type]
        if text := self.law.domain.describe_outside(contraction, pressure):
            warnings.warn(f"{text}; the law is extrapolated there", DomainWarning, stacklevel=user_level())
        return np.maximum(forces(self.law, contraction, pressure), 0.0)

    def plot(self, data: IsobaricDataset | None = None) -> Figure:  # pyrefly: ignore[bad-override]
        """Return a figure of points, fitted curves and residuals, see `mckibben.report.isobaric`.

        Default: the points of the fit; `IdentificationError` if it was read from a file, which has none.
        """
        return draw("isobaric", self.require_regression().points if data is None else data, self)

    def intervals(self, level: float = 0.95) -> dict[str, Interval]:
        """Confidence intervals by parameter, in SI, for errors common to strokes or, if unknown, to pressures."""
        errors, freedom = self._errors
        halves = {name: float(t_quantile(level, freedom[name])) * errors[name] for name in errors}
        return {name: Interval(value - halves[name], value + halves[name]) for name, value in self.estimates.items()}

    def force_intervals(self, contraction: ArrayLike, pressure: ArrayLike, *, level: float = 0.95) -> ForceIntervals:
        """Pointwise confidence interval and prediction interval of the force [N], negative where the muscle is slack.

        The confidence interval has the error of the parameters and the misfit of the law, which is the mean square of
        the errors at left-out pressures less their noise, and grows with the distance from the hull of the points
        (docs/uncertainty.md); the prediction interval, also the scatter of the points. How far the law is off between
        the contractions is in neither.

        Parameters
        ----------
        contraction, pressure
            Contraction [-] and pressure [Pa]; they broadcast.
        level
            As for `intervals`.

        Raises
        ------
        IdentificationError
            If the fit was read from a file without points.
        """
        check_level(level)
        regression = self.require_regression()
        contraction, pressure = np.asarray(contraction, float), np.asarray(pressure, float)
        value = forces(self.law, contraction, pressure)
        free = [regression.problem.names[i] for i in regression.free]
        gradients = design_matrix(self.law, free, contraction, pressure)
        model = regression.error_model
        variance, freedom = model.variance(gradients)
        square, free_residuals = (np.full_like(freedom, number) for number in model.residual_variance)
        of_law = [(variance, freedom)]
        if lopo := self.leave_one_pressure_out:
            domain = self.law.domain
            places = np.column_stack([np.ravel(values) for values in np.broadcast_arrays(contraction, pressure)])
            side = (places[:, 1] > domain.pressure_max).astype(int) - (places[:, 1] < domain.pressure_min)
            distance = hull_distance(domain, places)
            if held_loads(regression.points.table) is not None:
                force = regression.points.force
                distance = np.maximum(distance, load_distance(np.ravel(value), force) / np.ptp(force))
            unseen, few = lopo.misfit(distance, side)
            of_law.append((np.maximum(unseen - lopo.noise**2, 0.0), few))
            free_residuals = np.where(unseen > square, np.minimum(few, free_residuals), free_residuals)
            square = np.maximum(square, unseen)
        scatter = square, free_residuals
        return ForceIntervals(t_interval(level, value, of_law), t_interval(level, value, [of_law[0], scatter]))

    def require_regression(self) -> Regression:
        """Return the regression, or raise an `IdentificationError` if the fit was read from a file."""
        if self.regression is None:
            raise IdentificationError(
                f"this fit of {type(self.law).__name__} was read from a file without its points",
                remedy="identify it again from the data",
            )
        return self.regression

    @property
    def _errors(self) -> tuple[Mapping[str, float], Mapping[str, float]]:
        """Standard errors and degrees of freedom by parameter."""
        if self.robust:
            return self.robust.standard_errors, self.robust.degrees_of_freedom
        free = sum(not np.isnan(error) for error in self.standard_errors.values())
        return self.standard_errors, dict.fromkeys(self.standard_errors, float(self.points_used - free))

    def verdict(self) -> str:
        """Return how well the law describes the points, and points at pressures that were left out."""
        name, lopo = self.dataset.specimen or "unnamed specimen", self.leave_one_pressure_out
        points, share = self.regression.points if self.regression else None, ""
        if points is not None and self.residuals is not None:
            share = f" ({100 * self.rmse / float((points.force - self.residuals).max()):.2g} % of the largest)"
        held = "pressures" if points is None or held_loads(points.table) is None else "loads"
        unseen = f"; {lopo.rmse:.3g} N at {held} left out" if lopo else ""
        law = type(self.law).__name__
        return f"{law} describes {self.points_used} points of {name} to {self.rmse:.3g} N{share}{unseen}"

    @property
    def warnings(self) -> tuple[str, ...]:
        """Texts of the remarks that are not mere details."""
        return tuple(warning_texts(self.remarks()))

    def remarks(self) -> Iterable[Remark]:
        """Return the notes, and what the standard errors and the scatter are."""
        yield from self.notes
        yield Remark.note("law", f"{self.law.equation}; domain: {self.law.domain}")
        errors = self.robust
        kind = f"cluster-robust (CR2) by {errors.by.value}, {errors.groups} groups" if errors else "classical"
        yield Remark.note("standard_errors", f"standard errors: {kind}")
        if count := sum(p.penalised for p in type(self.law).parameters()):
            text = f"deviations from Eq. 2: {count} coefficients, in `estimates` and the file"
            if self.regression:
                text += f"; {self.regression.solution.effective_parameters:.1f} effective parameters in total"
            yield Remark.note("law", text)

    @property
    @number("N", "error at pressures left out", digits=3)
    def held_out_error(self) -> float | None:
        """Root mean square error at left-out pressures [N]; None without cross-validation."""
        return self.leave_one_pressure_out.rmse if self.leave_one_pressure_out else None

    @table()
    def parameters_with_intervals(self) -> list[Listing]:
        """Parameters in published units, with 95 % intervals."""
        return [self.parameter_table()]

    def parameter_table(self, level: float = 0.95) -> Listing:
        """Parameters in published units, with intervals of a confidence level."""
        shown = {p.name: (p.shown, p.unit, p.meaning) for p in type(self.law).parameters() if not p.penalised}
        return parameter_listing(shown, self.estimates, self._errors[0], self.intervals(level), level)

    def to_yaml(self, path: str | os.PathLike[str]) -> None:
        """Write everything to a file that `from_yaml` reads, with the points if there are at most 5000.

        The parameters have the digits that the residuals justify: rounded, they move the force by less than 1 % of the
        RMSE at the points. Other numbers of the fit have six, the points nine.
        """
        write_fit(self, Path(path))

    @classmethod
    def from_yaml(cls, path: str | os.PathLike[str]) -> Fit:
        """Read a file written by `to_yaml`; raises a `ScenarioError` with every problem and its line."""
        fields = read_fields(Path(path))
        if fields is None:
            problem = Problem("has a law, but not the numbers of its fit", remedy="give a file that `identify` wrote")
            raise ScenarioError(os.fspath(path), [problem])
        return cls(**fields)
