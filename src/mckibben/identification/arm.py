"""An arm of creep that is drawn along a test: its two numbers by least squares, and how sure they are."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mckibben.identification.courses import Courses, Moves

_LEVEL = 3.84  # the 95 % point of chi-square with one degree of freedom
_GRID = 61


@dataclass(frozen=True, eq=False)
class Arm:
    """An arm along the moves of a test, and what it leaves of the courses of the plateaus."""

    courses: Courses
    moves: Moves

    def numbers(self, tau: float, used: NDArray[np.bool_]) -> tuple[float, float]:
        """The stiffness [N/m] of an arm of a time constant [s], 0 at least, and the common rate [N/s]."""
        return self._solved(tau, used)[:2]

    def cost(self, tau: float, used: NDArray[np.bool_]) -> float:
        """The sum of the squared residuals of the plateaus, each a mean over its samples [N^2]."""
        return self._solved(tau, used)[2]

    def stiffness_error(self, tau: float, used: NDArray[np.bool_]) -> float:
        """The standard error of the stiffness [N/m] of an arm of a given time constant [s]."""
        columns, residuals = self._left(tau, used)
        return math.sqrt(_covariance(columns, residuals, self.courses.weight)[0][0, 0])

    def time_constant(self, used: NDArray[np.bool_], lower: float, upper: float) -> float:
        """The one with the least squares, from a grid and then exactly."""
        grid = np.linspace(math.log(lower), math.log(upper), _GRID)
        at = int(np.argmin([self.cost(math.exp(log_tau), used) for log_tau in grid]))
        from scipy.optimize import minimize_scalar  # 0.1 s, which no import of the package should wait for

        found = minimize_scalar(
            lambda log_tau: self.cost(math.exp(log_tau), used),
            bounds=(float(grid[max(at - 1, 0)]), float(grid[min(at + 1, _GRID - 1)])),
            method="bounded",
            options={"xatol": 1e-6},
        )
        return math.exp(float(found.x))  # type: ignore[attr-defined]

    def uncertainty(self, tau: float, used: NDArray[np.bool_]) -> tuple[dict[str, float], float, float]:
        """Standard errors of stiffness and time constant, their correlation, and how much correlation in plateaus adds.

        The last is a ratio of variances, that of the time constant.
        """
        small = 1e-4
        after, before = (self._by_stiffness(tau * math.exp(sign * small)) for sign in (1, -1))
        columns, residuals = self._left(tau, used)
        by_log_tau = self.numbers(tau, used)[0] * (after - before)[used] / (2 * small)
        every = np.concatenate([columns, by_log_tau[..., None]], axis=-1)
        covariance, simple = _covariance(every, residuals, self.courses.weight)
        spread = np.sqrt(np.diag(covariance))
        errors = {"stiffness": float(spread[0]), "time_constant": float(spread[2]) * tau}
        return errors, float(covariance[0, 2] / (spread[0] * spread[2])), float(covariance[2, 2] / simple[2, 2])

    def between(
        self, tau: float, used: NDArray[np.bool_], lower: float, upper: float, excess: float
    ) -> tuple[float, float]:
        """The interval of 95 % of the time constant by its profile; 0 or infinity where it has no end."""
        least = self.cost(tau, used)
        freedom = int(used.sum()) * (len(self.courses.weight) - 1) - 3

        def distance(log_tau: float) -> float:
            """From the best one, in standard errors."""
            more = max(self.cost(math.exp(log_tau), used) / least - 1, 0.0) * freedom
            return math.sqrt(more / max(excess, 1.0)) - math.sqrt(_LEVEL)

        from scipy.optimize import brentq

        ends: list[float] = []
        for end, none in ((lower, 0.0), (upper, math.inf)):
            if distance(math.log(end)) <= 0:
                ends.append(none)
                continue
            near, far = math.log(tau), math.log(end)
            steps = np.linspace(near, far, _GRID)
            first = next(k for k in range(1, _GRID) if distance(steps[k]) > 0)
            ends.append(math.exp(brentq(distance, steps[first - 1], steps[first], xtol=1e-4)))  # type: ignore[arg-type]
        return ends[0], ends[1]

    def _by_stiffness(self, tau: float) -> NDArray[np.float64]:
        return self.moves.held(tau)[:, None] * self.courses.blocks(np.exp(-self.courses.times / tau))

    def _solved(self, tau: float, used: NDArray[np.bool_]) -> tuple[float, float, float]:
        """Stiffness, common rate and cost: the normal equations of columns that are products of plateau and block."""
        values, weight = self.courses.values[used], self.courses.weight
        held, decay, line = (
            self.moves.held(tau)[used],
            self.courses.blocks(np.exp(-self.courses.times / tau)),
            self._line,
        )
        size1 = math.sqrt(held @ held * (decay**2 @ weight))
        size2 = math.sqrt(len(held) * (line**2 @ weight))
        wanted1 = held @ (values @ (weight * decay)) / size1 if size1 > 0 else 0.0
        wanted2 = float((values @ (weight * line)).sum()) / size2
        common = held.sum() * ((decay * line) @ weight) / (size1 * size2) if size1 > 0 else 0.0
        first = (wanted1 - common * wanted2) / (1 - common**2) if abs(common) < 1 else 0.0
        first = max(float(first), 0.0)  # no arm pushes on in the direction of the move
        second = wanted2 - common * first
        cost = (
            float((values**2 @ weight).sum())
            - (2 * first * wanted1 + 2 * second * wanted2)
            + (first**2 + second**2 + 2 * common * first * second)
        )
        return (first / size1 if size1 > 0 else 0.0), float(second / size2), float(cost)

    def _left(self, tau: float, used: NDArray[np.bool_]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Columns, shape (plateaus, blocks, 2), and residuals, shape (plateaus, blocks)."""
        values = self.courses.values[used]
        columns = np.stack([self._by_stiffness(tau)[used], np.broadcast_to(self._line, values.shape)], axis=-1)
        return columns, values - columns @ np.array(self.numbers(tau, used))

    @property
    def _line(self) -> NDArray[np.float64]:
        return self.courses.blocks(self.courses.times)


def _covariance(
    columns: NDArray[np.float64], residuals: NDArray[np.float64], weight: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Of the numbers: with the residuals of a plateau correlated in whatever way, and with independent ones."""
    plateaus, blocks, count = columns.shape
    size = np.sqrt(np.einsum("pbi,pbi,b->i", columns, columns, weight))
    scaled = columns / size
    bread = np.linalg.pinv(np.einsum("pbi,pbj,b->ij", scaled, scaled, weight))
    score = np.einsum("pbi,pb,b->pi", scaled, residuals, weight)
    spread = float((residuals**2 @ weight).sum()) / (plateaus * (blocks - 1) - count)
    correlated = bread @ (score.T @ score) @ bread * plateaus / (plateaus - count)
    return correlated / np.outer(size, size), bread * spread / np.outer(size, size)
