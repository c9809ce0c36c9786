"""Probe of a joint's channels before a run: each muscle alone has a low pressure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from mckibben.errors import StoppedError
from mckibben.rig.joint_record import JointReading
from mckibben.rig.safety import PROBED
from mckibben.units import bar, deg

MOVED = 0.5 * deg
"""Change of the angle [rad] that counts as a motion."""

_TAUT = 0.01  # N*m, least torque of a muscle that is not slack


@dataclass(eq=False)
class ChannelProbe:
    """Check of sensors, valves and supply: vented, muscle 1, vented, muscle 2, each for a quarter of the time.

    The means over the second half of each quarter are compared: by at least half of the set pressure, the sensor of the
    muscle has to follow, and the other must not.

    Parameters
    ----------
    periods
        Control periods of the whole probe.
    torques
        Torque of each muscle at that pressure [N*m], of which the sign counts; 0 for a slack one.
    probed
        Whether each muscle takes air.
    """

    periods: int
    torques: tuple[float, float]
    probed: Sequence[bool]
    _quarter: int = field(default=0, init=False)
    _readings: list[JointReading] = field(default_factory=list, init=False)
    _vented: NDArray[np.float64] = field(default_factory=lambda: np.zeros(3), init=False)

    def commands(self, number: int, reading: JointReading) -> tuple[float, float]:
        """Take the reading of a period, and return its commands [Pa].

        Raises
        ------
        StoppedError
            As `finish`, at the end of a quarter.
        """
        quarter, place = divmod(4 * number, self.periods)
        if quarter != self._quarter:
            self.finish()
            self._quarter = quarter
        if 2 * place >= self.periods:
            self._readings.append(reading)
        return PROBED * (quarter == 1), PROBED * (quarter == 3)

    def finish(self) -> None:
        """Check the readings of the quarter so far; nothing without readings.

        Raises
        ------
        StoppedError
            If the sensor of the muscle does not follow, that of the other does, or the joint moves the wrong way.
        """
        if not self._readings:
            return
        means, self._readings = np.mean(self._readings, axis=0), []
        muscle, pressurised = divmod(self._quarter, 2)
        if not pressurised:
            self._vented = means
        elif self.probed[muscle]:
            self._check(muscle, means - self._vented)

    def _check(self, muscle: int, change: NDArray[np.float64]) -> None:
        """Check the change of angle and pressures by a muscle."""
        number, other = muscle + 1, 2 - muscle
        follows, disturbed = change[number] >= PROBED / 2, change[other] >= PROBED / 2
        with_muscle = f"with {PROBED / bar:g} bar set at muscle {number}"
        if disturbed or not follows:
            remedy = f"check the supply, valve {number}, its hose, and the wiring of pressure sensor {number}"
            if disturbed:
                remedy = "check whether both muscles share a hose or a sensor"
            if disturbed and not follows:
                remedy = "the pressure sensors are swapped, or the valves: exchange two of them"
            raise StoppedError(
                f"{with_muscle}, pressure {number} rises by {change[number] / bar:.2f} bar and pressure {other} by "
                f"{change[other] / bar:.2f} bar",
                field=f"pressure{number}",
                value=float(change[number]),
                unit="Pa",
                remedy=remedy,
            )
        torque = self.torques[muscle]
        if abs(torque) > _TAUT and change[0] * np.sign(torque) < -MOVED:
            raise StoppedError(
                f"{with_muscle}, the angle moves by {change[0] / deg:.2g} deg, against the muscle",
                field="angle",
                value=float(change[0]),
                unit="rad",
                remedy="check the direction of the angle sensor, and whether the muscles are swapped",
            )
