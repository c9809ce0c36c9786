"""Controllers of scenario files, and their model of the joint."""

from __future__ import annotations

from typing import Annotated, Any, ClassVar

from pydantic import Field, ValidationInfo, field_validator

from mckibben.component.schema import ComponentModel, PartOf, default_of, model_of, named_model
from mckibben.config.fields import Flag, OneOf
from mckibben.config.model import ConfigModel, explicit_fields, fail_validation
from mckibben.control import (
    PID,
    BackpropPID,
    DecouplingControl,
    ExtendedStateObserver,
    InverseModelControl,
    Jacobian,
    LawAdaptation,
    PolePlacement,
    PredictiveControl,
    SlidingMode,
    SupplyLimit,
    ValveAdaptation,
)
from mckibben.study.scenario.plant import AnyLoad, JointSpec, LoadSpec, ValveSpec
from mckibben.units import (
    AngleDerivativeGain,
    AngleGain,
    AngleIntegralGain,
    AngleScale,
    Bandwidth,
    Force,
    StiffnessDerivativeGain,
    StiffnessGain,
    StiffnessIntegralGain,
    StiffnessScale,
    Tension,
    ValveLag,
)


class PIDSpec(ComponentModel):
    """Gains and filters of a `PID`; a reverse-acting loop has negative gains."""

    @field_validator("kd", mode="after", check_fields=False)
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


class BackpropSpec(ComponentModel):
    """Parameters of a `BackpropPID` with its base gains."""

    @field_validator("jacobian", mode="after", check_fields=False)
    @classmethod
    def _sign_known(cls, value: str | None, info: ValidationInfo) -> str | None:
        if value != "model" and info.data.get("ki") == 0:
            remedy = "give ki a sign, or write jacobian: model"
            fail_validation("learns by the sign of ki, which is zero", remedy, parent=True)
        return value

    def build(self, *args: Any, **others: Any) -> Any:
        declared = PID.__dataclass_fields__
        base = {name: value for name, value in explicit_fields(self).items() if name in declared}
        return super().build(PID(**base), *args, **others)

    def effective(self, name: str) -> Any:
        given = getattr(self, name)
        return default_of(PID, name) if given is None and name in PID.__dataclass_fields__ else super().effective(name)


class LoopSpec(ConfigModel):
    """One of `pid` and `backprop`."""

    pid: Any = None
    backprop: Any = None

    @field_validator("backprop", mode="after")
    @classmethod
    def _one_form(cls, value: Any, info: ValidationInfo) -> Any:
        pid = info.data.get("pid", "wrong")
        if (pid is None) == (value is None):
            what = "has no loop" if value is None else "is pid and backprop at once"
            fail_validation(what, "give one of pid, backprop", parent=True)
        return value

    def build(self) -> PID | BackpropPID:
        """The loop."""
        return (self.pid or self.backprop).build()


def _loop(quantity: str, kp: Any, ki: Any, kd: Any, scale: Any) -> Any:
    """The model of a loop with these units."""
    gains = {"kp": kp, "ki": ki, "kd": kd}
    pid = model_of(PID, base=PIDSpec, model_name=f"{quantity}PIDSpec", **gains)
    jacobian: Any = Annotated[str, OneOf(tuple(one.name.lower() for one in Jacobian))]
    backprop = model_of(
        BackpropPID,
        base=named_model(f"{quantity}GainsSpec", (BackpropSpec, pid), {}),
        model_name=f"{quantity}BackpropSpec",
        signal_scale=scale,
        error_scale=scale,
        jacobian=(jacobian | None, Field(None, validate_default=True)),
    )
    forms = {"pid": (pid | None, None), "backprop": (backprop | None, Field(None, validate_default=True))}
    return named_model(f"{quantity}LoopSpec", LoopSpec, forms)


class PositionLoopSpec(_loop("Position", AngleGain, AngleIntegralGain, AngleDerivativeGain, AngleScale)):
    """From angle [rad] to differential pressure [Pa]."""


class StiffnessLoopSpec(
    _loop("Stiffness", StiffnessGain, StiffnessIntegralGain, StiffnessDerivativeGain, StiffnessScale)
):
    """From stiffness [N*m/rad] to co-contraction [Pa]."""


class PolesSpec(model_of(PolePlacement)):
    """Parameters of `PolePlacement`."""

    bandwidth: Bandwidth


class SlidingSpec(model_of(SlidingMode)):
    """Parameters of `SlidingMode`."""


class ObserverSpec(ConfigModel):
    """Bandwidth [rad/s] of an observer."""

    bandwidth: Bandwidth


class DisturbanceObserverSpec(model_of(ExtendedStateObserver)):
    """Parameters of `ExtendedStateObserver`."""

    bandwidth: Bandwidth


class AdaptationSpec(model_of(LawAdaptation)):
    """Parameters of `LawAdaptation`."""


class ValveAdaptationSpec(model_of(ValveAdaptation)):
    """Parameters of `ValveAdaptation`."""


ADAPTATIONS = ("adaptation", "valve_adaptation")
_MODEL_FIELDS = ("valve_time_constant", "minimum_tension", "friction_compensation", "stiffness_amplitude")


class ModelBasedSpec(ComponentModel):
    """Observers of a model-based controller, and its model of load and valves, the plant's unless given."""

    velocity_observer: ObserverSpec | None = None
    disturbance_observer: DisturbanceObserverSpec | None = None
    pressure_observer: ObserverSpec | None = None
    valve_time_constant: ValveLag | None = None
    minimum_tension: Force | None = None
    load: AnyLoad | None = None
    adaptation: AdaptationSpec | None = None
    valve_adaptation: ValveAdaptationSpec | None = None

    @field_validator("disturbance_observer", mode="after")
    @classmethod
    def _one_observer(cls, value: Any, info: ValidationInfo) -> Any:
        if value is not None and info.data.get("velocity_observer") is not None:
            fail_validation("is given beside velocity_observer", "keep one: this one observes the velocity as well")
        return value


