"""Errors of a controller against those of commands optimised off line for the true plant."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from mckibben.control import OpenLoopControl, Samples
from mckibben.scenario import Scenario, run_scenario
from mckibben.simulation import OptimalCommands, Result, optimal_commands, simulate


@dataclass(frozen=True)
class OracleResult:
    """A run of a controller, and the same run with optimal commands, those of least cost of two starts."""

    controlled: Result
    optimal: Result
    starts: tuple[OptimalCommands, OptimalCommands]  # from the controller's commands, and from constant ones

    @property
    def ratio(self) -> float:
        """Angle RMSE of the controller over that of the optimal commands."""
        return self.controlled.metrics["angle_rmse"] / self.optimal.metrics["angle_rmse"]


def oracle(scenario: Scenario, **options: Any) -> OracleResult:
    """Simulate a scenario, and optimise its commands for its plant off line with options of `optimal_commands`.

    Raises `ScenarioError` if its parts do not fit together or it cannot start, `SimulationError` if a run diverges.
    """
    controlled = run_scenario(scenario).result
    plant, reference = scenario.plant(), scenario.reference()
    initial = scenario.initial(plant)
    substeps = controlled.resolution.substeps if controlled.resolution else scenario.needed_substeps()
    settings: Any = {"duration": scenario.duration, "control_period": scenario.control_period, "substeps": substeps}
    commands = np.stack([controlled["command1"], controlled["command2"]], axis=1)
    first, second = (
        optimal_commands(plant, reference, initial, begun, **settings, **options)
        for begun in (commands, np.broadcast_to(commands[0], commands.shape))
    )
    best = min(first, second, key=lambda found: found.cost)
    pressure1, pressure2 = (Samples(controlled.times, column) for column in best.commands.T)
    control = OpenLoopControl(pressure1, pressure2, scenario.joint)
    optimal = simulate(plant, control, reference, initial=initial, **settings)
    return OracleResult(controlled, optimal, (first, second))
