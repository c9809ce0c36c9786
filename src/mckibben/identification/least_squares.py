"""Separable nonlinear least squares: design matrix, search over the shape parameters, variable projection.

A force law is linear in some parameters and nonlinear in the others, its shape parameters. For each shape the best
linear parameters solve a linear problem, which leaves a problem in the shape alone.

References
----------
G. Golub and V. Pereyra, "Separable nonlinear least squares: the variable projection method and its applications",
Inverse Problems 19 (2003) R1-R26.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array
from numpy.typing import ArrayLike

from mckibben.dataset import IsobaricDataset
from mckibben.errors import IdentificationError, RangeError
from mckibben.identification.estimator import (
    CONDITION_LIMIT,
    Bools,
    Floats,
    condition_number,
    least_squares,
    remembered,
    tsqr_r,
)
from mckibben.muscle import Domain, ForceLaw, Parameter
from mckibben.notebook import stop_check
from mckibben.numerics.compiled import jit


def design_matrix(law: ForceLaw, names: Sequence[str], contraction: ArrayLike, pressure: ArrayLike) -> Floats:
    """Derivative of the force with respect to named parameters, shape (n, len(names)) [N per SI unit].

    Parameters
    ----------
    law
        Force law with values for all parameters; the values of linear parameters do not matter.
    contraction, pressure
        Contraction [-] and pressure [Pa]; they broadcast to n points.

    Examples
    --------
    Eq. 2 at 10 % and 2 bar, with a decay of 0.1 per percent: 1, p, eps, exp(-mu eps).

    >>> from mckibben.muscle import ExponentialLaw
    >>> law = ExponentialLaw(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, decay=10.0)
    >>> design_matrix(law, ["a1", "a2", "b1", "c1"], [0.1], [2e5]).round(4)
    array([[1.000e+00, 2.000e+05, 1.000e-01, 3.679e-01]])
    """
    contraction, pressure = np.broadcast_arrays(np.asarray(contraction, float), np.asarray(pressure, float))
    count = contraction.size
    if not names or not count:
        return np.empty((count, len(names)))
    pad = (0, max(128, 1 << (count - 1).bit_length()) - count)  # arrays of similar size share code
    padded = (np.pad(column.ravel(), pad, mode="edge") for column in (contraction, pressure))
    values = np.array([float(getattr(law, name)) for name in names])
    return np.asarray(_columns(law, values, *padded, names=tuple(names))).T[:count]


@jit
def _columns(
    law: ForceLaw, values: ArrayLike, contraction: ArrayLike, pressure: ArrayLike, *, names: tuple[str, ...]
) -> Array:
    def replaced(fields: dict[str, Any]) -> ForceLaw:
        return dataclasses.replace(law, **fields)

    return _force_and_columns(replaced, names, values, contraction, pressure)[1]


@jit
def _columns_and_residuals(
    law_type: type[ForceLaw],
    values: ArrayLike,
    contraction: ArrayLike,
    pressure: ArrayLike,
    force: ArrayLike,
    weights: ArrayLike,
    constants: Mapping[str, Any],
) -> Array:
    """Weighted columns of the design matrix, then weighted residuals [N]: shape (parameters + 1, n)."""
    names = tuple(p.name for p in law_type.parameters())
    modelled, columns = _force_and_columns(
        lambda fields: law_type(**fields, **constants), names, values, contraction, pressure
    )
    return jnp.concatenate([columns, (jnp.asarray(force) - modelled)[None]]) * jnp.asarray(weights)


def _force_and_columns(
    law: Callable[[dict[str, Any]], ForceLaw],
    names: tuple[str, ...],
    values: ArrayLike,
    contraction: ArrayLike,
    pressure: ArrayLike,
) -> tuple[Array, Array]:
    def force(values: Array) -> Array:
        return law(dict(zip(names, values, strict=True))).force(jnp.asarray(contraction), jnp.asarray(pressure))

    def column(direction: Array) -> tuple[Array, Array]:
        return jax.jvp(force, (jnp.asarray(values),), (direction,))

    return jax.vmap(column, out_axes=(None, 0))(jnp.eye(len(names)))


@dataclass(frozen=True)
class UnitCube:
    """Shape parameters scaled to 0..1 between their bounds: logarithmically where both are positive."""

    parameters: tuple[Parameter, ...]

    @cached_property
    def bounds(self) -> Floats:
        """Lower and upper bounds [SI], shape (2, parameters)."""
        return np.array([[p.lower for p in self.parameters], [p.upper for p in self.parameters]], np.float64)

    def values(self, position: Floats) -> Floats:
        """Parameters [SI] at a position, shape (parameters,)."""
        lower, upper = self._scaled(self.bounds)
        scaled = lower + (upper - lower) * position
        return np.clip(np.where(self.bounds[0] > 0, np.exp(scaled), scaled), *self.bounds)

    def position(self, values: ArrayLike) -> Floats:
        """Position of parameters [SI]: the inverse of `values`."""
        lower, upper = self._scaled(self.bounds)
        return (self._scaled(np.asarray(values, np.float64)) - lower) / (upper - lower)

    def rates(self, position: Floats) -> Floats:
        """Derivative of each parameter with respect to its own coordinate."""
        lower, upper = self._scaled(self.bounds)
        return np.where(self.bounds[0] > 0, self.values(position), 1.0) * (upper - lower)

    def _scaled(self, values: Floats) -> Floats:
        """Logarithms of the parameters that are positive."""
        positive = self.bounds[0] > 0
        return np.where(positive, np.log(np.where(positive, values, 1.0)), values)

    def at_bound(self, position: Floats, *, distance: float = 1e-6) -> Bools:
        """Mask of the parameters within a `distance` from a bound of their range, shape (parameters,)."""
        return (position < distance) | (position > 1 - distance)

    def grid(self, *, most: int = 512, per_parameter: int = 32) -> Floats:
        """Positions that cover the cube, none on a face; shape (positions, parameters)."""
        count = len(self.parameters)
        per_axis = min(per_parameter, int(most ** (1 / count))) if count else 1
        axis = (np.arange(per_axis) + 0.5) / per_axis
        return np.array(list(itertools.product(axis, repeat=count)))


@dataclass(frozen=True, eq=False)
class FitProblem:
    """Least-squares problem of a law; subsets (`selected`) of one dataset share compiled code.

    Attributes
    ----------
    contraction, pressure, force
        Columns of the points [-], [Pa], [N], padded, shape (n,).
    selected, weights
        Mask of the points that count, and weights of their residuals, shape (n,).
    constants
        Fields of the law that are not estimated.
    prior
        Shape (rows, parameters): adds the residuals ``-prior @ values`` [N], each as uncertain as a point, which is a
        Gaussian prior about zero.
    """

    law_type: type[ForceLaw]
    contraction: Floats = field(repr=False)
    pressure: Floats = field(repr=False)
    force: Floats = field(repr=False)
    selected: Bools = field(repr=False)
    weights: Floats = field(repr=False)
    constants: Mapping[str, Any] = field(default_factory=dict)
    prior: Floats | None = field(default=None, repr=False)

    @classmethod
    def of(cls, law_type: type[ForceLaw], points: IsobaricDataset) -> FitProblem:
        """Problem of a dataset, padded with zero-weight points so that datasets of similar size share code."""
        count = len(points)
        quarter = max(128, (1 << (count - 1).bit_length()) // 4)
        pad = (0, -count % quarter)
        contraction, pressure, force = (
            np.pad(column, pad, mode="edge") for column in (points.contraction, points.pressure, points.force)
        )
        selected = np.arange(count + pad[1]) < count
        return cls(law_type, contraction, pressure, force, selected, np.ones(len(selected)))

    def weighted(self, weights: Floats) -> FitProblem:
        """Problem with weights of the points, shape (points,)."""
        return replace(self, weights=np.pad(weights, (0, len(self.weights) - len(weights)), constant_values=1.0))

    def subset(self, selected: Bools) -> FitProblem:
        """Problem of the selected points; shape (m,) with m <= n, in the order of the points."""
        return replace(self, selected=np.pad(selected, (0, len(self.selected) - len(selected))))

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Parameters, linear ones first."""
        return tuple(p.name for p in self.law_type.parameters())

    @cached_property
    def linear(self) -> int:
        """Number of linear parameters."""
        return len(self.law_type.linear_parameters)

    @cached_property
    def cube(self) -> UnitCube:
        """Range of the shape parameters."""
        return UnitCube(self.law_type.shape_parameters)

    def law(self, values: Floats) -> ForceLaw:
        """Law with the given parameters [SI], shape (parameters,), within the contractions of the points."""
        domain = Domain(float(self.contraction.min()), float(self.contraction.max()))
        fields = dict(zip(self.names, values.tolist(), strict=True), domain=domain, **self.constants)
        try:
            return self.law_type(**fields)
        except RangeError as error:
            text = f"the points do not determine {self.law_type.__name__}: {error}"
            raise IdentificationError(text, remedy="measure over more contractions, or fit a simpler law") from error

    def columns_and_residuals(self, values: Floats) -> Floats:
        """Design matrix transposed, above the residuals [N], weighted, 0 if not selected, shape (parameters + 1, n)."""
        stop_check.get()()
        points = self.contraction, self.pressure, self.force, self.selected * self.weights
        return np.asarray(_columns_and_residuals(self.law_type, values, *points, self.constants))

    def with_prior(self, rows: Floats, values: Floats) -> Floats:
        """Columns and residuals, shape (parameters + 1, n), followed by the rows of the prior."""
        if self.prior is None:
            return rows
        return np.concatenate([rows, np.vstack([self.prior.T, -self.prior @ values])], axis=1)

    def response(self, values: Floats) -> tuple[Floats, Floats]:
        """Residuals [N], shape (rows,), and Jacobian of the force, (rows, parameters), the prior last."""
        rows = self.with_prior(self.columns_and_residuals(values)[:, self.selected], values)
        return rows[-1], rows[:-1].T

    def at_bound(self, position: Floats) -> Bools:
        """Mask of parameters at a bound of their range, shape (parameters,); linear ones are unbounded."""
        return np.concatenate([np.zeros(self.linear, bool), self.cube.at_bound(position)])


