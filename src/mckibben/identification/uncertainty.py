"""Standard errors and correlations of estimates, also for points that share errors."""

from __future__ import annotations

import enum
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from mckibben.dataset import IsobaricDataset
from mckibben.errors import IdentificationError

# Numbers in a block: so few that OpenBLAS does not wake threads, which beside XLA cost 100 times the work.
_BLOCK = 6144


def tsqr_r(matrix: NDArray[np.float64]) -> NDArray[np.float64]:
    """R of the QR factors, shape (k, k), of a matrix of shape (n, k), n >= k; fastest where columns are contiguous.

    As stable as the ordinary factorisation: blocks of rows are factored each, then their stacked triangles. Q is never
    needed: R of the columns [A, y] tells the least squares of A x = y, their residual, and the condition of A.

    References
    ----------
    J. Demmel et al., "Communication-optimal parallel and sequential QR and LU factorizations", SIAM J. Sci.
    Comput. 34 (2012) A206-A239.

    Examples
    --------
    >>> matrix = np.vander(np.linspace(0, 1, 5000), 6)
    >>> r = tsqr_r(matrix)
    >>> bool(np.allclose(r.T @ r, matrix.T @ matrix)), bool(np.all(np.tril(r, -1) == 0))
    (True, True)
    """
    count, width = matrix.shape
    most = max(_BLOCK // max(width, 1), 2 * width)
    if count <= most:
        return np.asarray(np.linalg.qr(matrix, mode="r"))
    blocks = -(-count // most)
    rows = -(-count // blocks)
    if blocks * rows > count:
        matrix = np.concatenate([matrix, np.zeros((blocks * rows - count, width))])
    triangles = np.asarray(np.linalg.qr(matrix.reshape(blocks, rows, width), mode="r"))
    return tsqr_r(triangles.reshape(blocks * width, width))


CONDITION_LIMIT = 1e10
"""Of the Jacobian with columns of length one: above it, about six digits of the sixteen are left."""


@dataclass(frozen=True, eq=False)
class Uncertainty:
    """What the data say about how well they determine the parameters.

    Attributes
    ----------
    standard_errors
        Shape (parameters,), in the unit of each; NaN where the parameter was held at a bound.
    correlations
        Shape (parameters, parameters); NaN in the rows and columns of these.
    spread
        s [N], the standard deviation of a plateau mean about the law.
    """

    standard_errors: NDArray[np.float64]
    correlations: NDArray[np.float64]
    spread: float


def uncertainty(
    jacobian: NDArray[np.float64], residuals: NDArray[np.float64], at_bound: NDArray[np.bool_]
) -> Uncertainty:
    """Standard errors and correlations of the parameters that are not held.

    Parameters
    ----------
    jacobian
        Shape (points, parameters): derivative of the force [N] with respect to the parameters.
    residuals
        Shape (points,) [N]; more points than free parameters.
    held
        Shape (parameters,): those at a bound, whose value the data did not choose.

    Examples
    --------
    The mean of four numbers: s is their standard deviation, and the standard error is s/2.

    >>> u = uncertainty(np.ones((4, 1)), np.array([1.0, -1.0, 2.0, -2.0]), np.array([False]))
    >>> round(u.spread, 4), u.standard_errors.round(4)
    (1.8257, array([0.9129]))
    """
    count = jacobian.shape[1]
    free = np.flatnonzero(~at_bound)
    lengths, singular, directions = _decompose(jacobian[:, free])
    inverse = directions.T / singular
    scaled = inverse @ inverse.T
    spread = float(np.sqrt(residuals @ residuals / (len(residuals) - len(free))))
    widths = np.sqrt(np.diag(scaled))
    errors = np.full(count, np.nan)
    errors[free] = spread * widths / lengths
    correlations = np.full((count, count), np.nan)
    correlations[np.ix_(free, free)] = np.clip(scaled / np.outer(widths, widths), -1.0, 1.0)
    correlations[free, free] = 1.0
    return Uncertainty(errors, correlations, spread)


def condition_number(jacobian: NDArray[np.float64]) -> float:
    """The condition number of a Jacobian with columns scaled to length one; infinite where singular."""
    _, singular, _ = _decompose(jacobian)
    if not len(singular):
        return 1.0
    return float(singular[0] / singular[-1]) if singular[-1] > 0 else np.inf


def unidentifiable(jacobian: NDArray[np.float64], names: Sequence[str]) -> list[str]:
    """The parameters that can change together and leave all forces nearly as they are."""
    _, _, directions = _decompose(jacobian)
    share = np.abs(directions[-1])
    return [name for name, part in zip(names, share, strict=True) if part > 0.05 * share.max()]


def _decompose(jacobian: NDArray[np.float64]) -> tuple[NDArray[np.float64], ...]:
    """Lengths of the columns; singular values and right singular vectors, as rows, of them at length one."""
    factor = tsqr_r(jacobian)
    lengths = np.linalg.norm(factor, axis=0)
    lengths[lengths == 0] = 1.0
    _, singular, directions = np.linalg.svd(factor / lengths)
    return lengths, singular, directions


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
class IndependentErrors:
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

    tsqr_r: NDArray[np.float64]
    spread: float
    freedom: int

    @classmethod
    def of(cls, jacobian: NDArray[np.float64], residuals: NDArray[np.float64]) -> IndependentErrors:
        """From a Jacobian, shape (points, parameters), and residuals, shape (points,)."""
        freedom = len(residuals) - jacobian.shape[1]
        spread = float(np.sqrt(residuals @ residuals / freedom))
        return cls(np.asarray(np.linalg.qr(jacobian, mode="r")), spread, freedom)

    @property
    def scatter(self) -> tuple[float, float]:
        return self.spread**2, float(self.freedom)

    def variance(self, gradients: NDArray[np.float64]) -> Pairs:
        z = _solve(self.tsqr_r, gradients)
        return self.spread**2 * np.einsum("mi,mi->m", z, z), np.full(len(z), float(self.freedom))


@dataclass(frozen=True, eq=False)
class ClusterRobustErrors:
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

    >>> model = ClusterRobustErrors.of(np.ones((4, 1)), np.array([1.0, -1.0, 2.0, -2.0]), np.arange(4))
    >>> variance, freedom = model.variance(np.ones((1, 1)))
    >>> round(float(np.sqrt(variance[0])), 4), round(float(freedom[0]), 4)
    (0.9129, 3.0)
    """

    tsqr_r: NDArray[np.float64]
    scores: NDArray[np.float64]
    own: NDArray[np.float64]
    shared: NDArray[np.float64]
    alone: tuple[int, ...]
    scatter: tuple[float, float]

    @classmethod
    def of(
        cls, jacobian: NDArray[np.float64], residuals: NDArray[np.float64], labels: NDArray[np.int64]
    ) -> ClusterRobustErrors:
        """From a Jacobian, shape (points, parameters), residuals, shape (points,), and groups, from 0 without gaps."""
        order = np.argsort(labels, kind="stable")
        starts = np.flatnonzero(np.diff(labels[order], prepend=-1))
        q, tsqr_r = np.linalg.qr(jacobian[order])
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
        return cls(tsqr_r, scores, own, shared, alone, _scatter(corrected, starts, sizes, jacobian.shape[1]))

    def variance(self, gradients: NDArray[np.float64]) -> Pairs:
        z = _solve(self.tsqr_r, gradients)
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


def _solve(tsqr_r: NDArray[np.float64], gradients: NDArray[np.float64]) -> NDArray[np.float64]:
    """R^-T c for each gradient, shape (m, k)."""
    lengths = np.linalg.norm(tsqr_r, axis=0)
    lengths[lengths == 0] = 1.0
    return np.linalg.solve((tsqr_r / lengths).T, (gradients / lengths).T).T


class Grouping(enum.Enum):
    """Points within a group may share an error; groups are independent of each other.

    Attributes
    ----------
    POINT
        Every plateau mean is its own group: the errors are independent, as the classical formula has it.
    STROKE
        The points of one pass at one pressure: same level, repeat and `approach_labels`, as far as recorded.
        What the zero of a force sensor, creep, or friction adds to a whole pass is then one error and not many.
    PRESSURE
        All points of a pressure level: as well what the passes at a level have in common, such as how the law misses
        the muscle there.
    REPEAT
        All points of one repeat of the whole test.
    """

    POINT = "point"
    STROKE = "stroke"
    PRESSURE = "pressure"
    REPEAT = "repeat"

    def counted(self, count: int) -> str:
        """Such as "1 stroke" or "26 strokes"."""
        return f"{count} {self.value}{'' if count == 1 else 's'}"


def group_labels(points: IsobaricDataset, grouping: Grouping) -> NDArray[np.int64]:
    """The number of each point's group, from 0 without gaps, shape (points,).

    Raises
    ------
    IdentificationError
        If the repeats are asked for and not recorded.

    Examples
    --------
    >>> points = IsobaricDataset.of(
    ...     pressure=[1e5, 1e5, 2e5, 2e5],
    ...     contraction=[0, 0.1, 0, 0.1],
    ...     force=[80, 40, 170, 90],
    ...     direction=["loading", "unloading", "loading", "loading"],
    ... )
    >>> group_labels(points, Grouping.STROKE), group_labels(points, Grouping.PRESSURE)
    (array([0, 1, 2, 2]), array([0, 0, 1, 1]))
    """
    if grouping is Grouping.POINT:
        return np.arange(len(points))
    columns: list[np.ndarray] = []
    if grouping in (Grouping.STROKE, Grouping.PRESSURE):
        columns.append(points.levels)
    if grouping in (Grouping.STROKE, Grouping.REPEAT) and "repeat" in points.table:
        columns.append(points.table["repeat"].to_numpy())
    if grouping is Grouping.STROKE:
        columns.append(approach_labels(points))
    if not columns:
        raise IdentificationError(
            "the data do not say which repeat a point belongs to",
            remedy="record a column 'repeat', or group by stroke or by pressure",
        )
    return _numbered(columns)


def approach_labels(points: IsobaricDataset) -> NDArray[np.str_]:
    """Which way each point was reached, shape (points,): what tells the passes at a level apart.

    That is its direction, or its phase where no direction is known at its level and repeat; empty where neither is.
    A point whose own is not known, as that at which a stroke begins after the muscle was filled, goes with the next
    point of its level and repeat that has one, or with the last: it is no pass of its own.

    Examples
    --------
    >>> points = IsobaricDataset.of(
    ...     pressure=[1e5, 1e5, 1e5, 2e5, 2e5],
    ...     contraction=[0, 0.1, 0, 0.1, 0.1],
    ...     force=[80, 40, 84, 90, 80],
    ...     direction=["", "unloading", "loading", "", ""],
    ...     phase=["filling", "", "", "filling", "venting"],
    ... )
    >>> approach_labels(points).tolist()
    ['unloading', 'unloading', 'loading', 'filling', 'venting']
    """
    direction, phase = (
        points.table[name].to_numpy() if name in points.table else np.full(len(points), "", "<U9")
        for name in ("direction", "phase")
    )
    repeat = [points.table["repeat"].to_numpy()] if "repeat" in points.table else []
    cells = _numbered([points.levels, *repeat])
    has_direction = np.bincount(cells, direction != "") > 0
    order = np.argsort(cells, kind="stable")
    own, cell = np.where(has_direction[cells], direction, phase)[order], cells[order]
    place = np.arange(len(own))
    following = np.minimum.accumulate(np.where(own != "", place, len(own) - 1)[::-1])[::-1]
    preceding = np.maximum.accumulate(np.where(own != "", place, 0))
    source = np.where(cell[following] == cell, following, place)
    source = np.where(own[source] == "", preceding, source)
    found = np.empty_like(own)
    found[order] = np.where(cell[source] == cell, own[source], "")
    return found


def finest_grouping(points: IsobaricDataset) -> Grouping:
    """Strokes where a direction, a phase or a repeat is known, else pressures."""
    told_apart = bool(len(points.directions) or len(points.phases) or len(points.repeats))
    return Grouping.STROKE if told_apart else Grouping.PRESSURE


def _numbered(columns: Sequence[np.ndarray]) -> NDArray[np.int64]:
    """The number of each row among the distinct rows."""
    number = np.zeros(len(columns[0]), np.int64)
    for column in columns:  # one after the other, so that numbers of rows are sorted and not rows
        codes = np.unique(column, return_inverse=True)[1].reshape(-1)
        number = np.unique(number * (int(codes.max(initial=0)) + 1) + codes, return_inverse=True)[1].reshape(-1)
    return number
