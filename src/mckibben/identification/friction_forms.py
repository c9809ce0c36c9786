"""Forms of friction fitted along loading paths: comparison by held-out loops, lack of fit, and tests of the drift."""

from __future__ import annotations

import dataclasses
import enum
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from mckibben.errors import IdentificationError
from mckibben.identification.estimator import (
    CONDITION_LIMIT,
    Bools,
    ClusterRobustErrors,
    Floats,
    IndependentErrors,
    Ints,
    condition_number,
    standard_errors,
    unidentifiable,
)
from mckibben.identification.loading_path import FRICTION, DriftBasis, PathDependentModel
from mckibben.muscle.friction import MIN_HALF_WIDTH


class FrictionForm(enum.Enum):
    """Form of the friction between loading and unloading; docs/hysteresis.md lists them and the data that they need."""

    COULOMB = "coulomb"
    CONSTANT = "constant"
    PRESSURE = "pressure"
    TENSION = "tension"
    VISCOUS = "viscous"
    DRY_AND_VISCOUS = "dry-and-viscous"
    VARIABLE_VISCOUS = "variable-viscous"
    RATE = "rate"

    @property
    def free(self) -> tuple[str, ...]:
        """Parameters of the friction that the form estimates."""
        return _FREE[self]

    @property
    def follows_rate(self) -> bool:
        """Whether the friction depends on the rate of the length."""
        return not _OF_RATE.isdisjoint(self.free)


_OF_RATE = frozenset({"viscous", "rate_growth"})  # parameters, of which a friction that follows the rate has one
_FREE = {
    FrictionForm.COULOMB: ("half_width",),
    FrictionForm.CONSTANT: ("half_width", "log_presliding"),
    FrictionForm.PRESSURE: ("half_width", "growth", "log_presliding"),
    FrictionForm.TENSION: ("half_width", "tension_growth", "log_presliding"),
    FrictionForm.VISCOUS: ("viscous",),
    FrictionForm.DRY_AND_VISCOUS: ("half_width", "viscous", "log_presliding"),
    FrictionForm.VARIABLE_VISCOUS: (
        *("half_width", "growth", "viscous", "viscous_growth", "viscous_length_growth", "log_presliding"),
    ),
    FrictionForm.RATE: ("half_width", "growth", "rate_growth", "log_rate_speed", "log_presliding"),
}


@dataclass(frozen=True, eq=False)
class PathSolution:
    """Least-squares solution; errors and correlations of the free parameters and the drift amplitudes."""

    values: dict[str, float]
    free: tuple[str, ...]
    offsets: Floats
    residuals: Floats
    jacobian: Floats
    active: Bools
    converged: bool
    errors: Floats = dataclasses.field(default_factory=lambda: np.empty(0))
    correlations: Floats = dataclasses.field(default_factory=lambda: np.empty(0))

    @property
    def cost(self) -> float:
        """Sum of squared residuals [N^2]."""
        return float(self.residuals @ self.residuals)

    @property
    def at_bound(self) -> list[str]:
        """Free parameters at a bound."""
        return [n for n, out in zip(self.free, self.active, strict=False) if out and n != "log_presliding"]

    def error(self, name: str) -> float:
        """Standard error of a parameter; NaN if it was not free."""
        return float(self.errors[self.free.index(name)]) if name in self.free else float("nan")


