"""Protocol files, and the runtime objects of their sections."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, cast

from pydantic import BeforeValidator, Field, PlainSerializer, SerializationInfo, ValidationInfo, field_validator

from mckibben.component.base import Component
from mckibben.component.schema import Part, section_of
from mckibben.config.document import Document, to_text
from mckibben.config.fields import Flag, OneOf, Title, read_path, write_path
from mckibben.config.model import ConfigModel, explicit_fields, fail_validation, parse_model, read_text
from mckibben.errors import ScenarioError, quoted
from mckibben.muscle import (
    Creep,
    ForceCorrection,
    ForceLaw,
    Friction,
    Muscle,
    NoCreep,
    NoFriction,
    Specimen,
)
from mckibben.rig.backend import MovingBackend
from mckibben.rig.bench import Bench, Drive, RigLimits
from mckibben.rig.calibration import Calibration, read_calibrations
from mckibben.rig.protocol import Protocol
from mckibben.storage.files import atomic_write
from mckibben.units import (
    BoundedInt,
    Contraction,
    Factor,
    PositiveTime,
    SampleRate,
    Strength,
    Travel,
)

if TYPE_CHECKING:
    from mckibben.rig.ni import Terminals


_ADDRESS = re.compile(r"[A-Za-z0-9_.:/-]{1,80}")


def _read_address(value: object) -> str:
    if not isinstance(value, str) or not _ADDRESS.fullmatch(value):
        fail_validation(
            f"{quoted(value)} is no address", "write it as the driver calls it, such as Dev1, ai0 or port0/line1"
        )
    return value


Address = Annotated[str, BeforeValidator(_read_address)]


def _read(value: object, info: ValidationInfo) -> object:
    return read_path(value, info, ".json")


def _write(value: object, info: SerializationInfo) -> str:
    return write_path(value, info)  # type: ignore[arg-type]


JsonPath = Annotated[object, BeforeValidator(_read), PlainSerializer(_write, when_used="json")]


class MountedMuscle(Component):
    """Muscle under test; the boundaries of the test follow from its law, or are found without one.

    Friction and creep are those of the simulated rig's muscle, unless it has its own.
    """

    specimen: Specimen
    law: ForceLaw | None = None
    mounted_at: Contraction = 0.0
    friction: Friction = NoFriction()
    creep: Creep = NoCreep()
    strength: Strength | None = None
    correction: ForceCorrection | None = None

    def muscle(self, **others: Any) -> Muscle:
        """Return the muscle, or one with other parts."""
        fields = {name: getattr(self, name) for name in ("friction", "creep", "strength", "correction")} | others
        law = fields.pop("law", self.law)
        assert law is not None  # the test sees to it
        return Muscle(self.specimen, law, **fields)


class SimulatedRigSettings(ConfigModel):
    """The simulated rig: law, friction and creep of its muscle (default: those of `muscle`), real or ideal parts."""

    seed: Annotated[int, BoundedInt(0, 2**31 - 1)] = 0
    law: Annotated[ForceLaw, Part(ForceLaw)] | None = None
    friction: Annotated[Friction, Part(Friction)] | None = None
    creep: Annotated[Creep, Part(Creep)] | None = None
    parts: Annotated[str, OneOf(("real", "ideal"))] | None = None
    paced: Flag | None = None


class DriveSettings(ConfigModel):
    """The motor, its reducer and its lead screw, see `Drive`; the paper's unless given."""

    steps: Annotated[int, BoundedInt(1, 1_000_000)] | None = None
    reduction: Factor | None = None
    lead: Travel | None = None
    fastest: SampleRate | None = None


class CardSettings(ConfigModel):
    """A card of National Instruments, see `Wiring` and `NiRig`: its terminals, and the file of its calibrations."""

    device: Address = "Dev1"
    force: Address = "ai0"
    pressure: Address = "ai1"
    valve: Address = "ao0"
    counter: Address = "ctr0"
    heartbeat: Address = "port0/line0"
    hold: Address = "port0/line1"
    direction: Address = "port0/line2"
    server: Address | None = None
    calibration: JsonPath
    rate: SampleRate | None = None
    patience: PositiveTime | None = None
    drive: DriveSettings | None = None


class RigSettings(ConfigModel):
    """One of `simulated` and `nidaqmx`."""

    renamed: ClassVar = {"virtual": "simulated"}

    simulated: SimulatedRigSettings | None = None
    nidaqmx: CardSettings | None = Field(None, validate_default=True)

    @field_validator("simulated", mode="before")
    @classmethod
    def _word_alone(cls, value: Any) -> Any:
        return {} if value == "" else value

    @field_validator("nidaqmx", mode="after")
    @classmethod
    def _one(cls, value: Any, info: ValidationInfo) -> Any:
        given = [
            key
            for key, one in (("simulated", info.data.get("simulated", "wrong")), ("nidaqmx", value))
            if one is not None
        ]
        if len(given) != 1:
            fail_validation(
                "is both at once" if given else "is empty", "give `simulated: {seed: 1}`, or `nidaqmx`", parent=True
            )
        return value


class RecordingSettings(section_of(Bench, partial=True)):
    """Cycle of the safety monitor, sample rate between plateaus, and force below which a point is slack."""


