"""How well a loop kept its time."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mckibben.study.joint_rig.rows import Phase


class Spread(NamedTuple):
    """Of times [s]: median, 95 and 99.9 percent, and the worst."""

    median: float
    most: float
    nearly_all: float
    worst: float

    @classmethod
    def of(cls, times: NDArray[np.float64]) -> Spread:
        """NaN where there are none."""
        if not times.size:
            return cls(*[float("nan")] * 4)
        return cls(*(float(value) for value in np.percentile(times, (50, 95, 99.9, 100))))

    def to_json(self) -> dict[str, float]:
        """In microseconds."""
        return dict(zip(("median_us", "p95_us", "p999_us", "worst_us"), (time * 1e6 for time in self), strict=True))


class Timing(NamedTuple):
    """The timing of a run's closed loop.

    Attributes
    ----------
    periods
        That it had.
    missed
        Of those, in how many no command from the sample at their start reached the valves before their end.
    skipped
        Of those, in how many there was none at all: the loop had been late, and took the next sample.
    dropped
        Of those, how many samples the device lost.
    lateness
        From when a sample was taken until the loop had it.
    work
        From then until the commands were out: limits, controller, valves.
    jitter
        By how much the time between commands differs from the period.
    """

    periods: int
    missed: int
    skipped: int
    dropped: int
    lateness: Spread
    work: Spread
    jitter: Spread

    @classmethod
    def of(cls, columns: Mapping[str, NDArray[Any]], period: float) -> Timing:
        """Of the columns of a record, its closed loop alone."""
        closed = np.isin(columns["phase"], (Phase.SETTLING, Phase.RUN))
        sample, taken, had, out = (
            columns[name][closed].astype(float) for name in ("sample", "time", "read_at", "answered_at")
        )
        answered = np.isfinite(out)
        periods = int(sample[-1] - sample[0] + 1) if sample.size else 0
        in_time = answered & (out <= taken + period * (1 + 1e-9))
        with np.errstate(invalid="ignore"):
            between = np.diff(out[answered])
        return cls(
            periods=periods,
            missed=periods - int(in_time.sum()),
            skipped=int((~answered).sum()),
            dropped=periods - sample.size,
            lateness=Spread.of((had - taken)[answered]),
            work=Spread.of((out - had)[answered]),
            jitter=Spread.of(np.abs(between - period)),
        )

    def to_json(self) -> dict[str, Any]:
        """As a JSON object, times in microseconds."""
        counts = {name: getattr(self, name) for name in ("periods", "missed", "skipped", "dropped")}
        return counts | {name: getattr(self, name).to_json() for name in ("lateness", "work", "jitter")}
