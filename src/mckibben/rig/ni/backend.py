"""Rigs on a card of National Instruments, and the status of its channels."""

from __future__ import annotations

import contextlib
import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from importlib.metadata import version
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from mckibben.component.checks import check_positive
from mckibben.errors import RangeError, RigError
from mckibben.rig.backend import Backend, Block, Channel, ChannelStatus, MovingBackend, Watchdog
from mckibben.rig.calibration import Calibration
from mckibben.rig.ni.driver import Driver, Terminals

if TYPE_CHECKING:
    from mckibben.rig.bench import Drive
    from mckibben.rig.ni.watchdog import WatchdogLink

_BUFFER = 10.0  # s of samples in the buffer of the driver
_OFF = 1e-3  # V from the signal at rest, and beyond the range of the outputs
_SAME = 1e-9


class NiBackend(Backend):
    """Sensors and valves on a card.

    All inputs are sampled by one clock of the card. A card holds its last output when its host dies: an external
    watchdog relay on the line `heartbeat` then cuts the current of a spring-return vent valve; `patience` has to be its
    timeout. The same watchdog is enforced here: after it has expired the line rests until the backend is reopened.

    Parameters
    ----------
    wiring
        Terminals.
    rate
        Sampling rate of each input [Hz]; the card has to have it exactly.
    patience
        Timeout of the watchdog relay [s].
    server
        Address of an NI gRPC Device Server, "host:port", on whose machine the card is; empty: this one.
    calibrations
        Calibrations by channel; none for volts alone.
    """

    def __init__(
        self,
        wiring: Terminals | None = None,
        *,
        rate: float = 1000.0,
        patience: float = 1.0,
        server: str = "",
        calibrations: Mapping[str, Calibration] | None = None,
    ) -> None:
        check_positive("rig", "Hz", rate=rate)
        check_positive("rig", "s", patience=patience)
        self.wiring = wiring or Terminals()
        self.rate = float(rate)
        self.patience = float(patience)
        self.server = server
        self.calibrations = calibrations or {}
        self._driver: Driver | None = None
        self._tasks: list[Any] = []
        self._inputs: Any = None
        self._reader: Any = None
        self._writer: Any = None
        self._switch: Any = None
        self._lines: dict[str, bool] = {}
        self._taken = 0
        self._watchdog = Watchdog(self.patience)
        self.watchdog_link: WatchdogLink | None = None  # within `host_watchdog`
        self._facts: dict[str, str] = {}

    @property
    def inputs(self) -> Sequence[Channel]:
        return self._channels(self.wiring.inputs, self.wiring.input_range)

    @property
    def outputs(self) -> Sequence[Channel]:
        low, high = self.wiring.output_range
        return self._channels(self.wiring.outputs, (low - _OFF, high + _OFF))

    def _channels(self, terminals: Mapping[str, str], ends: tuple[float, float]) -> Sequence[Channel]:
        return tuple(
            self.calibrations[name].channel(where, *ends)
            if name in self.calibrations
            else Channel(name, "V", math.nextafter(ends[0], math.inf), math.nextafter(ends[1], -math.inf), where)
            for name, where in terminals.items()
        )

    @property
    def description(self) -> Mapping[str, str]:
        """Description for the record; driver and serial numbers once it has been opened."""
        wired = {**self.wiring.inputs, **self.wiring.outputs, **self.wiring.lines}
        if self.wiring.counter:
            wired["counter"] = self.wiring.counter
        return {
            "kind": "nidaqmx",
            **({"server": self.server} if self.server else {}),
            **self._facts,
            "wiring": ", ".join(f"{name} at {where}" for name, where in wired.items()),
            "patience": f"{self.patience:g} s, of the relay",
            **{f"calibration of {name}": repr(calibration) for name, calibration in self.calibrations.items()},
        }

    def open(self) -> None:
        """Open the card as `Backend.open`; `RigError` also if it does not have the rate."""
        if self._driver is not None:
            raise RigError("the rig is already open", remedy="close it first")
        self._driver = Driver(self.server)
        try:
            self._open_tasks(self._driver)
        except BaseException:
            self.close()
            raise

    def clock(self) -> float:
        """Time since it was opened [s], by the sample clock of the card."""
        driver = self._open()
        with driver.translated("the card's clock"):
            return self._inputs.in_stream.total_samp_per_chan_acquired / self.rate

    def read(self, count: int, *, timeout: float = 1.0) -> Block:
        """As `Backend.read`; `RigError` also if samples were overwritten."""
        driver = self._open()
        if count < 1:
            raise RangeError(f"{count} samples cannot be read", value=count, lower=1)
        volts = np.empty((len(self.wiring.inputs), count))
        with driver.translated("reading"):
            self._reader.read_many_sample(volts, count, timeout=count / self.rate + timeout)
        first = self._taken
        self._taken += count
        times = np.arange(first, self._taken) / self.rate
        for row, name in zip(volts, self.wiring.inputs, strict=True):
            if name in self.calibrations:
                row[:] = self.calibrations[name].si(row)
        return Block(first, times, np.ascontiguousarray(volts.T), self._counted(times))

    def set_valves(self, pressures: Sequence[float]) -> None:
        """Set the pressures of the valves [Pa]; one that is not at rest closes the vent valve again."""
        driver = self._check_armed()
        low, high = self.wiring.output_range
        names = [*self.wiring.outputs]
        known = [self.calibrations[name].volts if name in self.calibrations else np.asarray for name in names]
        signals = np.array([float(volts(value)) for volts, value in zip(known, pressures, strict=False)])
        if len(pressures) != len(names) or not ((signals >= low - _OFF) & (signals <= high + _OFF)).all():
            raise RigError(f"{list(pressures)} cannot be given at {len(names)} output(s) of {low:g}..{high:g} V")
        with driver.translated("the valves"):
            self._writer.write_one_sample(np.clip(signals, low, high))
            if (np.abs(signals - self.wiring.rest) > _OFF).any():
                self._set(hold=True)

    def heartbeat(self) -> None:
        """Reset the watchdog, unless it has expired; `RigError` if the process of `host_watchdog` is gone."""
        driver = self._open()
        if self._missed():
            return
        if self.watchdog_link is not None:
            self.watchdog_link.beat(time.monotonic())
        with driver.translated("the heartbeat"):
            self._set(heartbeat=not self._lines["heartbeat"])
        self._watchdog.reset(time.monotonic())

    def vent(self) -> None:
        """Vent: cut the current of the vent valve, then set the signals to rest. Never raises."""
        self._quietly(lambda: self._set(hold=False))
        self._quietly(lambda: self._writer.write_one_sample(np.full(len(self.wiring.outputs), self.wiring.rest)))
        if (link := self.watchdog_link) is not None:
            self._quietly(link.rest)

    def close(self) -> None:
        """Vent, end the heartbeat, and close the card. Never raises."""
        self.vent()
        self._quietly(lambda: self._set(heartbeat=False))
        for task in reversed(self._tasks):
            self._quietly(task.close)
        if self._driver is not None:
            self._quietly(self._driver.close)
        self._tasks, self._driver, self._lines = [], None, {}
        self._inputs = self._reader = self._writer = self._switch = None

    def host_watchdog(self) -> AbstractContextManager[None]:
        """A second process that vents the card if this one dies or hangs within the block, and is watched in turn."""
        from mckibben.rig.ni.watchdog import host_watchdog

        return host_watchdog(self)

    def status(self) -> Iterator[ChannelStatus]:
        """Driver and devices, and the readings of the sensors; whatever is missing is a row, no error."""
        there = self.server or "this machine"
        try:
            driver = Driver(self.server)
            try:
                yield ChannelStatus("driver", there, f"NI-DAQmx {driver.version()}")
                for name, (model, serial) in driver.devices().items():
                    yield ChannelStatus("device", name, f"{model}, serial {serial}")
            finally:
                driver.close()
            yield from super().status()
        except RigError as error:
            yield ChannelStatus("rig", there, "", str(error))

    def _open_tasks(self, driver: Driver) -> None:
        self._open_outputs(driver)
        self._open_inputs(driver)
        self._taken = 0
        self._watchdog.start(time.monotonic())

    def _open_outputs(self, driver: Driver) -> None:
        """Open lines, which vent, then valves."""
        package, wiring = driver.package, self.wiring
        self._lines = dict.fromkeys(wiring.lines, False)
        lines = self._new_task(driver)
        for name, where in wiring.lines.items():
            with driver.translated(f"{name} at {where}"):
                lines.do_channels.add_do_chan(where, line_grouping=package.constants.LineGrouping.CHAN_PER_LINE)
        self._switch = package.stream_writers.DigitalMultiChannelWriter(lines.out_stream, auto_start=True)
        self._switch.verify_array_shape = False
        with driver.translated("the digital lines"):
            self._set()

        valves = self._new_task(driver)
        low, high = wiring.output_range
        for name, where in wiring.outputs.items():
            with driver.translated(f"{name} at {where}"):
                valves.ao_channels.add_ao_voltage_chan(where, min_val=low, max_val=high)
        self._writer = package.stream_writers.AnalogMultiChannelWriter(valves.out_stream, auto_start=True)
        self._writer.verify_array_shape = False
        with driver.translated("the valves"):
            self._writer.write_one_sample(np.full(len(wiring.outputs), wiring.rest))

    def _open_inputs(self, driver: Driver) -> None:
        package, wiring = driver.package, self.wiring
        constants = package.constants
        self._inputs = self._new_task(driver)
        for name, where in wiring.inputs.items():
            with driver.translated(f"{name} at {where}"):
                self._inputs.ai_channels.add_ai_voltage_chan(
                    where,
                    terminal_config=constants.TerminalConfiguration.DIFF,
                    min_val=wiring.input_range[0],
                    max_val=wiring.input_range[1],
                )
        self._reader = package.stream_readers.AnalogMultiChannelReader(self._inputs.in_stream)
        self._reader.verify_array_shape = False
        with driver.translated("the sample clock"):
            self._inputs.timing.cfg_samp_clk_timing(
                self.rate,
                sample_mode=constants.AcquisitionType.CONTINUOUS,
                samps_per_chan=math.ceil(_BUFFER * self.rate),
            )
            actual = self._inputs.timing.samp_clk_rate
        if abs(actual - self.rate) > _SAME * self.rate:
            raise RigError(
                f"the card cannot sample at {self.rate:g} Hz, the nearest is {actual:.9g} Hz", remedy="set that rate"
            )
        self._facts = {"driver": f"NI-DAQmx {driver.version()}, nidaqmx {version(package.__name__)}"}
        devices = {where.split("/")[0] for where in [*wiring.inputs.values(), *wiring.outputs.values()]}
        self._facts["devices"] = ", ".join(
            f"{name} ({model}, serial {serial})"
            for name, (model, serial) in driver.devices().items()
            if name in devices
        )
        with driver.translated("the start of the inputs"):
            self._inputs.start()

    def _new_task(self, driver: Driver) -> Any:
        task = driver.task()
        self._tasks.append(task)
        return task

    def _open(self) -> Driver:
        if self._driver is None or self._reader is None:
            raise RigError("the rig is not open", remedy="open it first")
        return self._driver

    def _check_armed(self) -> Driver:
        driver = self._open()
        if self._missed():
            raise RigError(
                f"there was no heartbeat for {self.patience:g} s: the relay has opened, the muscle is vented",
                remedy="reopen the rig, and send heartbeats in time",
            )
        return driver

    def _missed(self) -> bool:
        """Whether the watchdog has expired; the first time, vent."""
        if self._watchdog.expires(time.monotonic()):
            self._on_expiry()
        return self._watchdog.has_expired

    def _on_expiry(self) -> None:
        self.vent()

    def _set(self, **lines: bool) -> None:
        """Write the digital lines, all at once."""
        self._lines |= lines
        self._switch.write_one_sample_one_line(np.array([*self._lines.values()], bool))

    def _quietly(self, what: Callable[[], object]) -> None:
        """Call a function; errors must not prevent the next call."""
        with contextlib.suppress(Exception):
            what()

    def _counted(self, times: NDArray[np.float64]) -> NDArray[np.int64]:
        return np.zeros(len(times), np.int64)


