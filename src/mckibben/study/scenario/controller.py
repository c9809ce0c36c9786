"""The controller of a scenario: two loops, the inverse of a model or a look ahead; what it believes of the joint."""

from __future__ import annotations

from typing import Annotated, Any, Generic, TypeVar

from pydantic import Field, ValidationInfo, field_validator

from mckibben.config.fields import (
    AngleDerivativeGain,
    AngleGain,
    AngleIntegralGain,
    AngleScale,
    AngularAcceleration,
    Bandwidth,
    BoundedInt,
    Flag,
    Force,
    Mass,
    Momentum,
    OneOf,
    PoleDamping,
    PositiveRate,
    PositiveTime,
    PositiveTorque,
    PressureRate,
    PressureScale,
    Rate,
    Ratio,
    Share,
    ShortTime,
    StiffnessDerivativeGain,
    StiffnessGain,
    StiffnessIntegralGain,
    StiffnessScale,
    StrengthSpread,
    Tension,
)
from mckibben.config.model import ConfigModel, fail_validation
from mckibben.study.scenario.plant import JointSpec, LoadSpec, ValveSpec

P = TypeVar("P")
I = TypeVar("I")  # noqa: E741
D = TypeVar("D")
S = TypeVar("S")


class PIDSpec(ConfigModel, Generic[P, I, D]):
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
            fail_validation(f"its gains differ in sign ({signs})", remedy, parent=True)
        return value


class BackpropSpec(PIDSpec[P, I, D], Generic[P, I, D, S]):
    """The numbers of `BackpropPID` in SI, its base gains among them; where one is left out the class's own."""

    signal_scale: S
    error_scale: S
    output_scale: PressureRate
    learning_rate: Rate | None = None
    momentum: Momentum | None = None
    gain_ratio: Ratio | None = None
    hidden: Annotated[int, BoundedInt(1, 1000)] | None = None
    jacobian: Annotated[str, OneOf(("sign", "model"))] | None = Field(None, validate_default=True)
    seed: Annotated[int, BoundedInt(0, 2**31 - 1)] | None = None

    @field_validator("jacobian", mode="after")
    @classmethod
    def _sign_known(cls, value: str | None, info: ValidationInfo) -> str | None:
        if value != "model" and info.data.get("ki") == 0:
            fail_validation(
                "learns by the sign of ki, which is zero", "give ki a sign, or write jacobian: model", parent=True
            )
        return value


class LoopSpec(ConfigModel, Generic[P, I, D, S]):
    """One of `pid` and `backprop`."""

    pid: PIDSpec[P, I, D] | None = None
    backprop: BackpropSpec[P, I, D, S] | None = Field(None, validate_default=True)

    @field_validator("backprop", mode="after")
    @classmethod
    def _one_form(cls, value: Any, info: ValidationInfo) -> Any:
        pid = info.data.get("pid", "wrong")
        if (pid is None) == (value is None):
            what = "has no loop" if value is None else "is pid and backprop at once"
            fail_validation(what, "give one of pid, backprop", parent=True)
        return value


PositionLoopSpec = LoopSpec[AngleGain, AngleIntegralGain, AngleDerivativeGain, AngleScale]
"""From angle [rad] to differential pressure [Pa]."""

StiffnessLoopSpec = LoopSpec[StiffnessGain, StiffnessIntegralGain, StiffnessDerivativeGain, StiffnessScale]
"""From stiffness [N*m/rad] to co-contraction [Pa]."""


class PolesSpec(ConfigModel):
    """The numbers of `PolePlacement` in SI."""

    bandwidth: Bandwidth
    integral: Flag | None = None


class SlidingSpec(ConfigModel):
    """The numbers of `SlidingMode` in SI; where one is left out the class's own."""

    slope: PositiveRate
    reach: AngularAcceleration
    layer: Bandwidth
    lag: PositiveTime | None = None


class ObserverSpec(ConfigModel):
    """The bandwidth [rad/s] of an observer."""

    bandwidth: Bandwidth


class AdaptationSpec(ConfigModel):
    """The numbers of `LawAdaptation` in SI; where one is left out the class's own."""

    strength_spread: StrengthSpread | None = None
    mass_spread: Mass | None = None
    friction_spread: Share | None = None
    torque_error: PositiveTorque | None = None
    bandwidth: Bandwidth | None = None


class ModelBasedSpec(ConfigModel):
    """What a controller by a model observes, and what it believes of load and valves.

    Load and valves are the plant's own unless given, and the observers have the classes' own bandwidths. With
    `adaptation` the strength of the model's muscles is corrected on line.
    """

    velocity_observer: ObserverSpec | None = None
    disturbance_observer: ObserverSpec | None = None
    pressure_observer: ObserverSpec | None = None
    valve_time_constant: ShortTime | None = None
    minimum_tension: Force | None = None
    load: LoadSpec | None = None
    adaptation: AdaptationSpec | None = None

    @field_validator("disturbance_observer", mode="after")
    @classmethod
    def _one_observer(cls, value: Any, info: ValidationInfo) -> Any:
        if value is not None and info.data.get("velocity_observer") is not None:
            fail_validation("is given beside velocity_observer", "keep one: this one observes the velocity as well")
        return value


