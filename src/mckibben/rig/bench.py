"""Test bench: motor and limits."""

from __future__ import annotations

import math
from dataclasses import dataclass
from fractions import Fraction
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mckibben.component.base import Checked, Inherited, check_fields
from mckibben.errors import RangeError
from mckibben.muscle import Muscle, Specimen
from mckibben.rig.protocol import specimen_of
from mckibben.units import (
    Angle,
    BoundedInt,
    Duration,
    Factor,
    Force,
    Hz,
    N,
    PositivePressure,
    PressureRate,
    PressureScale,
    Quantity,
    SampleRate,
    Tension,
    Travel,
    bar,
    deg,
    mm,
    ms,
    s,
)

AngularRate = Annotated[float, Quantity("rad/s", "deg/s", 0, 1e4, open_lower=True)]

MonitorTime = Annotated[float, Quantity("s", "ms", 0, 5e3, open_lower=True)]  # more is one in ms

_WHOLE = 1e-6  # pulses


@dataclass(frozen=True, kw_only=True)
class Drive(Checked):
    """Stepper motor, reducer and lead screw; by default those of the paper.

    Parameters
    ----------
    steps
        Pulses per revolution of the motor: 200 (ours), full steps of the usual motor.
    reduction
        Revolutions of the motor per revolution of the screw (the paper, "Experimental system").
    lead
        Travel [m] per revolution of the screw (the paper).
    fastest
        Highest pulse rate [Hz] (ours), which is 5 mm/s.

    Examples
    --------
    >>> drive = Drive()
    >>> drive.pulses(1 * mm), drive.rate(0.2 * mm)
    (400, 80.0)
    """

    steps: Annotated[int, BoundedInt(1, 1_000_000)] = 200
    reduction: Factor = 10.0
    lead: Travel = 5 * mm
    fastest: SampleRate = 2000.0

    @property
    def pulses_per_metre(self) -> float:
        """Pulses per metre of travel [1/m]; exact in the given decimals."""
        return float(self.steps * Fraction(str(self.reduction)) / Fraction(str(self.lead)))

    def pulses(self, travel: float) -> int:
        """Return the pulses for a travel [m].

        Raises
        ------
        RangeError
            If the travel is not a whole number of pulses; the remedy is the travel of one.
        """
        exact = travel * self.pulses_per_metre
        if not np.isfinite(exact) or abs(exact - round(exact)) > _WHOLE:
            one = 1 / self.pulses_per_metre / mm
            remedy = f"take a multiple of {one:g} mm"
            raise RangeError(f"{travel / mm:g} mm are {exact:g} pulses", value=travel, unit="m", remedy=remedy)
        return round(exact)

    def nearest(self, travel: float) -> int:
        """Nearest number of pulses for a travel [m]."""
        return round(travel * self.pulses_per_metre)

    def travel(self, pulses: ArrayLike) -> NDArray[np.float64]:
        """Travel of pulses [m], any shape."""
        return np.asarray(pulses, np.float64) / self.pulses_per_metre

    def rate(self, speed: float) -> float:
        """Return the pulse rate [Hz] for a speed [m/s] of either sign.

        Raises
        ------
        RangeError
            If the speed is 0, or the rate is above that of the motor.
        """
        rate = abs(speed) * self.pulses_per_metre
        if not 0 < rate <= self.fastest:
            message = f"{speed / mm:g} mm/s are {rate:g} pulses per second; the motor does {self.fastest:g} at most"
            remedy = f"move at up to {self.fastest / self.pulses_per_metre / mm:g} mm/s"
            raise RangeError(message, value=rate, lower=0.0, upper=self.fastest, unit="Hz", remedy=remedy)
        return rate


@dataclass(frozen=True, kw_only=True)
class RigLimits(Checked):
    """Limits of a test rig; a single sample beyond one of them vents the muscle and stops the test.

    Parameters
    ----------
    pressure
        Highest pressure [Pa].
    force
        Highest force [N]; in a file, by default the rated force of the specimen.
    stretch, shorten
        Longest travel [m] from the mounted position, in either direction.
    pressure_rate
        Highest rate of the pressure [Pa/s], between the means of two cycles; not checked while it is vented.
    pressure_error
        Highest deviation from the set pressure [Pa] after `settling`.
    settling
        Time [s] that the pressure has to reach the set one.
    gap
        Highest age of the newest sample, and longest time without one [s].
    frozen
        Longest time [s] for which a sensor may read the same value; only for sensors with noise.
    deviation
        Highest deviation of a point's mean force from the law [N].

    Raises
    ------
    RangeError
        If a number is out of the range of its field.
    """

    pressure: PositivePressure
    force: Annotated[Tension, Inherited(lambda scope: scope["muscle"].specimen.known_force_limit)]
    stretch: Travel
    shorten: Travel
    pressure_rate: PressureRate = 50 * bar / s
    pressure_error: PressureScale = 0.3 * bar
    settling: Duration = 10 * s
    gap: MonitorTime = 500 * ms
    frozen: Duration = math.inf
    deviation: Tension = math.inf


