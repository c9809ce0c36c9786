"""Equations of motion with unknown laws, friction, loads and sensors, along recordings."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array

from mckibben.calibration.models import Moved, Weight
from mckibben.calibration.recordings import (
    Floats,
    JointPrior,
    JointRecording,
    Number,
    Samplings,
    check_recording,
    evenly,
    local_cubic,
    sampling_period,
)
from mckibben.codegen.engine import compiled
from mckibben.errors import IdentificationError
from mckibben.muscle import ForceCorrection, MaxwellSlip, Muscle, adjusted_law
from mckibben.muscle.friction import smooth_limit
from mckibben.muscle.muscle import warn_outside
from mckibben.units import mm

RATE = 50.0  # Hz, of the fitted samples
CREEP_TIMES = np.array([1.0, 3.0, 10.0])  # s, of the Maxwell arms of each muscle
SLIPS = np.geomspace(1 / 8, 4, 6)
"""Slip lengths of the elements of friction, relative to the presliding length of the model."""
_COEFFICIENTS = 3  # of each polynomial of a correction
_BLOCKS = np.cumsum([0, 2 * _COEFFICIENTS, 1, SLIPS.size, 1, CREEP_TIMES.size]).tolist()
OF_MUSCLE = _BLOCKS[-1]
"""Parameters of a muscle: coefficients of its law's correction, friction, shares of its slip lengths, growth, creep."""


class MotionSamples(NamedTuple):
    """Smoothed samples of a recording, and the memory of the muscles along its path.

    Attributes
    ----------
    angle, velocity, acceleration
        Shape (samples, joints).
    pressures, tensions
        Gauge pressures in the muscles [Pa], and readings of load cells [N]; shape (samples, muscles), or (samples, 0).
    stops
        Deflections of the elements of friction, relative to their slip lengths, shape (samples, muscles, elements).
    creep
        Deflections of the springs of creep [m], shape (samples, muscles, arms).
    """

    angle: Samplings
    velocity: Samplings
    acceleration: Samplings
    pressures: Samplings
    tensions: Samplings
    stops: Samplings
    creep: Samplings


class Recorded(NamedTuple):
    """Samples of a recording, its weight, and the first sample that does not depend on unknown states before it."""

    samples: MotionSamples
    weight: Weight
    begin: int


class Scales(NamedTuple):
    """Scales of the correction of a muscle."""

    force: float  # highest force at the middle contraction [N]
    highest: float  # pressure [Pa]
    centre: float  # middle contraction
    half_width: float
    pressure: float  # mean of the measured pressures [Pa]
    creep: float  # standard deviation of its stiffness [N/m]


class CalibrationProblem(NamedTuple):
    """The model, and prior deviations of what is estimated about it.

    Parameters z are in prior standard deviations from the model: `OF_MUSCLE` of each muscle (those of a return spring
    have no effect), then those of `names_of`.
    """

    model: Any  # Moved
    scales: tuple[Scales, ...]
    muscles: dict[str, float]  # deviations of the quantities of each muscle, as `JointPrior` names them
    others: tuple[float, ...]  # of the parameters of `names_of`

    @property
    def size(self) -> int:
        """Number of parameters."""
        return OF_MUSCLE * len(self.scales) + len(self.others)

    def as_correction(self, number: int) -> Floats:
        """Parameters of the correction that is nearest to the law of a muscle itself: its first ones."""
        scales = self.scales[number]
        v, pressure = np.meshgrid(np.linspace(-1, 1, 9), np.linspace(0.3, 1, 8) * scales.highest)
        force = _forces(self.model.muscles[number], (scales.centre + scales.half_width * v.ravel(), pressure.ravel()))
        powers = (v.ravel()[:, None] / 2) ** np.arange(_COEFFICIENTS)
        offsets = powers * self.muscles["offset"] * scales.force
        gains = powers * self.muscles["strength"] * scales.force * pressure.ravel()[:, None] / scales.highest
        return np.linalg.lstsq(np.concatenate([offsets, gains], axis=1), force)[0]


class Corrected(NamedTuple):
    """Model for given parameters, and those of the recordings by name: zeros, weight and load cells."""

    model: Any  # Moved
    values: dict[str, Number]


