"""Identification of a joint from commanded pressures: the simulated angle is fitted to the recorded one."""

from __future__ import annotations

import dataclasses
import math
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array

from mckibben.calibration.equations import (
    COEFFICIENTS,
    OF_MUSCLE,
    CalibrationProblem,
    Floats,
    JointPrior,
    JointRecording,
    JointSamples,
    check_recording,
    corrected,
    muscle_parameters,
    problem_of,
)
from mckibben.calibration.estimation import (
    STARTS,
    JointCalibration,
    JointEstimate,
    Scatter,
    gauss_newton,
    minimised,
    number,
    quantities_of,
    scatter_between,
    start,
    variance_of,
)
from mckibben.errors import IdentificationError, McKibbenWarning
from mckibben.joint import AntagonisticJoint, Load
from mckibben.numerics.batching import batched_program
from mckibben.numerics.compiled import jit
from mckibben.plant import FirstOrderValve, JointFriction, JointPlant
from mckibben.units import ms

_REST = 3.0  # s after the last change of the commands; later samples, up to the next change, are left out
_BEFORE = 0.5  # s kept before a change
_CHANGE = 1e-3  # smallest change of the commands, relative to the highest pressure
_LONGEST_PERIOD, _LARGEST_GAP = 0.05, 10  # s; periods
_STEP = 5e-3  # s, of the integration
_BLOCK = 1024  # samples
_DIFFERENCE = 1e-4  # prior standard deviations, of the difference quotients
_DELAY = 20 * ms  # prior median
_DAMPING_TIME = 1.0  # s, ratio of inertia to damping of a load without damping in the model
_FIRST_VARIANCE = 0.1**2  # rad^2
_DIFFERS = 1e-3  # probability of a larger scatter between recordings
_RATE_START = -1.5  # prior standard deviations: a limit that acts on large steps; else its derivative is zero
_STRENGTHS, _FIRST, _STAGES, _ITERATIONS = 3, 8, 3, 25
_FRICTION = 2 * COEFFICIENTS  # index of the half width among a muscle's parameters
_SHARED = 3  # parameters other than the muscles' shared with `corrected`: weight, zero and scale of the arms
_OWN = {  # units, and fields of the prior; the friction's only if the joint has its own friction
    "valve.time_constant": ("s", "lag"),
    "valve.rate": ("Pa/s", "rate"),
    "delay": ("s", "delay"),
    "load.damping": ("N*m*s/rad", "damping"),
    "load.inertia": ("kg*m^2", "mass"),
    "load.gravity_torque": ("N*m", "mass"),
    "friction.torque": ("N*m", "joint_friction"),
    "friction.presliding": ("rad", "joint_presliding"),
}


class _Motion(NamedTuple):
    """Equally spaced samples of a recording, without periods of rest."""

    time: Any  # [s], shape (samples,)
    angle: Any  # measured [rad]
    commands: Any  # [Pa], shape (2, samples)
    period: Any  # [s]
    added_mass: Any  # [kg]
    distance: Any  # [m]


class SimulatedAngles(NamedTuple):
    """Times [s] and angles [rad] of a recording, measured and simulated by the model before and after calibration."""

    time: Floats
    measured: Floats
    before: Floats
    after: Floats

    @property
    def errors(self) -> tuple[float, float]:
        """Root mean square errors [rad] of the model before and after calibration."""
        before, after = (float(np.sqrt(np.mean((one - self.measured) ** 2))) for one in (self.before, self.after))
        return before, after


class _Simulated(NamedTuple):
    """A plant with the additional quantities of recordings."""

    plant: JointPlant
    delay: Any  # of the commands [s]
    zero: Any  # of the encoder [rad]
    added: Any  # weight relative to its stated value


class _Problem(NamedTuple):
    """The model whose joint, load and weight `corrected` corrects, its valve, and prior medians of parameters."""

    base: CalibrationProblem
    valve: FirstOrderValve
    friction: JointFriction | None
    medians: tuple[float, ...]


