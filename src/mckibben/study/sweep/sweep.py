"""Sweeps: many runs of a scenario over ranges of its parameters."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import jax
import numpy as np

from mckibben.component.calls import checked_call
from mckibben.errors import SimulationError
from mckibben.notebook import Progress
from mckibben.scenario import ModelFollows, StudiedScenario, batched, followed_names, run_many
from mckibben.simulation import Batch
from mckibben.simulation.accuracy import STEP_COLUMNS
from mckibben.simulation.batch import rows_of
from mckibben.simulation.engine import CHUNK, ON_ACCELERATOR, VECTOR
from mckibben.simulation.metrics import Metrics, usual_metrics
from mckibben.simulation.problem import check_frequencies, check_names
from mckibben.simulation.software import engine_of_job, software
from mckibben.study.cluster import check_cluster
from mckibben.study.scenarios import ScenarioStudy, Sweepable, begun_settings
from mckibben.study.study import Table, select
from mckibben.study.sweep.result import SweepResult


@dataclass(frozen=True, eq=False, kw_only=True)
class Sweep(ScenarioStudy):
    """A sweep of a scenario: its rows are the values of the varied parameters, its records metrics and outcomes."""

    metrics: tuple[str, ...]
    model_follows: tuple[str, ...]  # varied plant parameters that the controller's model follows
    software: Mapping[str, str]  # versions, engine and compiler, required of all processes
    batch_size: int  # tables are padded to a multiple: a result must not depend on the number of runs
    block: int

    unit = "runs"
    format = "mckibben sweep"

    @classmethod
    def of(
        cls,
        scenario: StudiedScenario,
        over: Sweepable | None,
        begun: Mapping[str, Any] | None = None,
        *,
        metrics: Sequence[str] | None = None,
        model_follows: ModelFollows | None = None,
        engine: str = "auto",
        **sampling: Any,
    ) -> Sweep:
        """Return a sweep with the arguments of `sweep`; raises `ParameterError` for invalid ones."""
        begun = begun or {}
        chosen = begun.get("metrics", usual_metrics(Metrics)) if metrics is None else metrics
        check_names("metric", chosen, Metrics._fields)
        follows = begun.get("model_follows", ()) if model_follows is None else model_follows
        engine = engine_of_job(set, begun["software"], engine) if begun else engine
        settings: dict[str, Any] = {"metrics": tuple(chosen), "model_follows": (), "software": software(engine)}
        study = super().of(scenario, over, begun, **sampling, **settings, batch_size=0, block=0)
        check_frequencies(study.scenarios(study.rows()).references(), scenario.control_period)
        batch_size, block = _sizes(study.samples, engine)
        followed = followed_names(scenario, follows, [parameter.name for parameter in study.swept])
        return replace(study, model_follows=followed, batch_size=batch_size, block=block)

    def about(self) -> dict[str, object]:
        """Return all that determines the numbers, as JSON."""
        return {
            **super().about(),
            "model_follows": list(self.model_follows),
            "metrics": list(self.metrics),
            "block": self.block,
            "batch_size": self.batch_size,
            "software": dict(self.software),
        }

    def scenarios(self, rows: Table) -> StudiedScenario:
        """Return the scenarios of some rows as one; the controller's model has the values of `model_follows`."""
        return batched(self.scenario, rows, model_follows=self.model_follows)

    def compute(self, rows: Table, /) -> Table:
        """Return metrics, outcomes and integration steps; raises `SimulationError` with other software."""
        engine = self.software["engine"]
        here = software("auto" if engine == "native" else engine)
        if here != self.software:
            message = f"a worker has {_listed(here)}, the sweep {_listed(self.software)}"
            raise SimulationError(message, remedy="start workers in the same environment")
        count = len(next(iter(rows.values())))
        padding = -count % self.batch_size
        full = {name: np.concatenate([column, np.repeat(column[-1:], padding)]) for name, column in rows.items()}
        batch = self._simulate(full, chunk=self.batch_size, engine=engine)
        named = {name: rows_of(batch.table[name]) for name in (*self.metrics, "outcome", *STEP_COLUMNS)}
        columns = {f"{name}.{of}".rstrip("."): row for name, rows in named.items() for of, row in rows.items()}
        return select(columns, slice(count))  # such as ``angle_rmse.hip``

    def block_size(self) -> int:
        """Return the number of runs that are computed and kept together."""
        return self.block

    def with_known_engine(self, engine: str) -> Sweep:
        """Return the sweep with the engine that computes all its runs, as a trial shows."""
        trial = lambda: {self._simulate(select(self.rows(), slice(1))).engine}  # noqa: E731
        return replace(self, software=software(engine_of_job(trial, engine=engine)))

    def _simulate(self, rows: Table, **options: Any) -> Batch:
        settings = {"model_follows": self.model_follows, "metrics": self.metrics, "workers": 1}
        return run_many(self.scenario, dict(rows), **settings, **options)


