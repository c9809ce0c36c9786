"""Baselines of the benchmark: force laws of this package, a Gaussian process, and a recurrent network."""

from __future__ import annotations

import functools
import warnings
from collections.abc import Callable

import numpy as np
from scipy.signal import lfilter

from mckibben.bench.gaussian_process import GaussianProcess
from mckibben.bench.task import Floats, Predict, Training
from mckibben.dataset import IsobaricDataset
from mckibben.errors import McKibbenWarning
from mckibben.identification import identify, identify_hysteresis
from mckibben.muscle import LAWS, ForceLaw, forces

Fit = Callable[[Training], "Predict | None"]
"""A submission: the prediction from the training data; None if it does not apply to a task."""

_MOST_POINTS = 600  # of recordings, in a law
_MOST_CONDITIONED = 400  # of a Gaussian process
_MEMORY = (0.03, 0.3, 3.0)  # s, time constants of the low-pass filters


def fit_law(law_type: type[ForceLaw], training: Training) -> Predict | None:
    """Fit a static law to all points; for another specimen, its scale is fitted to the points of that one.

    A joint is calibrated from its commands (`mckibben.calibration.calibrate_from_commands`) with muscles of that law.
    """
    if training.kind == "joint":
        from mckibben.bench.joint_model import fit_joint

        return fit_joint(law_type, training)
    blocks = training.blocks[:-1] if training.kind == "transfer" else training.blocks
    inputs, output = (np.concatenate([getattr(one, name) for one in blocks]) for name in ("inputs", "output"))
    chosen = _thinned(len(output), _MOST_POINTS)
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


def fit_gaussian_process(training: Training) -> Predict:
    """Fit a Gaussian process to the inputs and, for recordings, to the inputs after low-pass filters."""
    features = functools.partial(_features, period=training.period)
    inputs = np.concatenate([features(one.inputs) for one in training.blocks])
    output = training.stacked[1]
    chosen = _thinned(len(output), _MOST_CONDITIONED)
    found = GaussianProcess.fitted(inputs[chosen], output[chosen])
    return lambda new: found.predict(features(new))[0]


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


def _thinned(count: int, most: int) -> np.ndarray:
    """Indices of at most so many evenly spaced samples."""
    return np.unique(np.linspace(0, count - 1, min(count, most)).round().astype(int))


def _recurrent(training: Training) -> Predict | None:
    from mckibben.bench.recurrent import fit_recurrent  # imports equinox and JAX

    return fit_recurrent(training)


BASELINES: dict[str, Fit] = {
    "eq2": functools.partial(fit_law, LAWS["ExponentialLaw"]),
    "chou": functools.partial(fit_law, LAWS["ChouLaw"]),
    "friction": fit_with_friction,
    "smooth": functools.partial(fit_law, LAWS["SmoothLaw"]),
    "gp": fit_gaussian_process,
    "gru": _recurrent,
}
"""Baselines by name; "eq2" is the reference."""
