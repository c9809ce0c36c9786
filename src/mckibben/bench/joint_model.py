"""Joint of the baselines: the calibrated model of this package, with muscles of a law."""

from __future__ import annotations

import warnings

import numpy as np

from mckibben import catalog
from mckibben.bench.task import Floats, Predict, Training
from mckibben.calibration import JointPrior, JointRecording, calibrate_from_commands
from mckibben.errors import McKibbenWarning
from mckibben.joint import AntagonisticJoint, GeneralLoad, PairedPaths, Pulley
from mckibben.muscle import ChouLaw, ExponentialLaw, ForceLaw, Muscle, Specimen
from mckibben.plant import FirstOrderValve
from mckibben.units import ms

_PRIOR = JointPrior(strength=0.3, offset=0.15)  # the muscles were never on a rig
_LAG = 50 * ms
_DAMPING = 0.05  # N*m*s/rad


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
