"""A rig on a terminal: a server of pymodbus in this process, which may stall."""

import asyncio
import threading
import time

import pytest

from mckibben.errors import RigError, ScenarioError, SilentError
from mckibben.rig.modbus import ModbusBackend, RegisterMap
from mckibben.units import bar

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


def test_all_mistakes_of_a_map_are_told_at_once():
    with pytest.raises(ScenarioError) as refused:
        RegisterMap.parse("host: 1.2.3.4\nrate: 0\ninputs: {force: {address: -1, gain: 1, unit: N, low: 0, high: 9}}\n")
    assert {problem.field for problem in refused.value.problems} == {"rate", "inputs.force.address", "outputs"}
