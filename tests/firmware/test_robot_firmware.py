"""Firmware of robots: channels by name, commands of all muscles, and a vent of all for a fault of one."""

import os
import re
import shutil
import subprocess
import tty

import numpy as np
import pytest

from mckibben.codegen.native import compiler
from mckibben.errors import ExportError
from mckibben.export import export
from mckibben.export.firmware import BoardParts
from mckibben.export.hardware import Hardware
from mckibben.rig.channels import Channels
from mckibben.robot import RobotScenario
from mckibben.serial_protocol import CommandSource, FaultCode, FirmwareState, Hello, MessageKind, pack_numbers
from tests.export.test_robot_controller import MANY
from tests.firmware.test_firmware import ANALOG, HERE, Session
from tests.robot.test_control import ONE, TORQUE, TWO

JOINTS, MUSCLES = ("hip", "knee"), ("hip1", "hip2", "knee1", "knee2")
needs_compiler = pytest.mark.skipif(compiler() is None or shutil.which("make") is None, reason="there is no cc or make")


def parts(sensors, *, left_out=""):
    """Hardware file of the leg."""
    angles = "\n".join(f"  {name}: {sensor}" for name, sensor in zip(JOINTS, sensors, strict=True))
    pressures = "\n".join(f"  {name}: {{pin: A{k}, {ANALOG}}}" for k, name in enumerate(MUSCLES) if name != left_out)
    valves = "\n".join(f'  {name}: {{output: pwm, pin: "{k}", pressure: 8 bar}}' for k, name in enumerate(MUSCLES))
    return f"angles:\n{angles}\npressures:\n{pressures}\nvalves:\n{valves}\nvent: {{pin: '40', open: low}}\n"


MULTIPLEXED = [f"{{sensor: as5600, channel: {k}}}" for k in range(2)]
ENCODERS = [f'{{sensor: quadrature, pin_a: "{20 + 2 * k}", pin_b: "{21 + 2 * k}"}}' for k in range(2)]


@pytest.fixture
def running(request, tmp_path):
    """The firmware of a robot on this computer, its digest and its description."""
    text = TWO if request.param == "leg" else ONE.replace("valve:", MANY + "valve:") + TORQUE
    export(RobotScenario.parse(text).replace(duration=0.2), "firmware", tmp_path, hardware=Hardware(board="host"))
    subprocess.run(["make", "-s"], cwd=tmp_path, check=True)
    master, slave = os.openpty()
    tty.setraw(slave)
    session = Session(["./firmware"], tmp_path, master, master, (slave, slave))
    bodies = []
    while not (bodies and Hello.is_whole(*bodies)):
        session.period(MessageKind.HELLO, bytes([len(bodies)]) if bodies else b"")
        wanted = MessageKind.CHANNELS if bodies else MessageKind.HELLO
        bodies += [message.body for message in session.others if message.kind == wanted][-1:]
        session.others = []
    yield session, RobotScenario.read(tmp_path / "scenario.yaml"), Hello.unpack(*bodies)
    session.process.kill()
    session.process.wait()
    os.close(master)


@needs_compiler
@pytest.mark.slow
@pytest.mark.parametrize("running", ["leg"], indirect=True)
def test_the_leg_reaches_its_setpoints_and_a_bad_one_of_one_joint_vents_all(running):
    session, scenario, hello = running
    assert hello.digest == scenario.digest
    assert [name for name, _ in hello.measurements] == [*Channels.of(scenario).readings]
    assert hello.setpoints[2] == ("stiffness.hip", "N*m/rad")
    setpoint = pack_numbers((0.05, 0.1, 15.0, 15.0))
    session.period(MessageKind.SETPOINT, setpoint)
    session.arm(hello.digest)
    samples = [session.period(MessageKind.SETPOINT, setpoint) for _ in range(2500)]
    assert samples[-1].state == FirmwareState.RUNNING
    np.testing.assert_allclose(samples[-1].values[:2], (0.05, 0.1), atol=2e-3)
    assert min(samples[-1].values[6:]) > 1e4
    bad = pack_numbers((np.nan, 0.1, 15.0, 15.0))
    samples = [session.period(MessageKind.SETPOINT, bad) for _ in range(60)]
    assert samples[0].state == FirmwareState.HOLDING and samples[-1].state == FirmwareState.VENTED
    assert samples[-1].values[6:] == (0,) * 4 and FaultCode.NOT_FINITE in session.faults()


