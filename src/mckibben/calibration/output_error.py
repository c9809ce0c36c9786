"""Identification of a joint from commanded pressures: the simulated angle is fitted to the recorded one."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, ArrayLike

from mckibben.actuator import FirstOrderValve
from mckibben.calibration.equations import (
    OF_MUSCLE,
    PARAMETERS,
    CalibrationProblem,
    Floats,
    JointPrior,
    JointRecording,
    JointSamples,
    Number,
    Samples,
    check_recording,
    corrected,
    problem_of,
)
from mckibben.calibration.estimation import CalibratedJoint, number, quantities_of, start
from mckibben.calibration.fitting import (
    OutputErrorFit,
    UncertainParameter,
    draws,
    fit_output_error,
    root_mean_square,
)
from mckibben.errors import IdentificationError
from mckibben.joint import AntagonisticJoint, Load
from mckibben.numerics.batching import batched_program
from mckibben.numerics.compiled import jit
from mckibben.plant import JointFriction, JointPlant
from mckibben.result import Column, column
from mckibben.units import ms

_ESTIMATED = np.array([*range(2 * OF_MUSCLE), 2 * OF_MUSCLE + 1, 2 * OF_MUSCLE + 2, 2 * OF_MUSCLE + 3])
"""Parameters of `corrected` that are estimated: those of the muscles, and weight, zero and scale of the arms."""


class _Motion(NamedTuple):
    """Equally spaced samples of a recording."""

    time: Samples  # [s], shape (samples,)
    angle: Samples  # measured [rad]
    commands: Samples  # [Pa], shape (2, samples)
    period: Number  # [s]
    added_mass: Number  # [kg]
    distance: Number  # [m]


class _Simulated(NamedTuple):
    """A plant with the additional quantities of recordings."""

    plant: JointPlant
    delay: Number  # of the commands [s]
    zero: Number  # of the encoder [rad]
    added: Number  # weight relative to its stated value


class _Problem(NamedTuple):
    """The model whose joint, load and weight `corrected` corrects, its valve, and quantities of valve and load."""

    base: CalibrationProblem
    valve: FirstOrderValve
    friction: JointFriction | None
    parameters: tuple[UncertainParameter, ...]


class CommandedCalibration(CalibratedJoint):
    """Joint identified from commanded pressures, by `calibrate_from_commands`.

    Attributes
    ----------
    quantities
        As for `JointCalibration`, and ``valve.time_constant``, ``valve.rate``, ``delay``, ``load.damping``,
        ``load.inertia``, ``load.gravity_torque``, with prior deviations relative to the estimates; no ``load.mass``.
    residual
        Root mean square of the error of the simulated angle [rad].
    valve, delay
        The valve with the estimates, and the delay [s] of its commands.
    friction
        Friction of the joint itself, which is not estimated; None if it has none.
    """

    _error = Column("rad", shown="deg", digits=3)

    residual: float = column("rad", "residual angle", shown="deg", digits=3)
    valve: FirstOrderValve
    delay: float
    friction: JointFriction | None
    _before: _Simulated
    _whole: _Problem

    def errors(self, recording: JointRecording) -> tuple[float, float]:
        """Return the root mean square errors of the simulated angle [rad] before and after the calibration."""
        motion, substeps = _motion(recording), _substeps([_motion(recording)])
        models = self._before, _model(self._whole, jnp.asarray(self._minima[0].z))
        angles = [np.asarray(_angle(model, _padded(motion), substeps))[: motion.angle.size] for model in models]
        return root_mean_square([angles[0] - motion.angle]), root_mean_square([angles[1] - motion.angle])

    def drawn(self, count: int) -> dict[str, Any]:
        """Return joint, load, valve and delay of plants, as `CalibratedJoint.drawn`."""
        models = _models(self._whole, draws(self._minima, count))
        plant = models.plant
        return {"joint": plant.joint, "load": plant.load, "valve": plant.valve, "command_delay": models.delay}

    @property
    def plant(self) -> JointPlant:
        """Joint, load, valve, friction and delay of the commands with the estimates."""
        return JointPlant(self.joint, self.load, self.valve, friction=self.friction, command_delay=self.delay)


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

    with the variance sigma^2 of `variance_of`.

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
        Dry friction of the joint itself, which is not estimated.
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
    motions = [_motion(recording) for recording in recordings]
    rigid = jax.tree.map(float, load.with_weight(0.0, 0.0))
    samples = [JointSamples(motion.angle, None, None, tuple(motion.commands), (), 0.0, 0.0) for motion in motions]
    base = problem_of(joint, rigid, [(half, half) for half in samples], prior)
    damping = rigid.damping or rigid.inertia / 1.0  # a time constant of 1 s
    highest = max(float(muscle.domain.pressure_max) for muscle in (joint.muscle1, joint.muscle2))  # 0 of a spring
    rate = highest / valve.time_constant if valve.rate is None else valve.rate
    own = (
        UncertainParameter("valve.time_constant", "s", float(valve.time_constant), prior.lag),
        UncertainParameter("valve.rate", "Pa/s", float(rate), prior.rate),
        UncertainParameter("delay", "s", delay or 20 * ms, prior.delay),
        UncertainParameter("load.damping", "N*m*s/rad", float(damping), prior.damping),
        UncertainParameter("load.inertia", "kg*m^2", rigid.inertia, prior.mass),
        UncertainParameter("load.gravity_torque", "N*m", rigid.greatest_gravity_torque, prior.mass),
    )
    problem = _Problem(base, valve, friction, own)
    fit = _solve(problem, motions)
    minimum = fit.minimum
    model = jax.tree.map(number, _model(problem, jnp.asarray(minimum.z)))
    quantities = quantities_of(base, [minimum])
    for name in ("muscle1.creep", "muscle2.creep", "inertia"):  # not estimated
        quantities.pop(name, None)
    quantities |= {
        parameter.name: parameter.estimate(float(z), float(deviation))
        for parameter, z, deviation in zip(own, minimum.z[PARAMETERS:], minimum.deviations[PARAMETERS:], strict=True)
        if parameter.median
    }
    return CommandedCalibration(
        quantities=quantities,
        joint=model.plant.joint,
        load=model.plant.load,
        recordings=tuple(recordings),
        _problem=base,
        _minima=(minimum,),
        residual=fit.residual,
        valve=model.plant.valve,
        delay=model.delay,
        friction=friction,
        _before=_Simulated(JointPlant(joint, rigid, valve, friction=friction), delay or 0.0, 0.0, 1.0),
        _whole=problem,
    )


def _motion(recording: JointRecording, *, longest: float = 0.05, gap: int = 10) -> _Motion:
    """Equally spaced samples with commands constant over each period, of at most some [s], and a gap of some periods.

    Raises `IdentificationError` for measured pressures, sparse samples, gaps, and constant commands.
    """
    if not recording.commanded:
        raise IdentificationError(
            "a recording has measured pressures", remedy="give commands, in columns command1_bar,command2_bar"
        )
    check_recording(recording)
    period = float(np.median(np.diff(recording.time)))
    widest = float(np.diff(recording.time).max())
    if not 0 < period <= longest or widest > gap * period:
        message = f"the samples of a recording are {period * 1e3:.3g} ms apart, with a gap of {widest * 1e3:.3g} ms"
        remedy = f"record at {1 / longest:.0f} Hz or more, and split recordings at gaps"
        raise IdentificationError(message, value=widest, unit="s", remedy=remedy)
    grid = np.arange(recording.time[0], recording.time[-1], period)
    last = np.searchsorted(recording.time, grid + period / 2, side="right") - 1
    commands = recording.pressures[last].T
    if not np.ptp(commands, axis=1).any():
        raise IdentificationError("the commands of a recording are constant", remedy="record steps of the pressures")
    angle = np.interp(grid, recording.time, recording.angle)
    weight = np.float64(recording.added_mass), np.float64(recording.distance)
    return _Motion(grid, angle, commands, np.float64(period), *weight)


def _padded(motion: _Motion, *, block: int = 512) -> _Motion:
    """A motion padded with rest to whole blocks of samples: each length needs its own program."""
    more = -motion.angle.size % block
    columns = motion[:3]
    time, angle, commands = (np.pad(values, [(0, 0)] * (values.ndim - 1) + [(0, more)], "edge") for values in columns)
    return motion._replace(time=time, angle=angle, commands=commands)


def _substeps(motions: Sequence[_Motion], *, step: float = 5 * ms) -> int:
    return math.ceil(max(float(motion.period) for motion in motions) / step)


def _trajectory(model: _Simulated, motion: _Motion, substeps: int) -> Array:
    """Angle [rad] at the samples, as read by the encoder."""
    plant, steps = model.plant, jnp.arange(motion.angle.shape[0])
    plant = dataclasses.replace(plant, load=plant.load.with_weight(model.added * motion.added_mass, motion.distance))
    at = steps - model.delay / motion.period  # between two samples: their mean over the period
    command1, command2 = (jnp.interp(at, steps, command) for command in motion.commands)
    first = plant.init_state(motion.angle[0] - model.zero, (command1[0], command2[0]))

    def step(state: Any, commands: Any) -> tuple[Any, Array]:
        return plant.advance(state, commands, motion.period, substeps), state.angle

    return lax.scan(step, first, (command1, command2))[1] + model.zero


@jit
def _angle(model: _Simulated, motion: _Motion, substeps: int) -> Array:
    with batched_program():
        return _trajectory(model, motion, substeps)


@jit
def _angles(problem: _Problem, zs: ArrayLike, motion: _Motion, substeps: int) -> Array:
    """Angles [rad], shape (parameter vectors, samples)."""
    with batched_program():
        return jax.vmap(lambda z: _trajectory(_simulated_by(problem, z), motion, substeps))(zs)


def _simulated_by(problem: _Problem, z: Array) -> _Simulated:
    """The model by parameters in prior standard deviations from their prior mean."""
    base, load = problem.base, problem.base.load
    joint, _, added, zero, *_ = corrected(base, z)
    values = [parameter.at(at) for parameter, at in zip(problem.parameters, z[PARAMETERS:], strict=True)]
    lag, rate, delay, damping, inertia, gravity = values
    load = dataclasses.replace(load, inertia=inertia, greatest_gravity_torque=gravity, damping=damping)  # pyrefly: ignore[unexpected-keyword]
    valve = dataclasses.replace(problem.valve, time_constant=lag, rate=rate)
    return _Simulated(JointPlant(joint, load, valve, friction=problem.friction), delay, zero, added)


_model = jit(_simulated_by)
_models = jit(jax.vmap(_simulated_by, (None, 0)))


def _solve(problem: _Problem, motions: Sequence[_Motion], *, difference: float = 1e-4) -> OutputErrorFit:
    """The fit of the angles of all motions; difference quotients are of a part of a prior standard deviation."""
    count, substeps = PARAMETERS + len(problem.parameters), _substeps(motions)
    padded, measured = list(map(_padded, motions)), [np.asarray(motion.angle) for motion in motions]
    estimated = np.append(_ESTIMATED, np.arange(PARAMETERS, count))
    moves = np.vstack([np.zeros(count), difference * np.eye(count)[estimated]])

    def simulated(z: Floats) -> list[tuple[Floats, Floats]]:
        """Angles [rad] of each motion, and their difference quotients."""
        pairs = []
        for motion, angle in zip(padded, measured, strict=True):
            angles = np.asarray(_angles(problem, z + moves, motion, substeps))[:, : angle.size]
            slopes = np.zeros((angle.size, count))
            slopes[:, estimated] = ((angles[1:] - angles[0]) / difference).T
            pairs.append((angles[0], slopes))
        return pairs

    def begin(strength: float) -> Floats:
        """Start with a limit of the rate that acts on large steps: else its derivative is zero."""
        return np.append(start(strength), np.where(np.arange(len(problem.parameters)) == 1, -1.5, 0.0))

    starts = [begin(strength) for strength in (0.0, -1.0, 1.0)]
    return fit_output_error(simulated, measured, starts, 0.1**2, 1e-8)
