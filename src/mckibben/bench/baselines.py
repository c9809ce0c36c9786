"""Baselines of the benchmark: force laws of this package, a Gaussian process, and a recurrent network."""

from __future__ import annotations

import functools
import warnings
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from scipy.linalg import cho_solve, cholesky
from scipy.optimize import minimize
from scipy.signal import lfilter

from mckibben import catalog
from mckibben.bench.recurrent import fit_recurrent
from mckibben.bench.task import Floats, Predict, Training
from mckibben.calibration import JointPrior, JointRecording, calibrate_from_commands
from mckibben.dataset import IsobaricDataset
from mckibben.errors import McKibbenWarning
from mckibben.identification import identify, identify_hysteresis
from mckibben.joint import AntagonisticJoint, GeneralLoad, PairedPaths, Pulley
from mckibben.muscle import LAWS, ChouLaw, ExponentialLaw, ForceLaw, Muscle, Specimen, forces
from mckibben.numerics.calculus import evenly_spaced
from mckibben.plant import FirstOrderValve
from mckibben.units import ms

Fit = Callable[[Training], "Predict | None"]
"""A submission: the prediction from the training data; None if it does not apply to a task."""

_PRIOR = JointPrior(strength=0.3, offset=0.15)  # the muscles were never on a rig
_LAG = 50 * ms
_DAMPING = 0.05  # N*m*s/rad
_MOST_POINTS = 600  # of recordings, in a law
_MOST_CONDITIONED = 400  # of a Gaussian process
_MEMORY = (0.03, 0.3, 3.0)  # s, time constants of the low-pass filters


