"""Identification of a force law, its friction and the drift of the force sensor from an isobaric test."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from mckibben.component.calls import checked_call
from mckibben.dataset import IsobaricDataset
from mckibben.errors import IdentificationError
from mckibben.identification.estimator import (
    CONDITION_LIMIT,
    Bools,
    Floats,
    Ints,
    condition_number,
    robust_errors,
)
from mckibben.identification.fit import Fit
from mckibben.identification.fitting import identify
from mckibben.identification.friction_model import FRICTION, FrictionForm, PathDependentModel, PathSolution
from mckibben.identification.hysteresis import FormComparison, HysteresisFit, LackOfFit, SensorDrift
from mckibben.identification.loading_path import DriftBasis, LoadingPaths, clipped, loop_half_width
from mckibben.identification.outliers import find_outliers
from mckibben.identification.summary import DatasetSummary, domain_of, left_out
from mckibben.muscle import ForceLaw
from mckibben.result import Remark
from mckibben.units import show

_AT_BOUND = 1e-2  # of the logarithm of the presliding length
_EDGE = 1e-6  # of the range of a shape parameter
_MISFIT = 0.1  # of half the loop width: larger systematic residuals bias the friction
_NOISY = 0.01  # share of moves against their stroke: the noise of the length is a third of a step or more
_ROUNDS = 2
_VAGUE = 0.3  # relative standard error above which a parameter is not determined


@checked_call
def identify_hysteresis(
    law: type[ForceLaw] | ForceLaw | Fit,
    dataset: IsobaricDataset,
    *,
    drift: bool = True,
    form: FrictionForm | None = None,
    elements: int = 6,
    robust: bool = True,
) -> HysteresisFit:
    """Fit a law and its friction to all points of an isobaric test, in the order of time.

    The force at a point is the sum of the law, the friction after the loading path up to that point, and the sensor's
    offset, all estimated together by least squares; docs/hysteresis.md describes the choice of the form of the
    friction, the test of what it lacks, and the drift.

    Parameters
    ----------
    law
        Class of the law to fit, or a known law (or fit).
    dataset
        Directions, initial length, and nominal pressures if measured ones scatter, in the order of the test or with
        times.
    drift
        True to estimate the drift if it is significant.
    form
        Form of the friction. Default: chosen by held-out loops.
    elements
        Number of Maxwell-slip elements.
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
    law = law.law if isinstance(law, Fit) else law
    known = law if isinstance(law, ForceLaw) else None
    law_type = type(law) if isinstance(law, ForceLaw) else law
    means = dataset.plateau_means()
    paths = LoadingPaths.of(means)
    taut = ~means.slack
    half_gap = loop_half_width(means, taut)
    bases = DriftBasis.candidates(paths, means)[: None if drift else 1]
    rate = paths.rate(means)
    # Friction that varies with the rate is not an outlier.
    outliers = find_outliers(means) if robust and rate is None else ()
    used = taut | (any(basis.has_offset for basis in bases) and not clipped(means))
    used &= (rate is None) | ~paths.at_reversal(means)
    used &= ~np.isin(np.arange(len(means)) + 1, [outlier.row for outlier in outliers])
    reference = float(np.unique(means.levels[taut]).mean()), elements, float(means.force[taut].mean())
    template = known or identify(law_type, means, robust=robust).law
    model = PathDependentModel(template, paths, means, bases[0], used, *reference, rate)
    of_law = () if known else model.law_names
    _check(model, form, len(of_law), bases[-1])
    model, start = _started(model, half_gap, None if known else law_type, robust)
    notes = [*left_out(outliers)]
    for name in _shapes_at_bound(model.template) & set(of_law):
        of_law = tuple(other for other in of_law if other != name)
        text = f"{name} is held at the bound of its range"
        notes.append(Remark.warning(name, text, "the law is probably misspecified: see how others fit"))
    comparison = None
    if form is None:
        comparison, start = _compare_forms(dataclasses.replace(model, drift=bases[-1]), start, of_law)
        form = comparison.chosen
    else:
        start = model.start(start, form)
    model, solution = _with_drift(model, bases, start, (*of_law, *form.free))
    solution, about_presliding = _presliding(model, solution)
    lack, rejected = _rejected(model, solution, form, of_law, half_gap)
    result = _result(model, solution, taut, form, comparison, lack)
    notes += [*about_presliding, *_doubts(model, solution, result, half_gap, rejected)]
    return dataclasses.replace(result, notes=tuple(notes))


