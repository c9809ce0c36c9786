"""Least stability margins of a scenario's linearised loop, with the metrics of its run."""

from __future__ import annotations

import numpy as np

from mckibben.errors import McKibbenError
from mckibben.scenario import Scenario, run_scenario
from mckibben.simulation.metrics import METRICS, in_shown_units

DISK_MARGIN = 0.4
"""Disk margin below which a loss is reported: gains off by 1.5, phases by 23 deg."""


def lost_margin(before: float, after: float) -> str:
    """Note on a least disk margin that tuning reduced below `DISK_MARGIN`; empty without such a loss."""
    lost = after < min(before, DISK_MARGIN)
    return f"tuning reduced the least disk margin from {before:.2g} to {after:.2g}" if lost else ""


UNSTABLE = (
    "least margins of 0: the linearised loop is unstable at some points of the run; `mckibben margins` shows where, "
    "and whether sticking friction bounds the oscillation"
)
"""Note on tuned gains without a disk margin."""


def metrics_and_margins(scenario: Scenario) -> tuple[dict[str, float], dict[str, float]]:
    """Metrics of a run and its least stability margins, by name and in shown units; NaN if it cannot be run."""
    margins: dict[str, float] = dict.fromkeys(("gain", "phase_deg", "delay_ms", "disk"), np.nan)
    try:
        metrics = in_shown_units(run_scenario(scenario).metrics)
        margins = scenario.margins().least()
    except McKibbenError:
        return dict.fromkeys(METRICS, np.nan), margins
    return metrics, margins
