"""A rig on a serial line: a board in a thread at the other end of a pseudo-terminal."""

import contextlib
import os
import pty
import threading
import time
import tty

import numpy as np
import pytest

from mckibben.errors import RigError, SilentError
from mckibben.rig.serial_line import SerialBackend
from mckibben.serial_protocol import (
    FaultCode,
    FaultReport,
    FirmwareState,
    Hello,
    Message,
    MessageKind,
    Receiver,
    Sample,
    unpack_numbers,
)
from mckibben.units import bar

pytest.importorskip("serial", reason="needs the extra rig")

PERIOD = 5e-3  # s
MEASURED = [("angle", "rad"), ("pressure1", "Pa"), ("pressure2", "Pa")]
VALVES = [("valve1", "Pa"), ("valve2", "Pa")]


class Board:
    """Firmware whose pressures are its commands; `damage` may change each of its frames."""

    def __init__(self, digest=b"\1" * 32, damage=lambda number, frame: frame):
        self.host, self.end = pty.openpty()
        tty.setraw(self.end)
        self.port, self.damage = os.ttyname(self.end), damage
        self.hello = Hello("test 1", round(PERIOD * 1e6), digest, MEASURED, VALVES)
        self.state, self.commands, self.sequence = FirmwareState.DISARMED, None, 0
        self.heard = time.monotonic()
        self.begun, self.running = time.monotonic(), True
        self.thread = threading.Thread(target=self.run)
        self.thread.start()

    def send(self, kind, body):
        self.sequence += 1
        stamp = round((time.monotonic() - self.begun) / PERIOD) * round(PERIOD * 1e6)
        os.write(self.host, self.damage(self.sequence, Message(kind, self.sequence, stamp, body).encode()))

    def run(self):
        os.set_blocking(self.host, False)
        receiver, due = Receiver(), time.monotonic()
        while self.running:
            due = max(due + PERIOD, time.monotonic() + PERIOD / 2)
            time.sleep(max(0.0, due - time.monotonic()))
            try:
                messages = receiver.feed(os.read(self.host, 4096))
            except OSError:
                messages = []
            for message in messages:
                self.take(message)
            armed = self.state == FirmwareState.RUNNING
            if armed and time.monotonic() - self.heard > 0.5:  # on a busy machine
                self.vent(FaultCode.HOST_SILENT)
            commands = self.commands if self.state == FirmwareState.RUNNING else (0.0, 0.0)
            numbers = (0.1, *commands, *commands)
            self.send(MessageKind.SAMPLE, Sample(self.state, 0, 0, 0, receiver.lost, numbers).pack())

    def take(self, message):
        self.heard = time.monotonic()
        if message.kind == MessageKind.HELLO:
            self.send(MessageKind.HELLO, self.hello.pack())
        elif message.kind == MessageKind.ARM and self.state == FirmwareState.DISARMED and self.commands is not None:
            self.state = FirmwareState.RUNNING
        elif message.kind == MessageKind.DISARM:
            self.state, self.commands = FirmwareState.DISARMED, None
        elif message.kind == MessageKind.VENT:
            self.vent(FaultCode.VENT_ASKED)
        elif message.kind == MessageKind.COMMAND:
            self.commands = unpack_numbers(message.body, "f")

    def vent(self, fault):
        self.state, self.commands = FirmwareState.VENTED, None
        self.send(MessageKind.FAULT, FaultReport(fault, 255, float("nan")).pack())

    def close(self):
        self.running = False
        self.thread.join()
        for file in (self.host, self.end):
            with contextlib.suppress(OSError):
                os.close(file)


@pytest.fixture
def board():
    made = []

    def make(**settings):
        made.append(Board(**settings))
        return made[-1]

    yield make
    for one in made:
        one.close()


def followed(rig, pressures, duration=0.5):
    """Blocks within a duration under commands [Pa]."""
    blocks, end = [], time.monotonic() + duration
    while time.monotonic() < end:
        rig.set_valves(pressures)
        blocks.append(rig.read(4, timeout=1.0))
        rig.heartbeat()
    return blocks


