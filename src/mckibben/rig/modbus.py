"""Rigs on a terminal that speaks Modbus TCP, such as a valve terminal with analog inputs; needs the extra `rig`."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, ClassVar, Literal

import numpy as np
from pydantic import ConfigDict, Field

from mckibben.config.model import DocumentModel
from mckibben.errors import RigError, SilentError
from mckibben.rig.backend import Backend, Block, Channel, ScaledChannel

_CABLE = "check cable, power and address of the terminal"


class Register(ScaledChannel):
    """A channel of a terminal: its register, and the line from counts to SI.

    Attributes
    ----------
    address
        Number of the (first) register, from 0.
    kind
        Holding registers, or input registers, which cannot be written.
    type
        Type of its number.
    """

    address: int = Field(ge=0, le=65535)
    kind: Literal["holding", "input"] = "holding"
    type: Literal["int16", "uint16", "int32", "uint32", "float32"] = "int16"


class RegisterMap(DocumentModel):
    """Registers of a terminal; numbers are in SI.

    Attributes
    ----------
    host, port, device
        Address of the terminal, and its number behind a gateway.
    rate
        Rate at which it is read [Hz].
    patience
        Time [s] after which the terminal itself vents without a request: its own watchdog, which has to be set there.
    inputs, outputs
        Registers of the sensors and valves, by channel.
    """

    model_config = ConfigDict(strict=False)
    kind: ClassVar[str] = "register map"
    examples: ClassVar[str] = "examples/rig/terminal.yaml"

    host: str
    port: int = Field(502, ge=1, le=65535)
    device: int = Field(1, ge=0, le=255)
    rate: float = Field(100.0, gt=0, le=1e3)
    patience: float = Field(0.5, gt=0, le=60)
    inputs: dict[str, Register]
    outputs: dict[str, Register]


class ModbusBackend(Backend):
    """Sensors and valves at the registers of a terminal, which the host reads at its own clock.

    Parameters
    ----------
    registers
        Its registers.
    rate
        Rate at which it is read [Hz]; 0: that of the map.
    """

    def __init__(self, registers: RegisterMap, *, rate: float = 0.0) -> None:
        self.registers = registers
        self.rate, self.patience = rate or registers.rate, registers.patience
        self._client: Any = None
        self._begun, self._next = 0.0, 0

    @property
    def inputs(self) -> Sequence[Channel]:
        return self._channels(self.registers.inputs)

    @property
    def outputs(self) -> Sequence[Channel]:
        return self._channels(self.registers.outputs)

    def _channels(self, registers: Mapping[str, Register]) -> Sequence[Channel]:
        host = self.registers.host
        return [Channel(name, one.unit, one.low, one.high, f"{host}/{one.address}") for name, one in registers.items()]

    @property
    def description(self) -> Mapping[str, str]:
        return {"kind": "modbus", "registers": self.registers.dumps()}

    def open(self) -> None:
        """Connect, vent, and start the clock.

        Raises
        ------
        RigError
            If the package or the terminal is missing, or it has no such registers.
        """
        if self._client is not None:
            raise RigError("the rig is already open", remedy="close it first")
        try:
            from pymodbus.client import ModbusTcpClient
        except ImportError as error:
            raise RigError("the package pymodbus is missing", remedy="pip install 'mckibben[rig]'") from error
        there = self.registers
        self._client = ModbusTcpClient(there.host, port=there.port, timeout=there.patience, retries=0)
        if not self._client.connect():
            self._client = None
            raise RigError(
                f"no terminal answers at {there.host}:{there.port}", field="host", value=there.host, remedy=_CABLE
            )
        self._write([0.0] * len(there.outputs))
        self._sample()
        self._begun, self._next = time.monotonic(), 0

    def clock(self) -> float:
        return time.monotonic() - self._begun

    def read(self, count: int, *, timeout: float = 1.0) -> Block:
        self._check_open()
        late = int(self.clock() * self.rate) - self._next
        first = self._next + max(late, 0)  # samples of a host that is late are never taken
        rows, times = [], []
        for number in range(first, first + count):
            time.sleep(max(0.0, number / self.rate - self.clock()))
            rows.append(self._sample())
            times.append(self.clock())
            if times[-1] - number / self.rate > timeout:
                raise SilentError(f"a sample took {times[-1] - number / self.rate:.2g} s", remedy=_CABLE)
        self._next = first + count
        return Block(first, np.array(times), np.array(rows), np.zeros(count))

    def set_valves(self, pressures: Sequence[float]) -> None:
        self._check_open()
        self._write(pressures)

    def heartbeat(self) -> None:
        """Nothing: each request is a sign of life."""

    def vent(self) -> None:
        with contextlib.suppress(Exception):
            self._write([0.0] * len(self.registers.outputs))

    def close(self) -> None:
        self.vent()
        with contextlib.suppress(Exception):
            self._client.close()
        self._client = None

    def _check_open(self) -> None:
        if self._client is None:
            raise RigError("the rig is not open", remedy="open it first")

    def _sample(self) -> list[float]:
        """Values of all inputs."""
        values = []
        for name, one in self.registers.inputs.items():
            ask = self._client.read_holding_registers if one.kind == "holding" else self._client.read_input_registers
            kind = self._client.DATATYPE[one.type.upper()]
            with self._translated(name):
                answer = ask(one.address, count=kind.value[1], device_id=self.registers.device)
                counts = self._client.convert_from_registers(self._answered(answer, name), kind)
            values.append(float(one.si(float(counts))))
        return values

    def _write(self, pressures: Sequence[float]) -> None:
        """Write commands [Pa], within the ranges of the valves; 0 is the lowest of them."""
        for (name, one), pressure in zip(self.registers.outputs.items(), pressures, strict=True):
            counts = float(one.raw(min(max(pressure, one.low), one.high)))
            number = counts if one.type == "float32" else round(counts)
            words = self._client.convert_to_registers(number, self._client.DATATYPE[one.type.upper()])
            with self._translated(name):
                self._answered(self._client.write_registers(one.address, words, device_id=self.registers.device), name)

    def _answered(self, answer: Any, name: str) -> list[int]:
        if answer.isError():
            remedy = "correct its address, kind and type in the register map"
            raise RigError(f"the terminal refuses {name}: {answer}", field=name, remedy=remedy)
        return answer.registers

    @contextlib.contextmanager
    def _translated(self, name: str) -> Iterator[None]:
        from pymodbus.exceptions import ModbusException

        try:
            yield
        except (ModbusException, OSError) as error:
            raise SilentError(f"the terminal does not answer for {name}: {error}", field=name, remedy=_CABLE) from error