def least_squares(
    model: PathDependentModel, start: Mapping[str, float], free: tuple[str, ...], *, max_nfev: int = 200
) -> PathSolution:
    """Bounded least squares from a start; the drift amplitudes are always free."""
    from scipy.optimize import least_squares as bounded  # takes 0.3 s to import

    count = len(free)
    lower, upper = model.bounds(free)
    unbounded = np.full(model.drift.points.shape[1], np.inf)
    initial = np.clip([start[name] for name in free], lower, upper)

    def values(x: Floats) -> dict[str, float]:
        return {**start, **dict(zip(free, x[:count].tolist(), strict=True))}

    answer = bounded(
        lambda x: model.residuals(values(x), x[count:]),
        np.concatenate([initial, np.zeros_like(unbounded)]),
        lambda x: model.jacobian(values(x), free),  # type: ignore[arg-type]
        bounds=(np.concatenate([lower, -unbounded]), np.concatenate([upper, unbounded])),
        x_scale="jac",
        xtol=1e-10,
        ftol=1e-10,
        gtol=1e-10,
        max_nfev=max_nfev,
    )
    active = np.concatenate([answer.active_mask[:count] != 0, np.zeros(len(unbounded), bool)])
    return PathSolution(values(answer.x), free, answer.x[count:], answer.fun, answer.jac, active, answer.status > 0)


def solve(model: PathDependentModel, start: Mapping[str, float], free: tuple[str, ...]) -> PathSolution:
    """Bounded least squares with standard errors."""
    found = least_squares(model, start, free)
    names = (*free, *(f"offset {k}" for k in range(len(found.offsets))))
    number = condition_number(found.jacobian[:, ~found.active])
    if not number < CONDITION_LIMIT:
        remaining = [name for name, out in zip(names, found.active, strict=True) if not out]
        loose = unidentifiable(found.jacobian[:, ~found.active], remaining)
        message = f"the points do not determine {', '.join(loose)} (condition number {number:.1e})"
        remedy = "measure at more pressures and contractions, use a law with fewer parameters, or give a known one"
        raise IdentificationError(message, value=number, upper=CONDITION_LIMIT, remedy=remedy)
    if not found.converged:
        raise IdentificationError(
            f"the fit of law and friction did not converge (RMSE {np.sqrt(np.mean(found.residuals**2)):.3g} N)",
            remedy="look for outliers, wrong units and rows that are not in the order of the test",
        )
    errors, correlations = standard_errors(found.jacobian, found.residuals, found.active)
    # Points of a stroke have errors in common: those of the length at its reversal, and of timing.
    robust = _errors(found.jacobian[:, ~found.active], found.residuals, model.paths.stroke(model.means)[model.used])
    variance = robust.variance(np.eye(int(np.count_nonzero(~found.active))))[0]
    errors[~found.active] = np.maximum(errors[~found.active], np.sqrt(variance))
    return dataclasses.replace(found, errors=errors, correlations=correlations)


_FEWEST_LEVELS = 4  # with more, there are enough groups
_DRIFT_LEVEL = 0.01  # probability of a false detection of drift


def with_drift(
    model: PathDependentModel, bases: Sequence[DriftBasis], start: Mapping[str, float], free: tuple[str, ...]
) -> tuple[PathDependentModel, PathSolution]:
    """Solution with the significant drift of lowest Bayesian information criterion, or without drift."""
    answers: list[tuple[float, PathDependentModel, PathSolution]] = []
    count = int(np.count_nonzero(model.used))
    zero = np.zeros(len(model.used), bool)
    for basis in bases:
        trial = dataclasses.replace(model, drift=basis)
        found = solve(trial, start, free)
        if not answers:
            zero = model.used & (model.means.slack | (model.components(found.values)[0] <= 0))
        elif not _significant(trial, found, zero):
            continue
        start = found.values
        parameters = len(free) + basis.points.shape[1]
        answers.append((count * np.log(found.cost / count) + parameters * np.log(count), trial, found))
    return min(answers, key=lambda answer: answer[0])[1:]


def _significant(model: PathDependentModel, found: PathSolution, zero: Bools) -> bool:
    """Test for drift: F test of the forces at zero tension, or t test of a line through the taut points."""
    from scipy.special import fdtrc, stdtr

    if not model.drift.has_offset:
        rate, error, freedom = drift_rate(model, found)
        return error > 0 and 2 * float(stdtr(freedom, -abs(rate / error))) < _DRIFT_LEVEL
    force, basis = model.means.force[zero], model.drift.points[zero]
    fitted = basis @ np.linalg.lstsq(basis, force, rcond=None)[0]
    width, rest = basis.shape[1], len(force) - basis.shape[1]
    if rest < 1:
        return False
    left = float(np.sum((force - fitted) ** 2))
    return left == 0 or float(fdtrc(width, rest, (fitted @ fitted / width) / (left / rest))) < _DRIFT_LEVEL


