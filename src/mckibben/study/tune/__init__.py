"""Tuning: the numbers of scenarios that cost least, by gradient, by evolution, or by CMA-ES."""

from mckibben.study.tune.cost import Cost, Term, around_gains, read_cost, read_ranges
from mckibben.study.tune.search import Method
from mckibben.study.tune.tune import Tuned, tune

__all__ = ["Cost", "Method", "Term", "Tuned", "around_gains", "read_cost", "read_ranges", "tune"]
