"""Protocol files, and the runtime objects of their sections."""

from __future__ import annotations

import abc
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

from jaxtyping import PyTree
from pydantic import Field

from mckibben.component.base import Checked, Component, Inherited
from mckibben.component.schema import ComponentField
from mckibben.config.document import Document
from mckibben.config.fields import Title
from mckibben.config.model import ConfigModel, DocumentModel, parse_model, read_text
from mckibben.errors import RangeError
from mckibben.muscle import Creep, ForceCorrection, ForceLaw, Friction, Muscle, NoCreep, NoFriction, Specimen
from mckibben.rig.backend import Backend, MovingBackend, MuscleRig
from mckibben.rig.bench import Bench, MonitorTime, RigLimits
from mckibben.rig.by_hand import HandBench
from mckibben.rig.modbus import ModbusBackend, RegisterMap
from mckibben.rig.ni import Card, NiBackend
from mckibben.rig.protocol import Protocol
from mckibben.rig.simulated.rig import Regulator
from mckibben.units import BoundedInt, Contraction, Duration, Force, PressureScale, SampleRate, Strength


class MountedMuscle(Component):
    """Muscle under test; its law gives the boundaries of the test, friction and creep are for the simulated rig.

    Attributes
    ----------
    specimen
        Specimen of the catalog or of a file.
    law
        Force law. Default: unknown, as it is before the first test.
    mounted_at
        Contraction at the position 0 of the motor [-].
    friction, creep, strength, correction
        Of the simulated rig's muscle, as for `Muscle`.
    """

    specimen: Specimen
    law: ForceLaw | None = None
    mounted_at: Contraction = 0.0
    friction: Friction = NoFriction()
    creep: Creep = NoCreep()
    strength: Strength | None = None
    correction: ForceCorrection | None = None

    def muscle(self, **others: PyTree) -> Muscle:
        """Return the muscle, or one with other parts."""
        fields = {name: getattr(self, name) for name in ("friction", "creep", "strength", "correction")} | others
        law = fields.pop("law", self.law)
        assert law is not None  # the test sees to it
        return Muscle(self.specimen, law, **fields)


@dataclass(frozen=True, kw_only=True)
class SimulatedRigSettings(Checked, MuscleRig):
    """The simulated rig: law, friction and creep of its muscle (default: those of `muscle`)."""

    short_name = "simulated"
    physical = False

    muscle: Annotated[MountedMuscle, Inherited(lambda scope: scope["muscle"])]
    seed: Annotated[int, BoundedInt(0, 2**31 - 1)] = 0
    law: ForceLaw | None = None
    friction: Friction | None = None
    creep: Creep | None = None
    regulator: Regulator | None = None
    paced: bool = False

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.law is None and self.muscle.law is None:
            remedy = "give `simulated: {law: lei-mas-10-180n}`, or the muscle a law"
            raise RangeError("has no law for its simulated muscle", remedy=remedy)

    def backend(self, session: int = 0) -> MovingBackend:
        """Return the simulated rig, each session with its own noise."""
        from mckibben.rig.simulated import SimulatedRig

        laws = {name: law for name in ("law", "friction", "creep") if (law := getattr(self, name)) is not None}
        muscle = self.muscle.muscle(**laws, **({"strength": None} if self.law else {}))
        settings: dict[str, Any] = {"mounted_at": self.muscle.mounted_at, "paced": self.paced}
        return SimulatedRig(muscle, seed=self.seed + 1_000_003 * session, regulator=self.regulator, **settings)


Moved = Literal["screw", "weights"]
"""Who has no motor: an operator turns a screw, or hangs weights on the muscle."""


@dataclass(frozen=True, kw_only=True)
class HandMovedRig(Checked, MuscleRig, abc.ABC):
    """Base of rigs of sensors and a valve whose muscle an operator moves, see `HandBench`."""

    moved_by: Moved = "screw"

    def backend(self, session: int = 0) -> MovingBackend:
        return HandBench(self.connected(), weights=self.moved_by == "weights")

    @abc.abstractmethod
    def connected(self) -> Backend:
        """Return the sensors and the valve, closed."""


