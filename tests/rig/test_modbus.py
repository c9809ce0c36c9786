"""A rig on a terminal: a server of pymodbus in this process, which may stall."""

import asyncio
import dataclasses
import json
import logging
import struct
import threading
import time

import numpy as np
import pytest

from mckibben.errors import RigError, ScenarioError, SilentError
from mckibben.rig.control_loop import RunPlan, control
from mckibben.rig.modbus import ModbusBackend, RegisterMap
from mckibben.units import bar
from tests.rig.joint.conftest import LIMITS, Kept, SteadyControl
from tests.rig.terminal import FaultyTerminal

pymodbus = pytest.importorskip("pymodbus", reason="needs the extra rig")

MAP = """host: 127.0.0.1
port: {port}
rate: 200
patience: 0.5
inputs:
  angle: {{address: 0, kind: holding, type: float32, gain: 1.0, unit: rad, low: -3, high: 3}}
  pressure1: {{address: 2, gain: 100, unit: Pa, low: -50000, high: 1000000}}
  pressure2: {{address: 3, gain: 100, offset: -100, unit: Pa, low: -50000, high: 1000000}}
outputs:
  valve1: {{address: 2, type: uint16, gain: 100, unit: Pa, low: 0, high: 900000}}
  valve2: {{address: 3, type: uint16, gain: 100, offset: -100, unit: Pa, low: 0, high: 900000}}
"""


class Terminal:
    """Registers of a terminal whose measured pressures are its commands."""

    def __init__(self):
        from pymodbus.datastore import ModbusDeviceContext, ModbusSequentialDataBlock, ModbusServerContext

        self.stalls = 0.0
        self.block = ModbusSequentialDataBlock(1, [0] * 10)
        self.context = ModbusServerContext(devices=ModbusDeviceContext(hr=self.block), single=True)
        self.ready, self.server, self.loop = threading.Event(), None, None
        self.thread = threading.Thread(target=lambda: asyncio.run(self.serve()))
        self.thread.start()
        assert self.ready.wait(10)

    async def serve(self):
        from pymodbus.server import ModbusTcpServer

        def trace(sending, data):
            if self.stalls and not sending:
                time.sleep(self.stalls)
            return data

        self.server = ModbusTcpServer(self.context, address=("127.0.0.1", 0), trace_packet=trace)
        self.loop = asyncio.get_running_loop()
        await self.server.serve_forever(background=True)
        self.port = self.server.transport.sockets[0].getsockname()[1]
        self.done = asyncio.Event()
        self.ready.set()
        await self.done.wait()
        await self.server.shutdown()

    def close(self):
        self.stalls = 0.0
        self.loop.call_soon_threadsafe(self.done.set)
        self.thread.join()


@pytest.fixture
def terminal():
    there = Terminal()
    yield there
    there.close()


def test_commands_go_out_and_readings_come_in(terminal):
    rig = ModbusBackend(RegisterMap.parse(MAP.format(port=terminal.port)))
    with rig.opened():
        assert [channel.name for channel in rig.inputs] == ["angle", "pressure1", "pressure2"]
        rig.set_valves([1 * bar, 2.5 * bar])
        block = rig.read(20)
        assert block.values[-1] == pytest.approx([0.0, 1 * bar, 2.5 * bar])
        assert block.time[-1] - block.time[0] == pytest.approx(19 / 200, abs=0.05)
        rig.vent()
        assert rig.read(1).values[0, 1:] == pytest.approx([0.0, 0.0])
        rig.set_valves([20 * bar, 0.0])
        assert rig.read(1).values[0, 1] == pytest.approx(9 * bar)  # the highest command
    with pytest.raises(RigError):
        rig.read(1)


def test_a_terminal_that_stalls_is_named(terminal):
    rig = ModbusBackend(RegisterMap.parse(MAP.format(port=terminal.port)))
    with rig.opened():
        terminal.stalls = 0.8
        with pytest.raises(SilentError) as silent:
            rig.read(5)
        assert silent.value.field == "angle" and silent.value.remedy
        terminal.stalls = 0.0


def test_no_terminal_and_no_register_are_named(terminal):
    with pytest.raises(RigError) as refused:
        ModbusBackend(RegisterMap.parse(MAP.format(port=1))).open()
    assert refused.value.field == "host"
    text = MAP.format(port=terminal.port).replace("address: 3, gain: 100, offset", "address: 300, gain: 100, offset")
    with pytest.raises(RigError) as refused:
        ModbusBackend(RegisterMap.parse(text)).open()
    assert refused.value.field == "pressure2"


