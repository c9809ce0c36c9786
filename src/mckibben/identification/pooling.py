"""One force law for several specimens of one make, which differ in length: pooled fit, and errors when left out."""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from mckibben.component.calls import user_level
from mckibben.component.checks import check_positive
from mckibben.dataset import IsobaricDataset
from mckibben.errors import IdentificationError, McKibbenWarning
from mckibben.identification.estimator import Floats, Ints, t_quantile
from mckibben.identification.fit import Fit
from mckibben.identification.fitting import identify
from mckibben.identification.least_squares import FitProblem, grid_search, solve
from mckibben.identification.outliers import find_outliers, without_outliers
from mckibben.identification.smooth import SMOOTH_LAWS
from mckibben.identification.summary import left_out
from mckibben.muscle import ExponentialLaw, ForceLaw, Specimen, forces
from mckibben.result import Column, Listing, Remark, Result, column
from mckibben.units import show

_AS_GOOD = 1.05  # times the lowest error
_LONGEST, _SHORTEST = 0.3, -0.1  # bounds of the dead length, of the shortest specimen
_MOST_BLOCKS = 8  # lengths of a specimen; more are grouped
_ROUNDS = 3  # of strengths and law
_CLOSE = 1e-3  # contractions closer than this are one


class PoolForm(NamedTuple):
    """Differences between the specimens of a pool that are estimated: dead length of the make, strengths."""

    dead_length: bool
    strength: bool

    @property
    def name(self) -> str:
        """Form as text."""
        parts = [word for word, has in zip(("dead length", "strengths"), self, strict=True) if has]
        return " and ".join(parts) or "the same law"


class LeftOutSpecimen(NamedTuple):
    """Prediction of a specimen from the others.

    Attributes
    ----------
    name, length, points
        Name, initial length [m], and number of taut points.
    rmse
        Error [N] of the law of the other specimens.
    lengths_rmse
        Error [N] at its lengths, each left out in turn, by the pooled fit to all other points; NaN if it has only one.
    strength
        Force over that of the law of the other specimens.
    inside
        Share of its points within the 95 % intervals that all specimens give.
    """

    name: str
    length: float
    points: int
    rmse: float
    lengths_rmse: float
    strength: float
    inside: float


class PooledFit(Result):
    """Law of a make, by `identify_pooled`.

    Attributes
    ----------
    fit
        Law fitted to the points of all specimens, over the contraction of the active length (initial length minus dead
        length), and divided by the strengths.
    form, errors
        Chosen form, and error [N] at left-out lengths by form.
    dead_length, dead_length_error
        Length [m] at the ends of each specimen that does not contract, and its standard error (jackknife over the
        specimens); 0 and NaN unless the form has it.
    left_out
        Predictions of each specimen from the others.
    strength_scatter, scatter
        Standard deviations among specimens, of the strength [-] and of the remaining error [N], from `left_out`.
    """

    fit: Fit
    form: PoolForm
    errors: dict[str, float]
    dead_length: float = column("m", "dead length", "mm", digits=3)
    dead_length_error: float = column("m", "its standard error", "mm", digits=2)
    strengths: Floats
    left_out: tuple[LeftOutSpecimen, ...]
    strength_scatter: float = column("1", "scatter of the strength among specimens", "%", digits=2)
    scatter: float = column("N", "remaining scatter among specimens", digits=2)

    def verdict(self) -> str:
        """Return the form, and the error at lengths that are left out."""
        law, count = type(self.law).__name__, len(self.left_out)
        unseen = f"{self.errors[self.form.name]:.3g} N at left-out lengths"
        return f"{law} of {count} specimens of one make, with {self.form.name}: {self.fit.rmse:.3g} N, {unseen}"

    def remarks(self) -> Iterable[Remark]:
        """Return the remarks of the fit."""
        return self.fit.notes

    def listings(self) -> Iterable[Listing]:
        """Return the numbers of the pool, the left-out specimens, the parameters, and the errors by form."""
        yield from super().listings()
        columns = {
            "name": Column("", "specimen"),
            "length": Column("m", "length", "mm"),
            "points": Column("", "points"),
            "rmse": Column("N", "error when left out", digits=3),
            "lengths_rmse": Column("N", "error at left-out lengths", digits=3),
            "strength": Column("1", "strength"),
            "inside": Column("1", "within 95 % intervals", "%", digits=3),
        }
        specimens = zip(columns.items(), zip(*self.left_out, strict=True), strict=True)
        yield Listing("left-out specimens", {name: (mark, values) for (name, mark), values in specimens})
        yield self.fit.parameter_table()
        forms = {
            "form": (Column(), list(self.errors)),
            "rmse": (Column("N", "error at left-out lengths", digits=3), list(self.errors.values())),
        }
        yield Listing("forms", forms, detail=True)

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
        active = _active(np.asarray(contraction, float), length, self.dead_length)
        force = forces(self.law, active, np.asarray(pressure, float))
        half = _half_width(force, self.strength_scatter, self.scatter, len(self.left_out), level)
        return force, force - half, force + half

    def prediction(self, length: float) -> Listing:
        """Forces of a specimen of another length [m] at the highest pressure, with 95 % intervals."""
        domain, ratio = self.law.domain, 1 - self.dead_length / length
        contraction = np.linspace(max(domain.contraction_min * ratio, 0.0), domain.contraction_max * ratio, 4)
        pressure = float(domain.pressure_max)
        force, low, high = self.predict(contraction, pressure, length)
        columns = {
            "contraction": (Column("1", "contraction", "%"), contraction),
            "force": (Column("N", "force"), force),
            "lower": (Column("N", "95 % from"), low),
            "upper": (Column("N", "to"), high),
        }
        return Listing(f"force of {show(length, 'mm')} at {show(pressure, 'bar', 3)}", columns)


