"""Linear calibrations of the channels of a card, fitted to known loads."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import ConfigDict, FiniteFloat, TypeAdapter, ValidationError

from mckibben.errors import Problem, RangeError, RigError, ScenarioError
from mckibben.rig.backend import Channel
from mckibben.units import percent

_COVERAGE = 60 * percent  # share of the span that the known values cover, of the smaller side of two signs
_TOLERANCE = 1 * percent  # highest residual, as a share of the range of the known values


@dataclass(frozen=True, kw_only=True)
class Calibration:
    """Linear calibration of a channel, ``x = gain (U - offset) - tare``; a valve is set by the inverse.

    Parameters
    ----------
    name
        Name of the channel, such as "force", "pressure", "valve", "angle".
    unit
        SI unit of x, such as "N", "Pa", "rad".
    gain
        Units per volt; negative for a sensor that is wired in reverse.
    offset
        Volts [V] at 0 before the tare.
    tare
        Reading of the unloaded sensor.
    low, high
        Span of the sensor, in the unit.
    margin
        Share of the span by which a reading may leave it before the sensor counts as lost.
    made, by, method
        Date, person and method of the calibration.
    known, volts_read, residual
        Data of the fit, and its largest residual, in the unit.

    Raises
    ------
    RangeError
        If a number is not finite, the gain is 0, or the span is empty.

    Examples
    --------
    >>> force = Calibration(name="force", unit="N", gain=200.0, offset=0.05, low=-2000.0, high=2000.0)
    >>> float(force.si(1.05)), float(force.volts(200.0))
    (200.0, 1.05)
    """

    __pydantic_config__ = ConfigDict(extra="forbid")

    name: str
    unit: str
    gain: FiniteFloat
    offset: FiniteFloat = 0.0
    tare: FiniteFloat = 0.0
    low: FiniteFloat
    high: FiniteFloat
    margin: FiniteFloat = 2 * percent
    made: str = ""
    by: str = ""
    method: str = ""
    known: tuple[float, ...] = ()
    volts_read: tuple[float, ...] = ()
    residual: FiniteFloat = 0.0

    def __post_init__(self) -> None:
        numbers = self.gain, self.offset, self.tare, self.low, self.high
        if self.gain == 0 or not self.low < self.high or self.margin < 0 or not np.isfinite(numbers).all():
            raise RangeError(
                f"calibration of {self.name}: a gain of {self.gain:g}, and a span of {self.low:g}..{self.high:g} "
                f"{self.unit} with a margin of {self.margin / percent:g} %",
                field="gain" if self.gain == 0 else "low",
                remedy="give finite numbers, a gain other than 0, low below high, and a margin of 0 or more",
            )

    def si(self, volts: ArrayLike) -> NDArray[np.float64]:
        """Quantity in the unit at volts [V]; any shape."""
        return (np.asarray(volts, np.float64) - self.offset) * self.gain - self.tare

    def volts(self, si: ArrayLike) -> NDArray[np.float64]:
        """Volts [V] at a quantity in the unit; any shape."""
        return (np.asarray(si, np.float64) + self.tare) / self.gain + self.offset

    def channel(self, where: str, low: float, high: float) -> Channel:
        """Return the channel at a terminal whose converter has a range from `low` to `high` [V].

        Its range is the span and the margin, without the ends of the range of the converter, where a sensor is lost.
        """
        beyond = self.margin * (self.high - self.low)
        ends = sorted(map(float, self.si([math.nextafter(low, math.inf), math.nextafter(high, -math.inf)])))
        least, most = self.low - beyond - self.tare, self.high + beyond - self.tare
        return Channel(self.name, self.unit, max(ends[0], least), min(ends[1], most), where)


def calibrate(
    name: str,
    unit: str,
    *,
    volts: Sequence[float],
    known: Sequence[float],
    low: float,
    high: float,
    made: str = "",
    by: str = "",
) -> Calibration:
    """Fit a calibration to readings at known values by least squares.

    Parameters
    ----------
    name, unit
        Name of the channel, and SI unit of the known values.
    volts, known
        Readings [V] and values, shape (points,).
    low, high
        Span of the sensor, in the unit; the values have to cover 60 % of it.
    made, by
        Date and person, for the record.

    Raises
    ------
    RigError
        If shapes differ, the points make no line, they do not cover the span, or the largest residual exceeds 1 % of
        their range.

    Examples
    --------
    >>> fitted = calibrate("force", "N", volts=[0.0, 2.5, 5.0], known=[0.0, 500.0, 1000.0], low=0.0, high=1000.0)
    >>> round(fitted.gain, 6), fitted.method
    (200.0, 'least squares of 3 points')
    """
    read, there = np.asarray(volts, np.float64), np.asarray(known, np.float64)
    if read.shape != there.shape or read.ndim != 1 or not np.isfinite([read, there]).all():
        raise RigError(f"{name}: {read.size} readings for {there.size} known values", remedy="give one for each")
    if len(set(there.tolist())) < 2 or np.ptp(read) <= 0:
        raise RigError(f"{name}: a line needs two different points", remedy="apply another load, and read again")
    reach = high - low if low * high >= 0 else min(-low, high)
    covered = float(np.ptp(there)) / reach
    if covered < _COVERAGE or there.min() < low or there.max() > high:
        raise RigError(
            f"{name}: the known values {there.min():g}..{there.max():g} {unit} cover {covered / percent:.0f} % of the "
            f"span {low:g}..{high:g} {unit}",
            value=covered,
            lower=_COVERAGE,
            upper=1.0,
            remedy=f"spread them over at least {_COVERAGE / percent:g} % of it, and not beyond, or give the span that "
            f"you use",
        )
    middle = read.mean()
    gain, at_middle = np.polynomial.polynomial.polyfit(read - middle, there, 1)[::-1]
    off = there - (at_middle + gain * (read - middle))
    worst = int(np.argmax(np.abs(off)))
    residual = float(abs(off[worst]))
    if residual > _TOLERANCE * np.ptp(there):
        message = (
            f"{name}: the reading {read[worst]:g} V at {there[worst]:g} {unit} is {residual:g} {unit} off the line, "
            f"{residual / float(np.ptp(there)) / percent:.2g} % of the range"
        )
        remedy = "read it again; if it stays, the sensor is not linear or is overloaded"
        raise RigError(message, value=residual, upper=_TOLERANCE * float(np.ptp(there)), unit=unit, remedy=remedy)
    return Calibration(
        name=name,
        unit=unit,
        gain=float(gain),
        offset=float(middle - at_middle / gain),
        low=low,
        high=high,
        made=made,
        by=by,
        method=f"least squares of {len(read)} points" if len(read) > 2 else "two points",
        known=tuple(there.tolist()),
        volts_read=tuple(read.tolist()),
        residual=residual if len(read) > 2 else 0.0,
    )


_FILE = TypeAdapter(dict[str, Calibration])


def to_json(calibrations: Mapping[str, Calibration]) -> str:
    """Content of a file for `read_calibrations`."""
    return _FILE.dump_json(dict(calibrations), indent=2).decode()


def read_calibrations(path: Path, units: Mapping[str, str]) -> dict[str, Calibration]:
    """Read the calibrations of a rig from a JSON file.

    Parameters
    ----------
    path
        File with one object per channel, see `to_json`.
    units
        SI units by channel; the file has to have these channels and no others.

    Raises
    ------
    ScenarioError
        With all problems of the file.
    """
    remedy = f"it needs {', '.join(units)}, see docs/rig-hardware.md"
    try:
        calibrations = _FILE.validate_json(path.read_bytes())
    except OSError as error:
        raise ScenarioError(str(path), [Problem(f"cannot be read: {error}", remedy=remedy)]) from None
    except ValidationError as error:
        problems = [Problem(row["msg"], field=".".join(map(str, row["loc"])), remedy=remedy) for row in error.errors()]
        raise ScenarioError(str(path), problems) from None
    problems = [Problem("is missing", field=name, remedy=remedy) for name in units if name not in calibrations]
    for name, calibration in calibrations.items():
        if name not in units:
            problems.append(Problem("is not a channel of this rig", field=name, remedy=remedy))
        elif (calibration.name, calibration.unit) != (name, units[name]):
            message = f"is of {calibration.name!r} in {calibration.unit}, not in {units[name]}"
            problems.append(Problem(message, field=name))
    if problems:
        raise ScenarioError(str(path), problems)
    return calibrations
