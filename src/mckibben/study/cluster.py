"""Computation of a study's blocks on a dask cluster."""

from __future__ import annotations

import logging
import uuid
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from typing import TYPE_CHECKING

from numpy.typing import NDArray

from mckibben.component.extensions import load_missing, loaded_extensions
from mckibben.errors import ParameterError, SimulationError

if TYPE_CHECKING:
    from distributed import Client, Future, Worker, WorkerPlugin
Block = Mapping[str, NDArray]  # rows or records by name


def check_cluster(address: str) -> None:
    """Check that dask is installed, and that an address has a valid form.

    Raises
    ------
    ParameterError
        If it is not an address such as tcp://host:8786, or the package `distributed` is missing.
    """
    if "://" not in address:
        message, remedy = f"{address!r} is not a dask cluster", "give an address like tcp://host:8786"
        raise ParameterError(message, value=address, remedy=remedy)
    try:
        import distributed  # noqa: F401
    except ImportError:
        message = "dask's package `distributed` is not installed"
        raise ParameterError(message, remedy="pip install 'mckibben[sweep]'") from None


def compute_on_cluster(
    compute: Callable[[Block], Block],
    blocks: Mapping[int, Block],
    keep: Callable[[int, Block], None],
    address: str,
) -> Iterator[int]:
    """Compute blocks by workers, and keep them here; yield their numbers. dask replaces workers that die.

    Parameters
    ----------
    compute
        Function of a block that returns its records; it is sent to the workers.
    blocks
        Rows to compute, by the numbers of their blocks.
    keep
        Called in this process with the number of a block and its records.
    address
        Address of the scheduler.

    Raises
    ------
    SimulationError
        If the scheduler does not answer, the connection is lost, or workers die repeatedly.
    """
    from distributed import CancelledError, as_completed
    from distributed.comm.core import CommClosedError
    from distributed.scheduler import KilledWorker

    waiting = iter(blocks)
    with _client(address) as client:
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
def _client(address: str) -> Iterator[Client]:
    """Client of a scheduler; its workers have our extensions."""
    from distributed import Client

    with ExitStack() as stack:
        for logger in (logging.getLogger(name) for name in ("distributed", "tornado.application", "asyncio")):
            stack.callback(logger.setLevel, logger.level)
            logger.setLevel(logging.CRITICAL + 1)  # lost connections are reported as errors
        try:
            client = stack.enter_context(Client(address, timeout="10s", set_as_default=False))
            client.wait_for_workers(1, timeout=60)
            client.register_plugin(_extended(loaded_extensions()))
        except (OSError, RuntimeError, ValueError) as error:  # TimeoutError is an OSError
            remedy = "is the scheduler running, and does it have workers? Continue with --resume (resume=True)"
            raise SimulationError(f"no answer of the cluster {address} ({error})", remedy=remedy) from error
        yield client


def _extended(extensions: Sequence[str]) -> WorkerPlugin:
    """Plugin that loads extensions in all workers."""
    from distributed import WorkerPlugin

    class Extended(WorkerPlugin):
        def setup(self, worker: Worker) -> None:
            load_missing(extensions)

    return Extended()
