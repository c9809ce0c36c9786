"""The sampled-data loop, its result and metrics, and the static feasibility of a reference."""

from mckibben.simulation.accuracy import ACCURACY, Resolution
from mckibben.simulation.batch import Batch, simulate_many
from mckibben.simulation.derivatives import Derivatives, differentiate
from mckibben.simulation.dynamic_stiffness import DynamicStiffness, closed_valves, dynamic_stiffness
from mckibben.simulation.feasibility import Feasibility, check_reference
from mckibben.simulation.loop import compiled_episode, episode
from mckibben.simulation.metrics import SETTLING_PART, Metrics, measure, rms, settling_band
from mckibben.simulation.outcome import Outcome
from mckibben.simulation.problem import AtRest, sampled, without_last_change
from mckibben.simulation.result import RunResult, SimulationResult, compute_metrics, compute_trajectory
from mckibben.simulation.simulate import needed_substeps, run_episode, simulate, unknown_air
from mckibben.simulation.stability import LEAST_DISK_MARGIN, Margins, disk_margins, margin_remarks, margins
from mckibben.simulation.trajectories import Trajectory, trajectory

__all__ = [
    "ACCURACY",
    "LEAST_DISK_MARGIN",
    "SETTLING_PART",
    "AtRest",
    "Batch",
    "Derivatives",
    "DynamicStiffness",
    "Feasibility",
    "Margins",
    "Metrics",
    "Outcome",
    "Resolution",
    "RunResult",
    "SimulationResult",
    "Trajectory",
    "check_reference",
    "closed_valves",
    "compiled_episode",
    "compute_metrics",
    "compute_trajectory",
    "differentiate",
    "disk_margins",
    "dynamic_stiffness",
    "episode",
    "margin_remarks",
    "margins",
    "measure",
    "needed_substeps",
    "rms",
    "run_episode",
    "sampled",
    "settling_band",
    "simulate",
    "simulate_many",
    "trajectory",
    "unknown_air",
    "without_last_change",
]
