"""Scenario files: one run of a controller on a joint; parameters of scenarios by name."""

import sys
from types import ModuleType
from typing import NoReturn

from mckibben.errors import CallError
from mckibben.scenario.muscle import muscle_text, read_specimen
from mckibben.scenario.parameters import ScenarioParameter, find_parameter, find_parameters, list_parameters
from mckibben.scenario.scenario import RunSettings, Scenario, Start, initial_state, run_scenario, with_run
from mckibben.scenario.values import (
    ModelFollows,
    batched,
    edit_scenario,
    followed_names,
    run_many,
    valid_rows,
    with_values,
)


class _Module(ModuleType):
    """Module that is also ``mk.scenario``: a call of it names the class."""

    def __call__(self, *_: object, **__: object) -> NoReturn:
        remedy = "write Scenario(name=..., joint=..., ...), or Scenario.read(path)"
        raise CallError("scenario is a module, and Scenario is the class", remedy=remedy)


sys.modules[__name__].__class__ = _Module

__all__ = [
    "ModelFollows",
    "RunSettings",
    "Scenario",
    "ScenarioParameter",
    "Start",
    "batched",
    "edit_scenario",
    "find_parameter",
    "find_parameters",
    "followed_names",
    "initial_state",
    "list_parameters",
    "muscle_text",
    "read_specimen",
    "run_many",
    "run_scenario",
    "valid_rows",
    "with_run",
    "with_values",
]
