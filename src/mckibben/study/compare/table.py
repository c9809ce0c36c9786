"""The table of all runs of a comparison, as a NetCDF file that also holds the suite."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from mckibben.dataset.schema import load_netcdf, write_netcdf
from mckibben.errors import FileError, Problem
from mckibben.simulation import Batch, Metrics
from mckibben.study.compare.runs import Runs
from mckibben.study.compare.suite import Suite


def write_table(
    suite: Suite, runs: Runs, batches: Mapping[str, Batch], tuned: Mapping[str, Mapping[str, float]], path: Path
) -> None:
    """Write metrics and outcomes along ``controller`` and ``run``, along ``run`` their conditions, and the suite."""
    import xarray as xr

    first = next(iter(batches.values())).table["outcome"]
    columns: dict[str, Any] = {
        name: (("controller", "run"), np.stack([batch.metrics[name] for batch in batches.values()]))
        for name in Metrics._fields
    }
    codes = np.stack([batch["outcome"] for batch in batches.values()])
    flags = {key: first.attrs[key] for key in ("flag_values", "flag_meanings")}
    columns["outcome"] = ("controller", "run"), codes, flags
    columns |= {"joint": ("run", np.array(runs.joint, dtype=str))}
    columns |= {"reference": ("run", np.array(runs.reference_name, dtype=str))}
    columns |= {name: ("run", values) for name, values in runs.conditions.items()}
    for reference, varied in runs.reference_values.items():
        rows = np.array([name == reference for name in runs.reference_name])
        for name, values in varied.items():
            column = columns.setdefault(name, ("run", np.full(runs.count, np.nan)))[1]
            column[rows] = values
    attrs = {"title": suite.name, "tuned": json.dumps(tuned), "suite": suite.dumps(folder=path.parent)}
    write_netcdf(xr.Dataset(columns, coords={"controller": list(batches)}, attrs=attrs), path)


def read_runs(path: Path) -> tuple[Suite, dict[str, dict[str, float]], int]:
    """Return suite, tuned values and number of runs from a file written by `write_table`."""
    table = load_netcdf(path)
    try:
        suite, tuned, count = table.attrs["suite"], json.loads(table.attrs["tuned"]), table.sizes["run"]
    except (KeyError, ValueError):
        remedy = "run the comparison again in another folder"
        raise FileError(str(path), [Problem("it is not a result of a comparison", remedy=remedy)]) from None
    return Suite.parse(suite, source=str(path), folder=path.parent), tuned, count
