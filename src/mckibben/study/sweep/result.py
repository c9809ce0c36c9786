"""Results of a sweep."""

from __future__ import annotations

import functools
import io
import json
import os
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO, Self

import numpy as np
from numpy.typing import NDArray

from mckibben.component.columns import attributes
from mckibben.dataset.schema import load_netcdf
from mckibben.errors import FileError, ParameterError, Problem
from mckibben.notebook import html_table
from mckibben.scenario import Scenario, list_parameters, with_values
from mckibben.simulation import Metrics, Outcome
from mckibben.simulation.accuracy import STEP_COLUMNS, StepCounts
from mckibben.simulation.batch import RunTable, outcome_variable
from mckibben.simulation.metrics import METRICS
from mckibben.simulation.outcome import OUTCOMES
from mckibben.storage.files import append_seal, atomic_write
from mckibben.study.sweep.compute import FEASIBILITY, Columns
from mckibben.study.sweep.plan import SweepPlan, digest_of_model
from mckibben.study.sweep.ranks import Pieces, RankedColumn, rank_correlation

if TYPE_CHECKING:
    import xarray as xr


PIECE = 1 << 16
"""Rows of a table that are handled at once."""

_KIND = "mckibben sweep"


class SweepResult(RunTable):
    """Results of a sweep; `computed` runs come from this call, the others were stored before.

    The table has along ``run``, all in SI: the inputs by their names in the scenario (attribute ``shown_units``: their
    unit in files), the metrics, ``outcome`` (a code; ``flag_meanings`` lists the words), ``shortfall_max`` (largest
    distance of the stiffness reference from the attainable stiffness), ``infeasible_time`` (share of the time at which
    no pressures hold the angle), and ``substeps``, ``error_estimate`` and ``chaotic`` as in a `Batch`. Its attributes
    identify the sweep.
    """

    computed: int = 0

    @classmethod
    def of(cls, plan: SweepPlan, columns: Columns, computed: int = 0) -> Self:
        """Result from a plan and the results of all its blocks."""
        import xarray as xr

        variables: dict[str, Any] = {}
        for swept in plan.swept:
            parameter = swept.parameter
            units = {"units": parameter.unit, "shown_units": parameter.shown}
            about = {**units, "long_name": parameter.name, "over": swept.text, "role": "input"}
            variables[swept.name] = ("run", plan.table[swept.name], about)
        for name in plan.task.metrics:
            variables[name] = ("run", columns[name], attributes(name))
        variables |= outcome_variable(columns["outcome"])
        for name in STEP_COLUMNS:
            variables[name] = ("run", columns[name], attributes(name))
        for name, (unit, meaning) in FEASIBILITY.items():
            variables[name] = ("run", columns[name], {"units": unit, "long_name": meaning})
        manifest = plan.manifest
        attrs = {
            "kind": _KIND,
            "title": plan.task.scenario.name,
            "source": manifest["source"],
            "scenario": manifest["scenario"],
            "manifest": json.dumps(manifest, sort_keys=True),
            "identity": plan.identity,
            "mckibben_version": plan.task.software["mckibben"],
            "jax_version": plan.task.software["jax"],
        }
        if plan.part != (1, 1):
            attrs |= {"part": "{}/{}".format(*plan.part), "first_run": plan.first}
        return cls(xr.Dataset(variables, attrs=attrs), computed)

    def __repr__(self) -> str:
        failed = f", {count} failed" if (count := int(self.failed.sum())) else ""
        return f"<SweepResult: {self.count} runs{failed}, over {', '.join(self.inputs)}>"

    def _repr_html_(self) -> str:
        numbers = summary(self)
        rows = metric_rows(numbers)
        return html_table(repr(self), ("metric", "unit", "median", "5 %", "95 %", "worst", "in run", ""), rows)

    @property
    def first(self) -> int:
        """Number of the first run: of a part, in the whole sweep."""
        return int(self.table.attrs.get("first_run", 0))

    @property
    def inputs(self) -> tuple[str, ...]:
        """Names of the varied parameters."""
        return tuple(str(name) for name in self.table if self.table[name].attrs.get("role") == "input")

    @property
    def metrics(self) -> tuple[str, ...]:
        """Names of the computed metrics."""
        return tuple(name for name in Metrics._fields if name in self.table)

    def scenario(self, run: int, *, folder: str | os.PathLike[str] = ".") -> Scenario:
        """Scenario of one run, numbered from 0; the controller's model is explicit if the plant varied.

        `folder` is the sweep's folder, for a scenario that names files. Raises ParameterError if there is no such run,
        and FileError if a file or catalog entry that the scenario names has changed since.
        """
        row, last = run - self.first, self.first + self.count - 1
        if not 0 <= row < self.count:
            raise ParameterError(f"there is no run {run}", value=run, remedy=f"choose {self.first} to {last}")
        nominal = Scenario.parse(self.table.attrs["scenario"], folder=folder)
        manifest = json.loads(self.table.attrs["manifest"])
        first = {name: np.array([value]) for name, value in manifest["first"].items()}
        if digest_of_model(nominal, first, manifest["known"]) != manifest["model"]:
            problem = Problem(
                "a file or catalog entry that the scenario names has changed, or another version made the sweep",
                remedy="give the sweep's folder with the original files, and use the version in its manifest",
            )
            raise FileError(os.fspath(folder), [problem])
        return with_values(
            nominal, {name: self.table[name][row].item() for name in self.inputs}, known=manifest["known"]
        )

    def to_netcdf(self, path: str | os.PathLike[str]) -> None:
        """Write a NetCDF file atomically, replacing an existing one; the same sweep gives the same bytes."""
        content = io.BytesIO()  # HDF5 crashes on a full disk
        columns = {str(name): [column.to_numpy()] for name, column in self.table.items()}
        write_columns(content, self.table, self.count, columns)
        with atomic_write(path, overwrite=True) as sibling:
            sibling.write_bytes(content.getbuffer())
            append_seal(sibling)

    @classmethod
    def from_netcdf(cls, path: str | os.PathLike[str], *, lazy: bool = False) -> Self:
        """Read a file written by `to_netcdf`, or open it so that columns are read when they are used (`lazy`).

        Raises FileError if it is missing, damaged, or not a sweep.
        """
        source = str(path)
        table = load_netcdf(Path(path), lazy=lazy)
        known = (name in table and table[name].dims == ("run",) for name in ("outcome", *STEP_COLUMNS, *FEASIBILITY))
        if table.attrs.get("kind") != _KIND or not all(known):
            raise FileError(source, [Problem("it is not a sweep", remedy="give the sweep.nc of `mckibben sweep`")])
        found = cls(table)
        for codes in _pieces(found, "outcome"):
            if codes.dtype.kind not in "iu" or np.any((codes < 0) | (codes >= len(OUTCOMES))):
                raise FileError(source, [Problem("it has unknown outcomes", field="outcome")])
        return found


