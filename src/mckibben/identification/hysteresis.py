"""Result of the identification of a force law, its friction and the drift of the force sensor."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from mckibben.dataset import IsobaricDataset
from mckibben.errors import IdentificationError
from mckibben.identification.estimator import (
    Floats,
)
from mckibben.identification.fit import warning_texts
from mckibben.identification.friction_model import FrictionForm
from mckibben.identification.summary import DatasetSummary
from mckibben.muscle import ForceLaw, MaxwellSlip, Muscle, Specimen
from mckibben.result import Column, Listing, Remark, Result, column, draw
from mckibben.units import factor, mm, show

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True, eq=False)
class SensorDrift:
    """Zero offset of the force sensor and its errors [N], linear between knots [s]; shape (knots,) each."""

    time: Floats
    offset: Floats
    standard_errors: Floats
    rate: float
    """Mean rate [N/s]: slope of the least-squares line through the knots."""
    rate_error: float
    """Standard error of the mean rate [N/s], robust to errors common to a level."""


@dataclass(frozen=True)
class FormComparison:
    """Forms of friction compared by held-out loops.

    Attributes
    ----------
    rmse
        Error [N] at the loops of a pressure (of a path with fewer than three pressures) left out of the fit, to first
        order in the parameters, by form; the drift is estimated from all loops.
    chosen
        Form with the fewest parameters whose error is within 5 % or one standard error of the lowest.
    """

    rmse: Mapping[FrictionForm, float]
    chosen: FrictionForm


@dataclass(frozen=True)
class LackOfFit:
    """Significant dependence of the friction that its form does not include.

    Attributes
    ----------
    quantity
        "pressure", "tension", "contraction" or "rate".
    force
        Root mean square [N] of the friction that depends on it.
    p_value
        Probability of at least this much if the form is right.
    remedy
        Form that has the dependence; None for the contraction.
    """

    quantity: str
    force: float
    p_value: float
    remedy: FrictionForm | None


class HysteresisFit(Result):
    """Law and friction identified together, by `identify_hysteresis`.

    Attributes
    ----------
    law
        Static law, midway between loading and unloading; its domain is the range of the points.
    friction
        Hysteresis, with the parameters of its form.
    form, comparison, lack_of_fit
        Form of the friction; comparison of the forms by held-out loops, None if the form was given; and significant
        dependence that the form lacks, None if there is none.
    standard_errors, correlations
        By parameter, in SI, in this order: the law's parameters (unless the law was given), ``half_width``, ``growth``,
        ``tension_growth``, ``viscous``, ``rate_growth``, ``rate_speed`` and ``presliding_length``; NaN if the form
        lacks it or the data do not determine it.
    drift
        Drift of the force sensor; None if not significant (1 %).
    rmse, max_error
        Root mean square and largest absolute residual [N].
    tension, friction_force, offset, residuals
        Shape (points,), in dataset order: force of the law, of friction, offset of the sensor, and measured minus
        modelled force [N]. Slack points count only if there is drift.
    points_used, points_slack, dataset
        Number of points used and of slack points; summary of the data.
    notes
        Reasons not to rely on the results.
    """

    law: ForceLaw
    friction: MaxwellSlip
    form: FrictionForm
    comparison: FormComparison | None
    lack_of_fit: LackOfFit | None
    standard_errors: dict[str, float]
    correlations: Floats
    drift: SensorDrift | None
    rmse: float = column("N", "RMSE of law and friction", digits=3)
    max_error: float = column("N", "largest residual", digits=3)
    tension: Floats
    friction_force: Floats
    offset: Floats
    residuals: Floats
    points_used: int
    points_slack: int
    notes: tuple[Remark, ...]
    dataset: DatasetSummary

    def verdict(self) -> str:
        """Return half width and presliding length."""
        friction, names = self.friction, f"{type(self.law).__name__} with friction of the form {self.form.value!r}"
        return (
            f"{names}: half width {friction.half_width:.3g} N, presliding length "
            f"{friction.presliding_length / mm:.3g} mm, RMSE {self.rmse:.3g} N"
        )

    def remarks(self) -> Iterable[Remark]:
        """Return the notes."""
        return self.notes

    def listings(self) -> Iterable[Listing]:
        """Return the parameters of the friction and the drift, and the comparison of forms."""
        yield from super().listings()
        rows = []
        for name, (unit, at) in _SHOWN.items():
            if value := getattr(self.friction, name):
                error, size = self.standard_errors[name], factor(unit)
                reference = (
                    show(getattr(self.friction, at), "bar" if at == "reference_pressure" else "N", 3) if at else ""
                )
                rows.append((name.replace("_", " "), value / size, error / size, unit, reference))
        if self.drift:
            rows.append(("drift of the sensor", 3600 * self.drift.rate, 3600 * self.drift.rate_error, "N/h", ""))
        titles = ("friction", "estimate", "standard error", "unit", "at")
        columns = zip(titles, zip(*rows, strict=True), strict=True)
        yield Listing("friction", {title: (Column(digits=3), values) for title, values in columns})
        if self.comparison and self.comparison.rmse:
            errors = sorted(self.comparison.rmse.items(), key=lambda item: item[1])
            forms = {
                "form": (Column("", "form of friction"), [form.value for form, _ in errors]),
                "rmse": (Column("N", "error at held-out loops", digits=3), [rmse for _, rmse in errors]),
            }
            yield Listing("forms of friction", forms, detail=True)

    @property
    def warnings(self) -> tuple[str, ...]:
        """Texts of the notes that are not mere details."""
        return tuple(warning_texts(self.notes))

    @property
    def force(self) -> Floats:
        """Modelled force at each point [N], shape (points,)."""
        return self.tension + self.friction_force + self.offset

    @property
    def undetermined(self) -> tuple[str, ...]:
        """Parameters of the friction that a simulation needs and the data do not determine."""
        return ("presliding_length",) if np.isnan(self.standard_errors["presliding_length"]) else ()

    def plot(self, data: IsobaricDataset) -> Figure:  # pyrefly: ignore[bad-override]
        """Return a figure of the loops of the identified points, see `mckibben.report.loops`."""
        return draw("loops", data, self)

    def muscle(self, specimen: Specimen) -> Muscle:
        """Muscle with the law and its friction."""
        return Muscle(specimen, self.law, self.friction)

    def corrected(self, dataset: IsobaricDataset) -> IsobaricDataset:
        """Plateau means of the identified dataset without friction and drift, for fitting a static law.

        Points that are slack, as measured or by the law, remain slack.
        """
        means = dataset.plateau_means()
        if len(means) != len(self.residuals) or not np.allclose(means.force, self.force + self.residuals):
            raise IdentificationError(
                f"{means!r} is not the dataset that the hysteresis was identified from", remedy="give the whole dataset"
            )
        force = np.where(means.slack, means.force, means.force - self.friction_force - self.offset)
        force = np.where(self.tension > 0, force, np.minimum(force, means.table.attrs["slack_force"]))
        return IsobaricDataset(means.table.assign(force=("point", force)).assign_attrs(friction="subtracted"))


_SHOWN = {
    "half_width": ("N", "reference_pressure"),
    "growth": ("N/bar", ""),
    "tension_growth": ("1", "reference_tension"),
    "viscous": ("N*s/m", ""),
    "rate_growth": ("1", ""),
    "rate_speed": ("mm/s", ""),
    "presliding_length": ("mm", ""),
}
"""Unit of the parameters of the friction in tables, and the quantity that they refer to."""
