"""Steps and procedures in a protocol file."""

from __future__ import annotations

import re
from typing import Annotated, Any

from pydantic import (
    BeforeValidator,
    Field,
    PlainSerializer,
    SerializationInfo,
    ValidationInfo,
    field_validator,
    model_serializer,
    model_validator,
)

from mckibben.config.fields import Flag, OneOf, read_path, write_path
from mckibben.config.model import ConfigModel, explicit_fields, fail_validation
from mckibben.errors import quoted, suggest
from mckibben.rig import steps as typed
from mckibben.units import BoundedInt, Duration, Force, Pressure, PressureRate, Quantity, quantity, show

_BARE = re.compile(r"[-+]?\d{1,9}(\.\d{0,9})?")
_ADDRESS = re.compile(r"[A-Za-z0-9_.:/-]{1,80}")


class Percent(Quantity):
    """Marks a ratio that is written in percent."""

    def read(self, value: Any) -> float:
        """The ratio, checked; one without a unit is a ratio."""
        if isinstance(value, str) and _BARE.fullmatch(value.strip()) and not self.holds(float(value)):
            fail_validation(
                f"{quoted(value)} has no unit, and as a ratio is outside {self.range}", f"write '{value.strip()} %'"
            )
        return super().read(value)

    def write(self, value: float) -> str:
        """Text that `read` takes back to the same float, in percent wherever that is possible."""
        texts = (show(value, "%", digits) for digits in (15, 16, 17))
        return next((text for text in texts if quantity(text, "1") == value), super().write(value))

    @property
    def example(self) -> str:
        """A value as it is written."""
        return "'10 %'"

    @property
    def range(self) -> str:
        """The range, in words."""
        return f"{self.lower:g} to {'below ' if self.open_upper else ''}{self.upper:g} %"


Contraction = Annotated[float, Percent("1", "%", -50, 80)]
Share = Annotated[float, Percent("1", "%", 0, 100, open_upper=True)]
Speed = Annotated[float, Quantity("m/s", "mm/s", 0, 1e3, open_lower=True)]
Way = Annotated[float, Quantity("m", "mm", 0, 1e4, open_lower=True)]
Wait = Annotated[float, Quantity("s", "s", 0, 1e6)]
Tension = Annotated[float, Quantity("N", "N", 0, 1e5, open_lower=True)]
SampleRate = Annotated[float, Quantity("1/s", "Hz", 0.001, 1e6)]
Factor = Annotated[float, Quantity("1", "1", 0, 1e6, open_lower=True)]


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


_MOST = 1_000_000
Direction = Annotated[str, OneOf(typed.DIRECTIONS[1:])]
Phase = Annotated[str, OneOf(typed.PHASES[1:])]


class MoveSpec(ConfigModel):
    """Stretch or shorten; ``move: 10 %`` is one with the paper's speed."""

    to: Contraction
    speed: Speed | None = None

    @model_validator(mode="before")
    @classmethod
    def _alone(cls, value: Any) -> Any:
        return {"to": value} if isinstance(value, str) and value else value


class DwellSpec(ConfigModel):
    """Wait: ``dwell: 5 s``."""

    duration: Wait

    @model_validator(mode="before")
    @classmethod
    def _alone(cls, value: Any) -> Any:
        return {"duration": value} if isinstance(value, str) and value else value


class PressuriseSpec(ConfigModel):
    """Set a pressure; ``pressurise: 2 bar`` is one at once."""

    pressure: Pressure
    rate: PressureRate | None = None
    holding: Tension | None = None

    @model_validator(mode="before")
    @classmethod
    def _alone(cls, value: Any) -> Any:
        return {"pressure": value} if isinstance(value, str) and value else value


class HoldForceSpec(ConfigModel):
    """Move until it pulls with a force; ``hold_force: 100 N``."""

    force: Tension
    tolerance: Tension | None = None
    speed: Speed | None = None
    longest: Duration | None = None

    @model_validator(mode="before")
    @classmethod
    def _alone(cls, value: Any) -> Any:
        return {"force": value} if isinstance(value, str) and value else value


class AcquireSpec(ConfigModel):
    """Take a point; nothing given is the paper's 1000 samples in 1 s."""

    samples: Annotated[int, BoundedInt(1, _MOST)] | None = None
    duration: Duration | None = None
    direction: Direction | None = None
    phase: Phase | None = None
    keep: Flag | None = None


