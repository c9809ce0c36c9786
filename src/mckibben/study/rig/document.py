"""Protocol files, and the runtime objects of their sections."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, cast

from pydantic import Field, ValidationInfo, field_validator

from mckibben.component.schema import PartOf, model_of
from mckibben.config.document import Document, to_text
from mckibben.config.fields import Flag, OneOf, Title
from mckibben.config.model import ConfigModel, explicit_fields, fail_validation, parse_model, read_text
from mckibben.errors import ScenarioError
from mckibben.muscle import Muscle, Specimen
from mckibben.rig.backend import MovingBackend
from mckibben.rig.bench import Bench, Drive, RigLimits
from mckibben.rig.calibration import Calibration, read_calibrations
from mckibben.rig.steps import Step, steps_of
from mckibben.storage.files import atomic_write
from mckibben.study.rig.steps import Address, JsonPath, ProtocolSpec, steps
from mckibben.study.scenario.muscle import CreepSpec, FrictionSpec, Law, MuscleSpec
from mckibben.units import (
    BoundedInt,
    Contraction,
    Factor,
    PositiveTime,
    SampleRate,
    Tension,
    Travel,
)

if TYPE_CHECKING:
    from mckibben.rig.ni import Terminals


class TestedMuscleSpec(MuscleSpec):
    """Muscle under test; the boundaries of the test follow from its `law`, or are found without one.

    Friction and creep are those of the simulated rig's muscle, unless it has its own.
    """

    law: Law | None = None  # type: ignore[assignment]
    mounted_at: Contraction = 0.0


class SimulatedRigSpec(ConfigModel):
    """The simulated rig: law, friction and creep of its muscle (default: those of `muscle`), real or ideal parts."""

    seed: Annotated[int, BoundedInt(0, 2**31 - 1)] = 0
    law: Law | None = None
    friction: FrictionSpec | None = None
    creep: CreepSpec | None = None
    parts: Annotated[str, OneOf(("real", "ideal"))] | None = None
    paced: Flag | None = None


class DriveSpec(ConfigModel):
    """The motor, its reducer and its lead screw, see `Drive`; the paper's unless given."""

    steps: Annotated[int, BoundedInt(1, 1_000_000)] | None = None
    reduction: Factor | None = None
    lead: Travel | None = None
    fastest: SampleRate | None = None


class CardSpec(ConfigModel):
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
    drive: DriveSpec | None = None


class RigSpec(ConfigModel):
    """One of `simulated` and `nidaqmx`; with the key ``class``, a `MovingBackend` of one's own, a dataclass."""

    renamed: ClassVar = {"virtual": "simulated"}

    simulated: SimulatedRigSpec | None = None
    nidaqmx: CardSpec | None = Field(None, validate_default=True)

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

    def backend(self, test: RigTest, session: int) -> MovingBackend:
        """The rig, which is not opened yet."""
        if self.simulated is not None:
            return _simulated(self.simulated, test, session)
        assert self.nidaqmx is not None  # `_one` sees to it
        return _card(self.nidaqmx)


class LimitsSpec(model_of(RigLimits)):
    """Safety limits; the force is the rated one unless given."""

    force: Tension | None = None


class RecordingSpec(model_of(Bench, optional=True)):
    """Cycle of the safety monitor, sample rate between plateaus, and force below which a point is slack."""


class RigTest(ConfigModel):
    """A test: specimen, rig, limits and protocol in SI; `read` and `to_yaml` know the units."""

    name: Title = Field(examples=["isobaric test of a new muscle"])
    muscle: TestedMuscleSpec
    rig: Annotated[RigSpec, PartOf("mckibben.rig.backend:MovingBackend")]
    limits: LimitsSpec
    recording: RecordingSpec = RecordingSpec()
    protocol: ProtocolSpec

    @field_validator("rig", mode="after")
    @classmethod
    def _law_known(cls, value: RigSpec, info: ValidationInfo) -> RigSpec:
        muscle = info.data.get("muscle")
        simulated = value.simulated if isinstance(value, RigSpec) else None
        if simulated is not None and simulated.law is None and muscle is not None and muscle.law is None:
            fail_validation(
                "has no law for its simulated muscle", "give `simulated: {law: lei-mas-10-180n}`, or the muscle a law"
            )
        return value

    @field_validator("limits", mode="after")
    @classmethod
    def _force_known(cls, value: LimitsSpec, info: ValidationInfo) -> LimitsSpec:
        muscle = info.data.get("muscle")
        if value.force is None and muscle is not None and muscle.specimen.effective("rated_force") is None:
            fail_validation("has no force, and the specimen no rated_force", "give `force`, such as `force: 200 N`")
        return value

    @property
    def physical(self) -> bool:
        """Whether it moves a real muscle."""
        return not isinstance(self.rig, RigSpec) or self.rig.simulated is None

    def is_same(self, other: RigTest) -> bool:
        """Whether two tests are the same, if on the same hardware at other terminals."""
        moved = self.physical and other.physical and type(self.rig) is type(other.rig)
        return (self.model_copy(update={"rig": other.rig}) if moved else self) == other

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
    rig: Any = test.rig
    backend: MovingBackend = rig.backend(test, session) if isinstance(rig, RigSpec) else rig.build()
    specimen = of.specimen if isinstance(of, Muscle) else of
    limits = RigLimits(**{"force": specimen.force_limit, **explicit_fields(test.limits)})
    bench = Bench(
        of=of,
        mounted_at=test.muscle.mounted_at,
        drive=backend.drive,
        calibrations=backend.calibrations,
        limits=limits,
        rate=backend.rate,
        **explicit_fields(test.recording),
    )
    return Setup(backend, bench)


def build_muscle(test: RigTest) -> Muscle | Specimen:
    """The specimen with its law, or alone if the law is unknown."""
    muscle = test.muscle.model_copy(update={"friction": None, "creep": None})
    return muscle.specimen.build() if muscle.law is None else muscle.build()


def build_steps(protocol: ProtocolSpec, of: Muscle | Specimen) -> tuple[Step, ...]:
    """The steps of a protocol; `RangeError` if a whole test does not suit the muscle."""
    if protocol.steps is not None:
        return steps(protocol.steps)
    return steps_of(getattr(protocol, protocol.form).build(), of)


def _simulated(spec: SimulatedRigSpec, test: RigTest, session: int) -> MovingBackend:
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
    muscle = test.muscle.model_copy(update={**changes, "strength": None} if spec.law else changes).build()
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
    return RealTimeRig(twin) if spec.paced else twin


def _card(spec: CardSpec) -> MovingBackend:
    from mckibben.rig.ni import NiRig

    calibrations = rig_calibrations(cast(Path, spec.calibration))
    given = {name: getattr(spec, name) for name in ("rate", "patience", "server") if getattr(spec, name) is not None}
    drive = Drive(**explicit_fields(spec.drive) if spec.drive else {})
    return NiRig(build_wiring(spec), **given, calibrations=calibrations, drive=drive)


def build_wiring(spec: CardSpec) -> Terminals:
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
