"""Rigs on a microcontroller that speaks the protocol of docs/serial-protocol.md; needs the extra `rig`."""

from __future__ import annotations

import contextlib
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from mckibben.errors import RigError, SilentError
from mckibben.rig.backend import Backend, Block, Channel
from mckibben.serial_protocol import (
    CommandSource,
    FaultCode,
    FaultReport,
    FirmwareState,
    Hello,
    Message,
    MessageKind,
    Receiver,
    Sample,
    pack_numbers,
)
from mckibben.units import ms

_ARMED = FirmwareState.RAMPING, FirmwareState.RUNNING, FirmwareState.HOLDING
_CABLE = "check cable and supply of the board, and what else keeps it or this computer busy"
_REMEDIES = {
    FaultCode.NOT_FINITE: "check the sensor's wiring and supply",
    FaultCode.OUT_OF_RANGE: "check the sensor, its calibration and the stops of the rig",
    FaultCode.FROZEN: "check the sensor's wiring",
    FaultCode.LATE: "use a longer period, or a faster board",
    FaultCode.HOST_SILENT: "check the cable, and find what kept the host busy",
    FaultCode.OTHER_DIGEST: "export and flash the firmware again, or use the scenario that it was made from",
    FaultCode.REFUSED: "export and flash the firmware again",
    FaultCode.VENT_ASKED: "find out what else uses the port, or repeats old messages on the line",
    FaultCode.WATCHDOG: "find out what hangs in the firmware",
}


