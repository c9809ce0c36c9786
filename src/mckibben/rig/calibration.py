"""Linear calibrations of channels, fitted to known loads."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mckibben.config.document import read_json
from mckibben.errors import McKibbenError, Problem, RangeError, RigError, ScenarioError, quoted
from mckibben.rig.backend import AnalogChannel
from mckibben.units import percent

_NUMBERS = ("gain", "offset", "tare", "low", "high")


@dataclass(frozen=True, kw_only=True)
class Calibration:
    r"""Linear calibration of a channel, from volts to a quantity in SI.

    .. math:: x = g\,(U - U_0) - x_0

    Inputs are read by it; outputs (valves) are set by its inverse.

    Parameters
    ----------
    name
        Name of the channel: "force", "pressure", "valve", "angle" ...
    unit
        Unit of the quantity, SI: "N", "Pa", "rad".
    gain
        g, in the unit per volt; negative for a sensor wired in reverse.
    offset
        U0 [V].
    tare
        x0, in the unit: the reading of the unloaded sensor, see `tared`.
    low, high
        Span of the sensor, in the unit.
    margin
        Share of the span [-] by which a reading may leave it before the sensor counts as `lost`: 2 %.
    made, by, method
        Date, author and method, as text.
    known, volts_read
        Data that it was fitted to, in the unit and in volts; empty for values of a data sheet.
    residual
        Largest residual of the fit, in the unit.

    Raises
    ------
    RangeError
        If a number is not finite, or the span is empty.

    Examples
    --------
    >>> force = Calibration(name="force", unit="N", gain=200.0, low=-2000.0, high=2000.0)
    >>> force.si([0.0, 1.5]), float(force.volts(630.0))
    (array([  0., 300.]), 3.15)
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
                raise RangeError(
                    f"calibration of {self.name}: {field} is {value:g}",
                    value=value,
                    remedy="it has to be finite" + (" and other than 0" if field == "gain" else ""),
                )
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
        """Whether no working sensor gives these volts [V]; any shape.

        They are outside the span by more than the margin, at an end of the converter's range, or not a number. A tare
        does not move the span.
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
        """Violations of measuring (or setting) values from low to high, in the unit.

        They have to be within the span, and within the range of the converter, if it is given.
        """
        problems: list[Problem] = []
        if low < self.low or high > self.high:
            problems.append(
                Problem(
                    f"{low:g}..{high:g} {self.unit} leaves its span {self.low:g}..{self.high:g} {self.unit}",
                    field=self.name,
                    remedy="stay within it, or take another sensor",
                )
            )
        if channel is not None:
            ends = sorted(float(end) for end in self.volts([low, high]))
            if ends[0] < channel.low or ends[1] > channel.high:
                problems.append(
                    Problem(
                        f"{low:g}..{high:g} {self.unit} are {ends[0]:g}..{ends[1]:g} V, and the converter has "
                        f"{channel.low:g}..{channel.high:g} V",
                        field=self.name,
                        remedy="stay within it, or set its range",
                    )
                )
        return problems

    def tared(self, volts: ArrayLike) -> Calibration:
        """Return the calibration that reads 0 at the mean of these volts [V] of the unloaded sensor.

        Raises
        ------
        RigError
            If the sensor is lost, or the tare exceeds a tenth of its span: then it is not unloaded.
        """
        readings = np.asarray(volts, np.float64)
        if not readings.size or self.lost(readings).any():
            raise RigError(f"no {self.name} to tare: the sensor is lost", remedy="check its wiring and its supply")
        tare = float(np.mean((readings - self.offset) * self.gain))
        if abs(tare) > 0.1 * (self.high - self.low):
            raise RigError(
                f"the unloaded {self.name} reads {tare:g} {self.unit}, more than a tenth of its span",
                value=tare,
                unit=self.unit,
                remedy="take the load off, or repeat the calibration",
            )
        return replace(self, tare=tare)

    def to_json(self) -> dict[str, Any]:
        """JSON object for `from_json`."""
        form: dict[str, Any] = {field: getattr(self, field) for field in (*self._texts[:2], *_NUMBERS, "margin")}
        form |= {field: getattr(self, field) for field in self._texts[2:] if getattr(self, field)}
        if self.known:
            form |= {"known": list(self.known), "volts_read": list(self.volts_read), "residual": self.residual}
        return form

    @classmethod
    def from_json(cls, form: Mapping[str, Any]) -> Calibration:
        """Calibration from a JSON object.

        Raises
        ------
        RangeError
            If fields are missing, unknown, or of a wrong type; all of them at once.
        """
        lists, numbers = ("known", "volts_read"), (*_NUMBERS, "margin", "residual")
        needed = ("name", "unit", "gain", "low", "high")
        problems = [Problem("missing", field=field) for field in needed if field not in form]
        for field, value in form.items():
            if field in cls._texts:
                right = isinstance(value, str)
            elif field in numbers:
                right = isinstance(value, int | float) and not isinstance(value, bool)
            elif field in lists:
                right = isinstance(value, list | tuple) and all(isinstance(one, int | float) for one in value)
            else:
                problems.append(Problem("unknown", field=str(field)))
                continue
            if not right:
                problems.append(Problem(f"{quoted(value)} has no meaning", field=field))
        if problems:
            name = form.get("name", "a channel")
            raise RangeError("\n  ".join([f"calibration of {name}: {len(problems)} problem(s)", *map(str, problems)]))
        values: dict[str, Any] = dict(form)
        values |= {field: float(values[field]) for field in numbers if field in values}
        values |= {field: tuple(map(float, values[field])) for field in lists if field in values}
        return cls(**values)


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
    coverage: float = 60 * percent,
    tolerance: float = 1 * percent,
) -> Calibration:
    """Least-squares calibration line through readings [V] at known values.

    With more than two points the largest residual is stored and checked.

    Parameters
    ----------
    name, unit
        Name of the channel, unit of the known values.
    volts, known
        Readings [V] and known values, in the unit; shape (points,).
    low, high
        Span of the sensor, in the unit.
    made, by
        Date and author, as text.
    coverage
        Share of the span [-] that the known values have to cover, of the smaller side where the span has two signs:
        60 %.
    tolerance
        Highest residual, as a share [-] of the range of the known values: 1 %.

    Raises
    ------
    RigError
        If there are fewer than two different points, the span is not covered, or the residual is too large.

    Examples
    --------
    >>> made = calibrate("force", "N", volts=[0.02, 1.02, 3.02], known=[0, 200, 600], low=0, high=800)
    >>> round(made.gain, 6), round(made.offset, 6), round(made.residual, 6)
    (200.0, 0.02, 0.0)
    """
    read, there = np.asarray(volts, np.float64), np.asarray(known, np.float64)
    if read.shape != there.shape or read.ndim != 1 or not np.isfinite([read, there]).all():
        raise RigError(f"{name}: {read.size} readings for {there.size} known values", remedy="give one for each")
    if len(set(there.tolist())) < 2 or np.ptp(read) <= 0:
        raise RigError(f"{name}: a line needs two different points", remedy="put another load on, and read again")
    reach = high - low if low * high >= 0 else min(-low, high)
    covered = float(np.ptp(there)) / reach
    if covered < coverage or there.min() < low or there.max() > high:
        raise RigError(
            f"{name}: the known values {there.min():g}..{there.max():g} {unit} cover {covered / percent:.0f} % of the "
            f"span {low:g}..{high:g} {unit}",
            value=covered,
            lower=coverage,
            upper=1.0,
            remedy=f"spread them over at least {coverage / percent:g} % of it, and not beyond, or give the span that "
            f"you use",
        )
    middle = read.mean()
    gain, at_middle = np.polynomial.polynomial.polyfit(read - middle, there, 1)[::-1]
    off = there - (at_middle + gain * (read - middle))
    worst = int(np.argmax(np.abs(off)))
    residual = float(abs(off[worst]))
    if residual > tolerance * np.ptp(there):
        raise RigError(
            f"{name}: the reading {read[worst]:g} V at {there[worst]:g} {unit} is {residual:g} {unit} off the line, "
            f"{residual / float(np.ptp(there)) / percent:.2g} % of the range",
            value=residual,
            upper=tolerance * float(np.ptp(there)),
            unit=unit,
            remedy="read it again; if it stays, the sensor is not linear or is overloaded",
        )
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


def content_of(path: Path, remedy: str) -> Mapping[str, Any]:
    """Content of a file of calibrations, by the names of the channels; `remedy` is that of the error.

    Raises
    ------
    ScenarioError
        If it cannot be read, or is not a JSON object.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, ValueError) as error:
        raise ScenarioError(str(path), [Problem(f"cannot be read: {error}", remedy=remedy)]) from None
    content = read_json(text, str(path))
    if not isinstance(content, dict):
        raise ScenarioError(str(path), [Problem("is no mapping of calibrations", remedy=remedy)])
    return content


def calibrations_in(content: Mapping[str, Any]) -> tuple[dict[str, Calibration], list[Problem]]:
    """Calibrations that can be read, and the problems of the others."""
    found: dict[str, Calibration] = {}
    problems: list[Problem] = []
    for name, form in content.items():
        try:
            found[name] = Calibration.from_json(form)
        except (McKibbenError, TypeError, AttributeError) as error:
            problems.append(Problem(str(error), field=name))
    return found, problems
