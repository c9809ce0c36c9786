"""Steps and procedures in a protocol file."""

from __future__ import annotations

import dataclasses
import re
from typing import Annotated, Any, ClassVar

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

from mckibben.component.schema import ComponentModel, model_of
from mckibben.config.fields import read_path, write_path
from mckibben.config.model import ConfigModel, fail_validation
from mckibben.errors import quoted, suggest
from mckibben.rig import steps as typed
from mckibben.rig.protocol import IsobaricProtocol
from mckibben.units import Repeats

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


class _AloneSpec(ComponentModel):
    """A step that may be written as one value."""

    alone: ClassVar[str]

    @model_validator(mode="before")
    @classmethod
    def _alone(cls, value: Any) -> Any:
        return {cls.alone: value} if isinstance(value, str) and value else value


class MoveSpec(model_of(typed.Move, base=_AloneSpec)):
    """Move: ``move: 10 %``."""

    alone: ClassVar = "to"


class DwellSpec(model_of(typed.Dwell, base=_AloneSpec)):
    """Wait: ``dwell: 5 s``."""

    alone: ClassVar = "duration"


class PressuriseSpec(model_of(typed.Pressurise, base=_AloneSpec)):
    """Change of pressure: ``pressurise: 2 bar``."""

    alone: ClassVar = "pressure"


class HoldForceSpec(model_of(typed.HoldForce, base=_AloneSpec)):
    """Force feedback: ``hold_force: 100 N``."""

    alone: ClassVar = "force"


class AcquireSpec(model_of(typed.Acquire)):
    """Acquisition of a point."""


class WalkSpec(model_of(typed.Walk, optional=True)):
    """Pass from plateau to plateau; without `to` back to the start of the walk before."""

    acquire: AcquireSpec | None = None

    def build(self, *args: Any, **others: Any) -> Any:
        return super().build(*args, to=self.to, **others)


class VentSpec(model_of(typed.Vent)):
    """Venting."""


class RepeatSpec(ConfigModel):
    """Steps several times."""

    times: Repeats
    steps: tuple[StepSpec, ...]

    @field_validator("steps", mode="after")
    @classmethod
    def _some(cls, value: Any) -> Any:
        return value or fail_validation("is empty", "give at least one")


_WORDS = ("vent", "acquire", "walk")
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
        return {kind: next(iter(inside.values())) if list(inside) == [getattr(part, "alone", None)] else inside}

    def step(self) -> typed.Step:
        """The step."""
        if self.repeat is not None:
            return typed.Repeat(times=self.repeat.times, steps=steps(self.repeat.steps))
        return next(part for _, part in self if part is not None).build()

    @classmethod
    def of(cls, step: typed.Step) -> StepSpec:
        """As it is written."""
        if isinstance(step, typed.Repeat):
            return cls(repeat=RepeatSpec(times=step.times, steps=tuple(map(cls.of, step.steps))))
        values = _changed(step)
        if acquire := values.pop("acquire", None):
            values["acquire"] = AcquireSpec(**_changed(acquire))
        kind = re.sub(r"(?<!^)(?=[A-Z])", "_", type(step).__name__).lower()
        return cls.model_validate({kind: _SPECS[kind](**values)})


_SPECS: dict[str, Any] = {
    "move": MoveSpec,
    "dwell": DwellSpec,
    "pressurise": PressuriseSpec,
    "hold_force": HoldForceSpec,
    "acquire": AcquireSpec,
    "walk": WalkSpec,
    "vent": VentSpec,
}


RepeatSpec.model_rebuild()


def steps(written: tuple[StepSpec, ...]) -> tuple[typed.Step, ...]:
    """The steps."""
    return tuple(one.step() for one in written)


def _changed(step: Any) -> dict[str, Any]:
    """The fields of a step that differ from their default."""
    return {
        field.name: getattr(step, field.name)
        for field in dataclasses.fields(step)
        if getattr(step, field.name) != _default(field)
    }


def _default(field: dataclasses.Field[Any]) -> Any:
    return field.default if field.default_factory is dataclasses.MISSING else field.default_factory()


def _pruned(value: Any) -> Any:
    return {key: _pruned(item) for key, item in value.items() if item is not None} if isinstance(value, dict) else value


class IsobaricSpec(model_of(IsobaricProtocol)):
    """Isobaric test."""


class IsometricSpec(model_of(typed.IsometricProtocol)):
    """Isometric test."""


class IsotonicSpec(model_of(typed.IsotonicProtocol)):
    """Isotonic test."""


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
