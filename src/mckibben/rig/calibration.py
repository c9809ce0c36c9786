"""Linear calibrations of channels, fitted to known loads."""

from __future__ import annotations

import json
import math
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic_core import from_json

from mckibben.errors import McKibbenError, Problem, RangeError, RigError, ScenarioError, quoted, refuse_problems
from mckibben.rig.backend import AnalogChannel
from mckibben.units import percent

_NUMBERS = ("gain", "offset", "tare", "low", "high")
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
        Reading of the unloaded sensor, see `tared`.
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

    name: str
    unit: str
    gain: float
    offset: float = 0.0
    tare: float = 0.0
    low: float
    high: float
    margin: float = 2 * percent
    made: str = ""
    by: str = ""
    method: str = ""
    known: tuple[float, ...] = ()
    volts_read: tuple[float, ...] = ()
    residual: float = 0.0

    _texts: ClassVar[tuple[str, ...]] = ("name", "unit", "made", "by", "method")

    def __post_init__(self) -> None:
        for field in (*_NUMBERS, "margin", "residual"):
            value = getattr(self, field)
            if not math.isfinite(value) or (field == "gain" and value == 0):
                remedy = "it has to be finite" + (" and other than 0" if field == "gain" else "")
                raise RangeError(f"calibration of {self.name}: {field} is {value:g}", value=value, remedy=remedy)
        if not self.low < self.high or self.margin < 0:
            raise RangeError(
                f"calibration of {self.name}: the span {self.low:g}..{self.high:g} {self.unit} with a margin of "
                f"{self.margin / percent:g} % is empty",
                remedy="give low below high, and a margin of 0 or more",
            )

    def si(self, volts: ArrayLike) -> NDArray[np.float64]:
        """Quantity in the unit at volts [V]; any shape."""
        return (np.asarray(volts, np.float64) - self.offset) * self.gain - self.tare

    def volts(self, si: ArrayLike) -> NDArray[np.float64]:
        """Volts [V] at a quantity in the unit; any shape."""
        return (np.asarray(si, np.float64) + self.tare) / self.gain + self.offset

    def lost(self, volts: ArrayLike, channel: AnalogChannel | None = None) -> NDArray[np.bool_]:
        """Return whether volts mark a lost sensor: outside its working range, or NaN.

        Parameters
        ----------
        volts
            Readings [V], any shape.
        channel
            Channel of the converter; readings at the ends of its range count as lost.
        """
        volts = np.asarray(volts, np.float64)
        lowest, highest = self.working_volts(channel)
        return ~((volts >= lowest) & (volts <= highest))

    @property
    def limits(self) -> tuple[float, float]:
        """Lowest and highest volts [V] of a working sensor: its span and the margin."""
        beyond = self.margin * (self.high - self.low)
        ends = sorted(end / self.gain + self.offset for end in (self.low - beyond, self.high + beyond))
        return ends[0], ends[1]

    def working_volts(self, channel: AnalogChannel | None) -> tuple[float, float]:
        """Lowest and highest volts [V] of a working sensor; the ends of the converter's range are excluded."""
        low, high = self.limits
        if channel is None:
            return low, high
        return max(low, math.nextafter(channel.low, math.inf)), min(high, math.nextafter(channel.high, -math.inf))

    def check(self, low: float, high: float, channel: AnalogChannel | None = None) -> list[Problem]:
        """Return the problems of values from `low` to `high`, in the unit, beyond the span or the converter's range."""
        problems: list[Problem] = []
        if low < self.low or high > self.high:
            message = f"{low:g}..{high:g} {self.unit} leaves its span {self.low:g}..{self.high:g} {self.unit}"
            problems.append(Problem(message, field=self.name, remedy="stay within it, or use another sensor"))
        if channel is not None:
            ends = sorted(float(end) for end in self.volts([low, high]))
            if ends[0] < channel.low or ends[1] > channel.high:
                message = (
                    f"{low:g}..{high:g} {self.unit} are {ends[0]:g}..{ends[1]:g} V, and the converter has "
                    f"{channel.low:g}..{channel.high:g} V"
                )
                problems.append(Problem(message, field=self.name, remedy="stay within it, or set its range"))
        return problems

    def tared(self, volts: ArrayLike) -> Calibration:
        """Return the calibration that reads 0 at the mean of volts [V] of the unloaded sensor.

        Raises
        ------
        RigError
            If a reading is that of a lost sensor, or the tare is more than a tenth of the span.
        """
        readings = np.asarray(volts, np.float64)
        if not readings.size or self.lost(readings).any():
            raise RigError(f"no {self.name} to tare: the sensor is lost", remedy="check its wiring and its supply")
        tare = float(np.mean((readings - self.offset) * self.gain))
        if abs(tare) > 0.1 * (self.high - self.low):
            message = f"the unloaded {self.name} reads {tare:g} {self.unit}, more than a tenth of its span"
            raise RigError(message, value=tare, unit=self.unit, remedy="take the load off, or repeat the calibration")
        return replace(self, tare=tare)

    def to_json(self) -> dict[str, Any]:
        """JSON object for `from_json`."""
        form: dict[str, Any] = {field: getattr(self, field) for field in (*self._texts[:2], *_NUMBERS, "margin")}
        form |= {field: getattr(self, field) for field in self._texts[2:] if getattr(self, field)}
        if self.known:
            form |= {"known": list(self.known), "volts_read": list(self.volts_read), "residual": self.residual}
        return form | {"checksum": _checksum(form)}

    @classmethod
    def from_json(cls, form: Mapping[str, Any]) -> Calibration:
        """Return the calibration of a JSON object.

        Raises
        ------
        RangeError
            With all fields that are missing, unknown or wrong, or because the checksum does not match; an object
            without a checksum is accepted.
        """
        lists, numbers = ("known", "volts_read"), (*_NUMBERS, "margin", "residual")
        needed = ("name", "unit", "gain", "low", "high")
        problems = [Problem("missing", field=field) for field in needed if field not in form]
        form = dict(form)
        checksum = form.pop("checksum", None)
        if checksum not in (None, _checksum(form)):
            remedy = "restore the file; if it was changed on purpose, leave the checksum out"
            problems.append(Problem("does not match: the file was changed or damaged", field="checksum", remedy=remedy))
        for field, value in form.items():
            if field in cls._texts:
                right, kind = isinstance(value, str), "text"
            elif field in numbers:
                right, kind = isinstance(value, int | float) and not isinstance(value, bool), "a number"
            elif field in lists:
                right = isinstance(value, list | tuple) and all(isinstance(one, int | float) for one in value)
                kind = "a list of numbers"
            else:
                problems.append(Problem("is not a known key", field=str(field), value=value))
                continue
            if not right:
                problems.append(Problem(f"{quoted(value)} is not {kind}", field=field, value=value))
        refuse_problems(f"calibration of {form.get('name', 'a channel')}", problems)
        values: dict[str, Any] = dict(form)
        values |= {field: float(values[field]) for field in numbers if field in values}
        values |= {field: tuple(map(float, values[field])) for field in lists if field in values}
        return cls(**values)


