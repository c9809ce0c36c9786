"""Recordings of a joint or a robot, and prior deviations of its quantities."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
from jaxtyping import Array
from numpy.polynomial.polynomial import polyder, polyval
from numpy.typing import NDArray

from mckibben.component.base import Checked
from mckibben.component.schema import read_component
from mckibben.errors import IdentificationError
from mckibben.units import HINGE, JointQuantity, JointType, Quantity, Strength, deg, kPa

Floats = NDArray[np.float64]
Samplings = Floats | Array
Number = float | np.float64 | Array
PositiveAngle = Annotated[float, JointQuantity("rad", "deg", 0, 57, open_lower=True)]
PositiveNoise = Annotated[float, Quantity("Pa", "kPa", 0, 1e3, open_lower=True)]


@dataclass(frozen=True, eq=False)
class JointRecording:
    """Measured motion of a joint.

    Attributes
    ----------
    time, angle
        Times [s] and angles [rad], shape (samples,).
    pressures, tensions
        Gauge pressures [Pa] of muscles 1 and 2, and their tensions [N] if there are load cells; shape (samples, 2).
    added_mass, distance, weight_inertia
        A known weight [kg] on the limb, the distance of its centre from the axis [m], and its inertia about its own
        centre [kg*m^2].
    tube
        Lag [s] of the pressure in a muscle behind that at its sensor.
    commands
        Commands [Pa], for `calibrate_valves`; shape (samples, 2).
    """

    time: Floats
    angle: Floats
    pressures: Floats
    tensions: Floats | None = None
    added_mass: float = 0.0
    distance: float = 0.0
    weight_inertia: float = 0.0
    tube: float = 0.0
    commands: Floats | None = None


@dataclass(frozen=True)
class JointPrior(Checked):
    """Prior standard deviations of the quantities that a calibration estimates; relative ones refer to the model.

    A file has these fields with units, such as ``mass: 5 %``.

    Attributes
    ----------
    strength, offset
        Pressure-proportional and constant part of a muscle's force, relative to the law's force at its highest pressure
        and the middle contraction; halved for each further power of contraction.
    friction, presliding
        Logarithm of the half width of the friction band at the mean pressure, and shares of the slip lengths.
    friction_growth
        Growth of the half width with pressure, relative to half width and mean pressure.
    creep
        Stiffness of creep relative to the slope of the law: total of three Maxwell arms of 1, 3 and 10 s.
    mass, inertia
        Load mass (`Load.estimated_mass`), and inertia of the load with it, relative.
    damping
        Damping of the joint, relative to critical damping.
    added_mass, distance
        Mass and lever of the weight, relative.
    load_cell
        Gains of the load cells, relative.
    zero
        Encoder zero [rad], of a slide [m]. Default: 1.2 deg, or 1.2 mm.
    arm_scale
        Scale of the moment arms.
    valve, delay, supply, polytropic_index, critical_ratio
        For `calibrate_valves`: logarithms of these quantities, and of all others of a valve.
    volume, pressure_zero
        For `calibrate_valves`: volume of the air in the muscles, relative; reading of the pressure sensors at 0 bar
        [Pa].
    """

    strength: Strength = 0.1
    offset: Strength = 0.05
    friction: Strength = 0.6
    presliding: Strength = 1.0
    friction_growth: Strength = 0.3
    creep: Strength = 0.05
    mass: Strength = 0.3
    inertia: Strength = 0.2
    damping: Strength = 0.1
    added_mass: Strength = 0.005
    distance: Strength = 0.01
    load_cell: Strength = 0.01
    zero: PositiveAngle | None = None
    arm_scale: Strength = 0.03
    delay: Strength = 1.0
    valve: Strength = 0.7
    supply: Strength = 0.05
    polytropic_index: Strength = 0.08
    critical_ratio: Strength = 0.3
    volume: Strength = 0.05
    pressure_zero: PositiveNoise = 1 * kPa

    @classmethod
    def read(cls, path: str | os.PathLike[str], joint_type: JointType = HINGE) -> JointPrior:
        """Read a file; raises `ScenarioError` with every problem: line, field, value, range and remedy."""
        return read_component(cls, Path(path), context={"joint_type": joint_type})

    def zero_of(self, joint_type: JointType) -> float:
        """Return the deviation of the encoder zero of a joint [rad], [m]."""
        return 1.2 * deg * joint_type.scale if self.zero is None else self.zero


def sampling_period(recording: JointRecording, *, longest: float = 0.01) -> float:
    """Mean sampling period [s]; `IdentificationError` for samples that are too sparse, have gaps or do not follow."""
    time, steps = recording.time, np.diff(recording.time)
    period = float(time[-1] - time[0]) / (time.size - 1)
    if period > longest or steps.max() > 5 * longest or steps.min() <= 0:
        worst = int(np.argmin(steps) if steps.min() <= 0 else np.argmax(steps))
        message = f"samples, {period * 1e3:.3g} ms apart on average, are {steps[worst] * 1e3:.3g} ms apart"
        remedy = f"record at {1 / longest:.0f} Hz or more, without gaps of {5 * longest * 1e3:.0f} ms"
        raise IdentificationError(f"{message} at {time[worst]:.6g} s", value=period, unit="s", remedy=remedy)
    return period


def evenly(time: Floats, values: Floats, period: float) -> Floats:
    """Values at equally spaced times from the first on, linear in between, shape (samples,)."""
    return np.interp(time[0] + period * np.arange(time.size), time, values)


def check_recording(recording: JointRecording, *, shortest: float = 5.0) -> None:
    """Raise `IdentificationError` for non-finite numbers, and for a recording that is too short, a duration [s]."""
    columns = [recording.time, recording.angle, recording.pressures]
    columns += [column for column in (recording.tensions, recording.commands) if column is not None]
    if not all(np.all(np.isfinite(column)) for column in columns):
        raise IdentificationError("a recording contains numbers that are not finite", remedy="leave these rows out")
    time = recording.time
    span = float(np.ptp(time)) * time.size / (time.size - 1) if time.size > 1 else 0.0  # the last sample lasts, too
    if time.size < 50 or span < shortest - 1e-6:
        message = f"a recording of {time.size} samples over {span:.3g} s is too short"
        raise IdentificationError(message, value=time.size, remedy=f"record at least {shortest:g} s")


def cubic_width(period: float, *, window: float = 0.05) -> int:
    """Number of samples of a local cubic fit: a window [s] that is short, as it attenuates accelerations."""
    return max(2 * int(window / (2 * period)) + 1, 5)


def local_cubic(values: Floats, period: float, derivative: int = 0) -> Floats:
    """Derivative at each sample of a cubic fitted to the `cubic_width` samples around it, at the ends to the outermost.

    A. Savitzky and M. J. E. Golay, Analytical Chemistry 36, 1964.
    """
    width, polynomials = cubic_width(period), np.eye(4)  # with one coefficient of 1
    half, places = width // 2, np.arange(width) - width // 2
    slopes = polyval(places, polyder(polynomials, derivative)).T / period**derivative
    rows = slopes @ np.linalg.pinv(polyval(places, polynomials).T)  # of samples, for the derivative at each place
    between = np.correlate(values, rows[half])
    return np.concatenate([rows[:half] @ values[:width], between, rows[half + 1 :] @ values[-width:]])