@dataclass(frozen=True, eq=False, repr=False)
class CommandedCalibration(JointCalibration):
    """Joint identified from commanded pressures, by `calibrate_from_commands`.

    Attributes
    ----------
    quantities
        As for `JointCalibration`, and ``valve.time_constant``, ``valve.rate``, ``delay``, ``load.damping``,
        ``load.inertia``, ``load.gravity_torque``, with prior deviations relative to the estimates; no ``load.mass``.
        With friction of the joint ``friction.torque`` and ``friction.presliding``, and ``friction.total`` [N*m], the
        sum of its torque and of the muscles' half widths times their moment arms.
    residual
        Root mean square of the error of the simulated angle [rad].
    valve, delay
        The valve with the estimates, and the delay [s] of its commands.
    friction
        Friction of the joint itself with the estimates; None if the initial model has none.
    """

    valve: FirstOrderValve
    delay: float
    _before: _Simulated
    friction: JointFriction | None

    @property
    def plant(self) -> JointPlant:
        """Joint, load, valve, friction and delay of the commands with the estimates."""
        return JointPlant(self.joint, self.load, self.valve, friction=self.friction, command_delay=self.delay)

    def simulate(self, recording: JointRecording) -> SimulatedAngles:
        """Return angles simulated from the first angle and the commands of a recording, without periods of rest."""
        motion = _motion(recording, _highest(self.joint))
        zero, added = self.quantities["zero"].value, self.quantities["added_mass"].value
        after = _Simulated(dataclasses.replace(self.plant, command_delay=None), self.delay, zero, added)
        substeps = _substeps([motion])
        before, found = (
            np.asarray(_angle(one, _padded(motion), substeps))[: motion.angle.size] for one in (self._before, after)
        )
        return SimulatedAngles(motion.time, motion.angle, before, found)


def calibrate_from_commands(
    joint: AntagonisticJoint,
    load: Load,
    valve: FirstOrderValve,
    recordings: Sequence[JointRecording],
    prior: JointPrior | None = None,
    *,
    friction: JointFriction | None = None,
    delay: float | None = None,
) -> CommandedCalibration:
    r"""Identify a joint, its load and valves from commanded pressures and angles (output-error method).

    The plant is simulated from the first angle and the commands; the angle's error is minimised over the quantities of
    docs/calibrate.md, all with Gaussian priors (on the logarithms for valves, delay and load):

    .. math:: \sum_k \frac{(\theta_k - \hat\theta_k(z))^2}{\sigma^2} + z^T z

    with the variance sigma^2 of the residuals times their correlation time. Samples more than 3 s after the last change
    of the commands are left out.

    Parameters
    ----------
    joint, load, valve
        The initial model. A muscle without friction gets a band with an estimated width, a valve without rate limit one
        that no step exceeds.
    recordings
        At least one, with commands as `pressures`.
    prior
        Prior standard deviations; choose larger ones than the default for a joint with poorly known muscles.
    friction
        Dry friction of the joint itself; its torque and presliding angle are then estimated.
    delay
        Delay of the commands in the initial model [s]. Default: a prior about 20 ms.

    Raises
    ------
    IdentificationError
        If a recording is too short, sampled at less than 20 Hz, has gaps or constant commands, or the joint is at rest.

    References
    ----------
    L. Ljung, System Identification, 2nd ed., Prentice Hall 1999, ch. 5 and 7 (output-error models).
    """
    prior = prior or JointPrior()
    if not recordings:
        raise IdentificationError("there is no recording", remedy="give at least one")
    highest = _highest(joint)
    motions = [_motion(one, highest) for one in recordings]
    rigid = jax.tree.map(float, load.with_weight(0.0, 0.0))
    samples = [JointSamples(one.angle, None, None, tuple(one.commands), (), 0.0, 0.0) for one in motions]
    base = problem_of(joint, rigid, [(one, one) for one in samples], prior)
    damping = rigid.damping or rigid.inertia / _DAMPING_TIME
    rate = highest / valve.time_constant if valve.rate is None else valve.rate
    medians = (valve.time_constant, rate, delay or _DELAY, damping, rigid.inertia, rigid.greatest_gravity_torque)
    medians += () if friction is None else (friction.torque, friction.presliding)
    problem = _Problem(base, valve, friction, tuple(map(float, medians)))
    z, covariance, residual, scatter = _solve(problem, motions)
    _warn_of_scatter(scatter, len(medians))
    full, slope = map(np.asarray, _full_and_slope(base, z))
    wide = slope @ covariance @ slope.T + np.diag(1.0 * ~slope.any(axis=1))  # keeps what is not estimated
    found = jax.tree.map(number, _model(problem, jnp.asarray(z)))
    plant, total = found.plant, {}
    if friction is not None:
        middle = float(np.concatenate([one.angle for one in motions]).mean())
        total["friction.total"] = _total_friction(problem, plant, z, covariance, middle)
    return CommandedCalibration(
        plant.joint,
        plant.load,
        quantities_of(base, full, wide) | _own_quantities(problem, z, np.sqrt(np.diag(covariance))) | total,
        residual,
        base,
        full,
        wide,
        plant.valve,
        found.delay,
        _Simulated(JointPlant(joint, rigid, valve, friction=friction), delay or 0.0, 0.0, 1.0),
        plant.friction,
    )