@dataclass(frozen=True, eq=False)
class Solution:
    """Solution of a least-squares problem.

    Attributes
    ----------
    values
        Parameters [SI], linear ones first, shape (parameters,).
    position
        Position of the shape parameters in the unit cube.
    cost
        Sum of the squared residuals [N^2], with those of a prior.
    triangle
        R factor of the Jacobian, with the columns of the shape by position.
    converged
        False if the number of evaluations was exhausted.
    """

    problem: FitProblem = field(repr=False)
    values: Floats
    position: Floats
    cost: float
    triangle: Floats = field(repr=False)
    converged: bool

    @property
    def residuals(self) -> Floats:
        """Measured minus fitted force [N], shape (selected,)."""
        weights = self.problem.weights[self.problem.selected]
        return self.augmented[0][: len(weights)] / weights

    @property
    def jacobian(self) -> Floats:
        """Weighted derivative of the force with respect to all parameters, shape (selected, parameters)."""
        return self.augmented[1][: np.count_nonzero(self.problem.selected)]

    @property
    def effective_parameters(self) -> float:
        """Trace of the derivative of the fitted by the measured forces; the number of parameters without a prior."""
        if self.problem.prior is None:
            return float(len(self.values))
        q = np.linalg.qr(self.augmented[1])[0]
        return len(self.values) - float(np.sum(q[np.count_nonzero(self.problem.selected) :] ** 2))

    @property
    def aicc(self) -> float:
        """Corrected Akaike information criterion for normal errors of unknown variance; NaN with too few points.

        C. Hurvich and C.-L. Tsai, Biometrika 76 (1989) 297-307.
        """
        count, total = len(self.residuals), self.effective_parameters + 1  # and the residual variance
        freedom = count - total - 1
        if freedom <= 0:
            return math.nan
        squares = float(self.residuals @ self.residuals)
        return count * math.log(max(squares, 1e-300) / count) + 2 * total + 2 * total * (total + 1) / freedom

    @property
    def at_bound(self) -> Bools:
        """Parameters at a bound of their range, shape (parameters,)."""
        return self.problem.at_bound(self.position)

    @cached_property
    def augmented(self) -> tuple[Floats, Floats]:
        """Weighted residuals and Jacobian, with the rows of the prior."""
        return self.problem.response(self.values)


