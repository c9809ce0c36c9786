"""Rigs on a card of National Instruments; needs the extra `daq` and the driver NI-DAQmx."""

from __future__ import annotations

import contextlib
import math
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from mckibben.component.base import Checked
from mckibben.component.checks import check_positive
from mckibben.errors import Problem, RangeError, RigError, SilentError, refuse_problems
from mckibben.rig.backend import Backend, Block, Channel, ChannelStatus, MovingBackend, Watchdog
from mckibben.rig.bench import Drive
from mckibben.rig.calibration import Calibration, read_calibrations

_TERMINAL = "correct the terminal"
_REMEDIES = {
    -200284: "samples did not come in time: check the card, and reopen the rig",
    -200279: "samples were overwritten, as the host did not read them in time: reopen the rig",
    -50103: "close the other program that uses it (NI MAX, another test)",
    -200022: "close the other program that uses it (NI MAX, another test)",
    **dict.fromkeys((-200220, -200170, -200149), _TERMINAL),
    **dict.fromkeys((-88709, -201003, -200324, -50405), "the device is disconnected: check cable and power"),
}
"""Remedies by the number of an error of NI-DAQmx."""


class Driver:
    """The driver NI-DAQmx.

    Parameters
    ----------
    server
        Address of an NI gRPC Device Server, "host:port"; empty for the driver of this machine.

    Raises
    ------
    RigError
        If the package is missing.
    """

    def __init__(self, server: str = "") -> None:
        try:
            import grpc
            import nidaqmx
            import nidaqmx.constants
            import nidaqmx.errors
            import nidaqmx.stream_readers
            import nidaqmx.stream_writers
            import nidaqmx.system
        except ImportError as error:
            message = f"the package {error.name or 'nidaqmx'} is missing"
            raise RigError(message, remedy="pip install 'mckibben[daq]'") from error
        self.package: Any = nidaqmx
        self.server = server
        self._channel = self._options = None
        if server:
            self._channel = grpc.insecure_channel(server)
            self._options = nidaqmx.GrpcSessionOptions(self._channel, "")

    def task(self) -> Any:
        """A new task without a name."""
        with self.translated("a task"):
            return self.package.Task(grpc_options=self._options)

    def version(self) -> str:
        """Version of the driver."""
        with self.translated("the driver"):
            version = self._system().driver_version
        return f"NI-DAQmx {version.major_version}.{version.minor_version}.{version.update_version}"

    def devices(self) -> dict[str, str]:
        """Model and serial number of each device, by name."""
        with self.translated("the devices"):
            devices = self._system().devices
            return {device.name: f"{device.product_type}, serial {device.serial_num:X}" for device in devices}

    def close(self) -> None:
        """Close the connection."""
        if self._channel is not None:
            self._channel.close()

    @contextlib.contextmanager
    def translated(self, what: str) -> Iterator[None]:
        """Translate errors of the driver to `RigError` with a remedy, timeouts to `SilentError`."""
        errors = self.package.errors
        try:
            yield
        except (errors.DaqNotFoundError, errors.DaqNotSupportedError) as error:
            remedy = "install NI-DAQmx from ni.com (`nidaqmx installdriver` helps), or give the server of another one"
            raise RigError("the driver NI-DAQmx is not installed on this machine", remedy=remedy) from error
        except errors.RpcError as error:
            raise RigError(
                f"{what}, by the NI gRPC Device Server at {self.server}: {_first_line(error)}",
                remedy="check that it runs there, that its version is that of nidaqmx, and the address",
            ) from error
        except errors.DaqError as error:
            remedy = _REMEDIES.get(code := error.error_code, "look the number up at ni.com")
            if remedy == _TERMINAL:
                remedy += f"; connected are: {', '.join(self._system().devices.device_names) or 'none'}"
            kind = SilentError if code == -200284 else RigError
            raise kind(f"{what}: {_first_line(error)} (NI-DAQmx {code})", remedy=remedy) from error

    def _system(self) -> Any:
        system = self.package.system.System
        return system.remote(self._options) if self._options else system.local()


