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
    run_parts,
    run_sweeps,
)
from mckibben.calibration.output_error import CommandedCalibration, SimulatedAngles, calibrate_from_commands
from mckibben.calibration.shut_valve import AirFit, identify_air
from mckibben.calibration.valve_experiment import (
    ValveExperiment,
    calibrate_scenario_valves,
    scenario_with_valves,
    valve_for,
    valve_statements,
)
from mckibben.calibration.valves import ValveCalibration, calibrate_valves

__all__ = [
    "AirFit",
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
    "expected",
    "identify_air",
    "read_joint_recording",
    "run_parts",
    "run_sweeps",
    "scenario_with_valves",
    "valve_for",
    "valve_statements",
]