def _rejected(
    model: PathDependentModel, solution: PathSolution, form: FrictionForm, of_law: tuple[str, ...], half_gap: float
) -> tuple[LackOfFit | None, FrictionForm]:
    """Dependence that a form lacks, and the form that is rejected for it."""
    lack = _lack_of_fit(model, solution, half_gap)
    if lack is not None or form not in (FrictionForm.PRESSURE, FrictionForm.TENSION):
        return lack, form
    # A dependence on contraction may be mistaken for growth, which hides it if there are few paths.
    simpler = model.fit(model.start(solution.values, FrictionForm.CONSTANT), (*of_law, *FrictionForm.CONSTANT.free))
    lack = _lack_of_fit(model, simpler, half_gap)
    return (lack, FrictionForm.CONSTANT) if lack and lack.remedy is None else (None, form)


def _check(model: PathDependentModel, form: FrictionForm | None, of_law: int, drift: DriftBasis) -> None:
    """Reject too few points, and a form that the data do not determine."""
    needed, count = of_law + len(FrictionForm.CONSTANT.free) + drift.points.shape[1] + 1, np.count_nonzero(model.used)
    if count < needed:
        message = f"{count} points cannot determine {needed - 1} parameters of law, friction and drift"
        remedy = f"measure at least {needed}, or give a law that is known"
        raise IdentificationError(message, value=int(count), lower=needed, remedy=remedy)
    if form is None:
        return
    levels = len(np.unique(model.means.levels[~model.means.slack]))
    if "growth" in form.free and levels < 3:
        message = f"friction of the form {form.value!r} needs three pressures, not {levels}"
        remedy = "measure at more pressures, or choose another form"
        raise IdentificationError(message, value=levels, lower=3, remedy=remedy)
    if form.follows_rate and model.rate is None:
        raise IdentificationError(
            f"friction of the form {form.value!r} needs times at which the speed varies",
            remedy="give the times of motions at several speeds, or choose another form",
        )


def _started(
    model: PathDependentModel, half_gap: float, law_type: type[ForceLaw] | None, robust: bool
) -> tuple[PathDependentModel, dict[str, float]]:
    """Model and start of the fits, from alternate fits of the friction and of a law (none if it is known)."""
    start = dict.fromkeys(FRICTION, 0.0) | {"half_width": half_gap, "log_presliding": float(np.log(model.paths.step))}
    model, start = _branched(model, start)
    for _ in range(_ROUNDS if law_type else 0):
        friction = model.components(start)[1]
        corrected = IsobaricDataset(model.means.table.assign(force=("point", model.means.force - friction)))
        try:
            model = dataclasses.replace(model, template=identify(law_type, corrected, robust=robust).law)  # type: ignore[arg-type]
        except (IdentificationError, np.linalg.LinAlgError):
            break  # the start is good enough
        model, start = _branched(model, start)
    return model, start | {name: float(getattr(model.template, name)) for name in model.law_names}


def _branched(model: PathDependentModel, start: dict[str, float]) -> tuple[PathDependentModel, dict[str, float]]:
    """Best of the models: which branch paths start on, and whether the muscle rested at turning points or overshot."""
    models = [
        dataclasses.replace(model, paths=dataclasses.replace(model.paths, side=side, overshot=overshot))
        for overshot in (False, True)[: 1 + bool(model.paths.turns.any())]
        for side in (model.paths.side, -model.paths.side)
    ]
    solutions = [branch.fit(start, ("half_width", "log_presliding"), evaluations=20) for branch in models]
    best = int(np.argmin([solution.minimum.cost for solution in solutions]))
    return models[best], solutions[best].values


def _shapes_at_bound(law: ForceLaw) -> set[str]:
    return {
        p.name
        for p in law.shape_parameters
        if not _EDGE < (float(getattr(law, p.name)) - p.lower) / (p.upper - p.lower) < 1 - _EDGE
    }


_DRIFT_LEVEL = 0.01  # probability of a false detection of drift
_FEWEST_LEVELS = 4  # with more, there are enough groups