def vented(board):
    deadline = time.monotonic() + 2
    while board.state != FirmwareState.VENTED and time.monotonic() < deadline:
        time.sleep(0.01)
    return board.state == FirmwareState.VENTED


def test_commands_go_out_and_samples_come_in(board):
    there = board()
    rig = SerialBackend(there.port, digest=there.hello.digest, period=PERIOD)
    with rig.opened():
        assert [channel.name for channel in rig.inputs] == [name for name, _ in MEASURED]
        assert [(channel.name, channel.unit) for channel in rig.outputs] == VALVES and rig.rate == 1 / PERIOD
        blocks = followed(rig, [1 * bar, 2 * bar])
        assert blocks[-1].values[-1] == pytest.approx([0.1, 1 * bar, 2 * bar])
        numbers = np.concatenate([np.round(block.time / PERIOD) for block in blocks])
        assert (np.diff(numbers) > 0).all() and abs(rig.clock() - blocks[-1].time[-1]) < 1.0
        rig.vent()
        assert vented(there)
        rig.read(50)  # what waits is from before
        assert followed(rig, [3 * bar, 0.0])[-1].values[-1, 1] == pytest.approx(3 * bar)
    assert vented(there)
    assert rig.description["firmware"] == "test 1"


@pytest.mark.parametrize("what", ["lost", "corrupted", "repeated"])
def test_loss_is_counted_and_not_fatal(board, what):
    def damage(number, frame):
        if number % 7:
            return frame
        return {"lost": b"", "corrupted": frame[:5] + bytes([frame[5] ^ 64 or 1]) + frame[6:], "repeated": 2 * frame}[
            what
        ]

    there = board(damage=damage)
    rig = SerialBackend(there.port)
    with rig.opened():
        blocks = followed(rig, [1 * bar, 1 * bar])
        assert blocks[-1].values[-1, 1] == pytest.approx(1 * bar)
        assert what in rig.losses


@pytest.mark.parametrize(
    ("settings", "field"), [({"digest": b"\2" * 32}, "digest"), ({"period": 2 * PERIOD}, "period")]
)
def test_another_firmware_is_refused_before_anything_is_armed(board, settings, field):
    there = board()
    with pytest.raises(RigError) as refused:
        SerialBackend(there.port, **settings).open()
    assert refused.value.field == field and refused.value.remedy
    assert there.state == FirmwareState.DISARMED


def test_a_wrong_port_is_named(monkeypatch):
    host, end = pty.openpty()
    for port in ("/dev/there-is-none", os.ttyname(end)):
        with pytest.raises(RigError) as refused:
            SerialBackend(port).open()
        assert refused.value.field == "port" and refused.value.value == port
    os.close(host)
    os.close(end)


def test_a_board_that_was_unplugged_falls_silent_or_is_lost(board):
    there = board()
    rig = SerialBackend(there.port)
    rig.open()
    followed(rig, [1 * bar, 1 * bar], 0.2)
    there.close()
    with pytest.raises((SilentError, RigError)) as stopped:
        for _ in range(100):
            rig.read(4, timeout=0.2)
    assert stopped.value.remedy
    rig.vent()
    rig.close()


def test_a_board_that_resets_or_vents_is_named(board):
    there = board()
    rig = SerialBackend(there.port)
    with rig.opened():
        followed(rig, [1 * bar, 1 * bar], 0.2)
        there.send(MessageKind.FAULT, FaultReport(FaultCode.NOT_FINITE, 255, float("nan")).pack())  # it only holds
        followed(rig, [1 * bar, 1 * bar], 0.1)
        there.vent(FaultCode.OUT_OF_RANGE)
        with pytest.raises(RigError, match=r"out of range, with angle 0\.1 rad"):
            followed(rig, [1 * bar, 1 * bar])
        rig.vent()
        there.send(MessageKind.HELLO, there.hello.pack())  # late
        followed(rig, [1 * bar, 1 * bar], 0.1)
        there.begun = time.monotonic()
        with pytest.raises(RigError, match="reset"):
            followed(rig, [1 * bar, 1 * bar])
