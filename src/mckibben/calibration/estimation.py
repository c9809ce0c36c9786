"""Identification on the joint: from recordings of its motion to the muscles' laws, load and encoder zero."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, ArrayLike
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d
from scipy.signal import savgol_filter

from mckibben.errors import IdentificationError
from mckibben.joint import AntagonisticJoint, Load, RigidTendon, ScaledArms
from mckibben.joint.geometry import Pressures
from mckibben.muscle import ForceCorrection, MaxwellCreep, MaxwellSlip, corrected_law
from mckibben.numerics.compiled import compiled
from mckibben.units import deg, mm

Floats = NDArray[np.float64]

GRAVITY = 9.81  # m/s^2
_RATE = 50.0  # Hz, of the samples that are fitted
_WINDOW = 0.05  # s, of the local cubic fits that differentiate: short, as they attenuate accelerations
_SHORTEST, _LONGEST_PERIOD = 5.0, 0.01  # s, of a recording and between its samples
_FILTER = 0.1  # s, standard deviation of the filter of the equations
_COEFFICIENTS = 3  # of each polynomial of a correction
_OF_MUSCLE = 2 * _COEFFICIENTS + 2  # parameters: those, friction and presliding
_BEYOND = 1.2  # half width of the corrections over that of the contractions measured
_SLIDING = 6.0  # presliding lengths of travel after which the friction's state at the start is forgotten
_BAND, _PRESLIDING = 0.02, 2e-3  # friction where the model has none, over highest force and initial length
_CREEP_TIME, _CREEP_ARMS = 1.0, 2  # s: time constants of 1 and 10 s
_START_VARIANCE = 1e-3  # of the torque [N^2*m^2], before residuals tell it
_LEAST_VARIANCE = 1e-8
_STARTS = (0.0, -1.0, 1.0)
_FIRST, _STAGES, _ITERATIONS, _MOST_DAMPING, _TOLERANCE = 8, 3, 25, 1e3, 1e-2
DETERMINED = 0.5
"""Posterior over prior standard deviation below which a quantity counts as determined by the recordings."""


@dataclass(frozen=True, eq=False)
class JointRecording:
    """Measured motion of a joint.

    Attributes
    ----------
    time, angle
        Equally spaced times [s] and angles [rad], shape (samples,).
    pressures, tensions
        Gauge pressures [Pa] of muscles 1 and 2, and their tensions [N] if there are load cells; shape (samples, 2).
    added_mass, distance
        A known weight [kg] on the limb, and its distance from the axis [m].
    """

    time: Floats
    angle: Floats
    pressures: Floats
    tensions: Floats | None = None
    added_mass: float = 0.0
    distance: float = 0.0


@dataclass(frozen=True)
class JointPrior:
    """Standard deviations of what a calibration estimates, before it; relative ones refer to the model.

    Attributes
    ----------
    strength, offset
        Of the pressure-proportional and of the constant part of a muscle's force, relative to the law's force at its
        highest pressure and the middle contraction; of each further power of contraction half of that of the last.
    friction, presliding
        Of the half width of the friction band, relative, and of the logarithm of the presliding length.
    creep
        Of the stiffness of creep over the slope of the law. It is not estimated, but widens the intervals.
    mass
        Of the load's mass (`Load.adapted_mass`), relative.
    added_mass, load_cell
        Of the added weight and of the gains of load cells, relative.
    zero
        Of the encoder's zero [rad].
    arm_scale
        Of the scale of the moment arms.
    """

    strength: float = 0.1
    offset: float = 0.05
    friction: float = 0.6
    presliding: float = 0.5
    creep: float = 0.05
    mass: float = 0.3
    added_mass: float = 0.01
    load_cell: float = 0.01
    zero: float = 0.5 * deg
    arm_scale: float = 0.02


class _Samples(NamedTuple):
    """Smoothed samples of a recording, each of shape (samples,); scalars of the weight."""

    angle: Any
    velocity: Any
    acceleration: Any
    pressures: tuple[Any, Any]
    tensions: tuple[Any, ...]
    inertia: Any  # of the added weight as it is believed [kg*m^2]
    moment: Any  # [N*m]


_Halves = tuple[_Samples, _Samples]


class _Problem(NamedTuple):
    """The model, and for each muscle the scales of its correction."""

    joint: AntagonisticJoint
    load: Load
    force: tuple[float, ...]  # highest force at the middle contraction [N]
    highest: tuple[float, ...]  # pressure [Pa]
    centre: tuple[float, ...]
    half_width: tuple[float, ...]
    pressure: tuple[float, ...]  # mean of those measured [Pa]
    creep: tuple[float, ...]  # standard deviation of its stiffness [N/m]
    prior: dict[str, float]


class _Corrected(NamedTuple):
    """Model by parameters."""

    joint: AntagonisticJoint
    load: Load
    added_mass: Any  # over what it is believed to be
    zero: Any  # [rad]
    load_cells: tuple[Any, Any]  # gains


@dataclass(frozen=True)
class JointEstimate:
    """An estimated quantity in SI, its standard deviation, and that before the recordings."""

    value: float
    deviation: float
    prior: float
    unit: str

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
        Estimates by name: ``muscle1.force`` (over the model's, at the middle contraction and the mean
        pressure), ``muscle1.friction``, ``muscle1.presliding``, ``friction`` (sum of both half widths), ``load.mass``,
        ``added_mass`` (over what it was believed to be), ``zero`` (reading of the encoder at the angle 0),
        ``arm_scale``.
    residual
        Root mean square of the error of the equation of motion [N*m], low-pass filtered.
    """

    joint: AntagonisticJoint
    load: Load
    quantities: dict[str, JointEstimate]
    residual: float
    _problem: _Problem
    _estimate: Floats
    _covariance: Floats

    def stiffness(self, angle: ArrayLike, pressures: Pressures) -> tuple[Floats, Floats]:
        """Return stiffness [N*m/rad] and its standard deviation at angles [rad] and gauge pressures [Pa]."""
        value, slope = _stiffness(self._problem, jnp.asarray(self._estimate), jnp.asarray(angle, float), pressures)
        return np.asarray(value), _deviation(np.asarray(slope), self._covariance)

    def prior_stiffness(self, angle: ArrayLike, pressures: Pressures) -> tuple[Floats, Floats]:
        """Return what `stiffness` was before the recordings."""
        start = jnp.zeros(self._estimate.size)
        value, slope = _stiffness(self._problem, start, jnp.asarray(angle, float), pressures)
        return np.asarray(value), _deviation(np.asarray(slope), np.eye(self._estimate.size))

    def __repr__(self) -> str:
        found = [name for name, one in self.quantities.items() if one.determined]
        return f"<JointCalibration: residual {self.residual:.3g} N*m, determined: {', '.join(found) or 'nothing'}>"


