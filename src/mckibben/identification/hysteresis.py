"""What an identification of hysteresis found: law, friction, drift, and what they leave of each measured point."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from mckibben.dataset import IsobaricDataset
from mckibben.errors import IdentificationError
from mckibben.identification.fit import DatasetSummary, Fit
from mckibben.identification.fitting import identify
from mckibben.identification.loading_path import FRICTION, DriftBasis, Strokes, WayModel, half_gap
from mckibben.identification.uncertainty import CONDITION_LIMIT, condition, uncertainty, undetermined
from mckibben.muscle import Domain, ForceLaw, MaxwellSlip, Muscle, Specimen
from mckibben.units import bar, mm, show


@dataclass(frozen=True, eq=False)
class Drift:
    """What the force sensor's zero did: straight lines between knots.

    Attributes
    ----------
    time
        Shape (knots,), of the dataset's own clock [s].
    offset, standard_errors
        Shape (knots,) [N].
    """

    time: NDArray[np.float64]
    offset: NDArray[np.float64]
    standard_errors: NDArray[np.float64]

    @property
    def rate(self) -> float:
        """Mean rate [N/s]: of the straight line that is nearest to the knots."""
        return float(np.polyfit(self.time - self.time[0], self.offset, 1)[0])


@dataclass(frozen=True, eq=False)
class HysteresisFit:
    """A law and its friction, identified together; `identify_hysteresis` makes it.

    Attributes
    ----------
    law
        The static law, that of neither direction; its domain is the range of the points.
    friction
        The hysteresis. Its viscous part is 0: points measured at rest say nothing of it.
    standard_errors
        By name, in SI: the parameters of the law unless it was given, ``half_width``, ``growth`` and
        ``presliding_length``; NaN where the data do not determine one.
    correlations
        Shape (parameters, parameters), in the order of `standard_errors`; NaN for what is not determined.
    drift
        Of the force sensor; None where the points show none.
    rmse, max_error
        Root of the mean squared residual, and the largest without sign [N].
    tension, friction_force, offset, residuals
        Shape (points,), in the order of the dataset: the law's force, what friction and drift add to it, and what is
        left of the measured one [N]. Slack points have a residual, but count only where there is a drift to be found.
    points_used, points_slack
        How many the fit rests on, and slack ones among all.
    warnings
        Sentences: what a reader should know before trusting the numbers.
    dataset
        Which data.
    """

    law: ForceLaw
    friction: MaxwellSlip
    standard_errors: dict[str, float]
    correlations: NDArray[np.float64] = field(repr=False)
    drift: Drift | None
    rmse: float
    max_error: float
    tension: NDArray[np.float64] = field(repr=False)
    friction_force: NDArray[np.float64] = field(repr=False)
    offset: NDArray[np.float64] = field(repr=False)
    residuals: NDArray[np.float64] = field(repr=False)
    points_used: int
    points_slack: int
    warnings: tuple[str, ...]
    dataset: DatasetSummary

    @property
    def force(self) -> NDArray[np.float64]:
        """The modelled force at each point [N], shape (points,)."""
        return self.tension + self.friction_force + self.offset

    def muscle(self, specimen: Specimen) -> Muscle:
        """A muscle that follows the law with its friction."""
        return Muscle(specimen, self.law, self.friction)

    def corrected(self, dataset: IsobaricDataset) -> IsobaricDataset:
        """The dataset that this was identified from, without friction and drift: plateau means for a static law.

        Raises
        ------
        IdentificationError
            If it is not that dataset.
        """
        means = dataset.plateau_means()
        if len(means) != len(self.residuals) or not np.allclose(means.force, self.force + self.residuals):
            raise IdentificationError(
                f"{means!r} is not the dataset that the hysteresis was identified from",
                remedy="give the same, whole",
            )
        force = means.force - self.friction_force - self.offset
        return IsobaricDataset(means.table.assign(force=("point", force)))

    def report(self) -> str:
        """The fit as text."""
        friction, errors = self.friction, self.standard_errors
        pressure = f"at {show(friction.reference_pressure, 'bar', 3)}"
        rows = [
            ("half width", f"{friction.half_width:.4g}", _error(errors["half_width"]), f"N {pressure}"),
            ("growth", f"{friction.growth * bar:.3g}", _error(errors["growth"] * bar), "N/bar"),
            (
                "presliding length",
                f"{friction.presliding_length / mm:.4g}",
                _error(errors["presliding_length"] / mm),
                "mm",
            ),
        ]
        lines = [
            f"{type(self.law).__name__} with Maxwell-slip friction of {friction.elements} elements",
            f"{self.dataset.specimen or 'unnamed specimen'}: {self.points_used} points used, {self.points_slack} slack",
            "",
            f"{'':17}  {'estimate':>8}  {'error':>7}",
            *(f"{name:17}  {value:>8}  {error:>7}  {unit}" for name, value, error, unit in rows),
        ]
        if self.drift is not None:
            lines.append(f"drift of the force sensor: {self.drift.rate * 3600:+.3g} N/h on average")
        lines.append(f"residuals: RMSE {self.rmse:.3g} N, maximum {self.max_error:.3g} N")
        lines += [f"warning: {warning}" for warning in self.warnings]
        return "\n".join(lines)


def _error(value: float) -> str:
    return f"{value:.2g}" if np.isfinite(value) else "-"


_GROWN = 3.0  # standard errors: a growth of the band with pressure that is nearer to 0 is not shown by the data
_AT_BOUND = 1e-2  # of the logarithm of a presliding
_EDGE = 1e-6  # of the range of a shape
_MISFIT = 0.25  # of half the gap between the directions: larger residuals are the law's, and may pass for friction
_ROUNDS = 2
_VAGUE = 0.3  # of the number itself: with a larger standard error it is not determined


def identify_hysteresis(
    law: type[ForceLaw] | ForceLaw | Fit,
    dataset: IsobaricDataset,
    *,
    drift: bool = True,
    elements: int = 6,
) -> HysteresisFit:
    """Fit a law and its friction to the whole course of an isobaric test, in the order of time.

    The force at a point is that of the law, that of friction after the way up to there, and the sensor's offset. All
    parameters are estimated together by least squares, so that the law runs where neither direction is favoured, also
    near the turning points. Each pressure begins on the side of the band from which its first stroke sets out:
    stretched before an unloading stroke, let go before a loading one.

    A drift of the sensor is looked for where the points have times: none, a straight line, or one with a knot for each
    pressure, whichever has the least Bayesian information criterion. Slack points, at which the sensor should read
    zero, tell it; without them it is at most one straight line that begins at 0.

    Parameters
    ----------
    law
        A kind of law, which is then fitted; or a law (or the fit of one) that is taken as known.
    dataset
        With directions and the initial length, and the nominal pressure where measured ones scatter. Its rows are in
        the order of the test, or it has times.
    drift
        Whether to look for one.
    elements
        Of the friction.

    Raises
    ------
    IdentificationError
        If the points cannot tell the hysteresis: one direction alone, an order that is no test, too few points, or
        parameters that trade off.

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
    strokes = Strokes.of(means)
    taut = ~means.slack
    shapes = DriftBasis.candidates(strokes, means)[: None if drift else 1]
    used = taut | any(shape.zeroed for shape in shapes)
    known = law if isinstance(law, ForceLaw) else None
    law_type = type(law) if isinstance(law, ForceLaw) else law
    levels = np.unique(means.levels[taut])
    gap = half_gap(means, taut)
    start = {"half_width": gap, "growth": 0.0, "log_presliding": float(np.log(strokes.step))}
    template = known or identify(law_type, means).law
    model = WayModel(template, strokes, means, shapes[0], used, float(levels.mean()), elements)
    free = FRICTION if known else (*model.law_names, *FRICTION)
    _check_count(model, free, shapes[-1])
    for _ in range(0 if known else _ROUNDS):  # nearer to the solution by turns: friction for a law, a law without it
        start = _friction_alone(model, start)
        try:
            model = dataclasses.replace(model, template=identify(law_type, _without_friction(model, start)).law)
        except (IdentificationError, np.linalg.LinAlgError):
            break  # it would only have been a better start
    warnings: list[str] = []
    for name in _at_bounds(model.template) & set(free):
        free = _without(free, name)
        warnings.append(f"{name} is held at the bound of its range: the data ask for a value beyond it")
    start |= {name: float(getattr(model.template, name)) for name in model.law_names}

    growth_seen = len(levels) >= 3
    model, found = _with_drift(model, shapes, start, free if growth_seen else _without(free, "growth"))
    if growth_seen and abs(found.value("growth")) < _GROWN * found.error("growth"):
        found = _solve(model, {**found.values, "growth": 0.0}, _without(found.free, "growth"))
    elif not growth_seen:
        warnings.append("fewer than three pressures: whether the band grows with pressure cannot be told")
    log_presliding = found.value("log_presliding")
    if log_presliding < model.shortest + _AT_BOUND or not found.error("log_presliding") < _VAGUE:
        held = min(max(log_presliding, model.shortest), float(np.log(strokes.step)))
        found = _solve(model, {**found.values, "log_presliding": held}, _without(found.free, "log_presliding"))
        warnings.append(
            f"the presliding length is not determined (steps of {show(strokes.step, 'mm', 3)}): no point lies where "
            "friction changes sides; measure a turn in smaller steps"
        )
    if not found.error("half_width") < _VAGUE * found.value("half_width"):
        warnings.append(
            f"the half width {found.value('half_width'):.3g} N has a standard error of {found.error('half_width'):.2g} "
            "N: loading and unloading hardly differ, or the strokes are too short to show by how much"
        )
    warnings += [f"{name} is at the bound of its range" for name in found.at_bound]
    answer = _answer(model, found, taut, tuple(warnings))
    if answer.rmse <= _MISFIT * gap:
        return answer
    misfit = (
        f"{type(model.template).__name__} leaves residuals of {answer.rmse:.3g} N beside {gap:.3g} N of half the gap "
        "between the directions: what the law misses may pass for friction or drift; take a law that fits better"
    )
    return dataclasses.replace(answer, warnings=(*answer.warnings, misfit))


