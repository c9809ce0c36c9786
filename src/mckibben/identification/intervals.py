"""Confidence and prediction intervals of quantities that depend on the parameters."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Array
from numpy.typing import ArrayLike, NDArray

from mckibben.dataset import IsobaricDataset
from mckibben.errors import IdentificationError, RangeError
from mckibben.identification.cross_validation import CrossValidation, cross_validate
from mckibben.identification.problem import FitProblem, Solution, design_matrix
from mckibben.identification.uncertainty import (
    ClusterRobustErrors,
    ErrorModel,
    Grouping,
    IndependentErrors,
    finest_grouping,
    group_labels,
)
from mckibben.muscle import ForceLaw, forces

_LOOKED_AT = 300  # points, evenly among all: enough to tell how sure the force is
FEWEST_GROUPS = 5
"""With fewer, what their points have in common cannot be told from what the groups scatter."""
_FAR_SMALLER = 0.5  # with the right law, 12 of 1000 data sets of 5 groups are below; with 10 none of 3000


@dataclass(frozen=True)
class RobustErrors:
    """Standard errors that allow the points of a group to share an error.

    Attributes
    ----------
    by
        What the groups are.
    groups
        How many.
    standard_errors
        By parameter, in SI; NaN where the parameter is at a bound.
    degrees_of_freedom
        Of the t interval, by parameter.
    """

    by: Grouping
    groups: int
    standard_errors: Mapping[str, float] = field(repr=False)
    degrees_of_freedom: Mapping[str, float] = field(repr=False)


@dataclass(frozen=True, eq=False)
class Regression:
    """The points behind a fit and its solution there.

    Attributes
    ----------
    points
        The taut plateau means.
    problem, solution
        What was asked of the solver, and its answer.
    held
        Shape (parameters,): those at a bound, whose value the data did not choose.
    """

    points: IsobaricDataset = field(repr=False)
    problem: FitProblem = field(repr=False)
    solution: Solution = field(repr=False)
    at_bound: NDArray[np.bool_] = field(repr=False)

    @property
    def free(self) -> NDArray[np.int64]:
        """The parameters that the data chose, by number."""
        return np.flatnonzero(~self.at_bound)

    @cached_property
    def default_grouping(self) -> tuple[Grouping, str]:
        """How the errors are grouped unless said, and where they are not, why.

        By stroke where directions, phases or repeats are known, else by pressure; the points count as independent if
        there are fewer than five groups, if most groups are a single point, if one group alone determines a parameter,
        or if all parameters are at a bound, so that there are no errors to group.
        The rule looks at where was measured, never at what was measured: a choice made by the residuals would spoil the
        intervals that it leads to.
        """
        if self.at_bound.all():
            return Grouping.POINT, "all parameters are at a bound, so that none has an error"
        by = finest_grouping(self.points)
        labels = self._labels(by)
        count = int(labels.max()) + 1
        if count < FEWEST_GROUPS:
            return Grouping.POINT, f"{by.counted(count)} are too few to tell what their points have in common"
        if 2 * count > len(labels):
            return Grouping.POINT, (
                f"the {len(labels)} points are at {by.counted(count)}, hardly two at each; "
                "record the set pressure of each point where the measured one differs"
            )
        if self._robust(by).alone:
            return Grouping.POINT, f"one {by.value} alone determines a parameter"
        return by, ""

    def cross_validated(self, kind: str, blocks: ArrayLike) -> CrossValidation:
        """The errors at whole blocks of points left out; worked out once for each kind of block.

        Parameters
        ----------
        kind
            Such as "pressure".
        blocks
            As for `cross_validate`; the same for the same kind.

        Raises
        ------
        UndeterminedError
            As `cross_validate`.
        """
        if kind not in self._left_out:
            self._left_out[kind] = cross_validate(self.problem, self.solution, blocks)
        return self._left_out[kind]

    @cached_property
    def warnings(self) -> tuple[str, ...]:
        """Sentences: why the errors by the rule are not to be relied on; none where all is well.

        A law of the wrong kind leaves residuals that are of one shape in every group. What is the same in all groups
        does not scatter from group to group, and the errors by group hardly see it. It shows in the uncertainty of the
        force at the points, all together: of single parameters one or another is often that small by chance.
        """
        by = self.default_grouping[0]
        if by is Grouping.POINT:
            return ()
        every = -(-len(self.solution.jacobian) // _LOOKED_AT)
        gradients = self.solution.jacobian[::every, self.free]
        grouped, independent = (
            float(np.sum(model.variance(gradients)[0])) for model in (self._robust(by), self._independent)
        )
        if not grouped < _FAR_SMALLER**2 * independent:
            return ()
        return (
            f"by {by.value}, the force is {np.sqrt(grouped / independent):.2g} times as uncertain as for independent "
            f"points: the residuals are alike from {by.value} to {by.value}, so the law is likely of the wrong kind, "
            "and the intervals do not say how far the force of the muscle is from it",
        )

    def error_model(self, by: Grouping | None = None) -> ErrorModel:
        """How the free parameters scatter, for errors grouped in a way; by the rule unless said.

        Raises
        ------
        IdentificationError
            If the groups are not recorded, are fewer than two, or one alone determines a parameter.
        """
        by = self.default_grouping[0] if by is None else by
        if by is Grouping.POINT:
            return self._independent
        model = self._robust(by)
        if len(model.scores) < 2 or model.alone:
            why = "one of them alone determines a parameter" if model.alone else "they are less than two"
            raise IdentificationError(
                f"no errors can be given for {by.counted(len(model.scores))}: {why}",
                value=len(model.scores),
                lower=2,
                remedy="group the points otherwise, or measure at more pressures",
            )
        return model

    def robust_errors(self, by: Grouping) -> RobustErrors:
        """Errors of the parameters for errors grouped in a way.

        Raises
        ------
        IdentificationError
            As `error_model`.
        """
        model, names = self.error_model(by), self.problem.names
        errors, freedom = np.full((2, len(names)), np.nan)
        variance, freedom[self.free] = model.variance(np.eye(len(self.free)))
        errors[self.free] = np.sqrt(variance)
        return RobustErrors(
            by,
            int(self._labels(by).max()) + 1,
            dict(zip(names, errors.tolist(), strict=True)),
            dict(zip(names, freedom.tolist(), strict=True)),
        )

    @cached_property
    def _left_out(self) -> dict[str, CrossValidation]:
        return {}

    @cached_property
    def _independent(self) -> IndependentErrors:
        return IndependentErrors.of(self.solution.jacobian[:, self.free], self.solution.residuals)

    def _robust(self, by: Grouping) -> ClusterRobustErrors:
        if by not in self._models:
            jacobian, residuals = self.solution.jacobian[:, self.free], self.solution.residuals
            self._models[by] = ClusterRobustErrors.of(jacobian, residuals, self._labels(by))
        return self._models[by]

    def _labels(self, by: Grouping) -> NDArray[np.int64]:
        if by not in self._numbered:
            self._numbered[by] = group_labels(self.points, by)
        return self._numbered[by]

    @cached_property
    def _numbered(self) -> dict[Grouping, NDArray[np.int64]]:
        return {}

    @cached_property
    def _models(self) -> dict[Grouping, ClusterRobustErrors]:
        return {}


def law_forces(
    law_type: type[ForceLaw], draws: ArrayLike, contraction: ArrayLike, pressure: ArrayLike
) -> NDArray[np.float64]:
    """The force of each of many laws.

    Parameters
    ----------
    law_type, draws
        A kind of law and parameters in SI, shape (draws, parameters), in its order.
    contraction, pressure
        Where [-], [Pa]; they broadcast.

    Returns
    -------
    ndarray
        Shape (draws, ...) [N].

    Examples
    --------
    >>> from mckibben.muscle import ExponentialLaw
    >>> rows = [[1.0, 0, 0, 0, 0, 0, 30.0], [0, 1e-3, 0, 0, 0, 0, 30.0]]
    >>> law_forces(ExponentialLaw, rows, [0.0, 0.1], 2e5)
    array([[  1.,   1.],
           [200., 200.]])
    """
    contraction, pressure = np.broadcast_arrays(np.asarray(contraction, float), np.asarray(pressure, float))
    return np.asarray(_forces(law_type, np.asarray(draws, np.float64), contraction, pressure))


@partial(jax.jit, static_argnames="law_type")
def _forces(law_type: type[ForceLaw], draws: Array, contraction: Array, pressure: Array) -> Array:
    names = [p.name for p in law_type.parameters()]

    def force(values: Array) -> Array:
        return law_type(**dict(zip(names, values, strict=True))).force(contraction, pressure)

    return jax.vmap(force)(draws)


class Interval(NamedTuple):
    """From lowest to highest, in SI; NaN where none is known."""

    lower: float
    upper: float


@dataclass(frozen=True, eq=False)
class IntervalEstimate:
    """A quantity and how sure it is, pointwise.

    Attributes
    ----------
    level
        The share of data sets for which the interval at a point holds the truth.
    value
        The estimate; its shape is that of all else, its unit too.
    standard_error
        Of the estimate.
    degrees_of_freedom
        Of the t interval.
    lower, upper
        Its ends.
    """

    level: float
    value: NDArray[np.float64]
    standard_error: NDArray[np.float64]
    degrees_of_freedom: NDArray[np.float64]
    lower: NDArray[np.float64]
    upper: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class ForceIntervals:
    """The force [N] of a fitted law, and that of a further measurement.

    Attributes
    ----------
    mean
        Where the law would lie if it were fitted to ever more such points. That is where the force of the muscle lies
        if the law is of the right kind; by how much a wrong one misses it is not in here, see
        `mckibben.identification.intervals.Regression.warnings` and the residuals.
    measurement
        Where one more plateau mean of the same muscle on the same rig would lie: wider by the residuals' spread.
    """

    confidence: IntervalEstimate
    prediction: IntervalEstimate


def check_level(level: float) -> float:
    """The level if it is one.

    Raises
    ------
    RangeError
        If it is not between 0 and 1.
    """
    if not 0 < level < 1:
        remedy = "write 0.95 for 95 %" if level >= 1 else ""
        raise RangeError(f"a level of {level:g} is no probability", value=level, lower=0.0, upper=1.0, remedy=remedy)
    return level


def t_quantile(level: float, freedom: ArrayLike) -> NDArray[np.float64]:
    """How many standard errors a two-sided t interval reaches to each side.

    >>> t_quantile(0.95, [4.0, 1e9]).round(3)
    array([2.776, 1.96 ])
    """
    from scipy.special import stdtrit

    return np.asarray(stdtrit(np.minimum(freedom, 1e12), (1 + check_level(level)) / 2))


def t_interval(
    level: float,
    value: ArrayLike,
    variances: Sequence[tuple[NDArray[np.float64], NDArray[np.float64]]],
) -> IntervalEstimate:
    """A band from independent contributions to its variance, each with its degrees of freedom.

    Their sum has the degrees of freedom of Satterthwaite, (sum V)^2 / sum(V^2/nu).
    """
    value = np.asarray(value, np.float64)
    total = np.sum([variance for variance, _ in variances], axis=0).reshape(value.shape)
    parts = np.sum([variance**2 / freedom for variance, freedom in variances], axis=0).reshape(value.shape)
    with np.errstate(divide="ignore", invalid="ignore"):
        freedom = np.where(parts > 0, total**2 / parts, np.inf)
    error = np.sqrt(total)
    reach = t_quantile(level, freedom) * error
    return IntervalEstimate(level, value, error, freedom, value - reach, value + reach)


def force_gradients(law: ForceLaw, free: Sequence[str], contraction: ArrayLike, pressure: ArrayLike) -> NDArray:
    """The derivative of the force with respect to the named parameters, shape (points, parameters).

    Points are padded to a power of two, so that bands of different sizes share what is compiled.
    """
    contraction, pressure = np.broadcast_arrays(np.asarray(contraction, float), np.asarray(pressure, float))
    count = contraction.size
    if not count:
        return np.empty((0, len(free)))
    pad = (0, max(128, 1 << (count - 1).bit_length()) - count)
    padded = (np.pad(column.ravel(), pad, mode="edge") for column in (contraction, pressure))
    return design_matrix(law, free, *padded)[:count]


def force_intervals(
    law: ForceLaw,
    regression: Regression,
    contraction: ArrayLike,
    pressure: ArrayLike,
    *,
    level: float = 0.95,
    by: Grouping | None = None,
) -> ForceIntervals:
    """The force of a fitted law with its uncertainty.

    Parameters
    ----------
    law
        As fitted.
    evidence
        What it was fitted to.
    contraction, pressure
        Where [-], [Pa]; they broadcast.
    level
        Of the intervals, pointwise.
    by
        How errors are grouped; by the rule of the fit unless said.
    """
    check_level(level)
    contraction, pressure = np.asarray(contraction, float), np.asarray(pressure, float)
    value = forces(law, contraction, pressure)
    free = [regression.problem.names[i] for i in regression.free]
    gradients = force_gradients(law, free, contraction, pressure)
    model = regression.error_model(by)
    variance, freedom = model.variance(gradients)
    square, left = model.scatter
    scatter = np.full_like(variance, square), np.full_like(freedom, left)
    mean = t_interval(level, value, [(variance, freedom)])
    return ForceIntervals(mean, t_interval(level, value, [(variance, freedom), scatter]))


def parameter_interval(estimate: float, error: float, freedom: float, level: float) -> Interval:
    """The t interval of one parameter."""
    if math.isnan(error):
        return Interval(math.nan, math.nan)
    reach = float(t_quantile(level, freedom)) * error
    return Interval(estimate - reach, estimate + reach)


def variance_of(model: ErrorModel, gradients: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Variance and degrees of freedom for gradients of shape (..., parameters), in the shape (...)."""
    variance, freedom = model.variance(gradients.reshape(-1, gradients.shape[-1]))
    return variance.reshape(gradients.shape[:-1]), freedom.reshape(gradients.shape[:-1])