def calibrate_joint(
    joint: AntagonisticJoint, load: Load, recordings: Sequence[JointRecording], prior: JointPrior | None = None
) -> JointCalibration:
    r"""Identify a joint from recordings of its motion, some of them best with a known added weight.

    The equation of motion (Eq. 6) of both muscles, with friction and creep along the measured path, is fitted to all
    recordings at once:

    .. math::

        (I + m_w l_w^2)\,\ddot\theta + c\dot\theta = \tau(\theta - \theta_0, p_1, p_2) + (G + m_w l_w g)
        \sin(\theta_h - \theta + \theta_0)

    Each muscle's law gets a `ForceCorrection`. Parameters have Gaussian priors. Under a single load the forces are
    known up to a factor; a known weight, or load cells, give the factor.

    Noise of the pressures is in the regressors as well, which biases least squares. So the estimates are those of
    instrumental variables, begun at least squares: even samples are the instruments of the odd ones, and the other way
    round. The variance of the torque is that of the residuals times their correlation time.

    Parameters
    ----------
    joint, load
        The model before, the mean of the prior. A muscle without friction gets a band whose width is estimated.
    recordings
        At least one. Slow sweeps in both directions, at several co-contractions, tell most; some faster motion tells
        the load's mass.
    prior
        Standard deviations before.

    Raises
    ------
    IdentificationError
        If a recording is too short, too slowly sampled or at rest, or holds numbers that are not finite.

    References
    ----------
    L. Ljung, System Identification, 2nd ed., Prentice Hall 1999, ch. 7 (instrumental variables); the procedure is
    this project's, docs/calibrate.md.
    """
    prior = prior or JointPrior()
    halves = [_halves(one) for one in recordings]
    if not halves:
        raise IdentificationError("there is no recording", remedy="give at least one")
    problem = _problem(joint, load, halves, prior)
    estimate, covariance, residual = _solve(problem, halves)
    names, units = _quantity_names(problem)
    value, slope = _quantities(problem, jnp.asarray(estimate))
    before = np.asarray(_quantities(problem, jnp.zeros(estimate.size))[1])
    deviation, wide = _deviation(np.asarray(slope), covariance), _deviation(before, np.eye(estimate.size))
    rows = zip(names, np.asarray(value).tolist(), deviation.tolist(), wide.tolist(), units, strict=True)
    found = jax.tree.map(_number, _corrected(problem, jnp.asarray(estimate)))
    return JointCalibration(
        found.joint,
        found.load,
        {row[0]: JointEstimate(*row[1:]) for row in rows},
        residual,
        problem,
        estimate,
        covariance,
    )


