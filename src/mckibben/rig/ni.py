"""Rigs on a card of National Instruments; needs the extra `daq` and the driver NI-DAQmx."""

from __future__ import annotations

import contextlib
import math
import time
from collections.abc import Iterator, Mapping, Sequence
from importlib.metadata import version
from typing import Any, ClassVar

import numpy as np
from pydantic import ConfigDict, Field

from mckibben.config.model import DocumentModel
from mckibben.errors import RangeError, RigError, SilentError
from mckibben.rig.backend import Backend, Block, Channel, ChannelStatus, ScaledChannel, Watchdog

_LINES = "heartbeat", "hold"
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


class Terminal(ScaledChannel):
    """A channel of a card: its terminal, such as ``ai0``, and the line from volts to SI."""

    terminal: str = Field(min_length=2)

    def channel(self, name: str, device: str, low: float, high: float) -> Channel:
        """Channel at a converter with a range [V], whose ends are the reading of a lost sensor."""
        ends = sorted(map(float, self.si([math.nextafter(low, math.inf), math.nextafter(high, -math.inf)])))
        return Channel(name, self.unit, max(ends[0], self.low), min(ends[1], self.high), f"{device}/{self.terminal}")


class Card(DocumentModel):
    """A card and its wiring; numbers are in SI.

    Attributes
    ----------
    device, server
        Name of the card; address of an NI gRPC Device Server, "host:port", on whose machine it is (default: this one).
    inputs, outputs
        Terminals of the sensors and valves, by channel.
    heartbeat
        Line that toggles with each heartbeat; an external relay opens when it does not.
    hold
        Line that through this relay energises the spring-return vent valve: high = closed.
    rate
        Sampling rate of each input [Hz], which the card has to have exactly; on a joint, the control frequency is.
    patience
        Timeout of the relay [s].
    """

    model_config = ConfigDict(strict=False)
    kind: ClassVar[str] = "card"
    examples: ClassVar[str] = "examples/rig/card.yaml"

    device: str = "Dev1"
    server: str = ""
    inputs: dict[str, Terminal] = Field(min_length=1)
    outputs: dict[str, Terminal] = Field(min_length=1)
    heartbeat: str = Field("port0/line0", min_length=2)
    hold: str = Field("port0/line1", min_length=2)
    rate: float = Field(1000.0, gt=0)
    patience: float = Field(gt=0)

    @property
    def wiring(self) -> dict[str, str]:
        """Terminals by name; `RangeError` if one is given twice."""
        channels = {name: channel.terminal for name, channel in (self.inputs | self.outputs).items()}
        wiring = channels | {name: getattr(self, name) for name in _LINES}
        given = [*wiring.values()]
        twice = [f"{name} at {where}" for name, where in wiring.items() if given.count(where) > 1]
        if twice:
            raise RangeError(f"{' and '.join(twice)} share a terminal", field="inputs", remedy="give each its own")
        return {name: f"{self.device}/{where}" for name, where in wiring.items()}


