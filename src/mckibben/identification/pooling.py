"""One force law for several specimens of one make, which differ in length: pooled fit, and errors when left out."""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from mckibben.component.calls import user_level
from mckibben.component.checks import check_positive
from mckibben.dataset import IsobaricDataset
from mckibben.errors import IdentificationError, McKibbenWarning
from mckibben.identification.estimator import Bools, Floats, Ints, bounded_minimum, t_quantile
from mckibben.identification.fit import Fit
from mckibben.identification.fitting import fit_law
from mckibben.identification.least_squares import FitProblem, grid_search, solve
from mckibben.identification.outliers import find_outliers, without_outliers
from mckibben.identification.smooth import SMOOTH_LAWS
from mckibben.identification.summary import left_out
from mckibben.muscle import ExponentialLaw, ForceLaw, Specimen, forces
from mckibben.result import Column, Listing, Remark, Result, column
from mckibben.units import show


class LeftOutSpecimen(NamedTuple):
    """Prediction of a specimen from the others.

    Attributes
    ----------
    name, length, points
        Name, initial length [m], and number of taut points.
    rmse
        Error [N] of the law of the other specimens.
    strength
        Force over that of the law of the other specimens.
    """

    name: str
    length: float
    points: int
    rmse: float
    strength: float


class PooledFit(Result):
    """Law of a make, by `identify_pooled`.

    Attributes
    ----------
    fit
        Law fitted to the points of all specimens, over the contraction of the active length (initial length minus dead
        length), and divided by the strengths.
    dead_length, dead_length_error
        Length [m] at the ends of each specimen that does not contract, and its standard error (jackknife over the
        specimens); 0 and NaN if it does not lower the scatter.
    strengths
        Force of each specimen over that of the law, shape (specimens,), with a mean of 1.
    left_out
        Predictions of each specimen from the others.
    strength_scatter, scatter
        Standard deviations among specimens, of the strength [-] and of the remaining error [N], from `left_out`.
    """

    fit: Fit
    dead_length: float = column("m", "dead length", "mm", digits=3)
    dead_length_error: float = column("m", "its standard error", "mm", digits=2)
    strengths: Floats
    left_out: tuple[LeftOutSpecimen, ...]
    strength_scatter: float = column("1", "scatter of the strength among specimens", "%", digits=2)
    scatter: float = column("N", "remaining scatter among specimens", digits=2)

    def verdict(self) -> str:
        """Return the errors of the law, of all specimens and of those that are left out."""
        dead = f" with a dead length of {show(self.dead_length, 'mm', 3)}" if self.dead_length else ""
        unseen = max(specimen.rmse for specimen in self.left_out)
        pool = f"{type(self.law).__name__} of {len(self.left_out)} specimens of one make{dead}"
        return f"{pool}: {self.fit.rmse:.3g} N, at most {unseen:.3g} N at one that is left out"

    def remarks(self) -> Iterable[Remark]:
        """Return the remarks of the fit."""
        return self.fit.notes

    def listings(self) -> Iterable[Listing]:
        """Return the numbers of the pool, the left-out specimens, and the parameters."""
        yield from super().listings()
        columns = {
            "name": Column("", "specimen"),
            "length": Column("m", "length", "mm"),
            "points": Column("", "points"),
            "rmse": Column("N", "error when left out", digits=3),
            "strength": Column("1", "strength"),
        }
        specimens = zip(columns.items(), zip(*self.left_out, strict=True), strict=True)
        yield Listing("left-out specimens", {name: (mark, values) for (name, mark), values in specimens})
        yield self.fit.parameter_table()

    @property
    def law(self) -> ForceLaw:
        """The law, over the contraction of the active length."""
        return self.fit.law

    def specimen(self, length: float, name: str = "") -> Specimen:
        """Specimen of an initial length [m] as it is measured; its own initial length is the active one."""
        check_positive("specimen", "m", length=length - self.dead_length)
        return Specimen(name or f"pooled, {show(length, 'mm')}", length - self.dead_length)

    def predict(
        self, contraction: ArrayLike, pressure: ArrayLike, length: float, *, level: float = 0.95
    ) -> tuple[Floats, Floats, Floats]:
        """Force [N] of another specimen of this make, and the ends of its prediction interval.

        The contraction [-] is that of the whole initial length [m]. The interval is that of Student's t with the number
        of specimens minus one; it has the scatter among specimens, and broadcasts as the force.
        """
        active = np.asarray(contraction, float) * (length / (length - self.dead_length))
        force = forces(self.law, active, np.asarray(pressure, float))
        quantile = float(t_quantile(level, len(self.left_out) - 1))
        half = quantile * np.hypot(self.strength_scatter * force, self.scatter)
        return force, force - half, force + half


