"""Result of a tuning: the values, and their effect on each scenario."""

from __future__ import annotations

import functools
from collections.abc import Iterator
from dataclasses import field
from typing import Any

import numpy as np

from mckibben.result import Column, Listing, Remark, Result, column
from mckibben.scenario import Scenario, find_parameter
from mckibben.simulation.metrics import METRICS
from mckibben.study.parameters import Table
from mckibben.study.tune.margin import DISK_MARGIN, UNSTABLE, lost_margin, metrics_and_margins
from mckibben.study.tune.trials import Trial

_MARGIN_UNITS = {"gain": "", "phase_deg": "deg", "delay_ms": "ms", "disk": ""}


class TuneResult(Result):
    """Result of a tuning; its tables simulate each scenario before and after when they are first asked for."""

    figures = ("tuning",)

    values: dict[str, float]
    """Tuned values [SI] by name: six digits in the unit of files, unless that increases the cost."""
    before: tuple[Scenario, ...]
    scenarios: tuple[Scenario, ...]
    """With the tuned values."""
    cost: float = column("", "cost")
    cost_before: float = column("", "cost before")
    """Cost of the first scenario's values in all scenarios; NaN if they are not valid."""
    evaluated: int = column("", "points evaluated")
    disk_margin: float = column("", "least disk margin kept by the search", default=0.0)
    """In all runs at four points; 0 for none."""
    at_bound: tuple[str, ...] = ()
    """Parameters within 1 % of an end of their range: a wider one may have better values."""
    trials: tuple[Trial, ...] = ()
    """In the order of the search."""
    conditions: Table = field(default_factory=dict)

    def verdict(self) -> str:
        """Return the costs before and after."""
        before = "" if np.isnan(self.cost_before) else f"{self.cost_before:.4g} -> "
        count = f"{len(self.values)} parameter{'s' if len(self.values) != 1 else ''}"
        return f"cost {before}{self.cost:.4g}, {count}, {self.evaluated} points"

    @functools.cached_property
    def effects(self) -> list[tuple[dict[str, float], dict[str, float]]]:
        """Metrics and least margins of each scenario before and after, by name and in shown units."""
        pairs = zip(self.before, self.scenarios, strict=True)
        runs = [[metrics_and_margins(scenario) for scenario in pair] for pair in pairs]
        return [(old[0] | old[1], new[0] | new[1]) for old, new in runs]

    def remarks(self) -> Iterator[Remark]:
        """Yield remarks on the margins, the ranges, and what to try next."""
        for old, new in self.effects:
            if new["disk"] == 0:
                yield Remark.warning("disk_margin", UNSTABLE)
            elif lost := lost_margin(old["disk"], new["disk"]):
                yield Remark.warning("disk_margin", lost, remedy=f"--disk-margin {DISK_MARGIN} bounds it")
            elif not self.disk_margin and new["disk"] < DISK_MARGIN:
                text = f"the least disk margin is {new['disk']:.2g}"
                yield Remark.note("disk_margin", text, remedy=f"--disk-margin {DISK_MARGIN} asks for more")
        if np.isnan(self.cost_before):
            text = "no cost before: the values given do not keep the margins, or give no valid run"
            yield Remark.note("cost_before", text)
        if self.at_bound:
            text = f"at a bound of the range: {', '.join(self.at_bound)}"
            yield Remark.warning("at_bound", text, remedy="consider a wider range")
        for text in dict.fromkeys(text for scenario in self.before for text in scenario.joint.remarks):
            yield Remark.note("joint", text)

    def listings(self) -> Iterator[Listing]:
        """Yield the scalars, the parameters and the effect on each scenario."""
        yield from super().listings()
        parameters = [find_parameter(self.before[0], name) for name in self.values]
        nominal = ["-" if p.nominal is None else p.show(p.nominal) for p in parameters]
        tuned = [p.show(value) for p, value in zip(parameters, self.values.values(), strict=True)]
        yield _table("Parameters", parameter=list(self.values), before=nominal, tuned=tuned)
        for scenario, (old, new) in zip(self.before, self.effects, strict=True):
            units = {METRICS[name][0].replace("_", " "): METRICS[name][1] for name in METRICS}
            units |= {f"least {name.split('_')[0]} margin": unit for name, unit in _MARGIN_UNITS.items()}
            title = f"{scenario.name}{', without the conditions' if self.conditions else ''}"
            rows = {"metric": list(units), "before": list(old.values()), "tuned": list(new.values())}
            yield _table(title, **rows, unit=list(units.values()))


def _table(title: str, **columns: Any) -> Listing:
    """Return a table of columns by their headings, in shown units."""
    return Listing(title, {name: (Column(title=name), values) for name, values in columns.items()})