SPLIT = """host: 127.0.0.1
port: {port}
rate: 200
patience: 0.4
inputs:
  angle: {{address: 0, kind: input, type: float32, gain: 1.0, unit: rad, low: -3, high: 3}}
  pressure1: {{address: 2, kind: input, gain: 100, unit: Pa, low: -50000, high: 1000000}}
  pressure2: {{address: 3, kind: input, gain: 100, unit: Pa, low: -50000, high: 1000000}}
outputs:
  valve1: {{address: 10, type: uint16, gain: 100, unit: Pa, low: 0, high: 900000}}
  valve2: {{address: 11, type: uint16, gain: 100, unit: Pa, low: 0, high: 900000}}
"""
FAULTS = {
    "lost": lambda reply: None,
    "late": lambda reply: time.sleep(0.3) or reply,
    "partial": lambda reply: reply[:2],
    "foreign": lambda reply: b"\x03\x02\x00\x00",
    "too many": lambda reply: reply[:3] + b"\x00\x02",
    "refused": lambda reply: bytes([reply[0] | 0x80, 4]),
}


@pytest.fixture
def faulty():
    there = FaultyTerminal()
    yield there
    there.close()


def opened(there, old="", new=""):
    rig = ModbusBackend(RegisterMap.parse(SPLIT.format(port=there.port).replace(old, new)))
    rig.open()
    return rig


@pytest.mark.parametrize("broken", [10, 11])
@pytest.mark.parametrize("fault", FAULTS)
def test_a_valve_whose_reply_is_wrong_holds_up_no_other_one(faulty, fault, broken):
    """The write is executed each time: only its reply is wrong."""
    rig = opened(faulty)
    rig.set_valves([5 * bar, 5 * bar])
    faulty.fault = lambda function, address, reply: (
        FAULTS[fault](reply) if (function, address) == (16, broken) else reply
    )
    begun = time.monotonic()
    rig.vent()
    assert faulty.registers[10:12] == [0, 0] and time.monotonic() - begun < 1.0
    faulty.fault = lambda function, address, reply: reply
    assert rig.read(1).values.shape == (1, 3) and not rig.losses  # the valves read back 0
    rig.close()


@pytest.mark.parametrize("readable", [True, False])
def test_after_a_vent_that_is_not_confirmed_nothing_more_is_sent(faulty, readable):
    if not readable:
        faulty.unreadable = {10, 11}
    rig = opened(faulty)
    faulty.refused = {(10, 0)}  # also where a host that stood still vents by itself
    rig.set_valves([5 * bar, 5 * bar])
    begun = time.monotonic()
    rig.vent()
    assert faulty.registers[10:12] == [5000, 0]
    assert "valve1" in rig.losses and "valve2" not in rig.losses
    requests = len(faulty.heard)
    for act in (lambda: rig.read(1), lambda: rig.set_valves([0.0, 0.0])):
        with pytest.raises(SilentError) as silent:
            act()
        assert silent.value.remedy
    rig.heartbeat()
    rig.vent()
    rig.close()
    time.sleep(0.1)
    assert len(faulty.heard) == requests and faulty.heard[-1] - begun < 1.0  # then its watchdog vents
    faulty.refused = set()
    rig.open()  # and it can be used again
    assert rig.read(1).values.shape == (1, 3)
    rig.close()


def test_a_dead_line_is_tried_no_longer_than_the_patience(faulty):
    rig = opened(faulty)
    rig.set_valves([5 * bar, 5 * bar])
    faulty.fault = lambda function, address, reply: None
    begun = time.monotonic()
    rig.vent()
    assert time.monotonic() - begun < 0.4 + 0.2 and rig.losses and faulty.registers[10:12] == [0, 0]


