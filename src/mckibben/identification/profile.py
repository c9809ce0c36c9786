r"""Profile likelihood of a shape parameter.

With the parameter fixed at :math:`\theta` and all others refitted, the sum of squares :math:`S(\theta)` gives the
signed root

.. math:: \tau(\theta) = \mathrm{sign}(\theta - \hat\theta) \sqrt{(S(\theta) - S(\hat\theta)) / s^2}

and the interval is where :math:`|\tau|` is below the quantile of t. Where points may share an error, :math:`\tau` is
divided by the ratio of the cluster-robust to the classical standard error, and t has the degrees of freedom of the
former.

References
----------
D. Bates and D. Watts, "Nonlinear Regression Analysis and Its Applications", Wiley 1988, chapter 6; J. Kent, "Robust
properties of likelihood ratio tests", Biometrika 69 (1982) 19-27, for the scaling.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field

import numpy as np

from mckibben.errors import IdentificationError, ParameterError
from mckibben.identification.estimator import (
    CONDITION_LIMIT,
    Floats,
    Interval,
    condition_number,
    parameter_interval,
    t_quantile,
)
from mckibben.identification.fit import Fit
from mckibben.identification.grouping import Grouping
from mckibben.identification.least_squares import Solution, solve
from mckibben.units import show

_CURVE_POINTS = 41
_MINIMA_STEPS = 48  # over the range searched for other minima
_MARGIN = 0.3  # of the interval, shown beyond its ends


@dataclass(frozen=True, eq=False)
class Profile:
    """Profile likelihood of one shape parameter.

    Attributes
    ----------
    interval
        Profile interval in SI; an end is infinite where the data do not bound the parameter within its range.
    wald
        Wald interval; NaN at a bound.
    values, root, threshold
        Ascending values of the parameter in SI and the signed root tau there, shape (m,); critical value of tau.
    reasons
        Reasons why the interval is open or unreliable.
    """

    name: str
    estimate: float
    level: float
    interval: Interval
    wald: Interval
    values: Floats = field(repr=False)
    root: Floats = field(repr=False)
    threshold: float
    by: Grouping
    reasons: tuple[str, ...]

    @property
    def identified(self) -> bool:
        """True if the data bound the parameter on both sides."""
        return bool(np.all(np.isfinite(self.interval)))


def profile(fit: Fit, name: str, *, level: float = 0.95, by: Grouping | None = None) -> Profile:
    """Profile likelihood of a shape parameter, such as "decay", of a `Fit`, and its confidence interval.

    Raises
    ------
    ParameterError
        If the law has no such shape parameter.
    IdentificationError
        If the fit was read from a file, or a fit with the parameter fixed does not converge.

    Examples
    --------
    >>> from mckibben import catalog
    >>> from mckibben.identification.fitting import identify
    >>> from mckibben.muscle import ExponentialLaw
    >>> found = profile(identify(ExponentialLaw, catalog.dataset("dmsp-10-250-martens2017")), "decay")
    >>> round(found.estimate, 1), found.identified
    (40.0, True)
    """
    shape = type(fit.law).shape_parameters
    index = next((i for i, p in enumerate(shape) if p.name == name), None)
    if index is None:
        known = ", ".join(p.name for p in shape)
        raise ParameterError(
            f"{name!r} is not a shape parameter of {type(fit.law).__name__}",
            value=name,
            remedy=f"profile one of {known}"
            if known
            else "the law is linear in all parameters: Fit.intervals is exact",
        )
    curve = _Curve(fit, index, by)
    threshold = float(t_quantile(level, curve.freedom))
    lower, reasons_below = curve.end(-1, threshold)
    upper, reasons_above = curve.end(+1, threshold)
    reasons = [*curve.reasons, *reasons_below, *reasons_above]
    low, high = (0.0 if lower is None else lower), (1.0 if upper is None else upper)
    minima = curve.other_minima(low, high, threshold)
    if minima:
        at = ", ".join(show(curve.value(u), shape[index].shown, 4) for u in minima)
        reasons.append(f"outside the interval, {name} near {at} fits the data equally well: a local minimum")
    margin = _MARGIN * max(high - low, 1e-6)
    positions = np.linspace(max(low - margin, 0.0), min(high + margin, 1.0), _CURVE_POINTS)
    positions = np.unique(np.append(positions, curve.start))
    return Profile(
        name=name,
        estimate=curve.value(curve.start),
        level=level,
        interval=Interval(
            -np.inf if lower is None else curve.value(lower), np.inf if upper is None else curve.value(upper)
        ),
        wald=parameter_interval(curve.value(curve.start), curve.error, curve.freedom, level),
        values=np.array([curve.value(u) for u in positions]),
        root=np.array([curve.root(u) for u in positions]),
        threshold=threshold,
        by=curve.by,
        reasons=tuple(reasons),
    )


class _Curve:
    """Signed root over the coordinate of one parameter in the unit cube."""

    def __init__(self, fit: Fit, index: int, by: Grouping | None) -> None:
        regression = fit.require_regression()
        self.problem, self.solution, self.index = regression.problem, regression.solution, index
        self.parameter = self.problem.law_type.shape_parameters[index]
        self.start = float(self.solution.position[index])
        residuals, jacobian = self.solution.augmented
        self.least = float(residuals @ residuals)
        self.by = regression.default_grouping[0] if by is None else by
        self.reasons: list[str] = []
        self._solutions: dict[float, Solution] = {self.start: self.solution}
        column = self.problem.linear + index
        at_bound = bool(regression.at_bound[column])
        if at_bound:
            self.reasons.append(f"the estimate of {self.parameter.name} is at the end of its range")
        others = regression.at_bound & (np.arange(len(regression.at_bound)) != column)
        regression = dataclasses.replace(regression, at_bound=others)
        gradient = (np.flatnonzero(~regression.at_bound) == column).astype(float)[None]
        points, count = len(residuals), np.count_nonzero(~regression.at_bound)
        self.variance = self.least / (points - count)
        self.error, self.freedom, self.ratio = np.nan, float(points - count), 1.0
        if condition_number(jacobian[:, ~regression.at_bound]) < CONDITION_LIMIT:
            variance, freedom = regression.error_model(self.by).variance(gradient)
            classical, _ = regression.error_model(Grouping.POINT).variance(gradient)
            self.error, self.freedom = float(np.sqrt(variance[0])), float(freedom[0])
            self.ratio = float(np.sqrt(variance[0] / classical[0])) if classical[0] > 0 else 1.0
        if at_bound:
            self.error = np.nan
        rate = float(self.problem.cube.rates(self.solution.position)[index])
        self.width = float(np.clip(self.error / abs(rate), 1e-6, 0.1)) if np.isfinite(self.error) else 0.02

    def value(self, u: float) -> float:
        """Parameter in SI."""
        position = self.solution.position.copy()
        position[self.index] = u
        return float(self.problem.cube.values(position)[self.index])

    def root(self, u: float) -> float:
        """Signed root with the parameter fixed at a coordinate."""
        if u == self.start:
            return 0.0
        if u not in self._solutions:
            position = self._solutions[min(self._solutions, key=lambda known: abs(known - u))].position.copy()
            position[self.index] = u
            found = solve(self.problem, position, fixed=self.index)
            if not found.converged:
                shown = show(self.value(u), self.parameter.shown)
                message = f"the fit with {self.parameter.name} fixed at {shown} did not converge"
                remedy = "look for outliers and wrong units in the data"
                raise IdentificationError(message, value=self.value(u), unit=self.parameter.unit, remedy=remedy)
            self._solutions[u] = found
        worse = max(self._solutions[u].cost - self.least, 0.0)
        return float(np.sign(u - self.start) * np.sqrt(worse / self.variance) / self.ratio) if worse else 0.0

    def end(self, side: int, threshold: float) -> tuple[float | None, list[str]]:
        """Coordinate where the root crosses the threshold; None, and the reason, if the range ends first."""
        from scipy.optimize import brentq  # takes 0.1 s to import

        bound = 1.0 if side > 0 else 0.0
        inside, step = self.start, self.width
        while inside != bound:
            outside = float(np.clip(inside + side * step, 0.0, 1.0))
            if abs(self.root(outside)) > threshold:
                crossing = brentq(lambda u: abs(self.root(float(u))) - threshold, inside, outside, xtol=1e-10)
                return float(crossing), []  # type: ignore[arg-type]
            inside, step = outside, 2 * step
        end, p = self.value(bound), self.parameter
        word = "above" if side > 0 else "below"
        return None, [
            f"the data do not bound {p.name} {word}: at {show(end, p.shown)}, the end of its range, the other "
            f"parameters compensate for it (tau = {self.root(bound):.2g}, the threshold is {threshold:.2g})"
        ]

    def other_minima(self, low: float, high: float, threshold: float) -> list[float]:
        """Local minima outside an interval where the root is below the threshold."""
        from scipy.optimize import minimize_scalar

        places = np.arange(_MINIMA_STEPS + 1) / _MINIMA_STEPS
        heights = np.array([abs(self.root(u)) for u in places.tolist()])
        found = []
        for i, u in enumerate(places.tolist()):
            before, after = max(i - 1, 0), min(i + 1, _MINIMA_STEPS)
            if low <= u <= high or heights[i] > min(heights[before], heights[after]):
                continue
            span = (float(places[before]), float(places[after]))
            bottom = minimize_scalar(lambda x: abs(self.root(float(x))), bounds=span, method="bounded")
            if bottom.fun < threshold and not low <= bottom.x <= high:  # type: ignore[attr-defined]
                found.append(float(bottom.x))  # type: ignore[attr-defined]
        return found
