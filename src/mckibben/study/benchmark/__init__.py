"""Comparison: controllers tuned alike, and ranked on runs that none of them has seen."""

from mckibben.study.benchmark.benchmark import BenchmarkResult, compare, evaluate
from mckibben.study.benchmark.runs import Runs, draw
from mckibben.study.benchmark.suite import NOMINAL_JOINT, Suite

__all__ = ["NOMINAL_JOINT", "BenchmarkResult", "Runs", "Suite", "compare", "draw", "evaluate"]
