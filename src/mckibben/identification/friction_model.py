"""Model of the force along loading paths: law, friction of one of several forms, and drift of the sensor."""

from __future__ import annotations

import dataclasses
import enum
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from mckibben.dataset import IsobaricDataset
from mckibben.errors import IdentificationError
from mckibben.identification.estimator import (
    CONDITION_LIMIT,
    Bools,
    Floats,
    Minimum,
    condition_number,
    least_squares,
    remembered,
    robust_errors,
    standard_errors,
    t_quantile,
    unidentifiable,
)
from mckibben.identification.grouping import finest_grouping, group_labels
from mckibben.identification.least_squares import FitProblem
from mckibben.identification.loading_path import DriftBasis, LoadingPaths, moving_rates
from mckibben.muscle import ForceLaw, MaxwellSlip
from mckibben.muscle.friction import MIN_HALF_WIDTH, play_response, polygon, smooth_limit


class FrictionForm(enum.Enum):
    """Form of the friction between loading and unloading; docs/hysteresis.md lists them and the data that they need."""

    COULOMB = "coulomb"
    CONSTANT = "constant"
    PRESSURE = "pressure"
    TENSION = "tension"
    VISCOUS = "viscous"
    DIRECTIONAL = "directional"

    @property
    def free(self) -> tuple[str, ...]:
        """Parameters of the friction that the form estimates."""
        return _FREE[self]


_FREE = {
    FrictionForm.COULOMB: ("half_width",),
    FrictionForm.CONSTANT: ("half_width", "log_presliding"),
    FrictionForm.PRESSURE: ("half_width", "growth", "log_presliding"),
    FrictionForm.TENSION: ("half_width", "tension_growth", "log_presliding"),
    FrictionForm.VISCOUS: ("half_width", "viscous", "log_presliding"),
    FrictionForm.DIRECTIONAL: ("half_width", "viscous", "viscous_asymmetry", "log_presliding"),
}
FRICTION = ("half_width", "growth", "tension_growth", "viscous", "viscous_asymmetry", "log_presliding")
"""Friction parameters in SI, as in `MaxwellSlip`, with the logarithm of the presliding length [m]."""

_WIDEST = 1e5  # N
_LONGEST = 0.25  # of the range of lengths: with a longer presliding length friction would never fully reverse