@dataclass(frozen=True, eq=False)
class _Found:
    """A solution: all values by name, those that were free, and what the data say of these and the drift."""

    values: dict[str, float]
    free: tuple[str, ...]
    offsets: NDArray[np.float64]
    cost: float
    errors: NDArray[np.float64]
    correlations: NDArray[np.float64]
    at_bound: tuple[str, ...]

    def value(self, name: str) -> float:
        return self.values[name]

    def error(self, name: str) -> float:
        return float(self.errors[self.free.index(name)]) if name in self.free else float("nan")


def _without(names: tuple[str, ...], name: str) -> tuple[str, ...]:
    return tuple(other for other in names if other != name)


def _at_bounds(law: ForceLaw) -> set[str]:
    """The shape parameters of a law that lie at an end of their range."""
    return {
        p.name
        for p in law.shape_parameters
        if not _EDGE < (float(getattr(law, p.name)) - p.lower) / (p.upper - p.lower) < 1 - _EDGE
    }


def _friction_alone(model: WayModel, start: dict[str, float]) -> dict[str, float]:
    """The friction that suits the law as it stands, without growth: a start for more."""
    names = ("half_width", "log_presliding")
    lower, upper = model.bounds(names)

    def values(x: NDArray[np.float64]) -> dict[str, float]:
        return {**start, **dict(zip(names, x.tolist(), strict=True))}

    from scipy.optimize import least_squares  # 0.1 s, which no import of the package should wait for

    found = least_squares(
        lambda x: model.residuals(values(x), np.empty(0)),
        np.clip([start[name] for name in names], lower, upper),
        lambda x: model.jacobian(values(x), names),  # type: ignore[arg-type]
        bounds=(lower, upper),
        x_scale="jac",
        max_nfev=20,
    )
    return values(found.x)


