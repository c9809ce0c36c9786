"""Result of a comparison."""

from __future__ import annotations

import functools
import json
from collections.abc import Iterator, Sequence
from dataclasses import field, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from mckibben.dataset.schema import write_netcdf
from mckibben.result import Listing, Remark, Result, Severity
from mckibben.scenario import StudiedScenario, find_parameters
from mckibben.simulation import Batch, Margins, margin_remarks
from mckibben.simulation.metrics import METRICS
from mckibben.storage.files import make_folder
from mckibben.study.compare.checks import filename
from mckibben.study.compare.runs import Runs, started
from mckibben.study.compare.statistics import Ratio, comparable, median, ratio_of_medians
from mckibben.study.compare.suite import ControllerSuite
from mckibben.study.tune.cost import mean_of_joints
from mckibben.study.tune.objective import FAILED_COST
from mckibben.study.tune.search import Vector
from mckibben.study.tune.trials import Trial
from mckibben.units import litre

if TYPE_CHECKING:
    import xarray as xr

_UNIT = {metric: size for metric, _, size in METRICS.values()}


class CompareResult(Result):
    """Result of a comparison, by controller.

    `at_air` is the evaluation at equal air: for each controller, the trial of lowest angle error on its Pareto front
    with no more air than the tuned first controller, by medians of the training runs; None if the first is not tuned.
    """

    figures = ("comparison_errors", "comparison_front")
    files = ("runs.nc", "suite.yaml", "controllers")

    suite: ControllerSuite
    runs: Runs  # of the evaluation
    tuned: dict[str, dict[str, float]]  # values [SI] by name; empty for an untuned controller
    training_cost: dict[str, tuple[float, float]]  # on the training runs, after and before tuning
    at_bound: dict[str, tuple[str, ...]]  # parameters at an end of their range
    batches: dict[str, Batch]  # results in the evaluation runs
    trials: dict[str, tuple[Trial, ...]] = field(default_factory=dict)  # with medians of the training runs
    at_air: CompareResult | None = None
    finalists: dict[str, tuple[Trial, ...]] = field(default_factory=dict)  # with the medians of their further runs
    margins: dict[str, Margins] = field(default_factory=dict)  # as tuned, on the plant of the models

    @functools.cached_property
    def order(self) -> list[str]:
        """Controllers by their median cost, the best first."""
        return sorted(self.batches, key=lambda name: float(np.median(self.cost(name))))

    @property
    def started(self) -> NDArray[np.bool_]:
        """Mask of the runs that could start, independent of the controller. Shape (runs,)."""
        return started(next(iter(self.batches.values())))

    def metric(self, controller: str, name: str) -> Vector:
        """A metric [SI] of each run that started, shape (started runs,); NaN for a divergence or a limit cycle."""
        batch = self.batches[controller]
        return np.where(batch.usable, mean_of_joints(batch.metrics[name]), np.nan)[self.started]

    def diverged(self, controller: str) -> NDArray[np.bool_]:
        """Mask of the runs that started and diverged."""
        return self.batches[controller].failed[self.started]

    def oscillates(self, controller: str) -> NDArray[np.bool_]:
        """Mask of the runs in a limit cycle of the angle, of the stiffness or of a command."""
        return self.batches[controller].oscillates[self.started]

    def cost(self, controller: str) -> Vector:
        """Cost of each run that started; 1e6 where the run diverged."""
        cost = self.suite.cost({name: self.metric(controller, name) for name in self.suite.cost.metrics})
        return np.where(np.isfinite(cost), cost, FAILED_COST)

    def training_air(self, controller: str) -> float:
        """Median air [m^3] of a tuned controller in the training runs; NaN if unknown."""
        trials = self.trials.get(controller, ())
        best = min(self.finalists.get(controller) or trials, key=lambda trial: trial.order, default=None)
        known = (trial.metrics for trial in trials if best and trial.point == best.point)
        return (next(known, None) or {}).get("air", np.nan)

    def scenario(self, controller: str, run: int) -> StudiedScenario:
        """Scenario of one run with the tuned controller."""
        return self.runs.scenario(controller, run, self.tuned[controller])

    def verdict(self) -> str:
        """Return the controller of the least median cost, and its angle error against that of the first."""
        best, first = self.order[0], next(iter(self.batches))
        ratio = ratio_of_errors([self], best, [self]).ratio
        runs = f"{len(self.batches)} controllers on {self.runs.count} runs"
        return f"{runs}: {best} is best, with {ratio:.3g} x the angle RMSE of {first}"

    def remarks(self) -> Iterator[Remark]:
        """Yield remarks on margins, severe for the best controller, missing starts, narrow ranges, and too much air."""
        for name, margins in self.margins.items():
            for remark in margin_remarks(float(margins.disk.min()), f", of {name} {margins.limit()}"):
                yield remark if name == self.order[0] else replace(remark, severity=Severity.WARNING)
        if len(self.batches) == 1:
            text = (
                "one controller is compared with itself alone: PID and decoupling need a pair of muscles at each joint"
            )
            yield Remark.warning("controllers", text, remedy="give others in `controllers` of the suite")
        if count := int((~self.started).sum()):
            yield Remark.warning("runs", f"{count} runs were infeasible: no static equilibrium at their start")
        if self.at_air and (left_out := [n for n, gains in self.tuned.items() if gains and n not in self.at_air.tuned]):
            first = next(iter(self.batches))
            limit = f"{self.training_air(first) / litre:.4g} L of air, the median of {first} in the training runs"
            least = (min((median(t, "air") for t in comparable(self.trials[n])), default=np.nan) for n in left_out)
            names = (f"{n} (at least {air / litre:.4g} L)" for n, air in zip(left_out, least, strict=True))
            yield Remark.warning("at_air", f"no gains were found that take at most {limit}: {', '.join(names)}")
        for name, parameters in self.at_bound.items():
            if parameters:
                text = f"{name}: at a bound of the range: {', '.join(parameters)}"
                yield Remark.warning("at_bound", text, remedy="consider a wider range")

    def listings(self) -> Iterator[Listing]:
        """Yield errors on the unseen runs, as tuned and with no more air than the first controller; tuned values."""
        yield from self._tables
        rows = []
        for name, values in self.tuned.items():
            after, before = self.training_cost.get(name, (np.nan, np.nan))
            parameters = find_parameters(self.suite.tuned_scenario(name, {}), values)
            tuned = "; ".join(f"{p.name} {p.show(values[p.name])}" for p in parameters)
            rows.append((name, before, after, tuned or "not tuned"))
        titles = ("controller", "cost before", "cost tuned", "parameters")
        yield replace(Listing.of("Tuned on the training runs", titles, rows), detail=True)

    @functools.cached_property
    def _tables(self) -> list[Listing]:
        title = f"{self.suite.name}: {int(self.started.sum())} unseen runs"
        tables, first = [error_table(title, [self], [self], self.order)], next(iter(self.batches))
        if self.at_air:
            air = f"{self.training_air(first) / litre:.4g} L in the training runs"
            title = f"With no more air than the tuned {first} ({air})"
            tables.append(error_table(title, [self.at_air], [self], list(self.at_air.batches)))
        return tables

    def to_dataset(self) -> xr.Dataset:
        """Return metrics and outcomes along ``controller`` and ``run``, and along ``run`` what varies."""
        import xarray as xr

        tables = [batch.table for batch in self.batches.values()]
        whole = xr.concat(tables, xr.Variable("controller", list(self.batches)), combine_attrs="override")
        varied = {name: ("run", column) for name, column in self.runs.table().items()}
        return whole.assign(varied).assign_attrs(title=self.suite.name, tuned=json.dumps(self.tuned))

    def write(self, folder: Path) -> None:
        """Write runs.nc, suite.yaml, and each tuned controller as a scenario with the plant of its model."""
        write_netcdf(self.to_dataset().assign_attrs(suite=self.suite.dumps(folder=folder)), folder / "runs.nc")
        self.suite.to_yaml(folder / "suite.yaml")
        controllers = make_folder(folder / "controllers")
        at_air = self.at_air.tuned if self.at_air else {}
        for suffix, tuned in (("", self.tuned), (", at equal air", at_air)):
            for name, values in tuned.items():
                self.suite.tuned_scenario(name, values).to_yaml(controllers / f"{filename(name + suffix)}.yaml")


