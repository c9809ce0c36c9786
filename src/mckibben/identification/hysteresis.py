"""Identification of a force law, its hysteresis and the drift of the force sensor from an isobaric test."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

import numpy as np

from mckibben.component.calls import checked_call
from mckibben.dataset import IsobaricDataset
from mckibben.dataset.schema import text_table
from mckibben.errors import IdentificationError
from mckibben.identification.estimator import Bools, Floats
from mckibben.identification.fit import DatasetSummary, Fit, counted, domain_of, left_out
from mckibben.identification.fitting import identify
from mckibben.identification.friction_forms import (
    FormComparison,
    FrictionForm,
    LackOfFit,
    PathSolution,
    compare_forms,
    drift_rate,
    form_start,
    lack_of_fit,
    least_squares,
    solve,
    systematic_residual,
    with_drift,
)
from mckibben.identification.loading_path import (
    FRICTION,
    DriftBasis,
    LoadingPaths,
    PathDependentModel,
    clipped,
    loop_half_width,
)
from mckibben.identification.outliers import find_outliers
from mckibben.muscle import ForceLaw, MaxwellSlip, Muscle, Specimen
from mckibben.notebook import draw, html_table
from mckibben.units import factor, mm, show


@dataclass(frozen=True, eq=False)
class SensorDrift:
    """Zero offset of the force sensor and its errors [N], linear between knots [s]; shape (knots,) each."""

    time: Floats
    offset: Floats
    standard_errors: Floats
    rate: float
    """Mean rate [N/s]: slope of the least-squares line through the knots."""
    rate_error: float
    """Standard error of the mean rate [N/s], robust to errors common to a loading path."""


@dataclass(frozen=True, eq=False, repr=False)
class HysteresisFit:
    """Law and friction identified together, by `identify_hysteresis`.

    Attributes
    ----------
    law
        Static law, midway between loading and unloading; its domain is the range of the points.
    friction
        Hysteresis, with the parameters of its form.
    form, comparison, lack_of_fit
        Form of the friction; comparison of the forms by held-out loops, None if the form was given; and significant
        dependence that the form lacks, None if there is none.
    standard_errors, correlations
        By parameter, in SI, in this order: the law's parameters (unless the law was given), ``half_width``, ``growth``,
        ``tension_growth``, ``viscous``, ``viscous_growth``, ``viscous_length_growth``, ``rate_growth``, ``rate_speed``
        and ``presliding_length``; NaN if the form lacks it or the data do not determine it.
    drift
        Drift of the force sensor; None if not significant (1 %).
    rmse, max_error
        Root mean square and largest absolute residual [N].
    tension, friction_force, offset, residuals
        Shape (points,), in dataset order: force of the law, of friction, offset of the sensor, and measured minus
        modelled force [N]. Slack points count only if there is drift.
    points_used, points_slack, warnings, dataset
        Number of points used and of slack points; reasons not to rely on the results; summary of the data.
    """

    law: ForceLaw
    friction: MaxwellSlip
    form: FrictionForm
    comparison: FormComparison | None
    lack_of_fit: LackOfFit | None
    standard_errors: dict[str, float]
    correlations: Floats
    drift: SensorDrift | None
    rmse: float
    max_error: float
    tension: Floats
    friction_force: Floats
    offset: Floats
    residuals: Floats
    points_used: int
    points_slack: int
    warnings: tuple[str, ...]
    dataset: DatasetSummary

    @property
    def force(self) -> Floats:
        """Modelled force at each point [N], shape (points,)."""
        return self.tension + self.friction_force + self.offset

    @property
    def undetermined(self) -> tuple[str, ...]:
        """Parameters of the friction that a simulation needs and the data do not determine."""
        unknown = "half_width" in self.form.free and bool(np.isnan(self.standard_errors["presliding_length"]))
        return ("presliding_length",) if unknown else ()

    def plot(self, data: IsobaricDataset) -> Any:
        """Return a figure of the loops of the identified points, see `mckibben.report.loops`."""
        return draw("loops", data, self)

    def muscle(self, specimen: Specimen) -> Muscle:
        """Muscle with the law and its friction."""
        return Muscle(specimen, self.law, self.friction)

    def corrected(self, dataset: IsobaricDataset) -> IsobaricDataset:
        """Plateau means of the identified dataset without friction and drift, for fitting a static law.

        Points that are slack, as measured or by the law, remain slack.
        """
        means = dataset.plateau_means()
        if len(means) != len(self.residuals) or not np.allclose(means.force, self.force + self.residuals):
            raise IdentificationError(
                f"{means!r} is not the dataset that the hysteresis was identified from", remedy="give the whole dataset"
            )
        force = np.where(means.slack, means.force, means.force - self.friction_force - self.offset)
        force = np.where(self.tension > 0, force, np.minimum(force, means.table.attrs["slack_force"]))
        return IsobaricDataset(means.table.assign(force=("point", force)).assign_attrs(friction="subtracted"))

    def rows(self) -> list[tuple[str, str, str, str]]:
        """Name, estimate, standard error and unit of the parameters of the friction, as text."""
        growth_at = show(self.friction.reference_tension, "N", 3)
        if self.form is not FrictionForm.TENSION:
            growth_at = show(self.friction.reference_pressure, "bar", 3)
        rows = []
        for name, (label, digits, unit, text) in _SHOWN.items():
            if value := getattr(self.friction, name):
                error = self.standard_errors[name] / factor(unit)
                shown = f"{error:.2g}" if np.isfinite(error) else "-"
                rows.append((label, f"{value / factor(unit):.{digits}g}", shown, (text or unit).format(growth_at)))
        return rows

    def report(self) -> str:
        """Fit as text."""
        lines = [
            f"{type(self.law).__name__} with friction of the form {self.form.value!r}",
            f"{self.dataset.specimen or 'unnamed specimen'}: {self.points_used} points used, {self.points_slack} slack",
            "",
            *text_table([("", "estimate", "standard error", ""), *self.rows()], (0, 3)),
        ]
        if self.drift is not None:
            rate, error = 3600 * self.drift.rate, 3600 * self.drift.rate_error
            lines.append(f"drift of the force sensor: {rate:+.3g} N/h on average, standard error {error:.2g} N/h")
        lines.append(f"residuals: RMSE {self.rmse:.3g} N, maximum {self.max_error:.3g} N")
        lines += [self.comparison.describe()] if self.comparison else []
        lines += [f"warning: {warning}" for warning in self.warnings]
        return "\n".join(lines)

    def __repr__(self) -> str:
        return (
            f"<HysteresisFit {type(self.law).__name__}: half width {self.friction.half_width:.3g} N, presliding length "
            f"{self.friction.presliding_length / mm:.3g} mm, RMSE {self.rmse:.3g} N{counted(self.warnings)}>"
        )

    def _repr_html_(self) -> str:
        return html_table(repr(self), ("friction", "estimate", "standard error", "unit"), self.rows(), self.warnings)


_SHOWN = {
    "half_width": ("half width", 4, "N", "N at {}"),
    "growth": ("growth", 3, "N/bar", ""),
    "tension_growth": ("tension growth", 3, "1", "N/N"),
    "viscous": ("viscous", 4, "N*s/m", ""),
    "viscous_growth": ("viscous growth", 3, "N*s/m/bar", ""),
    "viscous_length_growth": ("by length", 3, "N*s/m/mm", ""),
    "rate_growth": ("rate growth", 3, "1", "of the half width"),
    "rate_speed": ("rate speed", 3, "mm/s", ""),
    "presliding_length": ("presliding length", 4, "mm", ""),
}
"""Label, digits and unit of the parameters of the friction in tables, and text in place of the unit."""

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
    >>> found = identify_hysteresis(ExponentialLaw, SimulatedIsobaricTest(muscle).run(protocol, seed=1))
    >>> round(found.friction.half_width, 1), round(found.friction.presliding_length / mm, 2)
    (12.0, 0.5)
    """
    law = law.law if isinstance(law, Fit) else law
    means = dataset.plateau_means()
    paths = LoadingPaths.of(means)
    taut = ~means.slack
    bases = DriftBasis.candidates(paths, means)[: None if drift else 1]
    used = taut | (any(basis.has_offset for basis in bases) and not clipped(means))
    rate = paths.rate(means)
    used &= (rate is None) | ~paths.at_reversal(means)
    # Friction that varies with the rate is not an outlier.
    outliers = find_outliers(means) if robust and rate is None else ()
    used &= ~np.isin(np.arange(len(means)) + 1, [one.row for one in outliers])
    known = law if isinstance(law, ForceLaw) else None
    law_type = type(law) if isinstance(law, ForceLaw) else law
    levels = np.unique(means.levels[taut])
    half_gap = loop_half_width(means, taut)
    template = known or identify(law_type, means, robust=robust).law
    model = PathDependentModel(
        template, paths, means, bases[0], used, float(levels.mean()), elements, float(means.force[taut].mean()), rate
    )
    of_law = () if known else model.law_names
    _check_count(model, (*of_law, *FrictionForm.CONSTANT.free), bases[-1])
    start = dict.fromkeys(FRICTION, 0.0) | {"half_width": half_gap, "log_presliding": float(np.log(paths.step))}
    model, start = _started(model, start)
    for _ in range(0 if known else _ROUNDS):  # a better start: alternate friction and law
        friction = model.components(start)[1]
        corrected = IsobaricDataset(means.table.assign(force=("point", means.force - friction)))
        try:
            model = dataclasses.replace(model, template=identify(law_type, corrected, robust=robust).law)
        except (IdentificationError, np.linalg.LinAlgError):
            break  # the start is good enough
        model, start = _started(model, start)
    warnings = left_out(outliers)
    for name in _shapes_at_bound(model.template) & set(of_law):
        of_law = _without(of_law, name)
        warnings.append(f"{name} is held at the bound of its range: the law is probably misspecified")
    start |= {name: float(getattr(model.template, name)) for name in model.law_names}

    comparison = None
    if form is None:
        comparison, start = compare_forms(dataclasses.replace(model, drift=bases[-1]), start, of_law)
        form = comparison.chosen
    else:
        _check_form(model, form, levels)
        start = form_start(model, start, form)
    free = (*of_law, *form.free)
    model, found = with_drift(model, bases, start, free)
    if len(levels) < 3:
        warnings.append("fewer than three pressures: the growth of the half width with pressure is not determined")
    log_presliding = found.values["log_presliding"]
    determined = log_presliding >= model.shortest + _AT_BOUND and found.error("log_presliding") < _VAGUE
    if "half_width" in form.free and not determined:
        if "log_presliding" in found.free:
            value = min(max(log_presliding, model.shortest), float(np.log(paths.step)))
            found = solve(model, {**found.values, "log_presliding": value}, _without(found.free, "log_presliding"))
        warnings.append(
            f"the presliding length is not determined (steps of {show(paths.step, 'mm', 3)}): no point lies where "
            "friction reverses; measure a reversal in smaller steps"
        )
    elif "half_width" in form.free and paths.against > _NOISY:
        warnings.append(
            f"{100 * paths.against:.2g} % of the moves are against their stroke: the noise of the length is a third of "
            f"a step ({show(paths.step, 'mm', 3)}) or more, which biases the presliding length by about its standard "
            "error; record the mean of more samples at each point, or take larger steps"
        )
    half_width, error = found.values["half_width"], found.error("half_width")
    if "half_width" in form.free and not error < _VAGUE * half_width:
        warnings.append(
            f"the half width {half_width:.3g} N has a standard error of {error:.2g} N: loading and unloading hardly "
            "differ, or the strokes are too short"
        )
    warnings += [f"{name} is at the bound of its range" for name in found.at_bound]
    lack, rejected = lack_of_fit(model, found, half_gap), form
    if lack is None and form in (FrictionForm.PRESSURE, FrictionForm.TENSION):
        # A dependence on contraction may be mistaken for growth, which hides it if there are few paths.
        rejected = FrictionForm.CONSTANT
        simpler = least_squares(model, form_start(model, found.values, rejected), (*of_law, *rejected.free))
        lack = lack_of_fit(model, simpler, half_gap)
        lack = lack if lack and lack.remedy is None else None
    instead = "" if rejected is form else f", and {form.value!r} takes its place"
    warnings += [lack.describe(rejected) + instead] if lack else []
    answer = _result(model, found, taut, form, comparison, lack, tuple(warnings))
    systematic = systematic_residual(model, answer.residuals)
    if systematic <= _MISFIT * half_gap:
        return answer
    misfit = (
        f"{type(model.template).__name__} leaves residuals of {answer.rmse:.3g} N, {systematic:.3g} N of them shared "
        f"by neighbouring points, against {half_gap:.3g} N of half the loop width: the misfit may be mistaken for "
        "friction or drift; use a law that fits better, or a form of friction, if the law does"
    )
    return dataclasses.replace(answer, warnings=(*answer.warnings, misfit))


