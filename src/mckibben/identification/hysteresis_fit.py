"""What an identification of hysteresis found: law, friction, drift, and what they leave of each measured point."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from mckibben.dataset import IsobaricDataset
from mckibben.errors import IdentificationError
from mckibben.identification.fit import DatasetSummary
from mckibben.muscle import ForceLaw, MaxwellSlip, Muscle, Specimen
from mckibben.units import bar, mm, show


@dataclass(frozen=True, eq=False)
class Drift:
    """What the force sensor's zero did: straight lines between knots.

    Attributes
    ----------
    time
        Shape (knots,), of the dataset's own clock [s].
    offset, standard_errors
        Shape (knots,) [N].
    """

    time: NDArray[np.float64]
    offset: NDArray[np.float64]
    standard_errors: NDArray[np.float64]

    @property
    def rate(self) -> float:
        """Mean rate [N/s]: of the straight line that is nearest to the knots."""
        return float(np.polyfit(self.time - self.time[0], self.offset, 1)[0])


@dataclass(frozen=True, eq=False)
class HysteresisFit:
    """A law and its friction, identified together; `identify_hysteresis` makes it.

    Attributes
    ----------
    law
        The static law, that of neither direction; its domain is the range of the points.
    friction
        The hysteresis. Its viscous part is 0: points measured at rest say nothing of it.
    standard_errors
        By name, in SI: the parameters of the law unless it was given, ``half_width``, ``growth`` and
        ``presliding_length``; NaN where the data do not determine one.
    correlations
        Shape (parameters, parameters), in the order of `standard_errors`; NaN for what is not determined.
    drift
        Of the force sensor; None where the points show none.
    rmse, max_error
        Root of the mean squared residual, and the largest without sign [N].
    tension, friction_force, offset, residuals
        Shape (points,), in the order of the dataset: the law's force, what friction and drift add to it, and what is
        left of the measured one [N]. Slack points have a residual, but count only where there is a drift to be found.
    points_used, points_slack
        How many the fit rests on, and slack ones among all.
    warnings
        Sentences: what a reader should know before trusting the numbers.
    dataset
        Which data.
    """

    law: ForceLaw
    friction: MaxwellSlip
    standard_errors: dict[str, float]
    correlations: NDArray[np.float64] = field(repr=False)
    drift: Drift | None
    rmse: float
    max_error: float
    tension: NDArray[np.float64] = field(repr=False)
    friction_force: NDArray[np.float64] = field(repr=False)
    offset: NDArray[np.float64] = field(repr=False)
    residuals: NDArray[np.float64] = field(repr=False)
    points_used: int
    points_slack: int
    warnings: tuple[str, ...]
    dataset: DatasetSummary

    @property
    def force(self) -> NDArray[np.float64]:
        """The modelled force at each point [N], shape (points,)."""
        return self.tension + self.friction_force + self.offset

    def muscle(self, specimen: Specimen) -> Muscle:
        """A muscle that follows the law with its friction."""
        return Muscle(specimen, self.law, self.friction)

    def corrected(self, dataset: IsobaricDataset) -> IsobaricDataset:
        """The dataset that this was identified from, without friction and drift: plateau means for a static law.

        Raises
        ------
        IdentificationError
            If it is not that dataset.
        """
        means = dataset.plateau_means()
        if len(means) != len(self.residuals) or not np.allclose(means.force, self.force + self.residuals):
            raise IdentificationError(
                f"{means!r} is not the dataset that the hysteresis was identified from",
                remedy="give the same, whole",
            )
        force = means.force - self.friction_force - self.offset
        return IsobaricDataset(means.table.assign(force=("point", force)))

    def report(self) -> str:
        """The fit as text."""
        friction, errors = self.friction, self.standard_errors
        pressure = f"at {show(friction.reference_pressure, 'bar', 3)}"
        rows = [
            ("half width", f"{friction.half_width:.4g}", _error(errors["half_width"]), f"N {pressure}"),
            ("growth", f"{friction.growth * bar:.3g}", _error(errors["growth"] * bar), "N/bar"),
            (
                "presliding length",
                f"{friction.presliding_length / mm:.4g}",
                _error(errors["presliding_length"] / mm),
                "mm",
            ),
        ]
        lines = [
            f"{type(self.law).__name__} with Maxwell-slip friction of {friction.elements} elements",
            f"{self.dataset.specimen or 'unnamed specimen'}: {self.points_used} points used, {self.points_slack} slack",
            "",
            f"{'':17}  {'estimate':>8}  {'error':>7}",
            *(f"{name:17}  {value:>8}  {error:>7}  {unit}" for name, value, error, unit in rows),
        ]
        if self.drift is not None:
            lines.append(f"drift of the force sensor: {self.drift.rate * 3600:+.3g} N/h on average")
        lines.append(f"residuals: RMSE {self.rmse:.3g} N, maximum {self.max_error:.3g} N")
        lines += [f"warning: {warning}" for warning in self.warnings]
        return "\n".join(lines)


def _error(value: float) -> str:
    return f"{value:.2g}" if np.isfinite(value) else "-"
