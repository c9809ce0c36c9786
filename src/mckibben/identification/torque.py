"""Identification of the law of two equal muscles from the torque of their joint, with friction of muscles and joint."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from mckibben.component.calls import checked_call
from mckibben.dataset.at_joint import JointPaths
from mckibben.dataset.preprocessing import one_way_parts
from mckibben.dataset.table import Table
from mckibben.errors import IdentificationError
from mckibben.identification.estimator import (
    CONDITION_LIMIT,
    Bools,
    Floats,
    Ints,
    condition_number,
    robust_errors,
    t_quantile,
    unidentifiable,
)
from mckibben.identification.fit import parameter_listing
from mckibben.identification.fitting import check_law_type
from mckibben.identification.least_squares import FitProblem, design_matrix, grid_search, solve
from mckibben.muscle import Domain, ForceLaw, SmoothLaw, forces
from mckibben.muscle.slopes import unphysical
from mckibben.result import Listing, Remark, Result, column, table
from mckibben.units import kPa

FRICTION = {"half_width": "N", "joint_friction": "N*m"}
"""Friction of each muscle, and of the joint."""
_ROUNDS = 10  # until the same muscles are slack
_STEP = 10 * kPa  # of the pressure between two paths


class TorqueFit(Result):
    """Law of both muscles of a joint, by `identify_torque`.

    Attributes
    ----------
    law
        Law of each muscle; its domain is the range of the contractions and pressures of both.
    estimates, standard_errors
        By parameter, in SI: those of the law, then ``half_width`` [N] of the friction of each muscle and
        ``joint_friction`` [N*m], if the angle reverses; errors are robust to those common to a stroke. If the sum of
        the moment arms is constant, all friction counts as that of the joint.
    intervals
        95 % intervals by parameter.
    rmse
        Root mean square residual of the torque [N*m].
    force_error
        Standard error of the force amid the contractions and pressures [N]: a force that both muscles have alike hardly
        shows in the torque, unless one is vented.
    """

    law: ForceLaw
    estimates: dict[str, float]
    standard_errors: dict[str, float]
    intervals: dict[str, tuple[float, float]]
    rmse: float = column("N*m", "RMS residual of the torque", digits=3)
    force_error: float = column("N", "standard error of the force of a muscle", digits=2)
    points: int = column("", "points used")
    initial_length: float = column("m", "initial length", "mm")
    notes: tuple[Remark, ...] = ()

    def verdict(self) -> str:
        """Return the error of the torque, and the friction."""
        friction = [
            f"{name.replace('_', ' ')} {self.estimates[name]:.3g} +- {self.standard_errors[name]:.2g} {unit}"
            for name, unit in FRICTION.items()
            if name in self.estimates
        ]
        text = f"{type(self.law).__name__} of both muscles describes {self.points} torques to {self.rmse:.3g} N*m"
        return "; ".join([text, *friction])

    def remarks(self) -> Iterable[Remark]:
        """Return the notes."""
        return self.notes

    @table()
    def parameters(self) -> list[Listing]:
        """Return the parameters with their errors and intervals."""
        shown = {p.name: (p.shown, p.unit, p.meaning) for p in type(self.law).parameters()}
        shown |= {name: (unit, unit, "friction") for name, unit in FRICTION.items() if name in self.estimates}
        return [parameter_listing(shown, self.estimates, self.standard_errors, self.intervals)]


@dataclass(frozen=True, eq=False)
class TorqueProblem(FitProblem):
    r"""Least squares of torques: the points are those of muscle 1, then of muscle 2.

    .. math:: \tau = d_2 F(\varepsilon_2, p_2) - d_1 F(\varepsilon_1, p_1) - s (h (d_1 + d_2) + \tau_j)

    with moment arms d, the direction s of the motion, and the friction h of each muscle and of the joint; a slack
    muscle has neither. The parameters of friction are the last linear ones.
    """

    arms: Floats = field(default_factory=lambda: np.empty((2, 0)), repr=False)
    torque: Floats = field(default_factory=lambda: np.empty(0), repr=False)
    friction: Floats = field(default_factory=lambda: np.empty((0, 0)), repr=False)
    friction_names: tuple[str, ...] = ()
    taut: Bools = field(default_factory=lambda: np.empty(0, bool), repr=False)

    @classmethod
    def at(
        cls,
        law_type: type[ForceLaw],
        contraction: Floats,
        pressure: Floats,
        arms: Floats,
        torque: Floats,
        side: Floats,
        taut: Bools,
    ) -> TorqueProblem:
        """Problem of both muscles, shape (2, n), and the torque and its direction, shape (n,).

        Raises an `IdentificationError` if there are fewer torques than parameters.
        """
        names, columns = tuple(FRICTION), np.array([-side * np.sum(arms * taut, axis=0), -side])
        if not (np.any(side > 0) and np.any(side < 0)):
            names, columns = (), columns[:0]
        elif not condition_number(columns.T) < CONDITION_LIMIT:
            names, columns = names[1:], columns[1:]
        count, size = len(names) + len(law_type.parameters()), contraction.size
        if len(torque) <= count:
            text = f"{len(torque)} torques cannot determine {count} parameters"
            raise IdentificationError(text, remedy="measure more points")
        places = contraction.ravel(), pressure.ravel(), np.zeros(size), np.ones(size, bool), np.ones(size)
        friction = {"friction": columns, "friction_names": names}
        return cls(law_type, *places, arms=arms, torque=torque, **friction, taut=taut.ravel())

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Linear parameters of the law, those of friction, and the shape of the law."""
        of_law = [p.name for p in self.law_type.parameters()]
        linear = len(self.law_type.linear_parameters)
        return (*of_law[:linear], *self.friction_names, *of_law[linear:])

    @cached_property
    def linear(self) -> int:
        """Number of linear parameters."""
        return len(self.law_type.linear_parameters) + len(self.friction_names)

    def law(self, values: Floats) -> ForceLaw:
        """Law of each muscle."""
        points = self.contraction, self.pressure, self.force, self.selected, self.weights
        return FitProblem(self.law_type, *points).law(values[self.of_law])

    @property
    def of_law(self) -> Bools:
        """Mask of the parameters of the law."""
        return np.array([name not in FRICTION for name in self.names])

    def columns_and_residuals(self, values: Floats) -> Floats:
        """Design matrix of the torque transposed, above the residuals [N*m], shape (parameters + 1, n)."""
        rows = super().columns_and_residuals(values[self.of_law])
        first, second = np.split(rows * self.taut, 2, axis=1)  # the residual is minus the force
        columns = self.arms[1] * second - self.arms[0] * first
        linear = len(self.law_type.linear_parameters)
        torque = -columns[-1] + values[linear : self.linear] @ self.friction
        return np.concatenate([columns[:linear], self.friction, columns[linear:-1], [self.torque - torque]])

    def response(self, values: Floats) -> tuple[Floats, Floats]:
        """Residuals [N*m], shape (n,), and Jacobian of the torque."""
        rows = self.columns_and_residuals(values)
        return rows[-1], rows[:-1].T


