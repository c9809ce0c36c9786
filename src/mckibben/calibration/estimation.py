"""Identification on the joint: muscle laws, load and encoder zero from recordings of its motion."""

from __future__ import annotations

import math
import warnings
from collections import OrderedDict
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike
from scipy.ndimage import gaussian_filter1d
from scipy.special import chdtrc, chdtri

from mckibben.calibration.equations import (
    COEFFICIENTS,
    LEAST_FRICTION,
    OF_MUSCLE,
    RATE,
    CalibrationProblem,
    Floats,
    Halves,
    JointPrior,
    JointRecording,
    corrected,
    creep_begin,
    creep_stiffness,
    friction_places,
    halves_of,
    linearised,
    muscle_parameters,
    parameters,
    problem_of,
    sliding_from,
)
from mckibben.errors import IdentificationError, McKibbenWarning, RangeError
from mckibben.joint import AntagonisticJoint, Load
from mckibben.joint.geometry import Pressures
from mckibben.numerics.batching import recheck
from mckibben.numerics.compiled import jit

_FILTER = 0.1  # s, standard deviation of the filter of the equations
_START_VARIANCE = 1e-3  # of the torque [N^2*m^2], until residuals are available
_LEAST_VARIANCE = 1e-8
_LEAST_RECORDINGS = 3  # for their scatter
_INSIDE = 1e-6  # prior standard deviations from an estimate to its bound, for derivatives
_UNEXPLAINED = 2.0  # ratio of residual to noise above which the model does not describe the recordings
_NEGLIGIBLE = 1e-3  # ratio of residual to highest torque up to which that is irrelevant
_CONTRADICTION = 1e-6  # prior probability of estimates as far from the model
_CHECK = "check units and signs of the columns, and which is muscle 1 (it lengthens as the angle grows)"
STARTS = (0.0, -1.0, 1.0, -2.0, 2.0, -3.0, -4.0)  # prior standard deviations of the muscles' strength
_EXCHANGES = (0.35, -0.35)  # of the friction of muscle 1; the opposite of muscle 2, and of the presliding lengths
_WIDE = 1.96  # standard deviations to the bounds of a 95 % interval
_FIRST, _STAGES, _ITERATIONS, _MOST_DAMPING, _TOLERANCE = 8, 3, 25, 1e3, 1e-2
_UNITS = {"friction": "N", "presliding": "m", "creep": "N/m", "mass": "kg", "zero": "rad"}  # of quantities; else "1"
DETERMINED = 0.5
"""Ratio of posterior to prior standard deviation below which a quantity counts as determined by the recordings."""


@dataclass(frozen=True)
class JointEstimate:
    """An estimated quantity in SI, with posterior and prior standard deviation.

    With `logarithmic` its logarithm is estimated, and the deviations are those of the logarithm times the value.
    """

    value: float
    deviation: float
    prior: float
    unit: str
    logarithmic: bool = False

    @property
    def interval(self) -> tuple[float, float]:
        """Bounds of the 95 % interval."""
        if not self.logarithmic:
            return self.value - _WIDE * self.deviation, self.value + _WIDE * self.deviation
        factor = math.exp(_WIDE * self.deviation / self.value)
        return self.value / factor, self.value * factor

    @property
    def determined(self) -> bool:
        """Whether the recordings determine it: its standard deviation is below half of the prior one."""
        return self.deviation < DETERMINED * self.prior


