"""Computation of a sweep's blocks, on threads of this process or on a dask cluster."""

from __future__ import annotations

import logging
import signal
import uuid
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, ArrayLike
from numpy.typing import NDArray

from mckibben.component.extensions import load_missing, loaded_extensions
from mckibben.control.base import Reference
from mckibben.errors import McKibbenError, ParameterError, SimulationError
from mckibben.joint.attainable import is_affine
from mckibben.numerics.batching import cores, lanes_of, map_chunks, pad_chunk
from mckibben.numerics.calculus import evenly_spaced
from mckibben.numerics.compiled import jit_lanes, numeric
from mckibben.plant import JointPlant
from mckibben.scenario import Scenario, batched, run_many
from mckibben.simulation import Batch
from mckibben.simulation.accuracy import STEP_COLUMNS
from mckibben.simulation.feasibility import attainable_band
from mckibben.simulation.problem import sample_reference, sampling_times
from mckibben.simulation.software import software
from mckibben.study.parameters import Table

FEASIBILITY = {
    "shortfall_max": ("N*m/rad", "largest distance of the stiffness reference from the attainable stiffness"),
    "infeasible_time": ("1", "share of the time in which no pressures within limits hold the reference angle"),
}
"""Unit and meaning of the variables that `feasibility` returns."""

_INSTANTS = 200
_INSTANTS_WITH_SPRINGS = 50  # each costs as much as 100 with rigid tendons
_ROUNDING = 1e-6  # N*m/rad


class _Case(NamedTuple):
    """A plant, its reference, and the amplitude [rad] of its stiffness."""

    plant: JointPlant
    reference: Reference
    amplitude: Any = None


def feasibility(scenario: Scenario, table: Table, size: int) -> dict[str, NDArray[np.float64]]:
    """Variables of `FEASIBILITY` of each run at several instants; the shortfall is NaN if no angle can be held."""
    many = batched(scenario, table)
    case = numeric(_Case(many.plant(), many.reference(), many.controller.stiffness_amplitude))
    times = sampling_times(scenario.duration, scenario.control_period)
    count = _INSTANTS if is_affine(case.plant.joint) else _INSTANTS_WITH_SPRINGS
    instants = times[evenly_spaced(times.size, count)]
    rows = len(next(iter(table.values())))
    varied_rows, varying = lanes_of(case)
    if varied_rows is None:  # only the controller differs between runs
        nothing = _Case(None, None)  # type: ignore[arg-type]
        found = {name: np.asarray(value) for name, value in _feasibility(nothing, case, instants, 1).items()}
        return {name: np.broadcast_to(value, rows).copy() for name, value in found.items()}
    varied, shared = eqx.partition(case, varying)
    parts = []
    for start in range(0, rows, size):
        piece = slice(start, min(start + size, rows))
        found = _feasibility(pad_chunk(varied, piece, size), shared, instants, size)
        parts.append({name: np.asarray(value)[: piece.stop - start] for name, value in found.items()})
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}


@jit_lanes
def _feasibility(varied: _Case, shared: _Case, instants: ArrayLike, size: int) -> dict[str, Array]:
    """Scan over instants, with all runs in parallel: a joint with springs needs much memory per instant."""

    def shortfall(lane: _Case, instant: Array) -> Array:
        plant, reference, amplitude = eqx.combine(lane, shared)
        setpoint = sample_reference(reference, instant)
        low, high = attainable_band(plant, setpoint.angle, amplitude)
        return jnp.maximum(low - setpoint.stiffness, setpoint.stiffness - high)

    def step(carry: tuple[Array, Array], instant: Array) -> tuple[tuple[Array, Array], None]:
        largest, infeasible = carry
        short = jax.vmap(shortfall, in_axes=(0, None), axis_size=size)(varied, instant)
        return (jnp.fmax(largest, short), infeasible + jnp.isnan(short)), None

    initial = jnp.full(size, jnp.nan), jnp.zeros(size)
    (largest, infeasible), _ = lax.scan(step, initial, jnp.asarray(instants))
    largest = jnp.where(largest > _ROUNDING, largest, jnp.where(jnp.isnan(largest), jnp.nan, 0.0))
    return {"shortfall_max": largest, "infeasible_time": infeasible / jnp.size(instants)}