def _number(leaf: Any) -> Any:
    return float(leaf) if isinstance(leaf, jax.Array) and leaf.ndim == 0 else leaf


def _deviation(slope: Floats, covariance: Floats) -> Floats:
    return np.sqrt(np.einsum("...i,ij,...j->...", slope, covariance, slope))


def _halves(recording: JointRecording) -> _Halves:
    """Even and odd samples, whose noise is independent, smoothed and at the same times."""
    columns = [recording.time, recording.angle, recording.pressures]
    columns += [] if recording.tensions is None else [recording.tensions]
    if not all(np.all(np.isfinite(column)) for column in columns):
        raise IdentificationError("a recording holds numbers that are not finite", remedy="leave such rows out")
    time = recording.time
    if time.size < 50 or time[-1] - time[0] < _SHORTEST:
        raise IdentificationError(
            f"a recording of {time.size} samples over {np.ptp(time) if time.size else 0:.3g} s is too short",
            value=time.size,
            remedy=f"record at least {_SHORTEST:g} s",
        )
    period = (time[-1] - time[0]) / (time.size - 1)
    width = max(2 * int(_WINDOW / (4 * period)) + 1, 5)
    if period > _LONGEST_PERIOD or np.ptp(np.diff(time)) > period:
        raise IdentificationError(
            f"the samples of a recording, {period * 1e3:.3g} ms apart in the mean, are too far or not equally spaced",
            value=period,
            unit="s",
            remedy=f"record at {1 / _LONGEST_PERIOD:.0f} Hz or more",
        )
    margin = 2 * width * period
    grid = np.arange(time[0] + margin, time[-1] - margin, 1 / _RATE)
    mass, distance = recording.added_mass, recording.distance

    def half(begin: int) -> _Samples:
        def fit(column: Floats, derivative: int = 0) -> Floats:
            smooth: Any = savgol_filter(column[begin::2], width, 3, deriv=derivative, delta=2 * period)
            return np.interp(grid, time[begin::2], smooth)

        tensions = recording.tensions
        return _Samples(
            fit(recording.angle),
            fit(recording.angle, 1),
            fit(recording.angle, 2),
            (fit(recording.pressures[:, 0]), fit(recording.pressures[:, 1])),
            () if tensions is None else (fit(tensions[:, 0]), fit(tensions[:, 1])),
            np.float64(mass * distance**2),
            np.float64(mass * distance * GRAVITY),
        )

    return half(0), half(1)


def _problem(joint: AntagonisticJoint, load: Load, recordings: Sequence[_Halves], prior: JointPrior) -> _Problem:
    muscles, scales = [], []
    angle = np.concatenate([half.angle for half, _ in recordings])
    for muscle, spring, path in zip(
        (joint.muscle1, joint.muscle2), joint.springs, joint.geometry.path_lengths(angle), strict=True
    ):
        contraction = np.asarray(muscle.specimen.contraction_at(path))
        low, high = float(contraction.min()), float(contraction.max())
        if high - low < 1e-3:
            raise IdentificationError("the joint is at rest in the recordings", remedy="record sweeps of its range")
        middle, most = (low + high) / 2, float(muscle.domain.pressure_max)
        force = float(muscle.tension(middle, most))
        creep = prior.creep * abs(float(muscle.slope(middle, most))) / float(muscle.specimen.initial_length)
        mean = float(np.mean([half.pressures[len(scales)].mean() for half, _ in recordings]))
        scales.append((force, most, middle, _BEYOND * (high - low) / 2, mean, creep))
        if not (spring or muscle.has_friction):
            band = MaxwellSlip(_BAND * force, _PRESLIDING * float(muscle.specimen.initial_length))
            muscle = dataclasses.replace(muscle, friction=band)
        muscles.append(muscle)
    joint = dataclasses.replace(joint, muscle1=muscles[0], muscle2=muscles[1])
    force, highest, centre, half_width, pressure, creep = zip(*scales, strict=True)
    return _Problem(joint, load, force, highest, centre, half_width, pressure, creep, dataclasses.asdict(prior))