class Projection(NamedTuple):
    """Linear least-squares solution at a shape, and the projected problem: its residuals and their derivative."""

    position: Floats
    values: Floats
    cost: float
    triangle: Floats
    residuals: Floats
    derivative: Floats


def project(problem: FitProblem, position: Floats, guess: Floats | None = None) -> Projection:
    """Linear parameters at a position of the shape; the projected Jacobian is evaluated at their `guess`."""
    linear, shape = problem.linear, len(position)
    values = np.concatenate([np.zeros(linear) if guess is None else guess, problem.cube.values(position)])
    rows = problem.with_prior(problem.columns_and_residuals(values), values)
    if not np.isfinite(rows).all():
        zeros = np.zeros((linear + shape, linear + shape))
        return Projection(position, values, np.inf, zeros, np.full(shape + 1, np.inf), np.zeros((shape + 1, shape)))
    # R of [linear columns, shape columns, residuals]: the block below the linear columns is the projected problem.
    factor = tsqr_r(rows.T)
    factor[:, linear:-1] *= problem.cube.rates(position)
    lengths = np.linalg.norm(factor[:, :linear], axis=0)  # pressures are in Pa: columns differ by 1e5
    lengths[lengths == 0] = 1.0
    solved = np.linalg.lstsq(factor[:linear, :linear] / lengths, factor[:linear, -1], rcond=None)[0] / lengths
    values[:linear] += solved
    rest = factor[linear:, -1]
    return Projection(position, values, float(rest @ rest), factor[:-1, :-1], rest, factor[linear:, linear:-1])