def _others(model: Moved, prior: JointPrior) -> dict[str, float]:
    """Prior deviations of the parameters that are not a muscle's; of damping relative to critical damping."""
    each = {f"{joint}zero": prior.zero_of(model.joint_type) for joint in model.joint_names}
    each |= {f"{joint}damping": prior.damping for joint in model.joint_names}
    each |= {"added_mass": prior.added_mass, "distance": prior.distance}
    return each | {f"{name}.load_cell": prior.load_cell for name in model.muscle_names} | model.priors(prior)


def names_of(model: Moved) -> tuple[str, ...]:
    """Names of the parameters that are not a muscle's: differences of zeros and dampings, factors of others."""
    return tuple(_others(model, JointPrior()))


def is_difference(name: str) -> bool:
    """Whether a parameter is a difference, and not a factor."""
    return name.endswith(("zero", "damping"))


def samples_of(model: Moved, recording: JointRecording, *, lengths: float = 6.0) -> Recorded:
    """Return samples of a recording at 50 Hz, of cubic fits to 50 ms of the measured ones.

    The states of the muscles at the start are unknown. They are forgotten after a travel of some presliding lengths.

    Raises
    ------
    IdentificationError
        If numbers are not finite, the samples are too few, too sparse or have gaps, or the muscles do not travel that
        far within the first half of the samples.
    """
    check_recording(recording)
    time, period = recording.time, sampling_period(recording)
    grid = np.arange(time[0], time[-1], 1 / RATE)

    def fit(columns: Floats | None, derivative: int = 0) -> Floats:
        if columns is None:
            return np.zeros((grid.size, 0))
        even = [evenly(time, column, period) for column in columns.reshape(time.size, -1).T]
        places = time[0] + period * np.arange(time.size)
        for _ in range(derivative):  # a second derivative at once would lose 3 % at 4 Hz, and all inertias with it
            even = [local_cubic(x, period, 1) for x in even]
        return np.stack([np.interp(grid, places, local_cubic(x, period)) for x in even], axis=1)

    angle, pressures = fit(recording.angle), fit(_in_the_muscles(recording, period))
    path = np.stack(paths_of(model, angle), axis=1)
    slips = np.stack([SLIPS * _presliding(muscle) for muscle in model.muscles])
    travel = np.maximum.accumulate(path) - np.minimum.accumulate(path)
    passive = [is_spring(muscle) for muscle in model.muscles]
    enough = np.all((travel > lengths * slips[:, -1] / SLIPS[-1]) | passive, axis=1)
    if not enough.any() or (begin := int(np.argmax(enough))) > enough.size // 2:
        travelled = float(np.ptp(path, axis=0).min())
        message, remedy = f"muscle lengths change by no more than {travelled / mm:.2g} mm", "sweep larger angles"
        raise IdentificationError(
            message, value=travelled, unit="m", remedy=f"{remedy}: friction hides the force in small motions"
        )
    stops, creep = np.zeros((*path.shape, SLIPS.size)), np.zeros((*path.shape, CREEP_TIMES.size))
    decay = np.exp(-1 / (RATE * CREEP_TIMES))
    for k, moved in enumerate(np.diff(path, axis=0)[..., None], 1):
        stops[k] = np.clip(stops[k - 1] + moved / slips, -1, 1)
        creep[k] = decay * creep[k - 1] + np.sqrt(decay) * moved
    motion = angle, fit(recording.angle, 1), fit(recording.angle, 2)
    samples = MotionSamples(*motion, pressures, fit(recording.tensions), stops, creep)
    weight = Weight(recording.added_mass, recording.distance, recording.weight_inertia)
    return Recorded(samples, Weight(*map(np.float64, weight)), begin)


def _in_the_muscles(recording: JointRecording, period: float) -> Floats:
    """Pressures [Pa] in the muscles, behind a tube of a first-order lag, shape (samples, muscles)."""
    if not recording.tube:
        return recording.pressures
    from scipy.signal import lfilter  # 1 s

    keep = np.exp(-period / recording.tube)
    first = recording.pressures[0]
    return first + lfilter([1 - keep], [1, -keep], recording.pressures - first, axis=0)


def _presliding(muscle: Muscle, *, relative: float = 2e-3) -> float:
    """Presliding length [m] of a muscle; where the model has none, relative to the initial length."""
    length = getattr(muscle.friction, "presliding_length", None)
    return float(relative * muscle.specimen.initial_length if length is None else length)


