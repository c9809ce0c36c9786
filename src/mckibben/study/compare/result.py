"""Result of a comparison."""

from __future__ import annotations

import functools
import json
from collections.abc import Iterator, Sequence
from dataclasses import field, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from mckibben.dataset.schema import write_netcdf
from mckibben.result import Column, Listing, Remark, Result, Severity, TableColumns, table
from mckibben.scenario import StudiedScenario, find_parameters
from mckibben.simulation import LEAST_DISK_MARGIN, Batch, Margins, margin_remarks
from mckibben.storage.files import make_folder
from mckibben.study.compare.changes import Changed
from mckibben.study.compare.checks import filename
from mckibben.study.compare.runs import Runs, started
from mckibben.study.compare.statistics import Ratio, comparable, median, ratio_of_medians
from mckibben.study.compare.suite import ControllerSuite
from mckibben.study.tune.cost import mean_of_joints
from mckibben.study.tune.objective import FAILED_COST
from mckibben.study.tune.search import Vector
from mckibben.study.tune.trials import Trial
from mckibben.units import JointType, litre

if TYPE_CHECKING:
    import xarray as xr


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
    changed: dict[str, Changed] = field(default_factory=dict)  # as tuned, on plants that differ in one respect
    calibrated: dict[str, Batch] = field(default_factory=dict)  # with models calibrated on the plants of the runs
    calibrated_runs: NDArray[np.bool_] = field(default_factory=lambda: np.zeros(0, bool))  # whether each first run was

    @property
    def joint_type(self) -> JointType:
        return self.suite.joint_type

    @functools.cached_property
    def order(self) -> list[str]:
        """Controllers by their median cost, the best first; those that must not be used are last."""
        return sorted(self.batches, key=lambda name: (not self.usable(name), float(np.median(self.cost(name)))))

    def usable(self, controller: str) -> bool:
        """Whether the loop as tuned has the disk margin of tuned gains, on the plant of the models."""
        margins = self.margins.get(controller)
        return margins is not None and float(margins.disk.min()) >= LEAST_DISK_MARGIN

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
        """Mask of the runs in a limit cycle of the angle, or whose commands wear the valves."""
        return self.batches[controller].oscillates[self.started]

    def cost(self, controller: str) -> Vector:
        """Cost of each run that started; 1e6 where the run diverged."""
        cost = self.suite.cost({name: self.metric(controller, name) for name in self.suite.cost.metrics})
        return np.where(np.isfinite(cost), cost, FAILED_COST)

    def training_air(self, controller: str) -> float:
        """Median air [m^3] of a tuned controller in the training runs; NaN if unknown."""
        trials = self.trials.get(controller, ())
        best = min(self.finalists.get(controller) or trials, key=lambda trial: trial.order, default=None)
        metrics = (trial.metrics for trial in trials if best and trial.point == best.point)
        return (next(metrics, None) or {}).get("air", np.nan)

    def scenario(self, controller: str, run: int) -> StudiedScenario:
        """Scenario of one run with the tuned controller."""
        return self.runs.scenario(controller, run, self.tuned[controller])

    def verdict(self) -> str:
        """Return the controller of the least median cost, and its angle error against that of the first."""
        best, first, error = self.order[0], next(iter(self.batches)), self.joint_type.words("angle RMSE")
        runs = f"{len(self.batches)} controllers on {self.runs.count} runs"
        if not self.usable(best):
            return f"{runs}: none has a disk margin of {LEAST_DISK_MARGIN:g}, so that none is to be used"
        if best == first:
            others = "".join(f"; {name} has {self._ratio(name):.3g} x its {error}" for name in self.order[1:2])
            return f"{runs}: {best} is best{others}"
        return f"{runs}: {best} is best, with {self._ratio(best):.3g} x the {error} of {first}"

    def _ratio(self, controller: str) -> float:
        return ratio_of_errors([self], controller, [self]).ratio

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
        if count := int((~self.calibrated_runs).sum()):
            text = f"{count} of {self.calibrated_runs.size} plants could not be calibrated, and are left out there"
            yield Remark.note("calibration", text, "give another weight or angle")
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

    @functools.cached_property
    def _errors(self) -> TableColumns:
        return error_columns([self], [self], self.order)

    def declared(self) -> TableColumns:
        """Return the errors on the unseen runs as tuned, a row per controller."""
        return super().declared() | self._errors

    @table()
    def at_equal_air(self) -> Iterator[Listing]:
        """Yield the errors with no more air than the first controller, as tuned, takes."""
        if self.at_air:
            first = next(iter(self.batches))
            air = f"{self.training_air(first) / litre:.4g} L in the training runs"
            yield Listing(f"With no more air than the tuned {first} ({air})", self.at_air.errors_against(self))

    @table("True errors before and after a calibration of the models on the plants")
    def after_calibration(self) -> TableColumns:
        """Return the true errors of the stiffness in the first runs, before and after a calibration of the models."""
        return calibrated_columns([self], self.order)

    def errors_against(self, tuned: CompareResult) -> TableColumns:
        """Return the errors, against those of the first controller as tuned in another result."""
        return error_columns([self], [tuned], list(self.batches))

    @table()
    def breaks(self) -> Iterator[Listing]:
        """Yield the errors on changed plants, the disk margins that are too small, and how runs fail."""
        kind, changes = self.joint_type, next((changed.changes for changed in self.changed.values()), ())
        names = [name for name in self.order if name in self.changed and changes]
        cells = {name: (Column(), self.changed[name].cells(kind.size("deg"))) for name in names}
        title = f"What breaks: {kind.label('angle RMSE', 'deg')} on the plant of the models with one change"
        yield from [Listing(title, {"change": (Column(), list(changes)), **cells})] if changes else []

    @table("Tuned on the training runs", detail=True)
    def tuned_values(self) -> TableColumns:
        """Return the cost of each controller on the training runs, and its tuned values."""
        costs = [self.training_cost.get(name, (np.nan, np.nan)) for name in self.tuned]
        scenarios = {name: self.suite.tuned_scenario(name, {}) for name in self.tuned}
        texts = [
            "; ".join(f"{p.name} {p.show(values[p.name])}" for p in find_parameters(scenarios[name], values))
            for name, values in self.tuned.items()
        ]
        return {
            "controller": (Column(), [*self.tuned]),
            "cost_before": (Column(), [before for _, before in costs]),
            "cost_tuned": (Column(), [after for after, _ in costs]),
            "parameters": (Column(), [text or "not tuned" for text in texts]),
        }

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

    @property
    def joint_type(self) -> JointType:
        return next(iter(self.results.values())).joint_type

    def verdict(self) -> str:
        """Return the controller of the least angle error over all setups, of those that may be used."""
        results = list(self.results.values())
        first, usable = next(iter(results[0].batches)), [n for n in results[0].batches if self.usable(n)]
        ratios = {name: ratio_of_errors(results, name, results).ratio for name in usable}
        best = min(ratios, key=lambda name: ratios[name], default="")
        least = f"has a disk margin of {LEAST_DISK_MARGIN:g} in every setup"
        error = self.joint_type.words("angle RMSE")
        text = f"{best} has {ratios[best]:.3g} x the {error} of {first}" if best else f"no controller {least}"
        return f"{self.suite}, {len(results)} setups: {text}"

    def usable(self, controller: str) -> bool:
        """Whether the loops as tuned have the disk margin of tuned gains in every setup."""
        return all(result.usable(controller) for result in self.results.values())

    def remarks(self) -> Iterator[Remark]:
        """Yield a remark on controllers whose loops must not be used, severe if there are no others."""
        small = [name for name in next(iter(self.results.values())).batches if not self.usable(name)]
        if small:
            text = f"not to be used, with a disk margin below {LEAST_DISK_MARGIN:g} in a setup: {', '.join(small)}"
            none = len(small) == len(next(iter(self.results.values())).batches)
            yield (Remark.severe if none else Remark.warning)("disk_margin", text)

    def declared(self) -> TableColumns:
        """Return the errors over all setups as tuned, a row per controller."""
        results = list(self.results.values())
        return super().declared() | error_columns(results, results, list(results[0].batches))

    @table("All setups, with no more air than the first")
    def at_equal_air(self) -> TableColumns:
        """Return the errors over all setups with no more air than the first controller."""
        results, at_air = list(self.results.values()), [r.at_air for r in self.results.values() if r.at_air]
        return error_columns(at_air, results, list(results[0].batches)) if len(at_air) == len(results) else {}

    @table("All setups: true errors before and after a calibration of the models on the plants")
    def after_calibration(self) -> TableColumns:
        """Return the true errors of the stiffness, as for one setup."""
        results = list(self.results.values())
        return calibrated_columns(results, list(results[0].batches))

    @table()
    def setups(self) -> Iterator[Listing]:
        """Yield the tables of each setup."""
        for name, result in self.results.items():
            for listing in result.listings():
                yield replace(listing, title=f"{name}: {listing.title or 'unseen runs'}", detail=True)


