"""Run a scenario."""

from __future__ import annotations

from mckibben.simulation import CheckedRun, checked_run
from mckibben.study.scenario import Scenario


def run_scenario(scenario: Scenario) -> CheckedRun:
    """Simulate a scenario.

    Returns
    -------
    CheckedRun
        The result, which carries the scenario's text, and the reach of its reference.
    """
    plant = scenario.plant()
    return checked_run(
        plant,
        scenario.control(),
        scenario.reference(),
        duration=scenario.duration,
        control_period=scenario.control_period,
        substeps=scenario.substeps,
        initial=scenario.initial(plant),
        scenario=scenario.dumps(),
    )
