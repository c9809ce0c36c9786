"""Model of the force along loading paths: a smooth force, friction of one of several forms, and drift of the sensor."""

from __future__ import annotations

import dataclasses
import enum
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

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
    robust_errors,
    standard_errors,
    t_quantile,
    unidentifiable,
)
from mckibben.identification.grouping import measured_weights
from mckibben.identification.loading_path import DriftBasis, LoadingPaths, moving_rates
from mckibben.identification.surface import SmoothSurface
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

USUAL_PRESLIDING = 2e-3
"""Presliding length of muscles, relative to the initial length."""
LONGEST_PRESLIDING = 0.02
"""Ten times the usual one: what takes longer is no presliding."""
_WIDEST = 1e5  # N
_LONGEST = 0.25  # of the range of lengths: with a longer presliding length friction would never fully reverse


@dataclass(frozen=True, eq=False)
class PathDependentModel:
    """Force along loading paths: a smooth force, Maxwell-slip friction, and sensor drift.

    Attributes
    ----------
    tension
        Force without friction and drift, which bounds the friction [N], shape (rows,).
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
    surface
        Basis of what smooth deviations from the tension explain (`SmoothSurface.basis`); None without them.
    """

    tension: Floats = field(repr=False)
    paths: LoadingPaths
    means: IsobaricDataset = field(repr=False)
    drift: DriftBasis = field(repr=False)
    used: Bools = field(repr=False)
    weights: Floats = field(repr=False)
    reference_pressure: float
    reference_tension: float = 0.0
    rate: Floats | None = None
    surface: Floats | None = field(default=None, repr=False)

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

    def missing(self, form: FrictionForm, *, inflation: float = 10.0) -> str:
        """Data that a form needs and the points lack; empty if there are all.

        Damping by direction at one speed for each length is a smooth force: the surface explains it to a variance
        inflation factor of more than `inflation`.
        """
        if form is FrictionForm.PRESSURE and len(np.unique(self.means.levels[self.used])) < 3:
            return "three pressures"
        if "viscous" in form.free and self.rate is None:
            return "times at which the speed varies"
        if form is FrictionForm.DIRECTIONAL and self.surface is not None and self.rate is not None:
            rows = (self.weights * np.abs(self.rate))[self.used]
            left = self._beside_surface(rows)
            return "strokes of several speeds over the same lengths" if inflation * left @ left < rows @ rows else ""
        return ""

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
        longest = min(_LONGEST * np.ptp(self.paths.length), LONGEST_PRESLIDING * self.initial_length)
        ranges = {
            "half_width": (MIN_HALF_WIDTH, _WIDEST),
            "tension_growth": (-1.0, 1.0),
            "viscous": (0.0, np.inf),
            "viscous_asymmetry": (-1.0, 1.0),
            "log_presliding": (self.shortest, max(float(np.log(longest)), self.shortest + 1e-6)),
        }
        limits = np.array([ranges.get(name, (-np.inf, np.inf)) for name in names], float).reshape(-1, 2)
        return limits[:, 0], limits[:, 1]

    @property
    def initial_length(self) -> float:
        """Initial length of the muscle [m]."""
        return float(self.means.table.attrs["initial_length"])

    def with_paths(self, **changes: Any) -> PathDependentModel:
        """Model whose paths have other fields."""
        return dataclasses.replace(self, paths=dataclasses.replace(self.paths, **changes))

    def force(self, values: Mapping[str, float]) -> Floats:
        """Friction [N] at each row, shape (rows,)."""
        return self._friction([values])[:, 0]

    def residuals(self, values: Mapping[str, float], offsets: Floats) -> Floats:
        """Modelled minus measured force [N] at the points used, weighted, less what a smooth force explains."""
        residuals = self.tension + self.force(values) + self.drift.points @ offsets - self.means.force
        return self._beside_surface((self.weights * residuals)[self.used])

    def jacobian(self, values: Mapping[str, float], names: Sequence[str], *, step: float = 1e-6) -> Floats:
        """Derivative of the residuals with respect to the named parameters and the drift amplitudes.

        By difference quotients over a `step` divided by the range of the quantity that the parameter multiplies.

        Returns
        -------
        Shape (points used and rows of the surface, names and drift amplitudes).
        """
        fastest = 1.0 if self.rate is None else float(np.abs(self.rate).max())
        sizes = {
            "growth": float(np.abs(self.means.pressure - self.reference_pressure).max()),
            "tension_growth": float(np.abs(self.tension - self.reference_tension).max()),
            "viscous": fastest,
            "viscous_asymmetry": fastest * values["viscous"],
        }
        steps = np.array([step / max(sizes.get(name, 1.0), 1e-9) for name in names])
        moved = [{**values, name: values[name] + change} for name, change in zip(names, steps, strict=True)]
        friction = self._friction([values, *moved])  # in one pass along the paths
        slopes = (friction[:, 1:] - friction[:, :1]) / steps
        columns = np.concatenate([slopes, self.drift.points], axis=1)
        return self._beside_surface((self.weights[:, None] * columns)[self.used])

    def _beside_surface(self, rows: Floats) -> Floats:
        """Weighted residuals or columns at the points used, and at the prior of the surface, orthogonal to it."""
        if self.surface is None:
            return rows
        padded = np.concatenate([rows, np.zeros((len(self.surface) - len(rows), *rows.shape[1:]))])
        return padded - self.surface @ (self.surface.T @ padded)

    def smoothed(self, values: Mapping[str, float]) -> PathDependentModel:
        """Model whose surface is as rough as the points say beside friction of any form, and the drift."""
        plain = dataclasses.replace(self, surface=None)
        if self.rate is not None and not values["viscous"]:
            values = {**values, "viscous": self.start(values, FrictionForm.DIRECTIONAL)["viscous"]}
        columns = plain.jacobian(values, [name for name in FRICTION if self.rate is not None or "viscous" not in name])
        residuals = -plain.residuals(values, np.zeros(self.drift.points.shape[1]))
        surface = SmoothSurface.of(self.means, self.used).basis(columns, residuals, self.weights[self.used])
        return dataclasses.replace(self, surface=surface)

    def with_held_loads(self, law: ForceLaw, values: Mapping[str, float], *, share: float = 0.02) -> PathDependentModel:
        """Model of a test in which the load was held, without rows whose friction depends on the motion before a path.

        Its residuals are those of the contraction, which hardly moves after a reversal, over several pressures: the
        friction, which follows the length steeply there, is that of moves within the noise. `share` of the half width
        tells the friction of both motions apart.
        """
        stretched, shortened = (self.with_paths(side=np.full_like(self.paths.side, side)) for side in (1.0, -1.0))
        settled = np.abs(stretched.force(values) - shortened.force(values)) < share * values["half_width"]
        limit = self._limit([values])
        deflections, stiffness, yielding = self._elements(limit, [values])
        inside = np.abs(deflections) < (1 - 1e-9) * limit[self.paths.place][..., None] * (yielding / stiffness)
        slope = self.paths.scattered(np.sum(inside * stiffness, axis=(2, 3))) * self.initial_length
        weights = measured_weights(law, self.means, friction_slope=slope)
        return dataclasses.replace(self, used=self.used & settled, weights=weights)

    def _limit(self, sets: Sequence[Mapping[str, float]]) -> Floats:
        """Half width [N] for each parameter set, shape (rows, sets)."""
        tension = self.tension[:, None]
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

    def _friction(self, sets: Sequence[Mapping[str, float]]) -> Floats:
        """Friction [N] for each parameter set, shape (rows, sets)."""
        limit, (viscous, asymmetry) = self._limit(sets), _columns(sets, "viscous", "viscous_asymmetry")
        deflections, stiffness, _ = self._elements(limit, sets)
        force = self.paths.scattered(np.einsum("pwse,se->pws", deflections, stiffness))
        if self.rate is None or not viscous.any():
            return force
        most = np.maximum(self.tension[:, None] - limit, 0.0)
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
        whole = dataclasses.replace(self, surface=None).jacobian(solution.values, free)[:, inside]
        beside = np.linalg.norm(jacobian, axis=0) / np.maximum(np.linalg.norm(whole, axis=0), np.finfo(float).tiny)
        number = condition_number(jacobian) / max(float(beside.min(initial=1.0)), np.finfo(float).tiny)
        if not number < CONDITION_LIMIT:
            names = np.array([*free, *(f"offset {k}" for k in range(len(solution.offsets)))])[inside]
            message = (
                f"the points do not determine {', '.join(unidentifiable(jacobian, names.tolist()))} of the friction"
            )
            remedy = "measure at more pressures and contractions, or choose a form of friction with fewer parameters"
            raise IdentificationError(
                f"{message} (condition number {number:.1e})", value=number, upper=CONDITION_LIMIT, remedy=remedy
            )
        if not minimum.converged:
            rmse = np.sqrt(np.mean(minimum.residuals**2))
            raise IdentificationError(
                f"the fit of the friction did not converge (RMSE {rmse:.3g} N)",
                remedy="look for outliers, wrong units and rows that are not in the order of the test",
            )
        errors, _ = standard_errors(minimum.jacobian, minimum.residuals, ~inside)
        # What is smooth cancels between the directions of a loop, but not within one stroke.
        labels = np.unique(self.paths.loop(self.means)[self.used], return_inverse=True)[1]
        variance, freedom = robust_errors(jacobian, minimum.residuals, labels).variance(np.eye(jacobian.shape[1]))
        few = t_quantile(0.95, freedom) / t_quantile(0.95, np.inf)  # loops
        errors[inside] = np.maximum(errors[inside], few * np.sqrt(variance))
        return dataclasses.replace(solution, errors=self._inflation(len(inside)) * errors)

    def _inflation(self, count: int) -> float:
        """Factor of errors beside a surface, whose rows include as many degrees of freedom as its columns."""
        if self.surface is None:
            return 1.0
        rows, columns = self.surface.shape
        return float(np.sqrt((rows - count) / max(rows - columns - count, 1)))


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
        """Parameters and amplitudes that are not at a bound, and change the force: no friction has no presliding."""
        return ~self.minimum.at_bound & np.any(self.minimum.jacobian != 0, axis=0)

    def error(self, name: str) -> float:
        """Standard error of a parameter; NaN if it was not free."""
        return float(self.errors[self.free.index(name)]) if name in self.free else float("nan")