def write_columns(target: BinaryIO, like: xr.Dataset, runs: int, columns: Mapping[str, Iterable[NDArray]]) -> None:
    """Write a NetCDF file with attributes and types of a table; the pieces of columns do not determine the bytes."""
    import h5netcdf

    with h5netcdf.File(target, "w") as file:
        file.attrs.update({name: value for name, value in like.attrs.items() if name not in ("part", "first_run")})
        if runs == like.sizes["run"]:
            file.attrs.update({name: like.attrs[name] for name in ("part", "first_run") if name in like.attrs})
        file.dimensions = {"run": runs}
        for name, pieces in columns.items():
            variable = file.create_variable(name, ("run",), like[name].dtype)
            variable.attrs.update(like[name].attrs)
            at = 0
            for piece in pieces:
                variable[at : at + len(piece)] = piece
                at += len(piece)


MAIN = ("angle_rmse", "stiffness_rmse", "coupling")
"""Metrics used in correlations and figures, if they were computed."""

_MIN_RUNS = 3  # of a rank correlation: with fewer, every order is perfect
_SHOWN = {metric: name for name, (metric, _, _) in METRICS.items()}


def summary(sweep: SweepResult) -> dict[str, Any]:
    """Statistics of a sweep, for JSON.

    ``scenario``, ``runs``, ``failed``; ``outcomes``: counts. ``metrics``, under the names and in the units of results,
    over the runs that did not fail: ``median``, ``percentile_5``, ``percentile_95``, ``worst``, ``worst_run`` (from 0),
    and the number of ``runs`` with a value; None if there is none. ``correlations``: Spearman's rank correlation of
    each input with each main metric and with failing, the strongest first. ``feasibility``: numbers of runs with
    references that the joint cannot hold. ``integration``: largest number of integration steps and largest estimated
    error, and the number of runs found to be chaotic.
    """
    pieces = (np.bincount(codes, minlength=len(OUTCOMES)) for codes in _pieces(sweep, "outcome"))
    counts = sum(pieces, start=np.zeros(len(OUTCOMES), np.int64))
    return {
        "scenario": sweep.table.attrs.get("title", ""),
        "runs": sweep.count,
        "failed": int(np.sum(counts * _FAILED)),
        "outcomes": {one.name.lower(): int(count) for one, count in zip(OUTCOMES, counts, strict=True) if count},
        "metrics": {_SHOWN[name]: _percentiles(sweep, name) for name in sweep.metrics},
        "correlations": _correlations(sweep),
        "feasibility": _infeasible_runs(sweep),
        "integration": _integration(sweep),
    }