def identify_pooled(law: type[ForceLaw], datasets: Sequence[IsobaricDataset], *, robust: bool = True) -> PooledFit:
    """Fit one law to several specimens of one make: equal diameter and braid, several initial lengths.

    Two corrections are estimated if they lower the error at left-out lengths by more than 5 %: a dead length at the
    ends, common to the make, and a strength of each specimen (docs/laws.md).

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
    if len(datasets) < 3:
        message = f"{len(datasets)} specimens do not show how specimens differ"
        remedy = "give at least three datasets, one per specimen"
        raise IdentificationError(message, value=len(datasets), lower=3, remedy=remedy)
    pool = _Pool.of(law, datasets, robust)
    forms = [PoolForm(dead, strength) for dead in (False, True)[: 1 + pool.several] for strength in (False, True)]
    corrections = {form: pool.corrections(form) for form in forms}
    left_out_errors = {form: pool.left_out_lengths(form, dead) for form, (dead, _) in corrections.items()}
    errors = {form: float(np.sqrt(np.nanmean(error**2))) for form, error in left_out_errors.items()}
    form = min(
        (form for form in forms if errors[form] <= _AS_GOOD * min(errors.values())),
        key=lambda form: (sum(form), errors[form]),
    )
    dead, strengths = corrections[form]
    everything = np.ones(len(pool.force), bool)
    rows, deads, ratios, rests, predicted = [], [], [], [], []
    for number, data in enumerate(pool.parts):
        own = pool.specimen == number
        without, others = pool.corrections(form, ~own)
        tension = forces(pool.fit(without, others, ~own).law, pool.contraction(without)[own], pool.pressure[own])
        ratio = float(pool.force[own] @ tension / (tension @ tension))
        deads.append(without)
        ratios.append(ratio - 1)
        rests.append(pool.force[own] - ratio * tension)
        predicted.append(tension)
        rmse, inner = (float(np.sqrt(np.mean(e**2))) for e in (pool.force[own] - tension, left_out_errors[form][own]))
        rows.append(
            (data.table.attrs["specimen"] or f"specimen {number + 1}", float(pool.lengths[number]), rmse, inner)
        )
    count = len(pool.parts)
    strength_scatter = float(np.sqrt(np.mean(np.square(ratios))))
    scatter = float(np.sqrt(np.mean(np.concatenate(rests) ** 2)))
    error = float(np.sqrt((count - 1) / count * np.sum((np.array(deads) - np.mean(deads)) ** 2)))
    left_out = tuple(
        LeftOutSpecimen(
            name,
            length,
            len(tension),
            rmse,
            inner,
            1 + ratio,
            float(np.mean(np.abs(ratio * tension + rest) <= _half_width(tension, strength_scatter, scatter, count))),
        )
        for (name, length, rmse, inner), ratio, rest, tension in zip(rows, ratios, rests, predicted, strict=True)
    )
    return PooledFit(
        pool.fit(dead, strengths, everything),
        form,
        {form.name: rmse for form, rmse in errors.items()},
        dead,
        error if form.dead_length else math.nan,
        strengths,
        left_out,
        strength_scatter,
        scatter,
    )


def _half_width(force: Floats, strength_scatter: float, scatter: float, count: int, level: float = 0.95) -> Floats:
    """Half width [N] of the prediction interval of another specimen, from the scatter among a count of specimens."""
    return float(t_quantile(level, count - 1)) * np.hypot(strength_scatter * force, scatter)


@dataclass(frozen=True, eq=False)
class _Pool:
    """Taut points of all specimens."""

    law: type[ForceLaw]
    parts: tuple[IsobaricDataset, ...]
    lengths: Floats
    specimen: Ints
    block: Ints
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
        specimen = np.repeat(np.arange(len(parts)), [len(part) for part in parts])
        blocks, first = [], 0
        for part in parts:
            blocks.append(first + _groups(part.contraction))
            first = blocks[-1].max(initial=first) + 1
        columns = (
            np.concatenate([getattr(part, name) for part in parts]) for name in ("contraction", "levels", "force")
        )
        lengths = np.array([part.table.attrs["initial_length"] for part in parts], float)
        return cls(law, tuple(parts), lengths, specimen, np.concatenate(blocks), *columns)

    @property
    def several(self) -> bool:
        """Whether the lengths differ enough for a dead length."""
        return bool(np.ptp(self.lengths) > 0.1 * self.lengths.min())

    def contraction(self, dead: float) -> Floats:
        """Contraction [-] of the active length."""
        return _active(self.whole, self.lengths[self.specimen], dead)

    def dataset(self, dead: float, strengths: Floats, selected: np.ndarray) -> IsobaricDataset:
        """Points of one law: over the active contraction, forces divided by the strengths."""
        return IsobaricDataset.of(
            pressure=self.pressure[selected],
            contraction=self.contraction(dead)[selected],
            force=(self.force / strengths[self.specimen])[selected],
            slack_force=-1e9,
        )

    def fit(self, dead: float, strengths: Floats, selected: np.ndarray) -> Fit:
        """Fit of the law to the selected points."""
        return identify(self.law, self.dataset(dead, strengths, selected), robust=False)

    def corrections(self, form: PoolForm, selected: np.ndarray | None = None) -> tuple[float, Floats]:
        """Dead length [m] and strengths of a form, from the selected points."""
        from scipy.optimize import minimize_scalar

        selected = np.ones(len(self.force), bool) if selected is None else selected
        if not form.dead_length:
            return 0.0, self._solved(form, 0.0, selected)[1]
        shortest = float(self.lengths.min())
        search: Any = minimize_scalar(
            lambda dead: self._solved(form, dead, selected)[0],
            bounds=(_SHORTEST * shortest, _LONGEST * shortest),
            method="bounded",
            options={"xatol": 1e-3 * shortest},
        )
        return float(search.x), self._solved(form, float(search.x), selected)[1]

    def left_out_lengths(self, form: PoolForm, dead: float) -> Floats:
        """Errors [N] at each point as all other lengths predict it, for the dead length of all; shape (points,)."""
        errors = np.full(len(self.force), np.nan)
        for block in np.unique(self.block):
            rest = self.block != block
            if len(np.unique(self.specimen[rest])) < len(self.parts):
                continue  # the specimen has one length
            _, strengths, tension = self._solved(form, dead, rest)
            errors[~rest] = (self.force - strengths[self.specimen] * tension)[~rest]
        return errors

    def _solved(self, form: PoolForm, dead: float, selected: np.ndarray) -> tuple[float, Floats, Floats]:
        """Sum of squares [N^2] at the selected points, strengths with a mean of 1, and the law's force [N]."""
        kind = ExponentialLaw if self.law in SMOOTH_LAWS else self.law
        strengths, present = np.ones(len(self.parts)), np.unique(self.specimen[selected])
        contraction, tension = self.contraction(dead), self.force
        for _ in range(_ROUNDS if form.strength else 1):
            problem = FitProblem.of(kind, self.dataset(dead, strengths, selected))
            solution = solve(problem, grid_search(problem))
            tension = forces(problem.law(solution.values), contraction, self.pressure)
            if form.strength:
                own = [selected & (self.specimen == number) for number in present]
                ratios = np.array([self.force[k] @ tension[k] / (tension[k] @ tension[k]) for k in own])
                strengths[present] = ratios / ratios.mean()
        rest = (self.force - strengths[self.specimen] * tension)[selected]
        return float(rest @ rest), strengths, tension


def _active(contraction: Floats, length: Floats | float, dead: float) -> Floats:
    """Contraction [-] of the active length, for that of the whole one [m]."""
    return contraction * (length / (length - dead))


def _groups(contraction: Floats) -> Ints:
    """Fixed lengths of a specimen: the measured ones, or groups of equally many points."""
    order = np.argsort(contraction, kind="stable")
    label = np.empty(len(order), np.int64)
    label[order] = np.cumsum(np.diff(contraction[order], prepend=contraction[order[:1]]) > _CLOSE)
    if label.max(initial=0) < _MOST_BLOCKS:
        return label
    label[order] = np.arange(len(order)) * _MOST_BLOCKS // len(order)
    return label
