"""The sampled-data loop, its result and metrics, and the static feasibility of a reference."""

from mckibben.simulation.accuracy import ACCURACY, Resolution
from mckibben.simulation.batch import Batch, simulate_many
from mckibben.simulation.derivatives import Derivatives, Mode, differentiate
from mckibben.simulation.dynamic_stiffness import DynamicStiffness, closed_valves, dynamic_stiffness
from mckibben.simulation.loop import compiled_episode, episode
from mckibben.simulation.metrics import (
    SETTLING_PART,
    Metrics,
    Trajectory,
    compiled_measure,
    compiled_trajectory,
    measure,
    rms,
    settling_band,
    trajectory,
)
from mckibben.simulation.problem import AtRest, sampled, without_last_change
from mckibben.simulation.result import Outcome, Result
from mckibben.simulation.simulate import (
    CheckedRun,
    Feasibility,
    check_reference,
    checked_run,
    needed_substeps,
    run_episode,
    simulate,
)
from mckibben.simulation.stability import Margins, margins

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
    "Trajectory",
    "check_reference",
    "checked_run",
    "closed_valves",
    "compiled_episode",
    "compiled_measure",
    "compiled_trajectory",
    "differentiate",
    "dynamic_stiffness",
    "episode",
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
    "without_last_change",
]
