"""Identification on the joint: muscle laws, load and encoder zero from recordings of its motion."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike
from scipy.ndimage import gaussian_filter1d
from scipy.special import chdtri

from mckibben.calibration.equations import (
    COEFFICIENTS,
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
    halves_of,
    linearised,
    muscle_parameters,
    parameters,
    problem_of,
    sliding_from,
)
from mckibben.calibration.fitting import (
    UNEXPLAINED,
    Calibration,
    JointEstimate,
    correlation_time,
    draws,
    remembered,
    variance_of,
)
from mckibben.errors import IdentificationError, RangeError
from mckibben.joint import AntagonisticJoint, Load
from mckibben.joint.geometry import Pressures
from mckibben.numerics.batching import recheck
from mckibben.numerics.compiled import jit
from mckibben.result import Remark, column

_FILTER = 0.1  # s, standard deviation of the filter of the equations
_START_VARIANCE = 1e-3  # of the torque [N^2*m^2], until residuals are available
_LEAST_VARIANCE = 1e-8
_NEGLIGIBLE = 1e-3  # ratio of residual to highest torque up to which a misfit is irrelevant
_CONTRADICTION = 1e-6  # prior probability of estimates as far from the model
_CHECK = "check units and signs of the columns, and which is muscle 1 (it lengthens as the angle grows)"
_APART = 100  # samples, of the stiffness along recordings
_EXPECTED = {"added_mass": 1.0, "zero": 0.0, "arm_scale": 1.0}
STARTS = (0.0, -1.0, 1.0, -2.0, 2.0, -3.0, -4.0)  # prior standard deviations of the muscles' strength
_EXCHANGES = (0.35, -0.35)  # of the friction of muscle 1; the opposite of muscle 2, and of the presliding lengths
_FIRST, _STAGES, _ITERATIONS = 8, 3, 25
_TOLERANCE = 1e-2  # of the gradient, per prior standard deviation
_FARTHEST = 2.0  # prior standard deviations, of a step
_UNITS = {"friction": "N", "presliding": "m", "creep": "N/m", "mass": "kg", "zero": "rad"}  # of quantities; else "1"


class CalibratedJoint(Calibration):
    """Base of the calibrations of a joint: the model with the estimates, and its stiffness with deviations.

    Attributes
    ----------
    joint, load
        The model with the estimates.
    recordings
        Those that were fitted.
    """

    joint: AntagonisticJoint
    load: Load
    recordings: tuple[JointRecording, ...]
    _problem: CalibrationProblem
    _estimate: Floats
    _covariance: Floats

    figures = ("calibration",)

    def stiffness(self, angle: ArrayLike, pressures: Pressures) -> tuple[Floats, Floats]:
        """Return stiffness [N*m/rad] and its standard deviation at angles [rad] and gauge pressures [Pa]."""
        value, slope = _stiffness(self._problem, jnp.asarray(self._estimate), jnp.asarray(angle, float), pressures)
        return np.asarray(value), _deviation(np.asarray(slope), self._covariance)

    def prior_stiffness(self, angle: ArrayLike, pressures: Pressures) -> tuple[Floats, Floats]:
        """Return `stiffness` before the calibration."""
        start = jnp.zeros(self._estimate.size)
        value, slope = _stiffness(self._problem, start, jnp.asarray(angle, float), pressures)
        return np.asarray(value), _deviation(np.asarray(slope), np.eye(self._estimate.size))

    def stiffness_deviations(self) -> tuple[float, float]:
        """Return the root mean square deviation of the stiffness [N*m/rad] along the recordings, before and after."""
        angle = np.concatenate([recording.angle[::_APART] for recording in self.recordings])
        pressures = np.concatenate([recording.pressures[::_APART] for recording in self.recordings])
        before, after = (
            float(np.sqrt(np.mean(stiffness(angle, (pressures[:, 0], pressures[:, 1]))[1] ** 2)))
            for stiffness in (self.prior_stiffness, self.stiffness)
        )
        return before, after

    def drawn(self, count: int) -> dict[str, Any]:
        """Return joint and load of plants, with an array of shape (count,) for each number.

        The first plant has the estimates, the others are drawn from their distribution, always the same ones.
        """
        models = _models(self._problem, draws(self._estimate, self._covariance, count))
        return {"joint": models.joint, "load": models.load}

    def verdict(self) -> str:
        """Deviations of the stiffness along the recordings before and after, and the determined quantities."""
        before, after = self.stiffness_deviations()
        return f"stiffness: standard deviation {after:.2g} N*m/rad, {before:.2g} before; {super().verdict()}"

    def remarks(self) -> list[Remark]:
        """Contradictions of model and recordings, and quantities that are far from the model."""
        remarks, distance = [], float(self._estimate @ self._estimate)
        if distance > chdtri(self._estimate.size, _CONTRADICTION):
            text = f"the recordings contradict the model: it is too far from the estimates (chi-squared {distance:.3g})"
            remarks.append(Remark.warning("quantities", text, _CHECK))
        return remarks + super().remarks()


class JointCalibration(CalibratedJoint):
    """Joint identified from recordings of its motion, by `calibrate_joint`.

    Attributes
    ----------
    quantities
        Estimates by name: ``muscle1.force`` (relative to the model, at the middle contraction and the mean pressure),
        ``muscle1.friction``, ``muscle1.presliding``, ``muscle1.creep`` (total stiffness of its Maxwell arms),
        ``friction`` (sum of both half widths), ``load.mass``, ``added_mass`` (relative to its stated value), ``zero``
        (encoder reading at angle 0), ``arm_scale``.
    residual
        Root mean square of the error of the equation of motion [N*m], low-pass filtered.
    noise
        Root mean square of its sensor noise [N*m], the part not shared by even and odd samples.
    misfit
        Ratio of residual to noise if the model does not describe the recordings, else 1; deviations contain it.
    """

    residual: float = column("N*m", "residual torque", digits=2)
    noise: float = column("N*m", "noise of the torque", digits=2)
    misfit: float = 1.0

    def remarks(self) -> list[Remark]:
        """Whether the model describes the recordings, and remarks on the quantities."""
        if self.misfit == 1:
            return super().remarks()
        text = (
            f"the residual torque of {self.residual:.2g} N*m is far above its noise, {self.noise:.2g} N*m: the model "
        )
        text += f"does not describe the recordings, and deviations are multiplied by {self.misfit:.2g}"
        remedy = "check which recordings had the weight, the units, and the encoder's zero"
        return [Remark.warning("residual", text, remedy), *super().remarks()]


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

    If the residual is above twice its noise and a thousandth of the highest torque, the model does not describe the
    recordings: deviations are multiplied by their ratio (Birge), and a remark says so.

    References
    ----------
    L. Ljung, System Identification, 2nd ed., Prentice Hall 1999, ch. 7 (instrumental variables); W. K. Newey and K. D.
    West, Econometrica 55 (1987), 703-708 (covariance); the procedure is this project's.
    """
    prior = prior or JointPrior()
    halves = [halves_of(recording) for recording in recordings]
    if not halves:
        raise IdentificationError("there is no recording", remedy="give at least one")
    problem = problem_of(joint, load, halves, prior)
    estimate, covariance, residual, noise = _solve(problem, halves)
    arms = np.abs(joint.geometry.moment_arms(halves[0][0].angle))
    relevant = max(UNEXPLAINED * noise, _NEGLIGIBLE * float(np.max(problem.force)) * float(np.max(arms)))
    misfit = residual / noise if residual > relevant else 1.0
    covariance = covariance * misfit**2
    model = jax.tree.map(number, _model(problem, jnp.asarray(estimate)))
    try:
        recheck(model)
    except RangeError as error:
        raise IdentificationError(f"the recordings contradict the model: {error.message}", remedy=_CHECK) from None
    quantities = quantities_of(problem, estimate, covariance)
    parts = model.joint, model.load, tuple(recordings), problem, estimate, covariance
    return JointCalibration(quantities, *parts, residual, noise, misfit)