@dataclass(frozen=True, eq=False, repr=False)
class JointCalibration:
    """Joint identified from recordings of its motion, by `calibrate_joint`.

    Attributes
    ----------
    joint, load
        The model with the estimates.
    quantities
        Estimates by name: ``muscle1.force`` (relative to the model, at the middle contraction and the mean pressure),
        ``muscle1.friction``, ``muscle1.presliding``, ``muscle1.creep`` (total stiffness of its Maxwell arms),
        ``friction`` (sum of both half widths), ``load.mass``, ``added_mass`` (relative to its stated value), ``zero``
        (encoder reading at angle 0), ``arm_scale``.
    residual
        Root mean square of the error of the equation of motion [N*m], low-pass filtered.
    noise
        Root mean square of its sensor noise [N*m], the part not shared by even and odd samples; NaN for recordings of
        commands.
    """

    joint: AntagonisticJoint
    load: Load
    quantities: dict[str, JointEstimate]
    residual: float
    _problem: CalibrationProblem
    _estimate: Floats
    _covariance: Floats
    noise: float = field(default=math.nan, kw_only=True)

    def stiffness(self, angle: ArrayLike, pressures: Pressures) -> tuple[Floats, Floats]:
        """Return stiffness [N*m/rad] and its standard deviation at angles [rad] and gauge pressures [Pa]."""
        value, slope = _stiffness(self._problem, jnp.asarray(self._estimate), jnp.asarray(angle, float), pressures)
        return np.asarray(value), _deviation(np.asarray(slope), self._covariance)

    def prior_stiffness(self, angle: ArrayLike, pressures: Pressures) -> tuple[Floats, Floats]:
        """Return `stiffness` before the calibration."""
        start = jnp.zeros(self._estimate.size)
        value, slope = _stiffness(self._problem, start, jnp.asarray(angle, float), pressures)
        return np.asarray(value), _deviation(np.asarray(slope), np.eye(self._estimate.size))

    def __repr__(self) -> str:
        found = [name for name, one in self.quantities.items() if one.determined]
        return f"<JointCalibration: residual {self.residual:.3g} N*m, determined: {', '.join(found) or 'nothing'}>"


def calibrate_joint(
    joint: AntagonisticJoint, load: Load, recordings: Sequence[JointRecording], prior: JointPrior | None = None
) -> JointCalibration:
    r"""Identify a joint from recordings of its motion, preferably some with a known added weight.

    The equation of motion (Eq. 6) of both muscles, with friction and creep along the measured path, is fitted to all
    recordings at once; docs/calibrate.md describes the estimate:

    .. math::

        (I + m_w l_w^2)\,\ddot\theta + c\dot\theta = \tau(\theta - \theta_0, p_1, p_2) + (G + m_w l_w g)
        \sin(\theta_h - \theta + \theta_0)

    Each muscle's law gets a `ForceCorrection` and creep, Maxwell arms of 1, 3 and 10 s. Parameters have Gaussian
    priors. The estimates use instrumental variables: even samples are the instruments of the odd ones, and vice versa.

    Parameters
    ----------
    joint, load
        The initial model, the mean of the prior. A muscle without friction gets a band with an estimated width.
    recordings
        At least one. Slow sweeps in both directions at several co-contractions are most informative; some faster motion
        determines the load's mass.
    prior
        Prior standard deviations.

    Raises
    ------
    IdentificationError
        If a recording is too short, too slowly sampled or at rest, contains non-finite numbers, or does not give the
        load a positive mass.

    Warns
    -----
    McKibbenWarning
        If the estimates are farther from the model than their prior allows, with a probability of 1e-6; or if the
        residual is above twice its noise and a thousandth of the highest torque.

    References
    ----------
    L. Ljung, System Identification, 2nd ed., Prentice Hall 1999, ch. 7 (instrumental variables); W. K. Newey and K. D.
    West, Econometrica 55 (1987), 703-708 (covariance); the procedure is this project's.
    """
    prior = prior or JointPrior()
    halves = [halves_of(one) for one in recordings]
    if not halves:
        raise IdentificationError("there is no recording", remedy="give at least one")
    problem = problem_of(joint, load, halves, prior)
    estimate, covariance, residual, noise = _solve(problem, halves)
    found = jax.tree.map(number, _model(problem, jnp.asarray(estimate)))
    try:
        recheck(found)
    except RangeError as error:
        raise IdentificationError(f"the recordings contradict the model: {error.message}", remedy=_CHECK) from None
    if (distance := float(estimate @ estimate)) > chdtri(estimate.size, _CONTRADICTION):
        text = "the recordings contradict the model: the estimates are farther from it than the prior deviations allow"
        warnings.warn(
            f"{text} (chi-squared {distance:.3g} of {estimate.size}); {_CHECK}", McKibbenWarning, stacklevel=2
        )
    quantities = quantities_of(problem, estimate, covariance)
    torque = max(np.asarray(problem.force)) * float(np.max(np.abs(joint.geometry.moment_arms(halves[0][0].angle))))
    if residual > max(_UNEXPLAINED * noise, _NEGLIGIBLE * torque):
        text = f"the residual torque of {residual:.2g} N*m is far above the noise of the sensors, {noise:.2g} N*m"
        remedy = "check which recordings had the weight, the units, and the encoder's zero"
        warnings.warn(f"{text}: the model does not describe the recordings; {remedy}", McKibbenWarning, stacklevel=2)
    return JointCalibration(found.joint, found.load, quantities, residual, problem, estimate, covariance, noise=noise)


