"""Integration steps per control period, chosen by step doubling over whole runs for an accuracy of the angle.

The error of a solution is estimated as its distance from that with twice the steps, which is many times as accurate.
Richardson's extrapolation would estimate the error of the finer one, but needs an order: where muscles go slack or
friction slips, the acceleration has kinks at any place within a step, and the ratio of two such distances is between 1
and 40 instead of 16. There the extrapolated error was found to be 0.04 to 60 times the true one, the distance of the
coarser solution 0.4 to 1.7 times. Where that might decide, the solution with four times the steps is taken as well.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Mapping
from numbers import Real
from typing import Any, NamedTuple

import jax
import numpy as np
from numpy.typing import NDArray

from mckibben.component.columns import Label, declare
from mckibben.errors import McKibbenWarning, SimulationError
from mckibben.numerics.batching import map_chunks
from mckibben.simulation.engine import VECTOR
from mckibben.units import HINGE, JointType

ACCURACY = 1e-6
"""Default accuracy of the angle [rad]."""
BLOCK = 1024
"""Consecutive runs of a batch that share a number of integration steps."""

_LOWEST = {32: 1e-6, 64: 1e-12}  # accuracy [rad] above rounding, by the bits of the floats
STEP_COLUMNS = {
    "substeps": Label("1", "integration steps per control period"),
    "error_estimate": Label("rad", "estimated integration error of the angle"),
    "chaotic": Label("1", "found to be chaotic: solutions with more integration steps do not converge"),
}
"""Columns of `StepCounts`."""
declare(__name__, STEP_COLUMNS)

_DOUBLINGS = 7  # from 1 to 128 steps
_FALLING = 1 / 4  # change of the error over three doublings, below which the solution still converges
_CERTAIN = 0.1  # of the accuracy: a larger error is checked with four times the steps
_SAME_END = 1e-3  # rad, and relative: distance of two solutions where both diverge, below which the plant does
_FALLBACK_DOUBLINGS = 2  # of a block without a resolved run
_RANDOM, _EXTREME = 4, 28  # probed runs of a block

Positions = NDArray[np.floating]
"""Positions [rad], those of a trunk [m], shape (positions, periods, runs)."""
Runs = NDArray[np.int64]
"""Indices of runs."""
Solve = Callable[[int, Runs], Positions]
"""Positions of some runs with a number of integration steps per control period."""


class Resolution(NamedTuple):
    """Integration steps per control period of a run, and its error as estimated by step doubling."""

    substeps: int  # per control period
    error: float = math.nan  # largest distance of the angle from that with twice the steps [rad]; NaN for given steps
    unresolved_from: float = math.nan  # time from which these are further apart than the accuracy [s]; NaN for none
    chaotic: bool = False  # whether the error does not fall with the number of steps

    @classmethod
    def of(cls, attributes: Mapping[Any, Any]) -> Resolution | None:
        """From the attributes of a table; None without them."""
        if any(name not in attributes for name in cls._fields):
            return None
        substeps, error, unresolved_from, chaotic = (attributes[name] for name in cls._fields)
        return cls(int(substeps), float(error), float(unresolved_from), bool(chaotic))

    @property
    def attributes(self) -> dict[str, Any]:
        """Attributes of a table."""
        return self._asdict() | {"chaotic": int(self.chaotic)}

    @property
    def resolved(self) -> bool:
        """Whether the two solutions agree; true as well for a given number of steps."""
        return math.isnan(self.unresolved_from)

    def batch_substeps(self, first: int) -> int:
        """Integration steps with which many runs like this one reach the accuracy; `first` are the fewest possible.

        Those of this run; if it is chaotic, four times the fewest.
        """
        return 2**_FALLBACK_DOUBLINGS * first if self.chaotic else self.substeps

    def describe(self, joint_type: JointType = HINGE) -> str:
        """The estimated error of the angle of a joint in a sentence."""
        angle, unit = joint_type.words("angle"), joint_type.unit("rad")
        steps = f"{self.substeps} integration step{'s' if self.substeps > 1 else ''} per control period"
        if math.isnan(self.error):
            return f"{steps}, the integration error is not estimated"
        if self.resolved:
            return f"estimated integration error of the {angle}: {self.error:.1e} {unit} ({steps})"
        if math.isinf(self.error):
            return (
                f"not resolved: from {self.unresolved_from:.4g} s on, solutions with {self.substeps} and "
                f"{2 * self.substeps} integration steps per control period diverge differently: the plant is unstable, "
                "or the steps are too long for it"
            )
        if not self.chaotic:
            since = f"from {self.unresolved_from:.4g} s on the {angle} is less accurate than asked"
            return f"not resolved: {since}; estimated integration error: {self.error:.1e} {unit} ({steps})"
        return (
            f"not resolved: this run is chaotic; from {self.unresolved_from:.4g} s on, solutions with "
            f"{self.substeps} and {2 * self.substeps} integration steps per control period separate, by up to "
            f"{self.error:.2g} {unit}, so that its metrics hold as statistics only"
        )


def check_accuracy(accuracy: Any, substeps: Any = None, bits: int = 64) -> None:
    """Raise `SimulationError` unless an accuracy [rad] can be reached, or a given number of steps is an integer."""
    if substeps is not None:
        if isinstance(substeps, bool) or not isinstance(substeps, int) or substeps < 1:
            remedy = "give an integer from 1 up, or leave it out to reach the accuracy"
            raise SimulationError(f"substeps is {substeps!r}", field="substeps", value=substeps, remedy=remedy)
        return
    number = float(accuracy) if isinstance(accuracy, Real) and not isinstance(accuracy, bool) else math.nan
    if not 0 < number < math.inf:
        remedy = "give an angle in rad above 0"
        raise SimulationError(f"accuracy is {accuracy!r}", field="accuracy", value=accuracy, remedy=remedy)
    if number < _LOWEST[bits] * (1 - 1e-9):
        _raise_unreachable(number, _LOWEST[bits], f"rounding to {bits} bits", ", or 64 bits" if bits == 32 else "")


def _raise_unreachable(accuracy: float, reachable: float, why: str, otherwise: str = "") -> None:
    digits = 10 ** (math.floor(math.log10(reachable)) - 1)
    lowest = float(f"{math.ceil(reachable / digits - 1e-9) * digits:.1e}")
    message = f"an accuracy of {accuracy:g} rad is beyond {why}"
    remedy = f"give {lowest:g} rad or more{otherwise}"
    raise SimulationError(message, field="accuracy", value=accuracy, lower=lowest, unit="rad", remedy=remedy)


_KEPT = 20_000  # instants at which step doubling compares solutions


def spacing(periods: int) -> int:
    """Control periods between two instants at which solutions are compared: a divisor of their number."""
    least = -(-periods // _KEPT)
    return next((every for every in range(least, 10 * least) if periods % every == 0), 1)


def full_vectors(runs: Runs) -> Runs:
    """Runs repeated to fill vectors of 64-bit numbers: XLA compiles a program for each number of them."""
    return np.resize(runs, -(-runs.size // (VECTOR // 2)) * (VECTOR // 2))


class Refinement(NamedTuple):
    """Result of step doubling by run."""

    substeps: NDArray[np.int64]  # the fewest that agree with twice as many
    error: NDArray[np.float64]  # [rad]
    unresolved_from: NDArray[np.float64]  # time at which the last two solutions separate [s]; NaN with agreement
    converges: NDArray[np.bool_]  # whether the error falls with the number of steps
    errors: NDArray[np.float64]  # by doubling and run, NaN after agreement
    first: int

    @property
    def resolved(self) -> NDArray[np.bool_]:
        """Mask of the runs with agreement."""
        return np.isnan(self.unresolved_from)


def refine(
    solve: Solve,
    count: int,
    *,
    accuracy: float,
    spacing: float,
    first: int = 1,
    meaningful: Callable[[Positions, Runs], NDArray[np.bool_]] | None = None,
) -> Refinement:
    """Double the integration steps of runs until two solutions agree while they are finite and `meaningful`.

    Two solutions that end early need to be close to each other there: steps that are too long diverge, too, but each
    number of them in its own way.

    Parameters
    ----------
    solve
        Function of a number of steps per control period and of indices of runs, which returns their positions.
    count
        Number of runs.
    accuracy
        Largest distance of two solutions that agree [rad].
    spacing
        Time between two positions [s].
    first
        Fewest steps, with which the integration is stable.
    meaningful
        Function of positions and indices of runs: mask, shape (times, runs), of those that count.
    """
    runs, substeps = np.arange(count), first
    errors = np.full((_DOUBLINGS, count), np.nan)
    refinement = Refinement(
        np.full(count, first), np.zeros(count), np.full(count, np.nan), np.ones(count, bool), errors, first
    )

    def distance(coarse: Positions, fine: Positions) -> Positions:
        """Distances while the finer solution counts, shape (times, runs)."""
        counts = np.isfinite(fine).all(axis=0)
        if meaningful is not None:
            counts &= meaningful(fine, runs)
        with np.errstate(invalid="ignore", over="ignore"):
            apart = np.minimum(np.abs(fine - coarse).max(axis=0), np.finfo(float).max)
        apart[np.isnan(apart)] = np.inf
        if counts.all():  # the common case
            return apart
        counts = np.logical_and.accumulate(counts, axis=0)
        ends = np.zeros_like(counts)
        ends[1:] = counts[:-1] & ~counts[1:]
        with np.errstate(invalid="ignore", over="ignore"):
            alike = apart < _SAME_END * (1 + np.abs(fine).max(axis=0))
        return np.where(counts, apart, np.where(ends & ~alike, np.inf, 0.0))

    coarse, fine = solve(substeps, runs), solve(2 * substeps, runs)
    for doubling in range(_DOUBLINGS):
        apart = distance(coarse, fine)
        finer, error = None, apart.max(axis=0)
        if np.any((error <= accuracy) & (error > _CERTAIN * accuracy)) and doubling < _DOUBLINGS - 1:
            finer = solve(4 * substeps, runs)
            apart = np.maximum(apart, distance(coarse, finer))
            error = apart.max(axis=0)
        within = error <= accuracy
        refinement.substeps[runs] = substeps
        refinement.error[runs] = errors[doubling, runs] = error
        refinement.unresolved_from[runs] = np.where(within, np.nan, (apart > accuracy).argmax(axis=0) * spacing)
        if within.all() or doubling == _DOUBLINGS - 1:
            break
        runs, coarse, substeps = runs[~within], fine[..., ~within], 2 * substeps
        fine = solve(2 * substeps, runs) if finer is None else finer[..., ~within]
    refinement.converges[:] = refinement.resolved | (errors[-1] < _FALLING * errors[-4])
    return refinement


def resolution_of(refined: Refinement, accuracy: float) -> Resolution:
    """Resolution of one run with the coarser of the last two solutions; `SimulationError` for too fine an accuracy."""
    substeps, error, unresolved_from, converges = (column[0].item() for column in refined[:4])
    if converges and not math.isnan(unresolved_from) and accuracy < ACCURACY:
        _raise_unreachable(accuracy, error, f"{substeps} integration steps per control period")
    return Resolution(substeps, error, unresolved_from, not converges)


class StepCounts(NamedTuple):
    """Integration steps per control period of the runs of a batch, and their estimated errors [rad]."""

    substeps: NDArray[np.int64]
    error: NDArray[np.float64]  # largest of the block if not probed; NaN if chaotic, or for given steps
    chaotic: NDArray[np.bool_]

    @classmethod
    def given(cls, substeps: int, count: int) -> StepCounts:
        """The same number of steps for all runs."""
        return cls(np.full(count, substeps), np.full(count, np.nan), np.zeros(count, bool))

    def warn_of(self, accuracy: float) -> None:
        """Warn of runs whose estimated error is above the accuracy [rad]."""
        count = int(np.sum(self.error > accuracy))
        if count:
            worst = np.nanmax(self.error)
            most = f"up to {worst:.1e} rad" if np.isfinite(worst) else "some diverge, at each number differently"
            text = f"{count} runs are less accurate than {accuracy:g} rad: {most}"
            warnings.warn(f"{text}, with {int(self.substeps.max())} substeps at most", McKibbenWarning, stacklevel=3)

    def columns(self) -> dict[str, NDArray[Any]]:
        """Columns of a table of runs."""
        return {"substeps": self.substeps, "error_estimate": self.error, "chaotic": self.chaotic.astype(np.int8)}

    def summary(self) -> dict[str, Any]:
        """Largest number of steps, largest estimated error, and number of chaotic runs, as plain data."""
        errors = self.error[np.isfinite(self.error)]
        return {
            "substeps": int(self.substeps.max()),
            "error_estimate_rad": float(errors.max()) if errors.size else None,
            "runs_chaotic": int(self.chaotic.sum()),
        }


def integration_sentence(summary: Mapping[str, Any]) -> str:
    """Sentence on the integration error, from `StepCounts.summary`."""
    error, chaotic = summary["error_estimate_rad"], summary["runs_chaotic"]
    known = "not estimated" if error is None else f"estimated at no more than {error:.1e} rad"
    some = f"; {chaotic} runs were found to be chaotic: their metrics hold as statistics only" if chaotic else ""
    steps = "1 integration step" if summary["substeps"] == 1 else f"up to {summary['substeps']} integration steps"
    return f"integration error of the angle {known} ({steps} per control period){some}"


def refine_blocks(
    lanes: Any, count: int, refine_runs: Callable[[Runs], Refinement], workers: int | None = None
) -> StepCounts:
    """Return the number of steps for each block of 1024 consecutive runs, which some of them represent.

    Parameters
    ----------
    lanes
        Tree of arrays with the runs along the first axis.
    count
        Number of runs.
    refine_runs
        Function of indices of runs: their `Refinement`.
    workers
        Threads; None for one per core.
    """
    blocks = range(0, count, BLOCK)

    def refined(piece: slice) -> tuple[Runs, Refinement]:
        start = blocks[piece.start]
        runs = start + probed_runs(jax.tree.map(lambda leaf: leaf[start : start + BLOCK], lanes))
        return runs, refine_runs(runs)

    steps = StepCounts.given(1, count)
    for piece, (runs, refinement) in map_chunks(refined, len(blocks), 1, workers):
        block = slice(blocks[piece.start], blocks[piece.start] + BLOCK)
        first, converging = refinement.first, refinement.converges
        most = refinement.substeps[converging].max() / first if converging.any() else 2**_FALLBACK_DOUBLINGS
        doublings = round(math.log2(most))
        errors = np.where(np.isnan(refinement.errors[doublings]), refinement.error, refinement.errors[doublings])
        steps.substeps[block] = first * 2**doublings
        steps.error[block] = errors[refinement.converges].max(initial=0.0) if refinement.converges.any() else np.nan
        steps.error[runs] = np.where(refinement.converges, errors, np.where(np.isinf(refinement.error), np.inf, np.nan))
        steps.chaotic[runs] = ~refinement.converges & np.isfinite(refinement.error)
    return steps


def probed_runs(lanes: Any) -> Runs:
    """Runs of a block that represent it: first, lowest and highest of each varied number, and a few random ones."""
    leaves = [np.asarray(leaf) for leaf in jax.tree.leaves(lanes)]
    count = len(leaves[0])
    if count <= _RANDOM + _EXTREME:
        return np.arange(count)
    random = np.random.default_rng(0)
    numbers = [np.reshape(leaf, (count, -1)).astype(float).sum(axis=1) for leaf in leaves]
    extremes = list(dict.fromkeys(int(find(x)) for x in numbers for find in (np.argmin, np.argmax)))
    if len(extremes) > _EXTREME:
        extremes = random.choice(extremes, _EXTREME, replace=False).tolist()
    return np.unique([0, *extremes, *random.choice(count, _RANDOM, replace=False)])
