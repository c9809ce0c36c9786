"""Every law fitted to the same points and ranked by what it makes of points that it has not seen."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from mckibben.dataset import IsobaricDataset
from mckibben.errors import IdentificationError
from mckibben.identification.cross_validation import MOST_BLOCKS, CrossValidation, NotIdentifiableError, pressure_blocks
from mckibben.identification.fit import Fit
from mckibben.identification.fitting import (
    ResidualCorrelation,
    identify,
    residual_correlation,
    unphysical,
    without_direction_means,
)
from mckibben.muscle import LAWS, ForceLaw
from mckibben.units import show

BLOCKS = ("pressure", "direction", "phase", "repeat")
"""What is left out as a whole, one after the other."""

_STRONG = 0.999  # correlation of two parameters
_COUNTED_SCATTER = 1  # the scatter is a number of the model too
_AS_GOOD = 1.5  # times the least error
_SUPPORTED = 2.0  # difference of AICc up to which a model has substantial support (Burnham and Anderson 2002, sec. 2.6)


@dataclass(frozen=True)
class RankedLaw:
    """One law in a ranking.

    Attributes
    ----------
    law
        The name of its kind.
    fit
        To all taut points; None where it was refused.
    refused
        Why there is no fit; empty where there is one.
    unseen
        Errors at blocks of points left out, by "pressure", "direction", "phase" and "repeat", as far as these are
        known; without what the directions differ by on average, which is friction.
    aicc
        Akaike's criterion with the correction for few points; NaN where there are too few.
    structure
        What the residuals have in common.
    flags
        Reasons not to take the law for this muscle, as sentences: a shape at its bound, forces that no muscle has.
    remarks
        What to know of its numbers: parameters that trade off, blocks without which it is not determined.
    """

    law: str
    fit: Fit | None = None
    refused: str = ""
    cross_validation: dict[str, CrossValidation] = field(default_factory=dict, repr=False)
    aicc: float = math.nan
    residual_correlations: ResidualCorrelation | None = None
    flags: tuple[str, ...] = ()
    remarks: tuple[str, ...] = ()

    @property
    def error(self) -> float:
        """What it is ranked by: the largest of its RMSEs at blocks left out [N]; infinite without any."""
        return max((cross_validated.rmse for cross_validated in self.cross_validation.values()), default=math.inf)

    @property
    def parameters(self) -> int:
        """How many numbers the law has."""
        return len(LAWS[self.law].parameters()) if self.law in LAWS else len(self.fit.estimates) if self.fit else 0

    def record(self) -> dict[str, Any]:
        """All numbers, for JSON; forces in N."""
        cross_validation = {
            f"unseen_{name}_rmse_N": cross_validated.rmse for name, cross_validated in self.cross_validation.items()
        }
        fit, residual_correlations = self.fit, self.residual_correlations
        return {
            "law": self.law,
            "parameters": self.parameters,
            "refused": self.refused or None,
            "rmse_N": fit.rmse if fit else None,
            "max_N": fit.max_error if fit else None,
            **cross_validation,
            "aicc": self.aicc,
            "residual_correlation_along_contraction": residual_correlations.along_contraction
            if residual_correlations
            else None,
            "residual_correlation_along_pressure": residual_correlations.along_pressure
            if residual_correlations
            else None,
            "flags": list(self.flags),
            "remarks": list(self.remarks),
        }


@dataclass(frozen=True)
class Ranking:
    """Laws by their errors at what they have not seen, the best first and the refused last.

    A law that is not determined without some block stands behind those that are; where nothing can be left out,
    Akaike's criterion decides.

    Attributes
    ----------
    entries
        One a law.
    points
        The taut plateau means that all were fitted to.
    slack
        How many slack points were left out.
    missing
        Why a kind of block could not be left out, by its name.
    """

    entries: tuple[RankedLaw, ...]
    points: IsobaricDataset = field(repr=False)
    slack: int
    missing: dict[str, str]

    @property
    def best(self) -> RankedLaw:
        """The first without a flag, if it is nearly as good as the very first; else the very first.

        Nearly is 1.5 times its error, or, where no block could be left out, an AICc at most 2 above its own.

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

    def of(self, law: str) -> RankedLaw:
        """The entry of a law by the name of its kind.

        Raises
        ------
        IdentificationError
            If it was not ranked.
        """
        for entry in self.entries:
            if entry.law == law:
                return entry
        ranked = ", ".join(entry.law for entry in self.entries)
        raise IdentificationError(f"{law!r} was not ranked", value=law, remedy=f"ranked are {ranked}")

    def records(self) -> list[dict[str, Any]]:
        """One dictionary a law, in order."""
        return [entry.record() for entry in self.entries]

    @property
    def blocks(self) -> tuple[str, ...]:
        """The kinds of blocks that were left out."""
        return tuple(name for name in BLOCKS if any(name in entry.cross_validation for entry in self.entries))

    @property
    def criterion(self) -> str:
        """Ranking criterion: "unseen RMSE", or "AICc" where no block could be left out."""
        return "unseen RMSE" if self.blocks else "AICc"


