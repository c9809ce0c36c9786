"""Sweeps: run a plan, store its blocks in a journal, and continue an interrupted sweep."""

from __future__ import annotations

import hashlib
import os
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from mckibben.component.calls import checked_call
from mckibben.errors import FileError, ParameterError, Problem
from mckibben.notebook import Progress, notebook_progress
from mckibben.scenario import Known, Scenario
from mckibben.simulation.software import engine_of_job
from mckibben.storage.files import check_free, explain_write_errors, file_lock, make_folder
from mckibben.storage.journal import Journal, JournalReader, JournalRecord, array_record, read_header, unpack_arrays
from mckibben.study.sweep.compute import Columns, check_cluster, compute_on_cluster, compute_on_threads
from mckibben.study.sweep.plan import (
    FORMAT,
    VERSION,
    Sweepable,
    SweepOptions,
    SweepPlan,
    manifest_differences,
    parse_part,
)
from mckibben.study.sweep.result import SweepResult

JOURNAL = "sweep.journal"
TABLE = "sweep.nc"
_BLOCK, _TABLE = b"B", b"T"  # kinds of records; the table's record holds the digest of its file


class SweepStore:
    """Blocks of a sweep in a journal with the manifest as header; use `begin` or `resume` inside `lock`."""

    def __init__(self, folder: Path, plan: SweepPlan) -> None:
        self.folder = folder
        self.plan = plan
        self.kept: set[int] = set()
        self._journal: Journal | None = None

    @contextmanager
    def lock(self) -> Iterator[None]:
        """Lock out other processes; creates the folder if needed."""
        make_folder(self.folder)
        writing = explain_write_errors(self.folder, self._kept, "make room, and continue with --resume (resume=True)")
        with file_lock(self.folder / ".lock", "computing this sweep"), writing:
            try:
                yield
            finally:
                if self._journal is not None:
                    self._journal.close()

    def _kept(self) -> str:
        return "" if self._journal is None else f"{self.runs} of {self.plan.rows} runs are kept"

    def begin(self) -> None:
        """Create the journal."""
        check_unused(self.folder)
        self._journal = Journal.create(self.folder / JOURNAL, self.plan.header)

    def resume(self) -> None:
        """Open the journal and find the intact blocks; warn of damaged ones, which count as missing."""
        reader = JournalReader(self.folder / JOURNAL)
        self.kept = {record.number for record in reader if record.kind == _BLOCK}
        self._journal = Journal.resume(reader)
        reader.warn_of_damage("blocks")

    @property
    def missing(self) -> list[int]:
        """Blocks that are not stored."""
        return [block for block in self.plan.blocks if block not in self.kept]

    @property
    def runs(self) -> int:
        """Number of stored runs."""
        spans = [self.plan.block_rows(block) for block in self.kept]
        return sum(span.stop - span.start for span in spans)

    def keep(self, block: int, columns: Columns) -> None:
        """Append the results of a block; thread-safe."""
        assert self._journal is not None
        self._journal.append(array_record(_BLOCK, block, columns))
        self.kept.add(block)

    def columns(self) -> Columns:
        """Results of all runs."""
        parts: dict[int, Columns] = {}
        for record in JournalReader(self.folder / JOURNAL):
            if record.kind == _BLOCK:
                parts[record.number] = unpack_arrays(record.payload)
        if len(parts) < len(self.plan.blocks):
            problem = Problem("blocks are damaged", remedy="recompute them with --resume (resume=True)")
            raise FileError(str(self.folder / JOURNAL), [problem])
        ordered = [parts[block] for block in self.plan.blocks]
        return {name: np.concatenate([part.pop(name) for part in ordered]) for name in list(ordered[0])}  # freed early

    def write_table(self, swept: SweepResult) -> None:
        """Write the table."""
        swept.to_netcdf(self.folder / TABLE)
        assert self._journal is not None
        self._journal.append(JournalRecord(_TABLE, 0, self._digest()))

    def read_table(self) -> SweepResult | None:
        """The table, if the file is unchanged."""
        digests = [record.payload for record in JournalReader(self.folder / JOURNAL) if record.kind == _TABLE]
        try:
            return SweepResult.from_netcdf(self.folder / TABLE) if digests[-1:] == [self._digest()] else None
        except OSError:  # missing
            return None

    def _digest(self) -> bytes:
        with (self.folder / TABLE).open("rb") as file:
            return hashlib.file_digest(file, "sha256").digest()


