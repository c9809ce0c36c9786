"""Identification of a force law from measured points."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator

import numpy as np

from mckibben.component.calls import checked_call
from mckibben.dataset import IsobaricDataset
from mckibben.dataset.preprocessing import held_loads
from mckibben.errors import IdentificationError, described
from mckibben.identification.design import check_design
from mckibben.identification.estimator import (
    CONDITION_LIMIT,
    Bools,
    Floats,
    condition_number,
    standard_errors,
    unidentifiable,
)
from mckibben.identification.fit import Fit
from mckibben.identification.grouping import RESOLUTION, at_fixed_lengths, measured_weights, neighbours_apart
from mckibben.identification.least_squares import FitProblem, Solution, grid_search, project, solve
from mckibben.identification.outliers import find_outliers, without_outliers
from mckibben.identification.regression import NotIdentifiableError, Refit, Regression, pressure_blocks
from mckibben.identification.smooth import fit_smooth, smooth_refit
from mckibben.identification.summary import (
    CONTRACTION_NOISE,
    DatasetSummary,
    LeaveOnePressureOut,
    Outlier,
    domain_of,
    hull_distance,
    left_out,
    load_distance,
    off_levels,
    places_of,
    size_remarks,
    zero_remarks,
)
from mckibben.muscle import ExponentialLaw, ForceLaw, SmoothLaw, forces
from mckibben.muscle.slopes import unphysical
from mckibben.result import Remark
from mckibben.units import show

_GOOD = 0.005  # RMSE of the largest force up to which a misspecified law is a detail
_CONTRACTIONS = 6  # with fewer, a law of one contraction less is hardly determined (docs/results/intervals.md)


@checked_call
def fit_law(
    law_type: type[ForceLaw],
    dataset: IsobaricDataset,
    *,
    robust: bool = True,
) -> Fit:
    """Fit a force law to measured points by least squares.

    The fit is to the taut points, without outliers: single points that contradict the smooth
    surface through all others (docs/uncertainty.md). A warning names each by its row.

    Parameters
    ----------
    law_type
        Class of the law, such as `ExponentialLaw`.
    robust
        False to keep outliers.

    Raises
    ------
    IdentificationError
        If the points do not determine the parameters; the error names them.

    Examples
    --------
    >>> from mckibben import catalog
    >>> from mckibben.muscle import ExponentialLaw
    >>> fit = fit_law(ExponentialLaw, catalog.dataset("dmsp-10-250-martens2017"))
    >>> round(fit.law.decay, 1), round(fit.rmse, 2), round(fit.leave_one_pressure_out.rmse, 2)
    (40.0, 1.07, 1.34)
    """
    check_law_type(law_type)
    return fit_means(law_type, dataset, find_outliers(dataset) if robust else ())


def check_law_type(kind: object) -> None:
    """Raise an `IdentificationError` unless a value is a class of laws."""
    if not (isinstance(kind, type) and issubclass(kind, ForceLaw)):
        remedy = "give the class, such as ExponentialLaw: fit_law(ExponentialLaw, data)"
        raise IdentificationError(f"{described(kind)} is not a class of laws", remedy=remedy)


def fit_means(law_type: type[ForceLaw], means: IsobaricDataset, outliers: tuple[Outlier, ...]) -> Fit:
    """Fit a law to points without the outliers.

    A law with smooth deviations may be replaced by a simpler one, as a note then explains.

    Raises
    ------
    IdentificationError
        If there are too few points, points outside the validity of the law, or parameters that they do not determine.
    """
    means = without_outliers(means, outliers)
    taut = means.taut
    _check_count(ExponentialLaw if law_type is SmoothLaw else law_type, taut, slack=len(means) - len(taut))
    check_design(taut)
    points = _within_validity(law_type, taut)
    solution, refit, simpler = _solved(law_type, points)
    problem, law_type = solution.problem, solution.problem.law_type
    parameters = law_type.parameters()
    at_bound = solution.at_bound
    _check_determined(problem, solution, at_bound, points)
    if at_bound.all():
        raise IdentificationError(
            f"every parameter of {law_type.__name__} is at a bound of its range: the law cannot describe the points",
            remedy="look for wrong units in the data",
        )
    residuals = solution.residuals
    errors, correlations = standard_errors(solution.augmented[1], solution.augmented[0], at_bound)
    regression = Regression(points, problem, solution, at_bound, refit)
    ungrouped = regression.default_grouping[1]

    fitted = points.force - residuals
    good = float(np.sqrt(np.mean(residuals**2))) < _GOOD * float(fitted.max())
    doubt = Remark.note if good else Remark.warning  # a law that describes the points may be misspecified
    notes = [Remark.warning("law", f"Eq. 2 is fitted in place of SmoothLaw: {simpler}")] if simpler else []
    notes += _bound_remarks(law_type, solution, at_bound, doubt)
    if off := off_levels(points):
        text = f"measured pressures are up to {show(off, 'bar')} off the set ones"
        notes.append(Remark.warning("pressure", f"{text}: the domain is the range of the measured pressures"))
    notes += _friction_remarks(points, residuals)
    notes += left_out(outliers)
    notes += size_remarks(points, residuals, problem.weights[: len(points)])
    notes += zero_remarks(means, float(np.sqrt(np.mean(residuals**2))))
    if ungrouped:
        notes.append(Remark.note("standard_errors", f"the standard errors are for independent points: {ungrouped}"))
    lopo, reason = _leave_one_pressure_out(regression)
    notes += [Remark.warning("leave_one_pressure_out", reason)] if reason else []
    if (count := len(np.unique(np.round(points.contraction / RESOLUTION)))) < _CONTRACTIONS:
        text = f"between {count} contractions the error of the law is not known, and not in the prediction interval"
        notes.append(Remark.note("contraction", text, f"measure at {_CONTRACTIONS} or more"))
    law = dataclasses.replace(problem.law(solution.values), domain=domain_of(points, means))
    notes += _severe_remarks(law, lopo, points)
    return Fit(
        law=law,
        standard_errors={p.name: float(error) for p, error in zip(parameters, errors, strict=True)},
        correlations=correlations,
        rmse=float(np.sqrt(np.mean(residuals**2))),
        max_error=float(np.abs(residuals).max()),
        points_used=len(points),
        points_slack=len(means) - len(points),
        leave_one_pressure_out=lopo,
        notes=tuple(notes),
        dataset=DatasetSummary.of(points),
        residuals=residuals,
        robust=regression.robust_errors,
        regression=regression,
        outliers=outliers,
    )


def _solved(law_type: type[ForceLaw], points: IsobaricDataset) -> tuple[Solution, Refit | None, str]:
    """Solution, for smooth laws its refit to parts of the points, and why Eq. 2 is enough, if it is."""
    if law_type is SmoothLaw:
        eq2 = FitProblem.of(ExponentialLaw, points)
        start = solve(eq2, grid_search(eq2)).position
        solution, simpler = fit_smooth(points, np.ones(len(points), bool), start)
        return solution, None if simpler else smooth_refit(points, start), simpler
    problem, start = _weighted(FitProblem.of(law_type, points), points)
    return solve(problem, start), None, ""


def _weighted(problem: FitProblem, points: IsobaricDataset) -> tuple[FitProblem, Floats]:
    """Problem with residuals of the measured quantity, and the position of least residuals on a grid of the shape.

    Where the load is held, the weights at each position are those of the law there: of another one the slope may be
    far off, as loads are few. Positions at which the law has parameters out of their range do not count.
    """
    if held_loads(points.table) is None:
        return problem, grid_search(problem)
    best = np.inf, problem, np.full(len(problem.cube.parameters), 0.5)
    for position in problem.cube.grid():
        trial, values = problem, project(problem, position).values
        try:
            for _ in range(3):
                weights = measured_weights(problem.law(values), points, scaled=False)
                trial = problem.weighted(weights / np.sqrt(np.mean(weights**2)))
                values = project(trial, position).values
            misfit = float(np.sum((weights * (points.force - tension_of(problem.law(values), points))) ** 2))
        except IdentificationError:
            continue
        if misfit < best[0]:
            best = misfit, trial, position
    return best[1:]


def law_of(law_type: type[ForceLaw], points: IsobaricDataset) -> ForceLaw:
    """Law of the taut points by least squares, without the checks and errors of `fit_means`."""
    solution = _solved(law_type, _within_validity(law_type, points.taut))[0]
    return solution.problem.law(solution.values)


def tension_of(law: ForceLaw, points: IsobaricDataset) -> Floats:
    """Tension [N] of a law at points, shape (points,)."""
    return np.maximum(forces(law, points.contraction, points.pressure), 0.0)


def _check_count(law_type: type[ForceLaw], points: IsobaricDataset, slack: int) -> None:
    needed = len(law_type.parameters()) + 1
    if len(points) < needed:
        raise IdentificationError(
            f"{len(points)} taut points ({slack} slack ones left out) cannot determine the "
            f"{needed - 1} parameters of {law_type.__name__}",
            value=len(points),
            lower=needed,
            remedy=f"measure at least {needed}, or use a law with fewer parameters",
        )


def _within_validity(law_type: type[ForceLaw], points: IsobaricDataset) -> IsobaricDataset:
    """Move points outside the law's contraction range by no more than noise to its limit; refuse others."""
    valid = law_type.formula_domain
    contraction = np.clip(points.contraction, float(valid.contraction_min), float(valid.contraction_max))
    near = np.abs(contraction - points.contraction) <= CONTRACTION_NOISE
    contraction = np.where(near, contraction, points.contraction)
    beyond = ~np.asarray(valid.contains(contraction, points.levels))
    if beyond.any():
        raise IdentificationError(
            f"{law_type.__name__} is not valid at {np.count_nonzero(beyond)} of the {len(points)} taut points: it is "
            f"made for {valid.bounds()}",
            remedy="leave these points out, or use another law",
        )
    if np.array_equal(contraction, points.contraction):
        return points
    return IsobaricDataset(points.table.assign(contraction=("point", contraction)))


