"""Comparison: controllers tuned alike, and ranked on runs that none of them has seen."""

from mckibben.study.benchmark.benchmark import Contest, compare, judged
from mckibben.study.benchmark.runs import Runs, draw
from mckibben.study.benchmark.suite import AS_BELIEVED, Suite

__all__ = ["AS_BELIEVED", "Contest", "Runs", "Suite", "compare", "draw", "judged"]