@needs_compiler
@pytest.mark.slow
@pytest.mark.parametrize("running", ["many"], indirect=True)
def test_twelve_muscles_keep_their_order_and_a_bad_command_of_one_vents_all(running, tmp_path):
    session, scenario, hello = running
    structure = re.search(r"typedef struct \{([^}]*)\} controller_commands;", (tmp_path / "controller.h").read_text())
    assert re.findall(r"pressure\d+", structure[1]) == [f"pressure{number}" for number in range(1, 13)]
    assert [name for name, _ in hello.commands] == [f"valve.{muscle}" for muscle in scenario.muscle_names]
    asked = [1e3 * number for number in range(12)]
    session.period(MessageKind.COMMAND, pack_numbers(asked, "f"))
    session.arm(hello.digest, CommandSource.COMMANDS)
    sample = session.period(MessageKind.COMMAND, pack_numbers(asked, "f"))
    assert sample.values[-12:] == pytest.approx(asked)
    high = session.period(MessageKind.COMMAND, pack_numbers([9e6, *asked[1:]], "f"))
    assert high.values[-12:] == pytest.approx([8e5, *asked[1:]])
    for _ in range(60):
        sample = session.period(MessageKind.COMMAND, pack_numbers([*asked[:-1], np.inf], "f"))
    assert sample.state == FirmwareState.VENTED and sample.values[-12:] == (0,) * 12
    session.period(MessageKind.COMMAND, pack_numbers(asked[:-1], "f"))
    assert session.faults()[-1] == FaultCode.REFUSED


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("g++") is None, reason="there is no g++")
@pytest.mark.parametrize(("board", "sensors"), [("teensy4", MULTIPLEXED), ("stm32", ENCODERS)])
def test_the_sketch_of_the_leg_is_valid(board, sensors, tmp_path):
    hardware = Hardware.parse(f"board: {board}\n{parts(sensors)}")
    export(RobotScenario.parse(TWO).replace(duration=0.1), "firmware", tmp_path, name="leg", hardware=hardware)
    for header in ("Wire", "IWatchdog"):
        (tmp_path / f"{header}.h").touch()
    options = ["-std=gnu++17", "-Wall", "-Wextra", "-Werror", f"-I{HERE}", f"-I{tmp_path}", "-fsyntax-only"]
    subprocess.run(["g++", *options, "-x", "c++", "leg.ino"], cwd=tmp_path / "leg", check=True)
    sketch = (tmp_path / "leg" / "leg.ino").read_text()
    assert ("Wire.write(1 << 1)" in sketch) == (sensors is MULTIPLEXED)
    assert "values[2] = pressure(A0" in sketch and "set_output(false, 3" in sketch


@pytest.mark.parametrize(
    ("text", "field"),
    [
        (parts(ENCODERS, left_out="hip2"), "pressures.hip2"),
        (parts(["{sensor: as5600}"] * 2), "channel"),
        (parts([MULTIPLEXED[0]] * 2), "channel"),
        (parts(ENCODERS).replace("  hip1: {pin", "  ankle1: {pin"), "pressures.ankle1"),
        (parts(ENCODERS) + "angle: {sensor: as5600}\n", "angle"),
        (parts(ENCODERS).replace("vent:", "force: {clock: '1', data: '2', newtons_per_count: 1 N} #"), "vent"),
    ],
)
def test_parts_that_are_missing_left_over_or_at_one_address_are_refused(text, field):
    names, air = Channels(tuple(f".{name}" for name in JOINTS), tuple(f".{name}" for name in MUSCLES)), [True] * 4
    with pytest.raises(ExportError) as caught:
        BoardParts.of(Hardware.parse(f"board: teensy4\n{text}"), names, air)
    assert caught.value.field == field and caught.value.remedy
    with pytest.raises(ExportError) as caught:
        BoardParts.of(Hardware.parse(f"board: teensy4\n{parts(ENCODERS)}"), Channels(), [True, True])
    assert caught.value.field.startswith("angles.")
