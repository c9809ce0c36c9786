"""Computation of a study's blocks on a dask cluster."""

from __future__ import annotations

import logging
import signal
import uuid
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from typing import TYPE_CHECKING

from mckibben.component.extensions import load_missing, loaded_extensions
from mckibben.errors import ParameterError, SimulationError
from mckibben.numerics.batching import cores

if TYPE_CHECKING:
    from distributed import Client, Future, Worker

    from mckibben.study.study import Table

LOCAL = "local"
_DEATHS = 8  # workers that may die on one block before the scheduler gives up
_WAIT = 60  # s for the first worker
_SCHEMES = ("tcp://", "tls://", "ws://", "wss://", "ucx://")


def check_cluster(address: str) -> None:
    """Raise `ParameterError` unless dask is installed and the address has a valid form."""
    if address != LOCAL and not address.startswith(_SCHEMES):
        message, remedy = f"{address!r} is not a dask cluster", "give local, or an address like tcp://host:8786"
        raise ParameterError(message, value=address, remedy=remedy)
    try:
        import distributed  # noqa: F401
    except ImportError:
        message = "dask's package `distributed` is not installed"
        raise ParameterError(message, remedy="pip install 'mckibben[sweep]'") from None


def compute_on_cluster(
    compute: Callable[[Table], Table],
    blocks: Mapping[int, Table],
    keep: Callable[[int, Table], None],
    address: str,
    workers: int | None = None,
) -> Iterator[int]:
    """Compute blocks by workers, and keep them here; yield their numbers. dask replaces workers that die."""
    from distributed import CancelledError, as_completed
    from distributed.comm.core import CommClosedError
    from distributed.scheduler import KilledWorker

    waiting = iter(blocks)
    with _client(address, min(workers or cores(), len(blocks))) as client:
        pending: dict[Future, int] = {}

        def submit() -> list[Future]:
            """Submit enough to keep all workers busy while results travel."""
            futures = []
            limit = 2 * max(sum(client.nthreads().values()), 1)
            while len(pending) < limit and (number := next(waiting, None)) is not None:
                key = f"mckibben-study-{number}-{uuid.uuid4().hex}"  # a scheduler's earlier results may be others
                futures.append(client.submit(compute, blocks[number], key=key))
                pending[futures[-1]] = number
            return futures

        def collect(future: Future) -> int:
            keep(pending[future], future.result())
            return pending.pop(future)

        finished = as_completed(submit(), loop=client.loop)
        try:
            for future in finished:
                yield collect(future)
                for another in submit():
                    finished.add(another)
        except (KeyboardInterrupt, GeneratorExit):
            for future in [future for future in pending if future.status == "finished"]:
                collect(future)
            raise
        except (CommClosedError, CancelledError, TimeoutError):
            message = f"the connection to {address} is lost; finished blocks are kept"
            raise SimulationError(message, remedy="continue with --resume (resume=True)") from None
        except KilledWorker as error:
            raise SimulationError(f"workers die repeatedly: {error}", remedy="see their logs") from None


@contextmanager
def _client(address: str, workers: int) -> Iterator[Client]:
    """Client of a scheduler, or of a temporary cluster on this machine; its workers have our extensions."""
    loggers = [logging.getLogger(name) for name in ("distributed", "tornado.application", "asyncio")]
    levels = [logger.level for logger in loggers]
    with ExitStack() as stack:
        for logger, level in zip(loggers, levels, strict=True):  # lost connections are reported as errors
            logger.setLevel(logging.CRITICAL + 1)
            stack.callback(logger.setLevel, level)
        try:
            client = stack.enter_context(_connected(stack, address, workers))
            client.wait_for_workers(1, timeout=_WAIT)
            _prepare_workers(client, local=address == LOCAL)
        except (OSError, RuntimeError, ValueError) as error:  # TimeoutError is an OSError
            remedy = "is the scheduler running, and does it have workers? Continue with --resume (resume=True)"
            raise SimulationError(f"no answer of the cluster {address} ({error})", remedy=remedy) from error
        yield client


def _connected(stack: ExitStack, address: str, workers: int) -> Client:
    """Client of a scheduler, or of a new cluster of local processes."""
    from dask import config
    from distributed import Client, LocalCluster

    if address != LOCAL:
        return Client(address, timeout="10s", set_as_default=False)
    settings = {"distributed.scheduler.allowed-failures": _DEATHS, "distributed.logging.distributed": "critical"}
    stack.enter_context(config.set(settings))
    cluster = LocalCluster(
        n_workers=workers,
        threads_per_worker=1,
        dashboard_address=None,  # none
        memory_limit=0,  # a share of the memory is unrelated to the needs of a block
        silence_logs=logging.CRITICAL,
    )
    return Client(stack.enter_context(cluster), set_as_default=False)


def _prepare_workers(client: Client, *, local: bool) -> None:
    """Load the extensions of this process in all workers; local ones ignore Ctrl-C, which the client handles."""
    from distributed import WorkerPlugin

    extensions = loaded_extensions()

    class Prepare(WorkerPlugin):
        def setup(self, worker: Worker) -> None:
            load_missing(extensions)
            if local:
                try:
                    signal.signal(signal.SIGINT, signal.SIG_IGN)
                except ValueError:  # not in the main thread
                    return

    client.register_plugin(Prepare())
