"""Line of a sensor: gain and offset from readings at known values."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from mckibben.errors import RangeError, UnitError
from mckibben.result import Remark, Result, column
from mckibben.units import GRAVITY, NUMBER, factor, number_and_unit, percent, quantity

_SI = ("N", "Pa", "rad", "m", "N*m", "K")


class SensorLine(Result):
    """Gain and offset of a channel, for the file of a rig: value = gain * reading + offset.

    Attributes
    ----------
    reading, value, deviation
        Numbers of the device (volts or counts), known values [SI], and what they are above the line [SI].
    gain, offset, unit
        The line, and the SI unit of its values.
    is_of_weights
        Whether masses were given, for the force of their weight at 9.81 m/s^2.
    """

    reading: NDArray[np.float64] = column("", "reading")
    value: NDArray[np.float64] = column("", "known value [SI]", digits=6)
    deviation: NDArray[np.float64] = column("", "above the line [SI]", digits=2)
    gain: float = column("", "gain", digits=7)
    offset: float = column("", "offset", digits=7)
    unit: str = column("", "unit")
    is_of_weights: bool

    def verdict(self) -> str:
        """Return the keys of the channel, and how far off the line the readings are."""
        line = f"gain: {self.gain:.7g}, offset: {self.offset:.7g}, unit: {self.unit}"
        if len(self.reading) == 2:
            return line
        most, span = np.abs(self.deviation).max(), np.ptp(self.value)
        return f"{line}; within {most:.2g} {self.unit} of the line, {most / span / percent:.2g} % of the range"

    def remarks(self) -> Iterable[Remark]:
        """Return notes on two readings, and on weights."""
        if len(self.reading) == 2:
            yield Remark.note("reading", "two readings lie on any line: one between them shows whether it is straight")
        if self.is_of_weights:
            yield Remark.note("value", f"masses count as the force of their weight, at {GRAVITY} m/s^2")


def sensor_line(readings: Sequence[str]) -> SensorLine:
    """Fit the line of a sensor to readings at known values.

    Parameters
    ----------
    readings
        Texts such as ``"0.51 = 98.1 N"``: the number that the device shows, and the value at which it does; masses are
        weights on a load cell.

    Raises
    ------
    RangeError
        For fewer than two readings, or readings or values that are all equal.
    UnitError
        For another form, a value without a unit, or units that do not fit together.

    Examples
    --------
    >>> line = sensor_line(["0.02 = 0 kg", "0.5105 = 10 kg", "2.963 = 60 kg"])
    >>> round(line.gain, 1), round(line.offset, 2), line.unit
    (200.0, -4.0, 'N')
    """
    known = [_parsed(text) for text in readings]
    given = {unit for *_, unit in known}
    unit = "N" if given == {"kg"} else next(iter(given), "")
    if len(given) > 1:
        raise UnitError(f"readings are in {' and '.join(sorted(given))}", remedy="give all in units of one quantity")
    numbers, values = np.array([(reading, value) for reading, value, _ in known]).reshape(-1, 2).T
    for name, column_of in (("readings", numbers), ("values", values)):
        if len(set(column_of.tolist())) < 2:
            message = f"a line needs two different {name}"
            raise RangeError(message, field="readings", value=len(readings), remedy='give "0.02 = 0 N" "2.96 = 600 N"')
    if given == {"kg"}:
        values = values * GRAVITY
    gain, offset = np.polyfit(numbers, values, 1)
    deviation = values - (gain * numbers + offset)
    return SensorLine(numbers, values, deviation, float(gain), float(offset), unit, given == {"kg"})


def _parsed(text: str) -> tuple[float, float, str]:
    """Reading, value in SI and its SI unit, or kg."""
    reading, _, value = text.partition("=")
    if not NUMBER.fullmatch(reading.strip()):
        raise UnitError(f"{text!r} is no reading", value=text, remedy='write "READING = VALUE UNIT": "0.51 = 98.1 N"')
    _, written = number_and_unit(value)
    for unit in (*_SI, "kg"):
        try:
            factor(written or "1", unit)
        except UnitError:
            continue
        return float(reading), quantity(value, unit), unit
    remedy = f"give one of {', '.join(_SI)}, another unit of the same quantity, or kg on a load cell"
    raise UnitError(f"{text!r} has no unit of a sensor", value=text, remedy=remedy)