def _started(model: PathDependentModel, start: dict[str, float]) -> tuple[PathDependentModel, dict[str, float]]:
    """Best of the models: which branch paths start on, and whether the muscle rested at turning points or overshot."""
    models = [
        dataclasses.replace(model, paths=dataclasses.replace(model.paths, side=side, overshot=overshot))
        for overshot in (False, True)[: 1 + bool(model.paths.turns.any())]
        for side in (model.paths.side, -model.paths.side)
    ]
    found = [least_squares(each, start, ("half_width", "log_presliding"), max_nfev=20) for each in models]
    best = int(np.argmin([one.cost for one in found]))
    return models[best], found[best].values


def _check_form(model: PathDependentModel, form: FrictionForm, levels: Floats) -> None:
    """Reject a form that the data do not determine."""
    if "growth" in form.free and len(levels) < 3:
        message = f"friction of the form {form.value!r} needs three pressures, not {len(levels)}"
        remedy = "measure at more pressures, or choose another form"
        raise IdentificationError(message, value=len(levels), lower=3, remedy=remedy)
    if form.follows_rate and model.rate is None:
        raise IdentificationError(
            f"friction of the form {form.value!r} needs times at which the speed varies",
            remedy="give the times of motions at several speeds, or choose another form",
        )


def _without(names: tuple[str, ...], name: str) -> tuple[str, ...]:
    return tuple(other for other in names if other != name)