@dataclass(frozen=True, kw_only=True)
class CardBench(HandMovedRig):
    """Sensors and a valve at a card of National Instruments, see `NiBackend`."""

    short_name = "nidaqmx"

    card: Path

    def connected(self) -> Backend:
        return NiBackend(Card.read(self.card))


@dataclass(frozen=True, kw_only=True)
class SerialBench(HandMovedRig):
    """Sensors and a valve at a microcontroller, see `SerialBackend`.

    The muscle is one of the two of a joint's board, unless the firmware has the channels of a bench (0).
    """

    short_name = "serial"

    port: str
    baud: Annotated[int, BoundedInt(1200, 10_000_000)] = 1_000_000
    muscle: Annotated[int, BoundedInt(0, 2)] = 1

    def connected(self) -> Backend:
        from mckibben.rig.serial_line import SerialBackend

        return SerialBackend(self.port, baud=self.baud, muscle=self.muscle)


@dataclass(frozen=True, kw_only=True)
class ModbusBench(HandMovedRig):
    """Sensors and a valve at a terminal, see `RegisterMap`."""

    short_name = "modbus"

    registers: Path

    def connected(self) -> Backend:
        return ModbusBackend(RegisterMap.read(self.registers))


class RecordingSettings(ConfigModel):
    """Cycle of the safety monitor, record between plateaus, and when a pressure is settled or vented, see `Bench`."""

    cycle: MonitorTime | None = None
    between: SampleRate | None = None
    settled: PressureScale | None = None
    vented: PressureScale | None = None
    steady: Duration | None = None
    slack_force: Force | None = None


class RigTest(DocumentModel):
    """A test: specimen, rig, limits and protocol in SI; `read` and `to_yaml` know the units."""

    kind: ClassVar[str] = "protocol"
    examples: ClassVar[str] = "examples/rig/paper-protocol.yaml"

    name: Title = Field(examples=["isobaric test of a new muscle"])
    muscle: Annotated[MountedMuscle, ComponentField(MountedMuscle)]
    rig: Annotated[MuscleRig, ComponentField(MuscleRig)]
    limits: Annotated[RigLimits, ComponentField(RigLimits)]
    recording: RecordingSettings = RecordingSettings()
    protocol: Annotated[Protocol, ComponentField(Protocol)]

    def bench(self, backend: MovingBackend) -> Bench:
        """Return the bench of the test; its specimen has no law if that is unknown."""
        muscle = self.muscle
        return Bench(
            of=muscle.specimen if muscle.law is None else muscle.muscle(friction=NoFriction(), creep=NoCreep()),
            mounted_at=muscle.mounted_at,
            limits=self.limits,
            rate=backend.rate,
            supply=backend.supply,
            fastest=backend.fastest,
            **{name: value for name, value in self.recording if value is not None},
        )

    def is_same(self, other: RigTest) -> bool:
        """Whether two tests are the same, possibly on the same kind of hardware at other terminals."""
        wired = self.rig.physical and type(self.rig) is type(other.rig)
        return (self.model_copy(update={"rig": other.rig}) if wired else self) == other

    def _written(self, folder: Path) -> dict[str, Any]:
        data = super()._written(folder)
        if not any(value is not None for value in self.recording.model_dump().values()):
            del data["recording"]
        return data


def read_test(path: str | os.PathLike[str]) -> tuple[RigTest, Document]:
    """Return the test of a protocol file, and the lines of its values.

    Raises `FileError` if it cannot be read, and `ScenarioError` with all its mistakes.
    """
    text = read_text(path, f"a {RigTest.kind}", RigTest.examples)
    return parse_model(RigTest, text, source=os.fspath(path), folder=Path(path).parent)
