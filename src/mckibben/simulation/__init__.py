"""The sampled-data loop, its result and metrics, and the static feasibility of a reference."""

from mckibben.simulation.accuracy import ACCURACY, Resolution
from mckibben.simulation.batch import simulate_many
from mckibben.simulation.derivatives import Derivatives, Mode, differentiate
from mckibben.simulation.dynamic_stiffness import DynamicStiffness, closed_valves, dynamic_stiffness
from mckibben.simulation.loop import compiled_episode, episode
from mckibben.simulation.metrics import SETTLING_PART, Metrics, Trajectory, measure, rms, settling_band, trajectory
from mckibben.simulation.outcome import Outcome
from mckibben.simulation.problem import AtRest, sampled, sampled_signal, without_last_change
from mckibben.simulation.result import Result, compute_metrics, compute_trajectory
from mckibben.simulation.simulate import (
    CheckedRun,
    Feasibility,
    check_reference,
    checked_run,
    needed_substeps,
    run_episode,
    simulate,
)
from mckibben.simulation.stability import Margins, disk_margins, linear_loop, margins
from mckibben.simulation.table import Batch, RunResult

__all__ = [
    "ACCURACY",
    "SETTLING_PART",
    "AtRest",
    "Batch",
    "CheckedRun",
    "Derivatives",
    "DynamicStiffness",
    "Feasibility",
    "Margins",
    "Metrics",
    "Mode",
    "Outcome",
    "Resolution",
    "Result",
    "RunResult",
    "Trajectory",
    "check_reference",
    "checked_run",
    "closed_valves",
    "compiled_episode",
    "compute_metrics",
    "compute_trajectory",
    "differentiate",
    "disk_margins",
    "dynamic_stiffness",
    "episode",
    "linear_loop",
    "margins",
    "measure",
    "needed_substeps",
    "rms",
    "run_episode",
    "sampled",
    "sampled_signal",
    "settling_band",
    "simulate",
    "simulate_many",
    "trajectory",
    "without_last_change",
]
