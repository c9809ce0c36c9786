"""Results of a sweep."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mckibben.errors import FileError, ParameterError, Problem
from mckibben.simulation import Metrics, Outcome
from mckibben.simulation.metrics import METRICS
from mckibben.simulation.result import OUTCOMES, attributes
from mckibben.storage.files import whole
from mckibben.study.parameters import addresses, with_values
from mckibben.study.scenario import Scenario
from mckibben.study.sweep.blocks import REACH, Columns
from mckibben.study.sweep.plan import Plan

if TYPE_CHECKING:
    import xarray as xr


_KIND = "mckibben sweep"


@dataclass(frozen=True, eq=False)
class Sweep:
    """The answers of a sweep.

    Attributes
    ----------
    table
        Along ``run``, all in SI: the inputs by their names in the scenario (attribute ``shown_units``: the unit they
        are written in), the metrics, ``outcome`` (a code; ``flag_meanings`` lists the words), ``shortfall_max`` and
        ``unheld``, of which `mckibben.study.sweep.blocks` tells. Its attributes say what made it.
    computed
        How many runs were computed when it was asked for; the others were kept from before.
    """

    table: xr.Dataset
    computed: int = 0

    @classmethod
    def of(cls, plan: Plan, columns: Columns, computed: int = 0) -> Self:
        """From a plan and the answers of all its blocks."""
        import xarray as xr

        variables: dict[str, Any] = {}
        for over in plan.over:
            address = over.address
            about = {"units": address.unit, "shown_units": address.shown, "long_name": address.name, "over": over.text}
            variables[over.name] = ("run", plan.table[over.name], {**about, "role": "input"})
        flags = {
            "flag_values": np.arange(len(OUTCOMES), dtype=np.int8),
            "flag_meanings": " ".join(outcome.name for outcome in OUTCOMES),
        }
        for name in plan.job.metrics:
            variables[name] = ("run", columns[name], attributes(name))
        variables["outcome"] = ("run", columns["outcome"], {"long_name": "how the run ended", **flags})
        for name, (unit, meaning) in REACH.items():
            variables[name] = ("run", columns[name], {"units": unit, "long_name": meaning})
        manifest = plan.manifest
        attrs = {
            "kind": _KIND,
            "title": plan.job.scenario.name,
            "source": manifest["source"],
            "scenario": manifest["scenario"],
            "manifest": json.dumps(manifest, sort_keys=True),
            "identity": plan.identity,
            "mckibben_version": plan.job.software["mckibben"],
            "jax_version": plan.job.software["jax"],
        }
        return cls(xr.Dataset(variables, attrs=attrs), computed)

    @property
    def count(self) -> int:
        """The number of runs."""
        return self.table.sizes["run"]

    @property
    def inputs(self) -> tuple[str, ...]:
        """The names of what was varied."""
        return tuple(str(name) for name in self.table if self.table[name].attrs.get("role") == "input")

    @property
    def metrics(self) -> tuple[str, ...]:
        """The names of the metrics that were computed."""
        return tuple(name for name in Metrics._fields if name in self.table)

    @property
    def outcomes(self) -> list[Outcome]:
        """How each run ended."""
        return [OUTCOMES[code] for code in self.table["outcome"].to_numpy()]

    @property
    def lost(self) -> NDArray[np.bool_]:
        """Which runs came to no end that is of use."""
        return np.array([outcome.failed for outcome in OUTCOMES])[self.table["outcome"].to_numpy()]

    def scenario(self, run: int, *, folder: str | os.PathLike[str] = ".") -> Scenario:
        """The scenario of one run, to look at it alone; its controller's model is written out if the plant varied.

        Parameters
        ----------
        run
            Its number, from 0.
        folder
            That of the sweep, for a scenario that names files.

        Raises
        ------
        ParameterError
            If there is no such run.
        """
        if not 0 <= run < self.count:
            raise ParameterError(f"there is no run {run}", value=run, remedy=f"choose 0 to {self.count - 1}")
        nominal = Scenario.parse(self.table.attrs["scenario"], folder=folder)
        values = {name: self.table[name].to_numpy()[run].item() for name in self.inputs}
        return with_values(nominal, values, known=json.loads(self.table.attrs["manifest"])["known"])

    def to_netcdf(self, path: str | os.PathLike[str]) -> None:
        """Write everything to a NetCDF file, the same bytes for the same sweep; it appears whole or not at all."""
        floats = [name for name, values in self.table.variables.items() if values.dtype.kind == "f"]
        with whole(path) as part:
            self.table.to_netcdf(part, engine="h5netcdf", encoding={name: {"_FillValue": None} for name in floats})

    @classmethod
    def from_netcdf(cls, path: str | os.PathLike[str]) -> Self:
        """Read what `to_netcdf` wrote.

        Raises
        ------
        FileError
            If the file is missing, damaged, or no sweep.
        """
        import xarray as xr

        source = str(path)
        if not Path(path).is_file():
            raise FileError(source, [Problem("there is no such file")])
        try:
            table = xr.load_dataset(path, engine="h5netcdf")
        except Exception as error:  # HDF5 has many ways to say that a file is damaged
            raise FileError(source, [Problem(f"it cannot be read as NetCDF: {error}")]) from error
        missing = [name for name in ("outcome", *REACH) if name not in table or table[name].dims != ("run",)]
        if table.attrs.get("kind") != _KIND or missing:
            raise FileError(source, [Problem("it is no sweep", remedy="give the sweep.nc of `mckibben sweep`")])
        codes = table["outcome"].to_numpy()
        if codes.dtype.kind not in "iu" or np.any((codes < 0) | (codes >= len(OUTCOMES))):
            raise FileError(source, [Problem("its outcomes are none of ours", field="outcome")])
        return cls(table)


MAIN = ("angle_rmse", "stiffness_rmse", "coupling")
"""The metrics of which correlations are computed and figures are drawn, as far as they are there."""

_FEWEST = 3  # runs: with fewer every order is a perfect one
_SHOWN = {metric: name for name, (metric, _, _) in METRICS.items()}


def summary(sweep: Sweep) -> dict[str, Any]:
    """The statistics of a sweep, as JSON has them.

    Parameters
    ----------
    sweep
        What has been computed.

    Returns
    -------
    numbers
        ``scenario``, ``runs``, ``lost``; ``outcomes``: counts. ``metrics``, under the names and in the units in which
        they are shown, over the runs that are not lost: ``median``, ``percentile_5``, ``percentile_95``, ``worst`` with
        its ``worst_run`` (from 0), and how many ``runs`` have a number at all; None where none has.
        ``correlations``: Spearman's rank correlation of each input with each main metric, and with being lost, the
        strongest first. ``reach``: how many runs wish for what the joint cannot hold.
    """
    lost = sweep.lost
    codes = sweep.table["outcome"].to_numpy()
    counts = {outcome.name.lower(): int(np.sum(codes == code)) for code, outcome in enumerate(OUTCOMES)}
    return {
        "scenario": sweep.table.attrs.get("title", ""),
        "runs": sweep.count,
        "lost": int(lost.sum()),
        "outcomes": {name: count for name, count in counts.items() if count},
        "metrics": {_SHOWN[name]: _spread(sweep, name, ~lost) for name in sweep.metrics},
        "correlations": _correlations(sweep, lost),
        "reach": _reach(sweep),
    }


def main_metrics(sweep: Sweep) -> tuple[str, ...]:
    """Up to three metrics that have numbers: the main ones, and others where there is none of these."""
    alive = [name for name in sweep.metrics if np.isfinite(sweep.table[name].to_numpy()[~sweep.lost]).any()]
    main = [name for name in MAIN if name in alive]
    return tuple(main or alive[:3])


def spearman(x: ArrayLike, y: ArrayLike) -> float:
    """Spearman's rank correlation of two columns; ties share their mean rank. NaN where one of them is constant.

    >>> round(spearman([1, 2, 3, 4], [1, 10, 100, 50]), 6)
    0.8
    """
    from scipy.stats import rankdata

    ranks = [rankdata(np.asarray(values, float)) for values in (x, y)]
    centred = [rank - rank.mean() for rank in ranks] if len(ranks[0]) else ranks
    size = np.sqrt(np.sum(centred[0] ** 2) * np.sum(centred[1] ** 2))
    return float(np.sum(centred[0] * centred[1]) / size) if size > 0 else float("nan")


def _spread(sweep: Sweep, name: str, of_use: NDArray[np.bool_]) -> dict[str, Any]:
    values = sweep.table[name].to_numpy().astype(float) / METRICS[_SHOWN[name]][2]
    there = of_use & np.isfinite(values)
    if not there.any():
        nothing = dict.fromkeys(("median", "percentile_5", "percentile_95", "worst", "worst_run"))
        return {**nothing, "runs": 0}
    low, median, high = np.percentile(values[there], [5, 50, 95])
    worst = int(np.argmax(np.where(there, values, -np.inf)))
    return {
        "median": float(median),
        "percentile_5": float(low),
        "percentile_95": float(high),
        "worst": float(values[worst]),
        "worst_run": worst,
        "runs": int(there.sum()),
    }


def _correlations(sweep: Sweep, lost: NDArray[np.bool_]) -> list[dict[str, Any]]:
    answers = {_SHOWN[name]: sweep.table[name].to_numpy() for name in main_metrics(sweep)}
    found = []
    for name in sweep.inputs:
        column = sweep.table[name].to_numpy()
        for metric, values in answers.items():
            there = ~lost & np.isfinite(values)
            if there.sum() >= _FEWEST:
                found.append({"input": name, "with": metric, "spearman": spearman(column[there], values[there])})
        if len(column) >= _FEWEST:
            found.append({"input": name, "with": "lost", "spearman": spearman(column, lost)})
    found = [each for each in found if np.isfinite(each["spearman"])]
    return sorted(found, key=lambda each: -abs(each["spearman"]))


def _reach(sweep: Sweep) -> dict[str, Any]:
    short, unheld = sweep.table["shortfall_max"].to_numpy(), sweep.table["unheld"].to_numpy()
    out_of_reach = np.nan_to_num(short) > 0
    worst = int(np.argmax(np.nan_to_num(short)))
    return {
        "runs_stiffness_out_of_reach": int(out_of_reach.sum()),
        "shortfall_max": float(short[worst]) if out_of_reach.any() else 0.0,
        "shortfall_max_run": worst if out_of_reach.any() else None,
        "runs_angle_unheld": int(np.sum(unheld > 0)),
        "runs_out_of_reach": int(np.sum(out_of_reach | (unheld > 0))),
    }


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
