"""Equation of motion of a joint with unknown laws, friction, load and sensors, along recordings."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array
from numpy.polynomial.polynomial import polyder, polyval
from numpy.typing import NDArray

from mckibben.codegen.engine import compiled
from mckibben.component.base import Checked
from mckibben.component.schema import read_component
from mckibben.errors import IdentificationError
from mckibben.joint import AntagonisticJoint, Geometry, Load, ScaledArms
from mckibben.joint.geometry import Pair
from mckibben.muscle import ForceCorrection, MaxwellSlip, Muscle, adjusted_law
from mckibben.muscle.muscle import warn_outside
from mckibben.units import Quantity, Strength, deg, kPa, mm

Floats = NDArray[np.float64]
Samples = Floats | Array
Number = float | np.float64 | Array
PositiveAngle = Annotated[float, Quantity("rad", "deg", 0, 57, open_lower=True)]
PositiveNoise = Annotated[float, Quantity("Pa", "kPa", 0, 1e3, open_lower=True)]
RATE = 50.0  # Hz, of the fitted samples
COEFFICIENTS = 3  # of each polynomial of a correction
OF_MUSCLE = 2 * COEFFICIENTS + 3  # parameters: these, friction, presliding and growth of the friction
FORCES = np.array([i * OF_MUSCLE + j for i in range(2) for j in range(2 * COEFFICIENTS)])  # corrections of the laws
_CREEP = 2 * OF_MUSCLE + 7  # first creep stiffness, after mass, weight, zero, arms, load cells and apparent inertia
CREEP_TIMES = np.array([1.0, 3.0, 10.0])  # s, of the Maxwell arms of each muscle
PARAMETERS = _CREEP + 2 * CREEP_TIMES.size


@dataclass(frozen=True, eq=False)
class JointRecording:
    """Measured motion of a joint.

    Attributes
    ----------
    time, angle
        Times [s] and angles [rad], shape (samples,).
    pressures, tensions
        Gauge pressures [Pa] of muscles 1 and 2, and their tensions [N] if there are load cells; shape (samples, 2).
    added_mass, distance
        A known weight [kg] on the limb, and its distance from the axis [m].
    commands
        Commands [Pa], for `calibrate_valves`; shape (samples, 2).
    """

    time: Floats
    angle: Floats
    pressures: Floats
    tensions: Floats | None = None
    added_mass: float = 0.0
    distance: float = 0.0
    commands: Floats | None = None


@dataclass(frozen=True)
class JointPrior(Checked):
    """Prior standard deviations of the quantities that a calibration estimates; relative ones refer to the model.

    A file has these fields with units, such as ``mass: 5 %``.

    Attributes
    ----------
    strength, offset
        Pressure-proportional and constant part of a muscle's force, relative to the law's force at its highest pressure
        and the middle contraction; halved for each further power of contraction. Default of the strength: estimated
        from the recordings; of the offset: half of the strength.
    friction, presliding
        Logarithms of the half width of the friction band at the mean pressure, and of the presliding length.
    friction_growth
        Growth of the half width with pressure, relative to half width and mean pressure.
    creep
        Stiffness of creep relative to the slope of the law: total of three Maxwell arms of 1, 3 and 10 s.
    mass
        Load mass (`Load.estimated_mass`), relative.
    inertia
        Apparent inertia in excess of that of the mass, relative to that of the model: in fast motion an error of the
        friction resembles inertia, from which neither mass nor stiffness should be inferred.
    added_mass, load_cell
        Added weight and load cell gains, relative.
    zero
        Encoder zero [rad].
    arm_scale
        Scale of the moment arms.
    valve, delay, supply, polytropic_index, critical_ratio
        For `calibrate_valves`: logarithms of these quantities, and of all others of a valve.
    volume, pressure_zero
        For `calibrate_valves`: volume of the air in the muscles, relative; reading of the pressure sensors at 0 bar
        [Pa].
    """

    strength: Strength | None = None
    offset: Strength | None = None
    friction: Strength = 0.6
    presliding: Strength = 0.5
    friction_growth: Strength = 0.3
    creep: Strength = 0.05
    mass: Strength = 0.3
    inertia: Strength = 0.5
    added_mass: Strength = 0.01
    load_cell: Strength = 0.01
    zero: PositiveAngle = 0.5 * deg
    arm_scale: Strength = 0.02
    delay: Strength = 1.0
    valve: Strength = 0.7
    supply: Strength = 0.05
    polytropic_index: Strength = 0.08
    critical_ratio: Strength = 0.3
    volume: Strength = 0.05
    pressure_zero: PositiveNoise = 1 * kPa

    @classmethod
    def read(cls, path: str | os.PathLike[str]) -> JointPrior:
        """Read a file; raises `ScenarioError` with every problem: line, field, value, range and remedy."""
        return read_component(cls, Path(path))


class JointSamples(NamedTuple):
    """Smoothed samples of a recording, each of shape (samples,); scalars of the weight."""

    angle: Samples
    velocity: Samples | None
    acceleration: Samples | None
    pressures: tuple[Samples, Samples]
    tensions: tuple[Samples, ...]
    added_mass: Number  # as stated [kg]
    distance: Number  # [m]


Halves = tuple[JointSamples, JointSamples]


class Scales(NamedTuple):
    """Scales of the correction of a muscle."""

    force: float  # highest force at the middle contraction [N]
    highest: float  # pressure [Pa]
    centre: float  # middle contraction
    half_width: float
    pressure: float  # mean of the measured pressures [Pa]
    creep: float  # standard deviation of its stiffness [N/m]


class CalibrationProblem(NamedTuple):
    """The model, and the scales of each muscle's correction.

    Parameters z are in prior standard deviations from the model: of each muscle the coefficients of the constant and of
    the pressure-proportional correction, friction, presliding and growth of the friction; then mass, weight, zero,
    arms, load cells and apparent inertia; then creep stiffnesses of each muscle. Those of a return spring have no
    effect, and more parameters may follow.
    """

    joint: AntagonisticJoint
    load: Load
    scales: tuple[Scales, ...]
    prior: dict[str, float]


class _Corrected(NamedTuple):
    """Model for given parameters."""

    joint: AntagonisticJoint
    load: Load
    added_mass: Number  # relative to its stated value
    zero: Number  # [rad]
    load_cells: tuple[Number, Number]  # gains
    inertia: Number  # apparent, relative to that of the load


def sampling_period(recording: JointRecording, *, longest: float = 0.01) -> float:
    """Mean sampling period [s]; `IdentificationError` for samples that are too sparse, have gaps or do not follow."""
    time, steps = recording.time, np.diff(recording.time)
    period = float(time[-1] - time[0]) / (time.size - 1)
    if period > longest or steps.max() > 5 * longest or steps.min() <= 0:
        worst = int(np.argmin(steps) if steps.min() <= 0 else np.argmax(steps))
        message = f"samples, {period * 1e3:.3g} ms apart on average, are {steps[worst] * 1e3:.3g} ms apart"
        remedy = f"record at {1 / longest:.0f} Hz or more, without gaps of {5 * longest * 1e3:.0f} ms"
        raise IdentificationError(f"{message} at {time[worst]:.6g} s", value=period, unit="s", remedy=remedy)
    return period


def evenly(time: Floats, values: Floats, period: float) -> Floats:
    """Values at equally spaced times from the first on, linear in between, shape (samples,)."""
    return np.interp(time[0] + period * np.arange(time.size), time, values)


def check_recording(recording: JointRecording, *, shortest: float = 5.0) -> None:
    """Raise `IdentificationError` for non-finite numbers, and for a recording that is too short, a duration [s]."""
    columns = [recording.time, recording.angle, recording.pressures]
    columns += [column for column in (recording.tensions, recording.commands) if column is not None]
    if not all(np.all(np.isfinite(column)) for column in columns):
        raise IdentificationError("a recording contains numbers that are not finite", remedy="leave these rows out")
    time = recording.time
    if time.size < 50 or time[-1] - time[0] < shortest:
        message = f"a recording of {time.size} samples over {np.ptp(time) if time.size else 0:.3g} s is too short"
        raise IdentificationError(message, value=time.size, remedy=f"record at least {shortest:g} s")


def cubic_width(period: float, *, window: float = 0.05) -> int:
    """Number of samples of a local cubic fit: a window [s] that is short, as it attenuates accelerations."""
    return max(2 * int(window / (2 * period)) + 1, 5)


def local_cubic(values: Floats, period: float, derivative: int = 0) -> Floats:
    """Derivative at each sample of a cubic fitted to the `cubic_width` samples around it, at the ends to the outermost.

    A. Savitzky and M. J. E. Golay, Analytical Chemistry 36, 1964.
    """
    width, polynomials = cubic_width(period), np.eye(4)  # with one coefficient of 1
    half, places = width // 2, np.arange(width) - width // 2
    slopes = polyval(places, polyder(polynomials, derivative)).T / period**derivative
    rows = slopes @ np.linalg.pinv(polyval(places, polynomials).T)  # of samples, for the derivative at each place
    between = np.correlate(values, rows[half])
    return np.concatenate([rows[:half] @ values[:width], between, rows[half + 1 :] @ values[-width:]])


def halves_of(recording: JointRecording) -> Halves:
    """Return even and odd samples of a recording, with independent noise, smoothed at the same times at 50 Hz.

    Angle, velocity and acceleration are those of cubic fits to 50 ms of the samples.

    Raises
    ------
    IdentificationError
        If numbers are not finite, or the samples are too few, too sparse or have gaps.
    """
    check_recording(recording)
    time, period = recording.time, 2 * sampling_period(recording)  # of a half
    margin = cubic_width(period) * period
    grid = np.arange(time[0] + margin, time[-1] - margin, 1 / RATE)

    def half(begin: int) -> JointSamples:
        def fit(column: Floats, derivative: int = 0) -> Floats:
            places, even = time[begin::2], evenly(time[begin::2], column[begin::2], period)
            return np.interp(grid, places[0] + period * np.arange(places.size), local_cubic(even, period, derivative))

        tensions = recording.tensions
        return JointSamples(
            fit(recording.angle),
            fit(recording.angle, 1),
            fit(recording.angle, 2),
            (fit(recording.pressures[:, 0]), fit(recording.pressures[:, 1])),
            () if tensions is None else (fit(tensions[:, 0]), fit(tensions[:, 1])),
            np.float64(recording.added_mass),
            np.float64(recording.distance),
        )

    return half(0), half(1)


def problem_of(
    joint: AntagonisticJoint,
    load: Load,
    recordings: Sequence[Halves],
    prior: JointPrior,
    *,
    beyond: float = 1.2,
    band: float = 0.02,
    presliding: float = 2e-3,
    scatter: float = 0.1,
) -> CalibrationProblem:
    """Return the model, with friction added if it has none, and the scales of its corrections.

    Corrections have a half width of `beyond` times that of the measured contractions. Friction, where the model has
    none, begins at a `band` relative to the highest force, and a `presliding` length relative to the initial length.
    Where the prior has no strength, its estimate begins at a `scatter` of muscles.

    Raises
    ------
    IdentificationError
        If the muscles do not change their length in the recordings.
    """
    muscles: list[Muscle] = []
    scales: list[Scales] = []
    angle = np.concatenate([half.angle for half, _ in recordings])
    for muscle, spring, path in zip(
        (joint.muscle1, joint.muscle2), joint.springs, path_lengths(joint, angle), strict=True
    ):
        low, high, force, slope = map(float, _sweep((muscle, path.max(), path.min())))
        if high - low < 1e-3:
            raise IdentificationError("the joint is at rest in the recordings", remedy="record sweeps of its range")
        middle, most = (low + high) / 2, float(muscle.domain.pressure_max)
        warn_outside((muscle, middle, most))
        creep = prior.creep * abs(slope) / float(muscle.specimen.initial_length)
        mean = float(np.mean([half.pressures[len(scales)].mean() for half, _ in recordings]))
        scales.append(Scales(force, most, middle, beyond * (high - low) / 2, mean, creep))
        if not (spring or muscle.has_friction):
            friction = MaxwellSlip(band * force, presliding * float(muscle.specimen.initial_length))
            muscle = dataclasses.replace(muscle, friction=friction)
        muscles.append(muscle)
    joint = dataclasses.replace(joint, muscle1=muscles[0], muscle2=muscles[1])
    strength = prior.strength or scatter
    widths = {name: width for name, width in vars(prior).items() if width is not None}
    widths = {"scatter": 1.0, "strength": strength, "offset": strength / 2, **widths}
    return CalibrationProblem(joint, load, tuple(scales), widths)


def path_lengths(joint: AntagonisticJoint, angle: Samples) -> list[Floats]:
    """Path lengths [m] of both muscles at angles [rad]."""
    return list(paths_and_arms(joint.geometry, np.asarray(angle))[0])


@compiled
def paths_and_arms(geometry: Geometry, angle: Array) -> tuple[Pair, Pair]:
    """Path lengths and moment arms [m] at angles [rad], by one program for any number of them."""
    return geometry.paths_and_arms(angle)


@compiled
def _sweep(shared: tuple[Muscle, Array, Array], _: None) -> tuple[Array, Array, Array, Array]:
    """Ends of the contraction between two lengths [m]; midway, at the highest pressure, tension and its slope [N]."""
    muscle, longest, shortest = shared
    low, high = muscle.specimen.contraction_at(longest), muscle.specimen.contraction_at(shortest)
    at = (low + high) / 2, muscle.domain.pressure_max
    return low, high, muscle.tension(*at), muscle.slope(*at)


def corrected(problem: CalibrationProblem, z: Any) -> _Corrected:
    """The model for parameters in prior standard deviations from their prior mean."""
    prior, joint, load, n = problem.prior, problem.joint, problem.load, COEFFICIENTS
    muscles, shrink = [], 0.5 ** np.arange(n)
    for i, muscle in enumerate[Any]((joint.muscle1, joint.muscle2)):
        if joint.springs[i]:
            muscles.append(muscle)
            continue
        values, scales = z[i * OF_MUSCLE : (i + 1) * OF_MUSCLE], problem.scales[i]
        correction = ForceCorrection(
            tuple(values[:n] * shrink * (prior["scatter"] * prior["offset"] * scales.force)),
            tuple(values[n : 2 * n] * shrink * (prior["scatter"] * prior["strength"] * scales.force / scales.highest)),
            scales.centre,
            scales.half_width,
        )
        friction, mean = muscle.friction, scales.pressure
        width = friction.half_width + friction.growth * (mean - friction.reference_pressure)
        friction = dataclasses.replace(
            friction,
            half_width=width * jnp.exp(prior["friction"] * values[2 * n]),
            presliding_length=friction.presliding_length * jnp.exp(prior["presliding"] * values[2 * n + 1]),
            growth=friction.growth + prior["friction_growth"] * values[2 * n + 2] * width / mean,
            reference_pressure=mean,
        )
        muscles.append(
            dataclasses.replace(muscle, law=adjusted_law(muscle.law, correction=correction), friction=friction)
        )
    mass, added, zero, arms, cell1, cell2, inertia = z[2 * OF_MUSCLE : _CREEP]
    if load.estimated_mass:
        more = getattr(load, load.estimated_mass) * (1 + prior["mass"] * mass)
        load = dataclasses.replace(load, **{load.estimated_mass: more})
    geometry = ScaledArms(joint.geometry, 1 + prior["arm_scale"] * arms)
    return _Corrected(
        dataclasses.replace(joint, geometry=geometry, muscle1=muscles[0], muscle2=muscles[1]),
        load,
        1 + prior["added_mass"] * added,
        prior["zero"] * zero,
        (1 + prior["load_cell"] * cell1, 1 + prior["load_cell"] * cell2),
        1 + prior["inertia"] * inertia,
    )


def creep_stiffness(problem: CalibrationProblem, z: Array) -> Array:
    """Stiffness [N/m] of each Maxwell arm of both muscles, shape (2, arms); 0 of springs."""
    pairs = zip(problem.joint.springs, problem.scales, strict=True)
    deviations = jnp.stack([jnp.asarray(0.0 if spring else scales.creep) for spring, scales in pairs])
    return z[_CREEP:PARAMETERS].reshape(2, -1) * deviations[:, None] / np.sqrt(CREEP_TIMES.size)


def _errors(problem: CalibrationProblem, z: Array, samples: JointSamples) -> Array:
    """Errors of the equation of motion [N*m] and of the load cells [N], shape (samples, 1 or 3)."""
    joint, load, added, zero, cells, inertia = corrected(problem, z)
    loaded = load.with_weight(added * samples.added_mass, samples.distance)
    stiffness, decay = creep_stiffness(problem, z), np.exp(-1 / (RATE * CREEP_TIMES))

    def step(carry: Any, row: Any) -> tuple[Any, Array]:
        (states, creep, before), (angle, velocity, acceleration, pressures, tensions) = carry, row
        angle = angle - zero
        states = joint.update_state(states, angle, pressures)
        modelled = joint.forces(angle, velocity, pressures, states)
        paths, (arm1, arm2) = joint.geometry.paths_and_arms(angle)
        if joint.has_creep:
            rates = joint.state_rate(states, angle, velocity, pressures)
            states = tuple(
                state._replace(creep=tuple(x + rate / RATE for x, rate in zip(state.creep, rate_of.creep, strict=True)))
                for state, rate_of in zip(states, rates, strict=True)
            )
        path = jnp.stack(paths)
        creep = decay * creep + np.sqrt(decay) * stiffness * (path - before)[:, None]  # Maxwell arms, along the path
        more, required = creep.sum(axis=1), loaded.required_torque(angle, velocity, acceleration)
        required = required + (inertia - 1) * problem.load.total_inertia * acceleration
        if not tensions:
            errors = [required - (modelled.torque + arm2 * more[1] - arm1 * more[0])]
        else:
            # Measured tensions in the equation of motion: law errors affect only the errors of the tensions.
            true1, true2 = (measured / gain for measured, gain in zip(tensions, cells, strict=True))
            columns = zip(tensions, cells, modelled.tensions, more, strict=True)
            errors = [measured - gain * (law + rest) for measured, gain, law, rest in columns]
            errors = [required - (arm2 * true2 - arm1 * true1), *errors]
        return (states, creep, path), jnp.stack(errors)

    angle = samples.angle[0] - zero
    states = joint.init_state(angle, (samples.pressures[0][0], samples.pressures[1][0]))
    start = states, jnp.zeros_like(stiffness), jnp.stack(joint.geometry.path_lengths(angle))
    return lax.scan(step, start, samples[:5])[1]


@compiled
def derivatives(shared: tuple[CalibrationProblem, Array, JointSamples], direction: Array) -> tuple[Array, Array]:
    """Errors and their derivative in a direction of the parameters."""
    problem, z, samples = shared
    return jax.jvp(lambda z: _errors(problem, z, samples), (z,), (direction,))


def linearised(problem: CalibrationProblem, z: Floats, samples: JointSamples) -> tuple[Floats, Floats]:
    """Errors and their derivatives with respect to the parameters."""
    errors, slopes = derivatives((problem, z, samples), np.eye(z.size))
    return errors[..., 0], slopes


def sliding_from(joint: AntagonisticJoint, angle: Samples, *, lengths: float = 6.0) -> int:
    """First of the samples [rad] at which the friction does not depend on its unknown initial state.

    It is forgotten after a travel of some presliding lengths. Raises `IdentificationError` if that is not within the
    first half of the samples.
    """
    first = 0
    for muscle, path in zip((joint.muscle1, joint.muscle2), path_lengths(joint, angle), strict=True):
        travelled = np.maximum.accumulate(path) - np.minimum.accumulate(path)
        enough = travelled > lengths * float(getattr(muscle.friction, "presliding_length", 0.0))
        if not enough.any() or int(np.argmax(enough)) > len(enough) // 2:
            message = f"muscle lengths change by no more than {np.max(travelled) / mm:.2g} mm"
            remedy = "sweep larger angles: friction hides the force in small motions"
            raise IdentificationError(message, value=float(np.max(travelled)), unit="m", remedy=remedy)
        first = max(first, int(np.argmax(enough)))
    return first