def _with_drift(
    model: PathDependentModel, bases: Sequence[DriftBasis], start: Mapping[str, float], free: tuple[str, ...]
) -> tuple[PathDependentModel, PathSolution]:
    """Solution with the significant drift of lowest Bayesian information criterion, or without drift."""
    answers: list[tuple[float, PathDependentModel, PathSolution]] = []
    count = int(np.count_nonzero(model.used))
    zero = np.zeros(len(model.used), bool)
    for basis in bases:
        trial = dataclasses.replace(model, drift=basis)
        solution = trial.solve(start, free)
        if not answers:
            zero = model.used & (model.means.slack | (model.components(solution.values)[0] <= 0))
        elif not _significant(trial, solution, zero):
            continue
        start = solution.values
        parameters = len(free) + basis.points.shape[1]
        criterion = count * np.log(solution.minimum.cost / count) + parameters * np.log(count)
        answers.append((criterion, trial, solution))
    return min(answers, key=lambda answer: answer[0])[1:]


def _significant(model: PathDependentModel, solution: PathSolution, zero: Bools) -> bool:
    """Test for drift: F test of the forces at zero tension, or t test of a line through the taut points."""
    from scipy.special import fdtrc, stdtr

    if not model.drift.has_offset:
        rate, error, freedom = _drift_rate(model, solution)
        return error > 0 and 2 * float(stdtr(freedom, -abs(rate / error))) < _DRIFT_LEVEL
    force, basis = model.means.force[zero], model.drift.points[zero]
    fitted = basis @ np.linalg.lstsq(basis, force, rcond=None)[0]
    width, rest = basis.shape[1], len(force) - basis.shape[1]
    if rest < 1:
        return False
    left = float(np.sum((force - fitted) ** 2))
    return left == 0 or float(fdtrc(width, rest, (fitted @ fitted / width) / (left / rest))) < _DRIFT_LEVEL


def _drift_rate(model: PathDependentModel, solution: PathSolution) -> tuple[float, float, float]:
    """Mean rate of the drift [N/s], its standard error, robust to errors common to a level, and degrees of freedom."""
    basis = model.drift
    centred = basis.time - basis.time.mean()
    slope = centred / (centred @ centred) @ basis.at_knots
    gradient = np.concatenate([np.zeros(len(solution.free)), slope])[solution.inside]
    by_level = np.unique(model.means.levels[model.used], return_inverse=True)[1]  # the misfit of the law is common
    labels = by_level if by_level.max() >= _FEWEST_LEVELS else model.paths.label[model.used]
    errors = robust_errors(solution.minimum.jacobian[:, solution.inside], solution.minimum.residuals, labels)
    variance, freedom = errors.variance(gradient[None])
    return float(slope @ solution.offsets), float(np.sqrt(variance[0])), float(freedom[0])


_AS_GOOD = 1.05  # times the lowest error
_UNDETERMINED = 1e-8  # of the information in a direction outside a block


def _compare_forms(
    model: PathDependentModel, start: Mapping[str, float], law: tuple[str, ...]
) -> tuple[FormComparison, dict[str, float]]:
    """Compare the forms that the data can distinguish; also return the values of the chosen one."""
    levels = model.means.levels[model.used]
    many = len(np.unique(levels)) >= 3
    blocks = levels if many else model.paths.label[model.used]
    squares: dict[FrictionForm, Floats] = {}
    solutions: dict[FrictionForm, PathSolution] = {}
    for form in FrictionForm:
        if ("growth" in form.free and not many) or (form.follows_rate and model.rate is None):
            continue
        solutions[form] = model.fit(model.start(start, form), (*law, *form.free), evaluations=50)
        squares[form] = _held_out_squares(solutions[form], blocks)
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
    return FormComparison(rmse, chosen), solutions[chosen].values


def _held_out_squares(solution: PathSolution, blocks: Floats | Ints) -> Floats:
    """Sum of squared errors [N^2] of each block by the linearised fit to all others; NaN where not determined."""
    count, minimum = len(solution.free), solution.minimum
    jacobian = minimum.jacobian[:, :count][:, solution.inside[:count]]
    lengths = np.linalg.norm(jacobian, axis=0)
    left, singular, _ = np.linalg.svd(jacobian / np.where(lengths > 0, lengths, 1.0), full_matrices=False)
    q = left[:, singular > _UNDETERMINED * singular[0]]
    squares = []
    for block in np.unique(blocks):
        own, residuals = q[blocks == block], minimum.residuals[blocks == block]
        part, vectors = np.linalg.eigh(np.eye(q.shape[1]) - own.T @ own)
        if part[0] < _UNDETERMINED:
            squares.append(np.nan)
            continue
        error = residuals + own @ (vectors @ (vectors.T @ (own.T @ residuals) / part))
        squares.append(float(error @ error))
    return np.array(squares)