def _without_friction(model: WayModel, values: dict[str, float]) -> IsobaricDataset:
    force = model.means.force - model.parts(values)[1]
    return IsobaricDataset(model.means.table.assign(force=("point", force)))


def _with_drift(
    model: WayModel, shapes: list[DriftBasis], start: dict[str, float], free: tuple[str, ...]
) -> tuple[WayModel, _Found]:
    """The solution with the simplest drift that the points ask for, by the Bayesian information criterion."""
    answers: list[tuple[float, WayModel, _Found]] = []
    for shape in shapes:
        trial = dataclasses.replace(model, drift=shape)
        found = _solve(trial, start, free)
        start = found.values
        count = int(np.count_nonzero(model.used))
        parameters = len(free) + shape.points.shape[1]
        answers.append((count * np.log(found.cost / count) + parameters * np.log(count), trial, found))
    return min(answers, key=lambda answer: answer[0])[1:]


def _check_count(model: WayModel, free: tuple[str, ...], drift: DriftBasis) -> None:
    needed, count = len(free) + drift.points.shape[1] + 1, int(np.count_nonzero(model.used))
    if count < needed:
        raise IdentificationError(
            f"{count} points cannot determine {needed - 1} parameters of law, friction and drift",
            value=count,
            lower=needed,
            remedy=f"measure at least {needed}, or give a law that is known",
        )