def problem_of(
    model: Moved, recordings: Sequence[Recorded], prior: JointPrior, *, beyond: float = 1.2
) -> CalibrationProblem:
    """Return the model, with friction added if it has none, and the scales of its corrections.

    Corrections have a half width of `beyond` times that of the measured contractions.

    Raises
    ------
    IdentificationError
        If a muscle does not change its length in the recordings.
    """
    angle, pressures = (
        np.concatenate([getattr(each.samples, name) for each in recordings]) for name in ("angle", "pressures")
    )
    scales: list[Scales] = []
    for number, (muscle, path) in enumerate(zip(model.muscles, paths_of(model, angle), strict=True)):
        low, high, force, slope = map(float, _sweep((muscle, path.max(), path.min())))
        if high - low < 1e-3:
            raise IdentificationError("the joint is at rest in the recordings", remedy="record sweeps of its range")
        middle, most = (low + high) / 2, float(muscle.domain.pressure_max)
        warn_outside((muscle, middle, most))
        creep = prior.creep * abs(slope) / float(muscle.specimen.initial_length)
        scales.append(Scales(force, most, middle, beyond * (high - low) / 2, float(pressures[:, number].mean()), creep))
    others, model = _others(model, prior), with_friction(model, scales)
    damping = _critical_damping((model, tuple(angle.mean(axis=0)), tuple(pressures.mean(axis=0))))
    for joint, critical in zip(model.joint_names, damping, strict=True):
        others[f"{joint}damping"] *= float(critical)
    names = "strength", "offset", "friction", "presliding", "friction_growth"
    return CalibrationProblem(
        model, tuple(scales), {name: getattr(prior, name) for name in names}, tuple(others.values())
    )


def with_friction(model: Moved, scales: Sequence[Scales], *, band: float = 0.02) -> Moved:
    """Return a model in whose muscles friction, where they have none, has a `band` relative to their highest force."""
    muscles: list[Muscle] = []
    for muscle, of_muscle in zip(model.muscles, scales, strict=True):
        if not (is_spring(muscle) or muscle.has_friction):
            muscle = dataclasses.replace(muscle, friction=MaxwellSlip(band * of_muscle.force, _presliding(muscle)))
        muscles.append(muscle)
    return model.changed(muscles, {name: 0.0 if is_difference(name) else 1.0 for name in names_of(model)})


def is_spring(muscle: Muscle) -> bool:
    """Whether a muscle is a return spring, of which nothing is estimated."""
    return muscle.law.is_passive


def paths_of(model: Moved, angle: Floats) -> list[Floats]:
    """Path lengths [m] of all muscles at angles [rad] of shape (samples, joints)."""
    return list(_paths(model, angle.T))


@compiled
def _paths(model: Moved, angles: Array) -> tuple[Array, ...]:
    return tuple(jnp.asarray(route.path) for route in model.routes(tuple(angles)))


@compiled
def _forces(muscle: Muscle, at: tuple[Array, Array]) -> Array:
    """Forces of the law [N] at contractions and pressures [Pa]."""
    return muscle.force_law.force(*at)


@compiled
def _sweep(shared: tuple[Muscle, Array, Array], _: None) -> tuple[Array, Array, Array, Array]:
    """Ends of the contraction between two lengths [m]; midway, at the highest pressure, tension and its slope [N]."""
    muscle, longest, shortest = shared
    low, high = muscle.specimen.contraction_at(longest), muscle.specimen.contraction_at(shortest)
    at = (low + high) / 2, muscle.domain.pressure_max
    return low, high, muscle.tension(*at), muscle.slope(*at)


@compiled
def _critical_damping(shared: tuple[Moved, Sequence[Array], Sequence[Array]], _: None) -> Array:
    """Damping [N*m*s/rad] of each joint above which it does not oscillate, the others held."""
    model, angle, pressures = shared
    still = [jnp.zeros_like(angle[0])] * len(angle)
    held = model.required(angle, still, still, Weight())
    inertia = [
        model.required(angle, still, [*still[:i], still[i] + 1, *still[i + 1 :]], Weight())[i] - held[i]
        for i in range(len(angle))
    ]
    stiffness = jnp.stack(list(model.stiffness(angle, pressures)))
    return 2 * jnp.sqrt(jnp.abs(stiffness) * jnp.stack(inertia))


def swings_of(model: Moved, recorded: Sequence[Recorded]) -> Floats:
    """Return the torques [N*m] that move the joints by the model, about their means, shape (samples, joints)."""
    torques = np.concatenate([_required((model, each.samples[:3], each.weight)) for each in recorded])
    return torques - torques.mean(axis=0)


