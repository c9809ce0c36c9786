"""Tuning: the numbers of scenarios that cost least, by gradient, by evolution, or by CMA-ES."""

from mckibben.study.tuning.cost import Cost, Term, read_cost
from mckibben.study.tuning.ranges import around_gains, read_ranges
from mckibben.study.tuning.search import Method
from mckibben.study.tuning.searching import Tuned, tune

__all__ = ["Cost", "Method", "Term", "Tuned", "around_gains", "read_cost", "read_ranges", "tune"]
