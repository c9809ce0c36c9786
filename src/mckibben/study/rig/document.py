"""A protocol file: everything that one test on a rig needs."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated, Any, ClassVar

from pydantic import Field, ValidationInfo, field_validator

from mckibben.config.document import Document, to_text
from mckibben.config.fields import Flag, OneOf, Title
from mckibben.config.model import ConfigModel, fail_validation, parse_model, read_text
from mckibben.config.schema import model_of
from mckibben.rig.bench import Bench, RigLimits
from mckibben.storage.files import whole
from mckibben.study.rig.steps import Address, JsonPath, ProtocolSpec
from mckibben.study.scenario.plant import CatalogName, CreepSpec, FrictionSpec, Law
from mckibben.units import (
    BoundedInt,
    Contraction,
    Factor,
    PositiveTime,
    SampleRate,
    Tension,
    Travel,
)


class TestedMuscleSpec(ConfigModel):
    """Specimen under test.

    With a `law` the boundaries of the test follow from it; without one the test finds them.
    """

    specimen: Annotated[str, CatalogName("specimens")]
    law: Law | None = None
    mounted_at: Contraction = 0.0


class SimulatedRigSpec(ConfigModel):
    """The simulated rig, see `SimulatedRig`.

    Its muscle follows `law` (default: that of `muscle`), with friction and creep where given. Its `parts` are real
    (noise, offsets, backlash, resolution) or ideal.
    """

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
    """One of `simulated` and `nidaqmx`."""

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


class LimitsSpec(model_of(RigLimits)):
    """Safety limits; the force is the rated one unless given."""

    force: Tension | None = None


class RecordingSpec(model_of(Bench, optional=True)):
    """Cycle of the safety monitor, sample rate between plateaus, and force below which a point is slack."""


class RigTest(ConfigModel):
    """A test: specimen, rig, limits and protocol in SI; `read` and `to_yaml` know the units.

    Attributes
    ----------
    name
        One line of text.
    muscle
        Specimen and law.
    rig
        Simulated rig, or a card.
    limits
        Safety limits.
    recording
        Cycle of the safety monitor, sample rate between plateaus.
    protocol
        Steps, or a whole test.

    Examples
    --------
    >>> test = RigTest.read("examples/rig/paper-protocol.yaml")
    >>> test.protocol.form, test.muscle.specimen
    ('isobaric', 'MAS-10-180N-AA-MC-O')
    """

    name: Title = Field(examples=["isobaric test of a new muscle"])
    muscle: TestedMuscleSpec
    rig: RigSpec
    limits: LimitsSpec
    recording: RecordingSpec = RecordingSpec()
    protocol: ProtocolSpec

    @field_validator("rig", mode="after")
    @classmethod
    def _law_known(cls, value: RigSpec, info: ValidationInfo) -> RigSpec:
        muscle = info.data.get("muscle")
        if value.simulated is not None and value.simulated.law is None and muscle is not None and muscle.law is None:
            fail_validation(
                "has no law for its simulated muscle", "give `simulated: {law: lei-mas-10-180n}`, or the muscle a law"
            )
        return value

    @classmethod
    def read(cls, path: str | os.PathLike[str]) -> RigTest:
        """Read a protocol file.

        Raises
        ------
        ScenarioError
            With every problem of the file: line, field, value, allowed range and remedy.
        """
        return read_test(path)[0]

    @classmethod
    def parse(cls, text: str, *, source: str = "protocol", folder: str | os.PathLike[str] = ".") -> RigTest:
        """Read a protocol from text, in which paths are relative to a folder.

        Raises
        ------
        ScenarioError
            With every problem of the text.
        """
        return parse_model(RigTest, text, source=source, folder=folder)[0]

    def dumps(self, *, folder: str | os.PathLike[str] = ".") -> str:
        """The test as text that `parse` reads back to the last bit; paths are relative to a folder."""
        data = self.model_dump(mode="json", by_alias=True, context={"folder": Path(folder)})
        if not any(value is not None for value in self.recording.model_dump().values()):
            del data["recording"]
        return to_text(data)

    def to_yaml(self, path: str | os.PathLike[str]) -> None:
        """Write the test to a file that `read` reads back to the last bit."""
        with whole(path) as part:
            part.write_text(self.dumps(folder=Path(path).parent), encoding="utf-8")


def read_test(path: str | os.PathLike[str]) -> tuple[RigTest, Document]:
    """A protocol file, and the lines of its values.

    Raises
    ------
    ScenarioError
        As `RigTest.read`.
    """
    text = read_text(path, "a protocol", "examples/rig/paper-protocol.yaml")
    return parse_model(RigTest, text, source=os.fspath(path), folder=Path(path).parent)