def quantities_of(problem: CalibrationProblem, estimate: Floats, covariance: Floats) -> dict[str, JointEstimate]:
    """Estimates by name, from estimates and covariance of the parameters."""
    value, slope = _quantities(problem, estimate)
    before = _quantities(problem, np.zeros(estimate.size))[1]
    estimates = {}
    for name in value:
        deviation = _deviation(np.asarray(slope[name]), covariance)
        wide = _deviation(np.asarray(before[name]), np.eye(estimate.size))
        unit = _UNITS.get(name.rpartition(".")[2], "1")
        numbers = float(value[name]), float(deviation), float(wide)
        estimates[name] = JointEstimate(*numbers, unit, expected=_EXPECTED.get(name))
    return estimates


def number(leaf: Any) -> Any:
    """A scalar array as a number, anything else unchanged."""
    return leaf.item() if isinstance(leaf, jax.Array) and leaf.ndim == 0 else leaf


_model = jit(corrected)
_models = jit(jax.vmap(corrected, (None, 0)))


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
        quantities: Any = OrderedDict()
        bands = []
        creep = creep_stiffness(problem, z).sum(axis=1) if z.size > creep_begin(problem) else None
        pairs = zip((joint.muscle1, joint.muscle2), (problem.joint.muscle1, problem.joint.muscle2), strict=True)
        for i, (muscle, before) in enumerate(pairs):
            if joint.springs[i]:
                continue
            point, name, friction = (problem.centre[i], problem.pressure[i]), f"muscle{i + 1}", muscle.friction
            bands.append(friction.half_width)  # type: ignore[attr-defined]
            quantities[f"{name}.force"] = muscle.law.force(*point) / before.law.force(*point)
            quantities[f"{name}.friction"] = bands[-1]
            quantities[f"{name}.presliding"] = friction.presliding_length  # type: ignore[attr-defined]
            if creep is not None:
                quantities[f"{name}.creep"] = creep[i]
        quantities["friction"] = sum(bands)
        if load.adapted_mass:
            quantities["load.mass"] = getattr(load, load.adapted_mass)
        quantities |= {"added_mass": added, "zero": zero, "arm_scale": geometry.scale}
        return quantities

    return values(z), jax.jacfwd(values)(z)


