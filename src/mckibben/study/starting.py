"""The rest from which a scenario starts."""

from __future__ import annotations

import math

from mckibben.simulation import AtRest
from mckibben.study.scenario import Scenario


def rest(scenario: Scenario) -> AtRest:
    """The rest to start from; its numbers may be arrays with one value a run.

    >>> rest(Scenario.read("examples/pre-contracted-step-pid.yaml"))
    AtRest(angle=0.0, stiffness=12.0)
    """
    stiffness = scenario.start.stiffness
    return AtRest(scenario.start.angle, math.nan if stiffness is None else stiffness)
