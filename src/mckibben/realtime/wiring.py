"""Wiring of a joint rig: its channels, and their calibrations."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any, NamedTuple

from mckibben.errors import Problem, RigError
from mckibben.rig.backend import AnalogChannel, Backend
from mckibben.rig.calibration import Calibration
from mckibben.units import bar, deg


class JointReading(NamedTuple):
    """Measured angle [rad] and gauge pressures [Pa]."""

    angle: float
    pressure1: float
    pressure2: float


class _Line(NamedTuple):
    """Column and calibration of a sensor, and its working range [V]."""

    name: str
    column: int
    gain: float
    offset: float
    tare: float
    low: float
    high: float


@dataclass(frozen=True, kw_only=True)
class Wiring:
    """Calibrations of the three sensors and two valves of a joint, by channel.

    Defaults are those of common devices: a potentiometer of 340 deg on 10 V, pressure sensors with 1 to 5 V
    for 0 to 10 bar, and regulators (ITV0050 class) that give 9 bar at 10 V.
    """

    angle: Calibration = Calibration(
        name="angle", unit="rad", gain=36 * deg, offset=5.0, low=-170 * deg, high=170 * deg
    )
    pressure1: Calibration = Calibration(
        name="pressure1", unit="Pa", gain=2.5 * bar, offset=1.0, low=-0.3 * bar, high=10 * bar
    )
    pressure2: Calibration = Calibration(
        name="pressure2", unit="Pa", gain=2.5 * bar, offset=1.0, low=-0.3 * bar, high=10 * bar
    )
    valve1: Calibration = Calibration(name="valve1", unit="Pa", gain=0.9 * bar, low=0.0, high=9 * bar)
    valve2: Calibration = Calibration(name="valve2", unit="Pa", gain=0.9 * bar, low=0.0, high=9 * bar)

    @classmethod
    def of(cls, calibrations: Mapping[str, Calibration]) -> Wiring:
        """Return the calibrations of a backend; `RigError` if these are not of the five channels."""
        channels = [field.name for field in fields(cls)]
        if set(calibrations) != set(channels):
            raise RigError(
                f"the rig has calibrations of {', '.join(calibrations) or 'no channel'}",
                remedy=f"a joint needs those of {', '.join(channels)}",
            )
        return cls(**calibrations)

    @property
    def sensors(self) -> tuple[Calibration, Calibration, Calibration]:
        """Calibrations of angle and pressures."""
        return self.angle, self.pressure1, self.pressure2

    @property
    def valves(self) -> tuple[Calibration, Calibration]:
        """Calibrations of both valves."""
        return self.valve1, self.valve2

    def to_json(self) -> dict[str, Any]:
        """As a JSON object, by channel."""
        return {field.name: getattr(self, field.name).to_json() for field in fields(self)}

    def connected(self, backend: Backend) -> Connected:
        """Calibrations on the channels of a backend; `RigError` if channels are missing."""
        inputs, outputs = [one.name for one in backend.inputs], [one.name for one in backend.outputs]
        missing = [c.name for c in self.sensors if c.name not in inputs]
        missing += [c.name for c in self.valves if c.name not in outputs]
        if missing:
            raise RigError(
                f"the rig has no {', '.join(missing)}: its inputs are {', '.join(inputs)}, its outputs "
                f"{', '.join(outputs)}",
                remedy="connect them, and name the channels so",
            )
        return Connected(self, backend.inputs, backend.outputs)


class Connected:
    """Calibrations on the channels of a backend, as plain floats for the real-time loop."""

    def __init__(self, wiring: Wiring, inputs: Sequence[AnalogChannel], outputs: Sequence[AnalogChannel]) -> None:
        self.wiring = wiring
        names = [one.name for one in inputs]
        self._lines = [_line(c, names.index(c.name), inputs) for c in wiring.sensors]
        names = [one.name for one in outputs]
        at = [names.index(c.name) for c in wiring.valves]
        self._order = [at.index(i) for i in range(len(names))] if sorted(at) == list(range(len(names))) else None
        if self._order is None:
            raise RigError(
                f"a joint rig has two valves, and this one {len(names)} outputs ({', '.join(names)})",
                remedy="leave the others out",
            )
        self._outputs = outputs

    def picked(self, volts: Sequence[float]) -> list[float]:
        """Volts of angle and pressures, of those of all inputs."""
        return [volts[line.column] for line in self._lines]

    def reading(self, volts: Sequence[float]) -> JointReading:
        """Reading of one sample; NaN for a lost sensor."""
        return JointReading(
            *(
                (volts[line.column] - line.offset) * line.gain - line.tare
                if line.low < volts[line.column] < line.high
                else math.nan
                for line in self._lines
            )
        )

    def volts(self, commands: Sequence[float]) -> list[float]:
        """Signals of the outputs [V] for commands of muscles 1 and 2 [Pa]."""
        signals = [
            (command + valve.tare) / valve.gain + valve.offset
            for command, valve in zip(commands, self.wiring.valves, strict=True)
        ]
        assert self._order is not None
        return [signals[i] for i in self._order]

    def check(self, low: float, high: float) -> list[Problem]:
        """Violations of commands from low to high [Pa]."""
        assert self._order is not None
        channels = {channel.name: channel for channel in self._outputs}
        return [problem for c in self.wiring.valves for problem in c.check(low, high, channels[c.name])]


def _line(calibration: Calibration, column: int, inputs: Sequence[AnalogChannel]) -> _Line:
    low, high = calibration.limits
    low, high = max(low, inputs[column].low), min(high, inputs[column].high)
    return _Line(calibration.name, column, calibration.gain, calibration.offset, calibration.tare, low, high)
