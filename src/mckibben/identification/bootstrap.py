"""Bootstrap in blocks: the fit repeated on whole repeats, strokes or pressures drawn anew.

Each refit keeps the points where they are and counts them as often as their block was drawn, so that nothing is
compiled anew, and starts at the fit to all.

References
----------
A. Davison and D. Hinkley, "Bootstrap Methods and their Application", Cambridge 1997, sections 2.4 and 3.8;
T. Hesterberg, "What teachers should know about the bootstrap", The American Statistician 69 (2015) 371-386, for the
wider percentiles.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mckibben.errors import IdentificationError, RangeError
from mckibben.identification.bands import Band, Interval, check_level, quantile
from mckibben.identification.bounded import solve_between_bounds
from mckibben.identification.draws import law_forces
from mckibben.identification.evidence import Evidence
from mckibben.identification.fit import Fit
from mckibben.identification.groups import Grouping, group_labels
from mckibben.identification.projection import solve_by_projection
from mckibben.identification.uncertainty import CONDITION_LIMIT, condition
from mckibben.muscle import ForceLaw

FEWEST_BLOCKS = 8
"""Of blocks drawn with replacement: with fewer, the draws are too few and too alike."""
_MOST_FAILED = 0.1


@dataclass(frozen=True, eq=False)
class Bootstrap:
    """Refits to blocks drawn anew.

    Attributes
    ----------
    law
        The fit to all points.
    by, blocks
        What was drawn, and from how many.
    draws
        Shape (refits, parameters), in SI, in the order of the law's parameters.
    failed
        Draws that left the law undetermined, and were drawn again.
    """

    law: ForceLaw
    by: Grouping
    blocks: int
    draws: NDArray[np.float64] = field(repr=False)
    failed: int

    @property
    def standard_errors(self) -> dict[str, float]:
        """By parameter, in SI: the spread of the draws, times sqrt(G/(G - 1)) for G blocks."""
        spread = np.std(self.draws, axis=0, ddof=1) * np.sqrt(self.blocks / (self.blocks - 1))
        return dict(zip(self._names, spread.tolist(), strict=True))

    def intervals(self, level: float = 0.95) -> dict[str, Interval]:
        """By parameter, in SI: percentiles of the draws, taken wider as Hesterberg has it for few blocks."""
        lower, upper = self._percentiles(self.draws, level)
        return {name: Interval(*ends) for name, *ends in zip(self._names, lower.tolist(), upper.tolist(), strict=True)}

    def force_band(self, contraction: ArrayLike, pressure: ArrayLike, *, level: float = 0.95) -> Band:
        """The force of the law [N] at contractions [-] and pressures [Pa], with percentiles of the refitted laws."""
        value = law_forces(type(self.law), [list(self._estimates)], contraction, pressure)[0]
        forces = law_forces(type(self.law), self.draws, contraction, pressure)
        lower, upper = self._percentiles(forces, level)
        error = np.std(forces, axis=0, ddof=1) * np.sqrt(self.blocks / (self.blocks - 1))
        return Band(level, value, error, np.full_like(value, self.blocks - 1.0), lower, upper)

    def _percentiles(self, draws: NDArray[np.float64], level: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        from scipy.special import ndtr

        check_level(level)
        reach = float(quantile(level, self.blocks - 1)) * np.sqrt(self.blocks / (self.blocks - 1))
        lower, upper = np.quantile(draws, [float(ndtr(-reach)), float(ndtr(reach))], axis=0)
        return lower, upper

    @property
    def _names(self) -> list[str]:
        return [p.name for p in type(self.law).parameters()]

    @property
    def _estimates(self) -> NDArray[np.float64]:
        return np.array([float(getattr(self.law, name)) for name in self._names])


def bootstrap(fit: Fit, refits: int = 500, *, seed: int = 0, by: Grouping | None = None) -> Bootstrap:
    """Repeat a fit on blocks of its points, drawn with replacement.

    Parameters
    ----------
    fit
        As `identify` returned it.
    refits
        How many.
    seed
        The same seed gives the same draws.
    by
        What is drawn. Unless said, whole repeats of the test if there are at least eight; else strokes, where
        directions or repeats are recorded; else pressures; of these, too, there must be eight.

    Raises
    ------
    IdentificationError
        If there are too few blocks to draw from, or a tenth of the draws leave the law undetermined.
    RangeError
        If there are fewer than two refits.
    """
    if refits < 2:
        raise RangeError(f"{refits} refits have no spread", value=refits, lower=2, remedy="take some hundreds")
    evidence = fit.known_evidence()
    by, labels = _blocks(evidence, by)
    blocks = int(labels.max()) + 1
    generator = np.random.default_rng(seed)
    problem, start = evidence.problem, evidence.solution.position
    free_always = ~evidence.held
    draws: list[NDArray[np.float64]] = []
    failed = 0
    while len(draws) < refits:
        counts = generator.multinomial(blocks, np.full(blocks, 1 / blocks)).astype(np.float64)
        weighed = problem.weighing(counts[labels])
        found = solve_by_projection(weighed, start)
        if not found.converged:
            found = solve_between_bounds(weighed, evidence.solution.values)
        if found.converged and condition(found.jacobian[:, free_always]) < CONDITION_LIMIT:
            draws.append(found.values)
            continue
        failed += 1
        if failed > _MOST_FAILED * refits:
            raise IdentificationError(
                f"{failed} of {len(draws) + failed} draws of {by.counted(blocks)} do not determine "
                f"{type(fit.law).__name__}",
                value=failed,
                upper=_MOST_FAILED * refits,
                remedy="measure at more pressures or repeat the test, or rely on Fit.intervals",
            )
    return Bootstrap(fit.law, by, blocks, np.array(draws), failed)


def _blocks(evidence: Evidence, by: Grouping | None) -> tuple[Grouping, NDArray[np.int64]]:
    points = evidence.points
    if by is None:
        enough = len(points.repeats) >= FEWEST_BLOCKS
        told_apart = "direction" in points.table or "repeat" in points.table
        by = Grouping.REPEAT if enough else Grouping.STROKE if told_apart else Grouping.PRESSURE
    labels = group_labels(points, by)
    blocks = int(labels.max()) + 1
    if blocks < FEWEST_BLOCKS:
        raise IdentificationError(
            f"{by.counted(blocks)} are too few to draw from",
            value=blocks,
            lower=FEWEST_BLOCKS,
            remedy="repeat the test, or rely on Fit.intervals, which knows how little few groups say",
        )
    return by, labels