def fit_law(law_type: type[ForceLaw], training: Training) -> Predict | None:
    """Fit a static law to all points; for another specimen, its scale is fitted to the points of that one.

    A joint is calibrated from its commands (`mckibben.calibration.calibrate_from_commands`) with muscles of that law.
    """
    if training.kind == "joint":
        return fit_joint(law_type, training)
    blocks = training.blocks[:-1] if training.kind == "transfer" else training.blocks
    inputs, output = (np.concatenate([getattr(one, name) for one in blocks]) for name in ("inputs", "output"))
    chosen = evenly_spaced(len(output), _MOST_POINTS)
    points = IsobaricDataset.of(
        contraction=inputs[chosen, 0],
        pressure=inputs[chosen, 1],
        force=output[chosen],
        initial_length=training.facts.get("initial_length"),
        slack_force=training.facts.get("slack_force", 0.0),
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", McKibbenWarning)
        law = identify(law_type, points, robust=False).law
    scale = 1.0
    if training.kind == "transfer":
        known, force = training.blocks[-1].inputs, training.blocks[-1].output
        static = _tension(law, known)
        scale = float(static @ force / (static @ static))
    return lambda new: scale * _tension(law, new)


def fit_joint(law_type: type[ForceLaw], training: Training) -> Predict | None:
    """Calibrate a joint from commands, with a muscle of 10 mm before; None for laws that are fitted to a map only."""
    fact = training.fact
    length = fact("initial_length")
    published = catalog.law("lei-mas-10-180n")
    laws: dict[type[ForceLaw], ForceLaw] = {
        ExponentialLaw: published,
        ChouLaw: ChouLaw(
            braid_angle=fact("braid_angle"), initial_diameter=fact("initial_diameter"), domain=published.domain
        ),
    }
    if law_type not in laws:
        return None
    muscle = Muscle(Specimen("muscle", length), laws[law_type])
    mounted = length * (1 - fact("contraction_at_zero"))
    paths = PairedPaths(Pulley(fact("pulley_radius"), mounted), Pulley(fact("pulley_radius"), mounted))
    joint = AntagonisticJoint(paths, muscle, muscle)
    load = GeneralLoad(fact("inertia"), fact("gravity_torque"), _DAMPING)
    recordings = [_recording(one.inputs, one.output, training.period or 0.0) for one in training.blocks]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", McKibbenWarning)
        found = calibrate_from_commands(joint, load, FirstOrderValve(_LAG), recordings, _PRIOR)

    def predict(new: Floats) -> Floats:
        one = _recording(new, np.zeros(len(new)), training.period or 0.0)
        simulated = found.simulate(one)  # without long rests
        return np.interp(one.time, simulated.time, simulated.after)

    return predict


def _recording(commands: Floats, angle: Floats, period: float) -> JointRecording:
    return JointRecording(period * np.arange(angle.size, dtype=float), angle, commands, commanded=True)


def fit_with_friction(training: Training) -> Predict | None:
    """Fit Eq. 2 and Maxwell-slip friction along the recorded paths; None for other data than cycles of the length."""
    if training.kind != "hysteresis":
        return None
    length = training.fact("initial_length")
    stride = max(1, training.stacked[1].size // _MOST_POINTS)
    inputs = np.concatenate([one.inputs[::stride] for one in training.blocks])
    output = np.concatenate([one.output[::stride] for one in training.blocks])
    rates = np.concatenate([np.gradient(one.inputs[::stride, 0]) for one in training.blocks])
    points = IsobaricDataset.of(
        contraction=inputs[:, 0],
        pressure=inputs[:, 1],
        force=output,
        direction=np.where(rates > 0, "unloading", "loading"),
        initial_length=length,
        slack_force=training.facts.get("slack_force", 0.0),
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", McKibbenWarning)
        found = identify_hysteresis(LAWS["ExponentialLaw"], points, drift=False)

    def predict(new: Floats) -> Floats:
        tension = _tension(found.law, new)
        friction = found.friction.path_response(length * (1 - new[:, 0]), tension, new[:, 1])
        return np.maximum(tension + friction, 0.0)

    return predict


_STARTS = ((0.0, 0.0, -3.0), (-1.0, -1.0, -3.0), (0.0, 0.0, -6.0))  # first length, other lengths, noise
_BOUNDS = ((-3.0, 6.0), (-3.0, 4.0), (-9.0, 1.0))  # logarithms of amplitude, lengths and noise
_JITTER = 1e-9  # of the variance


class GaussianProcess(NamedTuple):
    """A Gaussian process conditioned on points, with a squared exponential kernel and one length per input."""

    inputs: Floats
    weights: Floats
    values: Floats
    middle: Floats
    width: Floats
    mean: float
    spread: float

    @classmethod
    def fitted(cls, inputs: Floats, output: Floats) -> GaussianProcess:
        """Return the process whose amplitude, lengths and noise have maximum likelihood, the best of three starts."""
        middle, width = inputs.mean(axis=0), np.maximum(inputs.std(axis=0), 1e-12)
        given, mean, spread = (inputs - middle) / width, float(output.mean()), max(float(output.std()), 1e-12)
        target, lengths = (output - mean) / spread, inputs.shape[1]
        apart = (given[:, None] - given) ** 2

        def solved(values: Floats) -> tuple[Any, Any, Any]:
            signal = np.exp(2 * values[0] - apart @ np.exp(-2 * values[1:-1]) / 2)
            noise = np.exp(2 * values[-1]) + _JITTER * np.exp(2 * values[0])
            factor = cholesky(signal + noise * np.eye(len(given)), lower=True)
            return signal, factor, cho_solve((factor, True), target)

        def cost(values: Floats) -> tuple[float, Floats]:
            signal, factor, weights = solved(values)
            inverse = cho_solve((factor, True), np.eye(len(given)))
            inner = inverse - np.outer(weights, weights)
            slopes = [np.sum(inner * signal) + _JITTER * np.exp(2 * values[0]) * np.trace(inner)]
            scaled = inner * signal
            slopes += [np.sum(scaled * apart[:, :, i]) * np.exp(-2 * values[1 + i]) / 2 for i in range(lengths)]
            slopes.append(np.exp(2 * values[-1]) * np.trace(inner))
            return float(target @ weights / 2 + np.log(np.diag(factor)).sum()), np.array(slopes)

        starts = [(1.0, first, *[rest] * (lengths - 1), noise) for first, rest, noise in _STARTS]
        bounds = (_BOUNDS[0], *[_BOUNDS[1]] * lengths, _BOUNDS[2])
        found = min((minimize(cost, one, jac=True, bounds=bounds) for one in starts), key=lambda one: one.fun).x
        return cls(given, solved(found)[2], found, middle, width, mean, spread)

    def predict(self, inputs: Floats) -> Floats:
        """Return the mean of new measurements at inputs of shape (points, inputs)."""
        apart = (((inputs - self.middle) / self.width)[:, None] - self.inputs) ** 2
        across = np.exp(2 * self.values[0] - apart @ np.exp(-2 * self.values[1:-1]) / 2)
        return self.mean + self.spread * (across @ self.weights)


def fit_gaussian_process(training: Training) -> Predict:
    """Fit a Gaussian process to the inputs and, for recordings, to the inputs after low-pass filters."""
    features = functools.partial(_features, period=training.period)
    inputs = np.concatenate([features(one.inputs) for one in training.blocks])
    output = training.stacked[1]
    chosen = evenly_spaced(len(output), _MOST_CONDITIONED)
    found = GaussianProcess.fitted(inputs[chosen], output[chosen])
    return lambda new: found.predict(features(new))


def _tension(law: ForceLaw, inputs: Floats) -> Floats:
    """Force of a law [N], 0 where the muscle is slack."""
    return np.maximum(forces(law, inputs[:, 0], inputs[:, 1]), 0.0)


def _features(inputs: Floats, period: float | None) -> Floats:
    """The inputs, and their differences to low-pass filtered ones, at rest before the first sample."""
    if period is None:
        return inputs
    columns = [inputs]
    for time in _MEMORY:
        keep = np.exp(-period / time)
        columns.append(inputs - inputs[0] - lfilter([1 - keep], [1, -keep], inputs - inputs[0], axis=0))
    return np.concatenate(columns, axis=1)


BASELINES: dict[str, Fit] = {
    "eq2": functools.partial(fit_law, LAWS["ExponentialLaw"]),
    "chou": functools.partial(fit_law, LAWS["ChouLaw"]),
    "friction": fit_with_friction,
    "smooth": functools.partial(fit_law, LAWS["SmoothLaw"]),
    "gp": fit_gaussian_process,
    "gru": fit_recurrent,
}
"""Baselines by name; "eq2" is the reference."""
