"""Ranking of force laws by cross-validation."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from mckibben.component.calls import checked_call
from mckibben.dataset import IsobaricDataset
from mckibben.errors import IdentificationError
from mckibben.identification.design import check_design
from mckibben.identification.fit import Fit
from mckibben.identification.fitting import check_law_type, fit_law, without_direction_means
from mckibben.identification.outliers import find_outliers, without_outliers
from mckibben.identification.regression import (
    CrossValidation,
    NotIdentifiableError,
    contraction_blocks,
    pressure_blocks,
)
from mckibben.identification.summary import Outlier, left_out
from mckibben.identification.with_friction import shows_hysteresis
from mckibben.muscle import LAWS, ForceLaw
from mckibben.muscle.slopes import unphysical
from mckibben.notebook import Progress, notebook_progress
from mckibben.result import Column, Listing, Remark, Result, column
from mckibben.units import show

BLOCKS = ("pressure", "contraction")
"""Kinds of cross-validation blocks."""


@dataclass(frozen=True)
class RankedLaw:
    """Entry of a ranking: a law, named by its class.

    Attributes
    ----------
    fit, refused
        Fit to all taut points, or None and the reason if the law was refused.
    cross_validation
        Errors by available kind of block: "pressure" and "contraction" (inner blocks only); without
         the mean difference between the directions, which is friction.
    aicc
        Corrected Akaike information criterion; NaN with too few points.
    flags
        Reasons against the law for this muscle, such as a parameter at its bound.
    remarks
        Blocks without which the law is not determined, and effective parameters.
    """

    law: str
    fit: Fit | None = None
    refused: str = ""
    cross_validation: dict[str, CrossValidation] = field(default_factory=dict, repr=False)
    aicc: float = math.nan
    flags: tuple[str, ...] = ()
    remarks: tuple[str, ...] = ()

    @property
    def error(self) -> float:
        """Geometric mean of the cross-validation RMSE [N]; infinite without any."""
        errors = [cross.rmse for cross in self.cross_validation.values()]
        return math.prod(errors) ** (1 / len(errors)) if errors else math.inf

    @property
    def parameters(self) -> int:
        """Number of parameters."""
        return len(self.fit.estimates if self.fit else LAWS[self.law].parameters() if self.law in LAWS else ())


class Ranking(Result):
    """Laws by cross-validation error, the best first and the refused last.

    Ordered by the geometric mean of the RMSE at blocks of pressure and of contraction. Laws that are not
    determined without some block come last; without any blocks AICc decides.

    Attributes
    ----------
    points, slack
        Taut points of all fits, and number of slack points left out.
    missing
        Reason why a kind of block is not available, by its name.
    outliers
        Points left out of all fits because they are off the smooth surface through the others.
    """

    figures: ClassVar = ("ranking",)

    entries: tuple[RankedLaw, ...]
    points: IsobaricDataset
    slack: int = column("", "slack points left out")
    missing: dict[str, str]
    outliers: tuple[Outlier, ...] = ()

    @property
    def best(self) -> RankedLaw:
        """First entry without a flag, if it is nearly as good as the first; else the first.

        Nearly means at most 1.5 times its error or, without cross-validation, an AICc at most 2 higher.

        Raises
        ------
        IdentificationError
            If every law was refused.
        """
        fitted = [entry for entry in self.entries if entry.fit]
        if not fitted:
            reasons = "\n  ".join(f"{entry.law}: {entry.refused}" for entry in self.entries)
            raise IdentificationError(f"no law could be fitted\n  {reasons}", remedy="measure at more points")
        first = fitted[0]
        return next((e for e in fitted if not e.flags and _nearly_as_good(e, first)), first)

    def verdict(self) -> str:
        """Return the best law and its errors."""
        fitted = [entry for entry in self.entries if entry.fit]
        refused = f" ({len(self.entries) - len(fitted)} refused)" if len(fitted) < len(self.entries) else ""
        criterion = "cross-validation RMSE" if self.blocks else "AICc"
        best = f": best {self.best.law}, RMSE {self.best.fit.rmse:.3g} N" if fitted and self.best.fit else ""
        return f"{len(fitted)} laws{refused} at {len(self.points)} taut points, by {criterion}{best}"

    def remarks(self) -> Iterable[Remark]:
        """Return remarks on points and tests that are left out, on the choice, and on each law."""
        yield from left_out(self.outliers)
        if not any(entry.fit for entry in self.entries):
            return
        best, first = self.best.law, self.entries[0].law
        if shows_hysteresis(self.points):
            text = "loading and unloading differ; laws are ranked without friction"
            remedy = f"fit {best} alone, with friction (command line: --law {best.removesuffix('Law')})"
            yield Remark.warning("friction", text, remedy)
        if best != first:
            yield Remark.note("law", f"selected: {best}; {first} is flagged and not substantially better")
        for name, reason in self.missing.items():
            yield Remark.note("cross_validation", f"no cross-validation over {name}s: {reason}")
        for entry in self.entries:
            for what, texts in (("not fitted", [entry.refused]), ("flagged", entry.flags), ("note on", entry.remarks)):
                if any(texts):
                    yield Remark.note(entry.law, f"{what} {entry.law.removesuffix('Law')}: {'; '.join(texts)}")

    def listings(self) -> Iterable[Listing]:
        """Return the laws with their errors, the best first."""
        yield from super().listings()
        fitted = [entry for entry in self.entries if entry.fit]
        least = min((entry.aicc for entry in fitted if entry.aicc == entry.aicc), default=0.0)
        columns: dict[str, tuple[Column, list[object]]] = {
            "law": (Column(), [entry.law.removesuffix("Law") for entry in fitted]),
            "parameters": (Column(), [entry.parameters for entry in fitted]),
            "rmse": (Column("N", "RMSE", digits=3), [entry.fit.rmse for entry in fitted if entry.fit]),
        }
        for name in self.blocks:
            crosses = [entry.cross_validation.get(name) for entry in fitted]
            errors: list[object] = [cross.rmse if cross else math.nan for cross in crosses]
            columns[name] = Column("N", f"held-out {name}s", digits=3), errors
        columns["aicc"] = Column("", "AICc difference"), [entry.aicc - least for entry in fitted]
        yield Listing("laws", columns)

    @property
    def blocks(self) -> tuple[str, ...]:
        """Kinds of blocks of the cross-validation."""
        return tuple(name for name in BLOCKS if any(name in entry.cross_validation for entry in self.entries))


@checked_call
def rank(
    dataset: IsobaricDataset,
    laws: Iterable[type[ForceLaw]] = tuple(LAWS.values()),
    *,
    robust: bool = True,
    progress: Progress | None = None,
) -> Ranking:
    """Fit laws to a dataset and rank them by their cross-validation errors.

    Laws that the points do not determine are listed with the reason. `robust` is that of `identify`. `progress` is
    called with the current law and the fraction done, 0 to 1; notebooks show a progress bar.

    Raises
    ------
    IdentificationError
        If there is no taut point, or the points give no law (`check_design`).

    Examples
    --------
    >>> from mckibben import catalog
    >>> from mckibben.muscle import ExponentialLaw, ReynoldsLaw
    >>> ranking = rank(catalog.dataset("dmsp-10-250-martens2017"), [ReynoldsLaw, ExponentialLaw])
    >>> [(e.law, round(e.cross_validation["pressure"].rmse, 2)) for e in ranking.entries]
    [('ExponentialLaw', 1.34), ('ReynoldsLaw', 32.37)]
    >>> ranking.best.law
    'ExponentialLaw'
    """
    kinds = list(laws)
    for kind in kinds:
        check_law_type(kind)
    outliers = find_outliers(dataset) if robust else ()
    means = without_outliers(dataset, outliers)
    points = means.taut
    if not len(points):
        raise IdentificationError(f"all {len(means)} points are slack", remedy="measure at higher pressures")
    check_design(points)
    blocks, missing = _blocks(points)
    progress, entries = progress or notebook_progress(), []
    for i, kind in enumerate(kinds):
        if progress:
            progress(kind.__name__, i / len(kinds))
        entries.append(_ranked(kind, means, blocks))
    if progress:
        progress("ranked", 1.0)
    entries.sort(key=_order)
    return Ranking(tuple(entries), points, len(means) - len(points), missing, outliers)


def _order(entry: RankedLaw) -> tuple[bool, int, float, float]:
    aicc = math.inf if math.isnan(entry.aicc) else entry.aicc
    return entry.fit is None, -len(entry.cross_validation), entry.error, aicc


def _blocks(points: IsobaricDataset) -> tuple[dict[str, np.ndarray], dict[str, str]]:
    """Labels by kind of block, and the reasons why other kinds are missing."""
    blocks: dict[str, np.ndarray] = {}
    missing: dict[str, str] = {}
    levels, reason = pressure_blocks(points)
    if levels is None:
        missing["pressure"] = reason
    else:
        blocks["pressure"] = levels
    blocks["contraction"] = contraction_blocks(points)
    if not blocks["contraction"].any():
        del blocks["contraction"]
        missing["contraction"] = "there are fewer than three contractions"
    return blocks, missing


def _ranked(kind: type[ForceLaw], means: IsobaricDataset, blocks: dict[str, np.ndarray]) -> RankedLaw:
    try:
        fit = fit_law(kind, means, robust=False)
    except IdentificationError as error:
        return RankedLaw(kind.__name__, refused=str(error))
    regression = fit.require_regression()
    cross_validation: dict[str, CrossValidation] = {}
    remarks: list[str] = []
    for name, labels in blocks.items():
        try:
            cross = regression.cross_validated(name, labels)
        except NotIdentifiableError as error:
            block = show(float(error.block), "bar") if name == "pressure" else f"{name} {error.block}"
            remarks.append(f"without {block} {error.reason}")
        else:
            residuals = without_direction_means(cross.residuals, regression.points)
            cross_validation[name] = dataclasses.replace(cross, residuals=residuals)
    bounds = [name for name, out in zip(fit.estimates, regression.at_bound, strict=True) if out]
    misspecified = bounds and regression.problem.prior is None  # deviations make a bound harmless
    flags = [f"{' and '.join(bounds)} at a bound: the law is probably misspecified"] if misspecified else []
    if reason := unphysical(fit.law):
        flags.append(reason)
    effective = regression.solution.effective_parameters
    if effective < len(fit.estimates):
        remarks.append(f"its prior leaves {effective:.1f} effective parameters")
    return RankedLaw(
        kind.__name__,
        fit,
        cross_validation=cross_validation,
        aicc=regression.solution.aicc,
        flags=tuple(flags),
        remarks=tuple(remarks),
    )


def _nearly_as_good(entry: RankedLaw, first: RankedLaw, *, ratio: float = 1.5, difference: float = 2.0) -> bool:
    """Whether an error is at most a `ratio` of the first or, without errors, the AICc is larger by a `difference`.

    Up to a difference of 2, a model has substantial support: K. Burnham and D. Anderson, "Model Selection and
    Multimodel Inference", Springer 2002, section 2.6.
    """
    if first.cross_validation:
        return entry.error <= ratio * first.error
    return entry.aicc <= first.aicc + difference