_ROUNDING = 1e-6  # pulses


class NiRig(NiBackend, MovingBackend):
    """A card with a motor.

    A counter sends the pulses of a move as one finite train, so that their number is exact. Their number at a time
    follows from the rate and the start of the train, to within the latency of the host: less than a pulse at 80 Hz and
    10 ms. After a `stop` during a move the count has that uncertainty.

    A 62xx needs both of its counters for a finite train, ctr1 along with ctr0.

    Parameters
    ----------
    wiring, card
        As for `NiBackend`.
    drive
        Motor, reducer and lead screw; default: the paper's.
    """

    def __init__(self, wiring: Terminals | None = None, *, drive: Drive | None = None, **card: Any) -> None:
        super().__init__(wiring, **card)
        self._drive = drive
        if not self.wiring.counter:
            raise RangeError("a stretching device needs a counter for its pulses", remedy="give the counter")
        self._train: Any = None
        self._begin = 0.0
        self._rate = 1.0
        self._pulses = 0
        self._position = 0

    @property
    def drive(self) -> Drive:
        return self._drive or super().drive

    def open(self) -> None:
        """Open the card as `NiBackend`; the pulses of the motor count from here."""
        self._position = self._pulses = 0
        super().open()

    def move(self, pulses: int, rate: float) -> None:
        """As `MovingBackend.move`; `RigError` also if the watchdog has expired, or the card cannot send the pulses."""
        driver = self._check_armed()
        if self.moving:
            raise RigError("the motor is still moving", remedy="wait until it stops, or stop it")
        self._end(self._pulses)
        if not pulses:
            return
        if not rate > 0:
            raise RigError(f"the motor cannot run at {rate:g} pulses per second", value=rate, lower=0.0, unit="Hz")
        constants = driver.package.constants
        train = driver.task()
        try:
            with driver.translated(f"the motor's pulses at {self.wiring.counter}"):
                train.co_channels.add_co_pulse_chan_freq(self.wiring.counter, freq=float(rate), duty_cycle=0.5)
                if abs(pulses) > 1:  # a single pulse needs no timing
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
        if self._train is None:
            return False
        with self._open().translated("the motor"):
            return not self._train.is_task_done()

    def stop(self) -> None:
        if self._train is None:
            return
        sent = self._pulses
        with contextlib.suppress(Exception):
            if not self._train.is_task_done():
                self._train.stop()
                sent = int(self._sent(np.array([self.clock()]))[0])
        self._end(sent)

    def close(self) -> None:
        self.vent()  # first: the air is the greater hazard
        self.stop()
        super().close()

    def _on_expiry(self) -> None:
        super()._on_expiry()
        self.stop()

    def _end(self, sent: int) -> None:
        """End a move after a number of pulses."""
        if self._train is not None:
            self._quietly(self._train.close)
        self._train = None
        self._position += sent
        self._pulses = 0

    def _sent(self, times: NDArray[np.float64]) -> NDArray[np.int64]:
        """Signed pulses of this move until times [s] of the card's clock."""
        sent = np.clip(np.floor((times - self._begin) * self._rate + _ROUNDING), 0, abs(self._pulses))
        return (np.sign(self._pulses) * sent).astype(np.int64)

    def _counted(self, times: NDArray[np.float64]) -> NDArray[np.int64]:
        return self._position + self._sent(times)
