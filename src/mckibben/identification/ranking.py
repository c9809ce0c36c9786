"""Ranking of force laws by cross-validation."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from mckibben.component.calls import checked_call
from mckibben.dataset import IsobaricDataset
from mckibben.dataset.preprocessing import held_loads
from mckibben.errors import IdentificationError
from mckibben.identification.design import check_design
from mckibben.identification.fit import data_remarks
from mckibben.identification.fitting import check_law_type
from mckibben.identification.outliers import find_outliers, without_outliers
from mckibben.identification.regression import (
    CrossValidation,
    NotIdentifiableError,
    contraction_blocks,
    pressure_blocks,
)
from mckibben.identification.summary import Outlier, left_out
from mckibben.identification.with_friction import (
    FitWithFriction,
    identify_with_friction,
)
from mckibben.muscle import LAWS, ForceLaw
from mckibben.muscle.slopes import unphysical
from mckibben.notebook import Progress, notebook_progress
from mckibben.result import Column, Remark, Result, Severity, TableColumns, column
from mckibben.units import show

BLOCKS = ("pressure", "contraction")
"""Kinds of cross-validation blocks."""
_RATIO = 1.5  # of errors up to which a law is nearly as good as another


@dataclass(frozen=True)
class RankedLaw:
    """Entry of a ranking: a law, named by its class.

    Attributes
    ----------
    fit, refused
        Fit by `identify_with_friction`, or None and the reason if the law was refused, or another fitted in its place.
    cross_validation
        Errors by available kind of block: "pressure" (of a test at constant loads, the load), of which "inside" are
        those at inner blocks, which are interpolated, and "edges" those at the lowest and the highest, which are
        extrapolated; and "contraction" (inner blocks only).
    aicc
        Corrected Akaike information criterion; NaN with too few points.
    flags
        Reasons against the law for this muscle, such as a parameter at its bound.
    remarks
        Blocks without which the law is not determined, and effective parameters.
    """

    law: str
    fit: FitWithFriction | None = None
    refused: str = ""
    cross_validation: dict[str, CrossValidation] = field(default_factory=dict, repr=False)
    aicc: float = math.nan
    flags: tuple[str, ...] = ()
    remarks: tuple[str, ...] = ()

    @property
    def held_out(self) -> dict[str, float]:
        """Cross-validation RMSE [N] inside the data, by available kind of block."""
        crosses = self.cross_validation
        inner = crosses | ({"pressure": crosses["inside"]} if "inside" in crosses else {})
        return {name: inner[name].rmse for name in BLOCKS if name in inner}

    @property
    def edge_error(self) -> float:
        """Cross-validation RMSE [N] at the lowest and the highest pressure; infinite if they are not told apart."""
        return self.cross_validation["edges"].rmse if "edges" in self.cross_validation else math.inf

    @property
    def error(self) -> float:
        """Geometric mean of the cross-validation RMSE [N] inside the data; infinite without any."""
        errors = self.held_out.values()
        return math.prod(errors) ** (1 / len(errors)) if errors else math.inf

    @property
    def parameters(self) -> int:
        """Number of parameters."""
        return len(self.fit.estimates if self.fit else LAWS[self.law].parameters() if self.law in LAWS else ())


class Ranking(Result):
    """Laws by cross-validation error, the best first and the refused last.

    Ordered by the geometric mean of the RMSE at inner blocks of pressure and of contraction. Laws that are not
    determined without some block come last; without any blocks AICc decides. Where loading and unloading differ, each
    law is fitted with its friction, as by `identify`.

    Attributes
    ----------
    points, slack
        Taut points, and number of slack points left out.
    missing
        Reason why a kind of block is not available, by its name.
    outliers
        Points left out of all fits because they are off the smooth surface through the others.
    """

    figures: ClassVar = ("ranking",)
    heading: ClassVar = "laws"

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
        """Return the criterion, and the verdict on the best law: that of its own fit."""
        fitted = [entry for entry in self.entries if entry.fit]
        refused = f" ({len(self.entries) - len(fitted)} not fitted)" if len(fitted) < len(self.entries) else ""
        criterion = "errors at blocks left out inside the data" if self.blocks else "AICc"
        best = f": best {self.best.law}. {self.best.fit.verdict()}" if fitted and self.best.fit else ""
        return f"{len(fitted)} laws{refused} by {criterion}{best}"

    def remarks(self) -> Iterable[Remark]:
        """Return remarks on points and tests that are left out, on the choice, and on each law."""
        yield from data_remarks(self.points)
        yield from left_out(self.outliers)
        fitted = [entry for entry in self.entries if entry.fit]
        if not fitted:
            return
        best, first = self.best, self.entries[0].law
        assert best.fit is not None
        yield from (note for note in best.fit.notes if note.severity is Severity.SEVERE)
        if best.law != first:
            yield Remark.note("law", f"selected: {best.law}; {first} is flagged and not substantially better")
        other = min((entry for entry in fitted if not entry.flags), key=lambda entry: entry.edge_error, default=best)
        if _RATIO * other.edge_error < best.edge_error < math.inf:
            errors = f"{other.edge_error:.3g} N at the outermost {self.held}s, against {best.edge_error:.3g} N"
            yield Remark.note("law", f"{other.law} extrapolates better than {best.law}: {errors}")
        for name, reason in self.missing.items():
            yield Remark.note("cross_validation", f"no cross-validation over {name}s: {reason}")
        for entry in self.entries:
            for what, texts in (("not fitted", [entry.refused]), ("flagged", entry.flags), ("note on", entry.remarks)):
                if any(texts):
                    yield Remark.note(entry.law, f"{what} {entry.law.removesuffix('Law')}: {'; '.join(texts)}")

    def declared(self) -> TableColumns:
        """Return the laws with their errors, the best first."""
        fits = [(entry, entry.fit) for entry in self.entries if entry.fit]
        columns: dict[str, tuple[Column, object]] = {
            "law": (Column(), [entry.law.removesuffix("Law") for entry, _ in fits]),
            "parameters": (Column(), [entry.parameters for entry, _ in fits]),
            "rmse": (Column("N", "RMSE", digits=3), [fit.rmse for _, fit in fits]),
        }
        kinds = {"pressure": f"held-out {self.held}s", "contraction": "held-out contractions"}
        kinds |= {"inside": f"inner {self.held}s", "edges": f"outermost {self.held}s"}
        for name, title in kinds.items():
            crosses = [entry.cross_validation.get(name) for entry, _ in fits]
            if any(crosses):
                columns[name] = Column("N", title, digits=3), [cross.rmse if cross else math.nan for cross in crosses]
        if any(fit.friction for _, fit in fits):
            widths: list[object] = [fit.friction.half_width if fit.friction else math.nan for _, fit in fits]
            columns["half_width"] = Column("N", "half width of friction", digits=3), widths
        else:  # with friction the laws are not fitted to the same numbers
            least = min((entry.aicc for entry, _ in fits if entry.aicc == entry.aicc), default=0.0)
            columns["aicc"] = Column("", "AICc difference"), [entry.aicc - least for entry, _ in fits]
        return super().declared() | columns

    @property
    def held(self) -> str:
        """Quantity that was held along the paths of the test: "pressure" or "load"."""
        return "pressure" if held_loads(self.points.table) is None else "load"

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
    progress, entries = progress or notebook_progress(), []
    for i, kind in enumerate(kinds):
        if progress:
            progress(kind.__name__, i / len(kinds))
        entries.append(_ranked(kind, dataset, robust=robust))
    if progress:
        progress("ranked", 1.0)
    entries.sort(key=_order)
    used = next((entry.fit.outliers for entry in entries if entry.fit), outliers)
    return Ranking(tuple(entries), points, len(means) - len(points), _blocks(points)[1], used)


def _order(entry: RankedLaw) -> tuple[bool, int, float, float]:
    aicc = math.inf if math.isnan(entry.aicc) else entry.aicc
    return entry.fit is None, -len(entry.cross_validation), entry.error, aicc


def _blocks(points: IsobaricDataset) -> tuple[dict[str, np.ndarray], dict[str, str]]:
    """Labels by kind of block, and the reasons why other kinds are missing."""
    blocks: dict[str, np.ndarray] = {}
    missing: dict[str, str] = {}
    loads = held_loads(points.table)
    levels, reason = pressure_blocks(points) if loads is None else (loads, "")
    if levels is None:
        missing["pressure"] = reason
    else:
        blocks["pressure"] = levels
    blocks["contraction"] = contraction_blocks(points)
    if not blocks["contraction"].any():
        del blocks["contraction"]
        missing["contraction"] = "there are fewer than three contractions"
    return blocks, missing


def _ranked(kind: type[ForceLaw], dataset: IsobaricDataset, *, robust: bool) -> RankedLaw:
    try:
        fit = identify_with_friction(kind, dataset, robust=robust)
    except IdentificationError as error:
        return RankedLaw(kind.__name__, refused=str(error))
    if type(fit.law) is not kind:
        return RankedLaw(kind.__name__, refused=next(note.text for note in fit.notes if note.field == "law"))
    regression = fit.require_regression()
    cross_validation: dict[str, CrossValidation] = {}
    remarks: list[str] = []
    blocks = _blocks(regression.points)[0]
    for name, labels in blocks.items():
        try:
            cross_validation[name] = regression.cross_validated(name, labels)
        except NotIdentifiableError as error:
            block = show(float(error.block), "bar") if name == "pressure" else f"{name} {error.block}"
            remarks.append(f"without {block} {error.reason}")
    bounds = [name for name, out in zip(fit.estimates, regression.at_bound, strict=True) if out]
    misspecified = bounds and regression.problem.prior is None  # deviations make a bound harmless
    flags = [f"{' and '.join(bounds)} at a bound: the law is probably misspecified"] if misspecified else []
    if reason := unphysical(fit.law):
        flags.append(reason)
    effective = regression.solution.effective_parameters
    if effective < len(fit.estimates):
        remarks.append(f"its prior leaves {effective:.1f} effective parameters")
    if "pressure" in cross_validation and len(levels := np.unique(blocks["pressure"])) > 2:
        ends = np.isin(blocks["pressure"], levels[[0, -1]])
        for name, part in (("inside", ~ends), ("edges", ends)):
            cross_validation[name] = cross_validation["pressure"].within(part)
    return RankedLaw(
        kind.__name__,
        fit,
        cross_validation=cross_validation,
        aicc=regression.solution.aicc,
        flags=tuple(flags),
        remarks=tuple(remarks),
    )


def _nearly_as_good(entry: RankedLaw, first: RankedLaw, *, difference: float = 2.0) -> bool:
    """Whether an error is at most a ratio of the first or, without errors, the AICc is larger by a `difference`.

    Up to a difference of 2, a model has substantial support: K. Burnham and D. Anderson, "Model Selection and
    Multimodel Inference", Springer 2002, section 2.6.
    """
    if first.cross_validation:
        return entry.error <= _RATIO * first.error
    return entry.aicc <= first.aicc + difference
