"""Estimates with deviations, and the output-error fit."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from mckibben.calibration.loop import loop_remarks
from mckibben.errors import IdentificationError
from mckibben.result import Column, Listing, Remark, Result, table
from mckibben.units import factor, show

if TYPE_CHECKING:
    from mckibben.identification.estimator import Minimum

Floats = NDArray[np.float64]

CONFLICT = 2.5
"""Prior standard deviations from the first model above which a quantity is named."""
SHOWN = {"m": "mm", "rad": "deg", "s": "ms", "Pa/s": "bar/s", "Pa": "kPa", "m^3": "cm^3", "m^3/(s*Pa)": "L/(s*bar)"}
"""Units of quantities in texts that differ from SI."""
_INTERVAL = 1.96  # standard deviations to the bounds of a 95 % interval

Simulated = Callable[[Floats], Sequence[tuple[Floats, Floats]]]
"""Samples of each recording, shape (samples,), and their derivatives, shape (samples, parameters), at parameters."""


@dataclass(frozen=True)
class JointEstimate:
    """An estimated quantity in SI, with posterior and prior standard deviation.

    With `logarithmic` its logarithm is estimated, and the deviations are those of the logarithm times the value.
    `expected` is its value in the first model, if the estimate is compared with it.

    Examples
    --------
    A logarithm that is known to 0.1, of 0.7 before:

    >>> estimate = JointEstimate(0.02, 0.002, 0.014, "s", logarithmic=True, expected=0.04)
    >>> estimate.determined, [round(bound, 4) for bound in estimate.interval], round(estimate.distance, 2)
    (True, [0.0164, 0.0243], 1.0)
    """

    value: float
    deviation: float
    prior: float
    unit: str
    logarithmic: bool = False
    expected: float | None = None

    @property
    def distance(self) -> float:
        """Distance of the estimate from its value in the first model, relative to its deviation if that were right.

        An estimate has the variance of the prior without the part that the recordings leave.
        """
        if self.expected is None:
            return 0.0
        ratio = self.value * math.log(self.value / self.expected) if self.logarithmic else self.value - self.expected
        determined = 1 - min((self.deviation / self.prior) ** 2, 0.99)  # of the variance of the prior
        return abs(ratio) / (self.prior * math.sqrt(determined))

    @property
    def interval(self) -> tuple[float, float]:
        """Bounds of the 95 % interval."""
        if not self.logarithmic:
            return self.value - _INTERVAL * self.deviation, self.value + _INTERVAL * self.deviation
        width = math.exp(_INTERVAL * self.deviation / self.value)
        return self.value / width, self.value * width

    @property
    def determined(self) -> bool:
        """Whether the recordings determine it: its standard deviation is below half of the prior one."""
        return self.deviation < self.prior / 2

    def __str__(self) -> str:
        unit = SHOWN.get(self.unit, self.unit)
        return f"{show(self.value, unit, 4)} with a standard deviation of {show(self.deviation, unit, 2)}"


class Calibration(Result):
    """Base of calibrations: estimates by name, with their prior deviations."""

    quantities: dict[str, JointEstimate]
    disk_margins: Floats | None = field(default=None, kw_only=True)
    """Least disk margins of the scenario's loop on the calibrated plant, and on plants drawn from the estimates."""

    files = ("model.yaml", "valve.yaml", "scenario.yaml", "estimate.json", "service.yaml")

    def deviations(self) -> dict[str, str]:
        """Return the standard deviation of each quantity with its unit; of forces in percent."""
        return {
            name: show(estimate.deviation / estimate.value, "%", 3)
            if name.endswith(".force")
            else f"{estimate.deviation:.3g} {'' if estimate.unit == '1' else estimate.unit}".strip()
            for name, estimate in self.quantities.items()
        }

    def verdict(self) -> str:
        """The determined quantities."""
        determined = [name for name, estimate in self.quantities.items() if estimate.determined]
        return f"determined: {', '.join(determined) or 'nothing'}"

    def remarks(self) -> list[Remark]:
        """A loop with too small margins, and quantities that are far from the first model."""
        loop = [] if self.disk_margins is None else loop_remarks(self.disk_margins)
        return loop + [
            Remark.warning(
                name,
                f"{name} is {estimate.distance:.1f} prior standard deviations from the model: {estimate}",
                "check it in the model, the weight, the sensors, and the class of the valve",
            )
            for name, estimate in self.quantities.items()
            if estimate.distance > CONFLICT
        ]

    @table()
    def estimates_and_margins(self) -> list[Listing]:
        """Estimates with deviations in the unit of their row, and margins of the loop."""
        listings = [self._estimates_listing()]
        if self.disk_margins is not None:
            plants = ["calibrated", *(f"drawn {i}" for i in range(1, len(self.disk_margins)))]
            columns = {"plant": (Column(), plants), "disk margin": (Column(digits=2), self.disk_margins)}
            listings.append(Listing("loop with the gains of the file", columns))
        return listings

    def _estimates_listing(self) -> Listing:
        """Table of the estimates, each in its own unit."""
        rows = [
            (estimate, SHOWN.get(estimate.unit, estimate.unit), factor(SHOWN.get(estimate.unit, estimate.unit)))
            for estimate in self.quantities.values()
        ]
        columns: dict[str, tuple[Column, Any]] = {
            "quantity": (Column(), list(self.quantities)),
            "estimate": (Column(), [estimate.value / size for estimate, _, size in rows]),
            "deviation": (Column(digits=2), [estimate.deviation / size for estimate, _, size in rows]),
            "before": (Column(digits=2), [estimate.prior / size for estimate, _, size in rows]),
            "unit": (Column(), ["" if unit == "1" else unit for _, unit, _ in rows]),
            "determined": (Column(), [estimate.determined for estimate, _, _ in rows]),
            "lower": (Column(title="95 % from"), [estimate.interval[0] / size for estimate, _, size in rows]),
            "upper": (Column(title="to"), [estimate.interval[1] / size for estimate, _, size in rows]),
        }
        return Listing("calibration", columns)


