"""Least-squares problems: design matrix, points, and ranges of the shape parameters."""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array
from numpy.typing import ArrayLike, NDArray

from mckibben.dataset import IsobaricDataset
from mckibben.muscle import ForceLaw, Parameter


def design_matrix(
    law: ForceLaw, names: Sequence[str], contraction: ArrayLike, pressure: ArrayLike
) -> NDArray[np.float64]:
    """The derivative of the force with respect to named parameters.

    Parameters
    ----------
    law
        A law with values for all parameters; the linear ones may have any.
    names
        Parameters of the law, in the order of the columns.
    contraction, pressure
        Shape (n,): [-], [Pa].

    Returns
    -------
    ndarray
        Shape (n, len(names)): [N] per SI unit of the parameter.

    Examples
    --------
    Eq. 2 at 10 % and 2 bar, with a decay of 0.1 per percent: 1, p, eps, exp(-mu eps).

    >>> from mckibben.muscle import ExponentialLaw
    >>> law = ExponentialLaw(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, decay=10.0)
    >>> design_matrix(law, ["a1", "a2", "b1", "c1"], [0.1], [2e5]).round(4)
    array([[1.000e+00, 2.000e+05, 1.000e-01, 3.679e-01]])
    """
    contraction = np.asarray(contraction, np.float64)
    pressure = np.asarray(pressure, np.float64)
    if not names:
        return np.empty((len(contraction), 0))
    values = np.array([float(getattr(law, name)) for name in names])
    return np.asarray(_columns_of(law, values, contraction, pressure, names=tuple(names))).T


@partial(jax.jit, static_argnames="names")
def _columns_of(law: ForceLaw, values: Array, contraction: Array, pressure: Array, *, names: tuple[str, ...]) -> Array:
    return _force_and_columns(lambda given: dataclasses.replace(law, **given), names, values, contraction, pressure)[1]


@partial(jax.jit, static_argnames="law_type")
def design_and_residuals(
    law_type: type[ForceLaw],
    values: ArrayLike,
    contraction: ArrayLike,
    pressure: ArrayLike,
    force: ArrayLike,
    weights: ArrayLike,
) -> Array:
    """The columns of the design matrix of all parameters, and under them measured minus given force [N], all weighted.

    Parameters
    ----------
    law_type, values
        A kind of law and its parameters in SI, shape (parameters,), linear ones first.
    contraction, pressure, force, weights
        Shape (n,): [-], [Pa], [N], [-].

    Returns
    -------
    array
        Shape (parameters + 1, n).
    """
    names = tuple(p.name for p in law_type.parameters())
    modelled, columns = _force_and_columns(lambda given: law_type(**given), names, values, contraction, pressure)
    return jnp.concatenate([columns, (jnp.asarray(force) - modelled)[None]]) * jnp.asarray(weights)


def _force_and_columns(
    law: Callable[[dict[str, Any]], ForceLaw], names: tuple[str, ...], values: Any, contraction: Any, pressure: Any
) -> tuple[Array, Array]:
    def force(values: Array) -> Array:
        return law(dict(zip(names, values, strict=True))).force(contraction, pressure)

    def column(direction: Array) -> tuple[Array, Array]:
        return jax.jvp(force, (values,), (direction,))

    return jax.vmap(column, out_axes=(None, 0))(jnp.eye(len(names)))


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
