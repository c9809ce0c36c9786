"""The sampled-data loop, its result and metrics, and the static feasibility of a reference."""

from mckibben.simulation.batch import Batch, simulate_many
from mckibben.simulation.derivatives import Derivatives, Mode, differentiate
from mckibben.simulation.dynamic_stiffness import DynamicStiffness, closed_valves, dynamic_stiffness
from mckibben.simulation.loop import compiled_episode, episode
from mckibben.simulation.metrics import (
    SETTLING_PART,
    Metrics,
    Trajectory,
    measure,
    rms,
    settling_band,
    trajectory,
)
from mckibben.simulation.problem import AtRest, sampled, sampled_signal, without_last_change
from mckibben.simulation.result import Outcome, Result, compute_metrics, compute_trajectory
from mckibben.simulation.simulate import CheckedRun, Feasibility, check_reference, checked_run, run_episode, simulate
from mckibben.simulation.stability import Margins, margins

__all__ = [
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
    "Result",
    "Trajectory",
    "check_reference",
    "checked_run",
    "closed_valves",
    "compiled_episode",
    "compute_metrics",
    "compute_trajectory",
    "differentiate",
    "dynamic_stiffness",
    "episode",
    "margins",
    "measure",
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
