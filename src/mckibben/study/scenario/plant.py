"""Joint, load, valves, sensors and initial state in a scenario file."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import BeforeValidator, Field, ValidationInfo, field_validator, model_validator

from mckibben.component.schema import PartOf, model_of
from mckibben.config.fields import Flag
from mckibben.config.model import ConfigModel, fail_validation
from mckibben.errors import quoted
from mckibben.joint import GeneralLoad, KneeGeometry, KneeLoad, PendulumLoad, SeriesSpring
from mckibben.muscle import Muscle, SpringLaw, return_spring
from mckibben.plant import FirstOrderValve, JointFriction, SampledSensors, TorquePulses
from mckibben.study.scenario.muscle import CatalogName, CatalogPart, MuscleSpec, entry_of, expanded
from mckibben.units import Angle, Distance, Stiffness, Strength, Torque


class GeometrySpec(model_of(KneeGeometry, optional=True, base=CatalogPart, entry=entry_of("geometries"))):
    """Geometry of the joint: an entry of the catalog by name, or the lengths of `KneeGeometry`.

    In text the name alone will do: ``geometry: knee-table-2``.
    """

    catalog_function = "geometry"

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


class SpringSpec(model_of(SeriesSpring)):
    """Preloaded spring in series with each muscle."""


class ReturnSpringSpec(model_of(SpringLaw, without=("domain",))):
    """Tension spring in place of a muscle."""

    def build(self, *args: Any, **others: Any) -> Muscle:
        """The spring as a muscle whose pressure is 0."""
        return return_spring(self.rate, self.free_length)


class JointSpec(ConfigModel):
    """A joint with two equal muscles (`muscle`) or two different ones (`muscle1`, the antagonist, and `muscle2`).

    `return_spring1` or `return_spring2` is in place of that muscle. `connector_length` [m] replaces that of the
    geometry, `arm_scale` multiplies its moment arms. In text the path of a file will do: ``model: model.yaml``.
    """

    geometry: Annotated[GeometrySpec, PartOf("mckibben.joint:Geometry")]
    connector_length: Distance | None = None
    arm_scale: Strength | None = None
    muscle1: MuscleSpec | None = None
    muscle2: MuscleSpec | None = None
    return_spring1: ReturnSpringSpec | None = None
    return_spring2: ReturnSpringSpec | None = None
    muscle: MuscleSpec | None = Field(None, validate_default=True)
    spring: SpringSpec | None = None

    @model_validator(mode="before")
    @classmethod
    def _from_file(cls, value: Any, info: ValidationInfo) -> Any:
        if isinstance(value, str) and value and not value.endswith(".yaml"):
            fail_validation(f"{quoted(value)} is no joint's file", "name a .yaml file, or give geometry and muscles")
        return expanded(cls, value, info)

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
        springs = [key for key in ("return_spring1", "return_spring2") if info.data.get(key) is not None]
        given = [key for key in ("muscle1", "muscle2") if info.data.get(key, "wrong") is not None]
        if springs:
            muscle = f"muscle{2 if springs[0].endswith('1') else 1}"
            if len(springs) == 2 or (value is not None) + len(given) != 1 or given not in ([], [muscle]):
                fail_validation(f"has {springs[0]} beside other than one muscle", f"give `{muscle}` alone", parent=True)
            return value
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


class LoadSpec(model_of(KneeLoad, optional=True, base=CatalogPart, entry=entry_of("loads"))):
    """An entry of the catalog by name, with changes, or the parameters of `KneeLoad`.

    In text the name alone will do: ``load: knee-table-2``.
    """

    catalog_function = "load"

    hanging: Flag | None = Field(None, validate_default=True)

    @field_validator("hanging", mode="after")
    @classmethod
    def _complete(cls, value: bool | None, info: ValidationInfo) -> bool | None:
        given = info.data
        missing = [key for key in _NEEDED if given.get(key, 0.0) is None]
        if given.get("entry", "") is None and missing:
            fail_validation(
                f"lacks {', '.join(missing)}",
                "give all of it, or begin with `from: knee-table-2`; or give a pendulum by `mass` and `length`, or any "
                "load by `inertia` and `gravity_torque`",
                parent=True,
            )
        parts = [given.get(key, 1.0) for key in ("inertia", "mass1", "distance1", "mass2", "distance2")]
        if all(part is not None for part in parts):
            inertia, mass1, distance1, mass2, distance2 = parts
            if inertia + mass1 * distance1**2 + mass2 * distance2**2 < 1e-9:
                fail_validation(
                    "has no inertia: the joint could not move", "give `inertia`, or masses at a distance", parent=True
                )
        return value


class PendulumLoadSpec(model_of(PendulumLoad)):
    """A pendulum: ``load: {mass: 0.3 kg, length: 250 mm}``."""

    own_keys = frozenset({"mass", "length"})


class GeneralLoadSpec(
    model_of(GeneralLoad, greatest_gravity_torque=(Torque, Field(alias="gravity_torque", examples=["0 N*m"])))
):
    """A load by its numbers: ``load: {inertia: 0.02 kg*m^2, gravity_torque: 0.7 N*m}``."""

    own_keys = frozenset({"gravity_torque"})


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


class JointFrictionSpec(model_of(JointFriction)):
    """Dry friction of the joint itself: ``friction: {torque: 0.3 N*m, presliding: 0.5 deg}``."""


def _valve_of_catalog(value: Any) -> Any:
    """A section of a valve with the numbers of the catalog's entry that its key ``from`` names."""
    if not isinstance(value, dict) or "from" not in value:
        return value
    from mckibben import catalog

    changes = {key: one for key, one in value.items() if key != "from"}
    return {**catalog.valve_section(CatalogName("valves").read(value["from"])), **changes}


AnyValve = Annotated[ValveSpec, PartOf("mckibben.plant:Actuator"), BeforeValidator(_valve_of_catalog)]
AnySensors = Annotated[SensorsSpec, PartOf("mckibben.plant:Sensors")]
AnyDisturbance = Annotated[DisturbanceSpec, PartOf("mckibben.plant:Disturbance")]
AnyLoad = Annotated[LoadSpec, PartOf("mckibben.joint:Load", others=(PendulumLoadSpec, GeneralLoadSpec))]


class StartSpec(ConfigModel):
    """Initial equilibrium: angle [rad], and stiffness [N*m/rad] (by default the middle of the attainable range)."""

    angle: Angle = 0.0
    stiffness: Stiffness | None = None
