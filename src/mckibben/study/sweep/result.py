"""Results of a sweep."""

from __future__ import annotations

import io
import json
import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mckibben.component.columns import attributes
from mckibben.dataset.schema import load_netcdf
from mckibben.errors import FileError, ParameterError, Problem
from mckibben.notebook import html_table
from mckibben.scenario import Scenario, list_parameters, with_values
from mckibben.simulation import Metrics, Outcome
from mckibben.simulation.accuracy import STEP_COLUMNS, StepCounts
from mckibben.simulation.metrics import METRICS
from mckibben.simulation.outcome import OUTCOMES
from mckibben.simulation.table import RunTable, outcome_variable
from mckibben.storage.files import append_seal, atomic_write
from mckibben.study.sweep.compute import FEASIBILITY, Columns
from mckibben.study.sweep.plan import SweepPlan, digest_of_model

if TYPE_CHECKING:
    import xarray as xr


PIECE = 1 << 16
"""Rows of a table that are handled at once."""

_KIND = "mckibben sweep"


@dataclass(frozen=True, eq=False, repr=False)
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
        missing = [
            name
            for name in ("outcome", *STEP_COLUMNS, *FEASIBILITY)
            if name not in table or table[name].dims != ("run",)
        ]
        if table.attrs.get("kind") != _KIND or missing:
            raise FileError(source, [Problem("it is not a sweep", remedy="give the sweep.nc of `mckibben sweep`")])
        codes = table["outcome"].to_numpy()
        if codes.dtype.kind not in "iu" or np.any((codes < 0) | (codes >= len(OUTCOMES))):
            raise FileError(source, [Problem("it has unknown outcomes", field="outcome")])
        return cls(table)


def write_columns(target: BinaryIO, like: xr.Dataset, runs: int, columns: Mapping[str, Iterable[NDArray]]) -> None:
    """Write a NetCDF file with the attributes and types of a table; each column in pieces, in the order of the runs.

    The pieces do not determine the bytes.
    """
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

    Parameters
    ----------
    sweep
        Result of `sweep`.

    Returns
    -------
    numbers
        ``scenario``, ``runs``, ``failed``; ``outcomes``: counts. ``metrics``, under the names and in the units of
        results, over the runs that did not fail: ``median``, ``percentile_5``, ``percentile_95``, ``worst``,
        ``worst_run`` (from 0), and the number of ``runs`` with a value; None if there is none. ``correlations``:
        Spearman's rank correlation of each input with each main metric and with failing, the strongest first.
        ``feasibility``: numbers of runs with references that the joint cannot hold. ``integration``: largest number of
        integration steps and largest estimated error, and the number of runs found to be chaotic.
    """
    failed = sweep.failed
    codes = sweep.table["outcome"].to_numpy()
    counts = {outcome.name.lower(): int(np.sum(codes == code)) for code, outcome in enumerate(OUTCOMES)}
    return {
        "scenario": sweep.table.attrs.get("title", ""),
        "runs": sweep.count,
        "failed": int(failed.sum()),
        "outcomes": {name: count for name, count in counts.items() if count},
        "metrics": {_SHOWN[name]: _percentiles(sweep, name, ~failed) for name in sweep.metrics},
        "correlations": _correlations(sweep, failed),
        "feasibility": _infeasible_runs(sweep),
        "integration": StepCounts(*(sweep.table[name].to_numpy() for name in STEP_COLUMNS)).summary(),
    }


def main_metrics(sweep: SweepResult) -> tuple[str, ...]:
    """Up to three metrics that have values: the main ones, or else others."""
    finite = [name for name in sweep.metrics if np.isfinite(sweep.table[name].to_numpy()[~sweep.failed]).any()]
    main = [name for name in MAIN if name in finite]
    return tuple(main or finite[:3])


def spearman(x: ArrayLike, y: ArrayLike) -> float:
    """Spearman's rank correlation of two columns, with mean ranks for ties; NaN if one is constant or has NaN."""
    return _correlation(*(_centred_ranks(np.asarray(values, float)) for values in (x, y)))


def _correlation(first: NDArray[np.float64], second: NDArray[np.float64]) -> float:
    """Correlation of columns less their means."""
    size = np.sqrt(np.sum(first**2) * np.sum(second**2))
    return float(np.sum(first * second) / size) if size > 0 else float("nan")


def _centred_ranks(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Ranks less their mean; in pieces, because SciPy takes 80 bytes per value."""
    order = np.argsort(values)
    ordered = values[order]
    ranks = np.full(len(values), np.nan)
    if len(values) and not np.isnan(ordered[-1]):
        for start in range(0, len(values), PIECE):
            piece = ordered[start : start + PIECE]
            ends = np.searchsorted(ordered, piece, "left") + np.searchsorted(ordered, piece, "right")
            ranks[order[start : start + PIECE]] = (ends - len(values)) / 2
    return ranks


def _percentiles(sweep: SweepResult, name: str, valid: NDArray[np.bool_]) -> dict[str, Any]:
    values = sweep.table[name].to_numpy().astype(float) / METRICS[_SHOWN[name]][2]
    valid = valid & np.isfinite(values)
    if not valid.any():
        return {**dict.fromkeys(("median", "percentile_5", "percentile_95", "worst", "worst_run")), "runs": 0}
    low, median, high = np.percentile(values[valid], [5, 50, 95])
    worst = int(np.argmax(np.where(valid, values, -np.inf)))
    return {
        "median": float(median),
        "percentile_5": float(low),
        "percentile_95": float(high),
        "worst": float(values[worst]),
        "worst_run": sweep.first + worst,
        "runs": int(valid.sum()),
    }


def _correlations(sweep: SweepResult, failed: NDArray[np.bool_]) -> list[dict[str, Any]]:
    def with_inputs(name: str, values: NDArray, rows: NDArray[np.bool_]) -> list[dict[str, Any]]:
        """Rank correlations of a column with the inputs, which are read one at a time."""
        ranks = _centred_ranks(values[rows])
        if len(ranks) < _MIN_RUNS or not ranks.any():
            return []
        others = ((other, _centred_ranks(sweep.table[other].to_numpy()[rows])) for other in sweep.inputs)
        return [{"input": other, "with": name, "spearman": _correlation(column, ranks)} for other, column in others]

    found = with_inputs("failed", failed.astype(float), np.ones_like(failed))
    for name in main_metrics(sweep):
        values = sweep.table[name].to_numpy()
        found += with_inputs(_SHOWN[name], values, ~failed & np.isfinite(values))
    found = [each for each in found if np.isfinite(each["spearman"])]
    return sorted(found, key=lambda each: -abs(each["spearman"]))


def _infeasible_runs(sweep: SweepResult) -> dict[str, Any]:
    short = np.nan_to_num(sweep.table["shortfall_max"].to_numpy())
    angle = sweep.table["infeasible_time"].to_numpy() > 0
    stiffness = short > 0
    worst = int(np.argmax(short))
    return {
        "runs_stiffness_infeasible": int(stiffness.sum()),
        "shortfall_max": float(short[worst]),
        "shortfall_max_run": sweep.first + worst if stiffness.any() else None,
        "runs_angle_infeasible": int(angle.sum()),
        "runs_infeasible": int(np.sum(stiffness | angle)),
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
    rows = []
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
