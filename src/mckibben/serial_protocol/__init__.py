"""Messages between a host and the firmware of a joint or a bench on a serial line: docs/serial-protocol.md.

A message is packed little-endian, followed by its CRC-16, encoded by consistent overhead byte stuffing (COBS) and ended
by a zero byte. A receiver therefore finds the next message after any loss, which it counts. The same protocol in C is
in `mckibben.export.firmware`.
"""

from __future__ import annotations

import binascii
import struct
from collections.abc import Sequence
from enum import IntEnum
from typing import NamedTuple

from mckibben.errors import ParameterError, RigError

VERSION = 3
"""Version of the protocol, in the first byte of `Hello`."""
MOST_CHANNELS = 255
"""Most measurements, commands, and setpoints of a firmware."""
LONGEST = 10 + 2 * 4 * MOST_CHANNELS
"""Most bytes in the body of a message: a `Sample` of all measurements and commands."""
DESCRIBED = 244
"""Most bytes in the body of `HELLO` and `CHANNELS`; each firmware takes bodies of this length."""
_HEADER = struct.Struct("<BHI")  # kind, sequence number, time in us
_HELLO = struct.Struct("<BBBBI32s")  # version, numbers of measurements, commands and setpoints, period in us, digest
_SAMPLE = struct.Struct("<BBHHHH")  # state, fault, held, missed, lost, heard
_FAULT = struct.Struct("<BBf")  # code, channel, value


class MessageKind(IntEnum):
    """Kind of a message; `HELLO` and `HEARTBEAT` are sent by both sides."""

    HELLO = 1
    ARM = 2
    DISARM = 3
    SETPOINT = 4
    COMMAND = 5
    VENT = 6
    HEARTBEAT = 7
    SAMPLE = 8
    FAULT = 9
    CHANNELS = 10


_ANEW = MessageKind.HELLO, MessageKind.VENT
"""Messages that are taken with any number, from which the count goes on: a vent is never too late."""


class FirmwareState(IntEnum):
    """State of the firmware; its valves are vented in all but `RAMPING`, `RUNNING` and `HOLDING`."""

    DISARMED = 0
    RAMPING = 1
    RUNNING = 2
    HOLDING = 3
    VENTED = 4


class FaultCode(IntEnum):
    """Reason why a sample was not used, why the valves were vented, or why a message was refused."""

    NONE = 0
    NOT_FINITE = 1
    OUT_OF_RANGE = 2
    FROZEN = 3
    LATE = 4
    HOST_SILENT = 5
    OTHER_DIGEST = 6
    REFUSED = 7
    VENT_ASKED = 8
    WATCHDOG = 9


class CommandSource(IntEnum):
    """Who computes the commands, asked for when arming."""

    SETPOINTS = 0
    COMMANDS = 1


class Message(NamedTuple):
    """A message without its frame: kind, sequence number, time of the sender [us] modulo 2**32, body."""

    kind: int
    sequence: int
    time: int
    body: bytes = b""

    def encode(self) -> bytes:
        """Bytes of the line; `ParameterError` for a body that is too long.

        >>> Message(MessageKind.HEARTBEAT, 1, 0).encode().hex(" ")
        '03 07 01 01 01 01 01 03 2a ad 00'
        """
        if len(self.body) > LONGEST:
            message = f"a message of {len(self.body)} bytes is longer than {LONGEST}"
            remedy = "use fewer channels"
            raise ParameterError(message, field="body", value=len(self.body), remedy=remedy)
        data = _HEADER.pack(self.kind, self.sequence & 0xFFFF, self.time & 0xFFFFFFFF) + self.body
        data += _checksum(data)
        return b"".join(map(_stuffed, data.split(b"\0"))) + b"\0"


