"""Test bench: motor, calibrations, limits."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from fractions import Fraction

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mckibben.errors import RangeError
from mckibben.muscle import Muscle, Specimen
from mckibben.numerics.checks import check_positive
from mckibben.rig.calibration import Calibration
from mckibben.rig.protocol import specimen_of
from mckibben.units import (
    Angle,
    AngularRate,
    Duration,
    Force,
    Hz,
    N,
    PositiveTime,
    Pressure,
    PressureRate,
    SampleRate,
    Tension,
    Travel,
    bar,
    deg,
    mm,
    ms,
    s,
)

_WHOLE = 1e-6  # pulses


@dataclass(frozen=True, kw_only=True)
class Drive:
    """Stepper motor, reducer and lead screw.

    Parameters
    ----------
    steps
        Pulses per revolution of the motor: 200 (ours; the usual motor, full steps).
    reduction
        Revolutions of the motor per revolution of the screw: 10 (the paper, "Experimental system").
    lead
        Travel per revolution of the screw [m]: 5 mm (the paper).
    fastest
        Highest pulse rate [Hz]: 2000 (ours), which is 5 mm/s.

    Raises
    ------
    RangeError
        If a number is not positive.

    Examples
    --------
    >>> drive = Drive()
    >>> drive.pulses_per_metre, drive.pulses(1 * mm), drive.rate(0.2 * mm)
    (400000.0, 400, 80.0)
    >>> drive.pulses(1.001 * mm)
    Traceback (most recent call last):
        ...
    mckibben.errors.RangeError: 1.001 mm are 400.4 pulses; take a multiple of 0.0025 mm
    """

    steps: int = 200
    reduction: float = 10.0
    lead: float = 5 * mm
    fastest: float = 2000.0

    def __post_init__(self) -> None:
        check_positive("drive", steps=float(self.steps), reduction=self.reduction)
        check_positive("drive", "m", lead=self.lead)
        check_positive("drive", "Hz", fastest=self.fastest)

    @property
    def pulses_per_metre(self) -> float:
        """Pulses per metre of travel [1/m]; exact in the given decimals."""
        return float(self.steps * Fraction(str(self.reduction)) / Fraction(str(self.lead)))

    def pulses(self, travel: float) -> int:
        """Pulses for a travel [m].

        Raises
        ------
        RangeError
            If that is no whole number.
        """
        exact = travel * self.pulses_per_metre
        if not np.isfinite(exact) or abs(exact - round(exact)) > _WHOLE:
            one = 1 / self.pulses_per_metre / mm
            raise RangeError(
                f"{travel / mm:g} mm are {exact:g} pulses",
                value=travel,
                unit="m",
                remedy=f"take a multiple of {one:g} mm",
            )
        return round(exact)

    def nearest(self, travel: float) -> int:
        """Nearest number of pulses for a travel [m]."""
        return round(travel * self.pulses_per_metre)

    def travel(self, pulses: ArrayLike) -> NDArray[np.float64]:
        """Travel of pulses [m], any shape."""
        return np.asarray(pulses, np.float64) / self.pulses_per_metre

    def rate(self, speed: float) -> float:
        """Pulse rate [Hz] for a speed [m/s].

        Raises
        ------
        RangeError
            If it is above that of the motor.
        """
        rate = abs(speed) * self.pulses_per_metre
        if not 0 < rate <= self.fastest:
            raise RangeError(
                f"{speed / mm:g} mm/s are {rate:g} pulses a second; the motor does {self.fastest:g} at most",
                value=rate,
                lower=0.0,
                upper=self.fastest,
                unit="Hz",
                remedy=f"move at up to {self.fastest / self.pulses_per_metre / mm:g} mm/s",
            )
        return rate


@dataclass(frozen=True, kw_only=True)
class RigLimits:
    """Limits of a test rig; a single sample beyond one of them stops the test.

    Parameters
    ----------
    pressure
        Highest pressure [Pa, gauge].
    force
        Highest force [N].
    stretch, shorten
        Travel of the rig from where the muscle was mounted [m], either way.
    pressure_rate
        Highest rate of change of the pressure [Pa/s], between the means of two cycles: 50 bar/s. Not checked during
        venting.
    pressure_error
        Highest deviation from the set pressure [Pa] after `settling`: 0.3 bar.
    settling
        Settling time of the pressure [s]: 10 s.
    gap
        Highest age of the newest sample, and longest time without one [s]: 0.5 s.
    frozen
        Longest time for which a sensor may read the same volts [s]; no limit unless given. For sensors with noise.
    deviation
        Highest deviation of a point's mean force from the law [N]; no limit unless given.

    Raises
    ------
    RangeError
        If one is not above 0, or not finite where it has to be.
    """

    pressure: Pressure
    force: Tension
    stretch: Travel
    shorten: Travel
    pressure_rate: PressureRate = 50 * bar / s
    pressure_error: Pressure = 0.3 * bar
    settling: Duration = 10 * s
    gap: PositiveTime = 500 * ms
    frozen: Duration = math.inf
    deviation: Tension = math.inf

    def __post_init__(self) -> None:
        for name, value in asdict(self).items():
            if not value > 0 or (value == math.inf and name not in ("frozen", "deviation")):
                raise RangeError(f"limits: {name} is {value:g}", value=value, remedy="it has to be finite and above 0")


@dataclass(frozen=True, kw_only=True)
class JointLimits:
    """Limits of a joint rig; a single sample beyond one of them stops the run and vents both muscles.

    Parameters
    ----------
    lowest_angle, highest_angle
        [rad].
    pressure
        Highest pressure in either muscle [Pa, gauge].
    angle_rate
        Highest angular velocity [rad/s], between the means over two consecutive windows: 720 deg/s.
    pressure_rate
        Highest rate of change of a pressure [Pa/s], in the same way; no limit unless given.
    window
        Duration of a window [s].
    pressure_error
        Highest deviation of a pressure from its command [Pa], low-pass filtered with `following`: 1 bar. Finds a lost
        supply, a stuck valve, and a sensor that hangs.
    following
        Time constant of that filter [s].
    silence
        Timeout of a sample after it was due [s].
    late
        Highest age of the newest sample, and longest time without one [s].

    Raises
    ------
    RangeError
        If one is not finite and above 0, or the angles are in the wrong order.
    """

    lowest_angle: Angle
    highest_angle: Angle
    pressure: Pressure
    angle_rate: AngularRate = 720 * deg
    pressure_rate: PressureRate = math.inf
    window: PositiveTime = 10 * ms
    pressure_error: Pressure = 1 * bar
    following: PositiveTime = 250 * ms
    silence: PositiveTime = 20 * ms
    late: PositiveTime = 50 * ms

    def __post_init__(self) -> None:
        for name, value in asdict(self).items():
            unlimited = name == "pressure_rate" and value == math.inf
            if not (math.isfinite(value) or unlimited) or (not name.endswith("angle") and value <= 0):
                raise RangeError(f"limits: {name} is {value:g}", value=value, remedy="it has to be finite and above 0")
        if not self.lowest_angle < self.highest_angle:
            raise RangeError(
                f"limits: the angle may be {self.lowest_angle / deg:g}..{self.highest_angle / deg:g} deg",
                remedy="give the lower one first",
            )


@dataclass(frozen=True, kw_only=True)
class Bench:
    """Test bench: the muscle, how it is mounted, the motor, calibrations, limits and recording.

    Parameters
    ----------
    of
        The muscle, or the specimen if its law is not known.
    mounted_at
        Contraction [-] at which the muscle was mounted, the origin of the motor.
    drive
        The motor.
    calibrations
        Of "force", "pressure" (inputs) and "valve" (output).
    limits
        Safety limits.
    rate
        Sampling rate of the backend [Hz].
    cycle
        Period at which samples are read and checked [s]: 100 ms.
    between
        Rate of the record between plateaus [Hz]: 10 Hz. All samples are checked; all samples of a block that stopped
        the test, and those after it, are recorded.
    settled
        Tolerance of the set pressure, for the mean of a cycle [Pa]: 0.1 bar.
    vented
        Pressure below which the muscle is vented [Pa]: 0.1 bar.
    steady
        Time for which the pressure has to be settled or vented [s]: 1 s.
    slack_force
        Highest mean force of a slack muscle [N]: 1 N, for the zero error of a sensor.
    """

    of: Muscle | Specimen
    mounted_at: float = 0.0
    drive: Drive
    calibrations: Mapping[str, Calibration]
    limits: RigLimits
    rate: float = 1000 * Hz
    cycle: PositiveTime = 100 * ms
    between: SampleRate = 10 * Hz
    settled: float = 0.1 * bar
    vented: float = 0.1 * bar
    steady: float = 1 * s
    slack_force: Force = 1 * N

    def __post_init__(self) -> None:
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
        """Position of the motor at a contraction [-], from where the muscle was mounted; the nearest pulse."""
        return self.drive.nearest((self.mounted_at - contraction) * float(self.specimen.initial_length))

    def contraction_at(self, pulses: float) -> float:
        """Contraction [-] at a position of the motor."""
        return self.mounted_at - pulses / self.drive.pulses_per_metre / float(self.specimen.initial_length)