def test_a_run_whose_valve_refuses_its_commands_ends_in_silence(faulty):
    """So that the watchdog of the terminal vents: 5 s of reading held it off."""

    def follow(function, address, reply):
        faulty.registers[2:4] = faulty.registers[10:12]
        if faulty.registers[10] > 2000:
            faulty.refused = {10}
        return reply

    faulty.fault = follow
    rig = ModbusBackend(RegisterMap.parse(SPLIT.format(port=faulty.port)))
    pressures = (0.0, 8 * bar), (0.0, 8 * bar)
    plan = RunPlan(np.zeros((200, 2)), 1 / 200, 100, 20, (3 * bar, 3 * bar), pressures)
    limits = dataclasses.replace(LIMITS, silence=1.0, late=1.0)  # on a busy machine
    outcome = control(rig, SteadyControl(), plan, limits, kept := Kept())
    ended = time.monotonic()
    assert outcome.kind == "rig" and outcome.error.field == "valve1" and outcome.remaining is None
    assert "valve1" in dict(kept.events)["losses"] and faulty.registers[11] == 0
    time.sleep(0.1)
    assert faulty.heard[-1] < ended and ended - faulty.heard[-1] < 0.5


@pytest.mark.parametrize("fault", [fault for fault in FAULTS if fault not in ("refused", "too many")])
def test_a_read_ends_within_its_timeout(faulty, fault):
    rig = opened(faulty)
    rig.read(1)
    faulty.fault = lambda function, address, reply: FAULTS[fault](reply)
    begun = time.monotonic()
    with pytest.raises(RigError):
        rig.read(1, timeout=0.02)
    assert time.monotonic() - begun < 0.15
    begun = time.monotonic()
    with pytest.raises(RigError):
        rig.set_valves([1 * bar, 1 * bar])
    assert time.monotonic() - begun < 0.15
    faulty.fault = lambda function, address, reply: reply
    rig.close()


def test_replies_of_another_size_are_named(faulty):
    rig = opened(faulty)
    faulty.fault = lambda function, address, reply: bytes([reply[0], reply[1] + 2]) + reply[2:] + b"\0\0"
    with pytest.raises(RigError) as refused:
        rig.read(1)
    assert refused.value.field == "angle" and refused.value.remedy
    faulty.fault = lambda function, address, reply: reply
    rig.close()


def changed(section, name, **changes):
    """Text of the map with changes of a register, as JSON, which is YAML."""
    registers = RegisterMap.parse(SPLIT.format(port=1)).model_dump(mode="json", exclude_none=True)
    registers[section][name] |= changes
    return json.dumps(registers, indent=1)


@pytest.mark.parametrize(
    ("section", "name", "changes", "field"),
    [
        ("outputs", "valve1", {"type": "int16", "gain": 10}, "type"),  # 9 bar are 90,000 counts
        ("outputs", "valve1", {"offset": 5000}, "type"),  # 0 Pa is -50 counts
        ("outputs", "valve1", {"gain": -100}, "type"),
        ("outputs", "valve1", {"kind": "input"}, "kind"),
        ("outputs", "valve2", {"address": 10}, "address"),
        ("outputs", "valve2", {"address": 9, "type": "uint32", "word_order": "little"}, "address"),
        ("outputs", "valve1", {"low": 20000}, "low"),  # nothing vents it
        ("outputs", "valve1", {"low": 900000, "high": 0}, "low"),
        ("outputs", "valve1", {"address": 20, "type": "uint32", "offset": -100}, "type"),  # 0 Pa is 1 count, or 65,536
        ("outputs", "valve2", {"address": 65536}, "address"),
        ("inputs", "pressure1", {"address": 1}, "address"),  # the second word of the angle
        ("inputs", "pressure1", {"gain": 10}, "type"),  # it would never read more than 3.3 bar
        ("inputs", "pressure1", {"type": "uint16"}, "type"),
        ("inputs", "pressure1", {"low": "-.inf"}, "low"),
    ],
)
def test_a_wrong_map_is_refused_before_a_connection(section, name, changes, field):
    with pytest.raises(ScenarioError) as refused:
        RegisterMap.parse(changed(section, name, **changes))
    (problem,) = refused.value.problems
    assert problem.field.startswith(section) and problem.field.endswith(field) and problem.line


def test_a_map_with_several_mistakes_names_them_all():
    text = changed("outputs", "valve1", kind="input").replace('"type": "int16"', '"type": "uint16"')
    with pytest.raises(ScenarioError) as refused:
        RegisterMap.parse(text)
    fields = {problem.field for problem in refused.value.problems}
    assert fields == {"inputs.pressure1.type", "inputs.pressure2.type", "outputs.valve1.kind"}


