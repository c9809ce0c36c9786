"""Sweeps: many runs of a scenario over ranges of its parameters."""

from mckibben.study.sweep.result import SweepResult, summary
from mckibben.study.sweep.sweep import InterruptedSweep, sweep

__all__ = ["InterruptedSweep", "SweepResult", "summary", "sweep"]