def _checksum(form: Mapping[str, Any]) -> str:
    return f"{zlib.crc32(json.dumps(form, sort_keys=True).encode()):08x}"


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


def read_calibrations(path: Path, units: Mapping[str, str]) -> dict[str, Calibration]:
    """Read the calibrations of a rig from a JSON file.

    Parameters
    ----------
    path
        File with one object per channel, see `Calibration.to_json`.
    units
        SI units by channel; the file has to have these channels and no others.

    Raises
    ------
    ScenarioError
        With all problems of the file.
    """
    remedy = f"it needs {', '.join(units)}, see docs/rig-hardware.md"
    try:
        content = from_json(path.read_text(encoding="utf-8"), allow_inf_nan=False)
    except (OSError, ValueError) as error:
        raise ScenarioError(str(path), [Problem(f"cannot be read: {error}", remedy=remedy)]) from None
    if not isinstance(content, dict):
        raise ScenarioError(str(path), [Problem("is not a mapping of calibrations", remedy=remedy)])
    found: dict[str, Calibration] = {}
    problems = [Problem("is missing", field=name, remedy=remedy) for name in units if name not in content]
    for name, form in content.items():
        if name not in units:
            problems.append(Problem("is not a channel of this rig", field=name, remedy=remedy))
            continue
        try:
            one = found[name] = Calibration.from_json(form)
        except (McKibbenError, TypeError, AttributeError) as error:
            problems.append(Problem(str(error), field=name))
            continue
        if (one.name, one.unit) != (name, units[name]):
            problems.append(Problem(f"is of {one.name!r} in {one.unit}, not in {units[name]}", field=name))
    if problems:
        raise ScenarioError(str(path), problems)
    return found