class SerialBackend(Backend):
    """Sensors and valves at the firmware of a microcontroller.

    The firmware samples by its own clock, ramps from the measured pressures to the first commands, and vents without a
    sign of life within 100 ms. A lost or damaged message is counted in `losses`; samples that are missing are missing
    in the numbers of a block.

    Parameters
    ----------
    port
        Port, such as "/dev/ttyACM0" or "COM3".
    baud
        Rate of the line [1/s]; of no effect on USB.
    digest
        SHA-256 that the firmware must have; empty: any.
    period
        Sampling period that the firmware must have [s]; 0: any.
    muscle
        Muscle of a joint's board that is on a bench, 1 or 2: its channels are "pressure" and "valve", and the other
        muscle stays vented. 0: a joint.
    """

    patience = 100 * ms

    def __init__(
        self, port: str, *, baud: int = 1_000_000, digest: bytes = b"", period: float = 0.0, muscle: int = 0
    ) -> None:
        self.port, self.baud, self.muscle = port, baud, muscle
        self._digest, self._period = digest, period
        self._line: Any = None
        self._sequence = time.monotonic_ns() & 0xFFFF  # not a number that an earlier host has sent
        self._forget()
        with self.opened():  # the firmware says its channels and its period
            pass

    def _forget(self) -> None:
        self._receiver = Receiver()
        self._sent: dict[int, float] = {}  # times [s] by number, of messages that the board has not returned
        self._returned: tuple[float, int] | None = None  # when one was sent [s], and a later time of the board [us]
        self._samples: deque[tuple[int, float, tuple[float, ...]]] = deque()  # number, time, values
        self._newest: Sample | None = None
        self._answer: Hello | None = None
        self._parts: list[bytes] = []  # bodies of it so far
        self._begun: int | None = None  # time of the board at sample 0 [us]
        self._device: int | None = None  # time of its latest sample [us]
        self._latest = -1  # number of that sample
        self._arrived = (0.0, 0.0)  # times of the latest sample, by host and board [s]
        self._report: FaultReport | None = None  # the latest one since it was armed
        self._armed = False

    @property
    def inputs(self) -> Sequence[Channel]:
        return [Channel(self._named(name), unit, where=self.port) for name, unit in self._known.measurements]

    @property
    def outputs(self) -> Sequence[Channel]:
        channels = [Channel(self._named(name), unit, 0.0, where=self.port) for name, unit in self._known.commands]
        return [channel for channel in channels if not self.muscle or channel.name == "valve"]

    def _named(self, channel: str) -> str:
        """Name of a channel of the firmware on this rig."""
        return {f"{name}{self.muscle}": name for name in ("pressure", "valve")}.get(channel, channel)

    @property
    def losses(self) -> str:
        """Losses on the line so far; empty if there are none."""
        counts = {name: getattr(self._receiver, name) for name in ("corrupted", "lost", "repeated")}
        counts["lost by the board"] = self._newest.lost if self._newest else 0
        return ", ".join(f"{count} messages {name}" for name, count in counts.items() if count)

    @property
    def description(self) -> Mapping[str, str]:
        firmware, _, digest, *_ = self._known
        return {"kind": "serial", "port": self.port, "firmware": firmware, "digest": digest.hex()}

    def open(self) -> None:
        """Open the port, ask the board who it is, vent it, and wait for its first sample.

        Raises
        ------
        RigError
            If the port is missing or silent, or the firmware has another version, scenario or period.
        """
        if self._line is not None:
            raise RigError("the rig is already open", remedy="close it first")
        self._forget()
        self._line = self._opened()
        self._check(self._ask())
        self.vent()
        if not self._until(lambda: self._state in (FirmwareState.DISARMED, FirmwareState.VENTED)):
            raise SilentError(f"no sample of a vented board comes from {self.port}", remedy="flash the board again")
        if not self._until(lambda: self._returned is not None, (MessageKind.HEARTBEAT, b"")):
            raise SilentError(f"the board at {self.port} returns no message of this host", remedy=_CABLE)
        self._begun = None
        self._samples.clear()
        self._until(lambda: bool(self._samples))

    def _opened(self) -> Any:
        try:
            import serial
            import serial.tools.list_ports
        except ImportError as error:
            raise RigError("the package pyserial is missing", remedy="pip install 'mckibben[rig]'") from error
        try:
            return serial.Serial(self.port, self.baud, timeout=0, write_timeout=self.patience, exclusive=True)
        except (OSError, ValueError) as error:
            ports = ", ".join(port.device for port in serial.tools.list_ports.comports()) or "none"
            raise RigError(
                f"the port {self.port} cannot be opened: {error}",
                field="port",
                value=self.port,
                remedy=f"connect the board, close other programs; ports are: {ports}",
            ) from error

    def _ask(self) -> Hello:
        """Description of the firmware, of which each part is asked for repeatedly: a board may just be starting."""
        while self._answer is None:
            count = len(self._parts)
            asked = MessageKind.HELLO, bytes([count]) if count else b""
            if self._until(lambda count=count: self._answer is not None or len(self._parts) > count, asked):
                continue
            received = "only other data come" if self._receiver.corrupted else "nothing comes"
            raise RigError(
                f"no firmware of mckibben answers at {self.port}: {received}",
                field="port",
                value=self.port,
                remedy="choose another port or baud rate, or flash the board: mckibben export SCENARIO --to firmware",
            )
        return self._answer

    def _until(self, done: Callable[[], bool], *sent: tuple[MessageKind, bytes], again: float = 20 * ms) -> bool:
        """Take messages until something is done, for 2 s at most, and send some again and again [s] meanwhile."""
        end, due = time.monotonic() + 2.0, 0.0
        while not done() and time.monotonic() < end:
            if time.monotonic() > due:
                for kind, body in sent:
                    self._send(kind, body)
                due = time.monotonic() + again
            self._take(self._received())
            time.sleep(0.5 * ms)
        return done()

    def _check(self, hello: Hello) -> None:
        self._known = hello
        if self._digest and hello.digest != self._digest:
            raise RigError(
                f"the firmware {hello.firmware} was made from another scenario ({hello.digest.hex()[:8]}, not "
                f"{self._digest.hex()[:8]})",
                field="digest",
                value=hello.digest.hex(),
                remedy=_REMEDIES[FaultCode.OTHER_DIGEST],
            )
        needed, period = self._period or self.patience, hello.period * 1e-6
        if period > needed + 1e-6 or (self._period and period < needed - 1e-6):
            limit = "exactly" if self._period else "at most"
            raise RigError(
                f"the firmware samples every {period / ms:g} ms, and {limit} {needed / ms:g} ms are needed",
                field="period",
                value=period,
                unit="s",
                remedy=_REMEDIES[FaultCode.OTHER_DIGEST],
            )
        self.rate = 1e6 / hello.period

    @property
    def latency(self) -> float:
        """Longest time [s] that the latest sample can have taken: since the message that the board returned in one.

        The board had that message before it took the sample, and its clock says how long ago that was.
        """
        if self._returned is None or self._device is None:
            return 0.0
        sent, device = self._returned
        return self._arrived[0] - sent - (self._device - device) * 1e-6

    def clock(self) -> float:
        """Time since it was opened [s]: that of the board's latest sample, and of the host since it arrived."""
        host, board = self._arrived
        return board + time.monotonic() - host

    def read(self, count: int, *, timeout: float = 1.0) -> Block:
        self._check_open()
        end, repeated = time.monotonic() + count / self.rate + timeout, self._receiver.repeated
        while not self._has(count):
            ended = time.monotonic() > end
            self._take(self._received())  # also what came while this computer was busy
            if ended and not self._has(count):
                older = ", but older ones, as after a reset" if self._receiver.repeated > repeated else ""
                raise SilentError(f"no sample from {self.port} for {timeout:g} s{older}", remedy=_CABLE)
            time.sleep(min(0.2 / self.rate, 1 * ms))
        first = self._samples[0][0]
        rows = [self._samples.popleft() for _ in range(len(self._samples)) if self._samples[0][0] < first + count]
        times = np.array([row[1] for row in rows])
        values = np.array([row[2][: len(self._known.measurements)] for row in rows], np.float64)
        return Block(first, times, values, np.zeros(len(rows)))

    def _has(self, count: int) -> bool:
        """Whether a number of samples came, less those that were lost."""
        samples = self._samples
        return bool(samples) and (len(samples) >= count or samples[-1][0] >= samples[0][0] + count - 1)

    def set_valves(self, pressures: Sequence[float]) -> None:
        """Send commands [Pa], and arm the board after the first ones."""
        self._check_open()
        self._take(self._received())
        commands = {valve.name: float(pressure) for valve, pressure in zip(self.outputs, pressures, strict=True)}
        asked = [commands.get(self._named(name), 0.0) for name, _ in self._known.commands]
        command = MessageKind.COMMAND, pack_numbers(asked, "f")
        if not self._armed:
            self._arm(command)
        self._send(*command)

    def _arm(self, command: tuple[MessageKind, bytes]) -> None:
        """Arm the board, with its first command; messages are repeated until its samples show the state."""
        arm = MessageKind.ARM, bytes([CommandSource.COMMANDS]) + self._known.digest
        for sent, states in (
            (((MessageKind.DISARM, b""),), (FirmwareState.DISARMED,)),
            ((command, arm), _ARMED),
        ):
            if not self._until(lambda states=states: self._state in states, *sent):
                text, remedy = _fault(self._newest.fault if self._newest is not None else FaultCode.NONE)
                raise RigError(f"the board does not follow {sent[-1][0].name}: {text}", remedy=remedy)
        self._armed, self._report = True, None

    def heartbeat(self) -> None:
        self._check_open()
        self._send(MessageKind.HEARTBEAT)

    def vent(self) -> None:
        """Vent, by three messages, of which two may be lost. Never raises."""
        self._armed = False
        for _ in range(3):
            with contextlib.suppress(Exception):
                self._send(MessageKind.VENT)

    def close(self) -> None:
        line = self._line
        if line is None:
            return
        self.vent()
        self._line = None
        with contextlib.suppress(Exception):
            line.flush()
        with contextlib.suppress(Exception):
            line.close()

    @property
    def _state(self) -> int:
        """State of the firmware in its latest sample; -1 before the first."""
        return -1 if self._newest is None else self._newest.state

    def _check_open(self) -> None:
        if self._line is None:
            raise RigError("the rig is not open", remedy="open it first")

    def _send(self, kind: MessageKind, body: bytes = b"") -> None:
        self._sequence = (self._sequence + 1) & 0xFFFF
        now = self._sent[self._sequence] = time.monotonic()
        with self._translated():
            self._line.write(Message(kind, self._sequence, int(now * 1e6), body).encode())

    def _received(self) -> list[Message]:
        with self._translated():
            return self._receiver.feed(self._line.read(4096))

    @contextlib.contextmanager
    def _translated(self) -> Iterator[None]:
        try:
            yield
        except (OSError, AttributeError, TypeError) as error:  # pyserial raises all of them for a lost port
            remedy = f"{_CABLE}; the board vents by itself"
            raise RigError(f"the port {self.port} does not work: {error}", remedy=remedy) from error

    def _take(self, messages: Sequence[Message]) -> None:
        """Take samples and faults of the board."""
        for message in messages:
            if message.kind == (MessageKind.CHANNELS if self._parts else MessageKind.HELLO) and self._answer is None:
                self._describe(message.body)
            if message.kind == MessageKind.FAULT and self._armed:
                report = FaultReport.unpack(message.body)
                if report.code != FaultCode.REFUSED:  # such as of a repeated message
                    self._report = report  # it stops when a sample shows that the board vented, and with which values
            if message.kind == MessageKind.SAMPLE and self._answer is not None:
                self._keep(message, self._answer)

    def _describe(self, body: bytes) -> None:
        """Take a part of the description of the firmware, if it is the next one."""
        if not self._parts or body[:1] == bytes([len(self._parts)]):
            self._parts.append(body)
            if Hello.is_whole(*self._parts):
                self._answer = Hello.unpack(*self._parts)

    def _keep(self, message: Message, hello: Hello) -> None:
        sample, now = Sample.unpack(message.body), time.monotonic()
        if len(sample.values) != len(hello.measurements) + len(hello.commands):
            raise RigError("a sample has another number of channels", remedy=_REMEDIES[FaultCode.OTHER_DIGEST])
        before = message.time if self._device is None else self._device
        self._device = before + (message.time - before + (1 << 31)) % (1 << 32) - (1 << 31)
        if self._device < before:
            raise RigError(
                "the clock of the board jumps back: it was reset", remedy="check its supply and cable, and reopen"
            )
        if sample.heard in self._sent:
            while (number := next(iter(self._sent))) != sample.heard:
                del self._sent[number]
            self._returned = self._sent.pop(sample.heard), self._device
        if self._begun is None:
            self._begun, self._latest = self._device, -1
        elapsed = (self._device - self._begun) * 1e-6
        number = round(elapsed * 1e6 / hello.period)
        self._newest, self._arrived = sample, (now, elapsed)
        if number > self._latest:
            self._samples.append((number, elapsed, sample.values))
        self._latest = number
        if self._armed and sample.state not in _ARMED:
            self._refuse(self._report or FaultReport(sample.fault, 255, float("nan")))

    def _refuse(self, report: FaultReport) -> None:
        """Raise the fault for which the board has vented."""
        self._armed = False
        fault, remedy = _fault(report.code)
        names = [name for name, _ in (*self._known.measurements, *self._known.commands)]
        where = f" at {names[report.channel]}: {report.value:g}" if report.channel < len(names) else ""
        if not where and self._newest is not None:
            shown = zip(self._known.measurements, self._newest.values, strict=False)
            where = ", with " + ", ".join(f"{name} {value:.4g} {unit}" for (name, unit), value in shown)
        raise RigError(
            f"the board vented: {fault}{where}",
            field=names[report.channel] if report.channel < len(names) else "",
            value=report.value,
            remedy=remedy,
        )


def _fault(code: int) -> tuple[str, str]:
    """Name of a fault, and what to check."""
    if code not in {*FaultCode}:
        return f"fault {code}, which is unknown here", "export and flash the firmware again, by this version"
    fault = FaultCode(code)
    return fault.name.lower().replace("_", " "), _REMEDIES.get(fault, _CABLE)