Columns = dict[str, NDArray]
"""Results by name, one value per run."""


@dataclass(frozen=True)
class BatchTask:
    """Computation of the rows of a table; picklable."""

    scenario: Scenario
    metrics: tuple[str, ...]
    precision: int  # bits
    batch_size: int  # tables are padded to a multiple: a result must not depend on the number of runs
    software: dict[str, str]  # versions, engine and compiler required of the process
    known: tuple[str, ...] = ()  # plant parameters that the controller's model follows

    def __call__(self, table: Table) -> Columns:
        """Return the results of some rows; raises SimulationError if the software differs."""
        engine = self.software["engine"]
        here = software("auto" if engine == "native" else engine)
        if here != self.software:
            raise SimulationError(
                f"a worker has {_listed(here)}, the sweep {_listed(self.software)}",
                remedy="start workers in the same environment",
            )
        rows = len(next(iter(table.values())))
        padding = -rows % self.batch_size
        full = {name: np.concatenate([column, np.repeat(column[-1:], padding)]) for name, column in table.items()}
        batch = self._run(full, chunk=self.batch_size, engine=engine)
        results = {name: batch.table[name].to_numpy() for name in (*self.metrics, "outcome", *STEP_COLUMNS)}
        results |= feasibility(self.scenario, full, self.batch_size)
        return {name: column[:rows] for name, column in results.items()}

    def engines_used(self, table: Table) -> set[str]:
        """Engine chosen automatically for the first run of a table."""
        return {self._run({name: column[:1] for name, column in table.items()}).engine}

    def _run(self, table: Table, **options: Any) -> Batch:
        own = {"known": self.known, "metrics": self.metrics, "precision": self.precision, "workers": 1}
        return run_many(self.scenario, table, **own, **options)


def _listed(software: dict[str, str]) -> str:
    return ", ".join(f"{name} {version}" for name, version in software.items())


LOCAL = "local"
_DEATHS = 5  # workers that may die on one block before the scheduler gives up
_RETRIES = 2  # resubmissions of a block whose workers died
_WAIT = 60  # s for the first worker
_SCHEMES = ("tcp://", "tls://", "ws://", "wss://", "ucx://")

Blocks = Iterable[tuple[int, Table]]
"""Block numbers and their tables."""


def compute_on_threads(
    task: BatchTask, blocks: Blocks, keep: Callable[[int, Columns], None], workers: int | None = None
) -> Iterator[int]:
    """Compute blocks on threads, which call `keep`; yield finished blocks. If closed early, running blocks are kept."""
    listed = list(blocks)

    def compute(piece: slice) -> int:
        block, table = listed[piece.start]
        keep(block, task(table))
        return block

    finished = map_chunks(compute, len(listed), 1, workers)
    with closing(finished):  # type: ignore[arg-type]  # it is a generator
        for _, block in finished:
            yield block


def check_cluster(address: str) -> None:
    """Raise ParameterError unless dask is installed and the address has a valid form."""
    if address != LOCAL and not address.startswith(_SCHEMES):
        raise ParameterError(
            f"{address!r} is not a dask cluster", value=address, remedy="give local, or an address like tcp://host:8786"
        )
    try:
        import distributed  # noqa: F401
    except ImportError:
        raise ParameterError(
            "dask's package `distributed` is not installed", remedy="pip install 'mckibben[sweep]'"
        ) from None