def drift_rate(model: PathDependentModel, found: PathSolution) -> tuple[float, float, float]:
    """Mean rate of the drift [N/s], its standard error, robust to errors common to a level, and degrees of freedom."""
    basis = model.drift
    centred = basis.time - basis.time.mean()
    slope = centred / (centred @ centred) @ basis.at_knots
    free = ~found.active
    gradient = np.concatenate([np.zeros(len(found.free)), slope])[free]
    levels = model.means.levels[model.used]
    by_level = np.unique(levels, return_inverse=True)[1]  # the misfit of the law is common to a level
    labels = by_level if by_level.max() >= _FEWEST_LEVELS else model.paths.label[model.used]
    errors = _errors(found.jacobian[:, free], found.residuals, labels)
    variance, freedom = errors.variance(gradient[None])
    return float(slope @ found.offsets), float(np.sqrt(variance[0])), float(freedom[0])


def _errors(jacobian: Floats, residuals: Floats, labels: Ints) -> ClusterRobustErrors | IndependentErrors:
    """Standard errors robust to errors common to a stroke, unless one stroke alone determines a parameter."""
    robust = ClusterRobustErrors.of(jacobian, residuals, labels)
    return IndependentErrors.of(jacobian, residuals) if robust.decisive else robust


@dataclass(frozen=True)
class FormComparison:
    """Forms of friction compared by held-out loops.

    Attributes
    ----------
    rmse
        Error [N] at the loops of a pressure (of a path with fewer than three pressures) left out of the fit, to first
        order in the parameters, by form; the drift is estimated from all loops.
    chosen
        Form with the fewest parameters whose error is within 5 % or one standard error of the lowest.
    """

    rmse: Mapping[FrictionForm, float]
    chosen: FrictionForm

    def describe(self) -> str:
        """Comparison as text."""
        best = min(self.rmse, key=lambda form: self.rmse[form])
        lines = ["error at held-out loops by form of friction:"]
        for form, rmse in sorted(self.rmse.items(), key=lambda item: item[1]):
            more = f" ({rmse / self.rmse[best]:.2f} times the lowest)" if form is not best else ""
            lines.append(f"  {form.value:15}  {rmse:.3g} N{more}{', chosen' if form is self.chosen else ''}")
        return "\n".join(lines)


_AS_GOOD = 1.05  # times the lowest error
_RATE_GROWTH = 0.3  # at the start of a fit
_UNDETERMINED = 1e-8  # of the information in a direction outside a block


def compare_forms(
    model: PathDependentModel, start: Mapping[str, float], law: tuple[str, ...]
) -> tuple[FormComparison, dict[str, float]]:
    """Compare the forms that the data can distinguish; also return the values of the chosen one."""
    levels = model.means.levels[model.used]
    many = len(np.unique(levels)) >= 3
    blocks = levels if many else model.paths.label[model.used]
    squares: dict[FrictionForm, Floats] = {}
    found: dict[FrictionForm, PathSolution] = {}
    for form in FrictionForm:
        if ("growth" in form.free and not many) or (form.follows_rate and model.rate is None):
            continue
        answer = least_squares(model, form_start(model, start, form), (*law, *form.free), max_nfev=50)
        if form is FrictionForm.DRY_AND_VISCOUS and "half_width" in answer.at_bound:
            continue  # viscous alone
        found[form] = answer
        squares[form] = _held_out_squares(found[form], len(law) + len(form.free), blocks)
    known = np.isfinite(list(squares.values())).all(axis=0)
    rows = sum(int(np.count_nonzero(blocks == block)) for block in np.unique(blocks)[known])
    if not rows:
        return FormComparison({}, FrictionForm.CONSTANT), dict(start)
    squares = {form: square[known] for form, square in squares.items()}
    rmse = {form: float(np.sqrt(square.sum() / rows)) for form, square in squares.items()}
    best = squares[min(rmse, key=lambda form: rmse[form])]

    def as_good(form: FrictionForm) -> bool:
        worse = squares[form] - best
        scatter = np.sqrt(len(worse)) * np.std(worse, ddof=1) if len(worse) > 1 else 0.0
        return worse.sum() <= max(scatter, (_AS_GOOD**2 - 1) * best.sum())

    chosen = min(filter(as_good, rmse), key=lambda form: (len(form.free), rmse[form]))
    return FormComparison(rmse, chosen), found[chosen].values