_LACK_LEVEL = 1e-3
_LEAST_LACK = 0.03  # of the half width
_TAUT = 4.0  # half widths of tension, above which the band is 96 % of the half width
_LEAST_ROWS = 20
_DEPENDENCES = {
    "pressure": ("growth", FrictionForm.PRESSURE),
    "tension": ("tension_growth", FrictionForm.TENSION),
    "contraction": ("", None),
    "rate": ("viscous", FrictionForm.VISCOUS),
}
"""Parameter that a form with a dependence estimates, and the form that has it."""


def _lack_of_fit(model: PathDependentModel, solution: PathSolution, scale: float) -> LackOfFit | None:
    """Score test of dependences that the form lacks, robust to errors common to a group of points; `scale` in N."""
    from scipy.special import stdtr

    means, used, residuals = model.means, model.used, -solution.minimum.residuals
    tension = model.components(solution.values)[0]
    side = model.band_side(solution.values)
    taut = tension > _TAUT * scale
    side = np.where(taut if np.count_nonzero(taut & used) >= _LEAST_ROWS else tension > 0, side, 0.0)
    rate = np.zeros(len(side)) if model.rate is None else model.rate
    quantities = {
        "pressure": (means.pressure - model.reference_pressure) * side,
        "tension": (tension - tension[tension > 0].mean()) * side,
        "contraction": (means.contraction - means.contraction[tension > 0].mean()) * side,
        "rate": rate * np.abs(side),
    }
    jacobian = solution.minimum.jacobian[:, solution.inside]
    lengths = np.linalg.norm(jacobian, axis=0)
    jacobian = jacobian[:, lengths > 0] / lengths[lengths > 0]
    candidates: list[tuple[float, LackOfFit]] = []
    for quantity, (parameter, remedy) in _DEPENDENCES.items():
        whole = quantities[quantity][used]
        length = float(np.linalg.norm(whole))
        if parameter in solution.free or (quantity == "rate" and "rate_growth" in solution.free) or not length:
            continue
        extended = np.column_stack([jacobian, whole / length])
        if not condition_number(extended) < np.sqrt(CONDITION_LIMIT):
            continue
        amount = np.linalg.lstsq(extended, residuals, rcond=None)[0]
        rest = residuals - extended @ amount
        variance, freedom = robust_errors(extended, rest, model.labels).variance(np.eye(len(amount))[-1:])
        p_value = 2 * float(stdtr(freedom[0], -abs(amount[-1]) / np.sqrt(variance[0])))
        force = float(abs(amount[-1])) / np.sqrt(np.count_nonzero(whole))
        if p_value < _LACK_LEVEL and force > _LEAST_LACK * scale:
            candidates.append((float(rest @ rest), LackOfFit(quantity, float(force), p_value, remedy)))
    return min(candidates, key=lambda candidate: candidate[0])[1] if candidates else None


def _presliding(model: PathDependentModel, solution: PathSolution) -> tuple[PathSolution, list[Remark]]:
    """Solution with the presliding length held if the points do not determine it, and a remark on it."""
    paths, log_presliding = model.paths, solution.values["log_presliding"]
    determined = log_presliding >= model.shortest + _AT_BOUND and solution.error("log_presliding") < _VAGUE
    if determined and paths.against <= _NOISY:
        return solution, []
    if determined:
        text = (
            f"{100 * paths.against:.2g} % of the moves are against their stroke: the noise of the length is a third of "
            f"a step ({show(paths.step, 'mm', 3)}) or more, which biases the presliding length by about its standard "
            "error"
        )
        remedy = "record the mean of more samples at each point, or take larger steps"
        return solution, [Remark.warning("presliding_length", text, remedy)]
    if "log_presliding" in solution.free:
        value = min(max(log_presliding, model.shortest), float(np.log(paths.step)))
        free = tuple(name for name in solution.free if name != "log_presliding")
        solution = model.solve({**solution.values, "log_presliding": value}, free)
    text = (
        f"the presliding length is not determined (steps of {show(paths.step, 'mm', 3)}): no point lies where friction "
        "reverses"
    )
    return solution, [Remark.warning("presliding_length", text, "measure a reversal in smaller steps")]