@checked_call
def sweep(
    scenario: StudiedScenario,
    over: Sweepable | None = None,
    *,
    out: str | os.PathLike[str] | None = None,
    design: str | None = None,
    samples: int | None = None,
    seed: int | None = None,
    metrics: Sequence[str] | None = None,
    resume: bool = False,
    dask: str | None = None,
    workers: int | None = None,
    model_follows: ModelFollows | None = None,
    engine: str = "auto",
    progress: Progress | None = None,
) -> SweepResult:
    """Simulate a scenario many times with some of its parameters varied.

    The runs are computed in blocks, each kept in `out`/study.sqlite when finished. The numbers are identical to the
    last bit for any number of threads or processes, and after any number of interruptions.

    Parameters
    ----------
    scenario
        Scenario with the nominal values.
    over
        Varied parameters: texts such as "load.mass2=0.2 kg..1.0 kg" (see `parse_sweep`), or distributions [SI] by name.
    out
        Folder of the study. Default: nothing is kept.
    design, samples, seed
        Sampling as for `mckibben.study.parameters.sample`. Defaults: "sobol", 1024 and 0.
    metrics
        Metrics to compute, by joint for a robot. Default: all but `coupling`.
    resume
        Continue the sweep in `out`. Options left out are taken from it; others must match.
    dask
        Address of a dask scheduler, to whose workers the blocks go. Default: threads of this process.
    workers
        Threads. Default: one per core.
    model_follows
        Varied plant parameters that the controller's model follows, "all" for all of them. Default: none; the
        controller's model is the scenario's in all runs.
    engine
        As for `simulate_many`; one engine computes all runs. Default: that of the sweep that is continued, or "auto".
    progress
        Called with the current step and the completed fraction, 0 to 1. Default: a progress bar in notebooks.

    Raises
    ------
    ParameterError
        If an option is invalid, or a row of values does not give a valid scenario.
    FileError
        If `out` has a study and `resume` is not set; with `resume`, if it has none or a different one; if another
        process is computing it; or if the disk is full.
    InterruptedStudy
        On Ctrl-C; finished blocks are kept.

    Examples
    --------
    >>> from mckibben.scenario import Scenario
    >>> scenario = Scenario.read("examples/pre-contracted-step-pid.yaml").replace(duration=0.2)
    >>> swept = sweep(scenario, ["load.mass2=0.4 kg..0.6 kg"], samples=4, metrics=["angle_rmse"])
    >>> swept.table["load.mass2"].to_numpy().round(3)
    array([0.482, 0.551, 0.512, 0.431])
    """
    if dask is not None:
        check_cluster(dask)
    begun = begun_settings(out, Sweep.format, resume=resume)
    folder = "." if out is None else os.fspath(out)
    sampling: dict[str, Any] = {"design": design, "samples": samples, "seed": seed, "folder": folder}
    settings: dict[str, Any] = {"metrics": metrics, "model_follows": model_follows, "engine": engine}
    study = Sweep.of(scenario, over, begun, **settings, **sampling)
    study = study if begun else study.with_known_engine(engine)
    records = study.run(out, resume=resume, workers=workers, dask=dask, progress=progress)
    inputs = {parameter: records.rows[parameter.name] for parameter in study.swept}
    return SweepResult.of(scenario, study.about(), inputs, records.columns, records.computed)


def _sizes(rows: int, engine: str = "auto") -> tuple[int, int]:
    """Runs per batch, and runs per block; functions of the number of runs, the platform and CUDA alone.

    A CPU gets 16 batches or more, as long as they fill a vector, and up to 256 blocks of up to 64 batches: an
    interruption loses one block per thread.
    """
    cpu = jax.default_backend() == "cpu" and engine != "cuda"
    batches, largest = (16, CHUNK) if cpu else (1, ON_ACCELERATOR)
    batches = max(batches, -(-rows // largest))  # of equal size, so that the last one needs little padding
    batch_size = -(-rows // batches // VECTOR) * VECTOR
    return batch_size, batch_size * min(max(rows // (batch_size * 256), 1), 64 if cpu else 4)


def _listed(versions: Mapping[str, str]) -> str:
    return ", ".join(f"{name} {version}" for name, version in versions.items())