def _solve(model: WayModel, start: dict[str, float], free: tuple[str, ...]) -> _Found:
    """Least squares from a start; the drift is linear and comes along."""
    count = len(free)
    lower, upper = model.bounds(free)
    offsets = np.zeros(model.drift.points.shape[1])
    x0 = np.concatenate([np.clip([start[name] for name in free], lower, upper), offsets])
    unbounded = np.full(len(offsets), np.inf)

    def values(x: NDArray[np.float64]) -> dict[str, float]:
        return {**start, **dict(zip(free, x[:count].tolist(), strict=True))}

    from scipy.optimize import least_squares

    answer = least_squares(
        lambda x: model.residuals(values(x), x[count:]),
        x0,
        lambda x: model.jacobian(values(x), free),  # type: ignore[arg-type]
        bounds=(np.concatenate([lower, -unbounded]), np.concatenate([upper, unbounded])),
        x_scale="jac",
        method="trf",
        xtol=1e-10,
        ftol=1e-10,
        gtol=1e-10,
        max_nfev=200,
    )
    held = np.concatenate([answer.active_mask[:count] != 0, np.zeros(len(offsets), bool)])
    names = (*free, *(f"offset {k}" for k in range(len(offsets))))
    number = condition(answer.jac[:, ~held])
    if not number < CONDITION_LIMIT:
        loose = undetermined(answer.jac[:, ~held], [name for name, out in zip(names, held, strict=True) if not out])
        raise IdentificationError(
            f"the points do not determine {', '.join(loose)} (condition number {number:.1e})",
            value=number,
            upper=CONDITION_LIMIT,
            remedy="measure at more pressures and contractions, take a law with fewer parameters, or give a known one",
        )
    if answer.status <= 0:
        raise IdentificationError(
            f"the fit of law and friction did not converge (RMSE {np.sqrt(np.mean(answer.fun**2)):.3g} N)",
            remedy="look for outliers, wrong units and rows that are not in the order of the test",
        )
    known = uncertainty(answer.jac, answer.fun, held)
    bound = tuple(name for name, out in zip(names, held, strict=True) if out and name != "log_presliding")
    cost = float(answer.fun @ answer.fun)
    return _Found(values(answer.x), free, answer.x[count:], cost, known.standard_errors, known.correlations, bound)


def _answer(model: WayModel, found: _Found, taut: NDArray[np.bool_], warnings: tuple[str, ...]) -> HysteresisFit:
    means, used, basis = model.means, model.used, model.drift
    tension, force = model.parts(found.values)
    offset = basis.points @ found.offsets
    residuals = means.force - tension - force - offset
    points = means.select(taut)
    friction = model.friction(found.values)
    names = [name for name in found.free if name in model.law_names]
    errors = {name: found.error(name) for name in names}
    errors |= {name: found.error(name) for name in ("half_width", "growth")}
    errors["presliding_length"] = found.error("log_presliding") * friction.presliding_length
    order = [*names, *FRICTION]
    correlations = np.full((len(order), len(order)), np.nan)
    places = [(i, found.free.index(name)) for i, name in enumerate(order) if name in found.free]
    for i, a in places:
        for j, b in places:
            correlations[i, j] = found.correlations[a, b]
    law = model.template
    if names:
        law = dataclasses.replace(model.law(found.values), domain=_domain_of(points))
    return HysteresisFit(
        law=law,
        friction=friction,
        standard_errors=errors,
        correlations=correlations,
        drift=Drift(basis.time, basis.at_knots @ found.offsets, basis.at_knots @ found.errors[len(found.free) :])
        if len(basis.time)
        else None,
        rmse=float(np.sqrt(np.mean(residuals[used] ** 2))),
        max_error=float(np.abs(residuals[used]).max()),
        tension=tension,
        friction_force=force,
        offset=offset,
        residuals=residuals,
        points_used=int(np.count_nonzero(used)),
        points_slack=int(np.count_nonzero(~taut)),
        warnings=warnings,
        dataset=DatasetSummary(
            str(means.table.attrs["specimen"]), str(means.table.attrs["source"]), tuple(points.pressures.tolist())
        ),
    )


def _domain_of(points: IsobaricDataset) -> Domain:
    contraction, levels = points.contraction, points.levels
    return Domain(float(contraction.min()), float(contraction.max()), float(levels.min()), float(levels.max()))