def check_unused(folder: Path) -> None:
    """Raise an error if a folder contains a sweep, or files of the same names."""
    if (folder / JOURNAL).exists():
        remedy = "continue it with --resume (resume=True), or choose another folder"
        raise FileError(str(folder), [Problem("a sweep already exists", remedy=remedy)])
    check_free(folder, [JOURNAL, TABLE])


def read_manifest(folder: Path) -> dict[str, Any]:
    """Manifest of the sweep in a folder."""
    if not (folder / JOURNAL).is_file():
        problem = Problem(f"there is no sweep to continue ({JOURNAL})", remedy="leave --resume (resume=True) out")
        raise FileError(str(folder), [problem])
    return read_header(folder / JOURNAL, FORMAT, VERSION)


class InterruptedSweep(KeyboardInterrupt):
    """Ctrl-C during a sweep; the text says how many runs are stored, and where."""


@checked_call
def sweep(
    scenario: Scenario,
    over: Sweepable | None = None,
    *,
    out: str | os.PathLike[str] | None = None,
    design: str | None = None,
    samples: int | None = None,
    seed: int | None = None,
    metrics: Sequence[str] | None = None,
    precision: int | None = None,
    resume: bool = False,
    dask: str | None = None,
    workers: int | None = None,
    block: int | None = None,
    known: Known | None = None,
    engine: str = "auto",
    part: str | None = None,
    source: str = "",
    progress: Progress | None = None,
) -> SweepResult:
    """Simulate a scenario many times with some of its parameters varied.

    The runs are computed in blocks, each stored when finished. The numbers are identical to the last bit for any number
    of threads or processes, and after any number of interruptions.

    Parameters
    ----------
    scenario
        Scenario with the nominal values.
    over
        Varied parameters: texts such as "load.mass2=0.2 kg..1.0 kg" (see `parse_sweep`), or distributions [SI] by name.
    out
        Output folder. Default: nothing is stored.
    design, samples, seed
        Sampling as for `mckibben.study.parameters.sample`. Defaults: "sobol", 1024 and 0.
    metrics
        Metrics to compute. Default: all.
    precision
        64 or 32 bits; 32 bits take half the time and give five digits, fewer with an encoder. Default: 64.
    resume
        Continue the sweep in `out`. Options left out are taken from it; others must match.
    dask
        "local" for processes on this machine, or the address of a dask scheduler. Default: threads.
    workers
        Threads or local processes. Default: one per core.
    block
        Runs per block. Default: chosen by the number of runs.
    known
        Varied plant parameters that the controller's model follows, "all" for all of them. Default: none; the
        controller's model is the scenario's in all runs.
    engine
        As for `simulate_many`; one engine computes all runs. Default: that of the sweep that is continued, or "auto".
    part
        "k/n": compute the k-th of n parts of the runs only; `merge` joins them. Default: all runs.
    source
        Origin of the scenario, for the record.
    progress
        Called with the current step and the completed fraction, 0 to 1. Default: a progress bar in notebooks.

    Raises
    ------
    ParameterError
        If an option is invalid, or a row of values does not give a valid scenario.
    FileError
        If `out` contains a sweep or files of these names and `resume` is not set; with `resume`, if it contains none or
        a different one; if another process is computing it; or if the disk is full.
    InterruptedSweep
        On Ctrl-C; finished blocks are stored.

    Examples
    --------
    >>> scenario = Scenario.read("examples/pre-contracted-step-pid.yaml").replace(duration=0.2)
    >>> swept = sweep(scenario, ["load.mass2=0.4 kg..0.6 kg"], samples=4, metrics=["angle_rmse"])
    >>> swept.table["load.mass2"].to_numpy().round(3)
    array([0.482, 0.551, 0.512, 0.431])
    """
    options = SweepOptions(over, design, samples, seed, metrics, precision, block, known)
    if dask is not None:
        check_cluster(dask)
    which = (1, 1) if part is None else parse_part(part)
    settings = (dask, workers, progress or notebook_progress())
    if out is None:
        if resume:
            raise ParameterError("there is no sweep to continue", remedy="give its folder")
        with tempfile.TemporaryDirectory(prefix="mckibben-") as folder:
            store = SweepStore(Path(folder), _planned(scenario, options, source=source, engine=engine, part=which))
            with store.lock():
                store.begin()
                return _computed(store, *settings)
    folder = Path(out)
    if resume:
        manifest = read_manifest(folder)
        source = manifest.get("source", "")
        engine = engine_of_job(str, manifest["software"], engine)
        which = tuple(manifest["part"]) if part is None else parse_part(part)
        about = {"folder": os.fspath(out), "source": source, "engine": engine}
        plan = SweepPlan.of(scenario, options.completed(manifest), part=which, **about)
        if found := manifest_differences(manifest, plan.header):
            raise FileError(str(folder), found)
        store = SweepStore(folder, plan)
        if (finished := store.read_table()) is not None:
            return finished
        with store.lock():
            if (finished := store.read_table()) is not None:  # by another process in the meantime
                return finished
            store.resume()
            return _stored(store, *settings)
    check_unused(folder)
    store = SweepStore(
        folder, _planned(scenario, options, folder=os.fspath(out), source=source, engine=engine, part=which)
    )
    with store.lock():
        store.begin()
        return _stored(store, *settings)


