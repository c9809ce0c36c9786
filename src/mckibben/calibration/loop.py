"""Loop of a scenario on the calibrated plant, and on plants drawn from the estimates."""

from __future__ import annotations

import dataclasses
import warnings
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mckibben.control.base import with_fields
from mckibben.errors import McKibbenError, McKibbenWarning
from mckibben.result import Remark
from mckibben.scenario import StudiedScenario, list_parameters
from mckibben.simulation import LEAST_DISK_MARGIN, disk_margins

PLANTS = 8
"""Plants of which the loop is checked: the calibrated one, and others drawn from the estimates."""
_SUBSTEPS = 4  # where a scenario does not say
_MODELS = {"joint": "model"}  # parts of a plant that have another name in a controller
_PARAMETERS = {  # of a scenario, for estimates of another name
    "muscle1.force": "joint.muscle1.strength",
    "muscle2.force": "joint.muscle2.strength",
    "delay": "command_delay",
    "valve1.delay": "command_delay",
    "valve2.delay": "command_delay",
}


def with_estimates(scenario: Any, deviations: Mapping[str, str], **parts: Any) -> Any:
    """Return a scenario with estimates as parts of its plant, and of the model that its controller holds itself.

    Parts of the model that the controller inherits follow the plant. `deviations` are standard deviations, as text with
    a unit, by the names of the estimates: those of parameters of the scenario become its `uncertainty`.
    """
    own = {_MODELS.get(name, name): value for name, value in parts.items()}
    control = scenario.controller and with_fields(scenario.controller, own)
    after = scenario.model_copy(update={**parts, "controller": control})
    known = {parameter.name for parameter in list_parameters(after) if parameter.nominal is not None}
    uncertain = {text.partition("=")[0]: text for text in scenario.uncertain}
    for name, deviation in deviations.items():
        valve = name.replace("valve1.", "valve.muscle1.").replace("valve2.", "valve.muscle2.")
        both = name.replace("valve1.", "valve.").replace("valve2.", "valve.")
        load = name.replace("load.mass", f"load.{after.load.estimated_mass}")
        for parameter in (_PARAMETERS.get(name, name), load, valve, both):
            if parameter in known:
                uncertain[parameter] = f"{parameter}=normal {deviation}"
                break
    return after.model_copy(update={"uncertainty": tuple(uncertain.values())} if uncertain else {})


def loop_margins(scenario: StudiedScenario, **parts: Any) -> NDArray[np.float64] | None:
    """Return the least disk margin of a scenario's loop on each of many plants; 0 where it is unstable.

    `parts` of the plants have arrays of shape (plants,) in place of numbers. Warns and returns None if the scenario
    cannot run.
    """
    plant = dataclasses.replace(scenario.plant(), **parts)
    run = plant, scenario.control(), scenario.references(), scenario.starts()
    times = {name: scenario.timing[name] for name in ("duration", "control_period")}
    try:
        return np.nan_to_num(disk_margins(*run, **times, substeps=scenario.substeps or _SUBSTEPS)).clip(0.0)
    except McKibbenError as error:
        warnings.warn(f"the loop of the file has no margins: {error}", McKibbenWarning, stacklevel=2)
        return None


def loop_remarks(margins: NDArray[np.float64]) -> list[Remark]:
    """Return the remark on a loop that has not the margin on all plants, with the command that finds other gains."""
    own, least = float(margins[0]), float(margins.min())
    if least >= LEAST_DISK_MARGIN:
        return []
    text = f"the gains of the file have a disk margin of {own:.2g} on the calibrated plant, and of {least:.2g} on the "
    text += f"worst of {len(margins) - 1} plants drawn from the estimates, below {LEAST_DISK_MARGIN}"
    return [Remark.warning("controller", text, "mckibben tune DIR/scenario.yaml")]
