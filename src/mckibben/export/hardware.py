"""Files of hardware: limits of exported controllers, and boards with their parts."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

from pydantic import Field

from mckibben.config.fields import Flag
from mckibben.config.model import ConfigModel, JointDocument
from mckibben.export.containment.limits import Limits
from mckibben.units import Angle, BoundedInt, ForceTerm, PositivePressure, PositiveTime, Share, ms

Pin = Annotated[str, Field(pattern=r"^[A-Z]{0,3}_?[0-9]{1,3}$")]
"""Name of a pin in the Arduino core, such as ``A0``, ``PA5`` or ``"9"``."""
Count = Annotated[int, BoundedInt(-(2**31), 2**31 - 1)]


class PressureSensor(ConfigModel):
    """Analog sensor of gauge pressure: 0 at `low_volts`, and `pressure` [Pa] at `high_volts` at the pin."""

    pin: Pin
    low_volts: Share
    high_volts: Share
    pressure: PositivePressure


class AngleSensor(ConfigModel):
    """AS5600 on I2C, or a quadrature encoder with its number of `counts` per turn, zero at its position at the start.

    The angle of the joint is that of the sensor minus `zero` [rad], with the opposite sign if `reversed`. All AS5600
    have one address: several need a TCA9548A at its first address, each at its own `channel`.
    """

    sensor: Literal["as5600", "quadrature"]
    zero: Angle = 0.0
    reversed: Flag = False
    pin_a: Pin = "2"
    pin_b: Pin = "3"
    counts: Annotated[int, BoundedInt(4, 10_000_000)] = 4096
    channel: Annotated[int, BoundedInt(0, 7)] | None = None


class RegulatorOutput(ConfigModel):
    """Signal of a proportional regulator by filtered PWM or a converter: its shares at 0 bar and at `pressure` [Pa]."""

    output: Literal["pwm", "dac"]
    pin: Pin
    low_share: Share = 0.0
    high_share: Share = 1.0
    pressure: PositivePressure


class VentOutput(ConfigModel):
    """Output of the valve that opens all muscles to the atmosphere at a level; it has to do so without current."""

    pin: Pin
    open: Literal["low", "high"]


class ForceSensor(ConfigModel):
    """Load cell with an HX711, recorded as `force` [N]."""

    clock: Pin
    data: Pin
    zero: Count = 0
    newtons_per_count: ForceTerm


class Hardware(JointDocument):
    """A file of hardware: limits for each exported controller, board and parts for firmware.

    Attributes
    ----------
    limits
        Limits of the samples of the controller.
    single
        Whether the numbers of the controller have 32 bits, for processors without a 64-bit unit.
    silence
        Longest time [s] without a message of the host.
    board
        Kind of board: one with an Arduino core, or ``host``, this computer with a simulated joint.
    angle, pressure1, pressure2, valve1, valve2, vent, force
        Parts of a joint, needed for all boards but ``host``; without `force` there is no load cell.
    angles, pressures, valves
        Those of a robot, by the names of its joints and muscles.
    """

    kind: ClassVar[str] = "hardware file"
    examples: ClassVar[str] = "examples/hardware/"

    limits: Limits = Limits()
    single: Flag = False
    silence: PositiveTime = 100 * ms
    board: Literal["uno_r4", "teensy4", "esp32", "stm32", "host"] | None = None
    angle: AngleSensor | None = None
    pressure1: PressureSensor | None = None
    pressure2: PressureSensor | None = None
    valve1: RegulatorOutput | None = None
    valve2: RegulatorOutput | None = None
    angles: dict[str, AngleSensor] = Field(default_factory=dict)
    pressures: dict[str, PressureSensor] = Field(default_factory=dict)
    valves: dict[str, RegulatorOutput] = Field(default_factory=dict)
    vent: VentOutput | None = None
    force: ForceSensor | None = None
