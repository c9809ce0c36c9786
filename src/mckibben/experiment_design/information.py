"""Fisher information of candidate points, and the exchange algorithm."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

RANK = 1e-10
"""Of the largest singular value: combinations of parameters below it change no force that can be measured."""


@dataclass(frozen=True, eq=False)
class Coordinates:
    """Combinations of parameters that the measurable forces depend on.

    Attributes
    ----------
    forward
        Shape (parameters, coordinates): rows of a design matrix times it are rows in the coordinates.
    size
        Shape (parameters,): root mean square of the rows, by parameter.
    lost
        Shape (parameters, rest): combinations of parameters, in units of 1 N, that change no measurable force.
    """

    forward: NDArray[np.float64] = field(repr=False)
    size: NDArray[np.float64] = field(repr=False)
    lost: NDArray[np.float64] = field(repr=False)

    @classmethod
    def of(cls, rows: NDArray[np.float64]) -> Coordinates:
        """From the design matrix of all that can be measured, shape (candidates, parameters)."""
        size = np.sqrt(np.mean(rows**2, axis=0))
        size[size == 0] = 1.0
        factor = np.linalg.qr(rows / size / np.sqrt(len(rows)), mode="r")  # as few rows as columns
        _, singular, directions = np.linalg.svd(factor)
        singular = np.append(singular, np.zeros(len(directions) - len(singular)))
        kept = singular > RANK * singular[0]
        forward = (directions[kept] / singular[kept, None]).T / size[:, None]
        return cls(forward, size, directions[~kept].T)

    def misses(self, gradients: NDArray[np.float64]) -> NDArray[np.float64]:
        """How much of gradients, shape (numbers, parameters), lies in combinations that no force tells; 0..1 each."""
        scaled = gradients / self.size
        length = np.linalg.norm(scaled, axis=1)
        return np.linalg.norm(scaled @ self.lost, axis=1) / np.where(length > 0, length, 1.0)


@dataclass(frozen=True, eq=False)
class Spread:
    """How measured points scatter about the law.

    Attributes
    ----------
    point
        sigma [N], of each plateau mean on its own.
    stroke
        tau [N], of what the points of a stroke share.
    """

    point: float
    stroke: float = 0.0

    def shared(self, count: NDArray[np.int64]) -> NDArray[np.float64]:
        """c_m of strokes that have m points."""
        return np.asarray(self.stroke**2 / (self.point**2 + count * self.stroke**2), np.float64)


def information(rows: NDArray[np.float64], strokes: NDArray[np.int64], spread: Spread) -> NDArray[np.float64]:
    """Of points, shape (points, coordinates), and the stroke of each, shape (points,); shape (coordinates,) * 2.

    Examples
    --------
    The mean of one stroke of four points is never surer than the stroke.

    >>> spread = Spread(point=1.0, stroke=3.0)
    >>> found = information(np.ones((4, 1)), np.zeros(4, int), spread)
    >>> round(1 / float(found[0, 0]), 9), 3.0**2 + 1.0**2 / 4
    (9.25, 9.25)
    """
    if not len(rows):
        return np.zeros((rows.shape[1],) * 2)
    sums, counts = stroke_sums(rows, strokes, int(strokes.max()) + 1)
    return (rows.T @ rows - (sums.T * spread.shared(counts)) @ sums) / spread.point**2


def stroke_sums(
    rows: NDArray[np.float64], strokes: NDArray[np.int64], count: int
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """The sum of the rows of each stroke, shape (strokes, coordinates), and how many they are."""
    sums = np.zeros((count, rows.shape[1]))
    np.add.at(sums, strokes, rows)
    return sums, np.bincount(strokes, minlength=count)


@dataclass(frozen=True, eq=False)
class Aim:
    """What is to become sure, in the coordinates.

    Attributes
    ----------
    gradients
        Shape (numbers, coordinates).
    joint
        Whether the volume of the joint confidence region counts, and not the mean variance.
    """

    gradients: NDArray[np.float64] = field(repr=False)
    joint: bool

    @classmethod
    def of(cls, gradients: NDArray[np.float64], joint: bool) -> Aim:
        """The same aim with no more numbers than coordinates: of a mean variance only the mean square matters."""
        count, width = gradients.shape
        if not joint and count > width:
            gradients = np.linalg.qr(gradients, mode="r") * np.sqrt(width / count)
        return cls(gradients, joint)

    def cost(self, known: NDArray[np.float64]) -> float:
        """The logarithm of the variance at an information: its mean, or the geometric one of the joint region."""
        covariance = self.gradients @ np.linalg.solve(known, self.gradients.T)
        if self.joint:
            return float(np.linalg.slogdet(covariance)[1]) / len(covariance)
        return float(np.log(np.trace(covariance) / len(covariance)))

    def costs_with(self, known: NDArray[np.float64], rows: NDArray[np.float64]) -> NDArray[np.float64]:
        """The same after one more point of unit variance, for each of the rows; shape (rows,)."""
        inverse = np.linalg.inv(known)
        seen = rows @ inverse
        leverage = 1 + np.einsum("ni,ni->n", seen, rows)
        moved = seen @ self.gradients.T
        covariance = self.gradients @ inverse @ self.gradients.T
        if self.joint:
            part = np.einsum("ni,in->n", moved, np.linalg.solve(covariance, moved.T)) / leverage
            total = float(np.linalg.slogdet(covariance)[1])
            return (total + np.log1p(-np.minimum(part, 1 - 1e-15))) / len(covariance)
        left = np.trace(covariance) - np.einsum("ni,ni->n", moved, moved) / leverage
        return np.log(np.maximum(left, 1e-300) / len(covariance))


def estimated_spread(
    rows: NDArray[np.float64], residuals: NDArray[np.float64], strokes: NDArray[np.int64] | None
) -> Spread:
    r"""Both standard deviations, from two quadratic forms of the residuals whose expectations are known.

    With Q the projection onto what the rows leave over and Z the indicator of strokes,
    :math:`E[e^T e] = \sigma^2 \mathrm{tr} Q + \tau^2 \mathrm{tr} Z^T Q Z` and
    :math:`E[|Z^T e|^2] = \sigma^2 \mathrm{tr} Z^T Q Z + \tau^2 \mathrm{tr} (Z^T Q Z)^2`: two equations, unbiased.

    Parameters
    ----------
    rows
        Shape (points, parameters): the design matrix; its columns may depend on each other.
    residuals
        Shape (points,) [N]; what the rows explain of them is taken out.
    strokes
        Shape (points,): the stroke of each point, from 0 without gaps; None where strokes have nothing in common.

    Returns
    -------
    Spread
        tau is 0 where the estimate of its square is negative.

    Examples
    --------
    >>> found = estimated_spread(np.ones((4, 1)), np.array([1.0, -1.0, 2.0, -2.0]), None)
    >>> round(found.point, 4)
    1.8257
    """
    lengths = np.linalg.norm(rows, axis=0)
    basis, singular, _ = np.linalg.svd(rows / np.where(lengths > 0, lengths, 1.0), full_matrices=False)
    basis = basis[:, singular > 1e-10 * singular[0]]
    left = residuals - basis @ (basis.T @ residuals)
    count, rank = basis.shape
    if count <= rank:
        return Spread(0.0)
    square = float(left @ left)
    alone = Spread(float(np.sqrt(square / (count - rank))))
    if strokes is None:
        return alone
    groups = np.eye(int(strokes.max()) + 1)[strokes]
    onto = basis.T @ groups
    between = groups.T @ groups - onto.T @ onto
    trace, trace2 = float(np.trace(between)), float(np.sum(between**2))
    sums = groups.T @ left
    equations = np.array([[count - rank, trace], [trace, trace2]])
    if np.linalg.cond(equations) > 1e8:
        return alone
    point, stroke = np.linalg.solve(equations, [square, float(sums @ sums)])
    if stroke <= 0 or point <= 0:
        return alone
    return Spread(float(np.sqrt(point)), float(np.sqrt(stroke)))


@dataclass(frozen=True, eq=False)
class Judge:
    """Standard errors without the prior: where it matters, the points determine nothing.

    Attributes
    ----------
    hand
        Shape (coordinates,) * 2: the information of the points at hand.
    prior
        That of the prior, the same for all coordinates.
    """

    hand: NDArray[np.float64] = field(repr=False)
    prior: NDArray[np.float64] = field(repr=False)

    def error(self, aim: Aim, more: NDArray[np.float64] | float = 0.0) -> float:
        """Of a quantity; infinite where it is not determined."""
        known = self.hand + more
        weak, weaker = (aim.cost(known + self.prior * part) for part in (1.0, 1e-2))
        return math.inf if weaker - weak > 0.02 else math.exp(weaker / 2)

    def errors(self, gradients: NDArray[np.float64], more: NDArray[np.float64] | float = 0.0) -> NDArray[np.float64]:
        """Of each of many numbers."""
        known = self.hand + more
        weak, weaker = (
            np.einsum("ni,in->n", gradients, np.linalg.solve(known + self.prior * part, gradients.T))
            for part in (1.0, 1e-2)
        )
        return np.where(weaker > 1.02 * weak, np.inf, np.sqrt(weaker))

    def unknown(self, coordinates: Coordinates) -> NDArray[np.float64]:
        """Combinations of parameters that the points at hand do not tell, in units of 1 N; shape (parameters, n)."""
        strength, directions = np.linalg.eigh(self.hand)
        free = directions[:, strength < self.prior[0, 0]]
        return coordinates.size[:, None] * (coordinates.forward @ free)


_LEAST_GAIN = 1e-9  # of the logarithm of a variance
_MOST_PASSES = 50


@dataclass(frozen=True, eq=False)
class Field:
    """All points that could be measured.

    Attributes
    ----------
    rows
        Shape (candidates, coordinates).
    strokes
        Shape (candidates,): on which new stroke each would lie, from 0.
    known
        Shape (coordinates,) * 2: the information that is there, invertible.
    spread
        How points scatter.
    aim
        What is to become sure.
    """

    rows: NDArray[np.float64] = field(repr=False)
    strokes: NDArray[np.int64] = field(repr=False)
    known: NDArray[np.float64] = field(repr=False)
    spread: Spread
    aim: Aim

    def after(self, chosen: list[int]) -> NDArray[np.float64]:
        """The information with some candidates measured."""
        return self.known + information(self.rows[chosen], self.strokes[chosen], self.spread)

    def cost(self, chosen: list[int]) -> float:
        """The logarithm of the variance with some candidates measured."""
        return self.aim.cost(self.after(chosen))

    def best(self, chosen: list[int], among: NDArray[np.int64] | None = None) -> tuple[int, float]:
        """The candidate, not yet chosen, that shrinks the variance most; and the cost then."""
        sums, counts = stroke_sums(self.rows[chosen], self.strokes[chosen], int(self.strokes.max()) + 1)
        rows = self.rows if among is None else self.rows[among]
        strokes = self.strokes if among is None else self.strokes[among]
        shared = self.spread.shared(counts)[strokes]
        seen = rows - shared[:, None] * sums[strokes]
        costs = self.aim.costs_with(self.after(chosen), seen / (self.spread.point * np.sqrt(1 + shared))[:, None])
        if among is None:
            costs[chosen] = np.inf
        place = int(np.argmin(costs))
        return (place if among is None else int(among[place])), float(costs[place])


def search(field: Field, count: int) -> list[int]:
    """The best points, as numbers of candidates, in the order of what each gains given those before it."""
    chosen: list[int] = []
    for _ in range(count):
        chosen.append(field.best(chosen)[0])
    cost = field.cost(chosen)
    for _ in range(_MOST_PASSES):
        before = cost
        for place in range(count):
            rest = chosen[:place] + chosen[place + 1 :]
            better, found = field.best(rest)
            if found < cost - _LEAST_GAIN:
                chosen[place], cost = better, found
        if cost > before - _LEAST_GAIN:
            break
    ordered: list[int] = []
    while len(ordered) < count:
        left = np.array([one for one in chosen if one not in ordered])
        ordered.append(field.best(ordered, left)[0])
    return ordered
