"""One block of a sweep: some rows of the table in, columns of answers out; what threads and workers compute."""

from __future__ import annotations

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

import mckibben
from mckibben.errors import SimulationError
from mckibben.study.many import run_many
from mckibben.study.parameters import Table
from mckibben.study.scenario import Scenario
from mckibben.study.sweep.attainable import attainability

Columns = dict[str, NDArray]
"""Answers by name, one value a run."""


def software() -> dict[str, str]:
    """What computes here, and on what: other versions give other last bits."""
    return {"mckibben": mckibben.__version__, "jax": jax.__version__, "platform": jax.default_backend()}


@dataclass(frozen=True)
class Job:
    """What all blocks of a sweep share; it travels to other processes.

    Attributes
    ----------
    scenario
        With its nominal values.
    metrics
        Which are computed.
    precision
        64 or 32 bits.
    lanes
        Runs that are computed together. A block is filled up to a multiple of it, so that there is one program, and a
        run's numbers do not depend on who computes it.
    software
        What the process has to have; see `software`.
    known
        Numbers of the plant that the controller's model follows.
    """

    scenario: Scenario
    metrics: tuple[str, ...]
    precision: int
    lanes: int
    software: dict[str, str]
    known: tuple[str, ...] = ()

    def __call__(self, table: Table) -> Columns:
        """The answers to some rows.

        Raises
        ------
        SimulationError
            If this process has other software than the one that planned the sweep.
        """
        here = software()
        if here != self.software:
            raise SimulationError(
                f"a worker has {_listed(here)}, the sweep {_listed(self.software)}",
                remedy="start workers in the same environment",
            )
        rows = len(next(iter(table.values())))
        filling = -rows % self.lanes
        full = {name: np.concatenate([column, np.repeat(column[-1:], filling)]) for name, column in table.items()}
        batch = run_many(
            self.scenario,
            full,
            known=self.known,
            metrics=self.metrics,
            precision=jnp.float32 if self.precision == 32 else jnp.float64,
            chunk=self.lanes,
            workers=1,
        )
        answers = {name: batch.table[name].to_numpy() for name in (*self.metrics, "outcome")}
        answers |= attainability(self.scenario, full, self.lanes)
        return {name: column[:rows] for name, column in answers.items()}


def _listed(software: dict[str, str]) -> str:
    return ", ".join(f"{name} {version}" for name, version in software.items())
