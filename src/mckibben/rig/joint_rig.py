"""Configuration file of a joint rig: hardware, limits, approach."""

from __future__ import annotations

import abc
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, ClassVar, NamedTuple

from jaxtyping import PyTree
from pydantic import Field

from mckibben.component.base import Checked
from mckibben.component.classes import Keyed
from mckibben.component.schema import ComponentField, section_of
from mckibben.config.fields import Title
from mckibben.config.model import ConfigModel, JointDocument
from mckibben.plant import Plant
from mckibben.rig.backend import Backend
from mckibben.rig.bench import JointLimits
from mckibben.rig.channels import Channels
from mckibben.rig.modbus import ModbusBackend, RegisterMap
from mckibben.rig.ni import Card, NiBackend
from mckibben.rig.simulated.joint import PERFECT, Sensing, SimulatedJoint
from mckibben.scenario import Scenario
from mckibben.units import Angle, AngleStep, BoundedInt, Duration, PositivePressure, PressureNoise, WaitTime


class RunConditions(NamedTuple):
    """Conditions of a run, for the hardware of a joint rig; some are for a simulated joint.

    Attributes
    ----------
    period
        Control period, which is the sampling period [s].
    patience
        Timeout of the watchdog [s].
    substeps
        Integration steps per period.
    paced
        Whether it runs in real time.
    start
        State at which it starts. Default: vented.
    ideal
        Whether sensors are ideal.
    digest
        SHA-256 of the scenario.
    channels
        Names of joints and muscles.
    """

    period: float
    patience: float
    substeps: int = 4
    paced: bool = True
    start: PyTree = None
    ideal: bool = False
    digest: bytes = b""
    channels: Channels = Channels()


class JointHardware(Keyed, Checked, abc.ABC):
    """Hardware of a joint rig, in its file: a backend, or the settings of one."""

    physical: ClassVar[bool] = True
    """Whether it moves a real joint."""

    @abc.abstractmethod
    def backend(self, plant: Plant, run: RunConditions) -> Backend:
        """Return the backend, closed.

        Parameters
        ----------
        plant
            Plant of the scenario.
        run
            Conditions of the run.
        """


@dataclass(frozen=True, kw_only=True)
class SimulatedJointSettings(JointHardware):
    """The plant of the scenario as a joint.

    Parameters
    ----------
    angle_step, pressure_noise
        Resolution of the encoder [rad] and noise of the pressures [Pa], see `Sensing`.
    seed
        Seed of the noise.
    """

    short_name = "simulated"
    physical = False

    angle_step: AngleStep = Sensing.angle_step
    pressure_noise: PressureNoise = Sensing.pressure_noise
    seed: Annotated[int, BoundedInt(0, 2**31 - 1)] = 0

    def backend(self, plant: Plant, run: RunConditions) -> Backend:
        return SimulatedJoint(
            plant,
            period=run.period,
            substeps=run.substeps,
            start=run.start,
            channels=run.channels,
            sensing=PERFECT if run.ideal else Sensing(self.angle_step, self.pressure_noise),
            patience=run.patience,
            paced=run.paced,
            seed=self.seed,
        )


@dataclass(frozen=True, kw_only=True)
class CardJoint(JointHardware):
    """A joint at a card of National Instruments, see `NiBackend`, which samples once per control period."""

    short_name = "nidaqmx"

    card: Path

    def backend(self, plant: Plant, run: RunConditions) -> Backend:
        return NiBackend(Card.read(self.card), rate=1 / run.period)


@dataclass(frozen=True, kw_only=True)
class SerialJoint(JointHardware):
    """A joint at a microcontroller, see `SerialBackend`, whose firmware was exported from the scenario.

    Parameters
    ----------
    port, baud
        Serial port, and its rate [1/s].
    firmware
        Scenario that the firmware was exported from, if it is another one of this joint: its limits hold.
    """

    short_name = "serial"

    port: str
    baud: Annotated[int, BoundedInt(1200, 10_000_000)] = 1_000_000
    firmware: Path | None = None

    def backend(self, plant: Plant, run: RunConditions) -> Backend:
        from mckibben.rig.serial_line import SerialBackend

        digest = run.digest if self.firmware is None else Scenario.read(self.firmware).digest
        return SerialBackend(self.port, baud=self.baud, digest=digest, period=run.period)


@dataclass(frozen=True, kw_only=True)
class ModbusJoint(JointHardware):
    """A joint at a terminal, see `RegisterMap`, which is read once per control period."""

    short_name = "modbus"

    registers: Path

    def backend(self, plant: Plant, run: RunConditions) -> Backend:
        return ModbusBackend(RegisterMap.read(self.registers), rate=1 / run.period)


class JointLimitsSettings(section_of(JointLimits, partial=True)):
    """Safety limits of all joints and muscles, by default those of each.

    They are 10 deg beyond its references, its start and its vented angle, and 5 % above its rated pressure.
    """


class OwnLimits(ConfigModel):
    """Limits of one joint or muscle of a robot, in place of those of all."""

    lowest_angle: Angle | None = None
    highest_angle: Angle | None = None
    pressure: PositivePressure | None = None


class ApproachSettings(ConfigModel):
    """Approach: in `probing` each muscle of a physical joint alone is filled to 0.5 bar to check its sensor.

    That is the time for two muscles; a robot of six takes three times as long. In `raising` the pressures are ramped to
    the start, in `settling` the first reference is held.
    """

    probing: WaitTime = 2.0
    raising: WaitTime = 2.0
    settling: WaitTime = 2.0


class JointRig(JointDocument):
    """Configuration of the rig of a joint or a robot, in SI; `read` reads a file with units.

    `limits_of` has limits of single joints and muscles of a robot, by name.

    Examples
    --------
    >>> rig = JointRig.read("examples/rig/joint-rig.yaml")
    >>> rig.approach.raising, rig.patience
    (2.0, 0.1)
    """

    kind: ClassVar[str] = "joint rig"
    examples: ClassVar[str] = "examples/rig/joint-rig.yaml"

    name: Title = Field("simulated joint", examples=["knee on the bench"])
    rig: Annotated[JointHardware, ComponentField(JointHardware)] = Field(examples=["simulated"])
    limits: JointLimitsSettings = JointLimitsSettings()
    limits_of: dict[str, OwnLimits] = Field(default_factory=dict)
    approach: ApproachSettings = ApproachSettings()
    patience: Duration = 0.1

    @property
    def physical(self) -> bool:
        """Whether it moves a real joint."""
        return self.rig.physical

    def to_json(self) -> dict[str, object]:
        """Explicit fields with units, for the record."""
        return self.model_dump(mode="json", by_alias=True, exclude_none=True, context={"folder": Path()})