class UncertainParameter(NamedTuple):
    """Uncertain quantity: its prior median, and the standard deviation of its logarithm, or of itself.

    Examples
    --------
    >>> lag = UncertainParameter("valve.time_constant", "s", 0.02, 0.7)
    >>> round(float(lag.at(1.0)), 5), round(lag.estimate(0.0, 0.1).deviation, 5)
    (0.04028, 0.0014)
    """

    name: str
    unit: str
    median: float
    deviation: float
    logarithmic: bool = True

    def at(self, z: Any) -> Any:
        """Value at a number of prior standard deviations."""
        return self.median * jnp.exp(self.deviation * z) if self.logarithmic else self.median + self.deviation * z

    def estimate(self, z: float, deviation: float) -> JointEstimate:
        """Estimate from the number of prior standard deviations and its standard deviation."""
        value = float(self.at(z))
        prior = abs(value) * self.deviation if self.logarithmic else self.deviation
        expected = self.median if self.logarithmic else None
        return JointEstimate(value, prior * deviation, prior, self.unit, self.logarithmic, expected)


class LocalMinimum(NamedTuple):
    """A minimum of an objective.

    Attributes
    ----------
    z, covariance
        Parameters in prior standard deviations, shape (parameters,), and their covariance at the minimum.
    """

    z: Floats
    covariance: Floats

    @property
    def deviations(self) -> Floats:
        """Standard deviations of the parameters."""
        return np.sqrt(np.diag(self.covariance))


def draws(minimum: LocalMinimum, count: int) -> Floats:
    """Return the parameters at a minimum, then drawn ones, shape (count, parameters)."""
    random = np.random.default_rng(0)
    return np.array([minimum.z, *random.multivariate_normal(minimum.z, minimum.covariance, count - 1)])


class OutputErrorFit(NamedTuple):
    """Result of `fit_output_error`.

    Attributes
    ----------
    minimum
        Parameters in prior standard deviations, and their covariance.
    errors
        Errors of each recording, shape (samples,).
    """

    minimum: LocalMinimum
    errors: list[Floats]


def fit_output_error(
    simulated: Simulated,
    measured: Sequence[Floats],
    start: Floats,
    variance: float,
    least: float,
    *,
    positive: NDArray[np.bool_],
    stages: int = 3,
    evaluations: int = 60,
    tolerance: float = 1e-7,
) -> OutputErrorFit:
    r"""Minimise errors of simulated samples, with a standard normal prior of the parameters.

    .. math:: \frac{1}{\sigma^2} \sum_k e_k(z)^2 + \sum_i z_i^2

    by `least_squares` of `mckibben.identification.estimator`, with sigma^2 of `variance_of`, re-estimated in stages.

    Parameters
    ----------
    simulated, measured
        Samples of each recording, with their derivatives, and as measured, shape (samples,).
    start
        Parameters at which the search begins.
    variance, least
        First and least variance of a sample.
    positive
        Parameters that are not negative.
    stages
        Re-estimations of the variance.
    evaluations, tolerance
        Most evaluations of a stage, and its relative tolerance of cost and parameters.

    Raises
    ------
    IdentificationError
        If the errors at the start are not finite.

    References
    ----------
    L. Ljung, System Identification, 2nd ed., Prentice Hall 1999, ch. 7 (output-error models).
    """
    from mckibben.identification.estimator import least_squares, remembered  # 0.3 s

    prior = np.eye(start.size)
    bounds = np.where(positive, 0.0, -np.inf), np.full(len(prior), np.inf)
    samples, edges = np.concatenate(measured), np.cumsum([part.size for part in measured])[:-1]

    def linearised(z: Floats) -> tuple[Floats, Floats]:
        values, slopes = map(np.concatenate, zip(*simulated(z), strict=True))
        return values - samples, slopes

    def search(z: Floats, variance: float) -> Minimum:
        @remembered
        def at(z: Floats) -> tuple[Floats, Floats]:
            error, slope = linearised(z)
            stacked = np.concatenate([error / math.sqrt(variance), z])
            return stacked, np.concatenate([slope / math.sqrt(variance), prior])

        limits: Any = {"tolerance": tolerance, "evaluations": evaluations}
        return least_squares(lambda z: at(z)[0], z, lambda z: at(z)[1], bounds, **limits)

    if not np.isfinite(linearised(start)[0]).all():
        raise IdentificationError("the simulated model diverges", remedy="give a model closer to the recordings")
    z = search(start, variance).values
    errors, information = [], np.zeros(0)
    for _ in range(stages):
        z = search(z, variance).values
        error, slope = linearised(z)
        errors, information = np.split(error, edges), slope.T @ slope
        scaled = information / variance
        determined = float(np.trace(np.linalg.solve(scaled + prior, scaled)))
        variance = max(variance_of(errors, determined), least)
    covariance = np.linalg.inv(information / variance + prior).astype(np.float64)
    return OutputErrorFit(LocalMinimum(z, covariance), errors)


