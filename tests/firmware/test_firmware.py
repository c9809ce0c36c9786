"""Firmware with a simulated joint, on this computer and on an emulated Cortex-M7, and the syntax of its sketches."""

import os
import shutil
import subprocess
import tty
from pathlib import Path

import numpy as np
import pytest

from mckibben.codegen.native import compiler
from mckibben.errors import ExportError, ScenarioError
from mckibben.export import export
from mckibben.export.hardware import Hardware
from mckibben.scenario import Scenario
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

pytestmark = pytest.mark.skipif(compiler() is None or shutil.which("make") is None, reason="there is no cc or make")
HERE = Path(__file__).parent
EXAMPLE = "examples/pre-contracted-step-pid.yaml"
SCENARIO = Scenario.read(EXAMPLE).model_copy(update={"duration": 0.5})
CROSS = "-std=c99 -O2 -mcpu=cortex-m7 -mthumb -mfpu=fpv5-d16 -mfloat-abi=hard -specs=nosys.specs -nostartfiles".split()
CROSS += ["-Wl,--section-start=.vectors=0", "-Wl,-Ttext=0x2000", "-Wl,-Tdata=0x20000000", "-Wl,-e,reset"]
QEMU = "qemu-system-arm -M mps2-an500 -display none -monitor none -serial stdio -kernel firmware.elf".split()
SETPOINT = pack_numbers((0.0, 15.0))
ANALOG = "low_volts: 0.2, high_volts: 4.7, pressure: 7 bar"
PARTS = f"""
angle: {{sensor: as5600, zero: 12 deg}}
pressure1: {{pin: A0, {ANALOG}}}
pressure2: {{pin: A1, {ANALOG}}}
valve1: {{output: pwm, pin: "9", pressure: 8 bar}}
valve2: {{output: dac, pin: "10", pressure: 8 bar}}
vent: {{pin: "7", open: low}}
force: {{clock: "4", data: "5", zero: 8421, newtons_per_count: 0.01 N}}
single: true
"""


class Session:
    """A host that sends one message in each period of a firmware."""

    def __init__(self, command, folder, read, write, child):
        self.process = subprocess.Popen(command, cwd=folder, stdin=child[0], stdout=child[1], stderr=subprocess.DEVNULL)
        for end in set(child):
            os.close(end)
        self.read, self.write, self.receiver, self.count = read, write, Receiver(), 0
        self.others: list[Message] = []  # messages that are no samples

    def period(self, kind=MessageKind.HEARTBEAT, body=b"", *, damage=False):
        line = Message(kind, self.count, 1000 * self.count, body).encode()
        self.count += 1
        os.write(self.write, line[:1] + b"\x47" + line[2:] if damage else line)
        samples = []
        while not samples:
            messages = self.receiver.feed(os.read(self.read, 4096))
            samples = [Sample.unpack(message.body) for message in messages if message.kind == MessageKind.SAMPLE]
            self.others += [message for message in messages if message.kind != MessageKind.SAMPLE]
        return samples[-1]

    def arm(self, digest, source=CommandSource.SETPOINTS):
        return self.period(MessageKind.ARM, bytes([source]) + digest)

    def faults(self):
        """Codes of the faults since the last call."""
        codes = [FaultReport.unpack(m.body).code for m in self.others if m.kind == MessageKind.FAULT]
        self.others = []
        return codes


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("host")
    export(SCENARIO, "firmware", folder, hardware=Hardware(board="host"))
    subprocess.run(["make", "-s"], cwd=folder, check=True)
    return folder


@pytest.fixture
def digest(folder):
    return Scenario.read(folder / "scenario.yaml").digest


@pytest.fixture
def session(folder):
    """The firmware of this computer on a pseudo-terminal."""
    master, slave = os.openpty()
    tty.setraw(slave)
    opened = Session(["./firmware"], folder, master, master, (slave, slave))
    yield opened
    opened.process.kill()
    opened.process.wait()
    os.close(master)


def armed(session, digest):
    """Arm a joint that hangs still."""
    for _ in range(100):
        assert session.period().values[0] == pytest.approx(np.deg2rad(30), abs=1e-3)
    session.period(MessageKind.SETPOINT, SETPOINT)
    session.faults()
    return session.arm(digest)


def test_it_describes_itself_and_is_armed_by_its_own_host_only(session, digest):
    session.period(MessageKind.HELLO)
    hello = Hello.unpack(session.others[-1].body)
    assert (hello.period, hello.digest) == (1000, digest)
    assert hello.measurements == [("angle", "rad"), ("pressure1", "Pa"), ("pressure2", "Pa")]
    session.others = []
    session.arm(digest)  # without a setpoint
    session.period(MessageKind.SETPOINT, SETPOINT)
    session.arm(bytes(32))
    session.period(MessageKind.SETPOINT, SETPOINT[:-1])
    sample = session.period(99)
    assert session.faults() == [FaultCode.REFUSED, FaultCode.OTHER_DIGEST, FaultCode.REFUSED, FaultCode.REFUSED]
    assert (sample.state, sample.values[3:]) == (FirmwareState.DISARMED, (0, 0))


