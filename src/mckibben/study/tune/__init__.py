"""Tuning: minimisation of a cost over scenario parameters, by gradient, differential evolution or CMA-ES."""

from mckibben.study.tune.cost import Cost, Term, parse_cost
from mckibben.study.tune.margin import on_small_step, stability_margin
from mckibben.study.tune.search import Method, SearchSpace, gain_ranges, parse_ranges
from mckibben.study.tune.tune import TuningResult, read_trials, tune

__all__ = [
    "Cost",
    "Method",
    "SearchSpace",
    "Term",
    "TuningResult",
    "gain_ranges",
    "on_small_step",
    "parse_cost",
    "parse_ranges",
    "read_trials",
    "stability_margin",
    "tune",
]
