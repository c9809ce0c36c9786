"""What a benchmark is made of: something that can be timed, what came out, and tables of that."""

from __future__ import annotations

import statistics
from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True)
class Candidate:
    """Something that can be timed.

    Attributes
    ----------
    engine
        Its name, unique in its table.
    run
        One run.
    work
        How much one run does, in the table's unit: 0.05 where a twentieth of the unit is run, and the time is scaled.
    deviation, tolerance
        How far its answer is from the reference's, in the table's unit of deviation; beyond the tolerance it computes
        something else and is not timed. None where there is nothing to compare.
    note
        What a reader has to know.
    base
        The engine that its ratio is against.
    warm
        Whether it runs once before it is timed (what compiles has to; where a run takes seconds it may not matter).
    most
        How many runs are enough.
    """

    engine: str
    run: Callable[[], object]
    work: float = 1.0
    deviation: float | None = None
    tolerance: float = 0.0
    note: str = ""
    base: str = ""
    warm: bool = True
    most: int = 10_000

    @property
    def agrees(self) -> bool:
        """Whether it computes what the reference does."""
        return self.deviation is None or self.deviation <= self.tolerance


@dataclass(frozen=True)
class Row:
    """What is known of one engine: times, or the reason why there are none."""

    engine: str
    note: str = ""
    deviation: float | None = None
    base: str = ""
    work: float = 1.0
    seconds: tuple[float, ...] = ()
    cpu_seconds: tuple[float, ...] = ()
    ratio: float | None = None

    @property
    def time(self) -> float | None:
        """Median seconds per unit of work."""
        return statistics.median(self.seconds) / self.work if self.seconds else None

    @property
    def cores(self) -> float | None:
        """How many cores it kept busy."""
        return sum(self.cpu_seconds) / sum(self.seconds) if self.seconds else None


@dataclass(frozen=True)
class Table:
    """Rows that belong together.

    Attributes
    ----------
    unit
        What one unit of work is.
    shown
        "time" or "speed": which of the two a table shows, and its ratios are of.
    deviation_of
        What a deviation is of, with its unit.
    """

    title: str
    unit: str
    shown: str
    deviation_of: str
    rows: tuple[Row, ...]
    notes: tuple[str, ...] = ()
