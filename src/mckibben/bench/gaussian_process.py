"""Plain Gaussian process: constant mean, squared exponential kernel with one length per input, and noise."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_solve, cholesky, solve_triangular
from scipy.optimize import minimize

Floats = NDArray[np.float64]

_STARTS = ((0.0, 0.0, -3.0), (-1.0, -1.0, -3.0), (0.0, 0.0, -6.0))  # first length, other lengths, noise
_BOUNDS = ((-3.0, 6.0), (-3.0, 4.0), (-9.0, 1.0))  # logarithms of amplitude, lengths and noise
_JITTER = 1e-9  # of the variance


class GaussianProcess(NamedTuple):
    """A Gaussian process conditioned on points, by `fitted`."""

    inputs: Floats
    weights: Floats
    factor: Floats
    values: Floats
    middle: Floats
    width: Floats
    mean: float
    spread: float

    @classmethod
    def fitted(cls, inputs: Floats, output: Floats) -> GaussianProcess:
        """Return the process whose amplitude, lengths and noise have maximum likelihood, the best of three starts."""
        middle, width = inputs.mean(axis=0), np.maximum(inputs.std(axis=0), 1e-12)
        given, mean, spread = (inputs - middle) / width, float(output.mean()), max(float(output.std()), 1e-12)
        target, lengths = (output - mean) / spread, inputs.shape[1]
        apart = (given[:, None] - given) ** 2

        def solved(values: Floats) -> tuple[Floats, Floats, Floats]:
            signal = np.exp(2 * values[0] - apart @ np.exp(-2 * values[1:-1]) / 2)
            noise = np.exp(2 * values[-1]) + _JITTER * np.exp(2 * values[0])
            factor = cholesky(signal + noise * np.eye(len(given)), lower=True)
            return signal, factor, cho_solve((factor, True), target)

        def cost(values: Floats) -> tuple[float, Floats]:
            signal, factor, weights = solved(values)
            inverse = cho_solve((factor, True), np.eye(len(given)))
            inner = inverse - np.outer(weights, weights)
            slopes = [np.sum(inner * signal) + _JITTER * np.exp(2 * values[0]) * np.trace(inner)]
            scaled = inner * signal
            slopes += [np.sum(scaled * apart[:, :, i]) * np.exp(-2 * values[1 + i]) / 2 for i in range(lengths)]
            slopes.append(np.exp(2 * values[-1]) * np.trace(inner))
            return float(target @ weights / 2 + np.log(np.diag(factor)).sum()), np.array(slopes)

        starts = [(1.0, first, *[rest] * (lengths - 1), noise) for first, rest, noise in _STARTS]
        bounds = (_BOUNDS[0], *[_BOUNDS[1]] * lengths, _BOUNDS[2])
        found = min((minimize(cost, one, jac=True, bounds=bounds) for one in starts), key=lambda one: one.fun).x
        _, factor, weights = solved(found)
        return cls(given, weights, factor, found, middle, width, mean, spread)

    def predict(self, inputs: Floats) -> tuple[Floats, Floats]:
        """Return mean and standard deviation of a new measurement at inputs of shape (points, inputs)."""
        apart = (((inputs - self.middle) / self.width)[:, None] - self.inputs) ** 2
        across = np.exp(2 * self.values[0] - apart @ np.exp(-2 * self.values[1:-1]) / 2)
        known = solve_triangular(self.factor, across.T, lower=True)
        variance = np.exp(2 * self.values[0]) - np.sum(known**2, axis=0) + np.exp(2 * self.values[-1])
        return self.mean + self.spread * (across @ self.weights), self.spread * np.sqrt(np.maximum(variance, 0.0))