class RigTest(ConfigModel):
    """A test: specimen, rig, limits and protocol in SI; `read` and `to_yaml` know the units."""

    name: Title = Field(examples=["isobaric test of a new muscle"])
    muscle: Annotated[MountedMuscle, Part(MountedMuscle)]
    rig: RigSettings
    limits: Annotated[RigLimits, Part(RigLimits)]
    recording: RecordingSettings = RecordingSettings()
    protocol: Annotated[Protocol, Part(Protocol)]

    @field_validator("rig", mode="after")
    @classmethod
    def _law_known(cls, value: RigSettings, info: ValidationInfo) -> RigSettings:
        muscle = info.data.get("muscle")
        if value.simulated is not None and value.simulated.law is None and muscle is not None and muscle.law is None:
            fail_validation(
                "has no law for its simulated muscle", "give `simulated: {law: lei-mas-10-180n}`, or the muscle a law"
            )
        return value

    @classmethod
    def read(cls, path: str | os.PathLike[str]) -> RigTest:
        """Read a protocol file; `ScenarioError` with all problems: line, field, value, allowed range and remedy."""
        return read_test(path)[0]

    @classmethod
    def parse(cls, text: str, *, source: str = "protocol", folder: str | os.PathLike[str] = ".") -> RigTest:
        """Read a protocol from text, in which paths are relative to a folder."""
        return parse_model(RigTest, text, source=source, folder=folder)[0]

    def dumps(self, *, folder: str | os.PathLike[str] = ".") -> str:
        """The test as text that `parse` reads back to the last bit; paths are relative to a folder."""
        data = self.model_dump(mode="json", by_alias=True, context={"folder": Path(folder)})
        if not any(value is not None for value in self.recording.model_dump().values()):
            del data["recording"]
        return to_text(data)

    def to_yaml(self, path: str | os.PathLike[str]) -> None:
        """Write the test to a file that `read` reads back to the last bit."""
        with atomic_write(path, overwrite=True) as part:
            part.write_text(self.dumps(folder=Path(path).parent), encoding="utf-8")


def read_test(path: str | os.PathLike[str]) -> tuple[RigTest, Document]:
    """A protocol file, and the lines of its values."""
    text = read_text(path, "a protocol", "examples/rig/paper-protocol.yaml")
    return parse_model(RigTest, text, source=os.fspath(path), folder=Path(path).parent)


_APART = 1_000_003  # between the seeds of sessions


@dataclass(frozen=True)
class Setup:
    """A rig that is not opened yet, and its bench."""

    backend: MovingBackend
    bench: Bench


def build_setup(test: RigTest, session: int = 0) -> Setup:
    """The rig of a test; `session` counts its resumptions."""
    of = build_muscle(test)
    if test.rig.simulated is not None:
        backend, calibrations, drive = _simulated(test.rig.simulated, test, session)
    else:
        assert test.rig.nidaqmx is not None  # the model of the rig sees to it
        backend, calibrations, drive = _card(test.rig.nidaqmx)
    bench = Bench(
        of=of,
        mounted_at=test.muscle.mounted_at,
        drive=drive,
        calibrations=calibrations,
        limits=test.limits,
        rate=backend.rate,
        **explicit_fields(test.recording),
    )
    return Setup(backend, bench)


def build_muscle(test: RigTest) -> Muscle | Specimen:
    """The specimen with its law, or alone if the law is unknown."""
    if test.muscle.law is None:
        return test.muscle.specimen
    return test.muscle.muscle(friction=NoFriction(), creep=NoCreep())


def _simulated(
    spec: SimulatedRigSettings, test: RigTest, session: int
) -> tuple[MovingBackend, Mapping[str, Calibration], Drive]:
    from dataclasses import replace

    from mckibben.rig.simulated import (
        FORCE_SENSOR,
        PRESSURE_SENSOR,
        Converter,
        RealTimeRig,
        Regulator,
        SimulatedRig,
        Stretcher,
    )

    changes = explicit_fields(spec, "seed", "parts", "paced")
    muscle = test.muscle.muscle(**changes, **({"strength": None} if spec.law else {}))
    parts: dict[str, Any] = {}
    if spec.parts == "ideal":
        parts = {
            "regulator": Regulator(hysteresis=0.0, repeatability=0.0, leak=0.0),
            "stretcher": Stretcher(backlash=0.0),
            "converter": Converter(bits=32),
            "force_sensor": replace(FORCE_SENSOR, noise=0.0),
            "pressure_sensor": replace(PRESSURE_SENSOR, noise=0.0),
        }
    twin = SimulatedRig(muscle, seed=spec.seed + _APART * session, mounted_at=test.muscle.mounted_at, **parts)
    return RealTimeRig(twin) if spec.paced else twin, twin.calibrations, twin.drive


def _card(spec: CardSettings) -> tuple[MovingBackend, Mapping[str, Calibration], Drive]:
    from mckibben.rig.ni import NiRig

    calibrations = rig_calibrations(cast(Path, spec.calibration))
    given = {name: getattr(spec, name) for name in ("rate", "patience", "server") if getattr(spec, name) is not None}
    return NiRig(build_wiring(spec), **given), calibrations, Drive(**explicit_fields(spec.drive) if spec.drive else {})


def build_wiring(spec: CardSettings) -> Terminals:
    """Terminals of the card."""
    from mckibben.rig.ni import Terminals

    def at(name: str) -> str:
        return f"{spec.device}/{getattr(spec, name)}"

    return Terminals(
        inputs={name: at(name) for name in ("force", "pressure")},
        outputs={"valve": at("valve")},
        counter=at("counter"),
        heartbeat=at("heartbeat"),
        hold=at("hold"),
        direction=at("direction"),
    )


def rig_calibrations(path: Path) -> dict[str, Calibration]:
    """The calibrations of a JSON file, by channel; `ScenarioError` with all problems."""
    remedy = "calibrate it, see docs/rig-hardware.md"
    found, problems = read_calibrations(path, ("force", "pressure", "valve"), remedy)
    if problems:
        raise ScenarioError(str(path), problems)
    return found
