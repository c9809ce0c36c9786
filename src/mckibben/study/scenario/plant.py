"""What a scenario's joint moves, through which valves, and from where it starts."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import Field, ValidationInfo, field_validator, model_serializer, model_validator

from mckibben.study.scenario.fields import (
    Angle,
    AngleStep,
    Damping,
    Delay,
    Distance,
    Duration,
    Flag,
    Gravity,
    Inertia,
    Mass,
    PositiveTime,
    PressureNoise,
    ShortTime,
    Stiffness,
    Torque,
)
from mckibben.study.scenario.joint import shortened
from mckibben.study.scenario.part import Part, refuse
from mckibben.study.scenario.words import Entry, Whole

_NEEDED = ("mass1", "mass2", "distance1", "distance2", "inertia", "damping")


class LoadSpec(Part):
    """An entry of the catalog by name, changed where said, or the numbers of `Load` in SI.

    In text the name alone will do: ``load: knee-table-2``.
    """

    base: Annotated[str, Entry("loads")] | None = Field(None, alias="from")
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
            refuse(f"lacks {', '.join(missing)}", "give all of it, or begin with `from: knee-table-2`", parent=True)
        parts = [given.get(key, 1.0) for key in ("inertia", "mass1", "distance1", "mass2", "distance2")]
        if all(part is not None for part in parts):
            inertia, mass1, distance1, mass2, distance2 = parts
            if inertia + mass1 * distance1**2 + mass2 * distance2**2 < 1e-9:
                refuse(
                    "has no inertia: the joint could not move", "give `inertia`, or masses at a distance", parent=True
                )
        return value

    @model_serializer(mode="wrap", when_used="json")
    def _write(self, handler: Any) -> Any:
        return shortened(handler(self))


class ValveSpec(Part):
    """A valve that follows its command with a lag [s]; in a scenario ``ideal`` stands for none at all."""

    time_constant: PositiveTime


class SensorsSpec(Part):
    """What the controller is told, see `SampledSensors`; a scenario without it has the truth, at once."""

    encoder: AngleStep = 0.0
    pressure_noise: PressureNoise = 0.0
    delay: Delay = 0.0
    seed: Annotated[int, Whole(0, 2**31 - 1)] = 0


class PulsesSpec(Part):
    """Pushes to and fro, see `TorquePulses`."""

    height: Torque
    width: PositiveTime
    interval: Duration
    start: ShortTime


class DisturbanceSpec(Part):
    """What pushes from outside: `pulses`."""

    pulses: PulsesSpec


class StartSpec(Part):
    """Where the joint rests at the start: angle [rad] and, unless it is to be in the middle, stiffness [N*m/rad]."""

    angle: Angle = 0.0
    stiffness: Stiffness | None = None