def _shapes_at_bound(law: ForceLaw) -> set[str]:
    return {
        p.name
        for p in law.shape_parameters
        if not _EDGE < (float(getattr(law, p.name)) - p.lower) / (p.upper - p.lower) < 1 - _EDGE
    }


def _check_count(model: PathDependentModel, free: tuple[str, ...], drift: DriftBasis) -> None:
    needed, count = len(free) + drift.points.shape[1] + 1, int(np.count_nonzero(model.used))
    if count < needed:
        message = f"{count} points cannot determine {needed - 1} parameters of law, friction and drift"
        remedy = f"measure at least {needed}, or give a law that is known"
        raise IdentificationError(message, value=count, lower=needed, remedy=remedy)


def _result(
    model: PathDependentModel,
    found: PathSolution,
    taut: Bools,
    form: FrictionForm,
    comparison: FormComparison | None,
    lack: LackOfFit | None,
    warnings: tuple[str, ...],
) -> HysteresisFit:
    means, used, basis = model.means, model.used, model.drift
    tension, force = model.components(found.values)
    offset = basis.points @ found.offsets
    residuals = means.force - tension - force - offset
    points = means.select(taut)
    friction = model.friction(found.values)
    names = [name for name in found.free if name in model.law_names]
    errors = {name: found.error(name) for name in (*names, *FRICTION) if not name.startswith("log_")}
    errors["rate_speed"] = found.error("log_rate_speed") * (friction.rate_speed or 1.0)
    errors["presliding_length"] = found.error("log_presliding") * friction.presliding_length
    order = [*names, *FRICTION]
    correlations = np.full((len(order), len(order)), np.nan)
    places = [(i, found.free.index(name)) for i, name in enumerate(order) if name in found.free]
    into, of = zip(*places, strict=True)
    correlations[np.ix_(into, into)] = found.correlations[np.ix_(of, of)]
    law = model.template
    if names:
        law = dataclasses.replace(model.law(found.values), domain=domain_of(points))
    drift = None
    if len(basis.time):
        drift_errors = basis.at_knots @ found.errors[len(found.free) :]
        rate, rate_error, _ = drift_rate(model, found)
        drift = SensorDrift(basis.time, basis.at_knots @ found.offsets, drift_errors, rate, rate_error)
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
        warnings=warnings,
        dataset=DatasetSummary.of(points),
    )
