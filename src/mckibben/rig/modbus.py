"""Rigs on a terminal that speaks Modbus TCP, such as a valve terminal with analog inputs; needs the extra `rig`."""

from __future__ import annotations

import contextlib
import logging
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, ClassVar, Literal, Self

import numpy as np
from pydantic import ConfigDict, Field, model_validator

from mckibben.config.model import DocumentModel, fail_validation
from mckibben.errors import RigError, SilentError
from mckibben.rig.backend import Backend, Block, Channel, ChannelStatus, ScaledChannel
from mckibben.units import ms

_CABLE = "check cable, power and address of the terminal, and what else keeps it or this computer busy"
_ORDER = "give word_order: big (high word first, as Modbus has it), or little"

logging.getLogger("pymodbus").addHandler(logging.NullHandler())  # its errors are ours, with remedies


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
    word_order
        Which word of a number of two registers comes first: the high one (big), or the low one (little). Default: big,
        as Modbus has it; of an output, if that makes sense of a reading at opening.
    """

    address: int = Field(ge=0, le=65535)
    kind: Literal["holding", "input"] = "holding"
    type: Literal["int16", "uint16", "int32", "uint32", "float32"] = "int16"
    word_order: Literal["big", "little"] | None = None

    @property
    def size(self) -> int:
        """Number of registers."""
        return 1 if self.type.endswith("16") else 2

    def can_read(self, counts: float) -> bool:
        """Whether a sensor can give these counts: in its range, and not the remnant of a number of other words."""
        return self.low <= float(self.si(counts)) <= self.high and not 0 < abs(counts) < np.finfo("float32").tiny

    @model_validator(mode="after")
    def _check_counts(self) -> Self:
        """Check that the type holds the range, so that no reading or command is cut or wraps."""
        limits = np.finfo(self.type) if self.type == "float32" else np.iinfo(self.type)
        lowest, highest = sorted(self.raw([self.low, self.high]).round().tolist())
        if not limits.min <= lowest <= highest <= limits.max:
            message = f"holds {limits.min:.0f}..{limits.max:.0f}, and the range is {lowest:.0f}..{highest:.0f} counts"
            fail_validation(message, "correct type, gain and offset, or low and high", field="type")
        return self


class ValveRegister(Register):
    """A register of a valve: it can be written, and its range holds 0, the command of the vent.

    Attributes
    ----------
    readback
        Number of the (first) holding register from which the command reads back. Default: its address.
    """

    readback: int | None = Field(None, ge=0, le=65535)

    @model_validator(mode="after")
    def _check_output(self) -> Self:
        if self.kind == "input":
            remedy = "give the holding register to which its command is written"
            fail_validation("input registers cannot be written", remedy, field="kind")
        if not self.low <= 0 < self.high:
            message = f"{self.low:g}..{self.high:g} {self.unit} does not hold 0, which vents"
            fail_validation(message, "give the pressure at the lowest command, at most 0", field="low")
        if self.size == 2 and self.word_order is None and self.raw(0.0).round():
            fail_validation("is of two registers, of which a wrong order could open the valve", _ORDER, field="type")
        return self


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
    outputs: dict[str, ValveRegister]

    @model_validator(mode="after")
    def _check_registers(self) -> Self:
        """Check that no register belongs to two inputs, or to two outputs."""
        for section, registers in {"inputs": self.inputs, "outputs": self.outputs}.items():
            names: dict[tuple[str, int], str] = {}
            for name, register in registers.items():
                for address in range(register.address, register.address + register.size):
                    other = names.setdefault((register.kind, address), name)
                    if other != name:
                        message = f"is at register {address}, as is {other}"
                        fail_validation(message, "give each its own register", field=f"{section}.{name}.address")
        return self


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
        self._timeout = self._end = 0.0  # longest wait for replies [s], and when it ends
        self._unreadable: set[str] = set()  # outputs that do not read back
        self._unvented: list[str] = []  # outputs that did not confirm the vent
        self._duration = 0.0  # of the latest sample [s]
        self._reads_big = False  # whether a reading makes sense only with the high word first

    @property
    def inputs(self) -> Sequence[Channel]:
        return self._channels(self.registers.inputs)

    @property
    def outputs(self) -> Sequence[Channel]:
        return self._channels(self.registers.outputs)

    def _channels(self, registers: Mapping[str, Register]) -> Sequence[Channel]:
        host = self.registers.host
        return [Channel(name, at.unit, at.low, at.high, f"{host}/{at.address}") for name, at in registers.items()]

    @property
    def description(self) -> Mapping[str, str]:
        return {"kind": "modbus", "registers": self.registers.dumps()}

    @property
    def latency(self) -> float:
        return self._duration

    @property
    def losses(self) -> str:
        return f"the vent was not confirmed for {' and '.join(self._unvented)}" if self._unvented else ""

    def open(self) -> None:
        """Connect, vent, and start the clock.

        Raises
        ------
        RigError
            If the package or the terminal is missing, it has no such registers, or an output reads back another number.
        """
        if self._client is not None:
            raise RigError("the rig is already open", remedy="close it first")
        try:
            from pymodbus.client import ModbusTcpClient
        except ImportError as error:
            raise RigError("the package pymodbus is missing", remedy="pip install 'mckibben[rig]'") from error
        there = self.registers
        self._client = ModbusTcpClient(there.host, port=there.port, timeout=there.patience, retries=0)
        self._unreadable, self._unvented, self._timeout = set(), [], there.patience
        if not self._client.connect():
            self._client = None
            raise RigError(
                f"no terminal answers at {there.host}:{there.port}", field="host", value=there.host, remedy=_CABLE
            )
        for name in there.outputs:
            self._await()
            self._write(name, 0.0)
            self._check_readback(name)
        self._await()
        self._sample()
        for name, register in there.outputs.items():
            if register.size == 2 and register.word_order is None and not self._reads_big:
                raise RigError(f"the order of the words of {name} shows in no reading", field=name, remedy=_ORDER)
        self._begun, self._next = time.monotonic(), 0

    def status(self) -> Iterator[ChannelStatus]:
        """Status of its channels; an input at the register from which an output reads back is a problem."""
        yield from super().status()
        commands = {self._readback(name): name for name in self.registers.outputs if name not in self._unreadable}
        for name, register in self.registers.inputs.items():
            if register.kind == "holding" and (valve := commands.get(register.address)):
                problem = f"reads the command of {valve}, and measures nothing: correct its address and kind"
                yield ChannelStatus(name, str(register.address), "", problem)

    def clock(self) -> float:
        return time.monotonic() - self._begun

    def read(self, count: int, *, timeout: float = 1.0) -> Block:
        self._check_open()
        self._timeout = min(timeout, self.patience)
        late = int(self.clock() * self.rate) - self._next
        first = self._next + max(late, 0)  # samples of a host that is late are never taken
        rows, times = [], []
        for number in range(first, first + count):
            time.sleep(max(0.0, number / self.rate - self.clock()))
            self._await()
            begun = self.clock()
            rows.append(self._sample())
            times.append(self.clock())
            self._duration = times[-1] - begun
        self._next = first + count
        return Block(first, np.array(times), np.array(rows), np.zeros(count))

    def set_valves(self, pressures: Sequence[float]) -> None:
        self._check_open()
        self._await()
        for name, pressure in zip(self.registers.outputs, pressures, strict=True):
            self._write(name, pressure)

    def heartbeat(self) -> None:
        """Nothing: each request is a sign of life."""

    def vent(self) -> None:
        """Write 0 to each output, whether or not others answer, and read each back, all within `patience`.

        Outputs that do not confirm it are tried once more, on new connections, which no late reply holds up. If one
        still does not, nothing more is sent, so that the watchdog of the terminal vents.
        """
        if self._client is None or self._unvented:
            return
        left = [*self.registers.outputs]
        for again in (False, True):
            written = {name: self._succeeds(again, self._write, name, 0.0) for name in left}
            left = [name for name in left if not self._succeeds(again, self._is_vented, name, written[name])]
        self._unvented = left
        if left:
            self._client.close()

    def close(self) -> None:
        self.vent()
        with contextlib.suppress(Exception):
            self._client.close()
        self._client = None

    def _check_open(self) -> None:
        if self._client is None:
            raise RigError("the rig is not open", remedy="open it first")
        if self._unvented:
            raise SilentError(self.losses, remedy="shut the supply by hand; the terminal has to vent by its watchdog")

    def _await(self, timeout: float | None = None) -> None:
        """Wait for the next replies until a time from now, together."""
        self._end = time.monotonic() + (self._timeout if timeout is None else timeout)

    def _sample(self) -> list[float]:
        """Values of all inputs."""
        return [self._value(name, register) for name, register in self.registers.inputs.items()]

    def _value(self, name: str, register: Register) -> float:
        """Value of an input; `RigError` if it is in its range only with the other order of words."""
        words, kind = self._read(name, register, register.address), self._client.DATATYPE[register.type.upper()]
        orders = ("little", "big") if register.word_order == "little" else ("big", "little")
        counts, other = (float(self._client.convert_from_registers(words, kind, order)) for order in orders)
        if register.size == 2 and register.can_read(other) and not register.can_read(counts):
            readings = (
                f"{register.si(counts):.4g} {register.unit}, and with its words exchanged {register.si(other):.4g}"
            )
            remedy = f"set word_order: {orders[1]} in its register"
            raise RigError(f"{name} reads {readings}", field=name, remedy=remedy)
        self._reads_big |= register.size == 2 and orders[0] == "big" and not register.can_read(other)
        return float(register.si(counts))

    def _words(self, register: ValveRegister, pressure: float) -> list[int]:
        """Words of a command [Pa], within the range of the valve."""
        counts = float(register.raw(min(max(pressure, register.low), register.high)))
        number, kind = counts if register.type == "float32" else round(counts), register.type.upper()
        return self._client.convert_to_registers(number, self._client.DATATYPE[kind], register.word_order or "big")

    def _write(self, name: str, pressure: float) -> None:
        """Write a command [Pa]."""
        register = self.registers.outputs[name]
        words = self._words(register, pressure)
        self._reply(name, register, 16, self._client.write_registers, register.address, words)

    def _read(self, name: str, register: Register, address: int) -> list[int]:
        holding = register.kind == "holding"
        ask = self._client.read_holding_registers if holding else self._client.read_input_registers
        return self._reply(name, register, 3 if holding else 4, ask, address, count=register.size).registers

    def _is_vented(self, name: str, written: bool) -> bool:
        """Whether an output reads back the command of the vent; of one that cannot, whether it was written."""
        if name in self._unreadable:
            return written
        register = self.registers.outputs[name]
        return self._read(name, register, self._readback(name)) == self._words(register, 0.0)

    def _readback(self, name: str) -> int:
        """Number of the register from which an output reads back."""
        register = self.registers.outputs[name]
        return register.address if register.readback is None else register.readback

    def _check_readback(self, name: str) -> None:
        """Check that an output reads back, unless the terminal refuses that; `RigError` for another number."""
        try:
            is_vented = self._is_vented(name, True)
        except RigError as refused:
            if isinstance(refused, SilentError) or self.registers.outputs[name].readback is not None:
                raise
            self._unreadable.add(name)
            return
        if not is_vented:
            remedy = "correct its address, or give the register from which it reads back (readback: NUMBER)"
            raise RigError(f"{name} does not read back the 0 that was written", field=name, remedy=remedy)

    def _succeeds(self, again: bool, act: Callable[..., bool | None], *arguments: object) -> bool:
        """Whether a request of a vent is answered in its share of `patience`, and not with False."""
        self._await(self.patience / (4 * len(self.registers.outputs)))
        try:
            if again:
                self._client.close()
            return act(*arguments) is not False
        except Exception:
            return False

    def _reply(
        self, name: str, register: Register, function: int, ask: Callable, *arguments: object, **options: int
    ) -> Any:
        """Reply to a request with a function code.

        Raises `SilentError` if there is none in time, and `RigError` if it is refused, or that to another request.
        """
        from pymodbus.exceptions import ModbusException

        wait = max(self._end - time.monotonic(), 1 * ms)
        for parameters in (self._client.comm_params, self._client.transaction.comm_params):
            parameters.timeout_connect = wait
        try:
            reply = ask(*arguments, device_id=self.registers.device, **options)
        except (ModbusException, OSError) as error:
            message = f"the terminal does not answer for {name} within {wait:.2g} s: {error}"
            raise SilentError(message, field=name, remedy=_CABLE) from error
        if reply.isError():
            remedy = "correct its address, kind and type in the register map"
            raise RigError(f"the terminal refuses {name}: {reply}", field=name, remedy=remedy)
        size = len(reply.registers) or reply.count
        if (reply.function_code, size) != (function, register.size):
            message = f"the terminal answers for {name} with {size} registers by function {reply.function_code}"
            remedy = "check its firmware, and what else answers at its address"
            raise RigError(f"{message}, not {register.size} by {function}", field=name, remedy=remedy)
        return reply
