"""A rig on a serial line: a board in a thread at the other end of a pseudo-terminal."""

import contextlib
import os
import pty
import threading
import time
import tty

import numpy as np
import pytest

from mckibben.errors import RigError, SilentError, StoppedError
from mckibben.rig.control_loop import RunPlan, control
from mckibben.rig.safety import JointMonitor
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
from mckibben.units import bar, ms
from tests.rig.joint.conftest import LIMITS, Kept, SteadyControl

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
        self.state, self.commands, self.sequence, self.was_armed = FirmwareState.DISARMED, None, 0, False
        self.heard, self.last = time.monotonic(), 0
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
            self.send(MessageKind.SAMPLE, Sample(self.state, 0, 0, 0, receiver.lost, self.last, numbers).pack())

    def take(self, message):
        self.heard, self.last = time.monotonic(), message.sequence
        if message.kind == MessageKind.HELLO:
            self.send(MessageKind.HELLO, self.hello.pack()[0])
        elif message.kind == MessageKind.ARM and self.state == FirmwareState.DISARMED and self.commands is not None:
            self.state, self.was_armed = FirmwareState.RUNNING, True
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


class SlowLine:
    """A line to a board which delays each frame [s], and may change their order: `order` takes and returns a list."""

    def __init__(self, board, *, delay=0.0, order=lambda side, frames: frames):
        self.far, self.end = pty.openpty()
        tty.setraw(self.end)
        self.port, self.near = os.ttyname(self.end), os.open(board.port, os.O_RDWR | os.O_NOCTTY)
        self.delay, self.order, self.running = delay, order, True
        self.threads = [
            threading.Thread(target=self.carry, args=way)
            for way in (("board", self.near, self.far), ("host", self.far, self.near))
        ]
        for thread in self.threads:
            thread.start()

    def carry(self, side, source, target):
        os.set_blocking(source, False)
        waiting, rest = [], b""
        while self.running:
            with contextlib.suppress(OSError):
                rest += os.read(source, 4096)
            *frames, rest = rest.split(b"\0")
            waiting += [(time.monotonic() + self.delay, frame + b"\0") for frame in self.order(side, frames)]
            while waiting and waiting[0][0] <= time.monotonic():
                with contextlib.suppress(BlockingIOError):  # nobody reads: they are lost
                    os.write(target, waiting.pop(0)[1])
            time.sleep(0.2 * ms)

    def close(self):
        self.running = False
        for thread in self.threads:
            thread.join()
        for file in (self.far, self.end, self.near):
            os.close(file)


@pytest.fixture
def line(board):
    lines = []

    def make(**settings):
        lines.append(SlowLine(board(), **settings))
        return lines[-1]

    yield make
    for made in lines:
        made.close()


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
    assert not there.was_armed


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
        there.send(MessageKind.HELLO, there.hello.pack()[0])  # late
        followed(rig, [1 * bar, 1 * bar], 0.1)
        there.begun = time.monotonic()
        with pytest.raises(RigError, match="reset"):
            followed(rig, [1 * bar, 1 * bar])


@pytest.mark.parametrize("delay", [0.0, 20 * ms, 100 * ms])
def test_the_latency_of_a_line_is_measured(line, delay):
    rig = SerialBackend(line(delay=delay).port)
    with rig.opened():
        for _ in range(20):
            rig.heartbeat()
            block = rig.read(1)
            assert 2 * delay - PERIOD <= rig.latency < 2 * delay + 4 * PERIOD + 20 * ms  # on a busy machine
        time.sleep(50 * ms)  # a busy host
        rig.heartbeat()
        block = rig.read(5)
        assert rig.latency < 2 * delay + 4 * PERIOD + 20 * ms and rig.clock() - block.time[-1] > 15 * ms
    named = {channel.name: channel.reading for channel in rig.status()}
    assert named["line"]


@pytest.mark.parametrize("delay", [40 * ms, 300 * ms])
def test_a_slow_line_stops_a_run_before_there_is_pressure(line, delay):
    """40 ms each way moved a joint beyond its limits; 300 ms looked like a valve that does not follow."""
    slow = line(delay=delay)
    rig, pressures = SerialBackend(slow.port), ((0.0, 8 * bar), (0.0, 8 * bar))
    plan = RunPlan(np.zeros((100, 2)), PERIOD, 20, 20, (3 * bar, 3 * bar), pressures, probing=100)
    outcome = control(rig, SteadyControl(), plan, LIMITS, kept := Kept())
    assert outcome.kind == "stopped" and 2 * delay - PERIOD <= outcome.error.value < 2 * delay + 0.2
    assert outcome.error.upper == LIMITS.late and outcome.error.remedy
    assert not np.nan_to_num(kept.columns["pressure1"]).any()


