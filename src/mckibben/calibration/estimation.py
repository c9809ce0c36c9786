"""Identification on the joint: muscle laws, load and encoder zero from recordings of its motion."""

from __future__ import annotations

import math
import warnings
from collections import OrderedDict
from collections.abc import Callable, Sequence
from dataclasses import field
from functools import cache, partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, ArrayLike, PyTree
from scipy import sparse
from scipy.special import chdtri

from mckibben.calibration.equations import (
    COEFFICIENTS,
    FORCES,
    OF_MUSCLE,
    PARAMETERS,
    RATE,
    CalibrationProblem,
    Floats,
    Halves,
    JointPrior,
    JointRecording,
    corrected,
    creep_stiffness,
    halves_of,
    linearised,
    paths_and_arms,
    problem_of,
    sliding_from,
)
from mckibben.calibration.fitting import (
    NEVER,
    Calibration,
    JointEstimate,
    LocalMinimum,
    correlation_time,
    draws,
    misfit_remarks,
    probabilities,
    root_mean_square,
)
from mckibben.codegen.engine import compiled
from mckibben.codegen.native import over_periods
from mckibben.errors import IdentificationError, McKibbenWarning, RangeError
from mckibben.joint import AntagonisticJoint, Load
from mckibben.joint.geometry import Pressures
from mckibben.numerics.batching import recheck
from mckibben.result import Column, Listing, Remark, column, table

_FILTER = 0.1  # s, standard deviation of the filter of the equations
_CHECK = "check units and signs of the columns, and which is muscle 1 (it lengthens as the angle grows)"
_APART = 100  # samples, of the stiffness along recordings
_EXPECTED = {"added_mass": 1.0, "zero": 0.0, "arm_scale": 1.0}
_LOGARITHMIC = ("friction", "presliding")  # quantities of which the logarithm is estimated
STRENGTHS = range(-4, 3)
"""Prior standard deviations of the muscles' strength at the starts of a search: slack muscles cause local minima."""
_UNITS = {"friction": "N", "presliding": "m", "creep": "N/m", "mass": "kg", "zero": "rad"}  # of quantities; else "1"


