"""Reference and limits of a joint rig."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mckibben.errors import McKibbenError, RangeError, StoppedError
from mckibben.realtime.config import JointReading
from mckibben.realtime.record import Phase
from mckibben.rig.safety import beyond
from mckibben.units import bar, deg, ms


@dataclass(frozen=True)
class RunPlan:
    """What a joint rig is to do.

    Attributes
    ----------
    wishes
        Angle [rad] and stiffness [N*m/rad] at the start of each period of the run, shape (periods, 2).
    period
        The control period [s].
    raising
        Periods in which the pressures are brought to `pressures` along a straight line, without the controller.
    settling
        Periods in which the controller then holds the first wish, before the run begins.
    pressures
        [Pa].
    limited_to
        The commands of each muscle are cut off at these [Pa]: (lowest, highest), (lowest, highest).
    """

    wishes: NDArray[np.float64]
    period: float
    raising: int
    settling: int
    pressures: tuple[float, float]
    limited_to: tuple[tuple[float, float], tuple[float, float]]

    @property
    def periods(self) -> int:
        """Of all three parts."""
        return self.raising + self.settling + len(self.wishes)


class RunProgress(NamedTuple):
    """What a run tells while it is on: how far it is [s], the reading, the wished angle [rad], missed deadlines."""

    time: float
    of: float
    phase: Phase
    reading: JointReading
    wish: float
    missed: int


@dataclass(frozen=True)
class RunOutcome:
    """How a run ended.

    Attributes
    ----------
    kind
        "completed"; or "limit", "signal", "silent" ... in a word, for programs.
    text
        In words, for people.
    error
        What stopped it, if something did.
    vented_after
        How long after the vent both pressures were below 0.2 bar [s]; None if they were not seen to be.
    """

    kind: str
    text: str
    error: McKibbenError | None = None
    vented_after: float | None = None

    @property
    def completed(self) -> bool:
        """Whether the run went to its end."""
        return self.error is None


@dataclass(frozen=True, kw_only=True)
class JointLimits:
    """A single sample beyond them stops the run and vents both muscles.

    Parameters
    ----------
    lowest_angle, highest_angle
        [rad].
    pressure
        Highest in either muscle [Pa, gauge].
    angle_rate
        How fast the joint may turn [rad/s], from the mean over one `window` to that over the next: 720 deg/s.
    pressure_rate
        How fast a pressure may change [Pa/s], in the same way; any unless given: what a valve does is its own affair.
    window
        [s].
    pressure_error
        How far the pressures may be from their commands [Pa], averaged over `following`: 1 bar. Air that is not there,
        a valve that is stuck, and a sensor that tells always the same are found by it.
    following
        [s].
    silence
        How long after it was due a sample may come [s] before the device counts as silent.
    late
        How old the newest sample may be when it is acted on [s].

    Raises
    ------
    RangeError
        If a number has no meaning.
    """

    lowest_angle: float
    highest_angle: float
    pressure: float
    angle_rate: float = 720 * deg
    pressure_rate: float = math.inf
    window: float = 10 * ms
    pressure_error: float = 1 * bar
    following: float = 250 * ms
    silence: float = 20 * ms
    late: float = 50 * ms

    def __post_init__(self) -> None:
        for name, value in asdict(self).items():
            endless = name == "pressure_rate" and value == math.inf
            if not (math.isfinite(value) or endless) or (not name.endswith("angle") and value <= 0):
                raise RangeError(f"limits: {name} is {value:g}", value=value, remedy="it has to be finite and above 0")
        if not self.lowest_angle < self.highest_angle:
            raise RangeError(
                f"limits: the angle may be {self.lowest_angle / deg:g}..{self.highest_angle / deg:g} deg",
                remedy="give the lower one first",
            )


class Watch:
    """Looks at each reading, and raises if the run has to stop.

    Parameters
    ----------
    limits
        What may not be exceeded.
    period
        Time between two readings [s].
    """

    def __init__(self, limits: JointLimits, period: float) -> None:
        self.limits = limits
        self._width = max(1, round(limits.window / period))
        self._recent: deque[tuple[float, JointReading]] = deque(maxlen=2 * self._width)
        self._sums = [0.0] * 8  # time, angle, pressure1, pressure2 of the older window, and of the newer
        self._share = min(1.0, period / limits.following)
        self._errors = [0.0, 0.0]

    def follow(self, reading: JointReading, commands: Sequence[float]) -> None:
        """Hold the pressures of a reading against the commands [Pa] that were in force until then.

        Raises
        ------
        StoppedError
            If one has not followed for too long.
        """
        errors, share, limit = self._errors, self._share, self.limits.pressure_error
        for i in (0, 1):
            pressure = reading[1 + i]
            errors[i] += share * (pressure - commands[i] - errors[i])
            if abs(errors[i]) > limit:
                raise StoppedError(
                    f"pressure {i + 1} does not follow: it has been {abs(errors[i]) / bar:.3g} bar "
                    f"{'above' if errors[i] > 0 else 'below'} its command on average over "
                    f"{self.limits.following / ms:.3g} ms, and is {pressure / bar:.3g} bar",
                    value=pressure,
                    unit="Pa",
                    remedy="check the supply, the valve, the muscle and the sensor",
                )

    def look(self, time: float, reading: JointReading) -> None:
        """Pass a reading [s], or not.

        Raises
        ------
        StoppedError
            If it is beyond a limit, or changes too fast.
        """
        limits = self.limits
        angle, pressure1, pressure2 = reading
        if not limits.lowest_angle <= angle <= limits.highest_angle:
            raise StoppedError(
                f"the angle of {angle / deg:.4g} deg is outside the limits of {limits.lowest_angle / deg:.4g} to "
                f"{limits.highest_angle / deg:.4g} deg",
                value=angle,
                lower=limits.lowest_angle,
                upper=limits.highest_angle,
                unit="rad",
            )
        if not (pressure1 <= limits.pressure and pressure2 <= limits.pressure):
            which, value = (1, pressure1) if not pressure1 <= limits.pressure else (2, pressure2)
            raise beyond(f"pressure {which}", value / bar, limits.pressure / bar, "bar")
        self._look_at_rates(time, reading)

    def _look_at_rates(self, time: float, reading: JointReading) -> None:
        recent, sums, width = self._recent, self._sums, self._width
        full = len(recent) == 2 * width
        if full:
            _add(sums, 0, recent[0], -1.0)
        if len(recent) >= width:
            middle = recent[-width]
            _add(sums, 4, middle, -1.0)
            _add(sums, 0, middle, 1.0)
        recent.append((time, reading))
        _add(sums, 4, recent[-1], 1.0)
        if len(recent) < 2 * width:
            return
        time = sums[4] - sums[0]
        for i, (what, unit, name, limit) in enumerate(
            (
                ("rate of the angle", deg, "deg/s", self.limits.angle_rate),
                ("rate of pressure 1", bar, "bar/s", self.limits.pressure_rate),
                ("rate of pressure 2", bar, "bar/s", self.limits.pressure_rate),
            ),
            start=1,
        ):
            rate = (sums[4 + i] - sums[i]) / time
            if not abs(rate) <= limit:
                raise beyond(what, abs(rate) / unit, limit / unit, name)


def _add(sums: list[float], at: int, one: tuple[float, JointReading], sign: float) -> None:
    time, (angle, pressure1, pressure2) = one
    sums[at] += sign * time
    sums[at + 1] += sign * angle
    sums[at + 2] += sign * pressure1
    sums[at + 3] += sign * pressure2