class WalkSpec(ConfigModel):
    """Plateau after plateau; without `to` back to where the walk before began."""

    to: Contraction | None = None
    step: Way | None = None
    speed: Speed | None = None
    dwell: Wait | None = None
    acquire: AcquireSpec | None = None
    force: Tension | None = None
    slack: Annotated[int, BoundedInt(1, 10_000)] | None = None
    slack_force: Force | None = None


class VentSpec(ConfigModel):
    """Let the air out."""


class RepeatSpec(ConfigModel):
    """Steps several times."""

    times: Annotated[int, BoundedInt(1, 10_000)]
    steps: tuple[StepSpec, ...]

    @field_validator("steps", mode="after")
    @classmethod
    def _some(cls, value: Any) -> Any:
        return value or fail_validation("is empty", "give at least one")


_WORDS = ("vent", "acquire", "walk")
_ALONE = {"move": "to", "dwell": "duration", "pressurise": "pressure", "hold_force": "force"}
_KINDS = ("move", "dwell", "pressurise", "hold_force", "acquire", "walk", "vent", "repeat")


class StepSpec(ConfigModel):
    """One of the steps; ``vent``, ``acquire`` and ``walk`` alone will do."""

    move: MoveSpec | None = None
    dwell: DwellSpec | None = None
    pressurise: PressuriseSpec | None = None
    hold_force: HoldForceSpec | None = None
    acquire: AcquireSpec | None = None
    walk: WalkSpec | None = None
    vent: VentSpec | None = None
    repeat: RepeatSpec | None = Field(default=None, validate_default=True)

    @model_validator(mode="before")
    @classmethod
    def _word_alone(cls, value: Any) -> Any:
        if isinstance(value, str):
            if value not in _WORDS:
                fail_validation(f"{value[:40]!r} is no step", suggest(value, _KINDS))
            return {value: {}}
        if isinstance(value, dict):
            for key in value:
                if key not in _KINDS:
                    fail_validation(f"{key[:40]!r} is no step", suggest(str(key), _KINDS))
            return {key: {} if key in _WORDS and inner == "" else inner for key, inner in value.items()}
        return value

    @field_validator("repeat", mode="after")
    @classmethod
    def _one_kind(cls, value: Any, info: ValidationInfo) -> Any:
        given = {**{key: info.data.get(key, "wrong") for key in _KINDS[:-1]}, "repeat": value}
        chosen = [key for key in _KINDS if given[key] is not None]
        if len(chosen) != 1:
            what = f"is {' and '.join(chosen)} at once" if chosen else "is empty"
            fail_validation(what, f"give one of {', '.join(_KINDS)} for each step", parent=True)
        return value

    @model_serializer(mode="plain", when_used="json")
    def _write(self) -> Any:
        if self.repeat is not None:
            return {"repeat": {"times": self.repeat.times, "steps": [step._write() for step in self.repeat.steps]}}
        kind, part = next((kind, part) for kind, part in self if part is not None)
        inside = _pruned(part.model_dump(mode="json"))
        if not inside and kind in _WORDS:
            return kind
        return {kind: next(iter(inside.values())) if list(inside) == [_ALONE.get(kind)] else inside}

    def step(self) -> typed.Step:
        """The step."""
        if self.repeat is not None:
            return typed.Repeat(times=self.repeat.times, steps=steps(self.repeat.steps))
        if self.walk is not None:
            given = explicit_fields(self.walk, "acquire", "to")
            acquire = typed.Acquire(**explicit_fields(self.walk.acquire)) if self.walk.acquire else typed.Acquire()
            return typed.Walk(to=self.walk.to, acquire=acquire, **given)
        if self.move is not None:
            return typed.Move(**explicit_fields(self.move))
        if self.dwell is not None:
            return typed.Dwell(duration=self.dwell.duration)
        if self.pressurise is not None:
            return typed.Pressurise(**explicit_fields(self.pressurise))
        if self.hold_force is not None:
            return typed.HoldForce(**explicit_fields(self.hold_force))
        return typed.Acquire(**explicit_fields(self.acquire)) if self.acquire is not None else typed.Vent()

    @classmethod
    def of(cls, step: typed.Step) -> StepSpec:
        """As it is written."""
        match step:
            case typed.Repeat():
                return cls(repeat=RepeatSpec(times=step.times, steps=tuple(map(cls.of, step.steps))))
            case typed.Walk():
                values = _changed(step, "acquire")
                acquire = _changed(step.acquire)
                return cls(walk=WalkSpec(**values, acquire=AcquireSpec(**acquire) if acquire else None))
            case typed.Move():
                return cls(move=MoveSpec(**_changed(step)))
            case typed.Dwell():
                return cls(dwell=DwellSpec(duration=step.duration))
            case typed.Pressurise():
                return cls(pressurise=PressuriseSpec(**_changed(step)))
            case typed.HoldForce():
                return cls(hold_force=HoldForceSpec(**_changed(step)))
            case typed.Acquire():
                return cls(acquire=AcquireSpec(**_changed(step)))
            case typed.Vent():
                return cls(vent=VentSpec())


