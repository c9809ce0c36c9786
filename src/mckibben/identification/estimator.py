r"""Estimator shared by all fits: bounded least squares, standard errors, and intervals.

Numbers alone, no datasets: residuals r of shape (n,), and their Jacobian J of shape (n, k), in any consistent units.

1. `least_squares` returns a `Minimum`: values, residuals, Jacobian, and the parameters at a bound.
2. `standard_errors` gives the classical errors and correlations; `IndependentErrors.of` and `ClusterRobustErrors.of`
   are error models, whose ``variance(gradients)`` is that of any quantity with those gradients, and its degrees of
   freedom. `robust_errors` chooses the cluster-robust one unless one group alone determines a parameter.
3. `t_quantile` and `t_interval` turn variances into intervals.
4. `condition_number` and `unidentifiable` name the parameters that the data do not determine.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mckibben.errors import IdentificationError, RangeError

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]
Answer = TypeVar("Answer")

# Block size, small enough that OpenBLAS starts no threads: competing with XLA's, they take 100 times as long.
_BLOCK = 6144


def tsqr_r(matrix: Floats) -> Floats:
    """R factor (k, k) of a matrix (n, k) by blocks of rows (Demmel et al., SIAM J. Sci. Comput. 34, 2012, A206)."""
    count, width = matrix.shape
    most = max(_BLOCK // max(width, 1), 2 * width)
    if count <= most:
        return np.asarray(np.linalg.qr(matrix, mode="r"))
    blocks = -(-count // most)
    rows = -(-count // blocks)
    if blocks * rows > count:
        matrix = np.concatenate([matrix, np.zeros((blocks * rows - count, width))])
    factors = np.asarray(np.linalg.qr(matrix.reshape(blocks, rows, width), mode="r"))
    return tsqr_r(factors.reshape(blocks * width, width))


def _tsqr(matrix: Floats) -> tuple[Floats, Floats]:
    """Q, shape (n, k), and R; orthogonalised twice, so Q is orthogonal to rounding."""
    q, r = matrix, np.eye(matrix.shape[1])
    for _ in range(2):
        factor = tsqr_r(q)
        lengths = np.linalg.norm(factor, axis=0)
        q = np.einsum("ni,ij->nj", q / lengths, np.linalg.inv(factor / lengths))  # no BLAS, no threads
        r = factor @ r
    return q, r


def remembered(function: Callable[[Floats], Answer]) -> Callable[[Floats], Answer]:
    """A function that remembers its last answer, as solvers ask for values and derivatives one after the other."""
    last: dict[bytes, Answer] = {}

    def at(position: Floats) -> Answer:
        if position.tobytes() not in last:
            last.clear()
            last[position.tobytes()] = function(position)
        return last[position.tobytes()]

    return at


@dataclass(frozen=True, eq=False)
class Minimum:
    """Minimum of a sum of squares, by `least_squares`.

    Attributes
    ----------
    values, at_bound
        Shape (k,): parameters, and whether each is at a bound.
    residuals, jacobian
        Shape (n,) and (n, k), at the values.
    converged
        False if the number of evaluations was exhausted.
    """

    values: Floats
    at_bound: Bools
    residuals: Floats = field(repr=False)
    jacobian: Floats = field(repr=False)
    converged: bool

    @property
    def cost(self) -> float:
        """Sum of squared residuals."""
        return float(self.residuals @ self.residuals)


def least_squares(
    residuals: Callable[[Floats], Floats],
    start: Floats,
    jacobian: Callable[[Floats], Floats],
    bounds: tuple[Floats, Floats],
    *,
    tolerance: float = 1e-12,
    evaluations: int = 300,
) -> Minimum:
    """Minimise a sum of squares between bounds by a trust region (`scipy.optimize.least_squares`).

    Parameters
    ----------
    residuals, jacobian
        Functions of the parameters, shape (k,): residuals (n,) and their derivatives (n, k).
    bounds
        Lower and upper bounds, shape (k,) each; infinite where there is none.
    tolerance
        Relative, of values, cost and gradient.

    Raises
    ------
    IdentificationError
        If residuals are not finite at the start.
    """
    from scipy.optimize import least_squares as search

    if not np.isfinite(residuals(start)).all():
        raise IdentificationError("the law has no force at some of the points", remedy="use another law")
    limits = {"ftol": tolerance, "xtol": tolerance, "gtol": tolerance, "max_nfev": evaluations}
    answer = search(residuals, start, jacobian, bounds=bounds, x_scale="jac", **limits)  # type: ignore[call-overload]
    return Minimum(answer.x, answer.active_mask != 0, answer.fun, answer.jac, answer.status > 0)


CONDITION_LIMIT = 1e10
"""Limit of the condition number of a Jacobian with columns of unit length: six of sixteen digits are left."""


def standard_errors(jacobian: Floats, residuals: Floats, at_bound: Bools) -> tuple[Floats, Floats]:
    """Classical standard errors and correlations of a least-squares fit, NaN at a bound.

    Parameters
    ----------
    jacobian, residuals
        Shape (points, parameters) and (points,).
    at_bound
        Mask of the parameters that are not free, shape (parameters,).

    Returns
    -------
    Errors, shape (parameters,), and correlations, (parameters, parameters).

    Examples
    --------
    A straight line through 1, 2, 2, 4: the intercept and the slope of textbooks.

    >>> x, y = np.arange(4.0), np.array([1.0, 2.0, 2.0, 4.0])
    >>> design = np.column_stack([np.ones(4), x])
    >>> residuals = y - design @ np.linalg.lstsq(design, y, rcond=None)[0]
    >>> errors, correlations = standard_errors(design, residuals, np.zeros(2, bool))
    >>> errors.round(3), correlations[0, 1].round(3)
    (array([0.495, 0.265]), np.float64(-0.802))
    """
    count = jacobian.shape[1]
    free = np.flatnonzero(~at_bound)
    lengths, singular, directions = _decompose(jacobian[:, free])
    inverse = directions.T / singular
    scaled = inverse @ inverse.T
    widths = np.sqrt(np.diag(scaled))
    errors = np.full(count, np.nan)
    errors[free] = np.sqrt(residuals @ residuals / (len(residuals) - len(free))) * widths / lengths
    correlations = np.full((count, count), np.nan)
    correlations[np.ix_(free, free)] = np.clip(scaled / np.outer(widths, widths), -1.0, 1.0)
    correlations[free, free] = 1.0
    return errors, correlations


def condition_number(jacobian: Floats) -> float:
    """Condition number of a Jacobian with columns scaled to unit length; infinite where singular.

    Examples
    --------
    Units do not matter:

    >>> condition_number(np.diag([1.0, 1e5]))
    1.0
    """
    _, singular, _ = _decompose(jacobian)
    if not len(singular):
        return 1.0
    return float(singular[0] / singular[-1]) if singular[-1] > 0 else np.inf


def unidentifiable(jacobian: Floats, names: Sequence[str]) -> list[str]:
    """Parameters with a component in the null space or, if it is empty, in the least identifiable direction."""
    _, singular, directions = _decompose(jacobian)
    null = singular <= max(_SINGULAR * singular[0], singular[-1])
    share = np.linalg.norm(directions[null], axis=0)
    return [name for name, part in zip(names, share, strict=True) if part > 0.05 * share.max()]


def _decompose(jacobian: Floats) -> tuple[Floats, ...]:
    """Column lengths, and singular values and right singular vectors (rows) of the unit-length columns."""
    factor = tsqr_r(jacobian)
    lengths = np.linalg.norm(factor, axis=0)
    lengths[lengths == 0] = 1.0
    _, singular, directions = np.linalg.svd(factor / lengths)
    return lengths, np.pad(singular, (0, len(lengths) - len(singular))), directions  # 0 with fewer rows than columns


_SINGULAR = 1e-10  # singular values of the null space, relative to the largest
_DECISIVE = 1e-8  # share of the information in a direction: if all other groups have less, one group determines it

Pairs = tuple[Floats, Floats]


@dataclass(frozen=True, eq=False)
class IndependentErrors:
    """Independent errors of equal variance: covariance s^2 (X^T X)^-1 with n - k degrees of freedom.

    Attributes
    ----------
    triangle
        R factor of the Jacobian, shape (parameters, parameters).
    residual_variance
        Variance s^2 of a single plateau mean about the law [N^2], and its degrees of freedom.
    """

    triangle: Floats
    residual_variance: tuple[float, float]

    @classmethod
    def of(cls, jacobian: Floats, residuals: Floats) -> IndependentErrors:
        """Error model from a Jacobian, shape (points, parameters), and residuals, shape (points,)."""
        freedom = len(residuals) - jacobian.shape[1]
        return cls(tsqr_r(jacobian), (float(residuals @ residuals / freedom), float(freedom)))

    def variance(self, gradients: Floats) -> Pairs:
        """Variance and degrees of freedom, shape (m,) each, for gradients of shape (m, parameters)."""
        z = _solve(self.triangle, gradients)
        square, freedom = self.residual_variance
        return square * np.einsum("mi,mi->m", z, z), np.full(len(z), freedom)


@dataclass(frozen=True, eq=False)
class ClusterRobustErrors:
    """Cluster-robust covariance CR2 with Satterthwaite degrees of freedom: points of a group share an error.

    R. Bell and D. McCaffrey, Survey Methodology 28 (2002) 169-181; J. Pustejovsky and E. Tipton, J. Business and
    Economic Statistics 36 (2018) 672-683. With J = Q R and the adjustment A_g = (I - Q_g Q_g^T)^-1/2 of the residuals
    e_g of group g:

    Attributes
    ----------
    triangle
        R, shape (parameters, parameters).
    scores
        Q_g^T A_g e_g, shape (groups, parameters).
    own, shared
        Q_g^T A_g^2 Q_g and Q_g^T A_g Q_g, shape (groups, parameters, parameters).
    decisive
        Groups without which the parameters are not determined.
    residual_variance
        Mean square of A_g e_g [N^2], and its degrees of freedom.
    """

    triangle: Floats
    scores: Floats
    own: Floats
    shared: Floats
    decisive: tuple[int, ...]
    residual_variance: tuple[float, float]

    @classmethod
    def of(cls, jacobian: Floats, residuals: Floats, labels: Ints) -> ClusterRobustErrors:
        """Error model from a Jacobian, shape (points, parameters), residuals and group numbers, shape (points,).

        Rows beyond the points belong to a prior, each independent of all others.
        """
        prior = len(jacobian) - len(labels)
        groups = int(labels.max()) + 1
        labels = np.append(labels, groups + np.arange(prior))
        order = np.argsort(labels, kind="stable")
        starts = np.flatnonzero(np.diff(labels[order], prepend=-1))
        q, triangle = _tsqr(jacobian[order])
        # A_g = (I - Q_g Q_g^T)^-1/2 shares its eigenvectors in the space of Q_g with Q_g^T Q_g.
        information = np.add.reduceat(q[:, :, None] * q[:, None, :], starts)
        part, vectors = np.linalg.eigh(information)
        part = np.clip(part, 0.0, 1.0)
        decisive = tuple(np.flatnonzero(part.max(axis=1, initial=0.0)[:groups] > 1 - _DECISIVE).tolist())
        stretch = 1 / np.sqrt(np.maximum(1 - part, _DECISIVE))
        projected = np.add.reduceat(q * residuals[order, None], starts)
        scores = np.einsum("gij,gj,gkj,gk->gi", vectors, stretch, vectors, projected)
        own = np.einsum("gij,gj,gkj->gik", vectors, part * stretch**2, vectors)
        shared = np.einsum("gij,gj,gkj->gik", vectors, part * stretch, vectors)
        # A_g e_g: the part of e_g outside the space of Q_g stays, the part inside is stretched.
        inverse = np.where(part > _DECISIVE, (stretch - 1) / np.maximum(part, _DECISIVE), 0.0)
        added = np.einsum("gij,gj,gkj,gk->gi", vectors, inverse, vectors, projected)
        sizes = np.diff(np.append(starts, len(labels)))
        corrected = residuals[order] + np.einsum("ni,ni->n", q, np.repeat(added, sizes, axis=0))
        variance = _residual_variance(corrected, starts, sizes, jacobian.shape[1])
        return cls(triangle, scores, own, shared, decisive, variance)

    def variance(self, gradients: Floats) -> Pairs:
        """As in `IndependentErrors`."""
        z = _solve(self.triangle, gradients)
        variance = np.sum((z @ self.scores.T) ** 2, axis=1)
        # Omega_gh = delta_gh z'D_g z - w_g'w_h with w_g = E_g z; its trace and square sum without forming it.
        own = np.einsum("mgj,mj->mg", np.einsum("mi,gij->mgj", z, self.own), z)
        w = np.einsum("gij,mj->mgi", self.shared, z)
        squares = np.einsum("mgi,mgi->mg", w, w)
        total = np.einsum("mgi,mgj->mij", w, w)
        diagonal = np.maximum(own - squares, 0.0)
        between = np.sum(total**2, axis=(1, 2)) - np.sum(squares**2, axis=1)
        trace, square_sum = np.sum(diagonal, axis=1), np.sum(diagonal**2, axis=1) + np.maximum(between, 0.0)
        with np.errstate(invalid="ignore", divide="ignore"):  # a zero gradient: no variance
            return variance, np.where(trace > 0, np.maximum(trace**2 / square_sum, 1.0), np.inf)


ErrorModel = IndependentErrors | ClusterRobustErrors
"""Covariance of the estimates."""


def robust_errors(jacobian: Floats, residuals: Floats, labels: Ints) -> ErrorModel:
    """Error model for errors common to a group, unless one group alone determines a parameter: independent ones."""
    model = ClusterRobustErrors.of(jacobian, residuals, labels)
    return IndependentErrors.of(jacobian, residuals) if model.decisive else model


def _residual_variance(residuals: Floats, starts: Ints, sizes: Ints, parameters: int) -> tuple[float, float]:
    """Mean square e^T e / n of the residuals, and n^2 / tr R^2 degrees of freedom less the parameters."""
    count = len(residuals)
    square = float(residuals @ residuals) / count
    pairs = int(np.sum(sizes * (sizes - 1)))
    if not square or not pairs:
        return square, float(count - parameters)
    correlation = float(np.sum(np.add.reduceat(residuals, starts) ** 2) - residuals @ residuals) / pairs / square
    correlation = min(max(correlation, 0.0), 1.0)
    return square, (count - parameters) / (1 + correlation**2 * pairs / count)


def _solve(triangle: Floats, gradients: Floats) -> Floats:
    """R^-T c for each gradient, shape (m, k)."""
    lengths = np.linalg.norm(triangle, axis=0)
    lengths[lengths == 0] = 1.0
    return np.linalg.solve((triangle / lengths).T, (gradients / lengths).T).T


class Interval(NamedTuple):
    """Interval in SI units; NaN if unknown."""

    lower: float
    upper: float


@dataclass(frozen=True, eq=False)
class IntervalEstimate:
    """Estimate of a quantity with its pointwise interval; all arrays have the shape of `value`."""

    level: float
    value: Floats
    standard_error: Floats
    degrees_of_freedom: Floats
    lower: Floats
    upper: Floats

    def contains(self, measured: ArrayLike) -> Bools:
        """Whether measured values are inside, of the shape of `value`."""
        values = np.asarray(measured, float)
        return (self.lower <= values) & (values <= self.upper)

    def score(self, measured: ArrayLike) -> Floats:
        """Interval score at measured values: the width, and 2 / (1 - level) of the distance of those outside.

        The mean score is least for the interval with the true quantiles at its ends: it rewards narrow intervals and
        coverage at once (T. Gneiting and A. Raftery, J. American Statistical Association 102, 2007, 359-378, Eq. 43).

        >>> estimate = t_interval(0.95, [10.0, 10.0], [(np.ones(2), np.full(2, np.inf))])
        >>> estimate.contains([11.0, 13.0]), estimate.score([11.0, 13.0]).round(2)
        (array([ True, False]), array([ 3.92, 45.52]))
        """
        values = np.asarray(measured, float)
        outside = np.maximum(self.lower - values, 0) + np.maximum(values - self.upper, 0)
        return self.upper - self.lower + 2 / (1 - self.level) * outside


def check_level(level: float) -> float:
    """Return the confidence level, or raise a `RangeError` if it is not between 0 and 1."""
    if not 0 < level < 1:
        remedy = "write 0.95 for 95 %" if level >= 1 else ""
        raise RangeError(f"a level of {level:g} is not a probability", value=level, lower=0.0, upper=1.0, remedy=remedy)
    return level


def t_quantile(level: float, freedom: ArrayLike) -> Floats:
    """Half-width of a two-sided t interval in standard errors; raises as `check_level`.

    Examples
    --------
    >>> t_quantile(0.95, [3, np.inf]).round(2)
    array([3.18, 1.96])
    """
    from scipy.special import stdtrit

    return np.asarray(stdtrit(np.minimum(freedom, 1e12), (1 + check_level(level)) / 2))


def t_interval(level: float, value: ArrayLike, variances: Sequence[tuple[Floats, Floats]]) -> IntervalEstimate:
    """T interval of a sum of independent variances V, with Satterthwaite's (sum V)^2 / sum(V^2/nu)."""
    value = np.asarray(value, np.float64)
    total = np.sum([variance for variance, _ in variances], axis=0).reshape(value.shape)
    parts = np.sum([variance**2 / freedom for variance, freedom in variances], axis=0).reshape(value.shape)
    with np.errstate(divide="ignore", invalid="ignore"):
        freedom = np.where(parts > 0, total**2 / parts, np.inf)
    error = np.sqrt(total)
    half_width = t_quantile(level, freedom) * error
    return IntervalEstimate(level, value, error, freedom, value - half_width, value + half_width)


def variance_of(model: ErrorModel, gradients: Floats) -> tuple[Floats, Floats]:
    """Variance and degrees of freedom, shape (...), for gradients of shape (..., parameters)."""
    variance, freedom = model.variance(gradients.reshape(-1, gradients.shape[-1]))
    return variance.reshape(gradients.shape[:-1]), freedom.reshape(gradients.shape[:-1])
