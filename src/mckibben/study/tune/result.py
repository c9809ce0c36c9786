"""Result of a tuning: the values, and their effect on each scenario."""

from __future__ import annotations

import functools
from collections.abc import Iterator
from dataclasses import field

import numpy as np
from jaxtyping import PyTree

from mckibben.errors import McKibbenError
from mckibben.result import Column, Listing, Remark, Result, TableColumns, column, table
from mckibben.scenario import StudiedScenario, find_parameter
from mckibben.simulation import margin_remarks
from mckibben.simulation.metrics import OF_STIFFNESS_SETPOINT, Metrics, metrics_of
from mckibben.study.parameters import Table
from mckibben.study.tune.trials import Trial

_MARGINS = {"least gain margin": "", "least phase margin": "deg", "least delay margin": "ms", "least disk margin": ""}


class TuneResult(Result):
    """Result of a tuning; its tables simulate each scenario before and after when they are first asked for.

    `trials` has every point of the search with its cost; `scenarios` can be written with their `to_yaml`.
    """

    figures = ("tuning",)

    values: dict[str, float]
    """Tuned values [SI] by name: six digits in the unit of files, unless that increases the cost."""
    before: tuple[StudiedScenario, ...]
    scenarios: tuple[PyTree, ...]
    """With the tuned values."""
    cost: float = column("", "cost")
    cost_before: float = column("", "cost before")
    """Cost of the first scenario's values in all scenarios; NaN if they are not valid."""
    evaluated: int = column("", "points evaluated")
    disk_margin: float = column("", "disk margin asked for", default=0.0)
    """0 for none."""
    least_disk: float = column("", "disk margin of the worst varied plant", default=np.nan)
    """Least under the conditions or the uncertainty of the plant, at twenty points of each run; NaN if none is asked
    for. That of the nominal plant is larger, and among the `effects`."""
    limit: str = ""
    """Operating point, loop and draw of the least disk margin."""
    change: str = ""
    """Change that would raise the least disk margin most, where it is below that asked for."""
    at_bound: tuple[str, ...] = ()
    """Parameters within 1 % of an end of their range: a wider one may have better values."""
    trials: tuple[Trial, ...] = ()
    """In the order of the search."""
    conditions: Table = field(default_factory=dict)

    @property
    def scenario(self) -> StudiedScenario:
        """The tuned scenario, the first of several."""
        return self.scenarios[0]

    @property
    def keeps_margin(self) -> bool:
        """Whether the values have the disk margin that was asked for."""
        return not self.least_disk < self.disk_margin

    def verdict(self) -> str:
        """Return the costs before and after, and what limits the disk margin."""
        if not self.keeps_margin:
            return f"not to be used: no gains with a disk margin of {self.disk_margin:g}, of {self.evaluated} points"
        before = "" if np.isnan(self.cost_before) else f"{self.cost_before:.4g} -> "
        count = f"{len(self.values)} parameter{'s' if len(self.values) != 1 else ''}"
        limit = f"; disk margin {self.least_disk:.3g} {self.limit}" if self.limit else ""
        return f"cost {before}{self.cost:.4g}, {count}, {self.evaluated} points{limit}"

    @functools.cached_property
    def effects(self) -> list[tuple[dict[str, float], dict[str, float]]]:
        """Metrics and least margins of each scenario before and after, by their titles and in shown units."""
        pairs = zip(self.before, self.scenarios, strict=True)
        return [(_metrics_and_margins(before), _metrics_and_margins(after)) for before, after in pairs]

    def remarks(self) -> Iterator[Remark]:
        """Yield remarks on the margins, the ranges, and what to try next."""
        if not self.keeps_margin:
            stable, radius = self.least_disk > 0, 1 - self.least_disk
            has = f"have {self.least_disk:.2g}" if stable else f"are unstable, with a spectral radius of {radius:.4g}"
            text = f"the gains of the largest disk margin {has}, {self.limit}; {self.change}"
            remedy = "a faster valve, less delay, a slower reference, less uncertainty by calibration, or --over others"
            yield Remark.severe("disk_margin", text, remedy)
        elif self.disk_margin:
            yield from margin_remarks(self.least_disk, f", {self.limit}")
        else:
            for scenario, (_, after) in zip(self.scenarios, self.effects, strict=True):
                yield from margin_remarks(after["least disk margin"], f", of {scenario.name}")
        if np.isnan(self.cost_before):
            text = "no cost before: the values given have no valid run"
            yield Remark.note("cost_before", text)
        if self.at_bound:
            text = f"at a bound of the range: {', '.join(self.at_bound)}"
            yield Remark.warning("at_bound", text, remedy="consider a wider range")
        yield from dict.fromkeys(remark for scenario in self.before for remark in scenario.model_remarks)

    @table("Parameters")
    def parameters(self) -> TableColumns:
        """Return the parameters before and after, as in a file."""
        parameters = [find_parameter(self.before[0], name) for name in self.values]
        nominal = ["-" if p.nominal is None else p.show(p.nominal) for p in parameters]
        tuned = [p.show(value) for p, value in zip(parameters, self.values.values(), strict=True)]
        return {"parameter": (Column(), [*self.values]), "before": (Column(), nominal), "tuned": (Column(), tuned)}

    @table()
    def effect(self) -> Iterator[Listing]:
        """Yield the effect on each scenario."""
        for scenario, (old, new) in zip(self.before, self.effects, strict=True):
            title = f"{scenario.name}{', nominal plant' if self.conditions or self.limit else ''}"
            units = {name: unit for name, (*_, unit) in _metric_rows(scenario).items()} | _MARGINS
            rows = [(name, old[name], new[name], unit) for name, unit in units.items()]
            yield Listing.of(title, ("metric", "before", "tuned", "unit"), rows)


def _metrics_and_margins(scenario: StudiedScenario) -> dict[str, float]:
    """Metrics of a run and its least stability margins, by title and in shown units; NaN if it cannot be run."""
    rows = _metric_rows(scenario)
    try:
        metrics, margins = scenario.run_once().metrics, scenario.margins().least()
    except McKibbenError:
        return dict.fromkeys((*rows, *_MARGINS), np.nan)
    values = {title: float(np.atleast_1d(metrics[name])[i]) / size for title, (name, i, size, _) in rows.items()}
    return values | dict(zip(_MARGINS, margins.values(), strict=True))


def _metric_rows(scenario: StudiedScenario) -> dict[str, tuple[str, int, float, str]]:
    """Metrics of a scenario by title: name, number of the joint, shown unit as a number and as text."""
    rows = {}
    left_out = () if scenario.follows_stiffness else OF_STIFFNESS_SETPOINT
    metrics = {name: label for name, label in metrics_of(Metrics).items() if name not in left_out}
    for name, label in metrics.items():
        label = label.for_joint(scenario.joint_type)
        title = scenario.joint_type.words(name.replace("_", " "))
        for number, of in enumerate(scenario.plant().mechanism.names_along(label.along) or ("",)):
            rows[f"{title}, {of}" if of else title] = name, number, label.size, label.shown_unit
    return rows