def _planned(scenario: Scenario, options: SweepOptions, *, engine: str, **about: Any) -> SweepPlan:
    """Plan of a new sweep, whose engine is known to compute its runs."""
    plan = SweepPlan.of(scenario, options, engine=engine, **about)
    return plan.with_engine(engine_of_job(lambda: plan.task.engines_used(plan.table), engine=engine))


def _reporting(progress: Progress | None, runs: int) -> Callable[[int], None]:
    """Callback for the number of finished runs that also reports their rate."""
    calls, began = 0, (0.0, 0)

    def report(done: int) -> None:
        nonlocal calls, began
        calls, now = calls + 1, time.monotonic()
        if calls <= 2:  # the first block includes compilation
            began = (now, done)
        text = f"{done} of {runs} runs"
        if done > began[1] and now > began[0] + 1:
            text += f", {(done - began[1]) / (now - began[0]):.4g} runs/s"
        if progress:
            progress(text, done / runs)

    return report


def _stored(store: SweepStore, *settings: Any) -> SweepResult:
    """Compute the missing blocks and write the table."""
    try:
        swept = _computed(store, *settings)
        store.write_table(swept)
    except KeyboardInterrupt:
        text = f"{store.runs} of {store.plan.rows} runs are kept in {store.folder}; continue with --resume"
        raise InterruptedSweep(text) from None
    return swept


def _computed(store: SweepStore, dask: str | None, workers: int | None, progress: Progress | None) -> SweepResult:
    plan, before = store.plan, store.runs
    done = before
    report = _reporting(progress, plan.rows)
    report(done)
    if store.missing:
        blocks = ((block, plan.block_table(block)) for block in store.missing)
        if dask is None:
            finished = compute_on_threads(plan.task, blocks, store.keep, workers)
        else:
            finished = compute_on_cluster(plan.task, blocks, store.keep, dask, workers)
        with closing(finished):  # type: ignore[arg-type]  # they are generators
            for block in finished:
                rows = plan.block_rows(block)
                done += rows.stop - rows.start
                report(done)
    return SweepResult.of(plan, store.columns(), plan.rows - before)
