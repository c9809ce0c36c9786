"""Run a scenario."""

from __future__ import annotations

from mckibben.simulation import Result, simulate
from mckibben.study.scenario import Scenario


def run_scenario(scenario: Scenario) -> Result:
    """Simulate a scenario; the result carries its text.

    Warns
    -----
    ReachabilityWarning
        If the joint cannot hold all of the reference.
    """
    plant = scenario.plant()
    return simulate(
        plant,
        scenario.control(),
        scenario.reference(),
        duration=scenario.duration,
        control_period=scenario.control_period,
        substeps=scenario.substeps,
        initial=scenario.initial(plant),
        scenario=scenario.dumps(),
    )
