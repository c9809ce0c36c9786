"""Tuning: the numbers of scenarios that cost least, by gradient, by evolution, or by CMA-ES."""

from mckibben.study.tune.cost import Cost, Term, gain_ranges, parse_cost, parse_ranges
from mckibben.study.tune.search import Method
from mckibben.study.tune.tune import TuningResult, tune

__all__ = ["Cost", "Method", "Term", "TuningResult", "gain_ranges", "parse_cost", "parse_ranges", "tune"]