def _check_determined(problem: FitProblem, solution: Solution, at_bound: Bools, points: IsobaricDataset) -> None:
    free = solution.augmented[1][:, ~at_bound]
    names = [name for name, out in zip(problem.names, at_bound, strict=True) if not out]
    number = condition_number(free)
    if at_bound.any() and number < CONDITION_LIMIT:
        # An undetermined shape parameter may end at a bound: then it is not determined inside its range either.
        middle = project(problem, np.full_like(solution.position, 0.5))
        amid = problem.response(middle.values)[1]
        if np.isfinite(middle.cost) and not condition_number(amid) < CONDITION_LIMIT:
            free, names, number = amid, list(problem.names), condition_number(amid)
    if not number < CONDITION_LIMIT:
        contractions = len(np.unique(points.contraction.round(6)))
        raise IdentificationError(
            f"{len(points)} taut points at {len(points.pressures)} pressure(s) and {contractions} contraction(s) "
            f"do not determine {', '.join(unidentifiable(free, names))} of {problem.law_type.__name__} "
            f"(condition number {number:.1e})",
            value=number,
            upper=CONDITION_LIMIT,
            remedy="measure at more pressures and contractions, or use a law with fewer parameters",
        )
    if not solution.converged:
        raise IdentificationError(
            f"the fit of {problem.law_type.__name__} did not converge "
            f"(RMSE {np.sqrt(np.mean(solution.residuals**2)):.3g} N where it stopped)",
            remedy="look for outliers and wrong units in the data",
        )