RepeatSpec.model_rebuild()


def steps(written: tuple[StepSpec, ...]) -> tuple[typed.Step, ...]:
    """The steps."""
    return tuple(one.step() for one in written)


def _changed(step: Any, *without: str) -> dict[str, Any]:
    """The fields of a step that differ from their default."""
    fields = type(step).__dataclass_fields__
    return {
        name: getattr(step, name)
        for name, field in fields.items()
        if name not in without and getattr(step, name) != field.default
    }


def _pruned(value: Any) -> Any:
    return {key: _pruned(item) for key, item in value.items() if item is not None} if isinstance(value, dict) else value


_Count = Annotated[int, BoundedInt(1, 1_000_000)]
_Repeats = Annotated[int, BoundedInt(1, 10_000)]


class IsobaricSpec(ConfigModel):
    """See `IsobaricProtocol`."""

    pressures: tuple[Pressure, ...] | None = None
    contraction_min: Contraction | None = None
    contraction_max: Contraction | None = None
    step: Way | None = None
    speed: Speed | None = None
    dwell: Wait | None = None
    acquisition: Duration | None = None
    samples: _Count | None = None
    repeats: _Repeats | None = None
    force_reserve: Share | None = None
    slack_steps: _Repeats | None = None


class IsometricSpec(ConfigModel):
    """See `IsometricProtocol`."""

    contractions: tuple[Contraction, ...] | None = None
    pressures: tuple[Pressure, ...] | None = None
    rate: PressureRate | None = None
    speed: Speed | None = None
    dwell: Wait | None = None
    acquisition: Duration | None = None
    samples: _Count | None = None
    repeats: _Repeats | None = None


class IsotonicSpec(ConfigModel):
    """See `IsotonicProtocol`."""

    forces: tuple[Tension, ...] | None = None
    pressures: tuple[Pressure, ...] | None = None
    rate: PressureRate | None = None
    tolerance: Force | None = None
    speed: Speed | None = None
    dwell: Wait | None = None
    acquisition: Duration | None = None
    samples: _Count | None = None
    repeats: _Repeats | None = None


_FORMS = ("isobaric", "isometric", "isotonic", "steps")


class ProtocolSpec(ConfigModel):
    """One of the whole tests, or `steps`; a whole test's name alone is one with all its defaults."""

    isobaric: IsobaricSpec | None = None
    isometric: IsometricSpec | None = None
    isotonic: IsotonicSpec | None = None
    steps: tuple[StepSpec, ...] | None = Field(None, validate_default=True)

    @field_validator("isobaric", "isometric", "isotonic", mode="before")
    @classmethod
    def _defaults(cls, value: Any) -> Any:
        return {} if value == "" else value

    @field_validator("steps", mode="after")
    @classmethod
    def _one_form(cls, value: Any, info: ValidationInfo) -> Any:
        given = {**{key: info.data.get(key, "wrong") for key in _FORMS[:-1]}, "steps": value}
        if value == ():
            fail_validation("is empty", "give at least one step")
        chosen = [key for key in _FORMS if given[key] is not None]
        if len(chosen) != 1:
            what = f"is {' and '.join(chosen)} at once" if chosen else "is empty"
            fail_validation(what, f"give one of {', '.join(_FORMS)}", parent=True)
        return value

    @property
    def form(self) -> str:
        """Name of the form that is given."""
        return next(key for key in _FORMS if getattr(self, key) is not None)
