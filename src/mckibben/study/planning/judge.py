"""Standard errors where points may determine nothing at all."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from mckibben.study.planning.information import Aim, Coordinates


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