def _bound_remarks(
    law_type: type[ForceLaw], solution: Solution, at_bound: Bools, doubt: Callable[[str, str, str], Remark]
) -> Iterator[Remark]:
    for p, value, bound in zip(law_type.parameters(), solution.values, at_bound, strict=True):
        span = f"{show(p.lower, p.shown)} .. {show(p.upper, p.shown)}"
        if bound:
            remedy = "the law is probably misspecified: see how others fit (mk.rank, or --law all)"
            text = f"{p.name} is at the bound of its range {span}: it has no standard error"
            yield doubt(p.name, text, "" if solution.problem.prior is not None else remedy)
        elif not p.lower <= value <= p.upper:
            yield Remark.warning(p.name, f"{p.name} = {show(value, p.shown)} is outside its range {span}")


def _friction_remarks(points: IsobaricDataset, residuals: Floats) -> Iterator[Remark]:
    """Remarks on residuals that differ by direction or phase, and so are not independent."""
    rms = float(np.sqrt(np.mean(residuals**2)))
    for column, words in (("direction", points.directions), ("phase", points.phases)):
        labels = points.table[column].to_numpy() if len(words) > 1 else None
        gap = 0.0 if labels is None else float(np.ptp([np.mean(residuals[labels == word]) for word in words]))
        if labels is None or gap < rms or (column == "direction" and at_fixed_lengths(points)):  # of few points
            continue
        text = (
            f"{' and '.join(words)} differ by {gap:.3g} N on average: most of the residual is friction, which is not "
            "independent from point to point, so the standard errors are not valid"
        )
        remedy = "" if "friction" in points.table.attrs else WITH_FRICTION
        if column == "phase":
            remedy = "to identify the friction, record strokes in both directions at constant pressures as well"
        yield Remark.warning("friction", text, remedy)


