"""Run a sweep: plan it, compute the blocks that are missing, put the table together."""

from __future__ import annotations

import os
import tempfile
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from mckibben.errors import FileError, McKibbenWarning, ParameterError, Problem
from mckibben.study.parameters import Known
from mckibben.study.scenario import Scenario
from mckibben.study.sweep.engines import check_address, on_cluster, on_threads
from mckibben.study.sweep.plan import MANIFEST, Plan, Said, SweepOptions
from mckibben.study.sweep.result import SweepResult
from mckibben.study.sweep.store import TABLE, Store


class InterruptedSweep(KeyboardInterrupt):
    """Ctrl-C in the middle of a sweep; its text says how much is kept, and where."""


def sweep(
    scenario: Scenario,
    over: Said | None = None,
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
    source: str = "",
    progress: Callable[[int, int], None] | None = None,
) -> SweepResult:
    """Simulate a scenario many times, with some of its numbers varied.

    The work is cut into blocks, each of which is kept as soon as it is finished. The numbers are the same to the last
    bit however many threads or processes compute them, and however often the work was interrupted.

    Parameters
    ----------
    scenario
        What all runs share.
    over
        What is varied: texts such as "load.mass2=0.2 kg..1.0 kg" (see `parse_sweep`), or spreads in SI by name.
    out
        A folder for manifest, blocks and table; without one nothing is kept.
    design, samples, seed
        As for `mckibben.study.parameters.sampling`: "sobol", 1024 and 0 unless given.
    metrics
        Which to compute; all unless given.
    precision
        64 bits, or 32: half the time, and some 6 digits.
    resume
        Go on with the sweep in `out`. What is left out is taken from there; what is given must be the same.
    dask
        "local" for processes on this machine, or the address of a dask scheduler; threads unless given.
    workers
        Threads, or local processes; one a core unless given.
    block
        Runs that are kept in one file; chosen by their number unless given.
    known
        Varied numbers of the plant that the controller's model follows, "all" for all of them. None unless given: the
        controller's model is that of the scenario in all runs.
    source
        Where the scenario came from, for the record.
    progress
        Called with the runs that are done, and all.

    Raises
    ------
    ParameterError
        If what is asked makes no sense, or a row of values makes no valid scenario.
    FileError
        If `out` has a sweep, or other files in the way, and `resume` is not set; or has none, or another one; if
        another process is computing it; or if the disk is full.
    InterruptedSweep
        On Ctrl-C, with what is finished kept.

    Examples
    --------
    >>> scenario = Scenario.read("examples/pre-contracted-step-pid.yaml").model_copy(update={"duration": 0.2})
    >>> swept = sweep(scenario, ["load.mass2=0.4 kg..0.6 kg"], samples=4, metrics=["angle_rmse"])
    >>> swept.table["load.mass2"].to_numpy().round(3)
    array([0.482, 0.551, 0.512, 0.431])
    """
    asked = SweepOptions(over, design, samples, seed, metrics, precision, block, known)
    if dask is not None:
        check_address(dask)
    if out is None:
        if resume:
            raise ParameterError("there is nothing to go on with", remedy="say in which folder it is")
        with tempfile.TemporaryDirectory(prefix="mckibben-") as folder:
            store = Store(Path(folder))
            store.begin(Plan.of(scenario, asked, source=source))
            return _finished(store, dask, workers, progress)
    store = Store(Path(out))
    if resume:
        return _resumed(store, scenario, asked, (dask, workers, progress))
    store.check_free()
    plan = Plan.of(scenario, asked, folder=os.fspath(out), source=source)
    with store.lock():
        store.begin(plan)
        return _kept(store, dask, workers, progress)


def _resumed(store: Store, scenario: Scenario, asked: SweepOptions, engine: tuple[Any, ...]) -> SweepResult:
    begun = store.begun()
    if begun is None:
        problem = Problem(f"there is no sweep to go on with ({MANIFEST})", remedy="leave --resume (resume=True) out")
        raise FileError(str(store.path), [problem])
    plan = Plan.of(scenario, asked.filled(begun), folder=os.fspath(store.path), source=begun.get("source", ""))
    store.go_on(plan, begun)
    there = _complete(store)
    if there is not None:  # and need not be written to
        return there
    with store.lock():
        there = _complete(store)  # by whoever was there until now
        if there is not None:
            return there
        for path in store.look():
            warnings.warn(f"{path} is damaged and is computed again", McKibbenWarning, stacklevel=3)
        return _kept(store, *engine)


def _complete(store: Store) -> SweepResult | None:
    """The sweep of a store, if its table is there."""
    try:
        there = SweepResult.from_netcdf(store.path / TABLE)
    except FileError:
        return None  # not yet there, or damaged: the blocks have all of it
    return there if there.table.attrs.get("identity") == store.plan.identity else None


def _kept(store: Store, *engine: Any) -> SweepResult:
    """The sweep, with its table written; or how much is kept of it."""
    try:
        swept = _finished(store, *engine)
        store.check_room(swept.table.nbytes)
        with store.room():
            swept.to_netcdf(store.path / TABLE)
        store.tidy()
    except KeyboardInterrupt:
        text = f"{store.runs} of {store.plan.rows} runs are kept in {store.path}; go on with --resume"
        raise InterruptedSweep(text) from None
    return swept


def _finished(
    store: Store, dask: str | None, workers: int | None, progress: Callable[[int, int], None] | None
) -> SweepResult:
    plan, before = store.plan, store.runs
    runs = before

    def done(more: int) -> None:
        nonlocal runs
        runs += more
        if progress:
            progress(runs, plan.rows)

    if progress:
        progress(before, plan.rows)
    if store.missing:
        if dask is None:
            on_threads(store, done, workers)
        else:
            on_cluster(store, done, dask, workers)
    return SweepResult.of(plan, store.columns(), plan.rows - before)