class Receiver:
    """Finds messages among the bytes of a line, and counts what was lost.

    Attributes
    ----------
    corrupted
        Frames with a wrong CRC, stuffing or length.
    lost
        Messages that are missing by their sequence numbers; those of corrupted frames are among them.
    repeated
        Messages whose number is not above the last one, which were repeated or overtaken on the way: they are dropped.

    Examples
    --------
    >>> receiver, line = Receiver(), Message(MessageKind.HEARTBEAT, 7, 5).encode()
    >>> receiver.feed(line[3:] + line + line)
    [Message(kind=7, sequence=7, time=5, body=b'')]
    >>> receiver.corrupted, receiver.lost, receiver.repeated
    (1, 0, 1)
    """

    corrupted = lost = repeated = 0
    _rest = b""
    _last: tuple[int, int] | None = None  # sequence number and time

    def feed(self, data: bytes) -> list[Message]:
        """Messages that end in these bytes; the rest is kept for the next call."""
        *frames, self._rest = (self._rest + data).split(b"\0")
        self._rest = self._rest[: LONGEST + 32]  # more than the longest frame: no message, however it ends
        messages = [self._message(frame) for frame in frames if frame]
        return [message for message in messages if message is not None]

    def _message(self, frame: bytes) -> Message | None:
        """Message of a frame, unless it is corrupted or repeated."""
        data = b""
        while frame and len(frame) >= frame[0]:
            data += frame[1 : frame[0]] + b"\0" * (frame[0] < 0xFF)
            frame = frame[frame[0] :]
        data = data.removesuffix(b"\0")
        if (
            frame
            or not 9 <= len(data) <= LONGEST + 9
            or binascii.crc_hqx(data[:-2], 0xFFFF) != int.from_bytes(data[-2:], "little")
        ):
            self.corrupted += 1
            return None
        kind, sequence, time = _HEADER.unpack_from(data)
        message = Message(kind, sequence, time, data[_HEADER.size : -2])
        if self._last is not None:
            ahead = (message.sequence - self._last[0]) & 0xFFFF
            anew = message.kind in _ANEW
            if self._last == (message.sequence, message.time) or not (anew or 0 < ahead < 0x8000):
                self.repeated += 1
                return None
            self.lost += 0 if anew else ahead - 1
        self._last = message.sequence, message.time
        return message


class Hello(NamedTuple):
    """Description of a firmware and its channels.

    Attributes
    ----------
    firmware
        Name and version.
    period
        Control period [us].
    digest
        SHA-256 of the scenario, or of the file of the bench, from which the firmware was made.
    measurements, commands, setpoints
        Name and unit of each channel, such as ``("pressure1", "Pa")``.
    """

    firmware: str
    period: int
    digest: bytes
    measurements: Sequence[tuple[str, str]]
    commands: Sequence[tuple[str, str]]
    setpoints: Sequence[tuple[str, str]] = ()

    def pack(self) -> list[bytes]:
        """Bodies: of `HELLO` and, if not all channels fit in it, of the messages `CHANNELS` 1, 2, ...

        Raises `ParameterError` for more than 255 channels of a group.

        >>> channels = [(f"pressure.muscle {number}", "Pa") for number in range(20)]
        >>> bodies = Hello("board 1", 2000, bytes(32), channels, channels).pack()
        >>> [len(body) <= DESCRIBED for body in bodies], Hello.unpack(*bodies).commands == channels
        ([True, True, True, True], True)
        """
        groups = self.measurements, self.commands, self.setpoints
        if (count := max(map(len, groups))) > MOST_CHANNELS:
            message = f"{count} channels are more than the {MOST_CHANNELS} that a description counts"
            raise ParameterError(
                message, field="channels", value=count, upper=MOST_CHANNELS, remedy="use a board for each limb"
            )
        bodies = [_HELLO.pack(VERSION, *map(len, groups), self.period, self.digest) + self.firmware.encode()]
        for line in (f"{name} {unit}".encode() for group in groups for name, unit in group):
            if len(bodies[-1]) + 1 + len(line) <= DESCRIBED:
                bodies[-1] += b"\n" + line
            else:
                bodies.append(bytes([len(bodies)]) + line)
        return bodies

    @staticmethod
    def is_whole(body: bytes, *more: bytes) -> bool:
        """Whether bodies have all channels, or are of another version; `RigError` for a malformed one."""
        if body[:1] != bytes([VERSION]):
            return True
        return sum(part.count(b"\n") for part in (body, *more)) + len(more) >= sum(_fields(_HELLO, body)[1:4])

    @classmethod
    def unpack(cls, body: bytes, *more: bytes) -> Hello:
        """Description in bodies, see `pack`; `RigError` for another version of the protocol, or a malformed body.

        Malformed are also texts that are not printable, equal names of a group, and a period of 0.
        """
        if body[:1] != bytes([VERSION]):
            message = f"the firmware speaks version {body[0] if body else 'none'} of the protocol, not {VERSION}"
            raise RigError(message, field="version", remedy="export and flash the firmware again")
        _, *sizes, period, digest = _fields(_HELLO, body)
        texts = body[_HELLO.size :], *(part[1:] for part in more)
        firmware, *lines = b"\n".join(texts).decode(errors="replace").split("\n")
        channels = [(name, unit) for name, _, unit in (line.rpartition(" ") for line in lines)]
        first, second, _ = sizes
        groups = channels[:first], channels[first : first + second], channels[first + second :]
        printable = all(line.isprintable() and "\ufffd" not in line for line in (firmware, *lines))
        if len(channels) != sum(sizes) or not printable or not period or any(len(dict(g)) < len(g) for g in groups):
            raise _malformed()
        return cls(firmware, period, digest, *groups)