def form_start(model: PathDependentModel, start: Mapping[str, float], form: FrictionForm) -> dict[str, float]:
    """Start of a fit of a form: parameters that it does not estimate are zero, or reverse friction within one step."""
    values = {**start, **dict.fromkeys(set(FRICTION) - {"half_width", "log_presliding"}, 0.0)}
    if "log_presliding" not in form.free:
        values["log_presliding"] = model.shortest
    if "half_width" not in form.free:
        values["half_width"] = MIN_HALF_WIDTH
    if form.follows_rate and model.rate is not None:
        speed = float(np.median(np.abs(model.rate[model.used])))
        if form is FrictionForm.RATE:
            return values | {"rate_growth": _RATE_GROWTH, "log_rate_speed": float(np.log(speed))}
        values["viscous"] = (
            start["half_width"] / speed if "half_width" not in form.free else 0.1 * values["half_width"] / speed
        )
    return values


def _held_out_squares(found: PathSolution, parameters: int, blocks: Floats | Ints) -> Floats:
    """Sum of squared errors [N^2] of each block by the linearised fit to all others; NaN where not determined."""
    jacobian = found.jacobian[:, :parameters][:, ~found.active[:parameters]]
    lengths = np.linalg.norm(jacobian, axis=0)
    left, singular, _ = np.linalg.svd(jacobian / np.where(lengths > 0, lengths, 1.0), full_matrices=False)
    q = left[:, singular > _UNDETERMINED * singular[0]]
    squares = []
    for block in np.unique(blocks):
        own, residuals = q[blocks == block], found.residuals[blocks == block]
        part, vectors = np.linalg.eigh(np.eye(q.shape[1]) - own.T @ own)
        if part[0] < _UNDETERMINED:
            squares.append(np.nan)
            continue
        error = residuals + own @ (vectors @ (vectors.T @ (own.T @ residuals) / part))
        squares.append(float(error @ error))
    return np.array(squares)


@dataclass(frozen=True)
class LackOfFit:
    """Significant dependence of the friction that its form does not include.

    Attributes
    ----------
    quantity
        "pressure", "tension", "contraction", "rate", its product with the pressure or the contraction, its square or,
        for a viscous form alone, "direction".
    force
        Root mean square [N] of the friction that depends on it.
    p_value
        Probability of at least this much if the form is right.
    remedy
        Form that has the dependence; None for the contraction.
    """

    quantity: str
    force: float
    p_value: float
    remedy: FrictionForm | None

    def describe(self, form: FrictionForm) -> str:
        """Rejection of a form as text."""
        offered = f"the form {self.remedy.value!r} includes this" if self.remedy else "no form includes this"
        return (
            f"the form {form.value!r} of the friction is rejected: {self.force:.2g} N of it depend on the "
            f"{self.quantity} (p = {self.p_value:.1g}); {offered}"
        )


