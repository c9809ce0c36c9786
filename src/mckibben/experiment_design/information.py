"""Information matrix, design criterion and exchange algorithm of an optimal experiment design.

Rows of a design matrix are derivatives of forces [N] by parameters, each in its SI unit, or by coordinates of the
`IdentifiableSubspace`, in which a unit is one newton. Points of one stroke of the rig share an error.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Indices = NDArray[np.int64]

RANK_TOLERANCE = 1e-10
"""Relative to the largest singular value; combinations of parameters below it change no measurable force."""


@dataclass(frozen=True, eq=False)
class IdentifiableSubspace:
    """Combinations of parameters that affect the measurable forces.

    Examples
    --------
    Only the sum of the first two of three parameters changes a force:

    >>> rows = np.array([[1.0, 1.0, 0.0], [1.0, 1.0, 2.0], [2.0, 2.0, 1.0]])
    >>> subspace = IdentifiableSubspace.of(rows)
    >>> subspace.basis.shape, np.abs(subspace.null_space[:, 0]).round(3)
    ((3, 2), array([0.707, 0.707, 0.   ]))
    >>> subspace.unidentifiable_part(np.eye(3)).round(3)
    array([0.707, 0.707, 0.   ])
    """

    basis: Floats = field(repr=False)  # (parameters, coordinates): from rows of a design matrix
    scale: Floats = field(repr=False)  # (parameters,): root mean square of each column
    null_space: Floats = field(repr=False)  # (parameters, rest): combinations of 1 N without effect

    @classmethod
    def of(cls, rows: Floats) -> IdentifiableSubspace:
        """Subspace of the design matrix of all measurable points, shape (candidates, parameters)."""
        scale = np.sqrt(np.mean(rows**2, axis=0))
        scale[scale == 0] = 1.0
        factor = np.linalg.qr(rows / scale / np.sqrt(len(rows)), mode="r")
        _, singular, directions = np.linalg.svd(factor)
        singular = np.append(singular, np.zeros(len(directions) - len(singular)))
        kept = singular > RANK_TOLERANCE * singular[0]
        basis = (directions[kept] / singular[kept, None]).T / scale[:, None]
        return cls(basis, scale, directions[~kept].T)

    def unidentifiable_part(self, gradients: Floats) -> Floats:
        """Relative norm of gradients, shape (values, parameters), in the null space; 0 to 1 each."""
        scaled = gradients / self.scale
        length = np.linalg.norm(scaled, axis=1)
        return np.linalg.norm(scaled @ self.null_space, axis=1) / np.where(length > 0, length, 1.0)


@dataclass(frozen=True, eq=False)
class NoiseModel:
    """Variance components of measured points."""

    point: float  # standard deviation sigma of a plateau mean [N]
    stroke: float = 0.0  # tau of the error shared by the points of a stroke [N]

    def shared_weight(self, count: Indices) -> Floats:
        """tau^2 / (sigma^2 + m tau^2) of strokes of m points."""
        return np.asarray(self.stroke**2 / (self.point**2 + count * self.stroke**2), np.float64)


def information_matrix(rows: Floats, strokes: Indices, noise: NoiseModel) -> Floats:
    r"""Return the Fisher information of points, shape (coordinates, coordinates).

    .. math:: \sum_s J_s^T (\sigma^2 I + \tau^2 1 1^T)^{-1} J_s

    with the rows J_s of stroke s, in the closed form of the inverse (Sherman and Morrison).

    Parameters
    ----------
    rows, strokes
        Shape (points, coordinates), and the index of the stroke of each, (points,).

    Examples
    --------
    Two points of a stroke whose shared error is as large as that of each point:

    >>> information_matrix(np.eye(2), np.array([0, 0]), NoiseModel(1.0, stroke=1.0)).round(3)
    array([[ 0.667, -0.333],
           [-0.333,  0.667]])
    """
    if not len(rows):
        return np.zeros((rows.shape[1],) * 2)
    sums, counts = _stroke_sums(rows, strokes, int(strokes.max()) + 1)
    return (rows.T @ rows - (sums.T * noise.shared_weight(counts)) @ sums) / noise.point**2


def _stroke_sums(rows: Floats, strokes: Indices, count: int) -> tuple[Floats, Indices]:
    """Sum of the rows of each stroke, shape (strokes, coordinates), and number of rows."""
    sums = np.zeros((count, rows.shape[1]))
    np.add.at(sums, strokes, rows)
    return sums, np.bincount(strokes, minlength=count)


def condensed(gradients: Floats) -> Floats:
    """Return gradients with the same mean variance for any information, of no more values than coordinates.

    Shape (values, coordinates), by the triangular factor of a QR decomposition.
    """
    count, width = gradients.shape
    return gradients if count <= width else np.linalg.qr(gradients, mode="r") * np.sqrt(width / count)


def mean_variance(gradients: Floats, information: Floats) -> float:
    """Return the mean variance of values (c-optimality of one, A- or V-optimality of several).

    Parameters
    ----------
    gradients, information
        Derivatives of the values, shape (values, coordinates), and an invertible matrix (coordinates, coordinates).

    Examples
    --------
    >>> mean_variance(np.eye(2), np.diag([4.0, 1.0]))
    0.625
    """
    return float(np.trace(gradients @ np.linalg.solve(information, gradients.T))) / len(gradients)


def mean_variances_with(gradients: Floats, information: Floats, rows: Floats) -> Floats:
    """Return the mean variance after adding each row as a point of unit variance, shape (rows,).

    By a rank-one update of the inverse, so that all candidates cost one inversion.
    """
    inverse = np.linalg.inv(information)
    seen = rows @ inverse
    leverage = 1 + np.einsum("ni,ni->n", seen, rows)
    moved = seen @ gradients.T
    total = np.trace(gradients @ inverse @ gradients.T) - np.einsum("ni,ni->n", moved, moved) / leverage
    return np.maximum(total, 1e-300) / len(gradients)


def estimate_noise(rows: Floats, residuals: Floats, strokes: Indices | None) -> NoiseModel:
    """Return unbiased variance components of points and strokes from residuals of a fit.

    Without strokes, or if they cannot be told from the points, or a component is negative, points are independent.

    Parameters
    ----------
    rows, residuals
        Design matrix, shape (points, parameters), and residuals [N], (points,).
    strokes
        Index of the stroke of each point; None for independent points.

    Examples
    --------
    Four residuals about a mean have three degrees of freedom:

    >>> round(estimate_noise(np.ones((4, 1)), np.array([1.0, -1.0, 1.0, -1.0]), None).point, 4)
    1.1547
    """
    lengths = np.linalg.norm(rows, axis=0)
    basis, singular, _ = np.linalg.svd(rows / np.where(lengths > 0, lengths, 1.0), full_matrices=False)
    basis = basis[:, singular > RANK_TOLERANCE * singular[0]]
    residuals = residuals - basis @ (basis.T @ residuals)
    count, rank = basis.shape
    if count <= rank:
        return NoiseModel(0.0)
    square = float(residuals @ residuals)
    independent = NoiseModel(float(np.sqrt(square / (count - rank))))
    if strokes is None:
        return independent
    groups = np.eye(int(strokes.max()) + 1)[strokes]
    onto = basis.T @ groups
    between = groups.T @ groups - onto.T @ onto
    trace, trace2 = float(np.trace(between)), float(np.sum(between**2))
    sums = groups.T @ residuals
    equations = np.array([[count - rank, trace], [trace, trace2]])
    if np.linalg.cond(equations) > 1e8:
        return independent
    point, stroke = np.linalg.solve(equations, [square, float(sums @ sums)])
    if stroke <= 0 or point <= 0:
        return independent
    return NoiseModel(float(np.sqrt(point)), float(np.sqrt(stroke)))


@dataclass(frozen=True, eq=False)
class ErrorEstimator:
    """Standard errors from information; infinite where only the prior determines the value."""

    information: Floats = field(repr=False)  # of the prior data, (coordinates,) * 2
    prior: Floats = field(repr=False)  # a weak multiple of the identity

    def error(self, gradients: Floats, added: Floats | float = 0.0) -> float:
        """Root of the mean variance of values, with added information."""
        return float(_root(*self._variances(gradients, added).mean(axis=1)))

    def errors(self, gradients: Floats, added: Floats | float = 0.0) -> Floats:
        """Standard error of each of many values, with added information."""
        return _root(*self._variances(gradients, added))

    def _variances(self, gradients: Floats, added: Floats | float) -> Floats:
        """Variances of values with the prior and with a hundredth of it, shape (2, values)."""
        priors = np.stack([self.prior, self.prior / 100])
        return np.einsum("ni,kin->kn", gradients, np.linalg.solve(self.information + added + priors, gradients.T))

    def undetermined(self, subspace: IdentifiableSubspace) -> Floats:
        """Combinations of parameters, scaled to 1 N, that the prior data leave free; shape (parameters, n)."""
        strength, directions = np.linalg.eigh(self.information)
        free = directions[:, strength < self.prior[0, 0]]
        return subspace.scale[:, None] * (subspace.basis @ free)


def _root(weak: Floats, weaker: Floats) -> Floats:
    """Standard error from the variances with a weak and a weaker prior; infinite if only the prior determines it."""
    return np.where(weaker > 1.02 * weak, np.inf, np.sqrt(weaker))


@dataclass(frozen=True, eq=False)
class ExchangeProblem:
    """Selection of points from candidates."""

    rows: Floats = field(repr=False)  # (candidates, coordinates)
    strokes: Indices = field(repr=False)  # (candidates,), new ones
    information: Floats = field(repr=False)  # of the prior data, invertible
    noise: NoiseModel
    gradients: Floats = field(repr=False)  # (values, coordinates), whose mean variance is the cost

    def added(self, chosen: list[int]) -> Floats:
        """Information of chosen candidates."""
        return information_matrix(self.rows[chosen], self.strokes[chosen], self.noise)

    def cost(self, chosen: list[int]) -> float:
        """Cost with chosen candidates measured."""
        return math.log(mean_variance(self.gradients, self.information + self.added(chosen)))

    def best(self, chosen: list[int], among: Indices | None = None) -> tuple[int, float]:
        """The unchosen candidate of the lowest cost, and that cost."""
        sums, counts = _stroke_sums(self.rows[chosen], self.strokes[chosen], int(self.strokes.max()) + 1)
        index = np.arange(len(self.rows)) if among is None else among
        strokes = self.strokes[index]
        weight = self.noise.shared_weight(counts)[strokes]
        rows = (self.rows[index] - weight[:, None] * sums[strokes]) / (self.noise.point * np.sqrt(1 + weight))[:, None]
        costs = np.log(mean_variances_with(self.gradients, self.information + self.added(chosen), rows))
        if among is None:
            costs[chosen] = np.inf
        place = int(np.argmin(costs))
        return int(index[place]), float(costs[place])


def exchange(problem: ExchangeProblem, count: int, *, passes: int = 50, gain: float = 1e-9) -> list[int]:
    """Return the indices of selected candidates in order of gain: greedy selection, then exchanges (Fedorov).

    Parameters
    ----------
    problem
        Candidates, of which there are at least `count`.
    count
        Number of points.
    passes, gain
        Exchanges end after so many passes over all points, or when one gains less of the logarithm of the variance.

    Examples
    --------
    The longest rows tell most about the only parameter:

    >>> rows, strokes = np.array([[1.0], [3.0], [2.0]]), np.arange(3)
    >>> problem = ExchangeProblem(rows, strokes, np.eye(1), NoiseModel(1.0), gradients=np.eye(1))
    >>> exchange(problem, 2)
    [1, 2]
    """
    chosen: list[int] = []
    for _ in range(count):
        chosen.append(problem.best(chosen)[0])
    cost = problem.cost(chosen)
    for _ in range(passes):
        before = cost
        for place in range(count):
            candidate, exchanged = problem.best(chosen[:place] + chosen[place + 1 :])
            if exchanged < cost - gain:
                chosen[place], cost = candidate, exchanged
        if cost > before - gain:
            break
    ordered: list[int] = []
    while len(ordered) < count:
        ordered.append(problem.best(ordered, np.setdiff1d(chosen, ordered))[0])
    return ordered
