"""Search of the pressures and their timing for the highest jump."""

from __future__ import annotations

import itertools
import zlib
from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array
from numpy.typing import NDArray

from mckibben.numerics.compiled import numeric
from mckibben.robot.control import PressureSchedule
from mckibben.robot.plant import RobotPlant, RobotStart
from mckibben.robot.simulate import robot_metrics, simulate_robots
from mckibben.simulation.batch import Batch
from mckibben.simulation.engine import BatchFunction, dynamic_steps
from mckibben.simulation.problem import sampling_times
from mckibben.storage.store import Job

Floats = NDArray[np.float64]

_GENERATIONS, _POPULATION = 80, 10  # of differential evolution; the latter for each variable
_POLISHING = 30  # iterations of L-BFGS-B
LANES = 16
"""Runs of one vector: a single height is computed as one of so many."""


class ScheduleVariables(eqx.Module):
    """Schedules by variables from 0 to 1: levels of the muscles, and, if timed, two switching times of each."""

    held: tuple[Any, ...]  # pressures of the start [Pa]
    low: Any  # range of the levels [Pa]
    high: Any
    latest: Any  # switching time [s]
    timed: bool = eqx.field(static=True)  # each muscle switches twice; else all change once, at the start

    @property
    def size(self) -> int:
        """Number of variables."""
        return len(self.held) * (4 if self.timed else 1)

    def schedule(self, variables: Any) -> PressureSchedule:
        """Return the schedule of variables, shape (size, ...)."""
        n = len(self.held)
        x = [variables[i] for i in range(self.size)]
        level: list[Any] = [self.low + (self.high - self.low) * one for one in x[: n * (2 if self.timed else 1)]]
        if not self.timed:
            return PressureSchedule(tuple((own,) for own in level))
        first = [self.latest * one for one in x[2 * n : 3 * n]]
        second = [at + (self.latest - at) * one for at, one in zip(first, x[3 * n :], strict=True)]
        levels: Any = tuple((self.held[i], level[i], level[n + i]) for i in range(n))
        return PressureSchedule(levels, tuple(zip(first, second, strict=True)))


class JumpRuns(NamedTuple):
    """Jumps of a plant from a start: heights to which the centre of mass rises, and their gradient."""

    plant: RobotPlant
    start: RobotStart
    variables: ScheduleVariables
    duration: float
    step: float
    substeps: int  # those that the first schedule needs, so that all jumps have the same
    engine: str = "auto"

    def simulate(self, variables: Floats) -> Batch:
        """Metrics of jumps for columns of variables."""
        steps = {"control_period": self.step, "substeps": self.substeps, "engine": self.engine}
        schedule = self.variables.schedule(np.asarray(variables))
        return simulate_robots(self.plant, schedule, self.start, duration=self.duration, **steps)

    def heights(self, variables: Floats) -> Floats:
        """Height [m] of the apex for columns of variables; 0 where the foot stays on the ground."""
        found = self.simulate(variables)["apex"]
        return np.where(np.isfinite(found), found, 0.0)

    def height_and_gradient(self, variables: Floats) -> tuple[float, Floats]:
        """Height [m] of `heights`, and its gradient by forward differentiation: a direction in each lane."""
        x = np.asarray(variables, float)
        times, period = sampling_times(self.duration, self.step), np.asarray(self.step)
        steps = dynamic_steps(self.substeps)
        shared = numeric((self.plant, self.start, self.variables, x, times, period)), steps
        (value, gradient), _ = _derivative(self.engine, shared, np.eye(x.size))
        return float(np.asarray(value)[0]), np.asarray(gradient)


@BatchFunction
def _derivative(shared: Any, direction: Any) -> tuple[Array, Array]:
    """Height of a jump, and its derivative in one direction."""
    (plant, start, given, variables, times, period), steps = shared

    def height(x: Array) -> Array:
        return robot_metrics(plant, given.schedule(x), start, times, period, steps).apex

    return jax.jvp(height, (variables,), (direction,))


class Evaluations:
    """Evaluations of a search by their number, kept or computed; a search repeats them in the same order."""

    def __init__(self, job: Job) -> None:
        self._job, self._number = job, itertools.count()

    def __call__(self, compute: Callable[[Floats], Floats], x: Floats) -> Floats:
        number, key = next(self._number), np.array([float(zlib.crc32(np.ascontiguousarray(x).tobytes()))])
        if number in self._job.numbers:
            block = self._job.read_arrays(number)
            if np.array_equal(block["key"], key):
                return block["found"]
        found = compute(x)
        self._job.add_arrays(number, {"key": key, "found": found})
        return found


def highest(
    runs: JumpRuns, guess: Floats | None, seed: int, evaluations: Evaluations, report: Callable[[float], object]
) -> Floats:
    """Return the variables of the highest jump found."""
    from scipy.optimize import differential_evolution, minimize

    size, generation = runs.variables.size, iter(range(1, 10_000))

    def lost_heights(x: Floats) -> Any:
        if x.ndim > 1:
            return -evaluations(runs.heights, x)
        return -evaluations(runs.heights, np.tile(x[:, None], LANES))[0]

    found = differential_evolution(
        lost_heights,
        [(0.0, 1.0)] * size,
        maxiter=_GENERATIONS,
        popsize=_POPULATION,
        rng=seed,
        x0=guess,
        polish=False,
        vectorized=True,
        updating="deferred",
        callback=lambda *_, **__: report(0.9 * next(generation) / _GENERATIONS) and None,
    )

    def height_and_gradient(x: Floats) -> Floats:
        height, gradient = runs.height_and_gradient(x)
        return np.concatenate([[height], gradient])

    def lost(x: Floats) -> tuple[float, Floats]:
        height, *gradient = evaluations(height_and_gradient, x)
        return -float(height), -np.array(gradient)

    options = {"maxiter": _POLISHING}
    polished = minimize(lost, found.x, jac=True, method="L-BFGS-B", bounds=[(0.0, 1.0)] * size, options=options)
    report(1.0)
    return np.asarray(polished.x if polished.fun <= found.fun else found.x)
