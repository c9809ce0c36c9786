"""Prior data of a plan: measured points, the law linearised about its estimate, and the noise model."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from mckibben.dataset import IsobaricDataset
from mckibben.errors import IdentificationError, ParameterError
from mckibben.experiment_design.information import Floats, Indices, NoiseModel, estimate_noise
from mckibben.identification import Fit, Grouping, fit_law
from mckibben.identification.grouping import group_labels
from mckibben.identification.least_squares import design_matrix
from mckibben.muscle import ForceLaw

DIRECTION_SIGN = {"loading": 1.0, "unloading": -1.0}
"""Sign of the friction force, by direction."""


@dataclass(frozen=True, eq=False)
class PriorData:
    """Measured points and the law linearised in its parameters."""

    law: ForceLaw
    points: IsobaricDataset = field(repr=False)  # taut ones
    measured: IsobaricDataset = field(repr=False)  # all
    friction: bool  # half the gap between the directions is the last unknown
    rows: Floats = field(repr=False)  # design matrix, (taut points, unknowns)
    strokes: Indices = field(repr=False)  # (taut points,)
    noise: NoiseModel
    half_width: float  # of the friction [N]
    notes: tuple[str, ...] = ()

    @property
    def parameters(self) -> list[str]:
        """Names of the law's parameters."""
        return [p.name for p in type(self.law).parameters()]

    @property
    def names(self) -> list[str]:
        """Names of the unknowns."""
        return self.parameters + ["friction"] * self.friction

    @classmethod
    def of(cls, data: IsobaricDataset | Fit, law_type: type[ForceLaw] | None, noise: float | None) -> PriorData:
        """Return prior data from points or a fit; arguments as for `mckibben.experiment_design.plan`.

        Raises
        ------
        IdentificationError
            If the points do not determine the law, or residuals are zero.
        ParameterError
            If the kind of law is missing, or has parameters with a prior.
        """
        if isinstance(data, Fit):
            fit = data
        elif law_type is None:
            remedy = "give one, such as ExponentialLaw"
            raise ParameterError("a plan needs the kind of law", field="law_type", remedy=remedy)
        else:
            fit = fit_law(law_type, data)
        measured = data if isinstance(data, IsobaricDataset) else data.require_regression().points
        points, law = measured.taut, fit.law
        if any(p.penalised for p in type(law).parameters()):
            message = f"{type(law).__name__} has deviations with a prior: points cannot be planned for them"
            raise ParameterError(message, remedy="plan for ExponentialLaw, which it extends")
        friction = bool(len(points.directions))
        rows = design_matrix(law, [p.name for p in type(law).parameters()], points.contraction, points.pressure)
        if friction:
            signs = [DIRECTION_SIGN.get(str(d), 0.0) for d in points.table["direction"].to_numpy()]
            rows = np.concatenate([rows, np.array(signs)[:, None]], axis=1)
        regression = fit.require_regression()
        residuals, (by, ungrouped) = regression.solution.residuals, regression.default_grouping
        strokes = group_labels(points, by)
        grouped = by is not Grouping.POINT
        noises = _noise(rows, residuals, strokes if grouped else None, noise, float(measured.force.max()))
        width = float(np.linalg.lstsq(rows, residuals, rcond=1e-10)[0][-1]) if friction else 0.0
        notes = () if grouped else (f"the points of a stroke count as independent: {ungrouped}",)
        return cls(law, points, measured, friction, rows, strokes, noises, width, notes)


def _noise(rows: Floats, residuals: Floats, strokes: Indices | None, noise: float | None, highest: float) -> NoiseModel:
    """Variance components: of a point as given or estimated from residuals, of a stroke estimated."""
    estimate = estimate_noise(rows, residuals, strokes) if np.any(residuals) else NoiseModel(0.0)
    point = estimate.point if noise is None else noise
    if not point > 1e-9 * highest:
        raise IdentificationError(
            "the residuals are zero to rounding: there is no uncertainty to reduce",
            field="noise",
            value=point,
            remedy="give the standard deviation of a point on the rig (noise)",
        )
    return NoiseModel(point, estimate.stroke)
