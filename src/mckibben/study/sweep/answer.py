"""What a sweep answers: one table, inputs beside metrics and outcomes, with all that made it."""

from __future__ import annotations

import json
import os
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from numpy.typing import NDArray

from mckibben.errors import FileError, ParameterError, Problem
from mckibben.files import whole
from mckibben.simulation import Metrics, Outcome
from mckibben.simulation.outcome import OUTCOMES
from mckibben.simulation.result import attributes
from mckibben.study.parameters import with_values
from mckibben.study.scenario import Scenario
from mckibben.study.sweep.attainable import REACH
from mckibben.study.sweep.block import Columns
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
        ``unheld``, of which `mckibben.study.sweep.attainable` tells. Its attributes say what made it.
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
        return np.array([outcome.lost for outcome in OUTCOMES])[self.table["outcome"].to_numpy()]

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
