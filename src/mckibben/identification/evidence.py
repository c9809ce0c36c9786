"""What a fit rests on: the points, their residuals and how the force depends on the parameters there."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mckibben.dataset import IsobaricDataset
from mckibben.errors import IdentificationError
from mckibben.identification.blocks import LeftOut, leave_out
from mckibben.identification.groups import Grouping, finest_recorded, group_labels
from mckibben.identification.problem import FitProblem, Solution
from mckibben.identification.robust import ClusterRobust, ErrorModel, Independent

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
class Evidence:
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
    held: NDArray[np.bool_] = field(repr=False)

    @property
    def free(self) -> NDArray[np.int64]:
        """The parameters that the data chose, by number."""
        return np.flatnonzero(~self.held)

    @cached_property
    def rule(self) -> tuple[Grouping, str]:
        """How the errors are grouped unless said, and where they are not, why.

        By stroke where directions, phases or repeats are known, else by pressure; the points count as independent if
        there are fewer than five groups, if most groups are a single point, if one group alone determines a parameter,
        or if all parameters are at a bound, so that there are no errors to group.
        The rule looks at where was measured, never at what was measured: a choice made by the residuals would spoil the
        intervals that it leads to.
        """
        if self.held.all():
            return Grouping.POINT, "all parameters are at a bound, so that none has an error"
        by = finest_recorded(self.points)
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

    def left_out(self, kind: str, blocks: ArrayLike) -> LeftOut:
        """The errors at whole blocks of points left out; worked out once for each kind of block.

        Parameters
        ----------
        kind
            Such as "pressure".
        blocks
            As for `leave_out`; the same for the same kind.

        Raises
        ------
        UndeterminedError
            As `leave_out`.
        """
        if kind not in self._left_out:
            self._left_out[kind] = leave_out(self.problem, self.solution, blocks)
        return self._left_out[kind]

    @cached_property
    def doubts(self) -> tuple[str, ...]:
        """Sentences: why the errors by the rule are not to be relied on; none where all is well.

        A law of the wrong kind leaves residuals that are of one shape in every group. What is the same in all groups
        does not scatter from group to group, and the errors by group hardly see it. It shows in the uncertainty of the
        force at the points, all together: of single parameters one or another is often that small by chance.
        """
        by = self.rule[0]
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
        by = self.rule[0] if by is None else by
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
    def _left_out(self) -> dict[str, LeftOut]:
        return {}

    @cached_property
    def _independent(self) -> Independent:
        return Independent.of(self.solution.jacobian[:, self.free], self.solution.residuals)

    def _robust(self, by: Grouping) -> ClusterRobust:
        if by not in self._models:
            jacobian, residuals = self.solution.jacobian[:, self.free], self.solution.residuals
            self._models[by] = ClusterRobust.of(jacobian, residuals, self._labels(by))
        return self._models[by]

    def _labels(self, by: Grouping) -> NDArray[np.int64]:
        if by not in self._numbered:
            self._numbered[by] = group_labels(self.points, by)
        return self._numbered[by]

    @cached_property
    def _numbered(self) -> dict[Grouping, NDArray[np.int64]]:
        return {}

    @cached_property
    def _models(self) -> dict[Grouping, ClusterRobust]:
        return {}