class PooledResult(Result):
    """Errors over the runs of all setups together, as tuned and with no more air than the first controller."""

    suite: str
    results: dict[str, CompareResult]

    def verdict(self) -> str:
        """Return the controller of the least angle error over all setups."""
        results = list(self.results.values())
        ratios = {name: ratio_of_errors(results, name, results).ratio for name in results[0].batches}
        best = min(ratios, key=lambda name: ratios[name])
        text = f"{best} has {ratios[best]:.3g} x the angle RMSE of {next(iter(ratios))}"
        return f"{self.suite}, {len(results)} setups: {text}"

    def listings(self) -> Iterator[Listing]:
        """Yield the errors over all setups, then those of each setup as details."""
        results = list(self.results.values())
        names, at_air = list(results[0].batches), [result.at_air for result in results if result.at_air]
        yield error_table("All setups, as tuned", results, results, names)
        if len(at_air) == len(results):
            yield error_table("All setups, with no more air than the first", at_air, results, names)
        for result in results:
            yield from (replace(listing, detail=True) for listing in result.listings())


def errors_in(results: Sequence[CompareResult], name: str, metric: str) -> Vector:
    """Return a metric [SI] of a controller in the runs of several results; NaN for failed runs."""
    return np.concatenate([result.metric(name, metric) for result in results])


