"""A sweep for people: rows of tables, and sentences."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from mckibben.simulation import Outcome
from mckibben.study.numbers import METRICS
from mckibben.study.parameters import addresses
from mckibben.study.scenario import Scenario

Row = tuple[str, ...]
_MOST_CORRELATIONS = 10
_WEAK = 0.05


def listed(scenario: Scenario) -> list[dict[str, Any]]:
    """All that can be varied: name, nominal value as text, what it may be, and the unit it is written in."""
    return [
        {
            "name": each.name,
            "nominal": None if each.nominal is None else each.show(each.nominal),
            "range": each.range,
            "unit": each.shown,
            "nominal_SI": each.nominal,
            "unit_SI": each.unit,
        }
        for each in addresses(scenario)
    ]


def outcome_rows(numbers: Mapping[str, Any]) -> list[Row]:
    """Count, share and meaning of each outcome."""
    runs = numbers["runs"]
    return [
        (str(count), f"{count / runs:.1%}", Outcome[name.upper()].value) for name, count in numbers["outcomes"].items()
    ]


def metric_rows(numbers: Mapping[str, Any]) -> list[Row]:
    """Name, unit, and what the runs that are not lost have of each metric; a metric that no run has is left out."""
    rows = []
    of_use = numbers["runs"] - numbers["lost"]
    for name, spread in numbers["metrics"].items():
        metric, unit, _ = METRICS[name]
        if not spread["runs"]:
            continue
        values = [f"{spread[key]:.4g}" for key in ("median", "percentile_5", "percentile_95", "worst")]
        none = of_use - spread["runs"]
        never = f"{none} never" if metric == "stiffness_settling" and none else f"{none} without" if none else ""
        rows.append((metric.replace("_", " "), unit, *values, str(spread["worst_run"]), never))
    return rows


def correlation_rows(numbers: Mapping[str, Any]) -> list[Row]:
    """Input, metric and rank correlation, the strongest few."""
    return [
        (each["input"], _words(each["with"]), f"{each['spearman']:+.2f}")
        for each in numbers["correlations"][:_MOST_CORRELATIONS]
        if abs(each["spearman"]) >= _WEAK
    ]


def reach_sentence(numbers: Mapping[str, Any]) -> str:
    """What the joint cannot hold, in words."""
    reach, runs = numbers["reach"], numbers["runs"]
    parts = []
    if count := reach["runs_stiffness_out_of_reach"]:
        parts.append(
            f"{count} of {runs} runs ask at times for a stiffness that the joint cannot hold, by up to "
            f"{reach['shortfall_max']:.3g} N*m/rad (run {reach['shortfall_max_run']})"
        )
    if count := reach["runs_angle_unheld"]:
        parts.append(f"{count} of {runs} runs ask at times for an angle that no pressures within limits hold")
    return "; ".join(parts) if parts else "all references are within static reach throughout"


def _words(name: str) -> str:
    return METRICS[name][0].replace("_", " ") if name in METRICS else "being lost"