class DecouplingSpec(ModelBasedSpec):
    """Parameters of `DecouplingControl`: feedback by `poles` or `sliding`, observers and model."""

    runtime: ClassVar = DecouplingControl

    poles: PolesSpec | None = None
    sliding: SlidingSpec | None = Field(None, validate_default=True)

    @field_validator("sliding", mode="after")
    @classmethod
    def _one_feedback(cls, value: Any, info: ValidationInfo) -> Any:
        if (info.data.get("poles", "wrong") is None) == (value is None):
            what = "has no feedback" if value is None else "is poles and sliding at once"
            fail_validation(what, "give one of poles, sliding", parent=True)
        return value


class PredictiveSpec(model_of(PredictiveControl, base=ModelBasedSpec, without=_MODEL_FIELDS)):
    """Parameters of `PredictiveControl`."""

    bandwidth: Bandwidth


class InverseModelSpec(model_of(InverseModelControl)):
    """Parameters of `InverseModelControl`, and its model of the load, the plant's unless given; `alone` has none."""

    alone: Flag | None = None
    load: AnyLoad | None = None

    @field_validator("load", mode="after")
    @classmethod
    def _one_start(cls, value: Any, info: ValidationInfo) -> Any:
        if value is not None and info.data.get("alone"):
            fail_validation("is given beside alone", "keep one: a network that is alone has no use for a load")
        return value


class SupplyLimitSpec(model_of(SupplyLimit)):
    """Parameters of `SupplyLimit`."""


class ControllerSpec(ConfigModel):
    """Two loops (`PositionStiffnessControl`), `decoupling` or `predictive`, and the controller's model of the joint.

    The model is the plant's joint unless given. `friction_compensation` compensates the friction of its muscles.
    `inverse_model` and `minimum_tension` go with the two loops. The stiffness is the isobaric one, or with
    `stiffness_amplitude` [rad] that of a motion of this size, the model's friction included. `supply_limit` estimates
    the supply.
    """

    position: PositionLoopSpec | None = None
    stiffness: StiffnessLoopSpec | None = None
    decoupling: DecouplingSpec | None = None
    predictive: PredictiveSpec | None = Field(None, validate_default=True)
    model: JointSpec | None = None
    friction_compensation: Flag | None = None
    inverse_model: InverseModelSpec | None = None
    minimum_tension: Tension | None = None
    stiffness_amplitude: AngleScale | None = None
    supply_limit: SupplyLimitSpec | None = None

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
            fail_validation("is given beside friction_compensation", "keep one: the learned inverse includes friction")
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

    @property
    def load(self) -> Any:
        """Its model of the load; None where it has none, or takes the plant's."""
        return next((part.load for part in self._with_load().values() if part.load is not None), None)

    def with_load(self, load: Any) -> ControllerSpec:
        """The controller with another model of the load, where it has one written out."""
        parts = {name: part for name, part in self._with_load().items() if part.load is not None}
        return self.model_copy(update={name: part.model_copy(update={"load": load}) for name, part in parts.items()})

    def without_adaptation(self) -> ControllerSpec:
        """The controller with the laws, the mass and the valves of its model as they are."""
        parts = {name: part for name, part in self._with_load().items() if isinstance(part, ModelBasedSpec)}
        return self.model_copy(
            update={name: part.model_copy(update=dict.fromkeys(ADAPTATIONS)) for name, part in parts.items()}
        )

    def _with_load(self) -> dict[str, Any]:
        """Sections that have a model of the load."""
        parts = {name: getattr(self, name) for name in ("decoupling", "predictive", "inverse_model")}
        return {name: part for name, part in parts.items() if part is not None}

    def with_model(self, joint: JointSpec, load: LoadSpec, valve: ValveSpec | None) -> ControllerSpec:
        """The controller with its model of joint, load and valves written out, taken from a plant where not given."""
        update: dict[str, Any] = {} if self.model is not None else {"model": joint}
        from mckibben.study.scenario.building import valve_time_constant

        lag = valve_time_constant(valve, joint)
        for name in ("decoupling", "predictive", "inverse_model", "supply_limit"):
            part = getattr(self, name)
            if part is None:
                continue
            plant = {"load": load, "valve_time_constant": lag}
            if name == "supply_limit" or (name == "inverse_model" and part.alone):  # a lone network has no load
                del plant["load"]
            missing = {key: value for key, value in plant.items() if getattr(part, key) is None}
            update[name] = part.model_copy(update=missing)
        return self.model_copy(update=update)


class OwnControllerSpec(ComponentModel):
    """A controller class of one's own; its `model` and `load` are the plant's unless given."""

    model: JointSpec | None = None
    load: AnyLoad | None = None
    friction_compensation: ClassVar[None] = None
    stiffness_amplitude: ClassVar[None] = None

    def with_model(self, joint: JointSpec, load: LoadSpec, valve: ValveSpec | None) -> OwnControllerSpec:
        """The controller with its model of joint and load written out."""
        missing = {"model": joint, "load": load}
        return self.model_copy(update={key: one for key, one in missing.items() if getattr(self, key) is None})

    def with_load(self, load: Any) -> OwnControllerSpec:
        """The controller with another model of the load, if it has one written out."""
        return self if self.load is None else self.model_copy(update={"load": load})

    def without_adaptation(self) -> OwnControllerSpec:
        """The controller; what a class of one's own adapts is not known."""
        return self


AnyController = Annotated[ControllerSpec, PartOf("mckibben.control.base:Controller", OwnControllerSpec)]