def _highest(joint: AntagonisticJoint) -> float:
    """Highest pressure [Pa] of a muscle; 0 for a return spring."""
    return max(float(muscle.domain.pressure_max) for muscle in (joint.muscle1, joint.muscle2))


def _motion(recording: JointRecording, highest: float) -> _Motion:
    """Equally spaced samples with commands constant over each period, without periods of rest."""
    if not recording.commanded:
        raise IdentificationError(
            "a recording has measured pressures", remedy="give commands, in columns command1_bar,command2_bar"
        )
    check_recording(recording)
    period = float(np.median(np.diff(recording.time)))
    gap = float(np.diff(recording.time).max())
    if not 0 < period <= _LONGEST_PERIOD or gap > _LARGEST_GAP * period:
        message = f"the samples of a recording are {period * 1e3:.3g} ms apart, with a gap of {gap * 1e3:.3g} ms"
        remedy = f"record at {1 / _LONGEST_PERIOD:.0f} Hz or more, and split recordings at gaps"
        raise IdentificationError(message, value=gap, unit="s", remedy=remedy)
    grid = np.arange(recording.time[0], recording.time[-1], period)
    last = np.searchsorted(recording.time, grid + period / 2, side="right") - 1
    commands = recording.pressures[last].T
    changes = np.flatnonzero(np.abs(np.diff(commands, axis=1)).max(axis=0) > _CHANGE * highest) + 1
    if not changes.size:
        raise IdentificationError("the commands of a recording are constant", remedy="record steps of the pressures")
    edges = np.zeros(grid.size + 1)
    np.add.at(edges, np.maximum(changes - round(_BEFORE / period), 0), 1)
    np.add.at(edges, np.minimum(changes + round(_REST / period), grid.size), -1)
    kept = np.cumsum(edges[:-1]) > 0
    angle = np.interp(grid, recording.time, recording.angle)
    weight = np.float64(recording.added_mass), np.float64(recording.distance)
    return _Motion(grid[kept], angle[kept], commands[:, kept], np.float64(period), *weight)


def _padded(motion: _Motion) -> _Motion:
    """A motion padded with rest to a common length: each length needs its own program."""
    more = -motion.angle.size % _BLOCK
    time, angle, commands = (np.pad(one, [(0, 0)] * (one.ndim - 1) + [(0, more)], mode="edge") for one in motion[:3])
    return motion._replace(time=time, angle=angle, commands=commands)


def _substeps(motions: Sequence[_Motion]) -> int:
    return math.ceil(max(float(one.period) for one in motions) / _STEP)


