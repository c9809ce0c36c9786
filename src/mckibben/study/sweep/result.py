"""Results of a sweep."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterator, Mapping
from dataclasses import field
from pathlib import Path
from typing import Any, Self

import jax
import numpy as np
from numpy.typing import NDArray

from mckibben.component.columns import attributes
from mckibben.dataset.schema import load_netcdf, write_netcdf
from mckibben.errors import FileError, ParameterError, Problem
from mckibben.result import Column, Listing, Remark
from mckibben.scenario import ModelFollows, Scenario, batched, with_values
from mckibben.simulation import Metrics
from mckibben.simulation.accuracy import STEP_COLUMNS, StepCounts, integration_sentence
from mckibben.simulation.batch import RunTable, outcome_variable
from mckibben.simulation.metrics import METRICS
from mckibben.simulation.outcome import OUTCOMES
from mckibben.study.parameters import SweptParameter
from mckibben.study.ranks import spearman
from mckibben.study.study import Table
from mckibben.study.sweep.feasibility import FEASIBILITY

_KIND = "mckibben sweep"
MAIN = ("angle_rmse", "stiffness_rmse", "coupling")
"""Metrics used in correlations and figures, if they were computed."""

_MIN_RUNS = 3  # of a rank correlation: with fewer, every order is perfect
_MAX_CORRELATIONS = 10
_WEAK = 0.05
_SHOWN = {metric: name for name, (metric, _, _) in METRICS.items()}


class SweepResult(RunTable):
    """Results of a sweep; `computed` runs come from this call, the others were kept before.

    The table has along ``run``, all in SI: the inputs by their names in the scenario (attribute ``shown_units``: their
    unit in files), the metrics, ``outcome`` (a code; ``flag_meanings`` lists the words), ``shortfall_max`` (largest
    distance of the stiffness reference from the attainable stiffness), ``infeasible_time`` (share of the time at which
    no pressures hold the angle), and ``substeps``, ``error_estimate`` and ``chaotic`` as in a `Batch`. Its attributes
    have the settings of the sweep.
    """

    figures = ("sweep",)
    files = ("sweep.nc",)

    computed: int = field(default=0)

    @classmethod
    def of(
        cls,
        title: str,
        about: Mapping[str, Any],
        inputs: Mapping[SweptParameter, NDArray[Any]],
        metrics: tuple[str, ...],
        columns: Table,
        computed: int = 0,
    ) -> Self:
        """Return the result of settings, values of the varied parameters, and the records of all runs."""
        import xarray as xr

        variables: dict[str, Any] = {}
        for swept, values in inputs.items():
            units = {"units": swept.parameter.unit, "shown_units": swept.parameter.shown}
            variables[swept.name] = (
                "run",
                values,
                units | {"long_name": swept.name, "over": swept.text, "role": "input"},
            )
        variables |= {name: ("run", columns[name], attributes(name)) for name in metrics}
        variables |= outcome_variable(columns["outcome"])
        variables |= {name: ("run", columns[name], attributes(name)) for name in STEP_COLUMNS}
        for name, (unit, meaning) in FEASIBILITY.items():
            variables[name] = "run", columns[name], {"units": unit, "long_name": meaning}
        identity = json.dumps({name: value for name, value in about.items() if name != "source"}, sort_keys=True)
        attrs = {
            "kind": _KIND,
            "title": title,
            "source": about["source"],
            "scenario": about["scenario"],
            "manifest": json.dumps(about, sort_keys=True),
            "identity": hashlib.sha256(identity.encode()).hexdigest(),
        }
        return cls(xr.Dataset(variables, attrs=attrs), computed)

    @property
    def inputs(self) -> tuple[str, ...]:
        """Names of the varied parameters."""
        return tuple(str(name) for name in self.table if self.table[name].attrs.get("role") == "input")

    @property
    def metrics(self) -> tuple[str, ...]:
        """Names of the computed metrics."""
        return tuple(name for name in Metrics._fields if name in self.table)

    @property
    def main_metrics(self) -> tuple[str, ...]:
        """Up to three metrics that have values: the main ones, or else others."""
        finite = [name for name in self.metrics if self.values(name).size]
        return tuple([name for name in MAIN if name in finite] or finite[:3])

    def values(self, name: str, metric: str | None = None) -> NDArray[np.float64]:
        """Return a column [SI] of the runs that did not fail and have a value of it, or of a metric."""
        return self[name].astype(float)[~self.failed & np.isfinite(self[metric or name])]

    def scenario(self, run: int, *, folder: str | os.PathLike[str] = ".") -> Scenario:
        """Return the scenario of one run, numbered from 0; the controller's model is explicit if the plant varied.

        `folder` is the sweep's folder, for a scenario that names files. Raises `ParameterError` if there is no such
        run, and `FileError` if a file or catalog entry that the scenario names has changed since.
        """
        if not 0 <= run < self.count:
            raise ParameterError(f"there is no run {run}", value=run, remedy=f"choose 0 to {self.count - 1}")
        nominal = Scenario.parse(self.table.attrs["scenario"], folder=folder)
        about = json.loads(self.table.attrs["manifest"])
        first = {name: np.array([value]) for name, value in about["first"].items()}
        if digest_of_model(nominal, first, about["model_follows"]) != about["digest of model"]:
            message = "a file or catalog entry that the scenario names has changed, or another version made the sweep"
            remedy = "give the sweep's folder with the original files, and use the version that made it"
            raise FileError(os.fspath(folder), [Problem(message, remedy=remedy)])
        return with_values(
            nominal, {name: self[name][run].item() for name in self.inputs}, model_follows=about["model_follows"]
        )

    def write(self, folder: Path) -> None:
        """Write sweep.nc to a folder."""
        self.to_netcdf(folder / "sweep.nc")

    def to_netcdf(self, path: str | os.PathLike[str]) -> None:
        """Write a NetCDF file atomically, replacing an existing one; the same sweep gives the same bytes."""
        write_netcdf(self.table, Path(path))

    @classmethod
    def from_netcdf(cls, path: str | os.PathLike[str]) -> Self:
        """Read a file written by `to_netcdf`; raises `FileError` if it is missing, damaged, or not a sweep."""
        table = load_netcdf(Path(path))
        whole = all(name in table and table[name].dims == ("run",) for name in ("outcome", *STEP_COLUMNS, *FEASIBILITY))
        if table.attrs.get("kind") != _KIND or not whole:
            raise FileError(str(path), [Problem("it is not a sweep", remedy="give the sweep.nc of `mckibben sweep`")])
        codes = table["outcome"].to_numpy()
        if codes.dtype.kind not in "iu" or np.any((codes < 0) | (codes >= len(OUTCOMES))):
            raise FileError(str(path), [Problem("it has unknown outcomes", field="outcome")])
        return cls(table)

    def verdict(self) -> str:
        """Return the numbers of runs and of failed runs."""
        failed = int(self.failed.sum())
        lost = f", {failed} of them failed" if failed else ""
        return f"{self.table.attrs.get('title', '')}: {self.count} runs over {', '.join(self.inputs)}{lost}"

    def remarks(self) -> Iterator[Remark]:
        """Yield remarks on references that the joint cannot hold, and on the integration error."""
        shortfall, held = np.nan_to_num(self["shortfall_max"]), self["infeasible_time"] == 0
        if count := int(np.sum(shortfall > 0)):
            text = (
                f"{count} of {self.count} runs have a stiffness reference that the joint cannot hold, short by up to "
            )
            text += f"{shortfall.max():.3g} N*m/rad (run {int(np.argmax(shortfall))})"
            yield Remark.warning("shortfall_max", text)
        if count := int(np.sum(~held)):
            text = f"{count} of {self.count} runs have an angle reference that no pressures within limits hold"
            yield Remark.warning("infeasible_time", text)
        steps = StepCounts(*(self[name] for name in STEP_COLUMNS)).summary()
        yield Remark.note("error_estimate", integration_sentence(steps))

    def listings(self) -> Iterator[Listing]:
        """Yield outcomes, statistics of the metrics over the runs that did not fail, and rank correlations."""
        counts = np.bincount(self["outcome"], minlength=len(OUTCOMES))
        outcomes = [(outcome.value, int(count)) for outcome, count in zip(OUTCOMES, counts, strict=True) if count]
        names, runs = zip(*outcomes, strict=True)
        share = Column("1", "share", "%", digits=3), [count / self.count for count in runs]
        yield Listing("Outcomes", {"outcome": (Column(), names), "runs": (Column(), runs), "share": share})
        yield _listing("Runs that did not fail", ("metric", "unit", *_STATISTICS), self.statistics())
        strong = [row for row in self.correlations() if abs(row[2]) >= _WEAK][:_MAX_CORRELATIONS]
        yield _listing("Rank correlations, strongest first", ("parameter", "metric", "Spearman"), strong)

    def statistics(self) -> list[tuple[Any, ...]]:
        """Return metric, unit, median, percentiles, worst value and its run, and number of runs with a value."""
        rows: list[tuple[Any, ...]] = []
        for metric in self.metrics:
            _, unit, scale = METRICS[_SHOWN[metric]]
            values = self.values(metric) / scale
            if values.size:
                valid = np.where(~self.failed & np.isfinite(self[metric]), self[metric], -np.inf)
                quantiles = np.quantile(values, (0.5, 0.05, 0.95)).tolist()
                worst = float(values.max()), int(np.argmax(valid))
                rows.append((metric.replace("_", " "), unit, *quantiles, *worst, int(values.size)))
        return rows

    def correlations(self) -> list[tuple[str, str, float]]:
        """Return parameter, metric and rank correlation, also with failing; the strongest first."""
        rows = []
        for name in self.inputs:
            if self.count >= _MIN_RUNS:
                rows.append((name, "failed", spearman(self[name], self.failed)))
            for metric in self.main_metrics:
                values = self.values(metric)
                if values.size >= _MIN_RUNS:
                    rows.append((name, metric.replace("_", " "), spearman(self.values(name, metric), values)))
        return sorted((row for row in rows if np.isfinite(row[2])), key=lambda row: -abs(row[2]))


_STATISTICS = ("median", "5 %", "95 %", "worst", "in run", "runs")


def _listing(title: str, headers: tuple[str, ...], rows: list[tuple[Any, ...]]) -> Listing:
    """Return a table of rows."""
    columns = zip(*rows, strict=True) if rows else ((),) * len(headers)
    return Listing(
        title, {name: (Column(title=name), list(column)) for name, column in zip(headers, columns, strict=True)}
    )


def digest_of_model(scenario: Scenario, table: Table, model_follows: ModelFollows) -> str:
    """Return a digest of all numbers of the first run, including the files and catalog entries that it names."""
    first = batched(scenario, {name: column[:1] for name, column in table.items()}, model_follows=model_follows)
    leaves = jax.tree_util.tree_leaves_with_path((first.plant(), first.control(), first.reference()))
    digest = hashlib.sha256()
    for path, leaf in leaves:
        digest.update(jax.tree_util.keystr(path).encode())
        digest.update(np.asarray(leaf).tobytes() if np.asarray(leaf).dtype != object else repr(leaf).encode())
    return digest.hexdigest()
