"""Identification of a force law, its hysteresis and the drift of the force sensor from an isobaric test."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from mckibben.dataset import IsobaricDataset
from mckibben.errors import IdentificationError
from mckibben.identification.fit import DatasetSummary, Fit, domain_of
from mckibben.identification.fitting import identify
from mckibben.identification.loading_path import (
    FRICTION,
    DriftBasis,
    LoadingPaths,
    PathDependentModel,
    loop_half_width,
)
from mckibben.identification.uncertainty import (
    CONDITION_LIMIT,
    Bools,
    Floats,
    condition_number,
    uncertainty,
    unidentifiable,
)
from mckibben.muscle import ForceLaw, MaxwellSlip, Muscle, Specimen
from mckibben.notebook import html_table
from mckibben.units import bar, mm, show


@dataclass(frozen=True, eq=False)
class SensorDrift:
    """Zero offset of the force sensor and its errors [N], linear between knots [s]; shape (knots,) each."""

    time: Floats
    offset: Floats
    standard_errors: Floats

    @property
    def rate(self) -> float:
        """Mean rate [N/s]: slope of the least-squares line through the knots."""
        return float(np.polyfit(self.time - self.time[0], self.offset, 1)[0])


@dataclass(frozen=True, eq=False, repr=False)
class HysteresisFit:
    """Law and friction identified together, by `identify_hysteresis`.

    Attributes
    ----------
    law
        Static law, midway between loading and unloading; its domain is the range of the points.
    friction
        Hysteresis; its viscous part is 0, as points measured at rest do not determine it.
    standard_errors, correlations
        By parameter, in SI, and in their order: those of the law unless it was given, ``half_width``, ``growth`` and
        ``presliding_length``; NaN where the data do not determine one.
    drift
        Drift of the force sensor; None where the points show none.
    rmse, max_error
        Root mean square and largest absolute residual [N].
    tension, friction_force, offset, residuals
        Shape (points,), in the order of the dataset: force of the law, of friction, offset of the sensor, and measured
        minus modelled force [N]. Slack points count only where there is a drift.
    points_used, points_slack, warnings, dataset
        Number of points used, and of slack ones; reasons not to rely on the results; summary of the data.
    """

    law: ForceLaw
    friction: MaxwellSlip
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

    def muscle(self, specimen: Specimen) -> Muscle:
        """Muscle with the law and its friction."""
        return Muscle(specimen, self.law, self.friction)

    def corrected(self, dataset: IsobaricDataset) -> IsobaricDataset:
        """Plateau means of the identified dataset without friction and drift, for the fit of a static law."""
        means = dataset.plateau_means()
        if len(means) != len(self.residuals) or not np.allclose(means.force, self.force + self.residuals):
            raise IdentificationError(
                f"{means!r} is not the dataset that the hysteresis was identified from",
                remedy="give the whole dataset",
            )
        force = means.force - self.friction_force - self.offset
        return IsobaricDataset(means.table.assign(force=("point", force)))

    def _rows(self) -> list[tuple[str, str, str, str]]:
        friction, errors, length = self.friction, self.standard_errors, self.friction.presliding_length
        reference = f"at {show(friction.reference_pressure, 'bar', 3)}"
        return [
            (name, value, f"{error:.2g}" if np.isfinite(error) else "-", unit)
            for name, value, error, unit in (
                ("half width", f"{friction.half_width:.4g}", errors["half_width"], f"N {reference}"),
                ("growth", f"{friction.growth * bar:.3g}", errors["growth"] * bar, "N/bar"),
                ("presliding length", f"{length / mm:.4g}", errors["presliding_length"] / mm, "mm"),
            )
        ]

    def report(self) -> str:
        """Fit as text."""
        lines = [
            f"{type(self.law).__name__} with Maxwell-slip friction of {self.friction.elements} elements",
            f"{self.dataset.specimen or 'unnamed specimen'}: {self.points_used} points used, {self.points_slack} slack",
            "",
            f"{'':17}  {'estimate':>8}  {'standard error':>14}",
            *(f"{name:17}  {value:>8}  {error:>14}  {unit}" for name, value, error, unit in self._rows()),
        ]
        if self.drift is not None:
            lines.append(f"drift of the force sensor: {self.drift.rate * 3600:+.3g} N/h on average")
        lines.append(f"residuals: RMSE {self.rmse:.3g} N, maximum {self.max_error:.3g} N")
        lines += [f"warning: {warning}" for warning in self.warnings]
        return "\n".join(lines)

    def __repr__(self) -> str:
        return (
            f"<HysteresisFit {type(self.law).__name__}: half width {self.friction.half_width:.3g} N, presliding length "
            f"{self.friction.presliding_length / mm:.3g} mm, RMSE {self.rmse:.3g} N>"
        )

    def _repr_html_(self) -> str:
        return html_table(repr(self), ("friction", "estimate", "standard error", "unit"), self._rows(), self.warnings)


_SIGNIFICANT = 3.0  # standard errors: a smaller growth with pressure is taken for 0
_AT_BOUND = 1e-2  # of the logarithm of the presliding length
_EDGE = 1e-6  # of the range of a shape parameter
_MISFIT = 0.25  # of half the loop width: larger residuals of the law may pass for friction
_ROUNDS = 2
_VAGUE = 0.3  # relative standard error above which a parameter is not determined


def identify_hysteresis(
    law: type[ForceLaw] | ForceLaw | Fit, dataset: IsobaricDataset, *, drift: bool = True, elements: int = 6
) -> HysteresisFit:
    """Fit a law and its friction to all points of an isobaric test, in the order of time.

    The force at a point is that of the law, that of friction after the loading path to there, and the sensor's offset,
    all estimated together by least squares. Each path begins on the branch of its first stroke: loading before an
    unloading stroke and vice versa.

    The drift of the sensor is none, a straight line, or linear with a knot for each path with slack points, whichever
    has the least Bayesian information criterion. It needs times; without slack points it is at most a line from 0.

    Parameters
    ----------
    law
        Class of the law to fit; or a law (or fit) that is known.
    dataset
        Directions, initial length, and nominal pressures where measured ones scatter, in the order of the test or with
        times.
    drift
        True to estimate a drift.
    elements
        Number of Maxwell-slip elements.

    Raises
    ------
    IdentificationError
        If the points do not determine the hysteresis: one direction alone, rows that are not in the order of a test,
        too few points, or correlated parameters.

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
    used = taut | any(basis.has_offset for basis in bases)
    known = law if isinstance(law, ForceLaw) else None
    law_type = type(law) if isinstance(law, ForceLaw) else law
    levels = np.unique(means.levels[taut])
    half_gap = loop_half_width(means, taut)
    start = {"half_width": half_gap, "growth": 0.0, "log_presliding": float(np.log(paths.step))}
    template = known or identify(law_type, means).law
    model = PathDependentModel(template, paths, means, bases[0], used, float(levels.mean()), elements)
    free = FRICTION if known else (*model.law_names, *FRICTION)
    _check_count(model, free, bases[-1])
    for _ in range(0 if known else _ROUNDS):  # a better start: friction and law in turn
        start = _least_squares(model, start, ("half_width", "log_presliding"), max_nfev=20).values
        friction = model.components(start)[1]
        corrected = IsobaricDataset(means.table.assign(force=("point", means.force - friction)))
        try:
            model = dataclasses.replace(model, template=identify(law_type, corrected).law)
        except (IdentificationError, np.linalg.LinAlgError):
            break  # the start is good enough
    warnings: list[str] = []
    for name in _shapes_at_bound(model.template) & set(free):
        free = _without(free, name)
        warnings.append(f"{name} is held at the bound of its range: the law is probably misspecified")
    start |= {name: float(getattr(model.template, name)) for name in model.law_names}

    growth_known = len(levels) >= 3
    model, found = _with_drift(model, bases, start, free if growth_known else _without(free, "growth"))
    if growth_known and abs(found.values["growth"]) < _SIGNIFICANT * found.error("growth"):
        found = _solve(model, {**found.values, "growth": 0.0}, _without(found.free, "growth"))
    elif not growth_known:
        warnings.append("fewer than three pressures: the growth of the half width with pressure is not determined")
    log_presliding = found.values["log_presliding"]
    if log_presliding < model.shortest + _AT_BOUND or not found.error("log_presliding") < _VAGUE:
        value = min(max(log_presliding, model.shortest), float(np.log(paths.step)))
        found = _solve(model, {**found.values, "log_presliding": value}, _without(found.free, "log_presliding"))
        warnings.append(
            f"the presliding length is not determined (steps of {show(paths.step, 'mm', 3)}): no point lies where "
            "friction reverses; measure a reversal in smaller steps"
        )
    half_width, error = found.values["half_width"], found.error("half_width")
    if not error < _VAGUE * half_width:
        warnings.append(
            f"the half width {half_width:.3g} N has a standard error of {error:.2g} N: loading and unloading hardly "
            "differ, or the strokes are too short"
        )
    warnings += [f"{name} is at the bound of its range" for name in found.at_bound]
    answer = _result(model, found, taut, tuple(warnings))
    if answer.rmse <= _MISFIT * half_gap:
        return answer
    misfit = (
        f"{type(model.template).__name__} leaves residuals of {answer.rmse:.3g} N beside {half_gap:.3g} N of half the "
        "loop width: its misfit may pass for friction or drift; take a law that fits better"
    )
    return dataclasses.replace(answer, warnings=(*answer.warnings, misfit))