_FAILED = np.array([outcome.failed for outcome in OUTCOMES])


def main_metrics(sweep: SweepResult) -> tuple[str, ...]:
    """Up to three metrics that have values: the main ones, or else others."""
    finite = [name for name in sweep.metrics if any(len(piece) for piece in _usable(sweep, name, name)())]
    main = [name for name in MAIN if name in finite]
    return tuple(main or finite[:3])


def _pieces(sweep: SweepResult, *names: str) -> Iterator[Any]:
    """Columns in pieces of rows: arrays for one name, tuples for several."""
    for start in range(0, sweep.count, PIECE):
        found = tuple(sweep.table[name][start : start + PIECE].to_numpy() for name in names)
        yield found if len(names) > 1 else found[0]


def _usable(sweep: SweepResult, name: str, metric: str, scale: float = 1.0) -> Pieces:
    """A column over a scale, in pieces, of the runs that did not fail and have a value of a metric."""

    def pieces() -> Iterator[NDArray[np.float64]]:
        for codes, values, shown in _pieces(sweep, "outcome", name, metric):
            yield values[~_FAILED[codes] & np.isfinite(shown)].astype(float) / scale

    return pieces


def _percentiles(sweep: SweepResult, name: str) -> dict[str, Any]:
    column = RankedColumn(_usable(sweep, name, name, scale := METRICS[_SHOWN[name]][2]), sweep.count)
    if not column.count:
        return {**dict.fromkeys(("median", "percentile_5", "percentile_95", "worst", "worst_run")), "runs": 0}
    worst, largest, start = 0, -np.inf, sweep.first
    for codes, values in _pieces(sweep, "outcome", name):
        valid = np.where(~_FAILED[codes] & np.isfinite(values), values.astype(float) / scale, -np.inf)
        if valid.max() > largest:
            worst, largest = start + int(np.argmax(valid)), float(valid.max())
        start += len(codes)
    return {
        "median": column.quantile(0.5),
        "percentile_5": column.quantile(0.05),
        "percentile_95": column.quantile(0.95),
        "worst": largest,
        "worst_run": worst,
        "runs": column.count,
    }


def _correlations(sweep: SweepResult) -> list[dict[str, Any]]:
    def all_of(name: str) -> Pieces:
        return lambda: (values.astype(float) for values in _pieces(sweep, name))

    def with_inputs(name: str, column: Pieces, of: Callable[[str], Pieces]) -> list[dict[str, Any]]:
        """Rank correlations of a column with the inputs, which are read one at a time."""
        ranked = RankedColumn(column, sweep.count)
        if ranked.count < _MIN_RUNS or ranked.quantile(0.0) == ranked.quantile(1.0):
            return []
        others = ((other, RankedColumn(of(other), sweep.count)) for other in sweep.inputs)
        return [{"input": one, "with": name, "spearman": rank_correlation(other, ranked)} for one, other in others]

    found = with_inputs("failed", lambda: (_FAILED[codes].astype(float) for codes in _pieces(sweep, "outcome")), all_of)
    for name in main_metrics(sweep):
        usable = functools.partial(_usable, sweep, metric=name)
        found += with_inputs(_SHOWN[name], usable(name), usable)
    found = [each for each in found if np.isfinite(each["spearman"])]
    return sorted(found, key=lambda each: -abs(each["spearman"]))


