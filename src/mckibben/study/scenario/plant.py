"""Joint, load, valves, sensors and initial state in a scenario file."""

from __future__ import annotations

import dataclasses
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

from mckibben.config.fields import Flag, read_path, write_path
from mckibben.config.model import ConfigModel, explicit_fields, fail_validation
from mckibben.config.schema import ComponentModel, PartOf, model_of
from mckibben.errors import quoted, suggest
from mckibben.joint import KneeGeometry, Load, SeriesSpring
from mckibben.muscle import MaxwellCreep, MaxwellSlip
from mckibben.plant import FirstOrderValve, SampledSensors, TorquePulses
from mckibben.units import Angle, Distance, Stiffness, Strength


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
    """Text that `read_law` reads."""
    return write_path(value, info) if isinstance(value, Path) else value


Law = Annotated[str | Path, BeforeValidator(read_law), PlainSerializer(write_law, when_used="json")]


def _entry_of(kind: str) -> Any:
    """The field ``from``, which names an entry of the catalog."""
    name: Any = Annotated[str, CatalogName(kind)]
    return name | None, Field(None, alias="from")


class _CatalogPart(ComponentModel):
    """An entry of the catalog by name, with changes, or all numbers."""

    @model_validator(mode="before")
    @classmethod
    def _name_alone(cls, value: Any) -> Any:
        return {"from": value} if isinstance(value, str) and value else value

    @model_serializer(mode="wrap", when_used="json")
    def _write(self, handler: Any) -> Any:
        written = handler(self)
        given = {key: value for key, value in written.items() if value is not None}
        return given["from"] if list(given) == ["from"] else written

    def build(self, *args: Any, **others: Any) -> Any:
        entry = self._entry()
        if entry is None:
            return super().build(*args, **others)
        return dataclasses.replace(entry, **explicit_fields(self, "entry"), **others)

    def effective(self, name: str) -> Any:
        entry = self._entry()
        return super().effective(name) if entry is None or getattr(self, name) is not None else getattr(entry, name)

    def _entry(self) -> Any:
        """The entry of the catalog; None without."""
        name = getattr(self, "entry", None)
        if name is None:
            return None
        from mckibben import catalog

        return catalog.geometry(name) if self.runtime is KneeGeometry else catalog.load(name)


class GeometrySpec(model_of(KneeGeometry, optional=True, base=_CatalogPart, entry=_entry_of("geometries"))):
    """Geometry of the joint: an entry of the catalog by name, or the lengths of `KneeGeometry`.

    In text the name alone will do: ``geometry: knee-table-2``.
    """

    connector_length: Distance | None = Field(None, validate_default=True)

    @field_validator("connector_length", mode="after")
    @classmethod
    def _complete(cls, value: float | None, info: ValidationInfo) -> float | None:
        given = {**info.data, "connector_length": value}
        missing = [key for key in ("joint_length", "joint_radius", "connector_length") if given.get(key, 0) is None]
        if given.get("entry", "") is None and missing:
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
            fail_validation(f"connector_length {value:g} m leaves no length for a muscle in {length:g} m", "shorten it")
        return value


class FrictionSpec(model_of(MaxwellSlip)):
    """Hysteresis and viscous friction of a muscle."""


class CreepSpec(model_of(MaxwellCreep)):
    """Creep of a muscle."""


class MuscleSpec(ConfigModel):
    """A specimen of the catalog and its law: of the catalog, ``chou``, or the path of a fit file.

    `strength` multiplies all forces of the law.
    """

    specimen: Annotated[str, CatalogName("specimens")]
    law: Law
    strength: Strength | None = None
    friction: FrictionSpec | None = None
    creep: CreepSpec | None = None


class SpringSpec(model_of(SeriesSpring)):
    """Preloaded spring in series with each muscle."""


