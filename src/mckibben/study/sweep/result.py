"""Results of a sweep."""

from __future__ import annotations

import functools
import json
from collections.abc import Iterator, Mapping
from dataclasses import field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from numpy.typing import NDArray

from mckibben.component.columns import attributes
from mckibben.dataset.schema import write_netcdf
from mckibben.errors import ParameterError
from mckibben.result import Column, Listing, Remark, TableColumns, table
from mckibben.scenario import ModelFollows, StudiedScenario, with_values
from mckibben.simulation.accuracy import STEP_COLUMNS, StepCounts, integration_sentence
from mckibben.simulation.batch import RunTable, outcome_variable
from mckibben.simulation.metrics import Metric, Metrics, metrics_of
from mckibben.simulation.outcome import OUTCOMES
from mckibben.study.parameters import SweptParameter
from mckibben.study.study import Table
from mckibben.units import JointType

if TYPE_CHECKING:
    import pandas as pd

MAIN = ("angle_rmse", "stiffness_rmse", "coupling")
"""Metrics used in correlations and figures, if they were computed."""

_MOST = 6  # metrics in correlations and figures


class SweepResult(RunTable):
    """Results of a sweep; `computed` runs come from this call, the others were kept before.

    The table has along ``run``, all in SI: the inputs by their names in the scenario (attribute ``shown_units``: their
    unit in files), the metrics, ``outcome`` (a code; ``flag_meanings`` lists the words), and ``substeps``,
    ``error_estimate`` and ``chaotic`` as in a `Batch`. Its attributes have the settings of the sweep.
    """

    figures = ("sweep",)
    files = ("sweep.nc",)

    nominal: StudiedScenario
    model_follows: ModelFollows = ()
    """Varied plant parameters that the controller's model follows."""
    computed: int = field(default=0)

    @classmethod
    def of(
        cls,
        scenario: StudiedScenario,
        about: Mapping[str, Any],
        inputs: Mapping[SweptParameter, NDArray],
        columns: Table,
        computed: int = 0,
    ) -> Self:
        """Return the result of a sweep.

        Parameters
        ----------
        scenario
            Scenario with the nominal values.
        about
            Settings of the sweep, see `Sweep.about`.
        inputs
            Values [SI] of the varied parameters, shape (runs,).
        columns
            Records of all runs, shape (runs,).
        computed
            Number of the runs that were not kept before.
        """
        import xarray as xr

        variables: dict[str, Any] = {}
        for swept, values in inputs.items():
            units = {"units": swept.parameter.unit, "shown_units": swept.parameter.shown}
            about_input = units | {"long_name": swept.name, "over": swept.text, "role": "input"}
            variables[swept.name] = "run", values, about_input
        for name, values in columns.items():
            if name != "outcome":
                variables[name] = "run", values, _attributes(name, scenario.joint_type)
        variables |= outcome_variable(columns["outcome"])
        attrs = {"title": scenario.name, "scenario": about["scenario"], "manifest": json.dumps(about, sort_keys=True)}
        return cls(xr.Dataset(variables, attrs=attrs), scenario, tuple(about["model_follows"]), computed)

    @property
    def inputs(self) -> tuple[str, ...]:
        """Names of the varied parameters."""
        return tuple(str(name) for name in self.table if self.table[name].attrs.get("role") == "input")

    @property
    def metrics(self) -> tuple[str, ...]:
        """Names of the computed metrics; of those along the joints of a robot, with the joint: ``angle_rmse.hip``."""
        order = list(Metrics._fields)
        names = [str(name) for name in self.table if str(name).partition(".")[0] in order and name not in self.inputs]
        return tuple(sorted(names, key=lambda name: order.index(name.partition(".")[0])))

    @property
    def main_metrics(self) -> tuple[str, ...]:
        """Up to three metrics that have values: the main ones, or else others; up to six of several joints."""
        finite = [name for name in self.metrics if self.values(name).size]
        return tuple([name for name in finite if name.partition(".")[0] in MAIN][:_MOST] or finite[:3])

    def label(self, metric: str) -> Metric:
        """Return unit and meaning of a metric."""
        return metrics_of(Metrics)[metric.partition(".")[0]].for_joint(self.nominal.joint_type)

    def words(self, metric: str) -> str:
        """Return the name of a metric in tables and figures."""
        return self.nominal.joint_type.words(metric.replace("_", " ").replace(".", ", "))

    def values(self, metric: str) -> NDArray[np.float64]:
        """Return a metric [SI] of the runs that did not fail and have a value of it."""
        return self._frame[metric].dropna().to_numpy()

    def scenario(self, run: int) -> StudiedScenario:
        """Return the scenario of one run, numbered from 0; the controller's model is explicit if the plant varied.

        Raises `ParameterError` if there is no such run.
        """
        if not 0 <= run < self.count:
            raise ParameterError(f"there is no run {run}", value=run, remedy=f"choose 0 to {self.count - 1}")
        values = {name: self[name][run].item() for name in self.inputs}
        return with_values(self.nominal, values, model_follows=self.model_follows)

    def write(self, folder: Path) -> None:
        """Write sweep.nc to a folder, atomically; the same sweep gives the same bytes."""
        write_netcdf(self.table, folder / "sweep.nc")

    def verdict(self) -> str:
        """Return the numbers of runs and of failed runs."""
        failed = int(self.failed.sum())
        lost = f", {failed} of them failed" if failed else ""
        return f"{self.table.attrs.get('title', '')}: {self.count} runs over {', '.join(self.inputs)}{lost}"

    def remarks(self) -> Iterator[Remark]:
        """Yield a remark on the integration error."""
        steps = StepCounts(*(self[name] for name in STEP_COLUMNS)).summary()
        yield Remark.note("error_estimate", integration_sentence(steps))

    @table("Outcomes")
    def outcome_counts(self) -> TableColumns:
        """Return the number and share of the runs by their outcome."""
        counts = np.bincount(self["outcome"], minlength=len(OUTCOMES))
        outcomes = [(outcome.value, int(count)) for outcome, count in zip(OUTCOMES, counts, strict=True) if count]
        names, runs = zip(*outcomes, strict=True)
        share = Column("1", "share", "%", digits=3), [count / self.count for count in runs]
        return {"outcome": (Column(), names), "runs": (Column(), runs), "share": share}

    @table()
    def metrics_over_runs(self) -> Iterator[Listing]:
        """Yield statistics of the metrics over the runs that did not fail, and rank correlations."""
        statistics = ("metric", "unit", "median", "5 %", "95 %", "worst", "in run", "runs")
        yield Listing.of("Runs that did not fail", statistics, self.statistics())
        ranks = self.correlations().rename_axis("parameter").reset_index()
        ranks = ranks.melt("parameter", var_name="metric", value_name="Spearman").dropna()
        ranks = ranks.sort_values("Spearman", key=abs, ascending=False, kind="stable").head(10)
        ranks["metric"] = ranks["metric"].map(self.words)
        if ranks.size:
            yield Listing.of("Rank correlations, strongest first", list(map(str, ranks)), ranks.to_numpy().tolist())

    def statistics(self) -> list[tuple[object, ...]]:
        """Return metric, unit, median, 5th and 95th percentile, worst value and its run, and number of runs.

        In shown units, over the runs that did not fail and have a value.
        """
        rows: list[tuple[object, ...]] = []
        for metric in self.metrics:
            label = self.label(metric)
            values = self._frame[metric].dropna() / label.size
            if values.size:
                numbers = *values.quantile([0.5, 0.05, 0.95]).tolist(), values.max(), values.idxmax(), values.size
                rows.append((self.words(metric), label.shown_unit, *numbers))
        return rows

    def correlations(self, *, least_runs: int = 3) -> pd.DataFrame:
        """Return Spearman's rank correlations of inputs (rows) with failing and the main metrics (columns).

        NaN for a constant column, and with fewer than `least_runs` runs, which are in perfect order, whatever their
        values. C. Spearman, Am. J. Psychology 15 (1904) 72.
        """
        columns = [*self.inputs, "failed", *self.main_metrics]
        whole = self._frame.assign(failed=self.failed.astype(float))[columns]
        return whole.corr("spearman", min_periods=least_runs).loc[list(self.inputs), columns[len(self.inputs) :]]

    @functools.cached_property
    def _frame(self) -> pd.DataFrame:
        """Inputs of all runs, and finite metrics of those that did not fail."""
        import pandas as pd

        metrics = {name: np.where(np.isfinite(self[name]) & ~self.failed, self[name], np.nan) for name in self.metrics}
        return pd.DataFrame({name: self[name].astype(float) for name in self.inputs} | metrics)


def _attributes(column: str, joint_type: JointType) -> dict[str, str]:
    """Attributes of a column, with the joint of a metric of one."""
    name, _, joint = column.partition(".")
    about = attributes(name, joint_type)
    return about | {"long_name": f"{about['long_name']}, {joint}"} if joint else about