class DecouplingSpec(ModelBasedSpec):
    """The parts of `DecouplingControl`: `poles` or `sliding`, and what it observes and believes."""

    poles: PolesSpec | None = None
    sliding: SlidingSpec | None = Field(None, validate_default=True)

    @field_validator("sliding", mode="after")
    @classmethod
    def _one_feedback(cls, value: Any, info: ValidationInfo) -> Any:
        if (info.data.get("poles", "wrong") is None) == (value is None):
            what = "has no feedback" if value is None else "is poles and sliding at once"
            fail_validation(what, "give one of poles, sliding", parent=True)
        return value


class PredictiveSpec(ModelBasedSpec):
    """The numbers of `PredictiveControl` in SI; where one is left out the class's own."""

    bandwidth: Bandwidth
    stiffness_bandwidth: Bandwidth | None = None
    damping: PoleDamping | None = None
    angle_scale: AngleScale | None = None
    stiffness_scale: StiffnessScale | None = None
    horizon: PositiveTime | None = None
    stages: Annotated[int, BoundedInt(1, 1000)] | None = None
    iterations: Annotated[int, BoundedInt(1, 100)] | None = None


class InverseModelSpec(ConfigModel):
    """The numbers of `InverseModelControl` in SI, where one is left out the class's own; and what it believes.

    Load and valves are the plant's own unless given; a network `alone` learns on no model's inverse, for no load.
    """

    learning_rate: Rate | None = None
    hidden: Annotated[int, BoundedInt(1, 1000)] | None = None
    valve_time_constant: ShortTime | None = None
    filter_bandwidth: Bandwidth | None = None
    angle_scale: AngleScale | None = None
    velocity_scale: Bandwidth | None = None
    acceleration_scale: AngularAcceleration | None = None
    stiffness_scale: StiffnessScale | None = None
    pressure_scale: PressureScale | None = None
    seed: Annotated[int, BoundedInt(0, 2**31 - 1)] | None = None
    alone: Flag | None = None
    load: LoadSpec | None = None

    @field_validator("load", mode="after")
    @classmethod
    def _one_start(cls, value: Any, info: ValidationInfo) -> Any:
        if value is not None and info.data.get("alone"):
            fail_validation("is given beside alone", "keep one: a network that is alone has no use for a load")
        return value


class ControllerSpec(ConfigModel):
    """Both loops of `PositionStiffnessControl`, `DecouplingControl` or `PredictiveControl`; and its model of the joint.

    The model is the plant's own joint unless given. `friction_compensation` makes up for the friction of that model's
    muscles, as `FrictionCompensation` does. Beside the loops there may be an `inverse_model` and a `minimum_tension`.
    """

    position: PositionLoopSpec | None = None
    stiffness: StiffnessLoopSpec | None = None
    decoupling: DecouplingSpec | None = None
    predictive: PredictiveSpec | None = Field(None, validate_default=True)
    model: JointSpec | None = None
    friction_compensation: Flag | None = None
    inverse_model: InverseModelSpec | None = None
    minimum_tension: Tension | None = None

    @field_validator("inverse_model", "minimum_tension", mode="after")
    @classmethod
    def _beside_loops(cls, value: Any, info: ValidationInfo) -> Any:
        if value is not None and None in (info.data.get("position", "wrong"), info.data.get("stiffness", "wrong")):
            fail_validation("goes with position and stiffness", "give a loop for both, or leave it out")
        return value

    @field_validator("inverse_model", mode="after")
    @classmethod
    def _friction_learned(cls, value: Any, info: ValidationInfo) -> Any:
        if value is not None and info.data.get("friction_compensation"):
            fail_validation("is given beside friction_compensation", "keep one: what it learns has the friction in it")
        return value

    @field_validator("decoupling", "predictive", mode="after")
    @classmethod
    def _one_form(cls, value: Any, info: ValidationInfo) -> Any:
        others = ("position", "stiffness") + (("decoupling",) if info.field_name == "predictive" else ())
        given = [key for key in others if info.data.get(key, "wrong") is not None]
        if value is not None and given:
            fail_validation(f"is given beside {' and '.join(given)}", "keep one of them")
        if value is None and info.field_name == "predictive" and "decoupling" not in given:
            missing = [key for key in ("position", "stiffness") if key not in given]
            if missing:
                remedy = "give a loop for both, or decoupling, or predictive"
                fail_validation(f"lacks {' and '.join(missing)}", remedy, parent=True)
        return value

    def with_model(self, joint: JointSpec, load: LoadSpec, valve: ValveSpec | None) -> ControllerSpec:
        """The controller with its model of joint, load and valves written out, taken from a plant where not given."""
        update: dict[str, Any] = {} if self.model is not None else {"model": joint}
        lag = 0.0 if valve is None else valve.time_constant
        for name in ("decoupling", "predictive", "inverse_model"):
            part = getattr(self, name)
            if part is None:
                continue
            plant = {"load": load, "valve_time_constant": lag}
            if name == "inverse_model" and part.alone:  # its network learns without a model of the load
                del plant["load"]
            missing = {key: value for key, value in plant.items() if getattr(part, key) is None}
            update[name] = part.model_copy(update=missing)
        return self.model_copy(update=update)