def calibrated_columns(results: Sequence[CompareResult], names: Sequence[str]) -> TableColumns:
    """Return columns over the runs of all results whose models were calibrated; none without any.

    Errors of the stiffness as medians and 95th percentiles, and medians of the angle error; runs that failed count in
    neither.
    """
    if not all(result.calibrated_runs.any() for result in results):
        return {}

    def values(name: str, metric: str, *, calibrated: bool) -> Vector:
        columns = []
        for result in results:
            batch, rows = result.batches[name], np.flatnonzero(result.calibrated_runs)
            batch, rows = (result.calibrated[name], np.arange(rows.size)) if calibrated else (batch, rows)
            columns.append(np.where(batch.usable, mean_of_joints(batch.metrics[metric]), np.nan)[rows])
        return np.concatenate(columns)

    count = sum(int(result.calibrated_runs.sum()) for result in results)
    columns: TableColumns = {"controller": (Column(), list(names)), "runs": (Column(), [count] * len(names))}
    for key, unit, shown in (("stiffness", "N*m/rad", ""), ("angle", "rad", "deg")):
        for when, calibrated in (("before", False), ("after", True)):
            spread = np.array([_spread(values(name, f"{key}_rmse", calibrated=calibrated)) for name in names])
            columns[f"{key}_{when}"] = Column(unit, f"{key} RMSE, {when}", shown, digits=3), spread[:, 0]
            columns[f"{key}_{when}_95"] = Column(unit, f"{key}, {when}, 95 %", shown, digits=3), spread[:, 1]
    return columns