@checked_call
def identify_torque(
    law_type: type[ForceLaw], table: Table, geometry: JointPaths, *, initial_length: float
) -> TorqueFit:
    """Identify the law of two equal muscles from torques of their joint at known angles and pressures.

    Parameters
    ----------
    table
        Columns ``angle``, ``torque``, ``pressure1`` and ``pressure2``, by `read_torques`, in the order of the test.
    initial_length
        Length of each muscle at contraction 0 [m].

    Raises
    ------
    IdentificationError
        If the points do not determine the parameters; the error names them.
    """
    check_law_type(law_type)
    if law_type is SmoothLaw:
        raise IdentificationError("torques do not determine SmoothLaw", remedy="take a law of few parameters")
    angle, torque, *pressures = (table.columns[name].values for name in ("angle", "torque", "pressure1", "pressure2"))
    lengths, arms = (np.array([np.asarray(side) for side in pair]) for pair in geometry.paths_and_arms(angle))
    contraction, pressure = 1 - lengths / initial_length, np.array(pressures)
    side, strokes = _motion(angle, pressure)
    taut = (pressure > 0) | (contraction < 0)
    rounds = 0
    while True:  # which muscle is slack follows from the law
        problem = TorqueProblem.at(law_type, contraction, pressure, arms, torque, side, taut)
        solution = solve(problem, grid_search(problem))
        before, taut, rounds = taut, forces(problem.law(solution.values), contraction, pressure) > 0, rounds + 1
        if np.array_equal(before, taut) or rounds == _ROUNDS:
            break
    values, inside = solution.values, ~solution.at_bound
    residuals, jacobian = problem.response(values)
    if not condition_number(jacobian[:, inside]) < CONDITION_LIMIT:
        named = np.array(problem.names)[inside].tolist()
        raise IdentificationError(
            f"the torques do not determine {', '.join(unidentifiable(jacobian[:, inside], named))}",
            remedy="measure at more angles, and also with one muscle vented: a force of both alike gives no torque",
        )
    model = robust_errors(jacobian[:, inside], residuals, strokes)
    variance, freedom = model.variance(np.eye(inside.sum()))
    errors, half = np.full(len(inside), np.nan), np.full(len(inside), np.nan)
    errors[inside] = np.sqrt(variance)
    half[inside] = t_quantile(0.95, freedom) * errors[inside]
    ends = [float(bound(quantity)) for quantity in (contraction, pressure) for bound in (np.min, np.max)]
    law = replace(problem.law(values), domain=Domain(*ends))
    amid = np.zeros((1, len(inside)))
    middle = [np.atleast_1d(np.mean(quantity)) for quantity in (contraction, pressure)]
    amid[:, problem.of_law] = design_matrix(law, [name for name in problem.names if name not in FRICTION], *middle)
    intervals = np.transpose([values - half, values + half])
    return TorqueFit(
        law=law,
        estimates=dict(zip(problem.names, values.tolist(), strict=True)),
        standard_errors=dict(zip(problem.names, errors.tolist(), strict=True)),
        intervals={name: (float(low), float(high)) for name, (low, high) in zip(problem.names, intervals, strict=True)},
        rmse=float(np.sqrt(np.mean(residuals**2))),
        force_error=float(np.sqrt(model.variance(amid[:, inside])[0][0])),
        points=len(torque),
        initial_length=initial_length,
        notes=tuple(_notes(law, problem, intervals)),
    )


