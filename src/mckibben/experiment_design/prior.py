"""The law and the measured points that a plan starts from."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from mckibben import catalog
from mckibben.dataset import IsobaricDataset
from mckibben.errors import IdentificationError, ParameterError
from mckibben.experiment_design.information import Spread, estimated_spread
from mckibben.identification import Fit, Grouping, identify
from mckibben.identification.intervals import force_gradients
from mckibben.identification.uncertainty import finest_grouping, group_labels
from mckibben.muscle import Domain, ForceLaw, forces

_CHART = "festo-tool-10mm"


def guessed_law(law_type: type[ForceLaw], points: IsobaricDataset, given: ForceLaw | None) -> tuple[ForceLaw, str]:
    """The law about which a plan is made before there is a fit, and where it comes from.

    Where none is given it is fitted to the maker's chart of a 10 mm muscle. Its linear parameters are then scaled
    together to the taut points, where there are any: a muscle of twice the area pulls twice as hard.

    Parameters
    ----------
    law_type
        The kind of law.
    points
        Taut points at hand, perhaps none.
    given
        A law of that kind.

    Raises
    ------
    ParameterError
        If the law given is of another kind.
    IdentificationError
        If there is none and the chart does not determine one either.
    """
    if given is not None:
        if type(given) is not law_type:
            raise ParameterError(
                f"the guess is a {type(given).__name__}, the plan is for {law_type.__name__}",
                remedy="give a guess of that kind, or plan for its kind",
            )
        law, origin = given, "the guess given"
    else:
        try:
            law = identify(law_type, catalog.dataset(_CHART)).law
        except IdentificationError as error:
            raise IdentificationError(
                f"there is no guess for {law_type.__name__}: the chart {_CHART} does not determine it either ({error})",
                remedy="give a law to begin with (--guess)",
            ) from error
        origin = f"{law_type.__name__} as it fits the chart {_CHART}"
    law = dataclasses.replace(law, domain=Domain())
    names = [p.name for p in law_type.linear_parameters]
    if not len(points) or not names:
        return law, origin
    place = points.contraction, points.pressure
    without = dataclasses.replace(law, **dict.fromkeys(names, 0.0))
    fixed, whole = forces(without, *place), forces(law, *place)
    part = whole - fixed
    scale = float(part @ (points.force - fixed) / (part @ part)) if part @ part else np.nan
    if not (np.isfinite(scale) and scale > 0):
        return law, origin
    law = dataclasses.replace(law, **{name: scale * float(getattr(law, name)) for name in names})
    return law, f"{origin}, times {scale:.3g} to meet the points at hand"


SIGN = {"loading": 1.0, "unloading": -1.0}
"""Of what friction adds to the force, by direction."""
_GUESSED_NOISE = 0.01  # of the highest force, where no fit tells


@dataclass(frozen=True, eq=False)
class AtHand:
    """The points at hand, and the law about which they are linear in its parameters.

    Attributes
    ----------
    law
        Fitted, or guessed.
    points, measured
        The taut ones, and all.
    friction
        Whether half the gap between the directions is an unknown, the last one.
    rows
        Shape (taut points, unknowns).
    strokes
        Shape (taut points,): which of them may share an error.
    spread
        How they scatter.
    width
        The half width of the friction [N] by the fit, where it is an unknown.
    notes
        Sentences on all that.
    """

    law: ForceLaw
    points: IsobaricDataset = field(repr=False)
    measured: IsobaricDataset = field(repr=False)
    friction: bool
    rows: NDArray[np.float64] = field(repr=False)
    strokes: NDArray[np.int64] = field(repr=False)
    spread: Spread
    width: tuple[float, ...]
    notes: tuple[str, ...] = ()

    @property
    def names(self) -> list[str]:
        """Of the unknowns."""
        return [p.name for p in type(self.law).parameters()] + ["friction"] * self.friction

    @property
    def parameters(self) -> int:
        """How many of the unknowns are parameters of the law."""
        return len(type(self.law).parameters())

    @classmethod
    def of(
        cls,
        data: IsobaricDataset | Fit,
        law_type: type[ForceLaw] | None,
        friction: bool | None,
        noise: float | None,
        stroke_error: float | None,
        guess: ForceLaw | None,
    ) -> AtHand:
        """Arguments as for `mckibben.experiment_design.plan`.

        Raises
        ------
        IdentificationError
            If the points leave nothing over, and no noise is given.
        ParameterError
            If there is neither a fit nor a kind of law.
        """
        fit, why = (data, "") if isinstance(data, Fit) else _fit(data, law_type)
        measured = data.plateau_means() if isinstance(data, IsobaricDataset) else data.require_regression().points
        points = measured.taut
        notes: list[str] = []
        residuals = np.zeros(len(points))
        if fit is None:
            assert law_type is not None
            law, origin = guessed_law(law_type, points, guess)
            notes.append(f"the plan begins with a guess, {origin}, because there is no fit: {why}")
        else:
            law, residuals = fit.law, fit.require_regression().solution.residuals
        modelled = bool(len(points.directions)) if friction is None else friction
        signs = np.zeros(len(points))
        if "direction" in points.table:
            signs = np.array([SIGN.get(str(d), 0.0) for d in points.table["direction"].to_numpy()])
        names = [p.name for p in type(law).parameters()]
        rows = force_gradients(law, names, points.contraction, points.pressure)
        rows = np.concatenate([rows, signs[:, None]], axis=1) if modelled else rows
        by, ungrouped = Grouping.POINT, "there is no fit"
        if fit is not None:
            by, ungrouped = fit.require_regression().default_grouping
        if stroke_error is not None:
            by = finest_grouping(points) if stroke_error else Grouping.POINT
        strokes = group_labels(points, by) if len(points) else np.empty(0, np.int64)
        spread = _spread(rows, residuals, strokes if by is not Grouping.POINT else None, measured, noise, stroke_error)
        if fit is None and noise is None:
            notes.append(f"the scatter of a point is not known: {spread.point:.3g} N is assumed, see noise")
        elif by is Grouping.POINT and stroke_error is None:
            notes.append(f"the points of a stroke count as independent: {ungrouped}")
        width = float(np.linalg.lstsq(rows, residuals, rcond=1e-10)[0][-1]) if modelled and len(rows) else 0.0
        return cls(law, points, measured, modelled, rows, strokes, spread, (width,) * modelled, tuple(notes))


def _fit(data: IsobaricDataset, law_type: type[ForceLaw] | None) -> tuple[Fit | None, str]:
    """The fit to the points at hand, or why there is none."""
    if law_type is None:
        raise ParameterError(
            "a plan is made for a kind of law", remedy="say which, such as ExponentialLaw, or give a fit"
        )
    try:
        return identify(law_type, data), ""
    except IdentificationError as error:
        return None, error.message


def _spread(
    rows: NDArray[np.float64],
    residuals: NDArray[np.float64],
    strokes: NDArray[np.int64] | None,
    measured: IsobaricDataset,
    noise: float | None,
    stroke_error: float | None,
) -> Spread:
    """How points scatter: as given, else as the fit leaves over."""
    highest = float(measured.force.max()) if len(measured) else 0.0
    found = estimated_spread(rows, residuals, strokes) if np.any(residuals) else Spread(_GUESSED_NOISE * highest)
    point = found.point if noise is None else noise
    if not point > 1e-9 * highest:
        pulls = highest > 0
        raise IdentificationError(
            "the points lie on the law to rounding: there is no uncertainty to shrink"
            if pulls
            else "no point pulls, so nothing says how much points will scatter",
            value=point,
            remedy="give the scatter of a point that the rig will have (noise)",
        )
    return Spread(point, found.stroke if stroke_error is None else stroke_error)
