"""How engines are timed: side by side, in turns, so that a machine that slows down slows all of them."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace

from rows import Candidate, Row

_SHORT = 0.05
"""Seconds: a shorter run is done once right before it is timed, for the engine before it has filled the caches."""


@dataclass
class Bench:
    """Gathers candidates, and rows for what cannot be timed.

    Attributes
    ----------
    rounds
        How often each engine runs at most.
    budget
        After how many counted seconds an engine sits the later rounds out.
    """

    rounds: int
    budget: float
    entries: list[Candidate | Row] = field(default_factory=list)

    def add(self, engine: str, build: Callable[[], Candidate | Iterable[Candidate]], *, install: str = "") -> None:
        """Build one engine's candidates; where that fails, the engine becomes a row that says why.

        Parameters
        ----------
        engine
            Its name, should it fail.
        build
            Makes its candidates, checked against the reference.
        install
            What to install where an import fails.
        """
        try:
            made = build()
        except Exception as error:  # of any engine: the others still are to be timed
            absent = install and isinstance(error, ImportError)
            self.say(engine, f"not installed (pip install {install})" if absent else failure(error))
        else:
            self.entries += [made] if isinstance(made, Candidate) else made

    def say(self, engine: str, note: str) -> None:
        """A row without times."""
        self.entries.append(Row(engine, note=note))

    def timed(self) -> tuple[Row, ...]:
        """Time what was added; in its order."""
        clocks = {
            entry.engine: _Clock(entry) for entry in self.entries if isinstance(entry, Candidate) and entry.agrees
        }
        for clock in clocks.values():
            clock.warm_up()
        for _ in range(self.rounds):
            for clock in clocks.values():
                clock.take_turn(self.budget)
        rows = {name: clock.row(clocks.get(clock.candidate.base)) for name, clock in clocks.items()}
        return tuple(
            entry if isinstance(entry, Row) else rows.get(entry.engine) or _refused(entry) for entry in self.entries
        )


@dataclass
class _Clock:
    """Times one engine."""

    candidate: Candidate
    seconds: list[float] = field(default_factory=list)
    cpu_seconds: list[float] = field(default_factory=list)
    failed: str = ""

    def warm_up(self) -> None:
        if self.candidate.warm:
            self._run()

    def take_turn(self, budget: float) -> None:
        """Run once more, unless it failed, ran often enough or used its budget [s] up."""
        spent = self.seconds
        used_up = spent and sum(spent) + spent[-1] > budget
        if self.failed or used_up or len(spent) >= self.candidate.most:
            return
        if self.candidate.warm and spent and spent[-1] < _SHORT:
            self._run()
        begin, cpu_begin = time.perf_counter(), time.process_time()
        self._run()
        cpu, wall = time.process_time() - cpu_begin, time.perf_counter() - begin
        if not self.failed:
            self.cpu_seconds.append(cpu)
            self.seconds.append(wall)

    def row(self, base: _Clock | None) -> Row:
        """What came out. The ratio is the median, over the rounds, of the ratios inside one round."""
        candidate = self.candidate
        if self.failed:
            return Row(candidate.engine, note=self.failed, deviation=candidate.deviation)
        mine, other = candidate.work, base.candidate.work if base else 1.0
        times = (self.seconds, base.seconds if base else [])
        ratios = [(one / mine) / (two / other) for one, two in zip(*times, strict=False)]
        return Row(
            engine=candidate.engine,
            note=candidate.note,
            deviation=candidate.deviation,
            base=candidate.base,
            work=candidate.work,
            seconds=tuple(self.seconds),
            cpu_seconds=tuple(self.cpu_seconds),
            ratio=statistics.median(ratios) if ratios else None,
        )

    def _run(self) -> None:
        try:
            self.candidate.run()
        except Exception as error:
            self.failed = failure(error)


def failure(error: Exception) -> str:
    """A note about what went wrong, in a line."""
    first = (str(error).splitlines() or [""])[0]
    return f"failed: {type(error).__name__}: {first[:120]}"


def inverted(rows: tuple[Row, ...]) -> tuple[Row, ...]:
    """Ratios of speeds in place of ratios of times."""
    return tuple(replace(row, ratio=1 / row.ratio if row.ratio else None) for row in rows)


def _refused(candidate: Candidate) -> Row:
    note = f"deviates by {candidate.deviation:.1e}, more than {candidate.tolerance:.0e}: not timed"
    return Row(candidate.engine, note=note, deviation=candidate.deviation)
