"""Plants that differ from the nominal one in one respect, and what becomes of a tuned controller on them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mckibben.scenario import ModelFollows, ScenarioParameter, StudiedScenario, batched, list_parameters
from mckibben.simulation import LEAST_DISK_MARGIN, Batch, Outcome
from mckibben.simulation.outcome import OUTCOMES
from mckibben.study.parameters import Table
from mckibben.study.tune.cost import mean_of_joints

_QUANTITIES: Mapping[str, Callable[[ScenarioParameter], bool]] = {
    "payload": lambda p: p.part in ("load", "robot") and p.unit == "kg",
    "strength": lambda p: p.part in ("joint", "robot") and p.name.endswith(".strength"),
    "delay": lambda p: p.name == "command_delay",
    "friction": lambda p: p.part != "controller" and p.name.endswith(("friction.half_width", "friction.torque")),
    "supply": lambda p: p.name == "valve.supply",
}


class Changed(NamedTuple):
    """Runs of a controller on changed plants that its model does not follow, and the disk margins of its loop."""

    changes: tuple[str, ...]
    batch: Batch
    disk: NDArray[np.float64]

    def cells(self, unit: float) -> list[str]:
        """Return the angle RMSE in a unit [SI] with each change and a disk margin too small, or how the run fails."""
        errors = mean_of_joints(self.batch.metrics["angle_rmse"]) / unit
        rows = zip(self.batch["outcome"], errors.tolist(), self.disk.tolist(), strict=True)
        return [_cell(OUTCOMES[code], error, disk) for code, error, disk in rows]


def _cell(outcome: Outcome, error: float, disk: float) -> str:
    if not outcome.usable:
        return outcome.name.replace("_", " ").lower()
    return f"{error:.2g}" if disk >= LEAST_DISK_MARGIN else f"{error:.2g} (disk {max(disk, 0.0):.2g})"


def changed_values(scenario: StudiedScenario) -> dict[str, dict[str, float]]:
    """Return the values [SI] of the plant's parameters under each change, of those that the plant has.

    >>> from mckibben.scenario import Scenario
    >>> changed_values(Scenario.read("examples/pre-contracted-step-pid.yaml"))["payload +50 %"]
    {'load.mass1': 0.75, 'load.mass2': 0.75}
    """
    factors = {
        "nominal": ("payload", 1.0),
        "payload +50 %": ("payload", 1.5),
        "payload -50 %": ("payload", 0.5),
        "strength +25 %": ("strength", 1.25),
        "strength -25 %": ("strength", 0.75),
        "delay x 1.5": ("delay", 1.5),
        "friction x 2": ("friction", 2.0),
        "supply x 0.5": ("supply", 0.5),
    }
    parameters = list_parameters(scenario)
    changes = {
        change: {p.name: factor * p.nominal for p in parameters if p.nominal and _QUANTITIES[quantity](p)}
        for change, (quantity, factor) in factors.items()
    }
    return {change: values for change, values in changes.items() if values}


def on_changed_plants(scenario: StudiedScenario, model_follows: ModelFollows = ()) -> Changed:
    """Return the runs of a scenario with each change of its plant."""
    changes = changed_values(scenario)
    nominal = {p.name: p.nominal for p in list_parameters(scenario)}
    names = sorted(set().union(*changes.values()))
    rows = [[values.get(name, nominal[name]) for name in names] for values in changes.values()]
    table: Table = dict(zip(names, np.array(rows, float).T, strict=True))
    many = batched(scenario, table, model_follows=model_follows)
    return Changed(tuple(changes), many.run_many(metrics=("angle_rmse",)), many.disk_margins(4))
