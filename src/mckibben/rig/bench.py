"""Test bench: motor, calibrations, limits."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mckibben.component.base import Checked, Inherited, check_fields
from mckibben.errors import RangeError
from mckibben.muscle import Muscle, Specimen
from mckibben.rig.calibration import Calibration
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
    """Stepper motor, reducer and lead screw; the paper's."""

    steps: Annotated[int, BoundedInt(1, 1_000_000)] = 200  # pulses per revolution (ours: the usual motor, full steps)
    reduction: Factor = 10.0  # revolutions of the motor per revolution of the screw (the paper, "Experimental system")
    lead: Travel = 5 * mm  # travel per revolution of the screw (the paper)
    fastest: SampleRate = 2000.0  # highest pulse rate (ours), which is 5 mm/s

    @property
    def pulses_per_metre(self) -> float:
        """Pulses per metre of travel [1/m]; exact in the given decimals."""
        return float(self.steps * Fraction(str(self.reduction)) / Fraction(str(self.lead)))

    def pulses(self, travel: float) -> int:
        """Pulses for a travel [m]; `RangeError` if that is not a whole number."""
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
        """Pulse rate [Hz] for a speed [m/s]; `RangeError` if it is above that of the motor."""
        rate = abs(speed) * self.pulses_per_metre
        if not 0 < rate <= self.fastest:
            message = f"{speed / mm:g} mm/s are {rate:g} pulses per second; the motor does {self.fastest:g} at most"
            remedy = f"move at up to {self.fastest / self.pulses_per_metre / mm:g} mm/s"
            raise RangeError(message, value=rate, lower=0.0, upper=self.fastest, unit="Hz", remedy=remedy)
        return rate


@dataclass(frozen=True, kw_only=True)
class RigLimits(Checked):
    """Limits of a test rig; a single sample beyond one of them stops the test."""

    pressure: PositivePressure  # highest
    force: Annotated[Tension, Inherited(lambda scope: scope["muscle"].specimen.known_force_limit)]  # highest
    stretch: Travel  # travel from the mounted position, in either direction
    shorten: Travel
    pressure_rate: PressureRate = 50 * bar / s  # between the means of two cycles; not checked during venting
    pressure_error: PressureScale = 0.3 * bar  # highest deviation from the set pressure after `settling`
    settling: Duration = 10 * s  # of the pressure
    gap: MonitorTime = 500 * ms  # highest age of the newest sample, and longest time without one
    frozen: Duration = math.inf  # longest time for which a sensor may read the same volts; for sensors with noise
    deviation: Tension = math.inf  # highest deviation of a point's mean force from the law


@dataclass(frozen=True, kw_only=True)
class JointLimits(Checked):
    """Limits of a joint rig, in SI; a single sample beyond one of them stops the run and vents both muscles."""

    lowest_angle: Angle
    highest_angle: Angle
    pressure: PositivePressure  # of either muscle
    angle_rate: AngularRate = 720 * deg  # highest, between the means over two consecutive windows
    pressure_rate: PressureRate = math.inf  # the same
    window: MonitorTime = 10 * ms
    pressure_error: PressureScale = 1 * bar  # highest filtered deviation from the command: lost supply, stuck valve ...
    following: MonitorTime = 250 * ms  # time constant of that filter
    silence: MonitorTime = 20 * ms  # timeout of a sample after it was due
    late: MonitorTime = 50 * ms  # highest age of the newest sample, and longest time without one

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.lowest_angle < self.highest_angle:
            raise RangeError(
                f"limits: the angle may be {self.lowest_angle / deg:g}..{self.highest_angle / deg:g} deg",
                remedy="give the lower one first",
            )


@dataclass(frozen=True, kw_only=True)
class Bench:
    """Test bench: the muscle, how it is mounted, the motor, calibrations, limits and recording."""

    of: Muscle | Specimen  # the specimen if its law is not known
    mounted_at: float = 0.0  # contraction, the origin of the motor
    drive: Drive
    calibrations: Mapping[str, Calibration]  # of "force", "pressure" (inputs) and "valve" (output)
    limits: RigLimits
    rate: float = 1000 * Hz  # of each input
    cycle: MonitorTime = 100 * ms  # period at which samples are read and checked
    between: SampleRate = 10 * Hz  # rate of the record between plateaus; after a stop all samples are recorded
    settled: float = 0.1 * bar  # tolerance of the set pressure, for the mean of a cycle [Pa]
    vented: float = 0.1 * bar  # pressure below which the muscle is vented [Pa]
    steady: float = 1 * s  # time for which the pressure has to be settled or vented [s]
    slack_force: Force = 1 * N  # highest mean force of a slack muscle, for the zero error of a sensor
    shuts: bool = False  # whether the rig has a shut-off valve
    supply: PositivePressure = math.inf  # highest pressure of supply and regulator

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
        """Contraction [-] at a position of the motor."""
        return self.mounted_at - pulses / self.drive.pulses_per_metre / float(self.specimen.initial_length)
