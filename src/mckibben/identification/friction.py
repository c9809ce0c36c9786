"""Identification of a force law, its friction and the drift of the force sensor from an isobaric test."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from mckibben.component.calls import checked_call
from mckibben.dataset import IsobaricDataset
from mckibben.dataset.preprocessing import held_loads
from mckibben.errors import IdentificationError
from mckibben.identification.estimator import Bools, Floats, Ints, robust_errors, t_quantile
from mckibben.identification.fit import Fit
from mckibben.identification.fitting import check_law_type, fit_means, law_of, tension_of
from mckibben.identification.friction_model import (
    FRICTION,
    USUAL_PRESLIDING,
    FrictionForm,
    PathDependentModel,
    PathSolution,
)
from mckibben.identification.grouping import at_fixed_lengths, held_values, measured_weights, with_loads
from mckibben.identification.loading_path import (
    TURN_TRAVELS,
    DriftBasis,
    LoadingPaths,
    half_gap_of_lengths,
    loop_half_width,
    with_last_motion,
)
from mckibben.identification.outliers import find_outliers
from mckibben.identification.summary import DatasetSummary, Outlier, left_out
from mckibben.muscle import ExponentialLaw, ForceLaw, MaxwellSlip
from mckibben.result import Column, Listing, Remark, Result, column, draw, table
from mckibben.units import factor, show

if TYPE_CHECKING:
    from mckibben.result import Figure

_VAGUE = 0.3  # relative standard error above which a parameter is not determined


@dataclass(frozen=True)
class SensorDrift:
    """Mean rate of the drift of the force sensor [N/s], and its standard error, robust to errors common to a path."""

    rate: float
    rate_error: float


class HysteresisFit(Result):
    """Friction, and the law without it, by `identify_hysteresis`.

    Attributes
    ----------
    fit
        Fit of the static law, midway between loading and unloading, to the points without friction and drift.
    corrected_points
        These points, used and slack; those that are slack, as measured or by the law, remain slack.
    friction
        Hysteresis, with the parameters of its form.
    form
        Form of the friction.
    comparison
        Error [N] by form at the loops of a pressure (of a path with fewer than three pressures) left out of the fit, to
        first order in the parameters, with the drift of all loops; empty if the form was given.
    standard_errors
        By parameter, in SI, in this order: the law's parameters, ``half_width``, ``growth``,
        ``tension_growth``, ``viscous``, ``viscous_asymmetry`` and ``presliding_length``; NaN if the form lacks it or
        the data do not determine it.
    drift
        Drift of the force sensor; None if not significant (1 %).
    rmse, max_error
        Root mean square and largest absolute residual [N] of the taut points that count.
    tension, friction_force, offset, residuals
        Shape (points,), in dataset order: force of the law, of friction, offset of the sensor, and measured minus
        modelled force [N].
    used
        Mask of the points that count, shape (points,): without outliers, points without a direction, rows at a reversal
        if the rate counts, those before a muscle with a held load slides and, unless there is drift, slack points.
    points_slack, points_left_out, dataset
        Numbers of slack points and of other ones that do not count; summary of the data.
    outliers
        Points left out because they are off the smooth surface through the others.
    undetermined
        Upper bounds (95 %), in SI, of parameters of the friction that a simulation needs and the data do not determine;
        infinite without one.
    notes
        Reasons not to rely on the results.
    """

    fit: Fit
    friction: MaxwellSlip
    form: FrictionForm
    comparison: Mapping[FrictionForm, float]
    standard_errors: dict[str, float]
    drift: SensorDrift | None
    rmse: float = column("N", "RMSE of law and friction", digits=3)
    max_error: float = column("N", "largest residual", digits=3)
    points_left_out: int = column("", "points left out")
    corrected_points: IsobaricDataset
    tension: Floats
    friction_force: Floats
    offset: Floats
    residuals: Floats
    used: Bools
    points_slack: int
    notes: tuple[Remark, ...]
    dataset: DatasetSummary
    outliers: tuple[Outlier, ...] = ()
    undetermined: Mapping[str, float] = dataclasses.field(default_factory=dict)

    @property
    def law(self) -> ForceLaw:
        """Static law; its domain is the range of the points."""
        return self.fit.law

    def verdict(self) -> str:
        """Return half width and presliding length."""
        friction, names = self.friction, f"{type(self.law).__name__} with friction of the form {self.form.value!r}"
        most = self.undetermined.get("presliding_length")
        bound = f"of at most {show(most or 0.0, 'mm', 2)}" if most != math.inf else "not determined"
        length = show(friction.presliding_length, "mm", 3) if most is None else bound
        return f"{names}: half width {friction.half_width:.3g} N, presliding length {length}, RMSE {self.rmse:.3g} N"

    def remarks(self) -> Iterable[Remark]:
        """Return the notes."""
        return self.notes

    @table()
    def friction_and_drift(self) -> Iterable[Listing]:
        """Return the parameters of the friction and the drift, and the comparison of forms."""
        rows = []
        for name, (unit, at) in _SHOWN.items():
            if value := getattr(self.friction, name):
                error, size = self.standard_errors[name], factor(unit)
                reference = (
                    show(getattr(self.friction, at), "bar" if at == "reference_pressure" else "N", 3) if at else ""
                )
                rows.append((name.replace("_", " "), value / size, error / size, unit, reference))
        if self.drift:
            rows.append(("drift of the sensor", 3600 * self.drift.rate, 3600 * self.drift.rate_error, "N/h", ""))
        titles = ("friction", "estimate", "standard error", "unit", "at")
        columns = zip(titles, zip(*rows, strict=True), strict=True)
        yield Listing("friction", {title: (Column(digits=3), values) for title, values in columns})
        if self.comparison:
            errors = sorted(self.comparison.items(), key=lambda item: item[1])
            forms = {
                "form": (Column("", "form of friction"), [form.value for form, _ in errors]),
                "rmse": (Column("N", "error at held-out loops", digits=3), [rmse for _, rmse in errors]),
            }
            yield Listing("forms of friction", forms, detail=True)

    @property
    def force(self) -> Floats:
        """Modelled force at each point [N], shape (points,)."""
        return self.tension + self.friction_force + self.offset

    def plot(self, data: IsobaricDataset) -> Figure:  # pyrefly: ignore[bad-override]
        """Return a figure of the loops of the identified points, see `mckibben.report.loops`."""
        return draw("loops", data, self)


_SHOWN = {
    "half_width": ("N", "reference_pressure"),
    "growth": ("N/bar", ""),
    "tension_growth": ("1", "reference_tension"),
    "viscous": ("N*s/m", ""),
    "viscous_asymmetry": ("1", ""),
    "presliding_length": ("mm", ""),
}
"""Unit of the parameters of the friction in tables, and the quantity that they refer to."""


@checked_call
def identify_hysteresis(
    law: type[ForceLaw],
    dataset: IsobaricDataset,
    *,
    drift: bool = True,
    form: FrictionForm | None = None,
    robust: bool = True,
) -> HysteresisFit:
    """Fit friction to all points of an isobaric test, in the order of time, and a law to the points without it.

    The force at a point is the sum of a smooth force over contraction and pressure (`SmoothSurface`), that of
    the friction after the loading path up to that point, and the offset of the sensor, all estimated together: friction
    does not depend on the law. Docs/hysteresis.md describes the choice of the form of the friction, and the drift.

    Parameters
    ----------
    law
        Class of the law to fit.
    dataset
        Directions, initial length, and nominal pressures if measured ones scatter, in the order of the test or with
        times.
    drift
        True to estimate the drift if it is significant.
    form
        Form of the friction. Default: chosen by held-out loops.
    robust
        False to keep outliers.

    Raises
    ------
    IdentificationError
        If the points do not determine the hysteresis: only one direction, rows not in the order of a test, too few
        points, or correlated parameters.

    Examples
    --------
    >>> from mckibben import catalog
    >>> from mckibben.muscle import ExponentialLaw, Muscle
    >>> from mckibben.rig import IsobaricProtocol, SimulatedIsobaricTest
    >>> from mckibben.units import bar, mm
    >>> muscle = Muscle(catalog.specimen("MAS-10-180N-AA-MC-O"), catalog.law("lei-mas-10-180n"))
    >>> protocol = IsobaricProtocol(pressures=[2 * bar, 4 * bar, 6 * bar], repeats=1)
    >>> fit = identify_hysteresis(ExponentialLaw, SimulatedIsobaricTest(muscle).run(protocol, seed=1))
    >>> round(fit.friction.half_width, 1), round(fit.friction.presliding_length / mm, 2)
    (12.0, 0.5)
    """
    check_law_type(law)
    means = with_last_motion(with_loads(dataset))
    paths = LoadingPaths.of(means)
    taut = ~means.slack
    half_gap, gap_error = loop_half_width(means, taut)
    bases = DriftBasis.candidates(paths, means)[: None if drift else 1]
    rate = paths.rate(means)
    # Friction that varies with the rate is not an outlier.
    outliers = find_outliers(means) if robust and rate is None else ()
    used = taut | (bases[-1].points.shape[1] > 1)  # slack points determine the zero
    used &= (rate is None) | ~paths.at_reversal(means)
    used &= means.table["direction"].to_numpy() != ""  # of others the friction is not known
    used &= ~np.isin(np.arange(len(means)) + 1, [outlier.row for outlier in outliers])
    reference = float(np.unique(means.levels[taut]).mean()), float(means.force[taut].mean())
    eq2 = law_of(ExponentialLaw, means.select(used))
    tension = np.where(taut, tension_of(eq2, means), 0.0)
    weights = measured_weights(eq2, means)
    model = PathDependentModel(tension, paths, means, bases[-1], used, weights, *reference, rate)
    model, start = _started(model, eq2, half_gap)
    if form is None:
        _check_left_out(model, used)
    elif missing := model.missing(form):
        message, remedy = f"friction of the form {form.value!r} needs {missing}", "measure them, or choose another form"
        raise IdentificationError(message, field="form", value=form.value, remedy=remedy)
    bases, about_creep = _with_creep(model, bases, start)
    model = dataclasses.replace(model, drift=bases[-1])
    comparison: Mapping[FrictionForm, float] = {}
    if fixed := at_fixed_lengths(means):  # lengths are few: the regression knows what they leave open
        form, start["half_width"] = form or FrictionForm.COULOMB, half_gap
    if form is None:
        form, comparison, start = _compare_forms(model, start)
    else:
        start = model.start(start, form)
    names = tuple(name for name in form.free if not (fixed and name == "half_width"))
    model, solution = _with_drift(_with_tension(model, start)[0].smoothed(start), bases, start, names)
    solution, undetermined, about_presliding = _presliding(model, solution)
    result = _result(model, solution, taut, form, comparison, law)
    if fixed:
        result.standard_errors["half_width"] = gap_error
    notes = [*left_out(outliers), *about_creep, *about_presliding, *_doubts(model, solution, result)]
    notes += _released(means, used & taut) if fixed else []
    return dataclasses.replace(result, notes=tuple(notes), outliers=outliers, undetermined=undetermined)


def _check_left_out(model: PathDependentModel, used: Bools, *, most: float = 0.1) -> None:
    """Refuse a share of more than `most` of points, beyond the first of each path, at which a held load sticks."""
    count, total = int(np.count_nonzero(used & ~model.used)), int(np.count_nonzero(used))
    if count - len(model.paths.counts) > most * total:
        remedy = (
            "start each load with more travel before its first point, or name a form of friction to identify it from "
            "the other points (form=FrictionForm.COULOMB, command line: --friction coulomb)"
        )
        text = f"the muscle sticks at {count} of {total} points, at which its last motion is not known"
        raise IdentificationError(text, value=count, upper=most * total, remedy=remedy)


def _started(model: PathDependentModel, law: ForceLaw, half_gap: float) -> tuple[PathDependentModel, dict[str, float]]:
    """Best of the models, and its values: the state at the start of paths, and whether the muscle rested at turns."""
    start = dict.fromkeys(FRICTION, 0.0) | {"half_width": half_gap}
    start["log_presliding"] = float(np.log(USUAL_PRESLIDING * model.initial_length))
    few = FrictionForm.CONSTANT if model.missing(FrictionForm.PRESSURE) else FrictionForm.PRESSURE
    form = few if model.rate is None else FrictionForm.VISCOUS
    start, measured, held = model.start(start, form), model, held_loads(model.means.table) is not None
    if held:
        model = model.with_held_loads(law, start)
    models = [
        model.with_paths(side=side * model.paths.side, turn_travel=travel)
        for travel in (TURN_TRAVELS if model.paths.turns.any() else TURN_TRAVELS[:1])
        for side in ((1,) if held else (1, -1, 0))
    ]
    surface = model.smoothed(start).surface
    models = [dataclasses.replace(branch, surface=surface) for branch in models]
    solutions = [branch.fit(start, form.free, evaluations=20) for branch in models]
    best = int(np.argmin([solution.minimum.cost for solution in solutions]))
    values = solutions[best].values
    model, law = _with_tension(dataclasses.replace(models[best], used=measured.used), values)
    if held:
        model = model.with_held_loads(law, values)
    return model.smoothed(values), values


def _with_tension(model: PathDependentModel, values: Mapping[str, float]) -> tuple[PathDependentModel, ForceLaw]:
    """Model with the tension of the points without friction of these parameters, and its law (Eq. 2)."""
    law = law_of(ExponentialLaw, _corrected(model.means, model.tension, model.force(values), model.used))
    return dataclasses.replace(model, tension=np.where(model.means.slack, 0.0, tension_of(law, model.means))), law


def _with_creep(
    model: PathDependentModel, bases: Sequence[DriftBasis], start: Mapping[str, float]
) -> tuple[Sequence[DriftBasis], list[Remark]]:
    """Bases of the drift with a creep, if Schwarz's criterion is lower with it, and a remark.

    On plateaus that are short against its time constant, creep looks like friction. It is told by points at rest, with
    times.
    """
    means, free = model.means, FrictionForm.CONSTANT.free
    if (
        not {"time", "force_spread"} <= set(means.table)
        or at_fixed_lengths(means)
        or held_loads(means.table) is not None
    ):
        return bases, []
    from scipy.optimize import minimize_scalar

    def solution(basis: DriftBasis) -> PathSolution:
        return dataclasses.replace(model, drift=basis).fit(start, free, evaluations=20)

    step = float(np.median(np.diff(np.sort(means.table["time"].to_numpy()))))
    search = minimize_scalar(
        lambda logarithm: solution(bases[-1].with_creep(means, model.tension, np.exp(logarithm))).minimum.cost,
        bounds=(np.log(step / 4), np.log(30 * step)),
        method="bounded",
        options={"xatol": 0.02},
    )
    tau, count = float(np.exp(search.x)), int(np.count_nonzero(model.used))
    creeping = [basis.with_creep(means, model.tension, tau) for basis in bases]
    share = float(solution(creeping[-1]).offsets[-1])
    if not (share > 0 and count * np.log(solution(bases[-1]).minimum.cost / search.fun) > 2 * np.log(count)):
        return bases, []
    text = f"the force creeps after a move, by {share:.2g} of its change, with a time constant of {tau:.2g} s"
    return creeping, [Remark.note("creep", f"{text}: this is not in the friction")]


def _with_drift(
    model: PathDependentModel,
    bases: Sequence[DriftBasis],
    start: Mapping[str, float],
    free: tuple[str, ...],
    *,
    level: float = 0.01,
) -> tuple[PathDependentModel, PathSolution]:
    """Solution with the drift if its mean rate is significant and Schwarz's criterion lower, else without.

    `level` is the probability of a false detection.
    """
    from scipy.special import stdtr

    without = dataclasses.replace(model, drift=bases[0])
    solution, count = without.solve(start, free), int(np.count_nonzero(model.used))
    for basis in bases[1:]:
        trial = dataclasses.replace(model, drift=basis)
        drifting = trial.solve(solution.values, free)
        rate, error, freedom = _drift_rate(trial, drifting)
        significant = error > 0 and 2 * float(stdtr(freedom, -abs(rate / error))) < level
        gain = count * np.log(solution.minimum.cost / drifting.minimum.cost)
        if significant and gain > np.count_nonzero(basis.slope) * np.log(count):
            return trial, drifting
    return without, solution


def _drift_rate(model: PathDependentModel, solution: PathSolution) -> tuple[float, float, float]:
    """Mean rate of the drift [N/s], its standard error, robust to errors common to a path, and degrees of freedom."""
    slope = model.drift.slope
    gradient = np.concatenate([np.zeros(len(solution.free)), slope])[solution.inside]
    labels = model.paths.label[model.used]
    errors = robust_errors(solution.minimum.jacobian[:, solution.inside], solution.minimum.residuals, labels)
    variance, freedom = errors.variance(gradient[None])
    return float(slope @ solution.offsets), float(np.sqrt(variance[0])), float(freedom[0])


def _compare_forms(
    model: PathDependentModel, start: Mapping[str, float], *, tolerance: float = 1.05
) -> tuple[FrictionForm, Mapping[FrictionForm, float], dict[str, float]]:
    """Form with the fewest parameters that is as good as the best; errors of those that the data tell apart; values.

    Its error is at most `tolerance` times the lowest, or larger by less than the standard error of the difference.
    """
    levels = held_values(model.means)[model.used]
    blocks = levels if len(np.unique(levels)) >= 3 else model.paths.label[model.used]
    squares: dict[FrictionForm, Floats] = {}
    solutions: dict[FrictionForm, PathSolution] = {}
    for form in FrictionForm:
        if model.missing(form):
            continue
        solutions[form] = model.fit(model.start(start, form), form.free, evaluations=50)
        squares[form] = _held_out_squares(solutions[form], blocks)
    known = np.isfinite(list(squares.values())).all(axis=0)
    rows = sum(int(np.count_nonzero(blocks == block)) for block in np.unique(blocks)[known])
    if not rows:
        return FrictionForm.CONSTANT, {}, dict(start)
    squares = {form: square[known] for form, square in squares.items()}
    rmse = {form: float(np.sqrt(square.sum() / rows)) for form, square in squares.items()}
    best = squares[min(rmse, key=lambda form: rmse[form])]

    def as_good(form: FrictionForm) -> bool:
        worse = squares[form] - best
        scatter = np.sqrt(len(worse)) * np.std(worse, ddof=1) if len(worse) > 1 else 0.0
        return worse.sum() <= max(scatter, (tolerance**2 - 1) * best.sum())

    chosen = min(filter(as_good, rmse), key=lambda form: (len(form.free), rmse[form]))
    return chosen, rmse, solutions[chosen].values


def _held_out_squares(solution: PathSolution, blocks: Floats | Ints, *, singular: float = 1e-8) -> Floats:
    """Sum of squared errors [N^2] of each block by the linearised fit to all others; NaN where not determined.

    The smooth surface is that of all points. Points do not determine a direction whose singular value is below
    `singular` times the largest.
    """
    count, residuals = len(solution.free), solution.minimum.residuals
    jacobian = solution.minimum.jacobian[:, :count][:, solution.inside[:count]]
    jacobian = jacobian / np.maximum(np.linalg.norm(jacobian, axis=0), np.finfo(float).tiny)
    rank, squares = np.linalg.matrix_rank(jacobian, rtol=singular), []
    for block in np.unique(blocks):
        out = np.pad(blocks == block, (0, len(residuals) - len(blocks)))  # what follows belongs to the surface
        step, _, rest, _ = np.linalg.lstsq(jacobian[~out], residuals[~out], rcond=singular)
        error = residuals[out] - jacobian[out] @ step
        squares.append(float(error @ error) if rest == rank else np.nan)
    return np.array(squares)


def _presliding(
    model: PathDependentModel, solution: PathSolution
) -> tuple[PathSolution, dict[str, float], list[Remark]]:
    """Solution with the presliding length held if the points do not determine it, its upper bound, and a remark.

    The interval (95 %) is that of the likelihood, with the other parameters to first order. It is held at the lower
    end or, where that reverses friction within half a step so that shorter ones are equivalent, at no more than the
    usual one, from which `calibrate` starts, too.
    """
    name, others = "log_presliding", tuple(free for free in solution.free if free != "log_presliding")
    if name in solution.free and solution.error(name) < _VAGUE:  # unknown at a bound
        return solution, {}, []
    minimum, inside = solution.minimum, solution.inside & (np.array([*solution.free, *solution.offsets]) != name)
    basis = np.linalg.qr(minimum.jacobian[:, inside])[0]
    lengths, costs = np.linspace(model.shortest, float(model.bounds([name])[1][0]), 60), []
    for length in lengths:
        residuals = model.residuals({**solution.values, name: length}, solution.offsets)
        costs.append(np.sum((residuals - basis @ (basis.T @ residuals)) ** 2))
    freedom = int(np.count_nonzero(model.used)) - basis.shape[1] - 1
    inside_interval = lengths[costs <= np.min(costs) * (1 + float(t_quantile(0.95, freedom)) ** 2 / freedom)]
    least, most = np.exp(inside_interval[[0, -1]])
    if inside_interval[0] == lengths[0]:
        least = min(least, USUAL_PRESLIDING * model.initial_length)
    held = model.solve({**solution.values, name: float(np.log(least))}, others)
    bound = f"at most {show(most, 'mm', 2)}, and " if inside_interval[-1] < lengths[-1] else ""
    most = most if bound else math.inf
    text = (
        f"the presliding length is not determined (steps of {show(model.paths.step, 'mm', 3)}): "
        f"{bound}{show(least, 'mm', 2)} in the muscle"
    )
    remark = Remark.warning("presliding_length", text, "record a short stroke with a reversal: long ones are averaged")
    return held, {"presliding_length": float(most)}, [remark]


def _released(means: IsobaricDataset, taut: Bools) -> list[Remark]:
    """Remark on fixed lengths at whose end the friction is less than the motion left (95 %)."""
    (first, error, freedom), (last, other, _) = (half_gap_of_lengths(means, taut, last=end) for end in (False, True))
    if not first - last > t_quantile(0.95, freedom) * np.hypot(error, other):
        return []
    text = f"the friction is {first:.3g} N after a move, and {last:.3g} N at the end of a length"
    why = "the frame yields as the pressure changes, and the law has part of the friction"
    return [
        Remark.warning("friction", f"{text}: {why}", "measure strokes at constant pressures, or in a stiffer frame")
    ]


def _doubts(model: PathDependentModel, solution: PathSolution, result: HysteresisFit) -> Iterable[Remark]:
    """Remarks on points left out, on the half width, and on parameters at a bound."""
    if result.points_left_out:
        text = f"{result.points_left_out} of {np.count_nonzero(~model.means.slack)} points are left out"
        why = "outliers, and those at which the direction of the last motion, or the rate, is not known"
        yield Remark.note("points", f"{text}: {why}")
    half_width, error = solution.values["half_width"], result.standard_errors["half_width"]
    if not error < _VAGUE * half_width:
        text = f"the half width {half_width:.3g} N has a standard error of {error:.2g} N"
        why = "loading and unloading hardly differ, or the strokes are too short"
        yield Remark.warning("half_width", f"{text}: {why}")
    bounded = zip(solution.free, solution.minimum.at_bound, strict=False)
    for name in [name for name, out in bounded if out and name != "log_presliding"]:
        yield Remark.warning(name, f"{name} is at the bound of its range")


def _result(
    model: PathDependentModel,
    solution: PathSolution,
    taut: Bools,
    form: FrictionForm,
    comparison: Mapping[FrictionForm, float],
    law: type[ForceLaw],
) -> HysteresisFit:
    means, used, basis = model.means, model.used, model.drift
    force = model.force(solution.values)
    offset = basis.points @ solution.offsets
    corrected = _corrected(means, model.tension, force + offset, used)
    fit = fit_means(law, corrected, ())
    tension = tension_of(fit.law, means)
    residuals = means.force - tension - force - offset
    friction = model.friction(solution.values)
    errors = {**fit.standard_errors, **{name: solution.error(name) for name in FRICTION if name != "log_presliding"}}
    errors["presliding_length"] = solution.error("log_presliding") * friction.presliding_length
    drift = SensorDrift(*_drift_rate(model, solution)[:2]) if basis.slope.any() else None
    return HysteresisFit(
        fit=fit,
        friction=friction,
        form=form,
        comparison=comparison,
        standard_errors=errors,
        drift=drift,
        rmse=float(np.sqrt(np.mean(residuals[used & taut] ** 2))),
        max_error=float(np.abs(residuals[used & taut]).max()),
        points_left_out=int(np.count_nonzero(taut & ~used)),
        corrected_points=corrected,
        tension=tension,
        friction_force=force,
        offset=offset,
        residuals=residuals,
        used=used,
        points_slack=int(np.count_nonzero(~taut)),
        notes=(),
        dataset=DatasetSummary.of(means.select(taut)),
    )


def _corrected(means: IsobaricDataset, tension: Floats, added: Floats, used: Bools) -> IsobaricDataset:
    """Used and slack points without friction and drift; those that are slack, as measured or by the tension, remain."""
    force = np.where(means.slack, means.force, means.force - added)
    force = np.where(tension > 0, force, np.minimum(force, means.table.attrs["slack_force"]))
    table = means.table.assign(force=("point", force)).assign_attrs(friction="subtracted")
    return IsobaricDataset(table).select(used | means.slack)
