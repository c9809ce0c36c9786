"""The controller of a scenario: a loop for position, a loop for stiffness, and what it believes of the joint."""

from __future__ import annotations

from typing import Annotated, Any, Generic, TypeVar

from pydantic import Field, ValidationInfo, field_validator

from mckibben.study.scenario.fields import (
    AngleDerivativeGain,
    AngleGain,
    AngleIntegralGain,
    AngleScale,
    Flag,
    Momentum,
    PressureRate,
    Rate,
    Ratio,
    ShortTime,
    StiffnessDerivativeGain,
    StiffnessGain,
    StiffnessIntegralGain,
    StiffnessScale,
)
from mckibben.study.scenario.joint import JointSpec
from mckibben.study.scenario.part import Part, refuse
from mckibben.study.scenario.words import Choice, Whole

P = TypeVar("P")
I = TypeVar("I")  # noqa: E741
D = TypeVar("D")
S = TypeVar("S")


class PIDSpec(Part, Generic[P, I, D]):
    """The numbers of `PID` in SI, where one is left out the class's own; a reverse-acting loop has negative gains."""

    kp: P
    ki: I
    kd: D
    filter_time: ShortTime | None = None
    tracking_time: ShortTime | None = None
    derivative_on_error: Flag | None = None

    @field_validator("kd", mode="after")
    @classmethod
    def _one_sign(cls, value: Any, info: ValidationInfo) -> Any:
        gains = [gain for gain in (info.data.get("kp"), info.data.get("ki"), value) if gain is not None]
        if min(gains) < 0 < max(gains):
            signs = ", ".join(
                f"{name} {'negative' if gain < 0 else 'zero' if gain == 0 else 'positive'}"
                for name, gain in {**info.data, "kd": value}.items()
            )
            remedy = "give all one sign, negative if the loop is reverse-acting"
            refuse(f"its gains differ in sign ({signs})", remedy, parent=True)
        return value


class BackpropSpec(PIDSpec[P, I, D], Generic[P, I, D, S]):
    """The numbers of `BackpropPID` in SI, its base gains among them; where one is left out the class's own."""

    signal_scale: S
    error_scale: S
    output_scale: PressureRate
    learning_rate: Rate | None = None
    momentum: Momentum | None = None
    gain_ratio: Ratio | None = None
    hidden: Annotated[int, Whole(1, 1000)] | None = None
    jacobian: Annotated[str, Choice(("sign", "model"))] | None = Field(None, validate_default=True)
    seed: Annotated[int, Whole(0, 2**31 - 1)] | None = None

    @field_validator("jacobian", mode="after")
    @classmethod
    def _sign_known(cls, value: str | None, info: ValidationInfo) -> str | None:
        if value != "model" and info.data.get("ki") == 0:
            refuse("learns by the sign of ki, which is zero", "give ki a sign, or write jacobian: model", parent=True)
        return value


class LoopSpec(Part, Generic[P, I, D, S]):
    """One of `pid` and `backprop`."""

    pid: PIDSpec[P, I, D] | None = None
    backprop: BackpropSpec[P, I, D, S] | None = Field(None, validate_default=True)

    @field_validator("backprop", mode="after")
    @classmethod
    def _one_form(cls, value: Any, info: ValidationInfo) -> Any:
        pid = info.data.get("pid", "wrong")
        if (pid is None) == (value is None):
            what = "has no loop" if value is None else "is pid and backprop at once"
            refuse(what, "give one of pid, backprop", parent=True)
        return value


PositionLoopSpec = LoopSpec[AngleGain, AngleIntegralGain, AngleDerivativeGain, AngleScale]
"""From angle [rad] to differential pressure [Pa]."""

StiffnessLoopSpec = LoopSpec[StiffnessGain, StiffnessIntegralGain, StiffnessDerivativeGain, StiffnessScale]
"""From stiffness [N*m/rad] to co-contraction [Pa]."""


class ControllerSpec(Part):
    """Both loops of `PositionStiffnessControl`, and its model of the joint; the plant's own joint unless given.

    `friction_compensation` adds what `FrictionCompensation` does with the friction of that model's muscles.
    """

    position: PositionLoopSpec
    stiffness: StiffnessLoopSpec
    model: JointSpec | None = None
    friction_compensation: Flag | None = None