@dataclass(frozen=True, eq=False)
class _Solution:
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


def _without(names: tuple[str, ...], name: str) -> tuple[str, ...]:
    return tuple(other for other in names if other != name)


def _shapes_at_bound(law: ForceLaw) -> set[str]:
    return {
        p.name
        for p in law.shape_parameters
        if not _EDGE < (float(getattr(law, p.name)) - p.lower) / (p.upper - p.lower) < 1 - _EDGE
    }


def _with_drift(
    model: PathDependentModel, bases: list[DriftBasis], start: dict[str, float], free: tuple[str, ...]
) -> tuple[PathDependentModel, _Solution]:
    """Solution with the drift of least Bayesian information criterion."""
    answers: list[tuple[float, PathDependentModel, _Solution]] = []
    for basis in bases:
        trial = dataclasses.replace(model, drift=basis)
        found = _solve(trial, start, free)
        start = found.values
        count = int(np.count_nonzero(model.used))
        parameters = len(free) + basis.points.shape[1]
        answers.append((count * np.log(found.cost / count) + parameters * np.log(count), trial, found))
    return min(answers, key=lambda answer: answer[0])[1:]


def _check_count(model: PathDependentModel, free: tuple[str, ...], drift: DriftBasis) -> None:
    needed, count = len(free) + drift.points.shape[1] + 1, int(np.count_nonzero(model.used))
    if count < needed:
        raise IdentificationError(
            f"{count} points cannot determine {needed - 1} parameters of law, friction and drift",
            value=count,
            lower=needed,
            remedy=f"measure at least {needed}, or give a law that is known",
        )