def _first_line(error: Exception) -> str:
    """First line of an error of the driver, which has paragraphs."""
    return str(error).strip().partition("\n")[0].strip().rstrip(".") or type(error).__name__


class NiBackend(Backend):
    """Sensors and valves on a card.

    All inputs, within -10..10 V and differential, are sampled by one clock of the card; outputs are 0..10 V, and 0 V
    vents. A card holds its last output when its host dies: an external watchdog relay on the line `heartbeat` then cuts
    the current of a spring-return vent valve; `patience` has to be its timeout. The same watchdog is enforced here:
    after it has expired the line rests until the backend is reopened.

    Parameters
    ----------
    inputs, outputs
        Terminals of the sensors and valves by channel, in the notation of the driver; by default the paper's.
    heartbeat
        Line that toggles with each heartbeat; an external relay opens when it does not.
    hold
        Line that through this relay energises the spring-return vent valve: high = closed.
    rate
        Sampling rate of each input [Hz]; the card has to have it exactly.
    patience
        Timeout of the watchdog relay [s].
    server
        Address of an NI gRPC Device Server, "host:port", on whose machine the card is; empty: this one.
    calibrations
        Calibrations by channel; none for volts alone.

    Raises
    ------
    RangeError
        With all terminals that are missing or given twice.
    """

    def __init__(
        self,
        inputs: Mapping[str, str] | None = None,
        outputs: Mapping[str, str] | None = None,
        *,
        heartbeat: str = "Dev1/port0/line0",
        hold: str = "Dev1/port0/line1",
        rate: float = 1000.0,
        patience: float = 1.0,
        server: str = "",
        calibrations: Mapping[str, Calibration] | None = None,
    ) -> None:
        check_positive("rig", "Hz", rate=rate)
        check_positive("rig", "s", patience=patience)
        self._inputs = {"force": "Dev1/ai0", "pressure": "Dev1/ai1"} if inputs is None else dict(inputs)
        self._outputs = {"valve": "Dev1/ao0"} if outputs is None else dict(outputs)
        self._lines = {"heartbeat": heartbeat, "hold": hold}
        self.rate, self.patience, self.server = float(rate), float(patience), server
        self.calibrations = calibrations or {}
        self._check_terminals()
        self._driver: Driver | None = None
        self._tasks: list[Any] = []
        self._samples: Any = None  # task of the inputs
        self._reader: Any = None
        self._writer: Any = None
        self._switch: Any = None
        self._levels: dict[str, bool] = {}  # of the lines
        self._taken = 0
        self._watchdog = Watchdog(self.patience)
        self._facts: dict[str, str] = {}

    @property
    def terminals(self) -> dict[str, str]:
        """All terminals by name."""
        return {**self._inputs, **self._outputs, **self._lines}

    def _check_terminals(self) -> None:
        required = {"inputs": self._inputs, "outputs": self._outputs, **self.terminals}
        problems = [Problem("is missing", field=name) for name, terminal in required.items() if not terminal]
        given = [*self._inputs.values(), *self._outputs.values(), *self._lines.values()]
        twice = sorted({terminal for terminal in given if given.count(terminal) > 1})
        problems += [Problem(f"{terminal} is given twice", field="wiring") for terminal in twice]
        refuse_problems("wiring", problems)

    @property
    def inputs(self) -> Sequence[Channel]:
        return self._channels(self._inputs, -10.0, 10.0)

    @property
    def outputs(self) -> Sequence[Channel]:
        return self._channels(self._outputs, -1e-3, 10.001)

    def _channels(self, terminals: Mapping[str, str], low: float, high: float) -> Sequence[Channel]:
        return [
            self.calibrations[name].channel(where, low, high)
            if name in self.calibrations
            else Channel(name, "V", math.nextafter(low, math.inf), math.nextafter(high, -math.inf), where)
            for name, where in terminals.items()
        ]

    @property
    def description(self) -> Mapping[str, str]:
        """Description for the record; driver and serial numbers once it has been opened."""
        return {
            "kind": "nidaqmx",
            **({"server": self.server} if self.server else {}),
            **self._facts,
            "wiring": ", ".join(f"{name} at {where}" for name, where in self.terminals.items()),
            "patience": f"{self.patience:g} s, of the relay",
            **{f"calibration of {name}": repr(calibration) for name, calibration in self.calibrations.items()},
        }

    def open(self) -> None:
        """Open the card as `Backend.open`; `RigError` also if it does not have the rate."""
        if self._driver is not None:
            raise RigError("the rig is already open", remedy="close it first")
        self._driver = Driver(self.server)
        try:
            self._open_outputs(self._driver)
            self._open_inputs(self._driver)
        except BaseException:
            self.close()
            raise
        self._taken = 0
        self._watchdog.start(time.monotonic())

    def clock(self) -> float:
        """Time since it was opened [s], by the sample clock of the card."""
        with self._open().translated("the card's clock"):
            return self._samples.in_stream.total_samp_per_chan_acquired / self.rate

    def read(self, count: int, *, timeout: float = 1.0) -> Block:
        """As `Backend.read`; `RigError` also if samples were overwritten."""
        driver = self._open()
        if count < 1:
            raise RangeError(f"{count} samples cannot be read", value=count, lower=1)
        volts = np.empty((len(self._inputs), count))
        with driver.translated("reading"):
            self._reader.read_many_sample(volts, count, timeout=count / self.rate + timeout)
        first, self._taken = self._taken, self._taken + count
        times = np.arange(first, self._taken) / self.rate
        for row, name in zip(volts, self._inputs, strict=True):
            if name in self.calibrations:
                row[:] = self.calibrations[name].si(row)
        return Block(first, times, np.ascontiguousarray(volts.T), self._counted(times))

    def set_valves(self, pressures: Sequence[float]) -> None:
        """Set the pressures of the valves [Pa]; one that is not at rest closes the vent valve again."""
        driver = self._check_armed()
        channels = self.outputs
        if len(pressures) != len(channels) or not all(
            channel.low <= pressure <= channel.high for channel, pressure in zip(channels, pressures, strict=True)
        ):
            ranges = ", ".join(f"{channel.low:g}..{channel.high:g} {channel.unit}" for channel in channels)
            raise RigError(f"{list(pressures)} cannot be given at outputs of {ranges}")
        known = [self.calibrations.get(name) for name in self._outputs]
        volts = np.array([c.volts(value) if c else value for c, value in zip(known, pressures, strict=True)], float)
        with driver.translated("the valves"):
            self._writer.write_one_sample(np.clip(volts, 0.0, 10.0))
            if (volts > 1e-3).any():
                self._set(hold=True)

    def heartbeat(self) -> None:
        """Reset the watchdog, unless it has expired."""
        driver = self._open()
        if self._missed():
            return
        with driver.translated("the heartbeat"):
            self._set(heartbeat=not self._levels["heartbeat"])
        self._watchdog.reset(time.monotonic())

    def vent(self) -> None:
        """Vent: cut the current of the vent valve, then set the signals to rest. Never raises."""
        with contextlib.suppress(Exception):
            self._set(hold=False)
        with contextlib.suppress(Exception):
            self._writer.write_one_sample(np.zeros(len(self._outputs)))

    def close(self) -> None:
        """Vent, end the heartbeat, and close the card. Never raises."""
        self.vent()
        with contextlib.suppress(Exception):
            self._set(heartbeat=False)
        for part in (*reversed(self._tasks), *([self._driver] if self._driver else [])):
            with contextlib.suppress(Exception):
                part.close()
        self._tasks, self._driver, self._levels = [], None, {}
        self._samples = self._reader = self._writer = self._switch = None

    def status(self) -> Iterator[ChannelStatus]:
        """Driver and devices, and the readings of the sensors; whatever is missing is a row, no error."""
        there = self.server or "this machine"
        try:
            with contextlib.closing(Driver(self.server)) as driver:
                yield ChannelStatus("driver", there, driver.version())
                for name, model in driver.devices().items():
                    yield ChannelStatus("device", name, model)
            yield from super().status()
        except RigError as error:
            yield ChannelStatus("rig", there, "", str(error))

    def _open_outputs(self, driver: Driver) -> None:
        """Open lines, which vent, then valves."""
        package = driver.package
        self._levels = dict.fromkeys(self._lines, False)
        lines = self._new_task(driver)
        for name, where in self._lines.items():
            with driver.translated(f"{name} at {where}"):
                lines.do_channels.add_do_chan(where, line_grouping=package.constants.LineGrouping.CHAN_PER_LINE)
        self._switch = package.stream_writers.DigitalMultiChannelWriter(lines.out_stream, auto_start=True)
        self._switch.verify_array_shape = False
        with driver.translated("the digital lines"):
            self._set()
        valves = self._new_task(driver)
        for name, where in self._outputs.items():
            with driver.translated(f"{name} at {where}"):
                valves.ao_channels.add_ao_voltage_chan(where, min_val=0.0, max_val=10.0)
        self._writer = package.stream_writers.AnalogMultiChannelWriter(valves.out_stream, auto_start=True)
        self._writer.verify_array_shape = False
        with driver.translated("the valves"):
            self._writer.write_one_sample(np.zeros(len(self._outputs)))

    def _open_inputs(self, driver: Driver) -> None:
        """Start the samples, of which the driver buffers 10 s."""
        package, constants = driver.package, driver.package.constants
        self._samples = self._new_task(driver)
        wired = {"terminal_config": constants.TerminalConfiguration.DIFF, "min_val": -10.0, "max_val": 10.0}
        for name, where in self._inputs.items():
            with driver.translated(f"{name} at {where}"):
                self._samples.ai_channels.add_ai_voltage_chan(where, **wired)
        self._reader = package.stream_readers.AnalogMultiChannelReader(self._samples.in_stream)
        self._reader.verify_array_shape = False
        buffered = {"sample_mode": constants.AcquisitionType.CONTINUOUS, "samps_per_chan": math.ceil(10 * self.rate)}
        with driver.translated("the sample clock"):
            self._samples.timing.cfg_samp_clk_timing(self.rate, **buffered)
            actual = self._samples.timing.samp_clk_rate
        if not math.isclose(actual, self.rate, rel_tol=1e-9):
            message = f"the card cannot sample at {self.rate:g} Hz, the nearest is {actual:.9g} Hz"
            raise RigError(message, remedy="set that rate")
        devices = {where.split("/")[0] for where in self.terminals.values()}
        models = [f"{name} ({model})" for name, model in driver.devices().items() if name in devices]
        driver_version = f"{driver.version()}, nidaqmx {version(package.__name__)}"
        self._facts = {"driver": driver_version, "devices": ", ".join(models)}
        with driver.translated("the start of the inputs"):
            self._samples.start()

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
        """Whether the watchdog has expired; the first time, rest."""
        if self._watchdog.expires(time.monotonic()):
            self._rest()
        return self._watchdog.has_expired

    def _rest(self) -> None:
        self.vent()

    def _set(self, **levels: bool) -> None:
        """Write the digital lines, all at once."""
        self._levels |= levels
        self._switch.write_one_sample_one_line(np.array([*self._levels.values()], bool))

    def _counted(self, times: NDArray[np.float64]) -> NDArray[np.int64]:
        return np.zeros(len(times), np.int64)


