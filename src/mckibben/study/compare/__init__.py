"""Comparison of controllers with equal tuning budgets, ranked on unseen runs."""

from mckibben.study.compare.compare import compare
from mckibben.study.compare.result import CompareResult
from mckibben.study.compare.runs import Runs, draw, evaluate
from mckibben.study.compare.settings import NOMINAL_JOINT
from mckibben.study.compare.suite import Suite

__all__ = ["NOMINAL_JOINT", "CompareResult", "Runs", "Suite", "compare", "draw", "evaluate"]
