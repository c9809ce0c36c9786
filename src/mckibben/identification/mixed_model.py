"""Linear mixed model: fixed columns, and random ones whose scales are estimated by restricted maximum likelihood.

The measured forces are y = X b + Z c + noise with c ~ N(0, (s sigma)^2): the scales s, relative to the noise, are a
function of a few hyperparameters. With sigma profiled and b integrated out, the restricted likelihood follows from one
QR factorisation of the columns.

References
----------
D. Harville, "Maximum likelihood approaches to variance component estimation and to related problems", J. American
Statistical Association 72 (1977) 320-338.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from mckibben.identification.estimator import Bools, Floats, tsqr_r

Scales = Callable[[Floats], tuple[Floats, Floats]]
"""Logarithm of the scale of each random column, shape (m,), and its derivative, (m, hyperparameters)."""


@dataclass(frozen=True, eq=False)
class MixedModel:
    """Columns and forces of a mixed model.

    Attributes
    ----------
    fixed, random
        Columns of the fixed and of the random coefficients, shape (n, f) and (n, m).
    residuals
        Measured forces less those of the linearisation [N], shape (n,).
    scales
        Scales of the random coefficients by hyperparameters.
    """

    fixed: Floats = field(repr=False)
    random: Floats = field(repr=False)
    residuals: Floats = field(repr=False)
    scales: Scales

    @property
    def freedom(self) -> int:
        """Number of points less the rank of the fixed columns."""
        return len(self.residuals) - self._fixed.shape[1]

    def estimate(self, starts: Sequence[Floats], bounds: Sequence[tuple[float, float]]) -> tuple[Floats, float]:
        """Hyperparameters of the largest restricted likelihood, and minus its logarithm."""
        from scipy.optimize import minimize

        options: dict[str, Any] = {"jac": True, "bounds": bounds, "method": "TNC"}  # no BLAS, no threads
        best = min((minimize(self.cost, start, **options) for start in starts), key=lambda answer: answer.fun)
        return best.x, float(best.fun)

    def cost(self, hyperparameters: Floats) -> tuple[float, Floats]:
        """Minus the logarithm of the restricted likelihood, and its gradient."""
        logarithms, derivative = self.scales(hyperparameters)
        count, free = len(logarithms), self.freedom
        scaled = self._projected * np.append(np.exp(logarithms), 1.0)
        factor = tsqr_r(np.concatenate([scaled, np.eye(count, count + 1)]))
        sizes = np.maximum(np.abs(np.diag(factor)), np.finfo(float).tiny)
        inverse = np.linalg.inv(factor[:-1, :-1])
        fitted = inverse @ factor[:-1, -1]
        part = np.sum(inverse**2, axis=1) + free * (fitted / sizes[-1]) ** 2
        return float(np.sum(np.log(sizes[:-1])) + free * np.log(sizes[-1])), (1 - part) @ derivative

    def deleted_residuals(self, hyperparameters: Floats) -> tuple[Floats, Floats]:
        """Errors [N] at each point as the fit to all others predicts it, and externally studentised residuals."""
        # R. Cook and S. Weisberg, "Residuals and Influence in Regression", Chapman and Hall 1982, section 2.2.
        q, target = self._orthonormal(hyperparameters)
        errors = target - q @ (q.T @ target)
        count, total = len(self.residuals), float(errors @ errors)
        rest = np.maximum(1 - np.sum(q[:count] ** 2, axis=1), np.finfo(float).eps)
        squares = errors[:count] ** 2 / rest
        others = np.maximum(total - squares, np.finfo(float).tiny) / (self.freedom - 1)
        return errors[:count] / rest, np.sign(errors[:count]) * np.sqrt(squares / others)

    def select(self, points: Bools) -> MixedModel:
        """Model of some of the points."""
        return MixedModel(self.fixed[points], self.random[points], self.residuals[points], self.scales)

    def _orthonormal(self, hyperparameters: Floats) -> tuple[Floats, Floats]:
        """Orthonormal basis of all columns, and the residuals; both with the rows of the prior."""
        scale = np.exp(self.scales(hyperparameters)[0])
        left = np.concatenate([self._fixed, np.zeros((len(scale), self._fixed.shape[1]))])
        right = np.concatenate([self.random * scale, np.eye(len(scale))])
        return np.linalg.qr(np.hstack([left, right]))[0], np.append(self.residuals, np.zeros(len(scale)))

    @cached_property
    def _fixed(self) -> Floats:
        """Orthonormal basis of the fixed columns, without those that are combinations of others to rounding."""
        lengths = np.linalg.norm(self.fixed, axis=0)
        u, sizes, _ = np.linalg.svd(self.fixed / np.where(lengths > 0, lengths, 1.0), full_matrices=False)
        return u[:, sizes > 1e-10 * sizes[0]]

    @cached_property
    def _projected(self) -> Floats:
        """R factor of the random columns and the residuals, orthogonal to the fixed ones."""
        width = self._fixed.shape[1]
        return tsqr_r(np.column_stack([self._fixed, self.random, self.residuals]))[width:, width:]
