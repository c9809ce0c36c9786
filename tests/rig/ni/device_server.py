# ruff: noqa: E501 - tables of cases
"""A card in this process: the NI gRPC Device Server's calls for NI-DAQmx, in front of a simulated rig.

The real `nidaqmx` package talks to it over gRPC, as it does to a card on another machine. It does what the driver's
manual says of the calls that a rig needs, refuses in the driver's way what a card would refuse, and does nothing else:
a call that is not here fails as unimplemented.
"""

# ruff: noqa: N802 - the names are the service's

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent import futures
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest

from mckibben.errors import RigError, SilentError
from mckibben.rig import ni
from mckibben.units import bar, deg

grpc = pytest.importorskip("grpc", reason="needs the extra daq")
messages = pytest.importorskip("nidaqmx._stubs.nidaqmx_pb2", reason="needs the extra daq")
service = pytest.importorskip("nidaqmx._stubs.nidaqmx_pb2_grpc", reason="needs the extra daq")

INPUTS, OUTPUTS = ("Dev1/ai0", "Dev1/ai1"), ("Dev1/ao0",)
LINES = [f"Dev1/port0/line{k}" for k in range(8)]
HEARTBEAT, HOLD = LINES[:2]
CONTINUOUS = 10123
TIMEOUT, OVERWRITTEN, NO_DEVICE, NO_CHANNEL, RESERVED, GONE = -200284, -200279, -200220, -200170, -50103, -88709


BENCH = {
    "force": ni.Terminal(terminal="ai0", unit="N", gain=200.0, low=-2000.0, high=2000.0),
    "pressure": ni.Terminal(terminal="ai1", unit="Pa", gain=1 * bar, low=-0.2 * bar, high=10 * bar),
    "valve": ni.Terminal(terminal="ao0", unit="Pa", gain=0.9 * bar, low=0.0, high=9 * bar),
}
KNEE = {
    "angle": ni.Terminal(terminal="ai0", unit="rad", gain=36 * deg, offset=-180 * deg, low=-176.8 * deg, high=3.0),
    **{f"pressure{i}": ni.Terminal(terminal=f"ai{i}", unit="Pa", gain=2.5 * bar, offset=-2.5 * bar, low=-0.5 * bar, high=10.2 * bar) for i in (1, 2)},
    **{f"valve{i}": ni.Terminal(terminal=f"ao{i - 1}", unit="Pa", gain=0.9 * bar, low=0.0, high=9 * bar) for i in (1, 2)},
}  # fmt: skip


def wired(server: str, known: Mapping[str, ni.Terminal] = BENCH, **fields: Any) -> ni.Card:
    """A card with these channels."""
    inputs = {name: terminal for name, terminal in known.items() if not name.startswith("valve")}
    outputs = {name: terminal for name, terminal in known.items() if name.startswith("valve")}
    return ni.Card(**{"server": server, "inputs": inputs, "outputs": outputs, "patience": 1.0} | fields)


@dataclass
class Task:
    kind: str = ""
    channels: list[str] = field(default_factory=list)
    rate: float = 0.0
    started: bool = False


class RefusedError(Exception):
    def __init__(self, code: int, text: str) -> None:
        super().__init__(text)
        self.code = code


