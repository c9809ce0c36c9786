"""A virtual rig in real time."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence

from mckibben.rig.backend import Block, Channel
from mckibben.rig.twin.rig import TwinRig

_SOON = 1e-6  # s: no sleep is shorter


class Paced:
    """A `TwinRig` whose time is that of the wall: what the host takes too long for goes by.

    Parameters
    ----------
    rig
        The virtual rig.
    wall, sleep
        A clock [s], and what waits so many seconds; the machine's own unless given.
    """

    def __init__(
        self,
        rig: TwinRig,
        *,
        wall: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        self.rig = rig
        self.rate, self.patience = rig.rate, rig.patience
        self._wall, self._sleep = wall, sleep
        self._began = wall()

    @property
    def inputs(self) -> Sequence[Channel]:
        """Those of the rig."""
        return self.rig.inputs

    @property
    def outputs(self) -> Sequence[Channel]:
        """Those of the rig."""
        return self.rig.outputs

    @property
    def described(self) -> Mapping[str, str]:
        """The rig, and that it is paced."""
        return {**self.rig.described, "pace": "real time"}

    def open(self) -> None:
        """Open the rig; its time begins now."""
        self.rig.open()
        self._began = self._wall()

    def clock(self) -> float:
        """Since it was opened [s], by the wall."""
        return self._wall() - self._began

    def read(self, count: int, *, timeout: float = 1.0) -> Block:
        """Wait for so many samples; as `TwinRig.read`."""
        self._catch_up()
        most = count / self.rig.rate + timeout
        while _SOON < (left := self.rig.due(count) - self.clock()) <= most:  # what comes later still, the rig refuses
            self._sleep(left)
        try:
            return self.rig.read(count, timeout=timeout)
        finally:  # a silent rig let its timeout go by, a late host its delay
            if (ahead := self.rig.clock() - self.clock()) > _SOON:
                self._sleep(ahead)

    def press(self, volts: Sequence[float]) -> None:
        """As `TwinRig.press`."""
        self._catch_up()
        self.rig.press(volts)

    def beat(self) -> None:
        """As `TwinRig.beat`."""
        self._catch_up()
        self.rig.beat()

    def vent(self) -> None:
        """As `TwinRig.vent`."""
        self._catch_up()
        self.rig.vent()

    def close(self) -> None:
        """As `TwinRig.close`."""
        self._catch_up()
        self.rig.close()

    def move(self, pulses: int, rate: float) -> None:
        """As `TwinRig.move`."""
        self._catch_up()
        self.rig.move(pulses, rate)

    @property
    def moving(self) -> bool:
        """As `TwinRig.moving`."""
        self._catch_up()
        return self.rig.moving

    def stop(self) -> None:
        """As `TwinRig.stop`."""
        self._catch_up()
        self.rig.stop()

    def _catch_up(self) -> None:
        if (behind := self.clock() - self.rig.clock()) > 0:
            self.rig.pass_time(behind)
