"""Joint, load, valves, sensors and initial state in a scenario file."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from pydantic import (
    BeforeValidator,
    Field,
    GetCoreSchemaHandler,
    PlainSerializer,
    SerializationInfo,
    ValidationInfo,
    field_validator,
    model_serializer,
    model_validator,
)
from pydantic_core import core_schema

from mckibben.config.fields import (
    Angle,
    AngleStep,
    BoundedInt,
    CreepTime,
    Damping,
    Delay,
    Distance,
    Duration,
    Flag,
    Force,
    FrictionForce,
    FrictionGrowth,
    Gravity,
    Inertia,
    Length,
    Mass,
    PositiveTime,
    Presliding,
    Pressure,
    PressureNoise,
    ShortTime,
    SpringRate,
    Stiffness,
    Strength,
    Torque,
    Viscosity,
    read_path,
    write_path,
)
from mckibben.config.model import ConfigModel, fail_validation
from mckibben.errors import quoted, suggest


@dataclass(frozen=True)
class CatalogName:
    """Marks the name of a catalog entry of a kind."""

    kind: str

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> core_schema.CoreSchema:
        return core_schema.no_info_before_validator_function(self.read, handler(source))

    def read(self, value: Any, others: Sequence[str] = ()) -> str:
        """The name, if the catalog has it or it is one of the others."""
        from mckibben import catalog

        known = [*catalog.names(self.kind), *others]
        if value not in known:
            what = {"geometries": "geometry"}.get(self.kind, self.kind.removesuffix("s"))
            fail_validation(f"the catalog has no {what} {quoted(value)}", suggest(str(value), known))
        return value


def read_law(value: Any, info: ValidationInfo) -> str | Path:
    """A law of the catalog, ``chou``, or the path of a fit."""
    if str(value).endswith((".yaml", ".yml")):
        return read_path(value, info, ".yaml")
    return CatalogName("laws").read(value, others=("chou",))


def write_law(value: str | Path, info: SerializationInfo) -> str:
    """What `read_law` reads."""
    return write_path(value, info) if isinstance(value, Path) else value


Law = Annotated[str | Path, BeforeValidator(read_law), PlainSerializer(write_law, when_used="json")]


class GeometrySpec(ConfigModel):
    """Where the muscles run: an entry of the catalog by name, or the three lengths [m] of `KneeGeometry`.

    In text the name alone will do: ``geometry: knee-table-2``.
    """

    base: Annotated[str, CatalogName("geometries")] | None = Field(None, alias="from")
    joint_length: Length | None = None
    joint_radius: Length | None = None
    connector_length: Distance | None = Field(None, validate_default=True)

    @model_validator(mode="before")
    @classmethod
    def _name_alone(cls, value: Any) -> Any:
        return {"from": value} if isinstance(value, str) and value else value

    @field_validator("connector_length", mode="after")
    @classmethod
    def _complete(cls, value: float | None, info: ValidationInfo) -> float | None:
        given = {**info.data, "connector_length": value}
        missing = [key for key in ("joint_length", "joint_radius", "connector_length") if given.get(key, 0) is None]
        if given.get("base", "") is None and missing:
            fail_validation(
                f"lacks {', '.join(missing)}", "give all three lengths, or begin with `from: knee-table-2`", parent=True
            )
        length, radius = given.get("joint_length"), given.get("joint_radius")
        if length is not None and radius is not None and radius >= length:
            fail_validation(
                f"joint_radius {radius:g} m is not below joint_length {length:g} m",
                "choose a smaller radius",
                parent=True,
            )
        if length is not None and value is not None and value >= length:
            fail_validation(f"connector_length {value:g} m leaves no room for a muscle in {length:g} m", "shorten it")
        return value

    @model_serializer(mode="wrap", when_used="json")
    def _write(self, handler: Any) -> Any:
        return shortened(handler(self))


class FrictionSpec(ConfigModel):
    """Hysteresis and viscous friction of a muscle, see `MaxwellSlip`; SI: N, m, N/Pa, Pa, N*s/m."""

    half_width: FrictionForce
    presliding_length: Presliding
    growth: FrictionGrowth = 0.0
    reference_pressure: Pressure = 0.0
    viscous: Viscosity = 0.0

    @model_serializer(mode="wrap", when_used="json")
    def _write(self, handler: Any) -> Any:
        given = {"half_width", "presliding_length"} | {name for name, value in self if value}
        return {name: text for name, text in handler(self).items() if name in given}


class CreepSpec(ConfigModel):
    """Creep of a muscle, see `MaxwellCreep`; SI: N/m, s."""

    stiffness: SpringRate
    time_constant: CreepTime


class MuscleSpec(ConfigModel):
    """A make of muscle from the catalog, and its law: of the catalog, ``chou``, or the path of a fit's file.

    Without `friction` it has none, and without `creep` none of that. With a `strength` all its forces are so many times
    those of the law.
    """

    specimen: Annotated[str, CatalogName("specimens")]
    law: Law
    strength: Strength | None = None
    friction: FrictionSpec | None = None
    creep: CreepSpec | None = None


class SpringSpec(ConfigModel):
    """A preloaded spring in series with each muscle, see `SeriesSpring`; SI: N/m, N, m."""

    stiffness: SpringRate
    preload: Force
    travel: Distance


class JointSpec(ConfigModel):
    """A joint between two muscles, alike (`muscle`) or not (`muscle1`, the antagonist, and `muscle2`).

    `connector_length` [m] takes the place of the geometry's own.
    """

    geometry: GeometrySpec
    connector_length: Distance | None = None
    muscle1: MuscleSpec | None = None
    muscle2: MuscleSpec | None = None
    muscle: MuscleSpec | None = Field(None, validate_default=True)
    spring: SpringSpec | None = None

    @property
    def has_friction(self) -> bool:
        """Whether one of its muscles has."""
        return any(muscle and muscle.friction for muscle in (self.muscle, self.muscle1, self.muscle2))

    @field_validator("spring", mode="after")
    @classmethod
    def _rate_known(cls, value: SpringSpec | None, info: ValidationInfo) -> SpringSpec | None:
        muscles = [info.data.get(key) for key in ("muscle", "muscle1", "muscle2")]
        if value is not None and any(muscle and muscle.friction and muscle.friction.viscous for muscle in muscles):
            fail_validation(
                "stands in series with a muscle of viscous friction, the rate of whose length is then not known",
                "leave out `viscous` or the spring",
            )
        if value is not None and any(muscle and muscle.creep for muscle in muscles):
            fail_validation(
                "stands in series with a muscle that creeps, the rate of whose length is then not known",
                "leave out `creep` or the spring",
            )
        return value

    @field_validator("connector_length", mode="after")
    @classmethod
    def _said_once(cls, value: float | None, info: ValidationInfo) -> float | None:
        geometry = info.data.get("geometry")
        if value is None or geometry is None:
            return value
        if geometry.connector_length is not None:
            fail_validation("is given in the geometry as well", "keep one of them")
        if geometry.joint_length is not None and value >= geometry.joint_length:
            fail_validation(
                f"{value:g} m leaves no room for a muscle in the joint_length of {geometry.joint_length:g} m",
                "shorten it",
            )
        return value

    @field_validator("muscle", mode="after")
    @classmethod
    def _two_muscles(cls, value: MuscleSpec | None, info: ValidationInfo) -> MuscleSpec | None:
        given = [key for key in ("muscle1", "muscle2") if info.data.get(key, "wrong") is not None]
        if value is not None and given:
            fail_validation(
                f"is given beside {' and '.join(given)}", "give `muscle` for both, or `muscle1` and `muscle2`"
            )
        if value is None and len(given) < 2:
            lacking = [key for key in ("muscle1", "muscle2") if key not in given]
            what = f"lacks {lacking[0]}" if given else "lacks its muscles"
            fail_validation(what, "give `muscle` for both, or `muscle1` and `muscle2`", parent=True)
        return value


def shortened(written: dict[str, Any]) -> Any:
    """A mapping that holds no more than the name of a catalog entry, as that name."""
    given = {key: value for key, value in written.items() if value is not None}
    return given["from"] if list(given) == ["from"] else written


_NEEDED = ("mass1", "mass2", "distance1", "distance2", "inertia", "damping")


class LoadSpec(ConfigModel):
    """An entry of the catalog by name, changed where said, or the numbers of `Load` in SI.

    In text the name alone will do: ``load: knee-table-2``.
    """

    base: Annotated[str, CatalogName("loads")] | None = Field(None, alias="from")
    mass1: Mass | None = None
    mass2: Mass | None = None
    distance1: Distance | None = None
    distance2: Distance | None = None
    inertia: Inertia | None = None
    damping: Damping | None = None
    hanging_angle: Angle | None = None
    gravity: Gravity | None = None
    hanging: Flag | None = Field(None, validate_default=True)

    @model_validator(mode="before")
    @classmethod
    def _name_alone(cls, value: Any) -> Any:
        return {"from": value} if isinstance(value, str) and value else value

    @field_validator("hanging", mode="after")
    @classmethod
    def _complete(cls, value: bool | None, info: ValidationInfo) -> bool | None:
        given = info.data
        missing = [key for key in _NEEDED if given.get(key, 0.0) is None]
        if given.get("base", "") is None and missing:
            fail_validation(
                f"lacks {', '.join(missing)}", "give all of it, or begin with `from: knee-table-2`", parent=True
            )
        parts = [given.get(key, 1.0) for key in ("inertia", "mass1", "distance1", "mass2", "distance2")]
        if all(part is not None for part in parts):
            inertia, mass1, distance1, mass2, distance2 = parts
            if inertia + mass1 * distance1**2 + mass2 * distance2**2 < 1e-9:
                fail_validation(
                    "has no inertia: the joint could not move", "give `inertia`, or masses at a distance", parent=True
                )
        return value

    @model_serializer(mode="wrap", when_used="json")
    def _write(self, handler: Any) -> Any:
        return shortened(handler(self))


class ValveSpec(ConfigModel):
    """A valve that follows its command with a lag [s]; in a scenario ``ideal`` stands for none at all."""

    time_constant: PositiveTime


class SensorsSpec(ConfigModel):
    """What the controller is told, see `SampledSensors`; a scenario without it has the truth, at once."""

    encoder: AngleStep = 0.0
    pressure_noise: PressureNoise = 0.0
    delay: Delay = 0.0
    seed: Annotated[int, BoundedInt(0, 2**31 - 1)] = 0


class PulsesSpec(ConfigModel):
    """Pushes to and fro, see `TorquePulses`."""

    height: Torque
    width: PositiveTime
    interval: Duration
    start: ShortTime


class DisturbanceSpec(ConfigModel):
    """What pushes from outside: `pulses`."""

    pulses: PulsesSpec


class StartSpec(ConfigModel):
    """Where the joint rests at the start: angle [rad] and, unless it is to be in the middle, stiffness [N*m/rad]."""

    angle: Angle = 0.0
    stiffness: Stiffness | None = None
