"""A stretching device on a card: the backend with a counter that sends the motor's pulses."""

from __future__ import annotations

import contextlib
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mckibben.errors import RangeError, RigError
from mckibben.rig.ni.backend import NiBackend
from mckibben.rig.ni.wiring import Wiring

_ROUNDING = 1e-6  # pulses


class NiRig(NiBackend):
    """A card with a motor as well; a `MovingBackend`.

    A counter sends the pulses of a move as one finite train: their number is the card's. How many of them were sent at
    a time follows from the rate and from the samples that had been taken when the train began, to within what the host
    takes to start it: less than a pulse at 80 a second and 10 ms. After a `stop` in the midst of a move the count is
    known no better than that.

    A 62xx has no counter beside its two that could gate a train: it needs both for it, ctr1 along with ctr0.
    """

    def __init__(
        self, wiring: Wiring | None = None, *, rate: float = 1000.0, patience: float = 1.0, server: str = ""
    ) -> None:
        super().__init__(wiring, rate=rate, patience=patience, server=server)
        if not self.wiring.counter:
            raise RangeError("a stretching device needs the counter that sends its pulses", remedy="give the counter")
        self._train: Any = None
        self._begin = 0.0
        self._rate = 1.0
        self._pulses = 0
        self._stood = 0

    def open(self) -> None:
        """As `NiBackend.open`; the motor stands, and its pulses count from here."""
        self._stood = self._pulses = 0
        super().open()

    def move(self, pulses: int, rate: float) -> None:
        """Begin to move by so many pulses, positive = stretching, at so many a second [Hz].

        Raises
        ------
        RigError
            If it is still moving, a beat was missed, or the card cannot send them.
        """
        driver = self._must_go()
        if self.moving:
            raise RigError("the motor is still moving", remedy="wait until it stands, or stop it")
        self._end(self._pulses)
        if not pulses:
            return
        if not rate > 0:
            raise RigError(f"the motor cannot go at {rate:g} pulses a second", value=rate, lower=0.0, unit="Hz")
        constants = driver.package.constants
        train = driver.task()
        try:
            with driver.translated(f"the motor's pulses at {self.wiring.counter}"):
                train.co_channels.add_co_pulse_chan_freq(self.wiring.counter, freq=float(rate), duty_cycle=0.5)
                if abs(pulses) > 1:  # without a timing the counter sends one
                    train.timing.cfg_implicit_timing(
                        sample_mode=constants.AcquisitionType.FINITE, samps_per_chan=abs(int(pulses))
                    )
                self._set(direction=pulses > 0)
                train.start()
        except BaseException:
            self._quietly(train.close)
            raise
        self._train, self._rate, self._pulses = train, float(rate), int(pulses)
        self._begin = self.clock()

    @property
    def moving(self) -> bool:
        """Whether pulses are being sent."""
        if self._train is None:
            return False
        with self._open().translated("the motor"):
            return not self._train.is_task_done()

    def stop(self) -> None:
        """Stand still, at once. Never raises."""
        if self._train is None:
            return
        sent = self._pulses
        with contextlib.suppress(Exception):
            if not self._train.is_task_done():
                self._train.stop()
                sent = int(self._sent(np.array([self.clock()]))[0])
        self._end(sent)

    def close(self) -> None:
        """Stop, vent, and let go of the card. Never raises."""
        self.vent()  # first: whatever a motor does, air is the danger
        self.stop()
        super().close()

    def _missed(self) -> bool:
        before, missed = self._tripped, super()._missed()
        if missed and not before:
            self.stop()
        return missed

    def _end(self, sent: int) -> None:
        """No move goes on; so many pulses of the last were sent."""
        if self._train is not None:
            self._quietly(self._train.close)
        self._train = None
        self._stood += sent
        self._pulses = 0

    def _sent(self, times: NDArray[np.float64]) -> NDArray[np.int64]:
        """Pulses of this move until times [s] of the card's clock, with their sign."""
        sent = np.clip(np.floor((times - self._begin) * self._rate + _ROUNDING), 0, abs(self._pulses))
        return (np.sign(self._pulses) * sent).astype(np.int64)

    def _counted(self, times: NDArray[np.float64]) -> NDArray[np.int64]:
        return self._stood + self._sent(times)