def rank(
    dataset: IsobaricDataset,
    laws: Iterable[type[ForceLaw]] = tuple(LAWS.values()),
    *,
    progress: Callable[[str, float], None] | None = None,
) -> Ranking:
    """Fit laws to a dataset and rank them by their errors at whole blocks of points left out.

    Parameters
    ----------
    dataset
        Measured points.
    laws
        Kinds of laws; all unless given.
    progress
        Called with what is done and which part of the work is done, 0 to 1.

    Returns
    -------
    Ranking
        A law that the points cannot determine stands in it with the reason.

    Raises
    ------
    IdentificationError
        If there is no taut point.

    Examples
    --------
    >>> from mckibben import catalog
    >>> from mckibben.muscle import ExponentialLaw, ReynoldsLaw
    >>> ranking = rank(catalog.dataset("dmsp-10-250-martens2017"), [ReynoldsLaw, ExponentialLaw])
    >>> [(entry.law, round(entry.error, 2)) for entry in ranking.entries]
    [('ExponentialLaw', 1.34), ('ReynoldsLaw', 32.37)]
    """
    means = dataset.plateau_means()
    points = means.taut
    if not len(points):
        raise IdentificationError(f"all {len(means)} points are slack", remedy="measure at higher pressures")
    blocks, missing = _blocks(points)
    kinds = list(laws)
    entries = []
    for i, kind in enumerate(kinds):
        if progress:
            progress(kind.__name__, i / len(kinds))
        entries.append(_ranked(kind, means, blocks))
    if progress:
        progress("ranked", 1.0)
    entries.sort(
        key=lambda entry: (entry.fit is None, -len(entry.cross_validation), entry.error, _last_if_nan(entry.aicc))
    )
    return Ranking(tuple(entries), points, len(means) - len(points), missing)


def _blocks(points: IsobaricDataset) -> tuple[dict[str, np.ndarray], dict[str, str]]:
    """What can be left out, and why the rest cannot."""
    blocks: dict[str, np.ndarray] = {}
    missing: dict[str, str] = {}
    levels, reason = pressure_blocks(points)
    if levels is None:
        missing["pressure"] = reason
    else:
        blocks["pressure"] = levels
    for name in BLOCKS[1:]:
        labels = points.table[name].to_numpy() if name in points.table else np.empty(0, "<U1")
        count = np.count_nonzero(np.unique(labels) != "") if labels.dtype.kind == "U" else len(np.unique(labels))
        if count == 0:
            missing[name] = f"no {name} is recorded"
        elif count == 1 or count > MOST_BLOCKS:
            missing[name] = f"there is one {name} only" if count == 1 else f"there are {count} of them"
        else:
            blocks[name] = labels
    return blocks, missing


def _ranked(kind: type[ForceLaw], means: IsobaricDataset, blocks: dict[str, np.ndarray]) -> RankedLaw:
    try:
        fit = identify(kind, means)
    except IdentificationError as error:
        return RankedLaw(kind.__name__, refused=str(error))
    regression = fit.regression
    assert regression is not None
    cross_validation: dict[str, CrossValidation] = {}
    remarks = [
        f"{first} and {second} trade off (correlation {correlation:+.4f})"
        for first, second, correlation in fit.strongest_correlations(len(fit.estimates) ** 2)
        if abs(correlation) > _STRONG
    ]
    for name, labels in blocks.items():
        try:
            cross_validated = regression.cross_validated(name, labels)
        except NotIdentifiableError as error:
            block = show(float(error.block), "bar") if name == "pressure" else f"{name} {error.block}"
            remarks.append(f"without {block} {error.reason}")
        else:
            cross_validation[name] = CrossValidation(
                without_direction_means(cross_validated.residuals, regression.points), cross_validated.by_block
            )
    bounds = [name for name, at_bound in zip(fit.estimates, regression.at_bound, strict=True) if at_bound]
    flags = [f"{' and '.join(bounds)} at a bound: the data ask for what the law cannot be"] if bounds else []
    if reason := unphysical(fit.law):
        flags.append(reason)
    residuals = regression.solution.residuals
    return RankedLaw(
        kind.__name__,
        fit,
        cross_validation=cross_validation,
        aicc=_aicc(residuals, len(fit.estimates)),
        residual_correlations=residual_correlation(regression.points, residuals),
        flags=tuple(flags),
        remarks=tuple(remarks),
    )


def _nearly_as_good(entry: RankedLaw, first: RankedLaw) -> bool:
    if first.cross_validation:
        return entry.error <= _AS_GOOD * first.error
    return entry.aicc <= first.aicc + _SUPPORTED


def _last_if_nan(value: float) -> float:
    return math.inf if math.isnan(value) else value


def _aicc(residuals: np.ndarray, parameters: int) -> float:
    """Akaike's criterion for errors of one unknown size, corrected for few points (Hurvich and Tsai 1989)."""
    count, numbers = len(residuals), parameters + _COUNTED_SCATTER
    left = count - numbers - 1
    if left <= 0:
        return math.nan
    squares = float(residuals @ residuals)
    return count * math.log(max(squares, 1e-300) / count) + 2 * numbers + 2 * numbers * (numbers + 1) / left
