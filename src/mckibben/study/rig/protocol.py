"""What is done in a test, as it is written: one of the whole tests, or steps."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import Field, ValidationInfo, field_validator

from mckibben.study.rig.fields import Contraction, Share, Speed, Tension, Wait, Way
from mckibben.study.rig.step import StepSpec
from mckibben.study.scenario.fields import Duration, Force, Pressure, PressureRate
from mckibben.study.scenario.part import Part, refuse
from mckibben.study.scenario.words import Whole

_Count = Annotated[int, Whole(1, 1_000_000)]
_Repeats = Annotated[int, Whole(1, 10_000)]


class IsobaricSpec(Part):
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


class IsometricSpec(Part):
    """See `IsometricProtocol`."""

    contractions: tuple[Contraction, ...] | None = None
    pressures: tuple[Pressure, ...] | None = None
    rate: PressureRate | None = None
    speed: Speed | None = None
    dwell: Wait | None = None
    acquisition: Duration | None = None
    samples: _Count | None = None
    repeats: _Repeats | None = None


class IsotonicSpec(Part):
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


class ProtocolSpec(Part):
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
            refuse("is empty", "give at least one step")
        chosen = [key for key in _FORMS if given[key] is not None]
        if len(chosen) != 1:
            what = f"is {' and '.join(chosen)} at once" if chosen else "is empty"
            refuse(what, f"give one of {', '.join(_FORMS)}", parent=True)
        return value

    @property
    def form(self) -> str:
        """Which of them it is."""
        return next(key for key in _FORMS if getattr(self, key) is not None)