class JointCalibration(Calibration):
    """Joint identified from recordings of its motion, by `calibrate_joint`.

    Attributes
    ----------
    quantities
        Estimates by name: ``muscle1.force`` (relative to the model, at the middle contraction and the mean pressure),
        ``muscle1.friction``, ``muscle1.presliding``, ``muscle1.creep`` (total stiffness of its Maxwell arms),
        ``friction`` (sum of both half widths), ``load.mass``, ``added_mass`` (relative to its stated value), ``zero``
        (encoder reading at angle 0), ``arm_scale``.
    joint, load
        The model with the estimates.
    recordings, held_out
        Those that were fitted, and those that were not.
    residual
        Root mean square of the error of the equation of motion [N*m], low-pass filtered.
    noise
        Root mean square of its sensor noise [N*m], the part not shared by even and odd samples.
    misfit
        Root mean square of the error of the model [N*m]: the residual without its noise. Deviations contain it.
    highest
        Highest torque of a muscle [N*m].
    kept
        Whether the stiffness along the recordings is that of the model before, because they do not tell another one
        from it.
    """

    joint: AntagonisticJoint
    load: Load
    recordings: tuple[JointRecording, ...]
    held_out: tuple[JointRecording, ...] = field(default=(), kw_only=True)
    _problem: CalibrationProblem
    _minima: tuple[LocalMinimum, ...]  # the best one first
    residual: float = column("N*m", "residual torque", digits=2)
    noise: float = column("N*m", "noise of the torque", digits=2)
    misfit: float = column("N*m", "error of the model", digits=2)
    highest: float = 0.0
    kept: bool = False

    figures = ("calibration",)

    def stiffness(self, angle: ArrayLike, pressures: Pressures) -> tuple[Floats, Floats]:
        """Return stiffness [N*m/rad] and its standard deviation at angles [rad] and gauge pressures [Pa]."""
        return self._stiffness(self._minima, angle, pressures)

    def prior_stiffness(self, angle: ArrayLike, pressures: Pressures) -> tuple[Floats, Floats]:
        """Return `stiffness` before the calibration."""
        count = self._minima[0].z.size
        return self._stiffness([LocalMinimum(np.zeros(count), np.eye(count))], angle, pressures)

    def _stiffness(
        self, minima: Sequence[LocalMinimum], angle: ArrayLike, pressures: Pressures
    ) -> tuple[Floats, Floats]:
        return _spread([_stiffness(self._problem, minimum.z, angle, pressures) for minimum in minima], minima)

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
        models = _models(self._problem, draws(self._minima, count).T)
        return {"joint": models.joint, "load": models.load}

    def errors(self, recording: JointRecording) -> tuple[float, float]:
        """Return the root mean square errors of the torque [N*m] by the model before and after the calibration."""
        halves = halves_of(recording)
        edge = sliding_from(self._problem.joint, halves[0].angle) + int(4 * _FILTER * RATE)
        before, after = (
            np.mean([_filtered(linearised(self._problem, z, half)[0], edge) for half in halves], axis=0)[:, 0]
            for z in (np.zeros(PARAMETERS), self._minima[0].z)
        )
        return root_mean_square([before]), root_mean_square([after])

    @property
    def predicts(self) -> bool:
        """Whether the recordings that were held out, if any, are described better than by the model before."""
        before, after = np.sum([np.square(self.errors(recording)) for recording in self.held_out], axis=0)
        return bool(after < before)

    def combinations(self, *, share: float = 0.3) -> dict[str, float]:
        """Return combinations of the quantities that the recordings do not determine one by one.

        The deviation of each relative to that before: below 1/2 the recordings determine the combination, near 1 they
        trade its quantities for each other. Quantities count in units of their deviations before, of their logarithms
        for friction and presliding. Quantities with less than a `share` are not named.
        """
        evaluations = [_quantities(self._problem, minimum.z) for minimum in self._minima]
        names = [name for name, estimate in self.quantities.items() if not estimate.determined]
        names = [name for name in names if name in evaluations[0][0] and name != "friction"]
        wide = {name: np.linalg.norm(evaluations[0][1][name]) for name in names}
        values, slopes = (
            np.array([[np.asarray(of[i][name]) / wide[name] for name in names] for of in evaluations]) for i in (0, 1)
        )
        spread: Any = 0.0
        for value, slope, minimum in zip(values - values[0], slopes, self._minima, strict=True):
            spread = spread + minimum.weight * (slope @ minimum.covariance @ slope.T + np.outer(value, value))
        rows = {}
        variances, directions = np.linalg.eigh(spread) if names else ((), np.zeros((0, 0)))
        for variance, direction in zip(variances, directions.T, strict=True):
            parts = [f"{x:+.2g} {name}" for x, name in zip(direction, names, strict=True) if abs(x) > share]
            if len(parts) > 1:
                rows[" ".join(parts)] = math.sqrt(variance)
        return rows

    @table()
    def errors_of_recordings(self) -> list[Listing]:
        """Combinations of the estimates that are not determined, and errors of each recording."""
        recordings, rows = (*self.recordings, *self.held_out), self.combinations()
        before, after = zip(*(self.errors(recording) for recording in recordings), strict=True)
        error = Column("N*m", digits=3)
        columns: dict[str, tuple[Column, Any]] = {
            "recording": (Column(), [str(i + 1) for i in range(len(recordings))]),
            "used as": (Column(), ["fitted"] * len(self.recordings) + ["held out"] * len(self.held_out)),
            "model before": (error, before),
            "calibrated": (error, after),
        }
        listings = [Listing("root mean square error", columns)]
        if rows:
            columns = {
                "combination": (Column(), list(rows)),
                "deviation relative to before": (Column(digits=2), list(rows.values())),
                "determined": (Column(), [ratio < 0.5 for ratio in rows.values()]),
            }
            listings.insert(-1, Listing("combinations of what is not determined", columns))
        return listings

    def verdict(self) -> str:
        """Deviations of the stiffness along the recordings before and after, and the determined quantities."""
        before, after = self.stiffness_deviations()
        return f"stiffness: standard deviation {after:.2g} N*m/rad, {before:.2g} before; {super().verdict()}"

    def remarks(self) -> list[Remark]:
        """Misfit, contradictions of model and recordings (probability 1e-6), and quantities far from the model."""
        z = self._minima[0].z
        remedy = "which recordings had the weight, the units and the encoder's zero, and state in --prior what is known"
        remarks = misfit_remarks(self.residual, self.noise, self.highest, "N*m", remedy)
        if self.kept:
            text = "the recordings do not tell the stiffness from that of the model before, which is kept"
            remedy = "weigh the limb and state mass: 5 % in --prior, or use a heavier weight and wider angles"
            remarks.append(Remark.note("stiffness", text, remedy))
        z = np.where(np.isin(np.arange(z.size), FORCES), self._problem.prior["scatter"], 1.0) * z
        distance = float(z @ z)
        if distance > chdtri(z.size, 1e-6):
            text = f"the recordings contradict the model: it is too far from the estimates (chi-squared {distance:.3g})"
            remarks.append(Remark.warning("quantities", text, _CHECK))
        if self.held_out and not self.predicts:
            text = "the model before predicts the recordings that were held out better, and is kept in the files"
            remarks.append(Remark.warning("held_out", text, _CHECK))
        if len(self._minima) > 1:
            text = f"{len(self._minima)} minima describe the recordings; deviations contain the distances between them"
            remarks.append(Remark.note("quantities", text))
        return remarks + super().remarks()


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

    References
    ----------
    L. Ljung, System Identification, 2nd ed., Prentice Hall 1999, ch. 7 (instrumental variables); the procedure is this
    project's.
    """
    prior = prior or JointPrior()
    halves = [halves_of(recording) for recording in recordings]
    if not halves:
        raise IdentificationError("there is no recording", remedy="give at least one")
    problem = problem_of(joint, load, halves, prior)
    problem, minima, residual, noise, kept = _solve(problem, halves, scatter=prior.strength is None)
    arms = paths_and_arms(joint.geometry, halves[0][0].angle)[1]
    highest = max(scales.force for scales in problem.scales) * float(np.max(np.abs(arms)))
    model = jax.tree.map(np.ndarray.item, _models(problem, minima[0].z[:, None]))
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", McKibbenWarning)  # a correction bends a law where no recording holds it
            recheck(model)
    except RangeError as error:
        raise IdentificationError(f"the recordings contradict the model: {error.message}", remedy=_CHECK) from None
    parts = model.joint, model.load, tuple(recordings), problem, minima
    misfit = math.sqrt(max(residual**2 - noise**2, 0.0))
    return JointCalibration(quantities_of(problem, minima), *parts, residual, noise, misfit, highest, kept)


def quantities_of(problem: CalibrationProblem, minima: Sequence[LocalMinimum]) -> dict[str, JointEstimate]:
    """Return estimates by name, with the deviations of all minima about the first one."""
    evaluations = [_quantities(problem, minimum.z) for minimum in minima]
    prior = _quantities(problem, np.zeros(minima[0].z.size))[1]
    estimates = {}
    for name in evaluations[0][0]:
        value, deviation = _spread([(values[name], slopes[name]) for values, slopes in evaluations], minima)
        wide = float(np.linalg.norm(prior[name]))
        unit, logarithmic = _UNITS.get(name.rpartition(".")[2], "1"), name.endswith(_LOGARITHMIC)
        number = math.exp(value) if logarithmic else float(value)
        scale = number if logarithmic else 1.0
        expected = _EXPECTED.get(name)
        estimates[name] = JointEstimate(number, float(deviation) * scale, wide * scale, unit, logarithmic, expected)
    return estimates


def _spread(evaluations: Sequence[tuple[Any, Any]], minima: Sequence[LocalMinimum]) -> tuple[Floats, Floats]:
    """Value of a function at the best minimum, and its standard deviation about it, from value and slope at each."""
    best, total = np.asarray(evaluations[0][0]), 0.0
    for (value, slope), minimum in zip(evaluations, minima, strict=True):
        variance = np.einsum("...i,ij,...j->...", slope, minimum.covariance, slope)
        total = total + minimum.weight * (variance + np.square(np.asarray(value) - best))
    return best, np.sqrt(total)


_models = compiled(corrected)


def _stiffness(problem: CalibrationProblem, z: Floats, angle: ArrayLike, pressures: Pressures) -> tuple[Floats, Floats]:
    """Stiffness [N*m/rad] at angles and pressures, and its derivatives with respect to the parameters."""
    points = np.broadcast_arrays(*(np.asarray(x, float) for x in (angle, *pressures)))
    flat = over_periods(tuple(map(np.ravel, points)))
    values, slopes = _stiffnesses((problem, z, flat), np.eye(z.size))
    return values[:, 0].reshape(points[0].shape), slopes.reshape(*points[0].shape, z.size)


@compiled
def _stiffnesses(shared: tuple[CalibrationProblem, Array, PyTree], direction: Array) -> tuple[Array, Array]:
    """Stiffness at each point, and its derivative in a direction of the parameters."""
    problem, z, points = shared

    def at(_: tuple[()], point: tuple[Array, Array, Array]) -> PyTree:
        evaluate = lambda z: corrected(problem, z).joint.evaluate(point[0], point[1:])[1]  # noqa: E731
        return (), jax.jvp(evaluate, (z,), (direction,))

    return lax.scan(at, (), points)[1]


def _quantities(problem: CalibrationProblem, z: Floats) -> tuple[dict[str, Floats], dict[str, Floats]]:
    """Quantities by name, and their derivatives with respect to the parameters."""
    values, slopes = _directional((problem, z), np.eye(z.size))
    return {name: value[0] for name, value in values.items()}, slopes


@compiled
def _directional(
    shared: tuple[CalibrationProblem, Array], direction: Array
) -> tuple[OrderedDict[str, Array], OrderedDict[str, Array]]:
    """Quantities and their derivatives in a direction; other dictionaries would come back sorted."""
    problem, z = shared

    def values(z: Array) -> OrderedDict[str, Array]:
        joint, load, added, zero, _, inertia = corrected(problem, z)
        geometry: Any = joint.geometry
        quantities: Any = OrderedDict()
        bands = []
        creep = creep_stiffness(problem, z).sum(axis=1)
        pairs = zip((joint.muscle1, joint.muscle2), (problem.joint.muscle1, problem.joint.muscle2), strict=True)
        for i, (muscle, before) in enumerate(pairs):
            if joint.springs[i]:
                continue
            name, scales, friction = f"muscle{i + 1}", problem.scales[i], muscle.friction
            point = scales.centre, scales.pressure
            bands.append(friction.half_width)  # type: ignore[attr-defined]
            quantities[f"{name}.force"] = muscle.law.force(*point) / before.law.force(*point)
            quantities[f"{name}.friction"] = jnp.log(bands[-1])
            quantities[f"{name}.presliding"] = jnp.log(friction.presliding_length)  # type: ignore[attr-defined]
            quantities[f"{name}.creep"] = creep[i]
        quantities["friction"] = jnp.log(jnp.stack(bands).sum())
        if load.estimated_mass:
            quantities["load.mass"] = getattr(load, load.estimated_mass)
        return quantities | {"added_mass": added, "zero": zero, "arm_scale": geometry.scale, "inertia": inertia}

    return jax.jvp(values, (z,), (direction,))


def _solve(
    problem: CalibrationProblem,
    recordings: Sequence[Halves],
    *,
    scatter: bool,
    stages: int = 4,
    variance: float = 1e-3,
) -> tuple[CalibrationProblem, tuple[LocalMinimum, ...], float, float, bool]:
    """The problem, minima of all starts, the best one first, residual torque [N*m], its noise, and `kept`.

    The variances, of the torque first that stated [N^2*m^2], are estimated from the residuals in stages, and with
    `scatter` the width of the prior of the forces from their corrections (D. J. C. MacKay, Neural Computation 4, 1992).
    """
    edge = int(4 * _FILTER * RATE)
    begins = [sliding_from(problem.joint, half.angle) + edge for half, _ in recordings]
    highest = max(scales.force for scales in problem.scales)
    variances = variance * np.array([1.0, highest**2, highest**2])[: 1 + len(recordings[0][0].tensions)]

    def raw(z: Floats, half: int) -> list[tuple[Floats, Floats]]:
        """Errors, shape (samples, groups), and their Jacobians, of the even or odd samples of each recording."""
        parts = [linearised(problem, z, halves[half]) for halves in recordings]
        return [(_filtered(r, n), _filtered(j, n)) for (r, j), n in zip(parts, begins, strict=True)]

    def terms(z: Floats, instruments: int = 1) -> tuple[float, Floats, Floats]:
        """Objective with the prior, its gradient, and its Gauss-Newton Hessian."""
        scale = 1 / np.sqrt(variances)
        objective, gradient, curvature = float(z @ z) / 2, z.copy(), np.eye(PARAMETERS)
        even = raw(z, 0)
        for pair in zip(even, raw(z, 1) if instruments else even, strict=True):
            r0, r1 = ((r * scale).ravel() for r, _ in pair)
            J0, J1 = ((J * scale[:, None]).reshape(-1, PARAMETERS) for _, J in pair)
            cross = J0.T @ J1
            objective, curvature = objective + float(r0 @ r1) / 2, curvature + (cross + cross.T) / 2
            gradient += (J0.T @ r1 + J1.T @ r0) / 2
        return objective, gradient, curvature

    def errors(z: Floats) -> tuple[list[Floats], list[Floats]]:
        """Means of the halves of each recording, and half of their difference, which is noise."""
        pairs = [(r0, r1) for (r0, _), (r1, _) in zip(raw(z, 0), raw(z, 1), strict=True)]
        return [(r0 + r1) / 2 for r0, r1 in pairs], [(r0 - r1) / 2 for r0, r1 in pairs]

    search = [start(strength) for strength in STRENGTHS] + [start(exchange=sign * 0.35) for sign in (1, -1)]
    coarse = partial(terms, instruments=0)  # least squares of the even samples, at half the cost
    fits = [minimised(coarse, z, iterations=8, tolerance=1.0) for z in search]
    fits.sort(key=lambda fit: fit[1])
    z, places = fits[0][0], np.array([z for z, *_ in fits])
    for _ in range(stages):
        z, _, curvature = minimised(terms, z)
        informed = 1 - np.diag(np.linalg.inv(curvature))  # 0 of a parameter of which the recordings tell nothing
        variances = np.maximum(_variances(*errors(z), float(informed.sum())), 1e-8)
        if scatter:
            factor = math.sqrt(z[FORCES] @ z[FORCES] / informed[FORCES].sum())
            problem = problem._replace(prior={**problem.prior, "scatter": problem.prior["scatter"] * factor})
            z[FORCES], places[:, FORCES] = z[FORCES] / factor, places[:, FORCES] / factor
    first, *others = _distinct([z, *places])
    fits = [minimised(terms, first)]
    fits += [minimised(terms, z, ceiling=fits[0][1] - math.log(NEVER)) for z in others]
    fits.sort(key=lambda fit: fit[1])
    weights = probabilities([value for _, value, _ in fits]).tolist()
    best = [
        LocalMinimum(z, np.asarray(np.linalg.inv(curvature), float), weight)
        for (z, _, curvature), weight in zip(fits, weights, strict=True)
        if weight > 0
    ]
    residual, noise = (root_mean_square([column[:, 0] for column in parts]) for parts in errors(best[0].z))
    columns = zip(*((half.angle, *half.pressures) for half, _ in recordings), strict=True)
    angle, first, second = (np.concatenate(column) for column in columns)
    best, kept = supported(best, lambda z: _stiffness(problem, z, angle, (first, second)))
    return problem, tuple(best), residual, noise, kept


def supported(
    minima: list[LocalMinimum],
    function: Callable[[Floats], tuple[Floats, Floats]],
    *,
    substantial: float = math.sqrt(10),
    negligible: float = 0.01,
    steps: int = 3,
) -> tuple[list[LocalMinimum], bool]:
    """Minima with values as before, and True, unless the change of their mean has substantial evidence.

    That is a Bayes factor of at least the square root of 10 (H. Jeffreys, Theory of Probability, Oxford 1961), the
    density of no change before over that after (J. M. Dickey, Annals of Mathematical Statistics 42, 1971). The function
    returns values, shape (values,), and slopes, shape (values, parameters), of which directions of less than the
    `negligible` part of the largest are ignored. Each minimum moves in Newton steps; its deviations contain the change.
    """
    before, slopes = function(np.zeros(minima[0].z.size))
    way = slopes.mean(axis=0) / np.linalg.norm(slopes.mean(axis=0))
    weights, change, spread = np.array([(m.weight, way @ m.z, way @ m.covariance @ way) for m in minima]).T
    if np.sum(weights * np.exp(-(change**2) / (2 * spread)) / np.sqrt(spread)) * substantial <= 1:
        return minima, False
    kept = []
    for minimum in minima:
        (z, covariance, _), moved = minimum, minimum.z
        for _ in range(steps):
            now, slopes = function(moved)
            left, sizes, rows = np.linalg.svd(slopes, full_matrices=False)
            rows = rows[: (rank := int(np.sum(sizes > negligible * sizes[0])))]
            along = left.T[:rank] @ (now - before) / sizes[:rank]
            moved = moved - covariance @ rows.T @ np.linalg.solve(rows @ covariance @ rows.T, along)
        kept.append(minimum._replace(z=moved, covariance=covariance + np.outer(z - moved, z - moved)))
    return kept, True


def _filtered(column: Floats, begin: int) -> Floats:
    """Low-pass filtered rows of samples from the first one of interest on, without the edge of the filter."""
    return (_filter(len(column), begin) @ column.reshape(len(column), -1)).reshape(-1, *column.shape[1:])


@cache
def _filter(samples: int, begin: int) -> PyTree:
    """Gaussian filter as a sparse matrix, shape (filtered samples, samples)."""
    width = _FILTER * RATE
    places = np.arange(2 * int(4 * width) + 1)
    weights = np.exp(-(((places - places.size // 2) / width) ** 2) / 2)
    rows = sparse.diags_array(weights / weights.sum(), offsets=places, shape=(samples - places.size + 1, samples))
    return rows.tocsr()[begin - places.size // 2 :: int(width / 2)]


def _distinct(points: Sequence[Floats]) -> list[Floats]:
    """Points that are farther than a prior standard deviation from all before."""
    chosen: list[Floats] = []
    for z in points:
        if all(np.linalg.norm(z - other) > 1.0 for other in chosen):
            chosen.append(z)
    return chosen


def _variances(errors: list[Floats], noise: list[Floats], determined: float) -> Floats:
    """Variance of a sample of each group, for the information of independent samples.

    The noise is correlated over some samples. The error of the model counts as in `variance_of`.
    """
    times = np.mean([[correlation_time(column) for column in half.T] for half in noise], axis=0)
    whole, white = (np.mean(np.concatenate(parts) ** 2, axis=0) for parts in (errors, noise))
    return white * times + np.maximum(whole - white, 0.0) * sum(map(len, errors)) / determined


def start(strength: float = 0.0, exchange: float = 0.0) -> Floats:
    """Start of a search, in prior standard deviations: `STRENGTHS`, or friction of the other muscle, and presliding."""
    z = np.zeros(PARAMETERS)
    muscles = z[: 2 * OF_MUSCLE].reshape(2, OF_MUSCLE)
    muscles[:, COEFFICIENTS] = strength
    muscles[:, -3:-1] = np.outer((exchange, -exchange), (1.0, -1.0))
    return z


def minimised(
    terms: Callable[[Floats], tuple[float, Floats, Floats]],
    z: Floats,
    *,
    iterations: int = 25,
    tolerance: float = 1e-3,
    ceiling: float = math.inf,
    farthest: float = 2.0,
) -> tuple[Floats, float, Floats]:
    """Minimum of an objective with its gradient and second derivatives, its value and these there, by a trust region.

    The search ends where a step would lower the objective by less than the tolerance, or where even the minimum of its
    quadratic model is above the ceiling. Steps have at most a length of 1, later of `farthest`, in prior standard
    deviations (J. Nocedal and S. Wright, Numerical Optimization, 2nd ed., Springer 2006, ch. 4).
    """
    (value, gradient, curvature), radius = terms(z), 1.0
    for _ in range(iterations):
        sizes, directions = np.linalg.eigh(curvature)
        sizes = np.maximum(sizes, 1.0)  # that of the prior: information is not negative
        along = directions.T @ gradient
        if value - np.sum(along**2 / sizes) / 2 > ceiling:
            break
        step = _bounded_step(along, sizes, radius)
        expected = -float(along @ step + step @ (sizes * step) / 2)
        if expected < tolerance:
            break
        there = terms(z + directions @ step)
        gain = (value - there[0]) / expected
        if gain > 0.75 and np.linalg.norm(step) > 0.99 * radius:
            radius = min(2 * radius, farthest)
        elif not gain > 0.25:
            radius = float(np.linalg.norm(step)) / 4
        if gain > 0.15:
            z, (value, gradient, curvature) = z + directions @ step, there
    return z, value, curvature


def _bounded_step(gradient: Floats, sizes: Floats, radius: float) -> Floats:
    """Step of at most a length to the minimum of a quadratic, whose second derivatives are a positive diagonal."""
    damping = 0.0
    for _ in range(30):  # Newton steps for the reciprocal of the length, which is nearly linear in the damping
        step = -gradient / (sizes + damping)
        length = np.linalg.norm(step)
        if length <= 1.001 * radius:
            break
        damping += (length / radius - 1) * length**2 / float(step @ (step / (sizes + damping)))
    return step
