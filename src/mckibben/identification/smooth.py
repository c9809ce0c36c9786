r"""Identification of `SmoothLaw`: scales by restricted maximum likelihood, and acceptance.

The deviations from Eq. 2 have a Gaussian prior about zero, :math:`s_j \sim N(0, (\gamma_j \sigma)^2 S^{-1})` with
:math:`c^T S c = \int s''^2 dv`, and a scale for each order in pressure, which is estimated
(`mckibben.identification.mixed_model`). A scale is kept if it raises the log-likelihood by 1 or more (Akaike). With the
scales fixed, the prior adds rows to the least-squares problem, in which the decay is refined.

Docs/laws.md gives the conditions on which deviations are accepted; else the result is Eq. 2.

References
----------
C. Rasmussen and C. Williams, "Gaussian Processes for Machine Learning", MIT Press 2006, sections 2.7 and 5.4.2.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cache

import numpy as np
from numpy.polynomial import legendre, polynomial

from mckibben.dataset import IsobaricDataset
from mckibben.identification.estimator import CONDITION_LIMIT, Bools, Floats, condition_number
from mckibben.identification.grouping import RESOLUTION
from mckibben.identification.least_squares import FitProblem, Solution, project, solve
from mckibben.identification.mixed_model import MixedModel
from mckibben.identification.regression import Refit, Regression, contraction_blocks, pressure_blocks
from mckibben.identification.summary import domain_of
from mckibben.muscle import Domain, ExponentialLaw, ForceLaw, SmoothLaw
from mckibben.muscle.slopes import unphysical
from mckibben.muscle.smooth import DEGREE

_MARGIN = 1.0  # window beyond the points, in half ranges of them
_GAIN = 1.0  # in the logarithm of the restricted likelihood, by hyperparameter
_WORSE = {"pressure": 1.0, "contraction": 1.05}  # largest error at left-out blocks, relative to Eq. 2
_BETTER = 0.95  # largest error over both kinds, relative to Eq. 2 or another law: a smaller gain may be chance


@dataclass(frozen=True, eq=False)
class Prior:
    """Prior of the deviations, a smoothing spline over contraction for each order in pressure.

    ``root @ coefficients``, divided by the scales, is standard normal.
    """

    root: Floats = field(repr=False)
    starts: tuple[Floats, ...]
    bounds: tuple[tuple[float, float], ...]  # at the lower ones a deviation is negligible compared to the noise

    @classmethod
    def of(cls, levels: Floats, *, orders: int = 3) -> Prior:
        """Prior for the orders from 0 in pressure, up to the highest of the levels [Pa]."""
        scale = np.diag(float(levels.max()) ** np.arange(orders))
        root = np.asarray(np.kron(scale, _roughness_root()), np.float64)
        return cls(root, tuple(np.full(orders, start) for start in (0.0, 5.0)), ((-4.0, 14.0),) * orders)

    def scales(self, hyperparameters: Floats) -> tuple[Floats, Floats]:
        """Logarithm of the scale of each row of the root, relative to the noise, and its derivative."""
        derivative = np.repeat(np.eye(len(hyperparameters)), DEGREE + 1, axis=0)
        return derivative @ hyperparameters, derivative

    def supported(self, model: MixedModel, best: Floats, cost: float) -> Floats | None:
        """Hyperparameters without those that the points do not support; None if they support none."""
        needed = np.zeros(len(best), bool)
        for order in reversed(range(len(best))):
            without = np.where(np.arange(len(best)) == order, self.bounds[order][0], best)
            higher = model.cost(without)[0]
            needed[order] = higher - cost >= _GAIN
            if not needed[order]:
                best, cost = without, higher
        return best if needed.any() else None

    def model(self, fixed: Floats, deviations: Floats, residuals: Floats) -> MixedModel:
        """Mixed model of Eq. 2 and the deviations."""
        independent = np.asarray(np.linalg.solve(self.root.T, deviations.T).T, np.float64)
        return MixedModel(fixed, independent, residuals, self.scales)


@cache
def _roughness_root() -> Floats:
    """Root C^T of the integral c^T C C^T c of s''^2 over the window, for the coefficients c of s."""
    window = polynomial.polypow([1.0, 0.0, -1.0], 3)
    places, weights = legendre.leggauss(20)
    curvature = [
        polynomial.polyval(places, polynomial.polyder(polynomial.polymul(window, power), 2))
        for power in np.eye(DEGREE + 1)
    ]
    return np.asarray(np.linalg.cholesky((np.array(curvature) * weights) @ np.array(curvature).T).T, np.float64)


def prior_rows(prior: Prior, scales: Floats) -> Floats:
    """Rows of a prior in a least-squares problem of all parameters, linear ones first."""
    of_eq2 = len(ExponentialLaw.linear_parameters), len(ExponentialLaw.shape_parameters)
    return np.pad(prior.root / scales[:, None], ((0, 0), of_eq2))


def prior_scales(prior: Prior, rows: Floats) -> Floats:
    """Scales of the rows: the inverse of `prior_rows`."""
    return np.diag(prior.root) / np.diag(rows[:, len(ExponentialLaw.linear_parameters) :])


@dataclass(frozen=True, eq=False)
class Deviations:
    """Columns of the deviations, around a fit of Eq. 2 to the selected points."""

    problem: FitProblem = field(repr=False)
    base: Solution = field(repr=False)
    prior: Prior = field(repr=False)
    domain: Domain

    @classmethod
    def of(cls, points: IsobaricDataset, base: Solution) -> Deviations:
        """Deviations in a window of twice the range of the selected points."""
        used = points.select(base.problem.selected[: len(points)])
        eps = used.contraction
        window = {"centre": float(eps.max() + eps.min()) / 2, "half_width": (1 + _MARGIN) * float(np.ptp(eps)) / 2}
        problem = replace(base.problem, law_type=SmoothLaw, constants=window)
        return cls(problem, base, Prior.of(used.levels), domain_of(used))

    @property
    def _inside(self) -> slice:
        """Columns of the deviations among those of the law."""
        return slice(len(ExponentialLaw.linear_parameters), self.problem.linear)

    def columns(self, base: Solution) -> tuple[Floats, Floats, Floats]:
        """Columns of Eq. 2 (its decay linearised) and of the deviations, and residuals, at all points of a fit."""
        inside = self._inside
        values = np.concatenate(
            [base.values[: inside.start], np.zeros(len(self.prior.root)), base.values[inside.start :]]
        )
        residuals, columns = replace(self.problem, selected=base.problem.selected).response(values)
        return np.delete(columns, np.s_[inside], axis=1), columns[:, inside], residuals

    def fit(self, hyperparameters: Floats | None = None) -> tuple[Solution, Floats] | None:
        """Solution and hyperparameters (from a guess, if there is one); None if the points do not support the law."""
        model = self.prior.model(*self.columns(self.base))
        starts = self.prior.starts if hyperparameters is None else (hyperparameters,)
        best, cost = model.estimate(starts, self.prior.bounds)
        if hyperparameters is None:
            supported = self.prior.supported(model, best, cost)
            if supported is None:
                return None
            best = supported
        rows = prior_rows(self.prior, np.exp(self.prior.scales(best)[0]))
        solution = solve(replace(self.problem, prior=rows), self.base.position)
        return solution, best

    def left_out(self, folds: Sequence[tuple[Bools, Solution]], hyperparameters: Floats) -> Floats:
        """Errors [N] at blocks left out of the selected points, each predicted by a fit to all others."""
        errors = np.full(len(self.base.residuals), np.nan)
        for out, base in folds:
            problem = replace(self.problem, selected=base.problem.selected)
            refit = replace(self, problem=problem, base=base).fit(hyperparameters)
            if refit is not None and refit[0].converged:
                errors[out] = replace(refit[0], problem=self.problem).residuals[out]
        return errors


def fit_smooth(
    points: IsobaricDataset, selected: Bools, start: Floats, *, compare: bool = True
) -> tuple[Solution, str]:
    """`SmoothLaw` for the selected points, or Eq. 2 and the reason; without comparison, however well it predicts."""
    base, used = solve(FitProblem.of(ExponentialLaw, points).subset(selected), start), points.select(selected)
    if not _may_deviate(base, used):
        return base, "Eq. 2 is exact, or the points are too few"
    deviations = Deviations.of(points, base)
    if (fitted := deviations.fit()) is None:
        return base, "the points support no deviation"
    solution, hyperparameters = fitted
    if objection := _objection(solution, base, used):
        return base, objection
    folds = _folds(base, points, used) if compare else {}
    ratios = {
        kind: _ratio(deviations.left_out(fits, hyperparameters), _left_out(base, fits)) for kind, fits in folds.items()
    }
    worse = [kind for kind, ratio in ratios.items() if ratio > _WORSE[kind]]
    score = float(np.exp(np.mean(np.log(list(ratios.values()))))) if ratios else 0.0  # geometric mean
    if worse or not score < _BETTER:
        return base, f"with deviations the errors at left-out {' and '.join(worse or folds)}s are hardly smaller"
    return solution, ""


def _may_deviate(base: Solution, used: IsobaricDataset, *, per_parameter: int = 4, rounding: float = 1e-9) -> bool:
    """Whether there are enough points off Eq. 2 to determine deviations: `per_parameter` of Eq. 2, at least.

    Residuals below a share `rounding` of the largest force are zero.
    """
    enough = len(used) >= per_parameter * len(base.problem.names) and bool(np.ptp(used.contraction))
    return enough and bool(np.abs(base.residuals).max() >= rounding * used.force.max())


def _objection(solution: Solution, base: Solution, used: IsobaricDataset) -> str:
    """Reason to prefer Eq. 2 without any refit; empty if there is none."""
    if not solution.converged:
        return "the fit with deviations did not converge"
    if not solution.aicc < base.aicc:
        return "Akaike's criterion is lower without deviations"
    domain = domain_of(used)
    wrong, before = (unphysical(fit.problem.law(fit.values), domain) for fit in (solution, base))
    return f"with deviations {wrong}" if wrong and not before else ""


def _folds(
    base: Solution, points: IsobaricDataset, used: IsobaricDataset, *, most: int = 5, contractions: int = 4
) -> dict[str, list[tuple[Bools, Solution]]]:
    """Blocks of pressure and of inner contraction among the selected points, each with Eq. 2 fitted to all others.

    There are `most` blocks of each kind at most. Eq. 2 needs four `contractions`: with as many, none is left out.
    """
    rows = np.flatnonzero(base.problem.selected)
    folds: dict[str, list[tuple[Bools, Solution]]] = {}
    levels, places = pressure_blocks(used)[0], contraction_blocks(used)
    for kind, labels in (("pressure", np.empty(0) if levels is None else levels), ("contraction", places)):
        blocks = [label for label in np.unique(labels).tolist() if label != ""]
        fewest = contractions + (kind == "contraction")
        for first in range(min(len(blocks), most)):
            out = np.isin(labels, blocks[first::most])
            rest = np.array(base.problem.selected)
            rest[rows[out]] = False
            if len(np.unique(np.round(used.contraction[~out] / RESOLUTION))) < fewest:
                continue
            refit = solve(replace(base.problem, selected=rest), base.position)
            if refit.converged and condition_number(refit.triangle[:, ~refit.at_bound]) < CONDITION_LIMIT:
                folds.setdefault(kind, []).append((out, refit))
    return folds


def _left_out(base: Solution, folds: Sequence[tuple[Bools, Solution]]) -> Floats:
    """Errors [N] of Eq. 2 at the blocks left out."""
    errors = np.full(len(base.residuals), np.nan)
    for out, refit in folds:
        errors[out] = replace(refit, problem=base.problem).residuals[out]
    return errors


def _ratio(ours: Floats, theirs: Floats) -> float:
    """Error relative to that of Eq. 2; 1 where neither can be compared."""
    both = np.isfinite(ours) & np.isfinite(theirs)
    return float(np.linalg.norm(ours[both]) / np.linalg.norm(theirs[both])) if both.any() else 1.0


def smooth_refit(points: IsobaricDataset, start: Floats) -> Refit:
    """Identification method of cross-validation: `SmoothLaw` where the points left support it."""
    return lambda selected: fit_smooth(points, selected, start, compare=False)[0]


def restored_regression(law: ForceLaw, points: IsobaricDataset, at_bound: Bools, scales: Floats | None) -> Regression:
    """Regression of a law that was fitted to points; `scales` are those of the prior of a law with deviations."""
    kind = type(law)
    constants = {p.name: float(getattr(law, p.name)) for p in kind.constants}
    problem, refit = replace(FitProblem.of(kind, points), constants=constants), None
    values = np.array([float(getattr(law, p.name)) for p in kind.parameters()])
    position = problem.cube.position(values[problem.linear :])
    if scales is not None:
        problem = replace(problem, prior=prior_rows(Prior.of(points.levels), scales))
        refit = smooth_refit(points, position)
    projection = project(problem, position, values[: problem.linear])
    solution = Solution(problem, values, position, projection.cost, projection.triangle, converged=True)
    return Regression(points, problem, solution, at_bound, refit)