def identify_pooled(law: type[ForceLaw], datasets: Sequence[IsobaricDataset], *, robust: bool = True) -> PooledFit:
    """Fit one law to several specimens of one make: equal diameter and braid, several initial lengths.

    Each specimen has a strength, and all have the same dead length at their ends if it lowers the scatter of specimens
    about the law of the others, whatever their strength, by more than 5 % (docs/laws.md).

    Parameters
    ----------
    law
        Class of the law, such as `ExponentialLaw`.
    datasets
        One per specimen, at least three, with their initial lengths.
    robust
        That of `identify`; a `McKibbenWarning` names the points that are left out.

    Raises
    ------
    IdentificationError
        If there are fewer than three specimens, an initial length is unknown, or the points do not determine the law.
    """
    count = len(datasets)
    if count < 3:
        message = f"{count} specimens do not show how specimens differ"
        remedy = "give at least three datasets, one per specimen"
        raise IdentificationError(message, value=count, lower=3, remedy=remedy)
    pool = _Pool.of(law, datasets, robust)
    others = [pool.specimen != number for number in range(count)]
    deads = np.array([pool.dead_length(selected) for selected in others])
    with_dead, without = (
        sum(pool.solved(dead, selected)[2] for dead, selected in zip(some, others, strict=True))
        for some in (deads, np.zeros(count))
    )
    has_dead_length = with_dead < 0.95**2 * without  # the scatter is less by 5 % or more
    deads, everything = deads * has_dead_length, np.ones(len(pool.force), bool)
    dead = pool.dead_length(everything) if has_dead_length else 0.0
    left_out, squares = [], 0.0
    for number, (data, without_it, selected) in enumerate(zip(pool.parts, deads.tolist(), others, strict=True)):
        strengths = pool.solved(without_it, selected)[0]
        tension = forces(pool.fit(without_it, strengths, selected).law, pool.contraction(without_it), pool.pressure)
        tension, force = tension[~selected], pool.force[~selected]
        strength, rest = _scaled(force, tension)
        squares += rest
        name, rmse = data.table.attrs["specimen"] or f"specimen {number + 1}", np.sqrt(np.mean((force - tension) ** 2))
        left_out.append(LeftOutSpecimen(name, float(pool.lengths[number]), len(force), float(rmse), strength))
    strengths = pool.solved(dead, everything)[0]
    error = float(np.sqrt((count - 1) * np.var(deads)))
    return PooledFit(
        pool.fit(dead, strengths, everything),
        dead,
        error if has_dead_length else math.nan,
        strengths,
        tuple(left_out),
        float(np.sqrt(np.mean([(specimen.strength - 1) ** 2 for specimen in left_out]))),
        math.sqrt(squares / len(pool.force)),
    )


def _scaled(force: Floats, tension: Floats) -> tuple[float, float]:
    """Strength that fits a tension to a force [N] best, and the sum of squares [N^2] that it leaves."""
    strength = float(force @ tension / (tension @ tension))
    return strength, float(np.sum((force - strength * tension) ** 2))


@dataclass(frozen=True, eq=False)
class _Pool:
    """Taut points of all specimens."""

    law: type[ForceLaw]
    parts: tuple[IsobaricDataset, ...]
    lengths: Floats
    specimen: Ints
    whole: Floats
    pressure: Floats
    force: Floats

    @classmethod
    def of(cls, law: type[ForceLaw], datasets: Sequence[IsobaricDataset], robust: bool) -> _Pool:
        parts = []
        for number, data in enumerate(datasets):
            if data.table.attrs.get("initial_length") is None:
                raise IdentificationError(
                    f"the initial length of dataset {number + 1} is unknown",
                    remedy="give each dataset its initial_length",
                )
            means = data.plateau_means()
            outliers = find_outliers(means) if robust else ()
            for text in left_out(outliers):
                warnings.warn(f"dataset {number + 1}: {text.text}", McKibbenWarning, stacklevel=user_level())
            parts.append(without_outliers(means, outliers).taut)
        columns = (
            np.concatenate([getattr(part, name) for part in parts]) for name in ("contraction", "levels", "force")
        )
        lengths = np.array([part.table.attrs["initial_length"] for part in parts], float)
        return cls(law, tuple(parts), lengths, np.repeat(np.arange(len(parts)), [*map(len, parts)]), *columns)

    def contraction(self, dead: float) -> Floats:
        """Contraction [-] of the active length."""
        length = self.lengths[self.specimen]
        return self.whole * (length / (length - dead))

    def dataset(self, dead: float, strengths: Floats, selected: Bools) -> IsobaricDataset:
        """Points of one law: over the active contraction, forces divided by the strengths."""
        return IsobaricDataset.of(
            pressure=self.pressure[selected],
            contraction=self.contraction(dead)[selected],
            force=(self.force / strengths[self.specimen])[selected],
            slack_force=-1e9,
        )

    def fit(self, dead: float, strengths: Floats, selected: Bools) -> Fit:
        """Fit of the law to the selected points."""
        return fit_law(self.law, self.dataset(dead, strengths, selected), robust=False)

    def dead_length(self, selected: Bools, *, shortest: float = -0.1, longest: float = 0.3) -> float:
        """Dead length [m] from the selected points; 0 if the lengths differ by less than 10 %.

        Its bounds are the shares `shortest` and `longest` of the length of the shortest specimen.
        """
        least = float(self.lengths.min())
        if np.ptp(self.lengths) < 0.1 * least:
            return 0.0
        ends = shortest * least, longest * least
        return bounded_minimum(lambda dead: self.solved(dead, selected)[1], *ends, 1e-3 * least)

    def solved(self, dead: float, selected: Bools) -> tuple[Floats, float, float]:
        """Strengths with a mean of 1 by alternate fits, and sums of squares [N^2] at selected and other points."""
        kind = ExponentialLaw if self.law in SMOOTH_LAWS else self.law
        strengths, present = np.ones(len(self.parts)), np.unique(self.specimen[selected])
        tension = self.force
        for _ in range(3):
            problem = FitProblem.of(kind, self.dataset(dead, strengths, selected))
            solution = solve(problem, grid_search(problem))
            tension = forces(problem.law(solution.values), self.contraction(dead), self.pressure)
            own = [self.specimen == number for number in range(len(self.parts))]
            ratios, squares = np.transpose([_scaled(self.force[rows], tension[rows]) for rows in own])
            strengths[present] = ratios[present] / ratios[present].mean()
        return strengths, float(squares[present].sum()), float(np.delete(squares, present).sum())
