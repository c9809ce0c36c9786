"""The gradient of a cost with respect to six gains, in units of our own single episode."""

from __future__ import annotations

from pathlib import Path

import jax
import numpy as np
import ours
from engines.plain_c import PlainC
from numpy.typing import NDArray
from reference import PERIOD, SUBSTEPS, Problem, gains_of, numbers, with_gains
from rows import Candidate, Table
from timing import Bench

from mckibben.numerics.compiled import numeric
from mckibben.simulation.loop import compiled_episode
from mckibben.units import bar

OWN = "ours, one episode"
LARGEST = np.array([2, 60, 0.4, 0.08, 5, 0.04]) * bar  # gains that matter
STEP = 1e-4  # of them, of the central differences
AGREED = 1e-5  # what central differences are good for


def gradient(problem: Problem, folder: Path, *, quick: bool) -> Table:
    """The table of gradients."""
    bench = Bench(rounds=7 if quick else 15, budget=1.0 if quick else 4.0)
    truth: list[NDArray[np.float64]] = []

    def own() -> Candidate:
        traced = jax.device_put(numeric((problem.plant, problem.pid, problem.setpoints, problem.start, PERIOD)))
        run = lambda: jax.block_until_ready(compiled_episode(*traced, SUBSTEPS))  # noqa: E731
        return Candidate(OWN, run, base=OWN, note="the loop by XLA")

    def by_c() -> Candidate:
        gains, steps = gains_of(problem.pid), STEP * LARGEST
        moved = [gains + sign * np.where(np.arange(6) == i, steps, 0) for i in range(6) for sign in (1, -1)]
        lanes = np.array([numbers(problem.plant, with_gains(problem.pid, values)) for values in moved])
        metrics = PlainC(folder).metrics(problem, lanes)

        def run() -> NDArray[np.float64]:
            costs = metrics().sum(axis=1)
            return (costs[::2] - costs[1::2]) / (2 * steps)

        truth.append(run())
        note = f"12 episodes; steps of {STEP:.0e} of a usual gain: not exact"
        return Candidate("plain C, central differences", run, note=note, base=OWN)

    def exact() -> Candidate:
        if not truth:
            raise OSError("there is no plain C to compare with")
        run = ours.gradient(problem)
        scaled, expected = run() * LARGEST, truth[0] * LARGEST
        off = float(np.abs(scaled - expected).max() / np.abs(expected).max())
        return Candidate("ours, differentiate", run, 1.0, off, AGREED, "exact: six tangents at once", OWN)

    bench.add(OWN, own)
    bench.add("plain C, central differences", by_c)
    bench.add("ours, differentiate", exact)
    notes = (
        "Of the sum of the RMS errors of angle [rad] and stiffness [N*m/rad] over the episode.",
        "Deviation: the largest from the central differences, each part times a usual gain, as a part of the largest; "
        f"beyond {AGREED:.0e} nothing is timed.",
    )
    return Table("Gradient with respect to six gains", "gradient", "time", "gradient", bench.timed(), notes)
