"""Sweeps: many runs of a scenario over ranges of its parameters."""

from mckibben.study.sweep.result import SweepResult
from mckibben.study.sweep.sweep import Sweep, sweep

__all__ = ["Sweep", "SweepResult", "sweep"]
