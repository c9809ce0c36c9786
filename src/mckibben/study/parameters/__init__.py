"""Scenario parameters by name, their distributions, samples of them, and scenarios with other values."""

from mckibben.study.parameters.distributions import Distribution, IntegerRange, LogUniform, Normal, Uniform, Values
from mckibben.study.parameters.parameter import ScenarioParameter, find_parameter, find_parameters, list_parameters
from mckibben.study.parameters.sampling import (
    SamplingMethod,
    SweptParameter,
    Table,
    parse_sweep,
    parse_sweeps,
    sample,
    sweep_parameters,
)
from mckibben.study.parameters.values import Known, batched, edit_scenario, known_names, valid_rows, with_values

__all__ = [
    "Distribution",
    "IntegerRange",
    "Known",
    "LogUniform",
    "Normal",
    "SamplingMethod",
    "ScenarioParameter",
    "SweptParameter",
    "Table",
    "Uniform",
    "Values",
    "batched",
    "edit_scenario",
    "find_parameter",
    "find_parameters",
    "known_names",
    "list_parameters",
    "parse_sweep",
    "parse_sweeps",
    "sample",
    "sweep_parameters",
    "valid_rows",
    "with_values",
]
