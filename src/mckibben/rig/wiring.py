"""Wiring of a joint rig: its channels, and their calibrations."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any, NamedTuple

from mckibben.errors import Problem, RigError
from mckibben.rig.backend import Backend
from mckibben.rig.calibration import Calibration
from mckibben.units import bar, deg


class JointReading(NamedTuple):
    """Reading of a joint.

    Attributes
    ----------
    angle
        Measured angle [rad].
    pressure1, pressure2
        Measured gauge pressures [Pa].
    """

    angle: float
    pressure1: float
    pressure2: float


@dataclass(frozen=True, kw_only=True)
class Wiring:
    """Calibrations of the three sensors and two valves of a joint, by channel.

    Defaults are those of common devices: a potentiometer of 340 deg on 10 V, pressure sensors with 1 to 5 V
    for 0 to 10 bar, and regulators (ITV0050 class) that give 9 bar at 10 V.

    Examples
    --------
    >>> wiring = Wiring()
    >>> [calibration.name for calibration in (*wiring.sensors, *wiring.valves)]
    ['angle', 'pressure1', 'pressure2', 'valve1', 'valve2']
    >>> float(wiring.valve1.volts(4.5 * bar))
    5.0
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
        """Return the wiring of the calibrations of a backend.

        Raises
        ------
        RigError
            If these are not of the five channels.
        """
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


class Connected:
    """Calibrations of a backend on its channels, for the real-time loop.

    Parameters
    ----------
    backend
        Backend with the five channels of `Wiring`.

    Raises
    ------
    RigError
        If channels or calibrations are missing.
    """

    def __init__(self, backend: Backend) -> None:
        self.wiring = wiring = Wiring.of(backend.calibrations)
        inputs, outputs = ({one.name: one for one in channels} for channels in (backend.inputs, backend.outputs))
        missing = [c.name for c in wiring.sensors if c.name not in inputs]
        missing += [c.name for c in wiring.valves if c.name not in outputs]
        if missing:
            raise RigError(
                f"the rig has no {', '.join(missing)}: its inputs are {', '.join(inputs)}, its outputs "
                f"{', '.join(outputs)}",
                remedy="connect them, and give the channels these names",
            )
        if len(outputs) != len(wiring.valves):
            raise RigError(
                f"a joint rig has two valves, and this one {len(outputs)} outputs ({', '.join(outputs)})",
                remedy="leave the others out",
            )
        columns = [*inputs]
        self._sensors = [
            (columns.index(c.name), c.gain, c.offset, c.tare, *c.working_volts(inputs[c.name])) for c in wiring.sensors
        ]
        self._valves = sorted(enumerate(wiring.valves), key=lambda one: [*outputs].index(one[1].name))
        self._outputs = outputs

    def picked(self, volts: Sequence[float]) -> list[float]:
        """Return the volts of angle and pressures among those of all inputs [V]."""
        return [volts[sensor[0]] for sensor in self._sensors]

    def reading(self, volts: Sequence[float]) -> JointReading:
        """Reading of one sample; NaN for a lost sensor."""
        return JointReading(
            *(
                (volts[column] - offset) * gain - tare if low <= volts[column] <= high else math.nan
                for column, gain, offset, tare, low, high in self._sensors
            )
        )

    def volts(self, commands: Sequence[float]) -> list[float]:
        """Return the signals of the outputs [V], in their order, for commands of muscles 1 and 2 [Pa]."""
        return [(commands[i] + valve.tare) / valve.gain + valve.offset for i, valve in self._valves]

    def check(self, low: float, high: float) -> list[Problem]:
        """Return the problems of commands from `low` to `high` [Pa], beyond a valve's span or the converter's range."""
        return [problem for c in self.wiring.valves for problem in c.check(low, high, self._outputs[c.name])]
