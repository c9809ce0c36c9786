"""Settings of a card in the file of a rig."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

from mckibben.component.base import Checked
from mckibben.rig.calibration import Calibration, read_calibrations
from mckibben.rig.ni.driver import Terminals


@dataclass(frozen=True, kw_only=True)
class CardSettings(Checked):
    """A card of National Instruments, see `Terminals`: its terminals, and the file of its calibrations."""

    sensors: ClassVar[Mapping[str, str]]
    """Units of the inputs by channel, which is the name of the field of its terminal."""
    valves: ClassVar[Mapping[str, str]]
    """Units of the outputs by channel."""

    device: str = "Dev1"
    heartbeat: str = "port0/line0"
    hold: str = "port0/line1"
    server: str = ""
    calibration: Path

    def terminals(self, *, counter: str = "", direction: str = "") -> Terminals:
        """Return the terminals, with those of a motor if it is given its counter."""
        return Terminals(
            inputs={name: self._at(getattr(self, name)) for name in self.sensors},
            outputs={name: self._at(getattr(self, name)) for name in self.valves},
            heartbeat=self._at(self.heartbeat),
            hold=self._at(self.hold),
            counter=self._at(counter),
            direction=self._at(direction),
        )

    def _at(self, name: str) -> str:
        return name and f"{self.device}/{name}"

    def calibrations(self) -> dict[str, Calibration]:
        """Return the calibrations of the file, by channel; `ScenarioError` with all problems."""
        return read_calibrations(self.calibration, {**self.sensors, **self.valves})
