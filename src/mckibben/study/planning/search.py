"""The search for the best points: one by one, then each against all others until no exchange gains.

The number of points is given and each is whole (an exact design). The first pass takes whatever shrinks the variance
most; then every point is taken out in turn and the best one put in its place (Fedorov's exchange). What is found is the
best that no exchange of one point improves; the very best it need not be.

References
----------
V. Fedorov, "Theory of Optimal Experiments", Academic Press 1972; T. Mitchell, Technometrics 16 (1974) 203-210; A.
Atkinson, A. Donev and R. Tobias, "Optimum Experimental Designs, with SAS", Oxford 2007, chapter 12.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from mckibben.study.planning.information import Aim, Spread, information, stroke_sums

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