def _infeasible_runs(sweep: SweepResult) -> dict[str, Any]:
    infeasible, worst, largest, start = np.zeros(3, np.int64), None, 0.0, sweep.first
    for shortfall, time in _pieces(sweep, "shortfall_max", "infeasible_time"):
        short, angle = np.nan_to_num(shortfall), time > 0
        infeasible += np.sum(short > 0), np.sum(angle), np.sum((short > 0) | angle)
        if short.max() > largest:
            worst, largest = start + int(np.argmax(short)), float(short.max())
        start += len(short)
    return {
        "runs_stiffness_infeasible": int(infeasible[0]),
        "shortfall_max": largest,
        "shortfall_max_run": worst,
        "runs_angle_infeasible": int(infeasible[1]),
        "runs_infeasible": int(infeasible[2]),
    }


def _integration(sweep: SweepResult) -> dict[str, Any]:
    found = [StepCounts(*columns).summary() for columns in _pieces(sweep, *STEP_COLUMNS)]
    errors = [one["error_estimate_rad"] for one in found if one["error_estimate_rad"] is not None]
    return {
        "substeps": max(one["substeps"] for one in found),
        "error_estimate_rad": max(errors, default=None),
        "runs_chaotic": sum(one["runs_chaotic"] for one in found),
    }


Row = tuple[str, ...]
_MAX_CORRELATIONS = 10
_WEAK = 0.05


def parameter_rows(scenario: Scenario) -> list[dict[str, Any]]:
    """Name, nominal value, range and unit of each parameter that can be varied."""
    return [
        {
            "name": each.name,
            "nominal": None if each.nominal is None else each.show(each.nominal),
            "range": each.range,
            "unit": each.shown,
            "nominal_SI": each.nominal,
            "unit_SI": each.unit,
        }
        for each in list_parameters(scenario)
    ]


def outcome_rows(numbers: Mapping[str, Any]) -> list[Row]:
    """Count, share and meaning of each outcome."""
    runs = numbers["runs"]
    return [
        (str(count), f"{count / runs:.1%}", Outcome[name.upper()].value) for name, count in numbers["outcomes"].items()
    ]


def metric_rows(numbers: Mapping[str, Any]) -> list[Row]:
    """Name, unit and statistics of each metric that has values."""
    rows: list[tuple[str, ...]] = []
    valid = numbers["runs"] - numbers["failed"]
    for name, found in numbers["metrics"].items():
        if not found["runs"]:
            continue
        metric, unit, _ = METRICS[name]
        values = [f"{found[key]:.4g}" for key in ("median", "percentile_5", "percentile_95", "worst")]
        missing = valid - found["runs"]
        note = f"{missing} {'never' if metric == 'stiffness_settling' else 'without'}" if missing else ""
        rows.append((metric.replace("_", " "), unit, *values, str(found["worst_run"]), note))
    return rows


def correlation_rows(numbers: Mapping[str, Any]) -> list[Row]:
    """Input, metric and rank correlation of the strongest few."""
    return [
        (each["input"], _label(each["with"]), f"{each['spearman']:+.2f}")
        for each in numbers["correlations"][:_MAX_CORRELATIONS]
        if abs(each["spearman"]) >= _WEAK
    ]


def feasibility_sentence(numbers: Mapping[str, Any]) -> str:
    """Sentence on the references that the joint cannot hold."""
    found, runs = numbers["feasibility"], numbers["runs"]
    parts = []
    if count := found["runs_stiffness_infeasible"]:
        parts.append(
            f"{count} of {runs} runs have a stiffness reference that the joint cannot hold, short by up to "
            f"{found['shortfall_max']:.3g} N*m/rad (run {found['shortfall_max_run']})"
        )
    if count := found["runs_angle_infeasible"]:
        parts.append(f"{count} of {runs} runs have an angle reference that no pressures within limits hold")
    return "; ".join(parts) if parts else "all references are statically feasible"


def _label(name: str) -> str:
    return METRICS[name][0].replace("_", " ") if name in METRICS else name