def grid_search(problem: FitProblem) -> Floats:
    """Position of lowest cost on a grid over the range of the shape."""
    return min(problem.cube.grid(), key=lambda position: project(problem, position).cost)


_EQUAL = 1e-9  # relative difference of costs that is rounding


def solve(problem: FitProblem, start: Floats, *, face: float = 1e-4) -> Solution:
    """Least squares over the shape, from a start in the unit cube.

    The search starts off its faces and stays inside: this close to a face counts as on the face.

    The projected Jacobian is Kaufman's approximation (BIT 15, 1975, 49-57). A shape parameter that the points do not
    determine is at a bound of its range, the lower one where the cost is equal at both.
    """

    @remembered
    def projection(position: Floats) -> Projection:
        """Projection with derivatives at the linear parameters of the solution."""
        return project(problem, position, project(problem, position).values[: problem.linear])

    best, converged = projection(start), True
    if len(start) and np.isfinite(best.cost):
        search = least_squares(
            lambda position: projection(position).residuals,
            np.clip(start, 1e-9, 1 - 1e-9),
            lambda position: -projection(position).derivative,
            (np.zeros(len(start)), np.ones(len(start))),
        )
        faces = np.where(search.values < face, 0.0, np.where(search.values > 1 - face, 1.0, search.values))
        inside, on_face = projection(search.values), projection(faces)
        best = on_face if on_face.cost * (1 - _EQUAL) <= inside.cost else inside
        best = _undetermined_at_bound(problem, best)
        converged = search.converged
    return Solution(problem, best.values, best.position, best.cost, best.triangle, converged and np.isfinite(best.cost))


def _undetermined_at_bound(problem: FitProblem, best: Projection) -> Projection:
    """Projection of equal cost with an undetermined shape parameter at its bound, if there is one."""
    for i, end in itertools.product(range(len(best.position)), (0.0, 1.0)):
        if condition_number(best.triangle) < CONDITION_LIMIT:
            return best
        position = best.position.copy()
        position[i] = end
        at_bound = project(problem, position, project(problem, position).values[: problem.linear])
        free = ~problem.at_bound(position)
        if at_bound.cost * (1 - _EQUAL) <= best.cost and condition_number(at_bound.triangle[:, free]) < CONDITION_LIMIT:
            return at_bound
    return best