class JointSpec(ConfigModel):
    """A joint with two equal muscles (`muscle`) or two different ones (`muscle1`, the antagonist, and `muscle2`).

    `connector_length` [m] replaces that of the geometry.
    """

    geometry: Annotated[GeometrySpec, PartOf("mckibben.joint:Geometry")]
    connector_length: Distance | None = None
    muscle1: MuscleSpec | None = None
    muscle2: MuscleSpec | None = None
    muscle: MuscleSpec | None = Field(None, validate_default=True)
    spring: SpringSpec | None = None

    @property
    def has_friction(self) -> bool:
        """Whether a muscle of the joint has friction."""
        return any(muscle and muscle.friction for muscle in (self.muscle, self.muscle1, self.muscle2))

    @field_validator("spring", mode="after")
    @classmethod
    def _rate_known(cls, value: SpringSpec | None, info: ValidationInfo) -> SpringSpec | None:
        muscles = [info.data.get(key) for key in ("muscle", "muscle1", "muscle2")]
        if value is not None and any(muscle and muscle.friction and muscle.friction.viscous for muscle in muscles):
            fail_validation(
                "is in series with a muscle that has viscous friction, whose rate of contraction is then unknown",
                "leave out `viscous` or the spring",
            )
        if value is not None and any(muscle and muscle.creep for muscle in muscles):
            fail_validation(
                "is in series with a muscle that creeps, whose rate of contraction is then unknown",
                "leave out `creep` or the spring",
            )
        return value

    @field_validator("connector_length", mode="after")
    @classmethod
    def _said_once(cls, value: float | None, info: ValidationInfo) -> float | None:
        geometry = info.data.get("geometry")
        if value is None or geometry is None:
            return value
        if not isinstance(geometry, GeometrySpec):
            fail_validation("is no part of a geometry with its own class", "give it in the geometry")
        if geometry.connector_length is not None:
            fail_validation("is given in the geometry as well", "keep one of them")
        if geometry.joint_length is not None and value >= geometry.joint_length:
            fail_validation(
                f"{value:g} m leaves no length for a muscle in the joint_length of {geometry.joint_length:g} m",
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


_NEEDED = ("mass1", "mass2", "distance1", "distance2", "inertia", "damping")


class LoadSpec(model_of(Load, optional=True, base=_CatalogPart, entry=_entry_of("loads"))):
    """An entry of the catalog by name, with changes, or the parameters of `Load`.

    In text the name alone will do: ``load: knee-table-2``.
    """

    hanging: Flag | None = Field(None, validate_default=True)

    @field_validator("hanging", mode="after")
    @classmethod
    def _complete(cls, value: bool | None, info: ValidationInfo) -> bool | None:
        given = info.data
        missing = [key for key in _NEEDED if given.get(key, 0.0) is None]
        if given.get("entry", "") is None and missing:
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


class ValveSpec(model_of(FirstOrderValve)):
    """Valve with a first-order lag; in a scenario ``ideal`` stands for none at all."""


class SensorsSpec(model_of(SampledSensors)):
    """Sensor model; ideal sensors without a delay are the default."""


class PulsesSpec(model_of(TorquePulses)):
    """Alternating disturbance torques."""


class DisturbanceSpec(ConfigModel):
    """Disturbance torques on the joint."""

    pulses: PulsesSpec

    def build(self) -> Any:
        """The disturbance."""
        return self.pulses.build()


def _valve_of_catalog(value: Any) -> Any:
    """A section of a valve with the numbers of the catalog's entry that its key ``from`` names."""
    if not isinstance(value, dict) or "from" not in value:
        return value
    from mckibben import catalog

    changes = {key: one for key, one in value.items() if key != "from"}
    return {**catalog.valve_section(CatalogName("valves").read(value["from"])), **changes}


AnyValve = Annotated[ValveSpec, PartOf("mckibben.plant:ValveModel"), BeforeValidator(_valve_of_catalog)]
AnySensors = Annotated[SensorsSpec, PartOf("mckibben.plant:Sensors")]
AnyDisturbance = Annotated[DisturbanceSpec, PartOf("mckibben.plant:Disturbance")]
AnyLoad = Annotated[LoadSpec, PartOf("mckibben.joint:Load")]


class StartSpec(ConfigModel):
    """Initial equilibrium: angle [rad], and stiffness [N*m/rad] (by default the middle of the attainable range)."""

    angle: Angle = 0.0
    stiffness: Stiffness | None = None
