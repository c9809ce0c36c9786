"""Calibration: identification of a joint model from recordings of the joint's motion."""

from mckibben.calibration.equations import JointPrior, JointRecording
from mckibben.calibration.estimation import JointCalibration, JointEstimate, calibrate_joint
from mckibben.calibration.experiment import (
    Sweeps,
    calibrate_scenario,
    calibrated_model,
    calibrated_scenario,
    expected,
    read_joint_recording,
    run_sweeps,
)
from mckibben.calibration.output_error import CommandedCalibration, SimulatedAngles, calibrate_from_commands

__all__ = [
    "CommandedCalibration",
    "JointCalibration",
    "JointEstimate",
    "JointPrior",
    "JointRecording",
    "SimulatedAngles",
    "Sweeps",
    "calibrate_from_commands",
    "calibrate_joint",
    "calibrate_scenario",
    "calibrated_model",
    "calibrated_scenario",
    "expected",
    "read_joint_recording",
    "run_sweeps",
]