def _trajectory(model: _Simulated, motion: _Motion, substeps: Any) -> Array:
    """Angle [rad] at the samples, as read by the encoder."""
    plant, steps = model.plant, jnp.arange(motion.angle.shape[0])
    plant = dataclasses.replace(plant, load=plant.load.with_weight(model.added * motion.added_mass, motion.distance))
    at = steps - model.delay / motion.period  # between two samples: their mean over the period
    command1, command2 = (jnp.interp(at, steps, one) for one in motion.commands)
    first = plant.init_state(motion.angle[0] - model.zero, (command1[0], command2[0]))

    def step(state: Any, commands: Any) -> tuple[Any, Array]:
        return plant.advance(state, commands, motion.period, substeps), state.angle

    return lax.scan(step, first, (command1, command2))[1] + model.zero


@jit
def _angle(model: _Simulated, motion: _Motion, substeps: Any) -> Array:
    with batched_program():
        return _trajectory(model, motion, substeps)


@jit
def _angles(problem: _Problem, zs: Any, motion: _Motion, substeps: Any) -> Array:
    """Angles [rad], shape (parameter vectors, samples)."""
    with batched_program():
        return jax.vmap(lambda z: _trajectory(_simulated_by(problem, z), motion, substeps))(zs)


def _full(base: CalibrationProblem, z: Array) -> Array:
    """Parameters of `corrected`, with the friction by its logarithm, and 0 for load mass and load cells."""
    count, prior = muscle_parameters(base), base.prior["friction"]
    muscles = z[:count].reshape(-1, OF_MUSCLE)
    muscles = muscles.at[:, _FRICTION].set(jnp.expm1(prior * muscles[:, _FRICTION]) / prior).ravel()
    return jnp.concatenate([muscles, jnp.zeros(1), z[count : count + _SHARED], jnp.zeros(2)])


@jit
def _full_and_slope(base: CalibrationProblem, z: Any) -> tuple[Array, Array]:
    return _full(base, z), jax.jacfwd(lambda z: _full(base, z))(z)


def _own_deviations(problem: _Problem) -> Any:
    names = [name for _, name in _OWN.values()][: len(problem.medians)]
    return jnp.stack([jnp.asarray(problem.base.prior[name]) for name in names])


def _simulated_by(problem: _Problem, z: Array) -> _Simulated:
    """The model by parameters in prior standard deviations from their prior mean."""
    base, load, friction = problem.base, problem.base.load, problem.friction
    joint, _, added, zero, _ = corrected(base, _full(base, z))
    factors = jnp.exp(_own_deviations(problem) * z[-len(problem.medians) :])
    own: Iterator[Any] = (median * factors[i] for i, median in enumerate(problem.medians))
    lag, rate, delay, damping, inertia, gravity, *rubbing = own
    load = dataclasses.replace(load, inertia=inertia, greatest_gravity_torque=gravity, damping=damping)  # pyrefly: ignore[unexpected-keyword]
    valve = dataclasses.replace(problem.valve, time_constant=lag, rate=rate)
    if friction is not None:
        friction = dataclasses.replace(friction, **dict(zip(("torque", "presliding"), rubbing, strict=True)))
    return _Simulated(JointPlant(joint, load, valve, friction=friction), delay, zero, added)


_model = jit(_simulated_by)


def _own_quantities(problem: _Problem, z: Floats, deviation: Floats) -> dict[str, JointEstimate]:
    prior, own = np.asarray(_own_deviations(problem)), len(problem.medians)
    rows = zip(list(_OWN.items())[:own], problem.medians, prior, z[-own:], deviation[-own:], strict=True)
    found = {}
    for (name, (unit, _)), median, wide, at, narrow in rows:
        value = median * math.exp(wide * at)
        if median:
            found[name] = JointEstimate(value, abs(value) * wide * float(narrow), abs(value) * wide, unit)
    return found


