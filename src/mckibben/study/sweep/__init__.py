"""Sweeps: many runs of a scenario over ranges of its numbers, kept block by block: nothing that is finished is lost."""

from mckibben.study.sweep.plan import MANIFEST, Plan
from mckibben.study.sweep.result import MAIN, SweepResult, summary
from mckibben.study.sweep.store import BLOCKS, TABLE
from mckibben.study.sweep.sweep import InterruptedSweep, sweep

__all__ = ["BLOCKS", "MAIN", "MANIFEST", "TABLE", "InterruptedSweep", "Plan", "SweepResult", "summary", "sweep"]
