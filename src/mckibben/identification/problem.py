"""A least-squares problem: a type of law, points, and which of them count."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from mckibben.dataset import IsobaricDataset
from mckibben.identification.design import design_and_residuals
from mckibben.identification.ranges import UnitCube
from mckibben.muscle import ForceLaw


@dataclass(frozen=True, eq=False)
class FitProblem:
    """Find the parameters of a law for which the sum of squared force errors over the kept points is least.

    Parameters
    ----------
    law_type
        Its parameters are sought.
    contraction, pressure, force
        Shape (n,): [-], [Pa], [N].
    kept
        Shape (n,): the points that count. The law is evaluated at all of them, so that leaving some out compiles
        nothing anew.
    weights
        Shape (n,): how often each point counts; once unless given.
    """

    law_type: type[ForceLaw]
    contraction: NDArray[np.float64] = field(repr=False)
    pressure: NDArray[np.float64] = field(repr=False)
    force: NDArray[np.float64] = field(repr=False)
    kept: NDArray[np.bool_] = field(repr=False)
    weights: NDArray[np.float64] | None = field(default=None, repr=False)

    @classmethod
    def of(cls, law_type: type[ForceLaw], points: IsobaricDataset) -> FitProblem:
        """All points of a dataset, and then some that do not count, up to a quarter of the next power of two.

        So datasets of similar size, such as the parts of one, share compiled code.
        """
        count = len(points)
        quarter = max(128, (1 << (count - 1).bit_length()) // 4)
        pad = (0, -count % quarter)
        contraction, pressure, force = (
            np.pad(column, pad, mode="edge") for column in (points.contraction, points.pressure, points.force)
        )
        return cls(law_type, contraction, pressure, force, np.arange(count + pad[1]) < count)

    def keeping(self, kept: NDArray[np.bool_]) -> FitProblem:
        """The same with only those points kept; shape (m,) with m <= n, in the order of the points."""
        return replace(self, kept=np.pad(kept, (0, len(self.kept) - len(kept))))

    def weighing(self, weights: NDArray[np.float64]) -> FitProblem:
        """The same with each point counted so many times; shape (m,) with m <= n, in the order of the points."""
        return replace(self, weights=np.pad(weights, (0, len(self.kept) - len(weights))))

    @cached_property
    def names(self) -> tuple[str, ...]:
        """The parameters, linear ones first."""
        return tuple(p.name for p in self.law_type.parameters())

    @property
    def linear(self) -> int:
        """How many of the parameters are linear."""
        return len(self.law_type.linear_parameters)

    @cached_property
    def cube(self) -> UnitCube:
        """Where the shape is sought."""
        return UnitCube(self.law_type.shape_parameters)

    @cached_property
    def measured(self) -> NDArray[np.float64]:
        """The forces [N] at the kept points, shape (kept,)."""
        return self.force[self.kept]

    def law(self, values: NDArray[np.float64]) -> ForceLaw:
        """The law with these parameters [SI], shape (parameters,)."""
        return self.law_type(**dict(zip(self.names, values.tolist(), strict=True)))

    def rows(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """The columns of the design matrix, and last measured minus modelled force [N], shape (parameters + 1, n).

        All 0 at points not kept: they change no sum of squares, and no array need be cut for each set of points.
        """
        points = self.contraction, self.pressure, self.force, self.factors
        return np.asarray(design_and_residuals(self.law_type, values, *points))

    def response(self, values: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Residuals [N], shape (kept,), and design matrix, shape (kept, parameters), at the kept points.

        Both times the root of the weights, where there are any.
        """
        rows = self.rows(values)[:, self.kept]
        return rows[-1], rows[:-1].T

    @cached_property
    def factors(self) -> NDArray[np.float64]:
        """Shape (n,): what each residual is multiplied by, 0 where a point does not count."""
        kept = self.kept.astype(np.float64)
        return kept if self.weights is None else kept * np.sqrt(self.weights)


@dataclass(frozen=True, eq=False)
class Solution:
    """The answer to a problem.

    Attributes
    ----------
    values
        Shape (parameters,), in SI, linear ones first.
    position
        Of the shape, in the unit cube.
    residuals
        Shape (kept,): measured minus fitted force [N].
    jacobian
        Shape (kept, parameters): derivative of the force with respect to all parameters.
    converged
        Whether the solver says so.
    """

    values: NDArray[np.float64]
    position: NDArray[np.float64]
    residuals: NDArray[np.float64] = field(repr=False)
    jacobian: NDArray[np.float64] = field(repr=False)
    converged: bool