def root_mean_square(parts: Sequence[Floats]) -> float:
    """Return the root mean square of all samples of several recordings.

    >>> root_mean_square([np.array([3.0, 0.0]), np.array([4.0, 5.0, 0.0])])
    3.1622776601683795
    """
    return float(np.sqrt(np.mean(np.concatenate(parts) ** 2)))


def variance_of_samples(
    information: Floats, samples: float, squares: Floats, firm: Floats, precision: Floats
) -> Floats:
    """Variance of the samples of each group of equations, with the mean square of the model's error.

    All n samples of a group count as the k independent ones that determine as many parameters, so that their variance
    is e^2 n/k: the error of the model repeats with the motion.

    Parameters
    ----------
    information
        Sums of products of the derivatives of the errors, shape (groups, parameters, parameters).
    samples, squares
        Number of samples, and mean square error of each group.
    firm
        Variances at which the determined parameters are counted.
    precision
        Inverse of the covariance of the parameters without the samples.
    """
    scaled = information / firm[:, None, None]
    covariance = np.linalg.inv(precision + scaled.sum(axis=0))
    return squares * samples / np.maximum(np.einsum("ij,gji->g", covariance, scaled), 1.0)


def variance_of(parts: Sequence[Floats], determined: float, *, significant: float = 2.0) -> float:
    """Variance of a sample of white noise and of the error of a model, for the information of independent samples.

    The noise follows from successive differences. The error of the model, if the residual is significantly above the
    noise, repeats with the motion: all samples together count as as many independent ones as there are effective
    parameters, which the recordings determine (ours).

    Parameters
    ----------
    parts
        Residuals of each recording, shape (samples,) each.
    determined
        Number of effective parameters.
    significant
        Standard deviations of the variance of the noise by which that of a residual is significantly above it.

    Examples
    --------
    Noise of 1, then with a wave of a root mean square of 1, which counts as 10 samples of 1,000:

    >>> noise, time = np.random.default_rng(0).standard_normal(1000), np.arange(1000) * 0.01
    >>> round(variance_of([noise], 10.0), 2)
    0.95
    >>> 85 < variance_of([noise + np.sqrt(2) * np.sin(time)], 10.0) < 115
    True
    """
    residual, noise = np.concatenate(parts), noise_of(parts) ** 2
    explained = noise * (1 + significant * math.sqrt(2 / residual.size))
    misfit = max(float(np.mean(residual**2)) - explained, 0.0)
    return noise + misfit * residual.size / determined


def noise_of(errors: Sequence[Floats]) -> float:
    """Return the root mean square of the white noise in errors, from differences of successive samples.

    >>> smooth = np.sin(np.linspace(0, 6, 1000))
    >>> noise_of([smooth]) < 0.01, round(noise_of([smooth + 0.5 * (-1.0) ** np.arange(1000)]), 2)
    (True, 0.71)
    """
    return root_mean_square([np.diff(part) for part in errors]) / math.sqrt(2)


def misfit_remarks(
    residual: float,
    noise: float,
    highest: float,
    unit: str,
    remedy: str,
    *,
    explained: float = 2.0,
    negligible: float = 2e-3,
) -> list[Remark]:
    """Return the remark on a residual pressure [Pa] or torque [N*m] that its noise does not explain, where it matters.

    The noise explains up to `explained` times its root mean square; up to a `negligible` part of the highest pressure
    or torque the residual does not matter.

    >>> len(misfit_remarks(5e3, 1e3, 6e5, "kPa", "units")), len(misfit_remarks(1e3, 1.0, 6e5, "kPa", "units"))
    (1, 0)
    """
    if residual <= max(explained * noise, negligible * highest):
        return []
    text = f"the residual of {show(residual, unit, 2)} is far above the noise, {show(noise, unit, 2)}: the model does "
    text += "not describe the recordings, and deviations contain its error"
    return [Remark.warning("residual", text, f"check {remedy}")]