def _notes(law: ForceLaw, problem: TorqueProblem, intervals: Floats) -> Iterator[Remark]:
    """Remarks on friction that is not identified or not told apart, and on a law that no muscle has."""
    names = problem.friction_names
    unclear = [name.replace("_", " ") for name in names if np.prod(intervals[problem.names.index(name)]) <= 0]
    if not names:
        yield Remark.note("joint_friction", "the angle does not reverse: friction is not identified")
    elif len(names) < len(FRICTION):
        text = "the friction of muscles and joint is not told apart: the sum of the moment arms is constant"
        remedy = "all of it is given as that of the joint; measure also with one muscle vented"
        yield Remark.warning("joint_friction", text, remedy)
    elif unclear:
        text = f"{' and '.join(unclear)} may be 0: the data hardly tell friction of the muscles from that of the joint"
        yield Remark.warning("joint_friction", text, "measure at more angles")
    if wrong := unphysical(law):
        remedy = "look for wrong signs, units and pressures of the wrong muscle"
        yield Remark.severe("law", f"the law is not that of a muscle: {wrong}", remedy)


def _motion(angle: Floats, pressure: Floats) -> tuple[Floats, Ints]:
    """Direction of the motion, 1 where the angle rises, and number of the stroke of each point, at equal pressures."""
    side, strokes, count = np.zeros(len(angle)), np.zeros(len(angle), np.int64), 0
    changes = np.flatnonzero(np.any(np.abs(np.diff(pressure)) > _STEP, axis=0)) + 1
    for rows in np.split(np.arange(len(angle)), changes):
        for part, word in one_way_parts(angle[rows]):
            side[rows[part]], strokes[rows[part]] = (1.0 if word == "unloading" else -1.0), count
            count += 1
        count += 1
    return side, np.unique(strokes, return_inverse=True)[1]