class NiBackend(Backend):
    """Sensors and valves on a card.

    All inputs, within -10..10 V and differential, are sampled by one clock of the card; outputs are 0..10 V, and 0 V
    vents. A card holds its last output when its host dies: an external watchdog relay on the line `heartbeat` then cuts
    the current of a spring-return vent valve; `patience` has to be its timeout. The same watchdog is enforced here:
    after it has expired the line rests until the backend is reopened.

    Parameters
    ----------
    card
        Card and wiring; `RangeError` for a terminal that is given twice.
    rate
        Sampling rate of each input [Hz]; 0: that of the card's file.
    """

    def __init__(self, card: Card, *, rate: float = 0.0) -> None:
        self.card, self.wiring = card, card.wiring
        self.rate, self.patience = rate or card.rate, card.patience
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
    def inputs(self) -> Sequence[Channel]:
        return [terminal.channel(name, self.card.device, -10.0, 10.0) for name, terminal in self.card.inputs.items()]

    @property
    def outputs(self) -> Sequence[Channel]:
        return [terminal.channel(name, self.card.device, -1e-3, 10.001) for name, terminal in self.card.outputs.items()]

    @property
    def description(self) -> Mapping[str, str]:
        """Description for the record; driver and serial numbers once it has been opened."""
        return {"kind": "nidaqmx", **self._facts, "card": self.card.dumps()}

    def open(self) -> None:
        """Open the card as `Backend.open`; `RigError` also if it does not have the rate."""
        if self._driver is not None:
            raise RigError("the rig is already open", remedy="close it first")
        self._driver = Driver(self.card.server)
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
        volts = np.empty((len(self.card.inputs), count))
        with driver.translated("reading"):
            self._reader.read_many_sample(volts, count, timeout=count / self.rate + timeout)
        first, self._taken = self._taken, self._taken + count
        times = np.arange(first, self._taken) / self.rate
        values = [terminal.si(row) for row, terminal in zip(volts, self.card.inputs.values(), strict=True)]
        return Block(first, times, np.stack(values, axis=1), np.zeros(count))

    def set_valves(self, pressures: Sequence[float]) -> None:
        """Set the pressures of the valves [Pa]; one that is not at rest closes the vent valve again."""
        driver = self._check_armed()
        channels = self.outputs
        if len(pressures) != len(channels) or not all(
            channel.low <= pressure <= channel.high for channel, pressure in zip(channels, pressures, strict=True)
        ):
            ranges = ", ".join(f"{channel.low:g}..{channel.high:g} {channel.unit}" for channel in channels)
            raise RigError(f"{list(pressures)} cannot be given at outputs of {ranges}")
        terminals = self.card.outputs.values()
        volts = np.array([terminal.raw(value) for terminal, value in zip(terminals, pressures, strict=True)])
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
            self._writer.write_one_sample(np.zeros(len(self.card.outputs)))

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
        there = self.card.server or "this machine"
        try:
            with contextlib.closing(Driver(self.card.server)) as driver:
                yield ChannelStatus("driver", there, driver.version())
                for name, model in driver.devices().items():
                    yield ChannelStatus("device", name, model)
            yield from super().status()
        except RigError as error:
            yield ChannelStatus("rig", there, "", str(error))

    def _open_outputs(self, driver: Driver) -> None:
        """Open lines, which vent, then valves."""
        package = driver.package
        self._levels = dict.fromkeys(_LINES, False)
        lines = self._new_task(driver)
        for name in _LINES:
            with driver.translated(f"{name} at {(where := self.wiring[name])}"):
                lines.do_channels.add_do_chan(where, line_grouping=package.constants.LineGrouping.CHAN_PER_LINE)
        self._switch = package.stream_writers.DigitalMultiChannelWriter(lines.out_stream, auto_start=True)
        self._switch.verify_array_shape = False
        with driver.translated("the digital lines"):
            self._set()
        valves = self._new_task(driver)
        for name in self.card.outputs:
            with driver.translated(f"{name} at {(where := self.wiring[name])}"):
                valves.ao_channels.add_ao_voltage_chan(where, min_val=0.0, max_val=10.0)
        self._writer = package.stream_writers.AnalogMultiChannelWriter(valves.out_stream, auto_start=True)
        self._writer.verify_array_shape = False
        with driver.translated("the valves"):
            self._writer.write_one_sample(np.zeros(len(self.card.outputs)))

    def _open_inputs(self, driver: Driver) -> None:
        """Start the samples, of which the driver buffers 10 s."""
        package, constants = driver.package, driver.package.constants
        self._samples = self._new_task(driver)
        wired = {"terminal_config": constants.TerminalConfiguration.DIFF, "min_val": -10.0, "max_val": 10.0}
        for name in self.card.inputs:
            with driver.translated(f"{name} at {(where := self.wiring[name])}"):
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
        models = [f"{name} ({model})" for name, model in driver.devices().items() if name == self.card.device]
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
        """Whether the watchdog has expired; the first time, vent."""
        if self._watchdog.expires(time.monotonic()):
            self.vent()
        return self._watchdog.has_expired

    def _set(self, **levels: bool) -> None:
        """Write the digital lines, all at once."""
        self._levels |= levels
        self._switch.write_one_sample_one_line(np.array([*self._levels.values()], bool))
