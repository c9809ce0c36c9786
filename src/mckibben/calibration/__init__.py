"""Calibration: identification of a joint's model on the joint, from recordings of its motion."""

from mckibben.calibration.equations import JointPrior, JointRecording
from mckibben.calibration.estimation import JointCalibration, JointEstimate, calibrate_joint
from mckibben.calibration.experiment import (
    Sweeps,
    calibrated_model,
    calibrated_scenario,
    expected,
    read_joint_recording,
    run_sweeps,
)

__all__ = [
    "JointCalibration",
    "JointEstimate",
    "JointPrior",
    "JointRecording",
    "Sweeps",
    "calibrate_joint",
    "calibrated_model",
    "calibrated_scenario",
    "expected",
    "read_joint_recording",
    "run_sweeps",
]
