"""Scenarios from files: of a joint, or of a robot."""

from __future__ import annotations

import os
from typing import Any

from mckibben.config.document import read_document
from mckibben.config.model import read_text
from mckibben.scenario.scenario import Scenario, StudiedScenario


def read_scenario(path: str | os.PathLike[str]) -> Any:
    """Read a scenario of a joint, or of a robot, which has a section `robot`; raises `ScenarioError`."""
    return scenario_class(read_document(read_text(path, "a scenario", "examples/")).data).read(path)


def scenario_class(document: object) -> type[StudiedScenario]:
    """Return the class of a document: that of a scenario of a robot if it has a section `robot`."""
    if not (isinstance(document, dict) and "robot" in document):
        return Scenario
    from mckibben.scenario.robot import RobotScenario

    return RobotScenario
