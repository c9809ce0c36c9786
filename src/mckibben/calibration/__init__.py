"""Calibration: identification of a joint model from recordings of the joint's motion."""

from mckibben.calibration.equations import JointPrior, JointRecording
from mckibben.calibration.estimation import JointCalibration, calibrate_joint
from mckibben.calibration.experiment import (
    Sweeps,
    calibrate_scenario,
    calibrated_model,
    calibrated_scenario,
    read_joint_recording,
    run_parts,
)
from mckibben.calibration.fitting import Calibration, JointEstimate
from mckibben.calibration.output_error import CommandedCalibration, SimulatedAngles, calibrate_from_commands
from mckibben.calibration.shut_valve import AirFit, identify_air
from mckibben.calibration.valve_experiment import (
    ValveExperiment,
    calibrate_scenario_valves,
    scenario_with_valves,
    valve_for,
)
from mckibben.calibration.valves import ValveCalibration, calibrate_valves

__all__ = [
    "AirFit",
    "Calibration",
    "CommandedCalibration",
    "JointCalibration",
    "JointEstimate",
    "JointPrior",
    "JointRecording",
    "SimulatedAngles",
    "Sweeps",
    "ValveCalibration",
    "ValveExperiment",
    "calibrate_from_commands",
    "calibrate_joint",
    "calibrate_scenario",
    "calibrate_scenario_valves",
    "calibrate_valves",
    "calibrated_model",
    "calibrated_scenario",
    "identify_air",
    "read_joint_recording",
    "run_parts",
    "scenario_with_valves",
    "valve_for",
]
