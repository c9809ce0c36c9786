"""Tuning: minimisation of a cost over scenario parameters, by CMA-ES or along the gradient."""

from mckibben.study.tune.cost import Cost, Term, parse_cost
from mckibben.study.tune.result import TuneResult
from mckibben.study.tune.search import Search
from mckibben.study.tune.space import SearchSpace, gain_ranges, parse_ranges
from mckibben.study.tune.trials import Trial, read_trials
from mckibben.study.tune.tune import tune

__all__ = [
    "Cost",
    "Search",
    "SearchSpace",
    "Term",
    "Trial",
    "TuneResult",
    "gain_ranges",
    "parse_cost",
    "parse_ranges",
    "read_trials",
    "tune",
]