@pytest.mark.parametrize("number", [0.123, 0.5, -1.75])  # 0.5 has a word of zeros: exchanged it is 2e-41
@pytest.mark.parametrize("order", ["big", "little"])
def test_words_in_the_other_order_are_named(faulty, number, order):
    words = struct.unpack(">2H", struct.pack(">f", number))
    faulty.registers[0:2] = words if order == "big" else words[::-1]
    other = "little" if order == "big" else "big"
    with pytest.raises(RigError) as refused:
        opened(faulty, "type: float32", f"type: float32, word_order: {other}")
    assert refused.value.field == "angle" and f"word_order: {order}" in refused.value.remedy
    rig = opened(faulty, "type: float32", f"type: float32, word_order: {order}")
    assert rig.read(1).values[0, 0] == pytest.approx(number)
    rig.close()


@pytest.mark.parametrize("order", ["big", "little"])
def test_commands_of_two_words_have_the_stated_order(faulty, order):
    rig = opened(faulty, "address: 11, type: uint16", f"address: 12, type: uint32, word_order: {order}")
    rig.set_valves([0.0, 5 * bar])
    assert faulty.registers[12:14] == ([0, 5000] if order == "big" else [5000, 0])
    rig.close()
    assert faulty.registers[10:14] == [0] * 4


@pytest.mark.parametrize(("angle", "known"), [(0.123, True), (0.0, False)])
def test_the_order_of_commands_is_that_of_readings_or_asked_for(faulty, angle, known):
    faulty.registers[0:2] = struct.unpack(">2H", struct.pack(">f", angle))
    text = SPLIT.replace("address: 11, type: uint16", "address: 12, type: uint32").format(port=faulty.port)
    rig = ModbusBackend(RegisterMap.parse(text))
    if known:
        with rig.opened():
            rig.set_valves([0.0, 5 * bar])
            assert faulty.registers[12:14] == [0, 5000]
    else:
        with pytest.raises(RigError) as refused, rig.opened():
            pass
        assert refused.value.field == "valve2" and "word_order" in refused.value.remedy


def test_an_output_that_reads_back_elsewhere_is_asked_for(faulty):
    """As on terminals that have the images of inputs and outputs at the same addresses."""
    faulty.answered = lambda request, answered=faulty.answered: (
        (3, request[2], b"4") if request[0] == 3 and request[2] in (10, 11) else answered(request)
    )
    with pytest.raises(RigError) as refused:
        opened(faulty)
    assert refused.value.field == "valve1" and "readback" in refused.value.remedy
    text = SPLIT.replace("address: 10,", "address: 10, readback: 20,").replace("11,", "11, readback: 21,")
    rig = ModbusBackend(RegisterMap.parse(text.format(port=faulty.port)))
    with rig.opened():
        rig.set_valves([5 * bar, 0.0])
        rig.vent()
        assert not rig.losses
        faulty.registers[20] = 5000
        rig.vent()
        assert "valve1" in rig.losses


@pytest.mark.parametrize(("section", "name", "unit"), [("inputs", "angle", "deg"), ("outputs", "valve1", "bar")])
def test_channels_in_other_units_are_refused(faulty, section, name, unit):
    registers = json.loads(changed(section, name, unit=unit)) | {"port": faulty.port}
    rig = ModbusBackend(RegisterMap.parse(json.dumps(registers)))
    with pytest.raises(RigError) as refused, rig.opened():
        pass
    assert refused.value.field == name and refused.value.remedy


def test_the_status_names_an_input_that_reads_a_command(faulty, terminal):
    right = ModbusBackend(RegisterMap.parse(SPLIT.format(port=faulty.port)))
    assert not [row for row in right.status() if row.problem]
    wrong = ModbusBackend(RegisterMap.parse(MAP.format(port=terminal.port)))
    assert [row.name for row in wrong.status() if row.problem] == ["pressure1", "pressure2"]


def test_remarks_of_the_library_stay_off_the_terminal(faulty, capsys, monkeypatch):
    rig = opened(faulty)
    monkeypatch.setattr(logging.getLogger(), "handlers", [])  # as without pytest
    faulty.fault = lambda function, address, reply: time.sleep(0.1) or reply
    for _ in range(3):
        with pytest.raises(RigError):
            rig.read(1, timeout=0.02)
    faulty.fault = lambda function, address, reply: reply
    rig.close()
    assert capsys.readouterr().err == ""