def test_it_reaches_the_setpoint_and_vents_when_asked(session, digest):
    assert armed(session, digest).state == FirmwareState.RAMPING
    samples = [session.period(MessageKind.SETPOINT, SETPOINT) for _ in range(4000)]
    commands = np.array([sample.values[3:] for sample in samples])
    steps = np.abs(np.diff(commands[:1500], axis=0))
    assert np.max(steps[:300]) < 1e3 and np.max(steps) < 3e4  # a ramp; then a muscle becomes taut
    assert samples[-1].state == FirmwareState.RUNNING
    assert abs(samples[-1].values[0]) < 1e-3
    sample = session.period(MessageKind.VENT)
    assert (sample.state, sample.values[3:], sample.fault) == (FirmwareState.VENTED, (0, 0), FaultCode.VENT_ASKED)
    session.period(MessageKind.SETPOINT, SETPOINT)
    assert session.arm(digest).state == FirmwareState.VENTED  # until it is disarmed
    assert session.period(MessageKind.DISARM).state == FirmwareState.DISARMED


def test_a_bad_setpoint_is_held_and_then_vented_for_good(session, digest):
    armed(session, digest)
    for _ in range(300):
        last = session.period(MessageKind.SETPOINT, SETPOINT)
    samples = [session.period(MessageKind.SETPOINT, pack_numbers((np.nan, 15.0))) for _ in range(100)]
    assert samples[0].state == FirmwareState.HOLDING and samples[0].values[3:] == last.values[3:]
    assert samples[60].state == FirmwareState.VENTED and samples[60].values[3:] == (0, 0)
    assert FaultCode.NOT_FINITE in session.faults()
    assert session.period(MessageKind.SETPOINT, SETPOINT).state == FirmwareState.VENTED


def test_a_sample_returns_the_number_of_the_last_message_that_was_heard(session):
    for number in range(5):
        assert session.period().heard == number
    assert session.period(damage=True).heard == 4
    assert session.period().heard == 6


def test_damaged_messages_are_counted_and_silence_vents(session, digest):
    armed(session, digest)
    before = session.period(MessageKind.SETPOINT, SETPOINT)
    for _ in range(90):
        assert session.period(damage=True).state != FirmwareState.VENTED
    after = session.period()
    assert (after.lost - before.lost, after.state != FirmwareState.VENTED) == (90, True)
    states = [session.period(damage=True).state for _ in range(120)]
    assert states.index(FirmwareState.VENTED) in range(95, 105)
    assert session.faults()[-1] == FaultCode.HOST_SILENT


def test_commands_of_the_host_are_limited(session, digest):
    for _ in range(2500):
        session.period(MessageKind.COMMAND, pack_numbers((1e5, 2e5), "f"))
    assert session.arm(digest, CommandSource.COMMANDS).values[3:] == (1e5, 2e5)
    assert session.period(MessageKind.COMMAND, pack_numbers((9e6, -1.0), "f")).values[3:] == (8e5, 0)
    assert session.period(MessageKind.COMMAND, pack_numbers((np.nan, 0.0), "f")).values[3:] == (8e5, 0)