def _total_friction(problem: _Problem, plant: JointPlant, z: Floats, covariance: Floats, angle: float) -> JointEstimate:
    """Friction torque [N*m] of joint and muscles at an angle [rad]; logarithms of its parts are estimated."""
    assert plant.friction is not None
    prior, own = problem.base.prior, iter(range(muscle_parameters(problem.base) // OF_MUSCLE))
    slope = np.zeros(z.size)
    muscles, arms = (plant.joint.muscle1, plant.joint.muscle2), plant.joint.geometry.moment_arms(angle)
    for muscle, arm, spring in zip(muscles, arms, plant.joint.springs, strict=True):
        if not spring:
            friction: Any = muscle.friction
            slope[OF_MUSCLE * next(own) + _FRICTION] = friction.half_width * abs(float(arm))
    slope[-2] = plant.friction.torque
    total = float(slope.sum())
    slope *= prior["friction"]
    slope[-2] *= prior["joint_friction"] / prior["friction"]
    return JointEstimate(total, math.sqrt(slope @ covariance @ slope), float(np.linalg.norm(slope)), "N*m")


def _warn_of_scatter(scatter: Scatter, own: int) -> None:
    """Warn of valve, delay and load if they differ between the recordings by more than their intervals allow."""
    rows = zip(list(_OWN)[:own], scatter.ratio[-own:], scatter.p_value[-own:], strict=True)
    differing = [f"{name} ({math.sqrt(ratio):.2g})" for name, ratio, p_value in rows if p_value < _DIFFERS]
    if differing:
        text = "the model is wrong: the recordings disagree by more than the noise allows"
        warnings.warn(
            f"{text} about {', '.join(differing)}; standard deviations are multiplied by the factors in parentheses",
            McKibbenWarning,
            stacklevel=3,
        )


def _solve(problem: _Problem, motions: Sequence[_Motion]) -> tuple[Floats, Floats, float, Scatter]:
    """Estimates, covariance widened by the scatter between recordings, residual angle [rad], and this scatter."""
    muscles, own = muscle_parameters(problem.base), len(problem.medians)
    count, substeps, variance = muscles + _SHARED + own, _substeps(motions), _FIRST_VARIANCE
    padded, sizes = list(map(_padded, motions)), [one.angle.size for one in motions]
    measured = np.concatenate([one.angle for one in motions])
    moves = np.vstack([np.zeros(count), _DIFFERENCE * np.eye(count)])

    def linearised(z: Floats) -> tuple[Floats, Floats]:
        """Errors of the angle [rad], and their difference quotients, shape (parameters, samples)."""
        found = [np.asarray(_angles(problem, z + moves, one, substeps)) for one in padded]
        angles = np.concatenate([one[:, :size] for one, size in zip(found, sizes, strict=True)], axis=1)
        return angles[0] - measured, (angles[1:] - angles[0]) / _DIFFERENCE

    def terms(z: Floats) -> tuple[float, Floats, Floats]:
        """Objective, its gradient, and its Gauss-Newton Hessian."""
        error, slope = linearised(z)
        return gauss_newton(error, slope.T, variance, z)

    def begun(strength: float) -> tuple[Floats, float]:
        z = np.zeros(count)
        z[:muscles] = start(problem.base, strength)[:muscles]
        z[list(_OWN).index("valve.rate") - own] = _RATE_START
        return minimised(terms, z, _FIRST)

    z = min((begun(strength) for strength in STARTS[:_STRENGTHS]), key=lambda found: found[1])[0]
    if not math.isfinite(terms(z)[0]):
        raise IdentificationError("the simulated joint diverges", remedy="give a model closer to the joint")
    error = np.zeros(0)
    for _ in range(_STAGES):
        z, _ = minimised(terms, z, _ITERATIONS)
        error = linearised(z)[0]
        variance = variance_of(np.split(error, np.cumsum(sizes)[:-1]))
    covariance: Any = np.linalg.inv(terms(z)[2])
    error, slope = linearised(z)
    ends = np.cumsum(sizes)[:-1]
    parts = zip(np.split(error, ends), np.split(slope, ends, axis=1), strict=True)
    scatter = scatter_between(covariance, [(part @ one / variance, part @ part.T / variance) for one, part in parts])
    wider = np.sqrt(np.maximum(scatter.ratio, 1.0))
    return z, covariance * np.outer(wider, wider), float(np.sqrt(np.mean(error**2))), scatter
