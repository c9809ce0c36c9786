"""A force law, with friction where loading and unloading differ."""

from __future__ import annotations

from dataclasses import replace
from html import escape
from typing import TYPE_CHECKING, Any, NamedTuple

from numpy.typing import ArrayLike

from mckibben.component.calls import checked_call
from mckibben.dataset import IsobaricDataset
from mckibben.errors import IdentificationError, RangeError, no_attribute
from mckibben.identification.estimator import Floats
from mckibben.identification.fit import Fit
from mckibben.identification.fitting import WITH_FRICTION, fit_means, identify
from mckibben.identification.friction_forms import FrictionForm
from mckibben.identification.hysteresis import HysteresisFit, identify_hysteresis
from mckibben.identification.loading_path import ReversedDirectionsError, loop_half_width
from mckibben.identification.outliers import find_outliers
from mckibben.muscle import ForceLaw, MaxwellSlip, Muscle, NoFriction, Specimen
from mckibben.muscle.air import inner_volume, volume_terms


class FitWithFriction(NamedTuple):
    """Result of `identify_with_friction`.

    Attributes
    ----------
    fit
        Law fitted to `points`: without friction, to the given ones.
    hysteresis
        Friction and drift of the force sensor; None if the law was fitted without them.
    points
        Points of the fit, corrected for friction and drift.
    note
        The choice between both, in words; empty if there was none.
    """

    fit: Fit
    hysteresis: HysteresisFit | None
    points: IsobaricDataset
    note: str = ""

    @property
    def friction(self) -> MaxwellSlip | None:
        """Friction of the muscle, None without it."""
        return self.hysteresis.friction if self.hysteresis else None

    @property
    def warnings(self) -> tuple[str, ...]:
        """Reasons not to rely on the results, of the law and of the friction."""
        return self.fit.warnings + (self.hysteresis.warnings if self.hysteresis else ())

    def report(self) -> str:
        """Return law, friction and the choice between both as text."""
        found = self.hysteresis
        return "\n\n".join(filter(None, [self.fit.report(), found.report() if found else "", self.note]))

    if not TYPE_CHECKING:  # an unknown attribute stays an error of the type checker

        def __getattr__(self, name: str) -> Any:
            raise no_attribute(self, name, {one: f"fit.{one}" for one in dir(self.fit) if not one.startswith("_")})

    def __repr__(self) -> str:
        return f"<FitWithFriction: {self.fit}, {self.hysteresis or 'without friction'}>"

    def _repr_html_(self) -> str:
        found = self.hysteresis
        return self.fit._repr_html_() + (found._repr_html_() if found else "") + f"<p>{escape(self.note)}</p>"

    def muscle(
        self, specimen: Specimen | None = None, *, diameter: float | None = None, fill: float | None = None
    ) -> Muscle:
        """Return the muscle with this law and its friction, for joints.

        Default specimen: name and initial length of the points; one of the catalog, which has more, such as its rated
        range, is given: ``muscle(catalog.specimen("DMSP-10-250"))``. A muscle without braid data gets an assumed volume
        (`mckibben.muscle.air.volume_terms`) from the measured volume of air at contraction 0, `fill` [m^3], or from its
        inner `diameter` [m]. Raises `IdentificationError` without initial length, and `RangeError` for both at once or
        a diameter below 1 mm or above the length.
        """
        if specimen is None:
            attrs = self.points.table.attrs
            if (length := attrs.get("initial_length")) is None:
                remedy = "give initial_length to read_dataset, or muscle(Specimen('my muscle', 0.3))"
                raise IdentificationError("the points have no initial length", remedy=remedy)
            specimen = Specimen(attrs["specimen"] or "my muscle", length)
        length = float(specimen.initial_length)
        if fill is not None and diameter is not None:
            raise RangeError(
                "fill and diameter both give the volume", field="diameter", value=diameter, remedy="give one"
            )
        if diameter is not None:
            fill = inner_volume(length, diameter)
        if fill is not None:
            specimen = replace(specimen, volume_terms=volume_terms(self.fit.law, length, fill))
        return Muscle(specimen, self.fit.law, self.friction or NoFriction())

    @checked_call
    def predict(self, contraction: ArrayLike, pressure: ArrayLike) -> Floats:
        """Return the force without friction [N] at a contraction [-] and a pressure [Pa], as `Fit.predict`."""
        return self.fit.predict(contraction, pressure)

    def plot(self) -> Any:
        """Return a figure of points, curves and residuals without friction, see `mckibben.report.isobaric`."""
        return self.fit.plot(self.points)


@checked_call
def identify_with_friction(
    law: type[ForceLaw],
    dataset: IsobaricDataset,
    *,
    friction: bool | None = None,
    drift: bool = True,
    form: FrictionForm | None = None,
    robust: bool = True,
) -> FitWithFriction:
    """Fit a law, together with friction where the dataset shows it.

    Parameters
    ----------
    law, dataset, drift, form, robust
        As for `identify_hysteresis`.
    friction
        True or False to fit with or without friction. Default: with it if forces at the same pressure and contraction
        differ significantly between loading and unloading, the points determine it, and the law fits better than
        half of this difference.

    Raises
    ------
    IdentificationError
        As `identify` and, with `friction`, `identify_hysteresis`.
    """
    note, found, gap = "", None, 0.0
    try:
        gap = _half_gap(dataset) if friction is None else 0.0
    except ReversedDirectionsError as error:
        note = f"fitted without friction: {error}"
    if friction or gap:
        try:
            found = identify_hysteresis(law, dataset, drift=drift, form=form, robust=robust)
        except IdentificationError as error:
            if friction:
                raise
            note = f"loading and unloading differ, but the friction is not identified: {error}"
    if found and gap and found.rmse > gap:
        note = (
            f"loading and unloading differ from their mean by {gap:.3g} N, but {law.__name__} leaves residuals of "
            f"{found.rmse:.3g} N, too large to identify friction: fitted without it; try a law that fits better, such "
            "as SmoothLaw (command line: --law smooth)"
        )
        if drift and "time" not in dataset.table:
            note += ", or give the time of each point: without times, sensor drift is confounded with friction"
        found = None
    points = found.corrected(dataset) if found else dataset
    # the misfit of the friction, which is largest behind reversals, does not make a point an outlier
    outliers = find_outliers(dataset.plateau_means()) if robust else ()
    fit = fit_means(law, points, outliers) if found else identify(law, points, robust=robust)
    if note and not found:  # it says why there is no friction
        fit = replace(fit, warnings=tuple(one.replace(WITH_FRICTION, "") for one in fit.warnings))
    if found and gap:
        note = (
            f"loading and unloading differ: fitted with friction, RMSE {found.rmse:.3g} N; without friction it is "
            f"{identify(law, dataset, robust=robust).rmse:.3g} N"
        )
    return FitWithFriction(fit, found, points, note)


def shows_hysteresis(dataset: IsobaricDataset) -> bool:
    """Whether forces at the same pressure and contraction differ significantly between loading and unloading."""
    try:
        return _half_gap(dataset) > 0
    except ReversedDirectionsError:
        return False


def _half_gap(dataset: IsobaricDataset) -> float:
    """Half the difference between the directions [N], 0 if not significant; raises `ReversedDirectionsError`."""
    if len(dataset.directions) < 2:
        return 0.0
    means = dataset.plateau_means()
    try:
        return loop_half_width(means, ~means.slack)
    except ReversedDirectionsError:
        raise
    except IdentificationError:
        return 0.0