@dataclass(frozen=True, kw_only=True)
class JointLimits(Checked):
    """Limits of a joint rig; a single sample beyond one of them stops the run and vents both muscles.

    Parameters
    ----------
    lowest_angle, highest_angle
        Range of the angle [rad].
    pressure
        Highest pressure [Pa] of either muscle.
    angle_rate, pressure_rate
        Highest rates [rad/s], [Pa/s], between the means over two consecutive windows.
    window
        Length of such a window [s].
    pressure_error
        Highest deviation [Pa] of a pressure from its command, filtered: of a lost supply or a stuck valve.
    following
        Time constant of that filter [s].
    silence
        Longest wait for a sample that is due [s].
    late
        Highest age of the newest sample, and longest time without one [s].

    Raises
    ------
    RangeError
        If a number is out of the range of its field, or the angles do not rise.
    """

    lowest_angle: Angle
    highest_angle: Angle
    pressure: PositivePressure
    angle_rate: AngularRate = 720 * deg
    pressure_rate: PressureRate = math.inf
    window: MonitorTime = 10 * ms
    pressure_error: PressureScale = 1 * bar
    following: MonitorTime = 250 * ms
    silence: MonitorTime = 20 * ms
    late: MonitorTime = 50 * ms

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.lowest_angle < self.highest_angle:
            raise RangeError(
                f"limits: the angle may be {self.lowest_angle / deg:g}..{self.highest_angle / deg:g} deg",
                remedy="give the lower one first",
            )


@dataclass(frozen=True, kw_only=True)
class Bench:
    """Test bench: the muscle, its mounting, the motor, limits and recording.

    Parameters
    ----------
    of
        Muscle, or specimen if its law is not known.
    mounted_at
        Contraction [-] at which it is mounted, the origin of the motor.
    drive
        The motor with its gear.
    limits
        Safety limits.
    rate
        Sampling rate [Hz] of each input.
    cycle
        Period [s] at which samples are read and checked.
    between
        Rate [Hz] of the record between plateaus; after a stop all samples are recorded.
    settled, vented
        Tolerance [Pa] of the set pressure, for the mean of a cycle; pressure [Pa] below which the muscle is vented.
    steady
        Time [s] for which the pressure has to be settled or vented.
    slack_force
        Highest mean force [N] of a slack muscle, for the zero error of a sensor.
    shuts
        Whether the rig has a shut-off valve.
    supply
        Highest pressure [Pa] of supply and regulator.

    Raises
    ------
    RangeError
        If a number is out of the range of its field, or a cycle has no sample.
    """

    of: Muscle | Specimen
    mounted_at: float = 0.0
    drive: Drive
    limits: RigLimits
    rate: float = 1000 * Hz
    cycle: MonitorTime = 100 * ms
    between: SampleRate = 10 * Hz
    settled: PressureScale = 0.1 * bar
    vented: PressureScale = 0.1 * bar
    steady: Duration = 1 * s
    slack_force: Force = 1 * N
    shuts: bool = False
    supply: PositivePressure = math.inf

    def __post_init__(self) -> None:
        check_fields(self)
        if not 1 <= self.rate * self.cycle:
            raise RangeError(f"no sample is taken within a cycle of {self.cycle:g} s", remedy="lengthen it")

    @property
    def specimen(self) -> Specimen:
        """The specimen."""
        return specimen_of(self.of)

    @property
    def samples_per_cycle(self) -> int:
        """Samples of each input per cycle."""
        return max(1, round(self.rate * self.cycle))

    @property
    def decimation(self) -> int:
        """Decimation factor of the record between plateaus."""
        return max(1, round(self.rate / self.between))

    def pulses_at(self, contraction: float) -> int:
        """Position of the motor at a contraction [-], from the mounted position, to the nearest pulse."""
        return self.drive.nearest((self.mounted_at - contraction) * float(self.specimen.initial_length))

    def contraction_at(self, pulses: float) -> float:
        """Return the contraction [-] at a position of the motor [pulses] from the mounted one."""
        return self.mounted_at - pulses / self.drive.pulses_per_metre / float(self.specimen.initial_length)