class Card(service.NiDAQmxServicer):
    """A PCI-6281 with a simulated rig at its terminals, and the relay that watches its heartbeat."""

    def __init__(
        self,
        twin: Any,
        inputs: Sequence[str] = INPUTS,
        outputs: Sequence[str] = OUTPUTS,
        channels: Mapping[str, ni.Terminal] | None = None,
    ) -> None:
        self.twin = twin
        known = BENCH if channels is None else channels
        self.sensors = [known[channel.name] for channel in twin.inputs]
        self.regulators = [known[channel.name] for channel in twin.outputs]
        self.inputs, self.outputs = list(inputs), list(outputs)
        self.tasks: dict[str, Task] = {}
        self.lines = dict.fromkeys(LINES, False)
        self.valves = [0.0] * len(self.outputs)
        self.beats = 0
        self.reads = 0
        self.unplugged = False
        self.samples = 1000.0

    def __getattribute__(self, name: str) -> Any:
        """Each call of the service, with its errors as the device server sends them."""
        attribute = super().__getattribute__(name)
        if not name[0].isupper():
            return attribute

        def called(request: Any, context: grpc.ServicerContext) -> Any:
            try:
                if self.unplugged:
                    raise RefusedError(GONE, "The specified device is not present or is not active in the system.")
                return attribute(request, context)
            except RefusedError as refused:
                context.set_trailing_metadata((("ni-error", str(refused.code)),))
                context.abort(grpc.StatusCode.UNKNOWN, f"{refused}\n\nStatus Code: {refused.code}")

        return called

    # Tasks

    def CreateTask(self, request: Any, context: Any) -> Any:
        name = f"task{len(self.tasks)}"
        self.tasks[name] = Task()
        return messages.CreateTaskResponse(task={"name": name}, new_session_initialized=True)

    def ClearTask(self, request: Any, context: Any) -> Any:
        task = self.tasks.get(request.task.name)
        if task is not None:
            self._halt(task)
            task.kind = "cleared"
        return messages.ClearTaskResponse()

    def StartTask(self, request: Any, context: Any) -> Any:
        task = self._task(request)
        task.started = True
        if task.kind == "ai":
            self.twin.open()
        return messages.StartTaskResponse()

    def StopTask(self, request: Any, context: Any) -> Any:
        self._halt(self._task(request))
        return messages.StopTaskResponse()

    def _task(self, request: Any) -> Task:
        return self.tasks[request.task.name]

    def _halt(self, task: Task) -> None:
        if task.started and task.kind == "ai":
            self.twin.close()
        task.started = False

    def ResetDevice(self, request: Any, context: Any) -> Any:
        assert request.device_name == "Dev1"
        for task in self.tasks.values():
            self._halt(task)
            task.kind = "cleared"
        self.lines = dict.fromkeys(LINES, False)
        self.valves = [0.0] * len(self.outputs)
        self.twin.vent()
        return messages.ResetDeviceResponse()

    # Channels

    def _add(self, request: Any, kind: str, channel: str, known: Any) -> None:
        task = self._task(request)
        if not channel.startswith("Dev1/"):
            raise RefusedError(NO_DEVICE, "Device identifier is invalid.")
        if channel not in known:
            raise RefusedError(NO_CHANNEL, "Physical channel specified does not exist on this device.")
        for other in self.tasks.values():
            if other is not task and other.kind == kind and channel in other.channels:
                raise RefusedError(RESERVED, "The specified resource is reserved.")
        task.kind = kind
        task.channels.append(channel)

    def CreateAIVoltageChan(self, request: Any, context: Any) -> Any:
        self._add(request, "ai", request.physical_channel, self.inputs)
        return messages.CreateAIVoltageChanResponse()

    def CreateAOVoltageChan(self, request: Any, context: Any) -> Any:
        self._add(request, "ao", request.physical_channel, self.outputs)
        return messages.CreateAOVoltageChanResponse()

    def CreateDOChan(self, request: Any, context: Any) -> Any:
        self._add(request, "do", request.lines, LINES)
        return messages.CreateDOChanResponse()

    # Timing

    def CfgSampClkTiming(self, request: Any, context: Any) -> Any:
        task = self._task(request)
        assert request.sample_mode_raw == CONTINUOUS and task.kind == "ai"
        divided = round(80e6 / request.rate)  # the clock's whole ticks
        task.rate = 80e6 / divided
        self.twin.rate = request.rate
        return messages.CfgSampClkTimingResponse()

    # Data

    def ReadAnalogF64(self, request: Any, context: Any) -> Any:
        task, count = self._task(request), request.num_samps_per_chan
        self.reads += 1
        try:
            block = self.twin.read(count, timeout=request.timeout - count / self.twin.rate)
        except SilentError as error:
            raise RefusedError(TIMEOUT, "Some or all of the samples requested have not yet been acquired.") from error
        except RigError as error:
            raise RefusedError(OVERWRITTEN, "The application is not able to keep up with the hardware.") from error
        places = [self.inputs.index(channel) for channel in task.channels]
        columns = [np.clip(self.sensors[place].raw(block.values[:, place]), -10, 10) for place in places]
        return messages.ReadAnalogF64Response(read_array=np.concatenate(columns), samps_per_chan_read=count)

    def WriteAnalogF64(self, request: Any, context: Any) -> Any:
        assert self._task(request).kind == "ao" and request.auto_start
        self.valves = list(request.write_array)
        self._wired()
        return messages.WriteAnalogF64Response(samps_per_chan_written=1)

    def WriteDigitalLines(self, request: Any, context: Any) -> Any:
        task, values = self._task(request), [bool(value) for value in request.write_array]
        assert task.kind == "do" and len(values) == len(task.channels)
        before = self.lines[HEARTBEAT]
        self.lines |= dict(zip(task.channels, values, strict=True))
        if self.lines[HEARTBEAT] != before:
            self.beats += 1
            self.twin.heartbeat()
        self._wired()
        return messages.WriteDigitalLinesResponse(samps_per_chan_written=1)

    def _wired(self) -> None:
        """The spring valve has its current only while the line holds; the twin's patience is the relay's."""
        if not self.lines[HOLD]:
            self.twin.vent()
        elif self.twin.is_open:
            try:
                pairs = zip(self.regulators, self.valves, strict=True)
                self.twin.set_valves([float(terminal.si(volts)) for terminal, volts in pairs])
            except RigError:  # the relay has let go
                self.twin.vent()

    # Attributes

    def GetReadAttributeUInt64(self, request: Any, context: Any) -> Any:
        assert request.attribute_raw == messages.ReadUInt64Attribute.READ_ATTRIBUTE_TOTAL_SAMP_PER_CHAN_ACQUIRED
        return messages.GetReadAttributeUInt64Response(value=round(self.twin.clock() * self.twin.rate))

    def GetTimingAttributeDouble(self, request: Any, context: Any) -> Any:
        assert request.attribute_raw == messages.TimingDoubleAttribute.TIMING_ATTRIBUTE_SAMP_CLK_RATE
        return messages.GetTimingAttributeDoubleResponse(value=self._task(request).rate)

    def GetTaskAttributeUInt32(self, request: Any, context: Any) -> Any:
        assert request.attribute_raw == messages.TaskUInt32Attribute.TASK_ATTRIBUTE_NUM_CHANS
        return messages.GetTaskAttributeUInt32Response(value=len(self._task(request).channels))

    def GetTaskAttributeString(self, request: Any, context: Any) -> Any:
        name = messages.TaskStringAttribute.TASK_ATTRIBUTE_NAME
        value = request.task.name if request.attribute_raw == name else ", ".join(self._task(request).channels)
        return messages.GetTaskAttributeStringResponse(value=value)

    def GetSystemInfoAttributeUInt32(self, request: Any, context: Any) -> Any:
        return messages.GetSystemInfoAttributeUInt32Response(
            value={0x1272: 24, 0x1923: 5}.get(request.attribute_raw, 0)
        )

    def GetSystemInfoAttributeString(self, request: Any, context: Any) -> Any:
        return messages.GetSystemInfoAttributeStringResponse(value="Dev1")

    def GetDeviceAttributeString(self, request: Any, context: Any) -> Any:
        return messages.GetDeviceAttributeStringResponse(value="PCI-6281")

    def GetDeviceAttributeUInt32(self, request: Any, context: Any) -> Any:
        return messages.GetDeviceAttributeUInt32Response(value=0x1234ABC)


def serve(card: Card) -> tuple[grpc.Server, str]:
    """Start it on a free port of this machine; its address."""
    server = grpc.server(futures.ThreadPoolExecutor(max_workers=1))
    service.add_NiDAQmxServicer_to_server(card, server)
    port = server.add_insecure_port("127.0.0.1:0")
    server.start()
    return server, f"127.0.0.1:{port}"
