"""A force law, with friction where loading and unloading differ."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import field, replace
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from mckibben.binding import call
from mckibben.component.calls import checked_call
from mckibben.dataset import IsobaricDataset
from mckibben.errors import IdentificationError, RangeError
from mckibben.identification.fit import Fit, data_remarks
from mckibben.identification.fitting import WITH_FRICTION, fit_law
from mckibben.identification.friction import HysteresisFit, identify_hysteresis
from mckibben.identification.friction_model import FrictionForm
from mckibben.identification.grouping import at_fixed_lengths
from mckibben.identification.loading_path import NoHysteresisError, loop_half_width, with_last_motion
from mckibben.muscle import ForceLaw, MaxwellSlip, Muscle, NoFriction, Specimen
from mckibben.muscle.air import inner_volume, volume_terms
from mckibben.result import Listing, Remark, column, table
from mckibben.units import Diameter, Volume

if TYPE_CHECKING:
    from mckibben.result import Figure


class FitWithFriction(Fit):
    """Fit of a law, with friction where it was identified: the result of `identify_with_friction`.

    Attributes
    ----------
    hysteresis
        Friction and drift of the force sensor; None if the law was fitted without them.
    points
        Points of the fit, corrected for friction and drift; without friction, the measured ones.
    note
        The choice between both, in words; empty if there was none.
    points_read, points_left_out
        Points of the dataset, which are used, slack as measured, or left out: outliers, points without a direction,
        rows at reversals whose friction or rate is not known, and points that the law has slack.
    """

    figures: ClassVar = ("fit",)
    files: ClassVar = ("fit.yaml", "muscle.yaml")
    suggestions: ClassVar = {**Fit.suggestions, "joint": "mk.joint(fit.muscle(), 'pulley', radius='30 mm')"}

    hysteresis: HysteresisFit | None = None
    points: IsobaricDataset = field(kw_only=True)
    note: str = ""
    points_read: int = column("", "points read", default=0)
    points_left_out: int = column("", "other points left out", default=0)

    def write(self, folder: Path) -> None:
        """Write the fit and, with an initial length, the muscle for scenarios and protocols."""
        self.to_yaml(folder / "fit.yaml")
        call("write_identified", folder / "muscle.yaml", self)

    def verdict(self) -> str:
        """Return the verdict of the law, and that of the friction."""
        return ". ".join([super().verdict(), *([self.hysteresis.verdict()] if self.hysteresis else [])])

    def remarks(self) -> Iterable[Remark]:
        """Return the remarks of the law and of the friction, and the choice between both."""
        if self.note:
            yield Remark.note("friction", self.note) if self.hysteresis else Remark.warning("friction", self.note)
        yield from super().remarks()
        yield from self.hysteresis.notes if self.hysteresis else ()
        yield from data_remarks(self.points)

    @table()
    def law_and_friction(self) -> Iterable[Listing]:
        """Return the tables of the law and friction, identified together."""
        return titled(self.hysteresis.listings(), "law and friction") if self.hysteresis else ()

    @property
    def friction(self) -> MaxwellSlip | None:
        """Friction of the muscle, None without it."""
        return self.hysteresis.friction if self.hysteresis else None

    @checked_call
    def muscle(
        self, specimen: Specimen | None = None, *, diameter: Diameter | None = None, fill: Volume | None = None
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
                remedy = "read them with initial_length='300 mm', or give muscle(Specimen('my muscle', 0.3))"
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
            specimen = replace(specimen, volume_terms=volume_terms(self.law, length, fill))
        return Muscle(specimen, self.law, self.friction or NoFriction())

    def plot(self, data: IsobaricDataset | None = None) -> Figure:  # pyrefly: ignore[bad-override]
        """Return a figure of points, curves and residuals without friction, see `mckibben.report.isobaric`."""
        return super().plot(self.points if data is None else data)


def titled(listings: Iterable[Listing], title: str) -> Iterable[Listing]:
    """Listings of a part of a result, those without a title with the name of the part."""
    return [replace(listing, title=listing.title or title) for listing in listings]


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
        differ significantly between loading and unloading, and the points determine it, whatever the law.

    Raises
    ------
    IdentificationError
        As `identify` and, with `friction`, `identify_hysteresis`.
    """
    note, hysteresis, gap = "", None, 0.0
    try:
        gap = _half_gap(dataset) if friction is None else 0.0
    except IdentificationError as error:
        note = f"fitted without friction: {error}"
    if friction or gap:
        try:
            hysteresis = identify_hysteresis(law, dataset, drift=drift, form=form, robust=robust)
        except IdentificationError as error:
            if friction:
                raise
            note = f"loading and unloading differ, but the friction is not identified: {error}"
    if not hysteresis:
        fit = fit_law(law, dataset, robust=robust)
        if friction is None or not shows_hysteresis(dataset):  # a note says why there is none, or the points do not
            notes = (one for one in fit.notes if one.field != "friction" or not (note or one.remedy == WITH_FRICTION))
            fit = replace(fit, notes=tuple(notes))
        return FitWithFriction(**vars(fit) | _counts(fit, dataset), points=dataset, note=note)
    fit = replace(hysteresis.fit, outliers=hysteresis.outliers)
    if at_fixed_lengths(dataset) and (lopo := fit.leave_one_pressure_out):
        # All points of a length have one direction: no pressure that is left out shows the error of the friction.
        rmse = float(np.hypot(lopo.rmse, hysteresis.standard_errors["half_width"]))
        fit = replace(fit, leave_one_pressure_out=replace(lopo, rmse=rmse))
    if gap:
        without = (hysteresis.residuals + hysteresis.friction_force)[hysteresis.used]
        note = (
            f"loading and unloading differ: fitted with friction, RMSE {hysteresis.rmse:.3g} N; without it, "
            f"{np.sqrt(np.mean(without**2)):.3g} N"
        )
    return FitWithFriction(
        **vars(fit) | _counts(fit, dataset), hysteresis=hysteresis, points=hysteresis.corrected_points, note=note
    )


def _counts(fit: Fit, dataset: IsobaricDataset) -> dict[str, int]:
    """Numbers of points that were read, those that are slack as measured, and those that are neither that nor used."""
    slack = int(np.count_nonzero(dataset.slack))
    return {
        "points_read": len(dataset),
        "points_slack": slack,
        "points_left_out": len(dataset) - fit.points_used - slack,
    }


def shows_hysteresis(dataset: IsobaricDataset) -> bool:
    """Whether forces at the same pressure and contraction differ significantly between loading and unloading."""
    try:
        return _half_gap(dataset) > 0
    except IdentificationError:
        return False


def _half_gap(dataset: IsobaricDataset) -> float:
    """Half the difference between the directions [N], 0 if not significant; raises `loop_half_width`'s others."""
    if len(dataset.directions) < 2:
        return 0.0
    means = with_last_motion(dataset)
    try:
        return loop_half_width(means, ~means.slack)[0]
    except NoHysteresisError:
        return 0.0