def test_a_line_that_becomes_slow_stops_the_next_sample(line):
    slow = line()
    rig = SerialBackend(slow.port)
    with rig.opened():
        monitor, late = JointMonitor(rig, LIMITS, PERIOD), None
        end = time.monotonic() + 1.0
        with pytest.raises(StoppedError) as stopped:
            while time.monotonic() < end:
                rig.set_valves([1 * bar, 1 * bar])
                block = rig.read(1)
                if slow.delay and late is None:
                    late = block.time[-1]
                monitor.check_latency(rig.clock() - block.time[-1])
                slow.delay = 40 * ms * (time.monotonic() > end - 0.6)
        assert stopped.value.upper == LIMITS.late


@pytest.mark.parametrize("side", ["board", "host"])
@pytest.mark.parametrize("what", ["exchanged", "replayed"])
def test_frames_in_another_order_are_dropped_and_are_no_reset(line, side, what, monkeypatch):
    monkeypatch.setattr(SerialBackend, "patience", 1.0)  # a busy machine may take longer to write
    seen = []

    def order(at, frames):
        changed = []
        for frame in frames if at == side else ():
            seen.append(frame)
            every_tenth = len(seen) % 10 == 9
            if what == "replayed":  # not the vents at its opening: the board takes them at any time
                changed += [frame, seen[-8]] if every_tenth and len(seen) > 50 else [frame]
            elif not every_tenth:  # the ninth comes behind the tenth
                changed += [frame, seen[-2]] if len(seen) % 10 == 0 else [frame]
        return changed if at == side else frames

    rig = SerialBackend(line(order=order).port)
    with rig.opened():
        blocks = followed(rig, [1 * bar, 1 * bar], 1.0)
        assert blocks[-1].values[-1, 1] == pytest.approx(1 * bar)
        assert (np.diff(np.concatenate([block.time for block in blocks])) > 0).all()
    if side == "board":
        assert "repeated" in rig.losses


HOSTILE = {
    "no period": {"period": 0},
    "a period of hours": {"period": 2**32 - 1},
    "escapes in its name": {"firmware": "knee\x1b[2J"},
    "escapes in a channel": {"measurements": [("angle\x07", "rad"), *MEASURED[1:]]},
    "the same channel twice": {"measurements": [("angle", "rad"), ("angle", "rad"), ("pressure2", "Pa")]},
    "another unit": {"measurements": [("angle", "deg"), *MEASURED[1:]]},
    "a unit of its valves": {"commands": [("valve1", "bar"), ("valve2", "bar")]},
}


@pytest.mark.parametrize("what", HOSTILE)
def test_a_board_of_foreign_content_is_refused_with_what_to_check(board, what):
    there = board()
    there.hello = there.hello._replace(**HOSTILE[what])
    begun = time.monotonic()
    with pytest.raises(RigError) as refused:
        SerialBackend(there.port)
    assert refused.value.remedy and time.monotonic() - begun < 3 and str(refused.value).isprintable()


@pytest.mark.parametrize("part", ["state", "fault"])
def test_codes_that_are_unknown_vent_and_are_named(board, part):
    there = board()
    rig = SerialBackend(there.port)
    with rig.opened():
        followed(rig, [1 * bar, 1 * bar], 0.2)
        if part == "fault":
            there.vent(200)
        else:
            there.state = 77
        with pytest.raises(RigError) as stopped:
            followed(rig, [1 * bar, 1 * bar])
        assert stopped.value.remedy and ("200" in str(stopped.value) or part == "state")


def test_a_busy_host_does_not_blame_the_line(board):
    there = board()
    rig = SerialBackend(there.port)
    with rig.opened():
        rig.read(1)
        take = rig._received

        def paused():
            time.sleep(30 * ms)
            return take()

        rig._received = paused
        assert len(rig.read(1, timeout=20 * ms).time)
