"""Distributions of scenario parameters, and samples of them."""

from mckibben.study.parameters.distributions import Distribution, LogUniform, Normal, Range, Uniform, Values
from mckibben.study.parameters.sampling import (
    SamplingMethod,
    SweptParameter,
    Table,
    parse_sweep,
    parse_sweeps,
    sample,
    sweep_parameters,
)

__all__ = [
    "Distribution",
    "LogUniform",
    "Normal",
    "Range",
    "SamplingMethod",
    "SweptParameter",
    "Table",
    "Uniform",
    "Values",
    "parse_sweep",
    "parse_sweeps",
    "sample",
    "sweep_parameters",
]
