r"""Standard errors that hold where points have errors in common: the cluster-robust sandwich with its small-sample
correction.

With :math:`X = Q R` the Jacobian and :math:`e_g` the residuals of group :math:`g`, a quantity with the gradient
:math:`c` has the variance

.. math::

    V = \sum_g \left(z^T Q_g^T A_g e_g\right)^2, \qquad z = R^{-T} c, \qquad A_g = (I - Q_g Q_g^T)^{-1/2}

(CR2). Nothing is assumed of the errors within a group; for errors that are independent and equal after all, V is
unbiased. It is a sum over groups, and few of them make an uncertain variance: the t interval has the degrees of freedom
of Bell and McCaffrey, :math:`(\mathrm{tr}\,\Omega)^2 / \mathrm{tr}\,\Omega^2`, with :math:`\Omega` the covariance of
the summands before squaring if the errors were independent. They differ from quantity to quantity, and are fewer than
the groups: what few groups decide has few.

References
----------
R. Bell and D. McCaffrey, "Bias reduction in standard errors for linear regression with multi-stage samples", Survey
Methodology 28 (2002) 169-181; G. Imbens and M. Kolesar, Rev. Economics and Statistics 98 (2016) 701-712;
J. Pustejovsky and E. Tipton, J. Business and Economic Statistics 36 (2018) 672-683.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

_ALONE = 1e-8  # of the information in a direction: if the other groups have less, one group alone determines it

Pairs = tuple[NDArray[np.float64], NDArray[np.float64]]


class ErrorModel(Protocol):
    """What gives any quantity that depends on the parameters its variance."""

    def variance(self, gradients: NDArray[np.float64]) -> Pairs:
        """Variance and degrees of freedom, shape (m,) each, for gradients of shape (m, parameters)."""
        ...

    @property
    def scatter(self) -> tuple[float, float]:
        """Variance of a single plateau mean about the law [N^2], and its degrees of freedom."""
        ...


@dataclass(frozen=True, eq=False)
class Independent:
    """Errors of the points that are independent and equal: s^2 (X^T X)^-1, with n - k degrees of freedom.

    Parameters
    ----------
    triangle
        R of the Jacobian, shape (k, k).
    spread
        s [N].
    freedom
        n - k.
    """

    triangle: NDArray[np.float64]
    spread: float
    freedom: int

    @classmethod
    def of(cls, jacobian: NDArray[np.float64], residuals: NDArray[np.float64]) -> Independent:
        """From a Jacobian, shape (points, parameters), and residuals, shape (points,)."""
        freedom = len(residuals) - jacobian.shape[1]
        spread = float(np.sqrt(residuals @ residuals / freedom))
        return cls(np.asarray(np.linalg.qr(jacobian, mode="r")), spread, freedom)

    @property
    def scatter(self) -> tuple[float, float]:
        return self.spread**2, float(self.freedom)

    def variance(self, gradients: NDArray[np.float64]) -> Pairs:
        z = _solve(self.triangle, gradients)
        return self.spread**2 * np.einsum("mi,mi->m", z, z), np.full(len(z), float(self.freedom))


@dataclass(frozen=True, eq=False)
class ClusterRobust:
    """Errors that points of a group may share.

    Parameters
    ----------
    triangle
        R of the Jacobian, shape (k, k).
    scores
        Q_g^T A_g e_g, shape (groups, k).
    own, shared
        Q_g^T A_g^2 Q_g and Q_g^T A_g Q_g, shape (groups, k, k).
    alone
        The groups without which the parameters are not determined: for them there is no such estimate.
    scatter
        Variance of a single plateau mean about the law [N^2], from the corrected residuals A_g e_g, and its degrees of
        freedom, which are few where the points of a group mostly err alike.

    Examples
    --------
    The mean of four numbers, each a group: the textbook's s/2, with 3 degrees of freedom.

    >>> model = ClusterRobust.of(np.ones((4, 1)), np.array([1.0, -1.0, 2.0, -2.0]), np.arange(4))
    >>> variance, freedom = model.variance(np.ones((1, 1)))
    >>> round(float(np.sqrt(variance[0])), 4), round(float(freedom[0]), 4)
    (0.9129, 3.0)
    """

    triangle: NDArray[np.float64]
    scores: NDArray[np.float64]
    own: NDArray[np.float64]
    shared: NDArray[np.float64]
    alone: tuple[int, ...]
    scatter: tuple[float, float]

    @classmethod
    def of(
        cls, jacobian: NDArray[np.float64], residuals: NDArray[np.float64], labels: NDArray[np.int64]
    ) -> ClusterRobust:
        """From a Jacobian, shape (points, parameters), residuals, shape (points,), and groups, from 0 without gaps."""
        order = np.argsort(labels, kind="stable")
        starts = np.flatnonzero(np.diff(labels[order], prepend=-1))
        q, triangle = np.linalg.qr(jacobian[order])
        # All that is needed of A_g is in the eigenvectors of Q_g^T Q_g: those of A_g within the space of Q_g.
        information = np.add.reduceat(q[:, :, None] * q[:, None, :], starts)
        part, vectors = np.linalg.eigh(information)
        part = np.clip(part, 0.0, 1.0)
        alone = tuple(np.flatnonzero(part.max(axis=1, initial=0.0) > 1 - _ALONE).tolist())
        stretch = 1 / np.sqrt(np.maximum(1 - part, _ALONE))
        pulls = np.add.reduceat(q * residuals[order, None], starts)
        scores = np.einsum("gij,gj,gkj,gk->gi", vectors, stretch, vectors, pulls)
        own = np.einsum("gij,gj,gkj->gik", vectors, part * stretch**2, vectors)
        shared = np.einsum("gij,gj,gkj->gik", vectors, part * stretch, vectors)
        # A_g e_g itself: what of e_g is outside the space of Q_g stays, what is inside is stretched.
        inverse = np.where(part > _ALONE, (stretch - 1) / np.maximum(part, _ALONE), 0.0)
        added = np.einsum("gij,gj,gkj,gk->gi", vectors, inverse, vectors, pulls)
        sizes = np.diff(np.append(starts, len(labels)))
        corrected = residuals[order] + np.einsum("ni,ni->n", q, np.repeat(added, sizes, axis=0))
        return cls(triangle, scores, own, shared, alone, _scatter(corrected, starts, sizes, jacobian.shape[1]))

    def variance(self, gradients: NDArray[np.float64]) -> Pairs:
        z = _solve(self.triangle, gradients)
        variance = np.sum((z @ self.scores.T) ** 2, axis=1)
        # Omega_gh = delta_gh z'D_g z - w_g'w_h with w_g = E_g z; its trace and square sum without forming it.
        own = np.einsum("mi,gij,mj->mg", z, self.own, z, optimize=True)
        w = np.einsum("gij,mj->mgi", self.shared, z)
        squares = np.einsum("mgi,mgi->mg", w, w)
        total = np.einsum("mgi,mgj->mij", w, w)
        trace = np.sum(own - squares, axis=1)
        square_sum = np.sum((own - squares) ** 2 - squares**2, axis=1) + np.sum(total**2, axis=(1, 2))
        with np.errstate(invalid="ignore"):  # a gradient of zeros has variance 0, and no degrees of freedom
            return variance, np.where(trace > 0, trace**2 / square_sum, np.inf)


def _scatter(
    residuals: NDArray[np.float64], starts: NDArray[np.int64], sizes: NDArray[np.int64], parameters: int
) -> tuple[float, float]:
    r"""Mean square of the residuals, and the degrees of freedom that their correlation within groups leaves it.

    For n normal errors of equal size with the correlations R, :math:`e^T e` has the mean :math:`\sigma^2 n` and the
    variance :math:`2 \sigma^4\,\mathrm{tr}\,R^2`, so as many degrees of freedom as :math:`n^2 / \mathrm{tr}\,R^2`;
    with one correlation :math:`\rho` within groups of the sizes :math:`m_g` the trace is
    :math:`n + \rho^2 \sum_g m_g (m_g - 1)`. That is n where :math:`\rho` is 0, the number of groups where it is 1
    and they are of a size, and never more than n. The parameters take their share.
    """
    count = len(residuals)
    square = float(residuals @ residuals) / count
    pairs = int(np.sum(sizes * (sizes - 1)))
    if not square or not pairs:
        return square, float(count - parameters)
    agreement = float(np.sum(np.add.reduceat(residuals, starts) ** 2) - residuals @ residuals) / pairs / square
    agreement = min(max(agreement, 0.0), 1.0)
    return square, (count - parameters) / (1 + agreement**2 * pairs / count)


def _solve(triangle: NDArray[np.float64], gradients: NDArray[np.float64]) -> NDArray[np.float64]:
    """R^-T c for each gradient, shape (m, k)."""
    lengths = np.linalg.norm(triangle, axis=0)
    lengths[lengths == 0] = 1.0
    return np.linalg.solve((triangle / lengths).T, (gradients / lengths).T).T
