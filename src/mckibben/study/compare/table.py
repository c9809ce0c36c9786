"""The table of all runs of a benchmark, as a NetCDF file that also holds the suite."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from mckibben.errors import FileError, Problem
from mckibben.simulation import Metrics
from mckibben.study.compare.compare import BenchmarkResult
from mckibben.study.compare.suite import Suite

if TYPE_CHECKING:
    import xarray as xr


def table_of(result: BenchmarkResult) -> xr.Dataset:
    """All runs along ``controller`` and ``run``: metrics and outcomes; along ``run`` their conditions."""
    import xarray as xr

    batches = result.batches
    names = list(batches)
    table: dict[str, Any] = {
        name: (("controller", "run"), np.stack([batches[each].metrics[name] for each in names]))
        for name in Metrics._fields
    }
    codes = np.stack([batches[each].table["outcome"].to_numpy() for each in names])
    flags = {key: batches[names[0]].table["outcome"].attrs[key] for key in ("flag_values", "flag_meanings")}
    table["outcome"] = (("controller", "run"), codes, flags)
    table["joint"] = ("run", np.array(result.runs.joint, dtype=str))
    table["reference"] = ("run", np.array(result.runs.reference_name, dtype=str))
    for name, values in result.runs.conditions.items():
        table[name] = ("run", values)
    for reference, columns in result.runs.reference_values.items():
        rows = np.array([each == reference for each in result.runs.reference_name])
        for name, values in columns.items():
            column = table.get(name, ("run", np.full(result.runs.count, np.nan)))[1]
            column[rows] = values
            table[name] = ("run", column)
    found = xr.Dataset(table, coords={"controller": names}, attrs={"title": result.suite.name})
    found.attrs["tuned"] = json.dumps(result.tuned)
    return found


def write_table(result: BenchmarkResult, path: Path) -> None:
    """Write `table_of` and the suite to a NetCDF file."""
    from mckibben.dataset.schema import write_netcdf

    write_netcdf(table_of(result).assign_attrs(suite=result.suite.dumps(folder=path.parent)), path)


def read_runs(path: Path) -> tuple[Suite, dict[str, dict[str, float]], int]:
    """Suite, tuned values and number of runs from a file written by `write_table`."""
    from mckibben.dataset.schema import load_netcdf

    table = load_netcdf(path)
    try:
        suite, tuned, count = table.attrs["suite"], json.loads(table.attrs["tuned"]), table.sizes["run"]
    except (KeyError, ValueError):
        remedy = "run the comparison again in another folder"
        raise FileError(str(path), [Problem("it is not a result of a comparison", remedy=remedy)]) from None
    return Suite.parse(suite, source=str(path), folder=path.parent), tuned, count