def _solve(problem: CalibrationProblem, recordings: Sequence[Halves]) -> tuple[Floats, Floats, float, float]:
    """Estimates and covariance of the parameters, the residual torque [N*m], and its noise."""
    count, edge, stride = parameters(problem), int(4 * _FILTER * RATE), int(_FILTER * RATE / 2)
    starts = [sliding_from(problem.joint, half.angle) + edge for half, _ in recordings]
    groups = 1 + len(recordings[0][0].tensions)
    highest = np.asarray(problem.force).max()
    variances = np.full(groups, _START_VARIANCE) * np.array([1.0, highest**2, highest**2])[:groups]

    def filtered(column: Floats, start: int) -> Floats:
        return gaussian_filter1d(column, _FILTER * RATE, axis=0)[start:-edge:stride]

    def raw(z: Floats) -> list[list[tuple[Floats, Floats]]]:
        """Errors, shape (samples, groups), and their Jacobians, of each recording, for both halves."""
        halves = [[linearised(problem, z, recording[half]) for recording in recordings] for half in (0, 1)]
        return [[(filtered(r, n), filtered(j, n)) for (r, j), n in zip(half, starts, strict=True)] for half in halves]

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
    starts_of_search = [start(problem, strength) for strength in STARTS]
    starts_of_search += [start(problem, exchange=exchange) for exchange in _EXCHANGES]
    z = min((_minimised(terms, first, _FIRST) for first in starts_of_search), key=lambda fit: fit[1])[0]
    for _ in range(_STAGES):
        z, _ = _minimised(terms, z)
        even, odd = raw(z)
        means, apart = ([(a + sign * b) / 2 for (a, _), (b, _) in zip(even, odd, strict=True)] for sign in (1, -1))
        variances = np.array([max(variance_of([mean[:, i] for mean in means]), _LEAST_VARIANCE) for i in range(groups)])
    residual, noise = (float(np.sqrt(np.mean(np.concatenate(errors)[:, 0] ** 2))) for errors in (means, apart))
    _, gradients, curvature = data(z)
    inverse = np.asarray(np.linalg.inv(curvature + np.eye(count)), float)
    time = float(np.mean([correlation_time(errors[:, i]) for errors in means for i in range(groups)]))
    covariance = inverse @ (_long_run(gradients, time) + np.eye(count)) @ inverse
    return z, covariance, residual, noise


def _long_run(gradients: list[Floats], correlation_time: float) -> Floats:
    """Covariance of the sum of correlated gradients (Newey and West 1987; bandwidth: Andrews 1991, Eqs. 6.2, 6.4)."""
    total = np.zeros((gradients[0].shape[1],) * 2)
    rho = (correlation_time - 1) / (correlation_time + 1)
    for gradient in gradients:
        bandwidth = 1.1447 * (4 * rho**2 / (1 - rho**2) ** 2 * len(gradient)) ** (1 / 3)
        total += gradient.T @ gradient
        for lag in range(1, min(int(bandwidth) + 1, len(gradient))):
            cross = (1 - lag / (int(bandwidth) + 1)) * gradient[lag:].T @ gradient[:-lag]
            total += cross + cross.T
    return total


def start(problem: CalibrationProblem, strength: float = 0.0, exchange: float = 0.0) -> Floats:
    """Start of a search, in prior standard deviations: slack muscles, or friction of the other, cause local minima."""
    z = np.zeros(parameters(problem))
    muscles = z[: muscle_parameters(problem)].reshape(-1, OF_MUSCLE)
    muscles[:, COEFFICIENTS] = strength
    muscles[:, -2:] = np.outer((exchange, -exchange), (1.0, -1.0))[: len(muscles)]  # friction and presliding
    return z


def _minimised(
    terms: Callable[[Floats], tuple[float, Floats, Floats]], z: Floats, most: int = _ITERATIONS
) -> tuple[Floats, float]:
    """Minimum, and its value, of an objective with its gradient and second derivatives (trust region)."""
    from scipy.optimize import minimize  # 0.2 s

    at = remembered(terms)
    options = {"maxiter": most, "max_trust_radius": _FARTHEST, "gtol": _TOLERANCE}
    derivatives = {"jac": lambda z: at(z)[1], "hess": lambda z: at(z)[2]}
    fit = minimize(lambda z: at(z)[0], z, method="trust-exact", options=options, **derivatives)
    return fit.x, float(fit.fun)