def quantities_of(problem: CalibrationProblem, estimate: Floats, covariance: Floats) -> dict[str, JointEstimate]:
    """Estimates by name, from estimates and covariance of the parameters."""
    value, slope = _quantities(problem, estimate)
    before = _quantities(problem, np.zeros(estimate.size))[1]
    found = {}
    for name in value:
        deviation = _deviation(np.asarray(slope[name]), covariance)
        wide = _deviation(np.asarray(before[name]), np.eye(estimate.size))
        unit = _UNITS.get(name.rpartition(".")[2], "1")
        found[name] = JointEstimate(float(value[name]), float(deviation), float(wide), unit)
    return found


def number(leaf: Any) -> Any:
    """A scalar array as a number, anything else unchanged."""
    return leaf.item() if isinstance(leaf, jax.Array) and leaf.ndim == 0 else leaf


_model = jit(corrected)


def _deviation(slope: Floats, covariance: Floats) -> Floats:
    return np.sqrt(np.einsum("...i,ij,...j->...", slope, covariance, slope))


@jit
def _stiffness(problem: CalibrationProblem, z: Array, angle: Array, pressures: Pressures) -> tuple[Array, Array]:
    def stiffness(z: Array) -> Array:
        return corrected(problem, z).joint.evaluate(angle, pressures)[1]

    return stiffness(z), jax.jacfwd(stiffness)(z)


@jit
def _quantities(problem: CalibrationProblem, z: Any) -> tuple[OrderedDict[str, Array], OrderedDict[str, Array]]:
    """Quantities by name and their derivatives; other dictionaries would come back sorted."""

    def values(z: Array) -> OrderedDict[str, Array]:
        joint, load, added, zero, _ = corrected(problem, z)
        geometry: Any = joint.geometry
        found: Any = OrderedDict()
        bands = []
        creep = creep_stiffness(problem, z).sum(axis=1) if z.size > creep_begin(problem) else None
        pairs = zip((joint.muscle1, joint.muscle2), (problem.joint.muscle1, problem.joint.muscle2), strict=True)
        for i, (muscle, before) in enumerate(pairs):
            if joint.springs[i]:
                continue
            point, name, friction = (problem.centre[i], problem.pressure[i]), f"muscle{i + 1}", muscle.friction
            bands.append(friction.half_width)  # type: ignore[attr-defined]
            found[f"{name}.force"] = muscle.law.force(*point) / before.law.force(*point)
            found[f"{name}.friction"] = bands[-1]
            found[f"{name}.presliding"] = friction.presliding_length  # type: ignore[attr-defined]
            if creep is not None:
                found[f"{name}.creep"] = creep[i]
        found["friction"] = sum(bands)
        if load.adapted_mass:
            found["load.mass"] = getattr(load, load.adapted_mass)
        found |= {"added_mass": added, "zero": zero, "arm_scale": geometry.scale}
        return found

    return values(z), jax.jacfwd(values)(z)