def _spread(values: Vector) -> Vector:
    """Median and 95th percentile over the runs that did not fail."""
    finite = values[np.isfinite(values)]
    return np.percentile(finite, [50, 95]) if finite.size else np.full(2, np.nan)


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


def error_columns(
    results: Sequence[CompareResult], tuned: Sequence[CompareResult], names: Sequence[str]
) -> TableColumns:
    """Return columns over the runs of all results: errors, ratios to the first controller as tuned, air, failed runs.

    Parameters
    ----------
    results
        Results whose runs are pooled; a controller that one of them lacks is left out.
    tuned
        Results on the same runs that have the first controller as tuned.
    names
        Controllers, in the order of the rows.
    """
    names, first = [name for name in names if all(name in r.batches for r in results)], next(iter(tuned[0].batches))

    angle, stiffness, air = (
        np.reshape([_spread(errors_in(results, name, metric)) for name in names], (-1, 2)).T
        for metric in ("angle_rmse", "stiffness_rmse", "air")
    )
    ratio, low, high = np.reshape([ratio_of_errors(results, n, tuned, resamples=2000) for n in names], (-1, 3)).T
    limit_cycles = [sum(int(result.oscillates(name).sum()) for result in results) for name in names]
    degrees, newtons, times = (partial(Column, unit, digits=3) for unit in ("rad", "N*m/rad", "1"))
    return {
        "controller": (Column(), names),
        "angle_rmse": (degrees("angle RMSE", "deg"), angle[0]),
        "angle_rmse_95": (degrees("angle RMSE, 95 %", "deg"), angle[1]),
        "ratio": (times(f"x {first}"), ratio),
        "ratio_low": (times("2.5 %"), low),
        "ratio_high": (times("97.5 %"), high),
        "stiffness_rmse": (newtons("stiffness RMSE"), stiffness[0]),
        "stiffness_rmse_95": (newtons("stiffness RMSE, 95 %"), stiffness[1]),
        "air": (Column("m^3", "air", "L", digits=3), air[0]),
        "diverged": (Column(), [sum(int(r.diverged(name).sum()) for r in results) for name in names]),
        "oscillating": (Column("", "limit cycles"), limit_cycles),
    }