_LACK_LEVEL = 1e-3
_LEAST_LACK = 0.03  # of the half width
_TAUT = 4.0  # half widths of tension, above which the band is 96 % of the half width
_LEAST_ROWS = 20
_REMEDIES = {
    "pressure": FrictionForm.PRESSURE,
    "tension": FrictionForm.TENSION,
    "contraction": None,
    "rate": FrictionForm.DRY_AND_VISCOUS,
    "direction": FrictionForm.DRY_AND_VISCOUS,
    "rate and pressure": FrictionForm.VARIABLE_VISCOUS,
    "rate and contraction": FrictionForm.VARIABLE_VISCOUS,
    "square of the rate": FrictionForm.RATE,
}


def lack_of_fit(model: PathDependentModel, found: PathSolution, scale: float) -> LackOfFit | None:
    """Score test of dependences that the form lacks, robust to errors common to a path (or stroke); `scale` in N."""
    from scipy.special import stdtr

    means, used = model.means, model.used
    tension = model.components(found.values)[0]
    side = model.band_side(found.values)
    rate = np.zeros(len(side)) if model.rate is None else model.rate
    taut = tension > _TAUT * scale
    side = np.where(taut if np.count_nonzero(taut & used) >= _LEAST_ROWS else tension > 0, side, 0.0)
    quantities = {
        "pressure": (means.pressure - model.reference_pressure) * side,
        "tension": (tension - tension[tension > 0].mean()) * side,
        "contraction": (means.contraction - means.contraction[tension > 0].mean()) * side,
        "rate": rate * np.abs(side),
        "direction": side,
    }
    if not _OF_RATE.isdisjoint(found.free):
        quantities |= {
            "rate and pressure": quantities["rate"] * (means.pressure - model.reference_pressure),
            "rate and contraction": quantities["rate"] * (means.contraction - means.contraction[tension > 0].mean()),
            "square of the rate": quantities["rate"] * np.abs(rate),
        }
    has = {"pressure": "growth", "tension": "tension_growth", "rate": "viscous", "direction": "half_width"}
    has |= {"rate and pressure": "viscous_growth", "rate and contraction": "viscous_length_growth"}
    labels = (model.paths.label if model.rate is None else model.paths.stroke(means))[used]
    jacobian = found.jacobian[:, ~found.active]
    lengths = np.linalg.norm(jacobian, axis=0)
    jacobian = jacobian[:, lengths > 0] / lengths[lengths > 0]
    candidates: list[tuple[float, LackOfFit]] = []
    for quantity, whole in quantities.items():
        column = whole[used]
        size = float(np.sqrt(np.mean(column[column != 0] ** 2))) if column.any() else 0.0
        if has.get(quantity) in found.free or not size:
            continue
        extended = np.column_stack([jacobian, column / np.linalg.norm(column)])
        if not condition_number(extended) < np.sqrt(CONDITION_LIMIT):
            continue
        amount = np.linalg.lstsq(extended, -found.residuals, rcond=None)[0]
        rest = -found.residuals - extended @ amount
        variance, freedom = _errors(extended, rest, labels).variance(np.eye(len(amount))[-1:])
        p_value = 2 * float(stdtr(freedom[0], -abs(amount[-1]) / np.sqrt(variance[0])))
        force = float(abs(amount[-1]) / np.linalg.norm(column) * size)
        if p_value < _LACK_LEVEL and force > _LEAST_LACK * scale:
            remedy = _REMEDIES[quantity]
            if remedy and remedy.follows_rate and not {"viscous_growth", "rate_growth"}.isdisjoint(found.free):
                remedy = None
            candidates.append((float(rest @ rest), LackOfFit(quantity, force, p_value, remedy)))
    return min(candidates, key=lambda candidate: candidate[0])[1] if candidates else None


def systematic_residual(model: PathDependentModel, residuals: Floats) -> float:
    """Root mean square [N] of the part of the residuals shared by neighbours along a path."""
    pairs = [rows[model.used[rows]] for rows in model.paths.rows]
    first, second = (np.concatenate([residuals[rows[part]] for rows in pairs]) for part in (slice(-1), slice(1, None)))
    return float(np.sqrt(max(np.mean(first * second), 0.0))) if len(first) else 0.0