def test_missing_commands_of_the_host_in_turn_vent(session, digest):
    """Every second bad command counts, one of three does not."""
    good, bad = pack_numbers((1e5, 2e5), "f"), pack_numbers((np.nan, 2e5), "f")
    for _ in range(100):
        session.period(MessageKind.COMMAND, good)
    session.arm(digest, CommandSource.COMMANDS)
    seldom = [session.period(MessageKind.COMMAND, bad if k % 3 == 0 else good).state for k in range(300)]
    assert FirmwareState.VENTED not in seldom and FirmwareState.HOLDING in seldom
    often = [session.period(MessageKind.COMMAND, bad if k % 2 == 0 else good).state for k in range(120)]
    assert often.index(FirmwareState.VENTED) in range(90, 110) and often[-1] == FirmwareState.VENTED


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("arm-none-eabi-gcc") is None, reason="there is no arm-none-eabi-gcc")
@pytest.mark.skipif(shutil.which(QEMU[0]) is None, reason="no qemu-system-arm")
def test_an_emulated_cortex_m7_does_the_same(session, folder, digest):
    shutil.copy(HERE / "qemu.c", folder)
    sources = "qemu.c simulated.c firmware.c link.c controller.c plant.c -o firmware.elf -lm".split()
    subprocess.run(["arm-none-eabi-gcc", *CROSS, *sources], cwd=folder, check=True, capture_output=True)
    (child_in, write), (read, child_out) = os.pipe(), os.pipe()
    limited = ["sh", "-c", 'ulimit -t 120; exec "$@"', "sh", *QEMU]  # an emulator without a host runs at full speed
    emulated = Session(limited, folder, read, write, (child_in, child_out))
    try:
        for number in range(400):
            kind = {100: MessageKind.SETPOINT, 101: MessageKind.ARM}.get(number, MessageKind.HEARTBEAT)
            body = {100: SETPOINT, 101: b"\0" + digest}.get(number, b"")
            found, expected = emulated.period(kind, body), session.period(kind, body)
            assert found[:6] == expected[:6]
            assert found.values == pytest.approx(expected.values, rel=1e-6, abs=1e-6)
        assert found.values[3] > 0
    finally:
        emulated.process.kill()
        emulated.process.wait()


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("g++") is None, reason="there is no g++")
@pytest.mark.parametrize(
    ("board", "angle"), [("uno_r4", "as5600"), ("teensy4", "quadrature"), ("esp32", "as5600"), ("stm32", "quadrature")]
)
def test_sketches_are_valid_with_declarations_of_the_core(board, angle, tmp_path):
    """Against declarations written by hand: the cores themselves were not at hand."""
    hardware = Hardware.parse(f"board: {board}\n{PARTS.replace('as5600', angle)}")
    export(Scenario.read("examples/pre-contracted-step-pid.yaml"), "firmware", tmp_path, name="knee", hardware=hardware)
    for header in ("Wire", "FspTimer", "WDT", "esp_system", "esp_task_wdt", "IWatchdog"):
        (tmp_path / f"{header}.h").touch()
    options = [
        "-std=gnu++17",
        "-Wall",
        "-Wextra",
        "-Werror",
        f"-I{HERE}",
        f"-I{tmp_path}",
        "-fsyntax-only",
        "-x",
        "c++",
    ]
    subprocess.run(["g++", *options, "knee.ino"], cwd=tmp_path / "knee", check=True)


def test_the_digest_is_the_same_from_any_folder(tmp_path, monkeypatch):
    (tmp_path / "angle.csv").write_text("time_s,angle_deg\n0,0\n20,5\n", encoding="utf-8")
    sine = "{class: sine, amplitude: 10 deg, frequency: 0.5 Hz}"
    text = Path(EXAMPLE).read_text(encoding="utf-8").replace(sine, "{class: samples_file, file: angle.csv}")
    (tmp_path / "scenario.yaml").write_text(text, encoding="utf-8")
    scenario = Scenario.read(tmp_path / "scenario.yaml")
    digest = scenario.digest
    scenario.to_yaml(tmp_path / "firmware.yaml")
    monkeypatch.chdir(tmp_path)
    assert digest == scenario.digest == Scenario.read("firmware.yaml").digest != SCENARIO.digest


def test_a_missing_part_is_asked_for(tmp_path):
    scenario = Scenario.read("examples/pre-contracted-step-pid.yaml")
    for text, field in ((PARTS, "board"), (f"board: esp32\n{PARTS}".replace("vent:", "#"), "vent")):
        with pytest.raises(ExportError) as caught:
            export(scenario, "firmware", tmp_path / "out", hardware=Hardware.parse(text))
        assert caught.value.field == field
    with pytest.raises(ExportError) as caught:
        export(scenario, "firmware", tmp_path / "out")
    assert caught.value.field == "hardware"
    with pytest.raises(ScenarioError):
        Hardware.parse(f"board: esp32\n{PARTS}".replace("A0", "A0); system(1"))
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_a_spring_in_place_of_a_muscle_needs_neither_sensor_nor_valve(tmp_path):
    scenario = Scenario.read("examples/setups/spring.yaml")
    parts = "\n".join(line for line in PARTS.splitlines() if not line.startswith(("pressure1", "valve1")))
    export(scenario, "firmware", tmp_path / "esp32", hardware=Hardware.parse(f"board: esp32\n{parts}"))
    export(scenario, "firmware", tmp_path, hardware=Hardware(board="host"))
    subprocess.run(["make", "-s"], cwd=tmp_path, check=True)
    master, slave = os.openpty()
    tty.setraw(slave)
    session = Session(["./firmware"], tmp_path, master, master, (slave, slave))
    try:
        session.period(MessageKind.SETPOINT, pack_numbers((0.0, 11.5)))
        session.arm(Scenario.read(tmp_path / "scenario.yaml").digest)
        samples = [session.period(MessageKind.SETPOINT, pack_numbers((0.0, 11.5))) for _ in range(2000)]
        assert samples[-1].state == FirmwareState.RUNNING
        assert samples[-1].values[3] == 0 < samples[-1].values[4] and abs(samples[-1].values[0]) < 0.05
    finally:
        session.process.kill()
        session.process.wait()
        os.close(master)