def _muscle_parameters(problem: _Problem) -> int:
    return _OF_MUSCLE * problem.joint.springs.count(False)


def _parameters(problem: _Problem) -> int:
    """Number of parameters: those of the muscles, the load's mass, the weight, zero, arms, and both load cells."""
    return _muscle_parameters(problem) + 6


def _corrected(problem: _Problem, z: Array) -> _Corrected:
    """The model by parameters in prior standard deviations from their prior mean."""
    prior, joint, load = problem.prior, problem.joint, problem.load
    muscles, shrink, n = [], 0.5 ** np.arange(_COEFFICIENTS), _COEFFICIENTS
    own = iter(z[: _muscle_parameters(problem)].reshape(-1, _OF_MUSCLE))
    for i, muscle in enumerate((joint.muscle1, joint.muscle2)):
        if joint.springs[i]:
            muscles.append(muscle)
            continue
        values, force = next(own), problem.force[i]
        correction = ForceCorrection(
            tuple(values[:n] * shrink * (prior["offset"] * force)),
            tuple(values[n : 2 * n] * shrink * (prior["strength"] * force / problem.highest[i])),
            problem.centre[i],
            problem.half_width[i],
        )
        friction: Any = muscle.friction
        friction = dataclasses.replace(
            friction,
            half_width=friction.half_width * jnp.maximum(1 + prior["friction"] * values[2 * n], 0.01),
            presliding_length=friction.presliding_length * jnp.exp(prior["presliding"] * values[2 * n + 1]),
        )
        muscles.append(dataclasses.replace(muscle, law=corrected_law(muscle.law, correction), friction=friction))
    mass, added, zero, arms, cell1, cell2 = z[_muscle_parameters(problem) :]
    if load.adapted_mass:
        more = getattr(load, load.adapted_mass) * (1 + prior["mass"] * mass)
        load = dataclasses.replace(load, **{load.adapted_mass: more})
    geometry = ScaledArms(joint.geometry, 1 + prior["arm_scale"] * arms)
    return _Corrected(
        dataclasses.replace(joint, geometry=geometry, muscle1=muscles[0], muscle2=muscles[1]),
        load,
        1 + prior["added_mass"] * added,
        prior["zero"] * zero,
        (1 + prior["load_cell"] * cell1, 1 + prior["load_cell"] * cell2),
    )


def _with_creep(problem: _Problem, joint: AntagonisticJoint, z: Any) -> AntagonisticJoint:
    """The joint with creep, in standard deviations, of the muscles whose model has none."""
    if not isinstance(joint.tendon, RigidTendon):
        return joint
    muscles = {
        f"muscle{i + 1}": dataclasses.replace(
            muscle, creep=MaxwellCreep(problem.creep[i] * z[i], _CREEP_TIME, arms=_CREEP_ARMS)
        )
        for i, muscle in enumerate((joint.muscle1, joint.muscle2))
        if not (joint.springs[i] or muscle.has_creep)
    }
    return dataclasses.replace(joint, **muscles)


