"""Explorers of the labs' pages: parts with sliders that run in the browser."""

from __future__ import annotations

from pathlib import Path

from mckibben.report.explorers import Explorer, explorers
from mckibben.scenario import Scenario

EXAMPLES = Path(__file__).parents[1] / "examples"


def _knee(key: str) -> Explorer:
    return explorers(Scenario.read(EXAMPLES / "pre-contracted-step-pid.yaml"), [key])[key]


EXPLORERS = {
    "force_law": lambda: _knee("force"),
    "attainable_stiffness": lambda: _knee("attainable"),
    "position_control": lambda: _knee("run"),
}
"""Explorers by lab, in the order of the course."""
