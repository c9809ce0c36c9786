"""Execution of the blocks of a sweep: threads of this process, or a dask cluster."""

from __future__ import annotations

import logging
import signal
import uuid
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from typing import Any

from mckibben.errors import McKibbenError, ParameterError, SimulationError
from mckibben.numerics.batching import cores, map_chunks
from mckibben.study.sweep.store import Store

Done = Callable[[int], None]
"""Is called with the number of runs that have been added."""


def on_threads(store: Store, done: Done, workers: int | None = None) -> None:
    """Compute the missing blocks, several at once; the thread that computes one keeps it.

    When this ends early, blocks that are under way are finished and kept first.

    Parameters
    ----------
    store
        Where they are missing.
    done
        Called here after each block, in order.
    workers
        Threads; one a core unless given.
    """
    plan, missing = store.plan, store.missing

    def compute(piece: slice) -> int:
        block = missing[piece.start]
        store.keep(block, plan.job(plan.part(block)))
        return block

    finished = map_chunks(compute, len(missing), 1, workers)
    with closing(finished):  # type: ignore[arg-type]  # it is a generator
        for _, block in finished:
            span = plan.span(block)
            done(span.stop - span.start)


LOCAL = "local"
_DEATHS = 5  # workers that may die over one block before the scheduler gives it up
_RETRIES = 2  # times that it is given to the scheduler again: more is the block's fault
_WAIT = 60  # s for the first worker
_SCHEMES = ("tcp://", "tls://", "ws://", "wss://", "ucx://")


def check_address(address: str) -> None:
    """Raise unless it is one that `on_cluster` takes, and dask is installed.

    Raises
    ------
    ParameterError
        If it is not; it says what to do.
    """
    if address != LOCAL and not address.startswith(_SCHEMES):
        raise ParameterError(
            f"{address!r} is no dask cluster", value=address, remedy="give local, or an address like tcp://host:8786"
        )
    try:
        import distributed  # noqa: F401
    except ImportError:
        raise ParameterError(
            "dask's package `distributed` is not installed", remedy="pip install 'mckibben[sweep]'"
        ) from None


def on_cluster(store: Store, done: Done, address: str, workers: int | None = None) -> None:
    """Compute the missing blocks on a cluster; their answers come back here and are kept here.

    A worker that dies costs time: its blocks are computed by others.

    Parameters
    ----------
    store
        Where they are missing.
    done
        Called here after each block.
    address
        "local" for one process a core on this machine, or that of a scheduler.
    workers
        Local processes.

    Raises
    ------
    SimulationError
        If the cluster does not answer, or a block keeps killing its workers.
    """
    from distributed import CancelledError, as_completed
    from distributed.comm.core import CommClosedError
    from distributed.scheduler import KilledWorker

    plan, waiting = store.plan, iter(store.missing)
    deaths: Counter[int] = Counter()
    with _quiet(), _client(address, workers or cores(), len(store.missing)) as client:
        under_way: dict[Any, int] = {}

        def submit(block: int) -> Any:
            # A name of its own: what a scheduler remembers of an earlier one may come of other software.
            future = client.submit(plan.job, plan.part(block), key=f"mckibben-sweep-{block}-{uuid.uuid4().hex}")
            under_way[future] = block
            return future

        def keep(future: Any) -> None:
            answer = future.result()
            block = under_way.pop(future)
            store.keep(block, answer)
            span = plan.span(block)
            done(span.stop - span.start)

        def more() -> Iterator[Any]:
            """As many as keep all workers busy while answers travel."""
            most = 2 * max(sum(client.nthreads().values()), 1)
            while len(under_way) < most and (block := next(waiting, None)) is not None:
                yield submit(block)

        finished = as_completed(more(), loop=client.loop)
        try:
            for future in finished:
                try:
                    keep(future)
                except (KilledWorker, CancelledError):
                    block = under_way.pop(future)
                    if deaths[block] >= _RETRIES or client.status != "running":
                        raise
                    deaths[block] += 1
                    finished.add(submit(block))
                for another in more():
                    finished.add(another)
        except KeyboardInterrupt:
            for future in [future for future in under_way if future.status == "finished"]:
                keep(future)
            raise
        except (CommClosedError, CancelledError, TimeoutError):
            kept = f"{store.runs} of {plan.rows} runs are kept"
            raise SimulationError(
                f"the connection to {address} is lost; {kept}", remedy="go on with --resume (resume=True)"
            ) from None
        except KilledWorker as error:
            raise SimulationError(f"workers die again and again: {error}", remedy="see their logs") from None


@contextmanager
def _quiet() -> Iterator[None]:
    """Dask tells of lost connections at length, with tracebacks; what matters of it becomes an error of ours."""
    loggers = [
        logging.getLogger(name) for name in ("distributed", "distributed.client", "tornado.application", "asyncio")
    ]
    levels = [logger.level for logger in loggers]
    for logger in loggers:
        logger.setLevel(logging.CRITICAL + 1)
    try:
        yield
    finally:
        for logger, level in zip(loggers, levels, strict=True):
            logger.setLevel(level)


@contextmanager
def _client(address: str, workers: int, blocks: int) -> Iterator[Any]:
    """A connection; to a cluster of its own, which ends with it, or to one that stays."""
    from dask import config
    from distributed import Client, LocalCluster

    if address != LOCAL:
        try:
            client = Client(address, timeout="10s", set_as_default=False)
        except (OSError, TimeoutError, ValueError) as error:
            raise _unanswered(address, error) from None
        with client:
            try:
                client.wait_for_workers(1, timeout=_WAIT)
            except TimeoutError as error:
                raise _unanswered(f"{address} has no workers", error) from None
            yield client
        return
    quiet = {"distributed.scheduler.allowed-failures": _DEATHS, "distributed.logging.distributed": "critical"}
    with config.set(quiet):
        cluster = LocalCluster(
            n_workers=min(workers, blocks),
            threads_per_worker=1,
            processes=True,
            dashboard_address=None,  # type: ignore[arg-type]  # none
            memory_limit=0,  # a share of the memory says nothing about what a block needs
            silence_logs=logging.CRITICAL,
        )
        with cluster, Client(cluster, set_as_default=False) as client:
            client.register_plugin(_deaf())
            yield client


def _unanswered(what: str, error: BaseException) -> McKibbenError:
    return SimulationError(f"no answer: {what} ({error})", remedy="is the scheduler running, and has it workers?")


def _deaf() -> Any:
    """Lets workers of ours go on when Ctrl-C reaches all processes of the terminal: the client decides."""
    from distributed import WorkerPlugin

    class Deaf(WorkerPlugin):
        def setup(self, worker: Any) -> None:
            try:
                signal.signal(signal.SIGINT, signal.SIG_IGN)
            except ValueError:  # not in the main thread
                return

    return Deaf()
