"""Prior data of a plan: measured points, the law linearised about its estimate, and the noise model."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field

import numpy as np

from mckibben import catalog
from mckibben.dataset import IsobaricDataset
from mckibben.errors import IdentificationError, ParameterError
from mckibben.experiment_design.information import Floats, Indices, NoiseModel, estimate_noise
from mckibben.identification import Fit, Grouping, identify
from mckibben.identification.grouping import finest_grouping, group_labels
from mckibben.identification.least_squares import force_gradients
from mckibben.muscle import Domain, ForceLaw, forces

DIRECTION_SIGN = {"loading": 1.0, "unloading": -1.0}
"""Sign of the friction force, by direction."""
_CHART = "festo-tool-10mm"
_DEFAULT_NOISE = 0.01  # of the highest force, without a fit


def initial_guess(law_type: type[ForceLaw], points: IsobaricDataset, given: ForceLaw | None) -> tuple[ForceLaw, str]:
    """The law to linearise about if there is no fit, scaled to the taut points, and its origin."""
    if given is not None:
        if type(given) is not law_type:
            raise ParameterError(
                f"the guess is a {type(given).__name__}, but the plan is for {law_type.__name__}",
                remedy="give a guess of that kind, or plan for the kind of the guess",
            )
        law, origin = given, "the given guess"
    else:
        try:
            law = identify(law_type, catalog.dataset(_CHART)).law
        except IdentificationError as error:
            raise IdentificationError(
                f"there is no guess for {law_type.__name__}: the chart {_CHART} does not determine it either ({error})",
                remedy="give a law to begin with (--guess)",
            ) from error
        origin = f"{law_type.__name__} fitted to the chart {_CHART}"
    law = dataclasses.replace(law, domain=Domain())
    names = [p.name for p in law_type.linear_parameters]
    if not len(points) or not names:
        return law, origin
    place = points.contraction, points.pressure
    offset = forces(dataclasses.replace(law, **dict.fromkeys(names, 0.0)), *place)  # pyrefly: ignore[bad-argument-type]
    part = forces(law, *place) - offset
    scale = float(part @ (points.force - offset) / (part @ part)) if part @ part else np.nan
    if not (np.isfinite(scale) and scale > 0):
        return law, origin
    law = dataclasses.replace(law, **{name: scale * float(getattr(law, name)) for name in names})  # pyrefly: ignore[bad-argument-type]
    return law, f"{origin}, scaled by {scale:.3g} to the data"


@dataclass(frozen=True, eq=False)
class PriorData:
    """Measured points and the law linearised in its parameters."""

    law: ForceLaw  # fitted or guessed
    points: IsobaricDataset = field(repr=False)  # taut ones
    measured: IsobaricDataset = field(repr=False)  # all
    friction: bool  # half the gap between the directions is the last unknown
    rows: Floats = field(repr=False)  # design matrix, (taut points, unknowns)
    strokes: Indices = field(repr=False)  # (taut points,)
    noise: NoiseModel
    half_width: float  # of the friction [N], 0 without a fit
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
    def of(
        cls,
        data: IsobaricDataset | Fit,
        law_type: type[ForceLaw] | None,
        friction: bool | None,
        noise: float | None,
        stroke_error: float | None,
        guess: ForceLaw | None,
    ) -> PriorData:
        """Prior data from points or a fit; arguments as for `mckibben.experiment_design.plan`."""
        fit, reason = (data, "") if isinstance(data, Fit) else _fit(data, law_type)
        measured = data.plateau_means() if isinstance(data, IsobaricDataset) else data.require_regression().points
        points = measured.taut
        notes: list[str] = []
        residuals = np.zeros(len(points))
        if fit is None:
            assert law_type is not None
            law, origin = initial_guess(law_type, points, guess)
            notes.append(f"no fit ({reason}): the plan is linearised about a guess, {origin}")
        else:
            law, residuals = fit.law, fit.require_regression().solution.residuals
        if any(p.penalised for p in type(law).parameters()):
            raise ParameterError(
                f"{type(law).__name__} has deviations with a prior: points cannot be planned for them",
                remedy="plan for ExponentialLaw, which it extends",
            )
        modelled = bool(len(points.directions)) if friction is None else friction
        signs = np.zeros(len(points))
        if "direction" in points.table:
            signs = np.array([DIRECTION_SIGN.get(str(d), 0.0) for d in points.table["direction"].to_numpy()])
        names = [p.name for p in type(law).parameters()]
        rows = force_gradients(law, names, points.contraction, points.pressure)
        rows = np.concatenate([rows, signs[:, None]], axis=1) if modelled else rows
        by, ungrouped = Grouping.POINT, "there is no fit"
        if fit is not None:
            by, ungrouped = fit.require_regression().default_grouping
        if stroke_error is not None:
            by = finest_grouping(points) if stroke_error else Grouping.POINT
        strokes = group_labels(points, by) if len(points) else np.empty(0, np.int64)
        grouped = strokes if by is not Grouping.POINT else None
        components = _noise_model(rows, residuals, grouped, measured, noise, stroke_error)
        if fit is None and noise is None:
            notes.append(f"the noise of a point is unknown: {components.point:.3g} N is assumed, see noise")
        elif by is Grouping.POINT and stroke_error is None:
            notes.append(f"the points of a stroke count as independent: {ungrouped}")
        width = float(np.linalg.lstsq(rows, residuals, rcond=1e-10)[0][-1]) if modelled and len(rows) else 0.0
        return cls(law, points, measured, modelled, rows, strokes, components, width, tuple(notes))


def _fit(data: IsobaricDataset, law_type: type[ForceLaw] | None) -> tuple[Fit | None, str]:
    """The fit to the points, or the reason why there is none."""
    if law_type is None:
        raise ParameterError("a plan needs the kind of law", remedy="give one, such as ExponentialLaw, or a fit")
    try:
        return identify(law_type, data), ""
    except IdentificationError as error:
        return None, error.message


def _noise_model(
    rows: Floats,
    residuals: Floats,
    strokes: Indices | None,
    measured: IsobaricDataset,
    noise: float | None,
    stroke_error: float | None,
) -> NoiseModel:
    """Variance components as given, else estimated from residuals."""
    highest = float(measured.force.max()) if len(measured) else 0.0
    found = estimate_noise(rows, residuals, strokes) if np.any(residuals) else NoiseModel(_DEFAULT_NOISE * highest)
    point = found.point if noise is None else noise
    if not point > 1e-9 * highest:
        raise IdentificationError(
            "the residuals are zero to rounding: there is no uncertainty to reduce"
            if highest > 0
            else "all forces are zero, so the noise of a point cannot be estimated",
            value=point,
            remedy="give the standard deviation of a point on the rig (noise)",
        )
    return NoiseModel(point, found.stroke if stroke_error is None else stroke_error)