def _least_squares(
    model: PathDependentModel, start: dict[str, float], free: tuple[str, ...], *, max_nfev: int = 200
) -> _Solution:
    """Bounded least squares from a start; the drift amplitudes are always free."""
    from scipy.optimize import least_squares  # 0.3 s, which no import of the package should wait for

    count = len(free)
    lower, upper = model.bounds(free)
    unbounded = np.full(model.drift.points.shape[1], np.inf)
    initial = np.clip([start[name] for name in free], lower, upper)

    def values(x: Floats) -> dict[str, float]:
        return {**start, **dict(zip(free, x[:count].tolist(), strict=True))}

    answer = least_squares(
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
    return _Solution(values(answer.x), free, answer.x[count:], answer.fun, answer.jac, active, answer.status > 0)


def _solve(model: PathDependentModel, start: dict[str, float], free: tuple[str, ...]) -> _Solution:
    """Bounded least squares with standard errors."""
    found = _least_squares(model, start, free)
    names = (*free, *(f"offset {k}" for k in range(len(found.offsets))))
    number = condition_number(found.jacobian[:, ~found.active])
    if not number < CONDITION_LIMIT:
        remaining = [name for name, out in zip(names, found.active, strict=True) if not out]
        loose = unidentifiable(found.jacobian[:, ~found.active], remaining)
        raise IdentificationError(
            f"the points do not determine {', '.join(loose)} (condition number {number:.1e})",
            value=number,
            upper=CONDITION_LIMIT,
            remedy="measure at more pressures and contractions, take a law with fewer parameters, or give a known one",
        )
    if not found.converged:
        raise IdentificationError(
            f"the fit of law and friction did not converge (RMSE {np.sqrt(np.mean(found.residuals**2)):.3g} N)",
            remedy="look for outliers, wrong units and rows that are not in the order of the test",
        )
    known = uncertainty(found.jacobian, found.residuals, found.active)
    return dataclasses.replace(found, errors=known.standard_errors, correlations=known.correlations)


def _result(model: PathDependentModel, found: _Solution, taut: Bools, warnings: tuple[str, ...]) -> HysteresisFit:
    means, used, basis = model.means, model.used, model.drift
    tension, force = model.components(found.values)
    offset = basis.points @ found.offsets
    residuals = means.force - tension - force - offset
    points = means.select(taut)
    friction = model.friction(found.values)
    names = [name for name in found.free if name in model.law_names]
    errors = {name: found.error(name) for name in (*names, "half_width", "growth")}
    errors["presliding_length"] = found.error("log_presliding") * friction.presliding_length
    order = [*names, *FRICTION]
    correlations = np.full((len(order), len(order)), np.nan)
    places = [(i, found.free.index(name)) for i, name in enumerate(order) if name in found.free]
    for i, a in places:
        for j, b in places:
            correlations[i, j] = found.correlations[a, b]
    law = model.template
    if names:
        law = dataclasses.replace(model.law(found.values), domain=domain_of(points))
    drift = None
    if len(basis.time):
        drift_errors = basis.at_knots @ found.errors[len(found.free) :]
        drift = SensorDrift(basis.time, basis.at_knots @ found.offsets, drift_errors)
    return HysteresisFit(
        law=law,
        friction=friction,
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