@dataclass(frozen=True, eq=False)
class PathDependentModel:
    """Force along loading paths: law, Maxwell-slip friction, and sensor drift.

    Attributes
    ----------
    template
        Law whose parameters, unless they are estimated, are those of the model.
    paths, means
        Loading paths, and the points of their rows.
    drift
        Basis of the drift of the sensor.
    used, weights
        Mask of the rows that count, and weights of their residuals, shape (rows,).
    reference_pressure, reference_tension
        Pressure [Pa] and tension [N] at which the friction has its half width.
    rate
        Rate of the length [m/s], shape (rows,); None without viscous friction.
    """

    template: ForceLaw
    paths: LoadingPaths
    means: IsobaricDataset = field(repr=False)
    drift: DriftBasis = field(repr=False)
    used: Bools = field(repr=False)
    weights: Floats = field(repr=False)
    reference_pressure: float
    reference_tension: float = 0.0
    rate: Floats | None = None

    @property
    def law_names(self) -> tuple[str, ...]:
        """Parameters of the law, linear ones first; penalised ones are fixed at the fit of the law alone."""
        return tuple(p.name for p in type(self.template).parameters() if not p.penalised)

    def law(self, values: Mapping[str, float]) -> ForceLaw:
        """Law with the values of its parameters."""
        return dataclasses.replace(self.template, **{name: values[name] for name in self.law_names if name in values})  # pyrefly: ignore[bad-argument-type]

    def friction(self, values: Mapping[str, float]) -> MaxwellSlip:
        """Friction model with the given parameters."""
        return MaxwellSlip(
            values["half_width"],
            float(np.exp(values["log_presliding"])),
            growth=values["growth"],
            reference_pressure=self.reference_pressure,
            tension_growth=values["tension_growth"] or None,
            reference_tension=self.reference_tension if values["tension_growth"] else 0.0,
            viscous=values["viscous"],
            viscous_asymmetry=values["viscous_asymmetry"] or None,
        )

    @property
    def shortest(self) -> float:
        """Logarithm of the presliding length [m] that reverses within half a step: shorter ones are equivalent.

        Where it reverses within just one step, the residuals have a kink.
        """
        share, stiffness = polygon(MaxwellSlip.elements)
        return float(np.log(self.paths.step / (4 * (share / stiffness).max())))

    def missing(self, form: FrictionForm) -> str:
        """Data that a form needs and the points lack; empty if there are all."""
        if form is FrictionForm.PRESSURE and len(np.unique(self.means.levels[self.used])) < 3:
            return "three pressures"
        return "times at which the speed varies" if "viscous" in form.free and self.rate is None else ""

    def start(self, values: Mapping[str, float], form: FrictionForm) -> dict[str, float]:
        """Start of a fit of a form: parameters that it does not estimate are zero, or reverse friction in one step."""
        start = {**values, **dict.fromkeys(set(FRICTION) - {"half_width", "log_presliding"}, 0.0)}
        if "log_presliding" not in form.free:
            start["log_presliding"] = self.shortest
        if "viscous" in form.free and self.rate is not None:
            start["viscous"] = 0.1 * start["half_width"] / float(np.median(moving_rates(self.rate[self.used])))
        return start

    def bounds(self, names: Sequence[str]) -> tuple[Floats, Floats]:
        """Lower and upper bounds of the named parameters."""
        ranges = {p.name: (p.lower, p.upper) for p in type(self.template).shape_parameters}
        ranges |= {
            "half_width": (MIN_HALF_WIDTH, _WIDEST),
            "tension_growth": (-1.0, 1.0),
            "viscous": (0.0, np.inf),
            "viscous_asymmetry": (-1.0, 1.0),
            "log_presliding": (self.shortest, float(np.log(_LONGEST * np.ptp(self.paths.length)))),
        }
        lower, upper = zip(*(ranges.get(name, (-np.inf, np.inf)) for name in names), strict=True)
        return np.array(lower, float), np.array(upper, float)

    def components(self, values: Mapping[str, float]) -> tuple[Floats, Floats]:
        """Tension of the law and friction force [N] at each row, shape (rows,)."""
        tension = self._tension(values)[0]
        return tension, self._friction(tension[:, None], [values])[:, 0]

    def residuals(self, values: Mapping[str, float], offsets: Floats) -> Floats:
        """Modelled minus measured force [N] at the points used, weighted."""
        tension, friction = self.components(values)
        residuals = tension + friction + self.drift.points @ offsets - self.means.force
        return (self.weights * residuals)[self.used]

    def jacobian(
        self, values: Mapping[str, float], names: Sequence[str], *, tension_step: float = 1e-4, step: float = 1e-6
    ) -> Floats:
        """Weighted derivative of the modelled force with respect to the named parameters and drift amplitudes.

        That of the law is exact. Friction has difference quotients: over a `tension_step` [N] for parameters of the
        law, and for its own over a `step` that is divided by the range of the quantity that the parameter multiplies.

        Returns
        -------
        Shape (points used, names and drift amplitudes).
        """
        tension, columns = self._tension(values)
        of_law = [name for name in names if name in self.law_names]
        columns = columns[:, [self._problem.names.index(name) for name in of_law]] * (tension > 0)[:, None]
        others = [name for name in names if name not in self.law_names]
        # All difference quotients of the friction in one pass along the paths.
        by_law = tension_step / np.maximum(np.abs(columns).max(axis=0, initial=0.0), 1e-300)
        fastest = 1.0 if self.rate is None else float(np.abs(self.rate).max())
        sizes = {
            "growth": float(np.abs(self.means.pressure - self.reference_pressure).max()),
            "tension_growth": float(np.abs(tension - self.reference_tension).max()),
            "viscous": fastest,
            "viscous_asymmetry": fastest * values["viscous"],
        }
        steps = np.array([*by_law, *(step / max(sizes.get(name, 1.0), 1e-9) for name in others)])
        moved = [dict(values) for _ in names]
        for k, name in enumerate(others):
            moved[len(of_law) + k][name] += steps[len(of_law) + k]
        tensions = np.repeat(tension[:, None], len(names) + 1, axis=1)
        tensions[:, 1 : len(of_law) + 1] += columns * steps[: len(of_law)]
        friction = self._friction(np.maximum(tensions, 0.0), [values, *moved])
        slopes = (friction[:, 1:] - friction[:, :1]) / steps
        slopes[:, : len(of_law)] += columns
        return (self.weights[:, None] * np.concatenate([slopes, self.drift.points], axis=1))[self.used]

    @cached_property
    def _problem(self) -> FitProblem:
        constants = {p.name: float(getattr(self.template, p.name)) for p in type(self.template).constants}
        return dataclasses.replace(FitProblem.of(type(self.template), self.means), constants=constants)

    @cached_property
    def _law(self) -> Callable[[Floats], tuple[Floats, Floats]]:
        """Tension [N] and its derivatives from the parameters of the law: a fit of the friction alone keeps them."""

        def at(parameters: Floats) -> tuple[Floats, Floats]:
            rows = self._problem.columns_and_residuals(parameters)[:, : len(self.means)]
            return np.maximum(self.means.force - rows[-1], 0.0), rows[:-1].T

        return remembered(at)

    def _tension(self, values: Mapping[str, float]) -> tuple[Floats, Floats]:
        """Tension of the law [N] at each row, and its derivatives by all parameters, shape (rows, parameters)."""
        own = [values[name] if name in values else getattr(self.template, name) for name in self._problem.names]
        return self._law(np.array(own, np.float64))

    def sliding(self, values: Mapping[str, float]) -> PathDependentModel:
        """Model without the rows where the muscle sticks after a reversal.

        Where the load is held, it sticks over several pressures, and its friction there is that of moves within the
        noise of the length.
        """
        limit = self._limit(self._tension(values)[0][:, None], [values])
        deflections, stiffness, share = self._elements(limit, [values])
        slides = np.all(np.abs(deflections) >= limit[self.paths.place][..., None] * (share / stiffness), axis=(2, 3))
        return dataclasses.replace(self, used=self.used & (self.paths.scattered(slides.astype(float)) > 0))

    def _limit(self, tension: Floats, sets: Sequence[Mapping[str, float]]) -> Floats:
        """Half width [N] for each column of tensions and its parameter set, shape (rows, sets)."""
        half_width, growth, by_tension = _columns(sets, "half_width", "growth", "tension_growth")
        above = (self.means.pressure - self.reference_pressure)[:, None]
        return smooth_limit(half_width + growth * above + by_tension * (tension - self.reference_tension), tension, np)

    def _elements(self, limit: Floats, sets: Sequence[Mapping[str, float]]) -> tuple[Floats, Floats, Floats]:
        """Deflections [m], shape (points, paths, sets, elements), stiffness [N/m] and share of the elements."""
        half_width, log_presliding = _columns(sets, "half_width", "log_presliding")
        share, stiffness = polygon(MaxwellSlip.elements)
        stiffness = stiffness * (half_width / np.exp(log_presliding))[:, None]
        travel, side = self.paths.travel[..., None], self.paths.side[:, None]
        return play_response(travel, limit[self.paths.place], stiffness, share, side=side), stiffness, share

    def _friction(self, tension: Floats, sets: Sequence[Mapping[str, float]]) -> Floats:
        """Friction [N] for each column of tensions and its parameter set, shape (rows, sets)."""
        limit, (viscous, asymmetry) = self._limit(tension, sets), _columns(sets, "viscous", "viscous_asymmetry")
        deflections, stiffness, _ = self._elements(limit, sets)
        force = self.paths.scattered(np.einsum("pwse,se->pws", deflections, stiffness))
        if self.rate is None or not viscous.any():
            return force
        most = np.maximum(tension - limit, 0.0)
        rate = self.rate[:, None]
        return force + np.clip(viscous * (rate + asymmetry * np.abs(rate)), -most, most)

    def fit(self, start: Mapping[str, float], free: tuple[str, ...], *, evaluations: int = 1000) -> PathSolution:
        """Bounded least squares from a start; the drift amplitudes are always free."""
        count = len(free)
        lower, upper = self.bounds(free)
        unbounded = np.full(self.drift.points.shape[1], np.inf)

        def values(x: Floats) -> dict[str, float]:
            return {**start, **dict(zip(free, x[:count].tolist(), strict=True))}

        minimum = least_squares(
            lambda x: self.residuals(values(x), x[count:]),
            np.concatenate([np.clip([start[name] for name in free], lower, upper), np.zeros_like(unbounded)]),
            lambda x: self.jacobian(values(x), free),
            (np.concatenate([lower, -unbounded]), np.concatenate([upper, unbounded])),
            tolerance=1e-8,
            evaluations=evaluations,
        )
        return PathSolution(values(minimum.values), free, minimum)

    def solve(self, start: Mapping[str, float], free: tuple[str, ...]) -> PathSolution:
        """Bounded least squares with standard errors; an `IdentificationError` if the points do not determine it.

        The errors are those of a normal distribution with the same intervals for 95 %, as groups are few.
        """
        solution = self.fit(start, free)
        minimum, inside = solution.minimum, solution.inside
        jacobian = minimum.jacobian[:, inside]
        number = condition_number(jacobian)
        if not number < CONDITION_LIMIT:
            names = np.array([*free, *(f"offset {k}" for k in range(len(solution.offsets)))])[inside]
            message = f"the points do not determine {', '.join(unidentifiable(jacobian, names.tolist()))}"
            remedy = "measure at more pressures and contractions, use a law with fewer parameters, or give a known one"
            raise IdentificationError(
                f"{message} (condition number {number:.1e})", value=number, upper=CONDITION_LIMIT, remedy=remedy
            )
        if not minimum.converged:
            rmse = np.sqrt(np.mean(minimum.residuals**2))
            raise IdentificationError(
                f"the fit of law and friction did not converge (RMSE {rmse:.3g} N)",
                remedy="look for outliers, wrong units and rows that are not in the order of the test",
            )
        errors, _ = standard_errors(minimum.jacobian, minimum.residuals, ~inside)
        labels = group_labels(self.means, finest_grouping(self.means))[self.used]  # as of a fit of the law alone
        variance, freedom = robust_errors(jacobian, minimum.residuals, labels).variance(np.eye(jacobian.shape[1]))
        few = t_quantile(0.95, freedom) / t_quantile(0.95, np.inf)  # groups
        errors[inside] = np.maximum(errors[inside], few * np.sqrt(variance))
        return dataclasses.replace(solution, errors=errors)


def _columns(sets: Sequence[Mapping[str, float]], *names: str) -> list[Floats]:
    """Values of the named parameters in each set."""
    return [np.array([values[name] for values in sets]) for name in names]


@dataclass(frozen=True, eq=False)
class PathSolution:
    """Least-squares solution; errors of the free parameters and the drift amplitudes."""

    values: dict[str, float]
    free: tuple[str, ...]
    minimum: Minimum
    errors: Floats = field(default_factory=lambda: np.empty(0))

    @property
    def offsets(self) -> Floats:
        """Amplitudes of the drift."""
        return self.minimum.values[len(self.free) :]

    @property
    def inside(self) -> Bools:
        """Parameters and amplitudes that are not at a bound."""
        return ~self.minimum.at_bound

    def error(self, name: str) -> float:
        """Standard error of a parameter; NaN if it was not free."""
        return float(self.errors[self.free.index(name)]) if name in self.free else float("nan")