def _solve(problem: CalibrationProblem, recordings: Sequence[Halves]) -> tuple[Floats, Floats, float, float]:
    """Estimates and covariance of the parameters, the residual torque [N*m], and its noise."""
    count, edge, stride = parameters(problem), int(4 * _FILTER * RATE), int(_FILTER * RATE / 2)
    starts = [sliding_from(problem, half) + edge for half, _ in recordings]
    groups = 1 + len(recordings[0][0].tensions)
    highest = np.asarray(problem.force).max()
    variances = np.full(groups, _START_VARIANCE) * np.array([1.0, highest**2, highest**2])[:groups]

    def filtered(column: Floats, start: int) -> Floats:
        return gaussian_filter1d(column, _FILTER * RATE, axis=0)[start:-edge:stride]

    def raw(z: Floats) -> list[list[tuple[Floats, Floats]]]:
        """Errors, shape (samples, groups), and their Jacobians, of each recording, for both halves."""
        found = [[linearised(problem, z, one[half]) for one in recordings] for half in (0, 1)]
        return [[(filtered(r, n), filtered(j, n)) for (r, j), n in zip(one, starts, strict=True)] for one in found]

    def data(z: Floats) -> tuple[float, list[Floats], Floats]:
        """Objective without the prior, its gradients at each sample, and its Gauss-Newton Hessian."""
        scale = 1 / np.sqrt(variances)
        objective, gradients, curvature = 0.0, [], np.zeros((count, count))
        for (r0, J0), (r1, J1) in zip(*raw(z), strict=True):
            r0, r1, J0, J1 = r0 * scale, r1 * scale, J0 * scale[:, None], J1 * scale[:, None]
            cross = np.tensordot(J0, J1, ((0, 1), (0, 1)))
            objective, curvature = objective + float(np.vdot(r0, r1)) / 2, curvature + (cross + cross.T) / 2
            gradients.append((np.einsum("tgi,tg->ti", J0, r1) + np.einsum("tgi,tg->ti", J1, r0)) / 2)
        return objective, gradients, curvature

    def terms(z: Floats) -> tuple[float, Floats, Floats]:
        """The same with the prior."""
        objective, gradients, curvature = data(z)
        return objective + float(z @ z) / 2, np.concatenate(gradients).sum(axis=0) + z, curvature + np.eye(count)

    means: list[Floats] = []
    apart: list[Floats] = []  # half the difference between the halves
    starts_of_search = [start(problem, one) for one in STARTS] + [start(problem, exchange=one) for one in _EXCHANGES]
    z = min((minimised(terms, one, _FIRST) for one in starts_of_search), key=lambda found: found[1])[0]
    for _ in range(_STAGES):
        z, _ = minimised(terms, z)
        even, odd = raw(z)
        means, apart = ([(a + sign * b) / 2 for (a, _), (b, _) in zip(even, odd, strict=True)] for sign in (1, -1))
        variances = np.array([variance_of([one[:, i] for one in means]) for i in range(groups)])
    residual, noise = (float(np.sqrt(np.mean(np.concatenate(one)[:, 0] ** 2))) for one in (means, apart))
    bands = friction_places(problem)  # at the bound there is no derivative; the covariance is taken at its edge
    z[bands] = np.maximum(z[bands], (LEAST_FRICTION - 1) / problem.prior["friction"] + _INSIDE)
    _, gradients, curvature = data(z)
    inverse: Any = np.linalg.inv(curvature + np.eye(count))
    time = float(np.mean([correlation_time(one[:, i]) for one in means for i in range(groups)]))
    covariance = inverse @ (_long_run(gradients, time) + np.eye(count)) @ inverse
    return z, covariance, residual, noise


def _long_run(gradients: list[Floats], correlation_time: float) -> Floats:
    """Covariance of the sum of correlated gradients (Newey and West 1987; bandwidth: Andrews 1991, Eqs. 6.2, 6.4)."""
    total = np.zeros((gradients[0].shape[1],) * 2)
    rho = (correlation_time - 1) / (correlation_time + 1)
    for one in gradients:
        bandwidth = 1.1447 * (4 * rho**2 / (1 - rho**2) ** 2 * len(one)) ** (1 / 3)
        total += one.T @ one
        for lag in range(1, min(int(bandwidth) + 1, len(one))):
            cross = (1 - lag / (int(bandwidth) + 1)) * one[lag:].T @ one[:-lag]
            total += cross + cross.T
    return total