@compiled
def _required(shared: tuple[Moved, tuple[Array, Array, Array], Weight], _: None) -> Array:
    model, motion, weight = shared

    def at(carry: tuple[()], row: tuple[Array, Array, Array]) -> tuple[tuple[()], Array]:
        angles, rates, accelerations = map(tuple, row)
        return carry, jnp.stack(model.required(angles, rates, accelerations, weight))

    return lax.scan(at, (), motion)[1]


def corrected(problem: CalibrationProblem, z: Any) -> Corrected:
    """The model for parameters in prior standard deviations from their prior mean."""
    model, prior = problem.model, problem.muscles
    blocks = [z[i * OF_MUSCLE : (i + 1) * OF_MUSCLE] for i in range(len(problem.scales))]
    muscles = [
        muscle if is_spring(muscle) else _corrected_muscle(muscle, scales, prior, values)
        for muscle, scales, values in zip(model.muscles, problem.scales, blocks, strict=True)
    ]
    names, tail = names_of(model), z[OF_MUSCLE * len(muscles) :]
    values = {
        name: (0.0 if is_difference(name) else 1.0) + width * tail[i]
        for i, (name, width) in enumerate(zip(names, problem.others, strict=True))
    }
    return Corrected(model.changed(muscles, values), values)


def _corrected_muscle(muscle: Muscle, scales: Scales, prior: dict[str, float], z: Any) -> Muscle:
    """Muscle whose friction is the `MaxwellSlip` nearest to that with the estimated shares of the slip lengths."""
    n, shrink = _COEFFICIENTS, 0.5 ** np.arange(_COEFFICIENTS)
    correction = ForceCorrection(
        tuple(z[:n] * shrink * (prior["offset"] * scales.force)),
        tuple(z[n : 2 * n] * shrink * (prior["strength"] * scales.force / scales.highest)),
        scales.centre,
        scales.half_width,
    )
    friction: Any = muscle.friction
    width, shares, growth = _band(friction, scales, prior, z)
    friction = dataclasses.replace(
        friction,
        half_width=width * shares.sum(),
        presliding_length=friction.presliding_length * 2 * (shares * SLIPS).sum() / shares.sum(),
        growth=growth * width * shares.sum() / scales.pressure,
        reference_pressure=scales.pressure,
    )
    return dataclasses.replace(muscle, law=adjusted_law(muscle.law, correction=correction), friction=friction)


def _band(friction: Any, scales: Scales, prior: dict[str, float], z: Any) -> tuple[Any, Any, Any]:
    """Half width [N] at the mean pressure, shares of the slip lengths, and growth relative to mean pressure and width.

    The shares before are those of a `MaxwellSlip`: of f = B (1 - exp(-2 s/s0)), the part with slip lengths up to s is
    1 - (1 + 2 s/s0) exp(-2 s/s0).
    """
    mean = scales.pressure
    width = friction.half_width + friction.growth * (mean - friction.reference_pressure)
    growth = friction.growth * mean / width + prior["friction_growth"] * z[_BLOCKS[3]]
    edges = 2 * np.sqrt(SLIPS[1:] * SLIPS[:-1])
    shares = np.diff(1 - (1 + edges) * np.exp(-edges), prepend=0.0, append=1.0)
    shares = shares * jnp.exp(prior["presliding"] * z[_BLOCKS[2] : _BLOCKS[3]])
    return width * jnp.exp(prior["friction"] * z[_BLOCKS[1]]), shares, growth


def creep_stiffness(problem: CalibrationProblem, z: Array) -> Array:
    """Stiffness [N/m] of each Maxwell arm of all muscles, shape (muscles, arms); 0 of springs.

    Muscles creep, and creep that is left out looks like stiffness: where the model has none, the mean is the deviation.
    """
    pairs = list(zip(problem.model.muscles, problem.scales, strict=True))
    deviations = jnp.stack([jnp.asarray(0.0 if is_spring(muscle) else scales.creep) for muscle, scales in pairs])
    means = [
        getattr(muscle.creep, "stiffness", float(not is_spring(muscle)) * scales.creep) for muscle, scales in pairs
    ]
    blocks = z[: len(pairs) * OF_MUSCLE].reshape(-1, OF_MUSCLE)[:, _BLOCKS[4] :]
    return jnp.stack(means)[:, None] / CREEP_TIMES.size + blocks * deviations[:, None] / np.sqrt(CREEP_TIMES.size)