def _errors(problem: _Problem, z: Array, samples: _Samples) -> Array:
    """Errors of the equation of motion [N*m] and of the load cells [N], shape (samples, 1 or 3).

    The last two parameters are the stiffnesses of creep.
    """
    joint, load, added, zero, cells = _corrected(problem, z[:-2])
    joint = _with_creep(problem, joint, z[-2:])
    angle = samples.angle - zero

    def step(states: Any, row: Any) -> tuple[Any, Any]:
        angle, velocity, pressures = row
        states = joint.update_state(states, angle, pressures)
        found = joint.forces(angle, velocity, pressures, states)
        if joint.has_creep:
            rates = joint.state_rate(states, angle, velocity)
            states = tuple(
                one._replace(creep=tuple(x + rate / _RATE for x, rate in zip(one.creep, each.creep, strict=True)))
                for one, each in zip(states, rates, strict=True)
            )
        return states, (found.torque, found.tensions)

    start = joint.init_state(angle[0], (samples.pressures[0][0], samples.pressures[1][0]))
    torque, tensions = lax.scan(step, start, (angle, samples.velocity, samples.pressures))[1]
    weight = added * samples.moment * jnp.sin(load.hanging_angle - angle)
    needed = load.required_torque(angle, samples.velocity, samples.acceleration) - weight
    errors = [needed + added * samples.inertia * samples.acceleration - torque]
    pairs = zip(samples.tensions, cells, tensions, strict=True) if samples.tensions else ()
    return jnp.stack([*errors, *(measured - gain * tension for measured, gain, tension in pairs)], axis=1)


@compiled
def _linearised(problem: _Problem, z: Any, samples: _Samples) -> tuple[Array, Array]:
    return _errors(problem, z, samples), jax.jacfwd(lambda z: _errors(problem, z, samples))(z)


@compiled
def _stiffness(problem: _Problem, z: Array, angle: Array, pressures: Pressures) -> tuple[Array, Array]:
    def stiffness(z: Array) -> Array:
        return _corrected(problem, z).joint.evaluate(angle, pressures)[1]

    return stiffness(z), jax.jacfwd(stiffness)(z)


@compiled
def _quantities(problem: _Problem, z: Array) -> tuple[Array, Array]:
    """Values of `_quantity_names` and their derivatives."""

    def values(z: Array) -> Array:
        joint, load, added, zero, _ = _corrected(problem, z)
        found, bands = [], []
        pairs = zip((joint.muscle1, joint.muscle2), (problem.joint.muscle1, problem.joint.muscle2), strict=True)
        for i, (muscle, before) in enumerate(pairs):
            if joint.springs[i]:
                continue
            point = problem.centre[i], problem.pressure[i]
            friction: Any = muscle.friction
            bands.append(friction.half_width)
            ratio = muscle.law.force(*point) / before.law.force(*point)
            found += [ratio, friction.half_width, friction.presliding_length]
        found += [sum(bands)] + ([getattr(load, load.adapted_mass)] if load.adapted_mass else [])
        return jnp.stack([*found, added, zero, 1 + problem.prior["arm_scale"] * z[-3]])

    return values(z), jax.jacfwd(values)(z)


def _quantity_names(problem: _Problem) -> tuple[list[str], list[str]]:
    """Names and units of the quantities."""
    rows = []
    for i, spring in enumerate(problem.joint.springs, 1):
        if not spring:
            rows += [(f"muscle{i}.force", "1"), (f"muscle{i}.friction", "N"), (f"muscle{i}.presliding", "m")]
    rows += [("friction", "N"), *([("load.mass", "kg")] if problem.load.adapted_mass else [])]
    rows += [("added_mass", "1"), ("zero", "rad"), ("arm_scale", "1")]
    names, units = zip(*rows, strict=True)
    return list(names), list(units)