def start(problem: CalibrationProblem, strength: float = 0.0, exchange: float = 0.0) -> Floats:
    """Start of a search, in prior standard deviations: slack muscles, or friction of the other, cause local minima."""
    z = np.zeros(parameters(problem))
    muscles = z[: muscle_parameters(problem)].reshape(-1, OF_MUSCLE)
    muscles[:, COEFFICIENTS] = strength
    muscles[:, -2:] = np.outer((exchange, -exchange), (1.0, -1.0))[: len(muscles)]  # friction and presliding
    return z


def minimised(
    terms: Callable[[Floats], tuple[float, Floats, Floats]],
    z: Floats,
    most: int = _ITERATIONS,
    tolerance: float = _TOLERANCE,
) -> tuple[Floats, float]:
    """Levenberg-Marquardt minimum, and its value, of an objective with its gradient and second derivatives."""
    objective, gradient, curvature = terms(z)
    damping = 1e-3
    for _ in range(most):
        step = np.linalg.solve(curvature + damping * np.diag(np.abs(np.diag(curvature))), gradient)
        tried = terms(z - step)
        if tried[0] < objective:
            z, (objective, gradient, curvature), damping = z - step, tried, max(damping / 5, 1e-9)
            if np.abs(step).max() < tolerance:
                break
        elif (damping := 4 * damping) > _MOST_DAMPING:
            break
    return z, objective


def gauss_newton(
    error: Floats, slope: Floats, variance: float, z: Floats, prior: Floats | float = 1.0
) -> tuple[float, Floats, Floats]:
    """Objective, gradient and Gauss-Newton Hessian of errors, with slopes (samples, parameters) and a normal prior."""
    if not (np.isfinite(error).all() and np.isfinite(slope).all()):
        return math.inf, np.zeros(z.size), np.eye(z.size)
    objective = float(error @ error / variance + prior * z @ z) / 2
    hessian = slope.T @ slope / variance + np.diag(prior * np.ones(z.size))
    return objective, error @ slope / variance + prior * z, hessian


def variance_of(parts: list[Floats]) -> float:
    """Variance of residuals times the number of samples equivalent to one independent sample."""
    total, times = sum(one @ one for one in parts), [correlation_time(one) for one in parts]
    return max(float(total / sum(one.size for one in parts) * np.mean(times)), _LEAST_VARIANCE)


def correlation_time(one: Floats) -> float:
    """Number of residual samples equivalent to one independent sample."""
    spectrum = np.abs(np.fft.rfft(one, 2 * one.size)) ** 2
    correlation = np.fft.irfft(spectrum)[: one.size]
    correlation /= max(correlation[0], 1e-300)
    negative = np.flatnonzero(correlation < 0)
    return float(1 + 2 * correlation[1 : negative[0] if negative.size else one.size].sum())


class Scatter(NamedTuple):
    """Variance of the influence of each recording on each parameter relative to the expected one, and its p-value."""

    ratio: Floats
    p_value: Floats


def scatter_between(covariance: Floats, parts: Sequence[tuple[Floats, Floats]]) -> Scatter:
    """Scatter of the estimates between recordings, from gradient and Hessian of each; 1 for less than three.

    The sum of squares of the influences C g_r is compared with the expected one, by H_r - H_r C H_r (Birge ratio), as
    a chi-squared variable with Satterthwaite's degrees of freedom.
    """
    if len(parts) < _LEAST_RECORDINGS:
        return Scatter(*np.ones((2, len(covariance))))
    influence = np.array([covariance @ gradient for gradient, _ in parts])
    expected = np.array(
        [np.diag(covariance @ (hessian - hessian @ covariance @ hessian) @ covariance) for _, hessian in parts]
    )
    total = np.maximum(expected.sum(axis=0), 1e-300)
    freedom = np.maximum(total**2 / np.maximum((expected**2).sum(axis=0), 1e-300) - 1, 1)
    ratio = (influence**2).sum(axis=0) / total
    return Scatter(ratio, chdtrc(freedom, ratio * freedom))
