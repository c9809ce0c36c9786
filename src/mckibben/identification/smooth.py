r"""Identification of `SmoothLaw`: selection and scales of the deviations by restricted maximum likelihood.

The deviation :math:`s_j` has the prior :math:`N(0, (\gamma_j \sigma)^2 S^{-1})` with
:math:`c^T S c = \int s''^2 dv`: it is smooth, and of unknown size. At the decay of Eq. 2 the restricted likelihood of
the scales :math:`\gamma_j`, with :math:`\sigma` profiled and the parameters of Eq. 2 (its decay linearised) integrated
out, follows from one QR factorisation. A scale is kept if it raises the log-likelihood by 1 or more (Akaike). With the
scales fixed, the prior adds rows to the least-squares problem, in which the decay is refined.

The result is Eq. 2 itself unless the deviations lower both the corrected Akaike criterion (with effective parameters:
few points support few) and the errors at left-out pressures, raise the errors at left-out inner contractions by at most
a twentieth, both with the scales fixed, and are physical where Eq. 2 is.

References
----------
D. Harville, "Maximum likelihood approaches to variance component estimation and to related problems", J. American
Statistical Association 72 (1977) 320-338; C. Rasmussen and C. Williams, "Gaussian Processes for Machine Learning", MIT
Press 2006, sections 2.7 and 5.4.2.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
from numpy.polynomial import legendre, polynomial
from numpy.typing import NDArray

from mckibben.dataset import IsobaricDataset
from mckibben.identification.fit import domain_of, unphysical
from mckibben.identification.least_squares import FitProblem, Solution, solve
from mckibben.identification.regression import contraction_blocks, pressure_blocks
from mckibben.identification.uncertainty import Bools, Floats, tsqr_r
from mckibben.muscle import ExponentialLaw, ForceLaw, SmoothAffineLaw, SmoothLaw
from mckibben.muscle.smooth import DEGREE

SMOOTH_LAWS = (SmoothLaw, SmoothAffineLaw)
"""Laws of this method; each falls back to the following ones, and to Eq. 2."""
_MARGIN = 1.0  # window beyond the contractions measured, in half ranges of them
_STARTS = (0.0, 5.0)  # logarithm of the scales
_BOUNDS = (-4.0, 14.0)  # at the lower one a deviation is negligible compared to the noise
_GAIN = 1.0  # in the logarithm of the restricted likelihood, by scale
_WORSE = {"pressure": 1.0, "contraction": 1.05}  # largest error at left-out blocks, relative to Eq. 2
_LEAST = 4  # points per parameter of Eq. 2
_ROUNDING = 1e-9  # of the largest force


def fit_smooth(law_type: type[ForceLaw], points: IsobaricDataset, kept: Bools, start: Floats) -> tuple[Solution, str]:
    """Fit the law to the kept points, or a simpler law that they support better; also return the reason.

    The search for Eq. 2 begins at a given start, as in its own refits, so that both agree if it is the result.
    """
    eq2 = FitProblem.of(ExponentialLaw, points).subset(kept)
    base, used = solve(eq2, start), points.select(kept)
    residuals, reach = base.residuals, float(np.ptp(used.contraction))
    if len(used) < _LEAST * len(eq2.names) or not reach or np.abs(residuals).max() < _ROUNDING * used.force.max():
        return base, "Eq. 2 is exact, or the points are too few"
    middle = float(used.contraction.max() + used.contraction.min()) / 2
    window = {"centre": middle, "half_width": (1 + _MARGIN) * reach / 2}
    reason = ""
    for kind in SMOOTH_LAWS[SMOOTH_LAWS.index(law_type) :]:
        problem = replace(eq2, law_type=kind, constants=window)
        problem = replace(problem, prior=_prior(problem, base, used))
        if problem.prior is None:
            reason = "the points support no deviation"
            continue
        found = solve(problem, base.position)
        reason = _objection(found, base, used)
        if not reason:
            return found, ""
    return base, reason


def _prior(problem: FitProblem, base: Solution, used: IsobaricDataset) -> Floats | None:
    """Rows of the prior; None if the points do not support the deviation of the highest order, or of any."""
    of_eq2, shape, width = len(base.problem.names) - 1, len(base.position), DEGREE + 1
    orders = (problem.linear - of_eq2) // width
    values = np.concatenate([base.values[:of_eq2], np.zeros(orders * width), base.values[of_eq2:]])
    columns = problem.response(values)[1]
    root = np.kron(np.diag(float(used.levels.max()) ** np.arange(orders)), _roughness_root())
    deviations = np.linalg.solve(root.T, columns[:, of_eq2 : problem.linear].T).T
    scales = _scales(np.delete(columns, np.s_[of_eq2 : problem.linear], axis=1), deviations, base.residuals, orders)
    if scales is None:
        return None
    rows = root / np.repeat(scales, width)[:, None]
    return np.pad(rows, ((0, 0), (of_eq2, shape)))


@cache
def _roughness_root() -> NDArray[Any]:
    """Root C^T of the integral c^T C C^T c of s''^2 over the window, for the coefficients c of s."""
    window = polynomial.polypow([1.0, 0.0, -1.0], 3)
    places, weights = legendre.leggauss(20)
    curvature = [
        polynomial.polyval(places, polynomial.polyder(polynomial.polymul(window, power), 2))
        for power in np.eye(DEGREE + 1)
    ]
    return np.linalg.cholesky((np.array(curvature) * weights) @ np.array(curvature).T).T


def _scales(fixed: Floats, deviations: NDArray[Any], residuals: Floats, orders: int) -> Floats | None:
    """Scales of the deviations relative to the noise; None if the highest order is, or all are, unsupported."""
    from scipy.optimize import minimize

    count, free = deviations.shape[1], len(residuals) - fixed.shape[1]
    projected = tsqr_r(np.column_stack([fixed, deviations, residuals]))[fixed.shape[1] :, fixed.shape[1] :]

    def objective(logarithms: Floats) -> tuple[float, Floats]:
        scaled = projected * np.append(np.repeat(np.exp(logarithms), count // orders), 1.0)
        factor = tsqr_r(np.concatenate([scaled, np.eye(count, count + 1)]))
        sizes = np.abs(np.diag(factor))
        inverse = np.linalg.inv(factor[:-1, :-1])
        fitted = inverse @ factor[:-1, -1]
        part = np.sum(inverse**2, axis=1) + free * (fitted / sizes[-1]) ** 2
        slope = np.sum((1 - part).reshape(orders, -1), axis=1)
        return float(np.sum(np.log(sizes[:-1])) + free * np.log(sizes[-1])), slope

    starts = [np.full(orders, start) for start in _STARTS]
    options: dict[str, Any] = {"jac": True, "bounds": [_BOUNDS] * orders, "method": "TNC"}  # no BLAS, no threads
    found = min((minimize(objective, start, **options) for start in starts), key=lambda one: one.fun)
    logarithms, cost = found.x, float(found.fun)
    supported = np.zeros(orders, bool)
    for order in reversed(range(orders)):
        without = np.where(np.arange(orders) == order, _BOUNDS[0], logarithms)
        higher = objective(without)[0]
        supported[order] = higher - cost >= _GAIN
        if not supported[order]:
            logarithms, cost = without, higher
    return np.exp(logarithms) if supported[2:].all() and supported.any() else None


def _objection(found: Solution, base: Solution, used: IsobaricDataset) -> str:
    """Reason to prefer Eq. 2; empty if there is none."""
    if not found.converged:
        return "the fit with deviations did not converge"
    if not found.aicc < base.aicc:
        return "Akaike's criterion is lower without deviations"
    blocks = {"pressure": pressure_blocks(used)[0], "contraction": contraction_blocks(used)}
    for kind, labels in blocks.items():
        if labels is None:
            continue
        ours, theirs = (_left_out(one, labels) for one in (found, base))
        both = np.isfinite(ours) & np.isfinite(theirs)
        if np.linalg.norm(ours[both]) > _WORSE[kind] * np.linalg.norm(theirs[both]):
            return f"with deviations the errors at left-out {kind}s are larger"
    domain = domain_of(used)
    wrong, before = (unphysical(one.problem.law(one.values), domain) for one in (found, base))
    return f"with deviations {wrong}" if wrong and not before else ""


def _left_out(solution: Solution, labels: NDArray[Any]) -> Floats:
    """Linearised leave-one-block-out residuals; NaN where the other blocks do not determine the fit."""
    residuals, jacobian = solution.augmented
    q = np.linalg.qr(jacobian)[0]
    found = np.full(len(labels), np.nan)
    for label in np.unique(labels):
        own = np.flatnonzero(labels == label)
        rest = np.eye(q.shape[1]) - q[own].T @ q[own]
        if label != "" and np.linalg.eigvalsh(rest)[0] > _ROUNDING:
            found[own] = residuals[own] + q[own] @ np.linalg.solve(rest, q[own].T @ residuals[own])
    return found
