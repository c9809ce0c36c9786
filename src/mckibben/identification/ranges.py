"""The ranges of the shape parameters as a unit cube, in which they are searched for."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mckibben.muscle import Parameter

_GRID_POINTS = 512  # of a grid over several parameters
_GRID_POINTS_PER_PARAMETER = 32
AT_BOUND = 1e-6  # this close to a face of the cube, a parameter is at its bound


@dataclass(frozen=True)
class UnitCube:
    """Coordinates 0..1 between the bounds of each parameter: logarithmic where both bounds are positive.

    Parameters
    ----------
    parameters
        Each with finite bounds.

    Examples
    --------
    >>> cube = UnitCube((Parameter("decay", "1", "1/percent", "", 1.0, 100.0),))
    >>> cube.values([0.5])
    [10.0]
    """

    parameters: tuple[Parameter, ...]

    def values(self, position: Sequence[Any] | Any) -> list[Any]:
        """The parameters [SI] at a position, shape (parameters,); works on traced positions too."""
        return [
            p.lower * (p.upper / p.lower) ** x if p.lower > 0 else p.lower + (p.upper - p.lower) * x
            for p, x in zip(self.parameters, position, strict=True)
        ]

    def position(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Where in the cube parameters [SI] are, shape (parameters,); 0 where a range has no width."""
        return np.array(
            [
                0.0
                if p.upper == p.lower
                else math.log(value / p.lower) / math.log(p.upper / p.lower)
                if p.lower > 0
                else (value - p.lower) / (p.upper - p.lower)
                for p, value in zip(self.parameters, values, strict=True)
            ]
        )

    def rates(self, position: NDArray[np.float64]) -> NDArray[np.float64]:
        """The derivative of each parameter with respect to its own coordinate."""
        return np.array(
            [
                value * math.log(p.upper / p.lower) if p.lower > 0 else p.upper - p.lower
                for p, value in zip(self.parameters, self.values(position), strict=True)
            ]
        )

    def grid(self) -> Iterator[NDArray[np.float64]]:
        """Positions that cover the cube, none on a face."""
        count = len(self.parameters)
        per_axis = min(_GRID_POINTS_PER_PARAMETER, int(_GRID_POINTS ** (1 / count))) if count else 1
        axis = (np.arange(per_axis) + 0.5) / per_axis
        return (np.array(position) for position in itertools.product(axis, repeat=count))

    def at_bound(self, position: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Which parameters lie at a bound of their range."""
        return (position < AT_BOUND) | (position > 1 - AT_BOUND)
