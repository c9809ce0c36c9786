"""Access to the NI-DAQmx driver: terminals and errors."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

from mckibben.errors import Problem, RigError, SilentError, refuse_problems

_TIMEOUT = -200284
_OVERWRITTEN = -200279
_RESERVED = (-50103, -200022)
_NO_DEVICE = -200220
_NO_CHANNEL = (-200170, -200149)
_GONE = (-88709, -201003, -200324, -50405)

_DRIVER = "install NI-DAQmx from ni.com (`nidaqmx installdriver` helps), or give the server of a machine with cards"


class Driver:
    """The driver NI-DAQmx.

    Parameters
    ----------
    server
        Address of an NI gRPC Device Server, "host:port"; empty for the driver of this machine.

    Raises
    ------
    RigError
        If the package, the driver or the server is missing.
    """

    def __init__(self, server: str = "") -> None:
        try:
            import nidaqmx
            import nidaqmx.constants
            import nidaqmx.errors
            import nidaqmx.stream_readers
            import nidaqmx.stream_writers
            import nidaqmx.system
        except ImportError as error:
            raise RigError(
                f"the package {error.name or 'nidaqmx'} is missing", remedy="pip install 'mckibben[daq]'"
            ) from error
        self.package = nidaqmx
        self.server = server
        self._channel: Any = None
        if server:
            try:
                import grpc
            except ImportError as error:
                raise RigError("the package grpcio is missing", remedy="pip install 'nidaqmx[grpc]'") from error
            self._channel = grpc.insecure_channel(server)

    def task(self) -> Any:
        """A new task without a name."""
        with self.translated("a task"):
            return self.package.Task(grpc_options=self._options())

    def version(self) -> str:
        """Version of the driver."""
        with self.translated("the driver"):
            version = self._system().driver_version
        return f"{version.major_version}.{version.minor_version}.{version.update_version}"

    def devices(self) -> dict[str, tuple[str, str]]:
        """Model and serial number of each device, by name."""
        with self.translated("the devices"):
            return {device.name: (device.product_type, f"{device.serial_num:X}") for device in self._system().devices}

    def reset(self, device: str) -> None:
        """Abort the tasks of a device, whose lines and outputs then return to rest."""
        with self.translated(device):
            self._system().devices[device].reset_device()

    def close(self) -> None:
        """Close the connection."""
        if self._channel is not None:
            self._channel.close()
            self._channel = None

    @contextmanager
    def translated(self, what: str) -> Iterator[None]:
        """Translate errors of the driver to `RigError` with a remedy, timeouts to `SilentError`."""
        errors = self.package.errors
        try:
            yield
        except errors.DaqNotFoundError as error:
            raise RigError("the driver NI-DAQmx is not installed on this machine", remedy=_DRIVER) from error
        except errors.DaqNotSupportedError as error:
            raise RigError("there is no driver NI-DAQmx for this system", remedy=_DRIVER) from error
        except errors.RpcError as error:
            raise RigError(
                f"{what}, by the NI gRPC Device Server at {self.server}: {_first(error)}",
                remedy="check that it runs there, that its version is that of nidaqmx, and the address",
            ) from error
        except errors.DaqError as error:
            raise self._said(error, what) from error

    def _said(self, error: Any, what: str) -> RigError:
        code, text = error.error_code, _first(error)
        if code == _TIMEOUT:
            return SilentError(f"{what}: samples did not come in time", remedy="check the card, and reopen it")
        if code == _OVERWRITTEN:
            return RigError(
                f"{what}: samples were overwritten, the host did not read them in time", remedy="reopen the rig"
            )
        if code == _NO_DEVICE or code in _NO_CHANNEL:
            return RigError(f"{what}: {text}", remedy=f"{self._there()}; correct the address in the wiring")
        if code in _RESERVED:
            return RigError(f"{what} is in use by another program", remedy="close that program (NI MAX, another test)")
        if code in _GONE:
            return RigError(f"{what}: the device is disconnected ({text})", remedy="check cable and power")
        return RigError(f"{what}: {text} (NI-DAQmx {code})", remedy="look the number up at ni.com")

    def _there(self) -> str:
        try:
            names = list(self._system().devices.device_names)
        except self.package.errors.Error:
            return "no device can be listed"
        return f"connected are {', '.join(names)}" if names else "no device is connected"

    def _system(self) -> Any:
        system = self.package.system.System
        options = self._options()
        return system.local() if options is None else system.remote(options)

    def _options(self) -> Any:
        if not self.server:
            return None
        if self._channel is None:
            raise RigError("the connection to the device server is closed", remedy="reopen the rig")
        return self.package.GrpcSessionOptions(self._channel, "")


def _first(error: Exception) -> str:
    """First line of an error of the driver, which has paragraphs."""
    lines: Sequence[str] = str(error).strip().splitlines()
    return lines[0].strip().rstrip(".") if lines else type(error).__name__


@dataclass(frozen=True, kw_only=True)
class Terminals:
    """Terminals of a rig, in the notation of the driver; by default the paper's.

    Parameters
    ----------
    inputs, outputs
        Terminals of the sensors and valves, by channel.
    heartbeat
        Line that toggles with each heartbeat; an external relay opens when it does not.
    hold
        Line that through this relay energises the spring-return vent valve: high = closed.
    counter
        Counter of the motor's pulses; empty without a motor.
    direction
        Line of the motor's direction: high = stretching.
    input_range, output_range
        Ranges of all inputs and outputs [V].
    rest
        Signal of the outputs at which a valve vents [V].

    Raises
    ------
    RangeError
        With all terminals that are missing or given twice, or if the rest is outside the range.
    """

    # analog inputs of the sensors, each differential: "Dev1/ai0" is AI 0 against AI 8
    inputs: Mapping[str, str] = field(default_factory=lambda: {"force": "Dev1/ai0", "pressure": "Dev1/ai1"})
    outputs: Mapping[str, str] = field(default_factory=lambda: {"valve": "Dev1/ao0"})
    heartbeat: str = "Dev1/port0/line0"
    hold: str = "Dev1/port0/line1"
    counter: str = "Dev1/ctr0"
    direction: str = "Dev1/port0/line2"
    input_range: tuple[float, float] = (-10.0, 10.0)
    output_range: tuple[float, float] = (0.0, 10.0)
    rest: float = 0.0

    def __post_init__(self) -> None:
        problems: list[Problem] = []
        if not self.inputs:
            problems.append(Problem("has no sensor", field="inputs"))
        if not self.outputs:
            problems.append(Problem("has no valve", field="outputs"))
        problems += [
            Problem("is missing: without it nothing vents when the host dies", field=name)
            for name in ("heartbeat", "hold")
            if not getattr(self, name)
        ]
        if self.counter and not self.direction:
            problems.append(Problem("is missing: the motor needs it", field="direction"))
        for name in ("input_range", "output_range"):
            low, high = getattr(self, name)
            if not low < high:
                problems.append(Problem(f"{low:g}..{high:g} V is empty", field=name))
        low, high = self.output_range
        if not low <= self.rest <= high:
            problems.append(Problem(f"{self.rest:g} V is outside {low:g}..{high:g} V", field="rest"))
        given = [*self.inputs.values(), *self.outputs.values(), *self.lines.values()]
        problems += [
            Problem(f"{terminal} is given twice", field="wiring")
            for terminal in sorted({one for one in given if given.count(one) > 1})
        ]
        refuse_problems("wiring", problems)

    @property
    def lines(self) -> dict[str, str]:
        """Digital lines by name, in the order in which they are written."""
        lines = {"heartbeat": self.heartbeat, "hold": self.hold}
        return lines | {"direction": self.direction} if self.counter else lines