def _doubts(
    model: PathDependentModel, solution: PathSolution, result: HysteresisFit, half_gap: float, rejected: FrictionForm
) -> Iterable[Remark]:
    """Remarks on the pressures, the half width, parameters at a bound, the form, and the misfit of the law."""
    if len(np.unique(model.means.levels[~model.means.slack])) < 3:
        text = "fewer than three pressures: the growth of the half width with pressure is not determined"
        yield Remark.note("growth", text)
    half_width, error = solution.values["half_width"], solution.error("half_width")
    if not error < _VAGUE * half_width:
        text = f"the half width {half_width:.3g} N has a standard error of {error:.2g} N"
        why = "loading and unloading hardly differ, or the strokes are too short"
        yield Remark.warning("half_width", f"{text}: {why}")
    bounded = zip(solution.free, solution.minimum.at_bound, strict=False)
    for name in [name for name, out in bounded if out and name != "log_presliding"]:
        yield Remark.warning(name, f"{name} is at the bound of its range")
    if lack := result.lack_of_fit:
        offered = f"the form {lack.remedy.value!r} includes this" if lack.remedy else "no form includes this"
        instead = "" if rejected is result.form else f", and {result.form.value!r} takes its place"
        text = (
            f"the form {rejected.value!r} of the friction is rejected: {lack.force:.2g} N of it depend on the "
            f"{lack.quantity} (p = {lack.p_value:.1g})"
        )
        yield Remark.warning("form", text, offered + instead)
    pairs = [rows[model.used[rows]] for rows in model.paths.rows]
    first, second = (
        np.concatenate([result.residuals[rows[part]] for rows in pairs]) for part in (slice(-1), slice(1, None))
    )
    shared = float(np.sqrt(max(np.mean(first * second), 0.0))) if len(first) else 0.0
    if shared > _MISFIT * half_gap:
        text = (
            f"{type(model.template).__name__} leaves residuals of {result.rmse:.3g} N, {shared:.3g} N of them shared "
            f"by neighbouring points, against {half_gap:.3g} N of half the loop width: the misfit may be mistaken for "
            "friction or drift"
        )
        yield Remark.warning("law", text, "use a law that fits better, or a form of friction, if the law does")


def _result(
    model: PathDependentModel,
    solution: PathSolution,
    taut: Bools,
    form: FrictionForm,
    comparison: FormComparison | None,
    lack: LackOfFit | None,
) -> HysteresisFit:
    means, used, basis = model.means, model.used, model.drift
    tension, force = model.components(solution.values)
    offset = basis.points @ solution.offsets
    residuals = means.force - tension - force - offset
    points = means.select(taut)
    friction = model.friction(solution.values)
    names = [name for name in solution.free if name in model.law_names]
    errors = {name: solution.error(name) for name in (*names, *FRICTION) if not name.startswith("log_")}
    errors["rate_speed"] = solution.error("log_rate_speed") * (friction.rate_speed or 1.0)
    errors["presliding_length"] = solution.error("log_presliding") * friction.presliding_length
    order = [*names, *FRICTION]
    correlations = np.full((len(order), len(order)), np.nan)
    into, of = zip(*[(i, solution.free.index(n)) for i, n in enumerate(order) if n in solution.free], strict=True)
    correlations[np.ix_(into, into)] = solution.correlations[np.ix_(of, of)]
    drift = None
    if len(basis.time):
        drift_errors = basis.at_knots @ solution.errors[len(solution.free) :]
        rate, rate_error, _ = _drift_rate(model, solution)
        drift = SensorDrift(basis.time, basis.at_knots @ solution.offsets, drift_errors, rate, rate_error)
    law = dataclasses.replace(model.law(solution.values), domain=domain_of(points)) if names else model.template
    return HysteresisFit(
        law=law,
        friction=friction,
        form=form,
        comparison=comparison,
        lack_of_fit=lack,
        standard_errors=errors,
        correlations=correlations,
        drift=drift,
        rmse=float(np.sqrt(np.mean(residuals[used] ** 2))),
        max_error=float(np.abs(residuals[used]).max()),
        tension=tension,
        friction_force=force,
        offset=offset,
        residuals=residuals,
        points_used=int(np.count_nonzero(used)),
        points_slack=int(np.count_nonzero(~taut)),
        notes=(),
        dataset=DatasetSummary.of(points),
    )