def _solve(problem: _Problem, recordings: Sequence[_Halves]) -> tuple[Floats, Floats, float]:
    """Estimates and covariance of the parameters, and the residual torque [N*m]."""
    count, edge, stride = _parameters(problem), int(4 * _FILTER * _RATE), int(_FILTER * _RATE / 2)
    starts = [_sliding_from(problem, half) + edge for half, _ in recordings]
    groups = 1 + len(recordings[0][0].tensions)
    highest = np.asarray(problem.force).max()
    variances = np.full(groups, _START_VARIANCE) * np.array([1.0, highest**2, highest**2])[:groups]

    def filtered(column: Array, start: int) -> Floats:
        return gaussian_filter1d(np.asarray(column), _FILTER * _RATE, axis=0)[start:-edge:stride]

    def raw(z: Floats) -> list[list[tuple[Floats, Floats]]]:
        """Errors, shape (samples, groups), and their Jacobians, of each recording, for both halves."""
        found = [[_linearised(problem, np.append(z, (0.0, 0.0)), one[half]) for one in recordings] for half in (0, 1)]
        return [[(filtered(r, n), filtered(j, n)) for (r, j), n in zip(one, starts, strict=True)] for one in found]

    def data(z: Floats) -> tuple[float, Floats, Floats]:
        """Objective without the prior, its gradient, and its second derivatives without those of the errors."""
        scale = 1 / np.sqrt(variances)
        (r0, J0), (r1, J1) = (
            (
                np.concatenate([(r * scale).ravel() for r, _ in one]),
                np.concatenate([(j * scale[:, None]).reshape(-1, count + 2) for _, j in one]),
            )
            for one in raw(z)
        )
        cross = J0.T @ J1
        return float(r0 @ r1) / 2, (J0.T @ r1 + J1.T @ r0) / 2, (cross + cross.T) / 2

    def terms(z: Floats) -> tuple[float, Floats, Floats]:
        """The same with the prior, of the estimated parameters."""
        objective, gradient, curvature = data(z)
        return objective + float(z @ z) / 2, gradient[:count] + z, curvature[:count, :count] + np.eye(count)

    means: list[Floats] = []
    begun = [_minimised(terms, _start(problem, strength), _FIRST) for strength in _STARTS]
    z = min(begun, key=lambda z: terms(z)[0])
    for _ in range(_STAGES):
        z = _minimised(terms, z)
        even, odd = raw(z)
        means = [(a + b) / 2 for (a, _), (b, _) in zip(even, odd, strict=True)]
        variances = np.array([_variance([one[:, i] for one in means]) for i in range(groups)])
    torque = np.concatenate([one[:, 0] for one in means])
    covariance: Any = np.linalg.inv(terms(z)[2])
    creep = covariance @ data(z)[2][:count, count:]  # change of the estimates by creep of one standard deviation
    return z, covariance + creep @ creep.T, float(np.sqrt(np.mean(torque**2)))


def _start(problem: _Problem, strength: float) -> Floats:
    """Start of a search, with a strength of all muscles in prior standard deviations: slack ones make local minima."""
    z = np.zeros(_parameters(problem))
    z[: _muscle_parameters(problem)].reshape(-1, _OF_MUSCLE)[:, _COEFFICIENTS] = strength
    return z


def _minimised(terms: Callable[[Floats], tuple[float, Floats, Floats]], z: Floats, most: int = _ITERATIONS) -> Floats:
    """Levenberg-Marquardt minimum of an objective that comes with its gradient and second derivatives."""
    objective, gradient, curvature = terms(z)
    damping = 1e-3
    for _ in range(most):
        step = np.linalg.solve(curvature + damping * np.diag(np.abs(np.diag(curvature))), gradient)
        tried = terms(z - step)
        if tried[0] < objective:
            z, (objective, gradient, curvature), damping = z - step, tried, max(damping / 5, 1e-9)
            if np.abs(step).max() < _TOLERANCE:
                break
        elif (damping := 4 * damping) > _MOST_DAMPING:
            break
    return z


def _sliding_from(problem: _Problem, samples: _Samples) -> int:
    """First sample at which the friction does not depend on its unknown state at the start."""
    joint, first = problem.joint, 0
    for muscle, path in zip((joint.muscle1, joint.muscle2), joint.geometry.path_lengths(samples.angle), strict=True):
        travelled = np.maximum.accumulate(path) - np.minimum.accumulate(path)
        enough = travelled > _SLIDING * float(getattr(muscle.friction, "presliding_length", 0.0))
        if not enough.any() or int(np.argmax(enough)) > len(enough) // 2:
            raise IdentificationError(
                f"muscle lengths change by no more than {np.max(travelled) / mm:.2g} mm in a recording",
                value=float(np.max(travelled)),
                unit="m",
                remedy="record sweeps of a larger angle: friction hides the force in small motions",
            )
        first = max(first, int(np.argmax(enough)))
    return first


def _variance(parts: list[Floats]) -> float:
    """Variance of residuals times the number of samples that are as good as one independent sample."""
    total, times = 0.0, []
    for one in parts:
        spectrum = np.abs(np.fft.rfft(one, 2 * one.size)) ** 2
        correlation = np.fft.irfft(spectrum)[: one.size]
        correlation /= max(correlation[0], 1e-300)
        negative = np.flatnonzero(correlation < 0)
        times.append(1 + 2 * correlation[1 : negative[0] if negative.size else one.size].sum())
        total += one @ one
    return max(float(total / sum(one.size for one in parts) * np.mean(times)), _LEAST_VARIANCE)