def _severe_remarks(law: ForceLaw, lopo: LeaveOnePressureOut | None, points: IsobaricDataset) -> Iterator[Remark]:
    """Remarks on a law that no muscle has, or that predicts worse than the mean of all forces.

    Beyond the points, as at the highest load or between the lowest and the corner of the box, it is only not
    determined.
    """
    remedy = "look for wrong units and columns, measure at more pressures, or use a law with fewer parameters"
    spread = float(np.std(points.force))
    held, unit = ("pressures", "bar") if held_loads(points.table) is None else ("loads", "N")
    if lopo is not None and lopo.rmse > spread:
        text = f"{held} left out are predicted worse ({show(lopo.rmse, 'N', 3)}) than by the mean of all forces"
        yield Remark.severe("leave_one_pressure_out", text, remedy)
    elif lopo is not None and max(lopo.by_level.values()) > spread:
        level = max(lopo.by_level, key=lambda level: lopo.by_level[level])
        text = f"without {show(level, unit, 3)} the law is another there: the {held} do not determine it beyond them"
        yield Remark.warning("leave_one_pressure_out", text, f"measure at more {held}, or stay within them")
    if wrong := unphysical(law, measured=True):
        yield Remark.severe("law", f"the law is not that of a muscle: {wrong}", remedy)
    elif wrong := unphysical(law):
        text = f"beyond the points the law is not determined: {wrong}"
        yield Remark.warning("law", text, "measure there, or stay within the points")


WITH_FRICTION = "identify the friction with identify_hysteresis (command line: --friction on)"
_NO_CROSS_VALIDATION = "there is no cross-validation by pressure, and the misfit of the law is not in the intervals"


def _leave_one_pressure_out(regression: Regression) -> tuple[LeaveOnePressureOut | None, str]:
    """Cross-validation errors, or the reason why there are none.

    An end of the levels that is predicted worse than by the mean of all forces is no error inside of them.
    """
    points = regression.points
    loads = held_loads(points.table)
    levels, reason = pressure_blocks(points) if loads is None else (loads, "")
    if levels is None:
        return None, f"{_NO_CROSS_VALIDATION}: {reason}"
    try:
        cross = regression.cross_validated("pressure", levels)
    except NotIdentifiableError as error:
        block = show(float(error.block), "bar" if loads is None else "N")
        return None, f"without the points at {block} {error.reason}: {_NO_CROSS_VALIDATION}"
    by_level = {float(level): error for level, error in cross.by_block.items()}
    ends = [levels == end for end in (levels.min(), levels.max())]
    places, box = places_of(points), domain_of(points)
    if loads is None:
        reach = [float(hull_distance(box, places[out], places[~out]).max()) or np.inf for out in ends]
    else:
        reach = [
            float(load_distance(points.force[out], points.force[~out]).max() / np.ptp(points.force)) for out in ends
        ]
    rates = by_level[float(levels.min())] / reach[0], by_level[float(levels.max())] / reach[1]
    if loads is not None:  # the sides of the pressure are not those of the load
        rates = max(rates), max(rates)
    far = [out for out in ends if by_level[float(levels[out][0])] > np.std(points.force)]
    inside = ~np.any(far, axis=0) if 0 < len(far) < len(by_level) else np.ones(len(points), bool)
    residuals = cross.residuals[inside]
    rmse, noise = np.sqrt(np.mean(residuals**2)), neighbours_apart(residuals, points.select(inside))
    return LeaveOnePressureOut(float(rmse), float(np.abs(residuals).max()), by_level, rates, noise), ""
