"""Test bench and its limits; limits of a joint rig."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated

from mckibben.component.base import Checked, Inherited, check_fields
from mckibben.errors import RangeError
from mckibben.muscle import Muscle, Specimen
from mckibben.rig.protocol import specimen_of
from mckibben.units import (
    Angle,
    Duration,
    Force,
    Hz,
    JointQuantity,
    N,
    PositivePressure,
    PressureRate,
    PressureScale,
    Quantity,
    SampleRate,
    Speed,
    Tension,
    Travel,
    bar,
    deg,
    mm,
    ms,
    s,
)

AngularRate = Annotated[float, JointQuantity("rad/s", "deg/s", 0, 1e4, open_lower=True)]

MonitorTime = Annotated[float, Quantity("s", "ms", 0, 5e3, open_lower=True)]  # more is one in ms

FASTEST = 5 * mm / s
"""Highest speed of a motor [m/s], where it is not known (ours)."""


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
        Highest age of the newest sample, with the latency of its line, and longest time without one [s].
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
    """Limits of a joint rig; a single sample beyond one of them stops the run and vents all muscles.

    Parameters
    ----------
    lowest_angle, highest_angle
        Range of the angle [rad], of a slide of its position [m], in files in mm.
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
        Highest age of the newest sample, with the latency of its line, and longest time without one [s].

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
                f"limits: lowest_angle {self.lowest_angle:g} is not below highest_angle {self.highest_angle:g}",
                remedy="give the lower one first",
            )


@dataclass(frozen=True, kw_only=True)
class Bench:
    """Test bench: the muscle, its mounting, limits, recording and rig.

    Parameters
    ----------
    of
        Muscle, or specimen if its law is not known.
    mounted_at
        Contraction [-] at which it is mounted, the origin of the motor.
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
    supply
        Highest pressure [Pa] of supply and regulator.
    fastest
        Highest speed of the motor [m/s].

    Raises
    ------
    RangeError
        If a number is out of the range of its field, or a cycle has no sample.
    """

    of: Muscle | Specimen
    mounted_at: float = 0.0
    limits: RigLimits
    rate: float = 1000 * Hz
    cycle: MonitorTime = 100 * ms
    between: SampleRate = 10 * Hz
    settled: PressureScale = 0.1 * bar
    vented: PressureScale = 0.1 * bar
    steady: Duration = 1 * s
    slack_force: Force = 1 * N
    supply: PositivePressure = math.inf
    fastest: Speed = FASTEST

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

    def position_at(self, contraction: float) -> float:
        """Position of the motor [m] at a contraction [-], from the mounted position, positive = stretched."""
        return (self.mounted_at - contraction) * float(self.specimen.initial_length)

    def contraction_at(self, position: float) -> float:
        """Return the contraction [-] at a position of the motor [m] from the mounted one."""
        return self.mounted_at - position / float(self.specimen.initial_length)