class Sample(NamedTuple):
    """State and channels of the firmware in a period.

    Attributes
    ----------
    state, fault
        State, and the reason why the last sample was not used or the valves were vented.
    held, missed, lost
        Since the start and modulo 2**16: samples that were not used, periods that were missed, and messages of the host
        that were lost.
    heard
        Sequence number of the last message of the host that was received before this sample was taken.
    values
        Measurements and commands in the order of `Hello`, in SI.
    """

    state: int
    fault: int
    held: int
    missed: int
    lost: int
    heard: int
    values: tuple[float, ...]

    def pack(self) -> bytes:
        """Body of the message."""
        return _SAMPLE.pack(*self[:6]) + struct.pack(f"<{len(self.values)}f", *self.values)

    @classmethod
    def unpack(cls, body: bytes) -> Sample:
        """Sample in a body; `RigError` for a malformed one."""
        state, fault, held, missed, lost, heard = _fields(_SAMPLE, body)
        return cls(state, fault, held, missed, lost, heard, unpack_numbers(body[_SAMPLE.size :], "f"))


class FaultReport(NamedTuple):
    """A fault: its `FaultCode`, the channel in the order of `Hello` (255: none), and its value."""

    code: int
    channel: int
    value: float

    def pack(self) -> bytes:
        """Body of the message."""
        return _FAULT.pack(*self)

    @classmethod
    def unpack(cls, body: bytes) -> FaultReport:
        """Fault in a body; `RigError` for a malformed one."""
        return cls(*_fields(_FAULT, body))


def _stuffed(block: bytes) -> bytes:
    """Bytes without a zero, in blocks of at most 254 bytes, after a byte that counts those of the block and itself."""
    parts = [block[at : at + 254] for at in range(0, len(block) + 1, 254)]
    return b"".join(bytes([len(part) + 1]) + part for part in parts)


def _checksum(data: bytes) -> bytes:
    """CRC-16/CCITT-FALSE."""
    return struct.pack("<H", binascii.crc_hqx(data, 0xFFFF))


def _fields(form: struct.Struct, body: bytes) -> tuple:
    """Fields at the beginning of a body."""
    if len(body) < form.size:
        raise _malformed()
    return form.unpack_from(body)


def _malformed() -> RigError:
    remedy = "check that the port is that of the firmware, and export and flash it again"
    return RigError("a message of the firmware is malformed", field="body", remedy=remedy)


def pack_numbers(numbers: Sequence[float], kind: str = "d") -> bytes:
    """Body of `SETPOINT` (64-bit numbers, ``d``) or `COMMAND` (32-bit numbers, ``f``)."""
    return struct.pack(f"<{len(numbers)}{kind}", *numbers)


def unpack_numbers(body: bytes, kind: str = "d") -> tuple[float, ...]:
    """Numbers of a body; `RigError` for a part of a number."""
    if len(body) % struct.calcsize(kind):
        raise _malformed()
    return struct.unpack(f"<{len(body) // struct.calcsize(kind)}{kind}", body)
