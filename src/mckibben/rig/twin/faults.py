"""What can go wrong with a rig, each at a time of its own."""

from __future__ import annotations

from dataclasses import dataclass

from mckibben.errors import RangeError
from mckibben.numerics.checks import check_positive
from mckibben.rig.twin.air import L_PER_S_BAR


@dataclass(frozen=True)
class Fault:
    """Something that happens to a virtual rig.

    Parameters
    ----------
    at
        When [s], counted from when the rig was first opened.
    """

    at: float

    def __post_init__(self) -> None:
        check_positive(type(self).__name__, "s", zero=True, at=self.at)


@dataclass(frozen=True)
class SupplyLost(Fault):
    """The compressed air fails, and its line is empty; an open regulator lets the muscle's air flow back into it."""


@dataclass(frozen=True)
class ValveStuck(Fault):
    """The regulator stays as far open as it is told here, from -1 (out) to 1 (in), whatever its signal."""

    opening: float = 1.0

    def __post_init__(self) -> None:
        super().__post_init__()
        if not -1 <= self.opening <= 1:
            raise RangeError(f"ValveStuck: opening {self.opening:g} is outside -1..1", value=self.opening)


@dataclass(frozen=True)
class Unplugged(Fault):
    """A sensor's plug comes off.

    Parameters
    ----------
    sensor
        "force" or "pressure".
    volts
        What the open input then reads [V]: a rail, to which a resistor pulls it, 10 V. None: it floats, and picks up
        the mains.
    """

    sensor: str = "force"
    volts: float | None = 10.0

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.sensor not in ("force", "pressure"):
            raise RangeError(f"Unplugged: no sensor {self.sensor!r}", value=self.sensor, remedy="force or pressure")


@dataclass(frozen=True)
class Slipped(Fault):
    """The muscle slips out of its clamp: it pulls at nothing, and goes to its shortest."""


@dataclass(frozen=True)
class Burst(Fault):
    """The bladder tears: a hole of such a sonic conductance [m^3/(s*Pa)], 5 dm^3/(s*bar) unless given."""

    conductance: float = 5 * L_PER_S_BAR

    def __post_init__(self) -> None:
        super().__post_init__()
        check_positive("Burst", "m^3/(s*Pa)", conductance=self.conductance)


@dataclass(frozen=True)
class Stalled(Fault):
    """The motor stands still; its pulses are counted as before."""


@dataclass(frozen=True)
class HostDelayed(Fault):
    """The host is busy with something else for so long [s]: its next read returns that much later."""

    duration: float = 1.0

    def __post_init__(self) -> None:
        super().__post_init__()
        check_positive("HostDelayed", "s", duration=self.duration)


@dataclass(frozen=True)
class Silent(Fault):
    """No more samples come."""


@dataclass(frozen=True)
class Dropping(Fault):
    """Samples are lost: the next so many, and again each so many seconds [s] where a period is given.

    What was waiting to be read at that time goes with them.
    """

    samples: int = 10
    every: float | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.samples < 1:
            raise RangeError(f"Dropping: {self.samples} samples", value=self.samples, lower=1)
        if self.every is not None:
            check_positive("Dropping", "s", every=self.every)


@dataclass(frozen=True)
class Delaying(Fault):
    """Samples come so much later [s] than they were taken."""

    delay: float = 0.2

    def __post_init__(self) -> None:
        super().__post_init__()
        check_positive("Delaying", "s", delay=self.delay)
