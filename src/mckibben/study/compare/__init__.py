"""Comparison of controllers with equal tuning budgets, ranked on unseen runs."""

from mckibben.study.benchmark.benchmark import BenchmarkResult, compare, evaluate
from mckibben.study.benchmark.runs import Runs, draw
from mckibben.study.benchmark.suite import NOMINAL_JOINT, Suite

__all__ = ["NOMINAL_JOINT", "BenchmarkResult", "Runs", "Suite", "compare", "draw", "evaluate"]
