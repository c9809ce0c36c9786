"""Scenario files: one run of a controller on a joint; parameters of scenarios by name."""

from mckibben.scenario.muscle import air_volume, read_specimen, write_identified, write_muscle
from mckibben.scenario.parameters import ScenarioParameter, find_parameter, find_parameters, list_parameters
from mckibben.scenario.scenario import (
    RunSettings,
    Scenario,
    Start,
    StudiedScenario,
    initial_state,
    read_scenario,
    run_scenario,
)
from mckibben.scenario.start import UNKNOWN, starting_scenario, starting_stiffness, starting_text
from mckibben.scenario.values import (
    ModelFollows,
    batched,
    edit_scenario,
    followed_names,
    run_many,
    valid_rows,
    with_values,
)

__all__ = [
    "UNKNOWN",
    "ModelFollows",
    "RunSettings",
    "Scenario",
    "ScenarioParameter",
    "Start",
    "StudiedScenario",
    "air_volume",
    "batched",
    "edit_scenario",
    "find_parameter",
    "find_parameters",
    "followed_names",
    "initial_state",
    "list_parameters",
    "read_scenario",
    "read_specimen",
    "run_many",
    "run_scenario",
    "starting_scenario",
    "starting_stiffness",
    "starting_text",
    "valid_rows",
    "with_values",
    "write_identified",
    "write_muscle",
]