def _errors(
    problem: CalibrationProblem, z: Array, samples: MotionSamples, weight: Weight, pushing: Number
) -> tuple[Array, Array]:
    """Errors of the equations of motion [N*m] and of the load cells [N], shape (samples, joints + cells).

    Also the sum over samples and muscles of the gain from pressures to the torques, shape (joints,).
    """
    model, values = corrected(problem, z)
    weight = Weight(values["added_mass"] * weight.mass, values["distance"] * weight.distance, weight.inertia)
    zeros = [values[f"{name}zero"] for name in model.joint_names]
    stiffness = creep_stiffness(problem, z)
    bands = [
        None if is_spring(muscle) else _band(muscle.friction, scales, problem.muscles, z[i * OF_MUSCLE :])
        for i, (muscle, scales) in enumerate(zip(problem.model.muscles, problem.scales, strict=True))
    ]

    def tension(i: int, route: Any, row: MotionSamples) -> Array:
        """Tension of a muscle, with friction and creep."""
        pressure = row.pressures[i]
        contraction, law = route.contraction(pressure), route.tension(pressure)
        law = law + pushing * jnp.minimum(route.muscle.force_law.force(contraction, pressure), 0.0)
        if (band := bands[i]) is None:
            return law
        width, shares, growth = band
        level = smooth_limit(width * (1 + growth * (pressure / problem.scales[i].pressure - 1)), law, jnp)
        force = law + level * (shares * row.stops[i]).sum() + (stiffness[i] * row.creep[i]).sum()
        if not route.muscle.friction.follows_rate:
            return force
        return force + route.muscle.viscous_force(contraction, pressure, route.rate(row.velocity))

    def step(gains: tuple[Array, ...], row: MotionSamples) -> tuple[tuple[Array, ...], Array]:
        angles = [row.angle[i] - zero for i, zero in enumerate(zeros)]
        routes = model.routes(angles)
        modelled = [tension(i, route, row) for i, route in enumerate(routes)]
        pulling, errors = modelled, []
        if row.tensions.size:  # in the equations of motion, so that errors of the laws affect only those of tensions
            cells = [values[f"{name}.load_cell"] for name in model.muscle_names]
            pulling = [row.tensions[i] / cell for i, cell in enumerate(cells)]
            errors = [
                row.tensions[i] - cell * force for i, (cell, force) in enumerate(zip(cells, modelled, strict=True))
            ]
        required = model.required(angles, tuple(row.velocity), tuple(row.acceleration), weight)
        summed = list(gains)
        for i, (force, route) in enumerate(zip(pulling, routes, strict=True)):
            gain = jax.grad(route.tension)(row.pressures[i])
            for joint, slope in route.slopes.items():
                required[joint] = required[joint] + slope * force
                summed[joint] = summed[joint] + jnp.abs(slope) * gain
        return tuple(summed), jnp.stack([*required, *errors])

    gains, errors = lax.scan(step, tuple(jnp.zeros_like(zero * z[0]) for zero in zeros), samples)
    return errors, jnp.stack(gains)


@compiled
def _derivatives(
    shared: tuple[CalibrationProblem, Array, MotionSamples, Weight, Array], direction: Array
) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
    """Errors and gains, and their derivatives in a direction of the parameters."""
    problem, z, samples, weight, pushing = shared
    return jax.jvp(lambda z: _errors(problem, z, samples, weight, pushing), (z,), (direction,))


def linearised(
    problem: CalibrationProblem, z: Floats, recorded: Recorded, *, pushing: float = 0.0
) -> tuple[Floats, Floats]:
    """Errors of all samples, shape (samples, groups), and their derivatives with respect to the parameters.

    The derivatives of torques are those at a constant gain from pressures to torques, that is, of the errors of the
    pressures, which are what is measured: torques that are all too small by a factor have small errors, but not in
    pressures. A slack muscle has no derivatives; `pushing`, 0 to 1, is the part of a negative force of its law that is
    kept.
    """
    samples, weight, _ = recorded
    (errors, gains), (slopes, changes) = _derivatives((problem, z, samples, weight, pushing), np.eye(z.size))
    errors, joints = errors[..., 0], len(gains)
    slopes[:, :joints] -= errors[:, :joints, None] * (changes / gains[..., :1])
    return errors, slopes
