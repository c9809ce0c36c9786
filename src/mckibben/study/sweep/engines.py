"""Who computes the blocks of a sweep: threads of this process."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import closing

from mckibben.numerics.lanes import worked_off
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

    finished = worked_off(compute, len(missing), 1, workers)
    with closing(finished):  # type: ignore[arg-type]  # it is a generator
        for _, block in finished:
            span = plan.span(block)
            done(span.stop - span.start)
