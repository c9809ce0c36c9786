"""The sampled-data loop, its result and metrics, and the check of a wish before the run."""

from mckibben.simulation.loop import episode
from mckibben.simulation.metrics import Metrics, measure
from mckibben.simulation.reach import Reach, check_reference
from mckibben.simulation.result import Outcome, Result
from mckibben.simulation.simulate import simulate
from mckibben.simulation.trajectory import Trajectory, trajectory

__all__ = [
    "Metrics",
    "Outcome",
    "Reach",
    "Result",
    "Trajectory",
    "check_reference",
    "episode",
    "measure",
    "simulate",
    "trajectory",
]
