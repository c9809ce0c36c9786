r"""What points tell about the parameters, where the points of a stroke may share an error.

With independent errors of variance :math:`\sigma^2` and one of variance :math:`\tau^2` for each stroke, the information
of a stroke's rows :math:`X_g`, m of them with the sum u, is

.. math::

    \sigma^{-2} \left(X_g^T X_g - c_m u u^T\right), \qquad c_m = \frac{\tau^2}{\sigma^2 + m \tau^2}

so that a further point x of the stroke adds :math:`\tilde x \tilde x^T / v` with :math:`\tilde x = x - c_m u` and
:math:`v = \sigma^2 (1 + c_m)`: an exact update of rank one. Ten points on one stroke do not count ten times.

Parameters are in the coordinates of `Coordinates`, in which a unit changes the force by 1 N in the mean over all states
that can be measured. There a prior is easily said: each coordinate is 0, give or take a hundred times the highest
force. It is so weak that it decides nothing which data decide, and lets a search begin where they determine nothing.
"""

from __future__ import annotations

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