def ratio_of_errors(
    results: Sequence[CompareResult], name: str, tuned: Sequence[CompareResult], resamples: int = 0
) -> Ratio:
    """Return the ratio of a controller's median angle error to that of the first one as tuned in other results."""
    first = next(iter(tuned[0].batches))
    errors = errors_in(results, name, "angle_rmse"), errors_in(tuned, first, "angle_rmse")
    return ratio_of_medians(*errors, resamples)


def error_table(
    title: str, results: Sequence[CompareResult], tuned: Sequence[CompareResult], names: Sequence[str]
) -> Listing:
    """Return a table over the runs of all results: errors, ratios to the first controller as tuned, air, failed runs.

    Parameters
    ----------
    title
        Heading.
    results
        Results whose runs are pooled; a controller that one of them lacks is left out.
    tuned
        Results on the same runs that have the first controller as tuned.
    names
        Controllers, in the order of the rows.
    """

    def spread(name: str, metric: str) -> tuple[float | None, float | None]:
        """Median and 95th percentile over the runs that did not fail."""
        values = errors_in(results, name, metric) / _UNIT[metric]
        finite = values[np.isfinite(values)]
        return tuple(np.percentile(finite, [50, 95]).tolist()) if finite.size else (None, None)

    rows = []
    for name in names:
        if all(name in result.batches for result in results):
            ratio, low, high = ratio_of_errors(results, name, tuned, resamples=2000)
            failed = (
                sum(int(mask.sum()) for mask in masks)
                for masks in ([r.diverged(name) for r in results], [r.oscillates(name) for r in results])
            )
            errors = *spread(name, "angle_rmse"), ratio, f"{low:.3g}..{high:.3g}", *spread(name, "stiffness_rmse")
            rows.append((name, *errors, spread(name, "air")[0], " + ".join(map(str, failed))))
    first = next(iter(tuned[0].batches))
    titles = ("controller", "angle rmse, deg", "angle, 95 %", f"x {first}", "95 % interval")
    titles = (*titles, "stiffness rmse", "stiffness, 95 %", "air, L", "diverged + limit cycles")
    return Listing.of(title, titles, rows, digits=3)