class NiRig(NiBackend, MovingBackend):
    """A card with a motor.

    A counter sends the pulses of a move as one finite train, so that their number is exact. Their number at a time
    follows from the rate and the start of the train, to within the latency of the host: less than a pulse at 80 Hz and
    10 ms. After a `stop` during a move the count has that uncertainty.

    A 62xx needs both of its counters for a finite train, ctr1 along with ctr0.

    Parameters
    ----------
    inputs, outputs, card
        As for `NiBackend`.
    counter
        Counter of the motor's pulses.
    direction
        Line of the motor's direction: high = stretching.
    drive
        Motor, reducer and lead screw; default: the paper's.
    """

    def __init__(
        self,
        inputs: Mapping[str, str] | None = None,
        outputs: Mapping[str, str] | None = None,
        *,
        counter: str = "Dev1/ctr0",
        direction: str = "Dev1/port0/line2",
        drive: Drive | None = None,
        **card: Any,
    ) -> None:
        super().__init__(inputs, outputs, **card)
        self.drive = drive or Drive()
        self._lines["direction"], self._counter = direction, counter
        self._check_terminals()
        self._train: Any = None
        self._begin, self._rate = 0.0, 1.0  # of the train [s], [Hz]
        self._pulses = self._position = 0  # of the train, and before it

    @property
    def terminals(self) -> dict[str, str]:
        return {**super().terminals, **({"counter": self._counter} if "direction" in self._lines else {})}

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
        finite = {"sample_mode": driver.package.constants.AcquisitionType.FINITE, "samps_per_chan": abs(int(pulses))}
        self._train = driver.task()
        try:
            with driver.translated(f"the motor's pulses at {self._counter}"):
                self._train.co_channels.add_co_pulse_chan_freq(self._counter, freq=float(rate), duty_cycle=0.5)
                if abs(pulses) > 1:  # a single pulse needs no timing
                    self._train.timing.cfg_implicit_timing(**finite)
                self._set(direction=pulses > 0)
                self._train.start()
        except BaseException:
            self._end(0)
            raise
        self._rate, self._pulses, self._begin = float(rate), int(pulses), self.clock()

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
        self._rest()
        super().close()

    def _rest(self) -> None:
        self.vent()  # first: the air is the greater hazard
        self.stop()

    def _end(self, sent: int) -> None:
        """End a move after a number of pulses."""
        with contextlib.suppress(Exception):
            self._train.close()
        self._train = None
        self._position += sent
        self._pulses = 0

    def _sent(self, times: NDArray[np.float64]) -> NDArray[np.int64]:
        """Signed pulses of this move until times [s] of the card's clock."""
        sent = np.clip(np.floor((times - self._begin) * self._rate + 1e-6), 0, abs(self._pulses))
        return (np.sign(self._pulses) * sent).astype(np.int64)

    def _counted(self, times: NDArray[np.float64]) -> NDArray[np.int64]:
        return self._position + self._sent(times)


@dataclass(frozen=True, kw_only=True)
class CardSettings(Checked):
    """A card of National Instruments, see `NiBackend`: its terminals, and the file of its calibrations."""

    sensors: ClassVar[Mapping[str, str]]
    """Units of the inputs by channel, which is the name of the field of its terminal."""
    valves: ClassVar[Mapping[str, str]]
    """Units of the outputs by channel."""

    device: str = "Dev1"
    heartbeat: str = "port0/line0"
    hold: str = "port0/line1"
    server: str = ""
    calibration: Path

    def at(self, *names: str) -> dict[str, str]:
        """Terminals of fields, by the name of the field."""
        return {name: f"{self.device}/{getattr(self, name)}" for name in names}

    def wiring(self) -> dict[str, Any]:
        """Arguments of `NiBackend`."""
        wired = {"inputs": self.at(*self.sensors), "outputs": self.at(*self.valves), **self.at("heartbeat", "hold")}
        return {**wired, "server": self.server, "calibrations": self.calibrations()}

    def calibrations(self) -> dict[str, Calibration]:
        """Return the calibrations of the file, by channel; `ScenarioError` with all problems."""
        return read_calibrations(self.calibration, {**self.sensors, **self.valves})