def compute_on_cluster(
    task: BatchTask, blocks: Blocks, keep: Callable[[int, Columns], None], address: str, workers: int | None = None
) -> Iterator[int]:
    """Compute blocks on a dask cluster and call `keep` here; yield finished blocks. Dead workers are replaced."""
    from distributed import CancelledError, as_completed
    from distributed.comm.core import CommClosedError
    from distributed.scheduler import KilledWorker

    tables = dict(blocks)
    waiting = iter(tables)
    deaths: Counter[int] = Counter()
    with _quiet(), _client(address, workers or cores(), len(tables)) as client:
        pending: dict[Any, int] = {}

        def submit(block: int) -> Any:
            # A unique key: a scheduler's earlier results may come from other software.
            future = client.submit(task, tables[block], key=f"mckibben-sweep-{block}-{uuid.uuid4().hex}")
            pending[future] = block
            return future

        def collect(future: Any) -> int:
            columns = future.result()
            block = pending.pop(future)
            keep(block, columns)
            return block

        def more() -> Iterator[Any]:
            """Submit enough to keep all workers busy while results travel."""
            limit = 2 * max(sum(client.nthreads().values()), 1)
            while len(pending) < limit and (block := next(waiting, None)) is not None:
                yield submit(block)

        finished = as_completed(more(), loop=client.loop)
        try:
            for future in finished:
                try:
                    yield collect(future)
                except (KilledWorker, CancelledError):
                    block = pending.pop(future)
                    if deaths[block] >= _RETRIES or client.status != "running":
                        raise
                    deaths[block] += 1
                    finished.add(submit(block))
                for another in more():
                    finished.add(another)
        except (KeyboardInterrupt, GeneratorExit):
            for future in [future for future in pending if future.status == "finished"]:
                collect(future)
            raise
        except (CommClosedError, CancelledError, TimeoutError):
            raise SimulationError(
                f"the connection to {address} is lost; finished blocks are kept",
                remedy="continue with --resume (resume=True)",
            ) from None
        except KilledWorker as error:
            raise SimulationError(f"workers die repeatedly: {error}", remedy="see their logs") from None


@contextmanager
def _quiet() -> Iterator[None]:
    """Silence dask's tracebacks about lost connections, which we report as errors."""
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
    """Client of a scheduler, or of a temporary cluster on this machine."""
    from dask import config
    from distributed import Client, LocalCluster

    if address != LOCAL:
        try:
            client = Client(address, timeout="10s", set_as_default=False)
        except (OSError, ValueError) as error:
            raise _unanswered(address, error) from None
        with client:
            try:
                client.wait_for_workers(1, timeout=_WAIT)
            except TimeoutError as error:
                raise _unanswered(f"{address} has no workers", error) from None
            _load_extensions(client)
            yield client
        return
    quiet = {"distributed.scheduler.allowed-failures": _DEATHS, "distributed.logging.distributed": "critical"}
    with config.set(quiet):
        try:
            cluster = LocalCluster(
                n_workers=min(workers, blocks),
                threads_per_worker=1,
                processes=True,
                dashboard_address=None,  # none
                memory_limit=0,  # a share of the memory is unrelated to the needs of a block
                silence_logs=logging.CRITICAL,
            )
        except (OSError, RuntimeError) as error:  # for example because a worker was killed
            message = f"the workers on this machine did not start ({error})"
            raise SimulationError(message, remedy="run it again with --resume, or without dask") from error
        with cluster, Client(cluster, set_as_default=False) as client:
            client.register_plugin(_ignore_interrupts())
            _load_extensions(client)
            yield client


def _unanswered(what: str, error: BaseException) -> McKibbenError:
    return SimulationError(f"no answer: {what} ({error})", remedy="is the scheduler running, and does it have workers?")


def _load_extensions(client: Any) -> None:
    """Load the extensions of this process in all workers, now and when they start later."""
    from distributed import WorkerPlugin

    extensions = loaded_extensions()

    class LoadExtensions(WorkerPlugin):
        def setup(self, worker: Any) -> None:
            load_missing(extensions)

    if extensions:
        client.register_plugin(LoadExtensions())


def _ignore_interrupts() -> Any:
    """Plugin of local workers: Ctrl-C reaches all processes of the terminal, but only the client handles it."""
    from distributed import WorkerPlugin

    class IgnoreInterrupts(WorkerPlugin):
        def setup(self, worker: Any) -> None:
            try:
                signal.signal(signal.SIGINT, signal.SIG_IGN)
            except ValueError:  # not in the main thread
                return

    return IgnoreInterrupts()
