"""The parts of a scenario as the objects that are simulated. Only here is JAX needed."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

from mckibben import catalog
from mckibben.config.model import explicit_fields
from mckibben.control import (
    PID,
    BackpropPID,
    Constant,
    DecouplingControl,
    ExtendedStateObserver,
    Feedback,
    FrictionCompensation,
    InverseModelControl,
    Jacobian,
    LawAdaptation,
    Multisine,
    Observer,
    PolePlacement,
    PositionStiffnessControl,
    PredictiveControl,
    PressureObserver,
    Reference,
    Samples,
    Signal,
    Sine,
    SlidingMode,
    Step,
    VelocityObserver,
)
from mckibben.joint import AntagonisticJoint, KneeGeometry, Load, RigidTendon, SeriesSpring
from mckibben.muscle import ChouLaw, Creep, Friction, MaxwellCreep, MaxwellSlip, Muscle, NoCreep, NoFriction, scaled_law
from mckibben.plant import (
    Disturbance,
    FirstOrderValve,
    IdealValve,
    JointPlant,
    NoDisturbance,
    PerfectSensors,
    PlantState,
    SampledSensors,
    Sensors,
    TorquePulses,
    Valve,
)
from mckibben.study.scenario.controller import (
    AdaptationSpec,
    BackpropSpec,
    ControllerSpec,
    DecouplingSpec,
    InverseModelSpec,
    LoopSpec,
    ModelBasedSpec,
    PIDSpec,
)
from mckibben.study.scenario.plant import (
    CreepSpec,
    DisturbanceSpec,
    FrictionSpec,
    GeometrySpec,
    JointSpec,
    LoadSpec,
    MuscleSpec,
    SensorsSpec,
    SpringSpec,
    StartSpec,
    ValveSpec,
)
from mckibben.study.scenario.reference import ReferenceSpec, SignalSpec, read_samples

_PARTS = ("poles", "sliding", "velocity_observer", "disturbance_observer", "pressure_observer", "load", "adaptation")
_UNITS = {"angle": "rad", "stiffness": "N*m/rad"}


def build_plant(
    joint: JointSpec,
    load: LoadSpec,
    valve: ValveSpec | None,
    sensors: SensorsSpec | None = None,
    disturbance: DisturbanceSpec | None = None,
) -> JointPlant:
    """What is simulated."""
    return JointPlant(
        build_joint(joint),
        build_load(load),
        build_valve(valve),
        build_sensors(sensors),
        build_disturbance(disturbance),
    )


def build_joint(spec: JointSpec) -> AntagonisticJoint:
    """The joint, as it is or as a controller believes it to be."""
    muscle1, muscle2 = spec.muscle1 or spec.muscle, spec.muscle2 or spec.muscle
    assert muscle1 is not None and muscle2 is not None  # the model of the joint sees to it
    return AntagonisticJoint(build_geometry(spec), _muscle(muscle1), _muscle(muscle2), build_tendon(spec.spring))


def build_geometry(spec: JointSpec) -> KneeGeometry:
    """Where the muscles of a joint run, its own connectors in place of the geometry's."""
    geometry = _geometry(spec.geometry)
    if spec.connector_length is None:
        return geometry
    return dataclasses.replace(geometry, connector_length=spec.connector_length)


def build_friction(spec: FrictionSpec | None) -> Friction:
    """What a muscle's way adds to its law."""
    return NoFriction() if spec is None else MaxwellSlip(**explicit_fields(spec))


def build_creep(spec: CreepSpec | None) -> Creep:
    """What the time since its last moves adds to a muscle's law."""
    return NoCreep() if spec is None else MaxwellCreep(**explicit_fields(spec))


def build_tendon(spec: SpringSpec | None) -> RigidTendon | SeriesSpring:
    """What lies between muscle and path."""
    return RigidTendon() if spec is None else SeriesSpring(**explicit_fields(spec))


def build_load(spec: LoadSpec) -> Load:
    """What is moved."""
    numbers = explicit_fields(spec, "base")
    return Load(**numbers) if spec.base is None else dataclasses.replace(catalog.load(spec.base), **numbers)


def build_valve(spec: ValveSpec | None) -> Valve:
    """One kind of valve for both muscles."""
    return IdealValve() if spec is None else FirstOrderValve(spec.time_constant)


def build_sensors(spec: SensorsSpec | None) -> Sensors:
    """What tells the controller."""
    return PerfectSensors() if spec is None else SampledSensors(**explicit_fields(spec))


def build_disturbance(spec: DisturbanceSpec | None) -> Disturbance:
    """What pushes from outside."""
    return NoDisturbance() if spec is None else TorquePulses(**explicit_fields(spec.pulses))


def build_control(
    spec: ControllerSpec, joint: JointSpec, load: LoadSpec, valve: ValveSpec | None
) -> PositionStiffnessControl | FrictionCompensation | InverseModelControl | DecouplingControl | PredictiveControl:
    """The controller of a plant; its model is an object of its own even where it is that of the plant."""
    spec = spec.with_model(joint, load, valve)
    assert spec.model is not None
    model = build_joint(spec.model)
    believing = spec.decoupling or spec.predictive
    if believing is not None:
        assert believing.load is not None
        beliefs = model, build_load(believing.load)
        numbers: dict[str, Any] = {
            "friction_compensation": bool(spec.friction_compensation),
            "adaptation": build_adaptation(believing.adaptation),
            **explicit_fields(believing, *_PARTS),
        }
        if isinstance(believing, DecouplingSpec):
            return DecouplingControl(*beliefs, *decoupling_parts(believing), **numbers)
        return PredictiveControl(*beliefs, *observers(believing), **numbers)
    assert spec.position is not None and spec.stiffness is not None  # the model of the controller sees to it
    loops = build_loop(spec.position), build_loop(spec.stiffness)
    control = PositionStiffnessControl(*loops, model=model, minimum_tension=spec.minimum_tension)
    if spec.inverse_model is not None:
        return build_inverse_model(spec.inverse_model, control)
    return FrictionCompensation(control, model=model) if spec.friction_compensation else control


def build_inverse_model(spec: InverseModelSpec, loops: PositionStiffnessControl) -> InverseModelControl:
    """Two loops with what learns beside them."""
    load = None if spec.load is None else build_load(spec.load)
    return InverseModelControl(loops, load, **explicit_fields(spec, "alone", "load"))


def decoupling_parts(spec: DecouplingSpec) -> tuple[Feedback, Observer, PressureObserver]:
    """What a `DecouplingControl` is put together from."""
    feedback = (
        PolePlacement(**explicit_fields(spec.poles))
        if spec.poles is not None
        else SlidingMode(**explicit_fields(spec.sliding))
    )
    return feedback, *observers(spec)


def observers(spec: ModelBasedSpec) -> tuple[Observer, PressureObserver]:
    """What a controller by a model observes with."""
    velocity, disturbance, pressure = spec.velocity_observer, spec.disturbance_observer, spec.pressure_observer
    observer = (
        VelocityObserver(**explicit_fields(velocity))
        if velocity
        else ExtendedStateObserver(**explicit_fields(disturbance))
    )
    return observer, PressureObserver(**explicit_fields(pressure))


def build_adaptation(spec: AdaptationSpec | None) -> LawAdaptation | None:
    """What corrects the model's muscles on line."""
    return None if spec is None else LawAdaptation(**explicit_fields(spec))


def build_loop(spec: LoopSpec[Any, Any, Any, Any]) -> PID | BackpropPID:
    """One of the controller's loops."""
    if spec.backprop is None:
        assert spec.pid is not None  # the model of the loop sees to it
        return PID(**explicit_fields(spec.pid))
    network = explicit_fields(spec.backprop, *PIDSpec.model_fields)
    if "jacobian" in network:
        network["jacobian"] = Jacobian[network["jacobian"].upper()]
    return BackpropPID(_base(spec.backprop), **network)


def build_reference(spec: ReferenceSpec) -> Reference:
    """What is wanted over time."""
    return Reference(angle=build_signal(spec.angle, "angle"), stiffness=build_signal(spec.stiffness, "stiffness"))


def build_signal(spec: SignalSpec[Any], quantity: str) -> Signal:
    """What is wanted over time of "angle" or of "stiffness"."""
    if spec.step is not None:
        return Step(**explicit_fields(spec.step))
    if spec.sine is not None:
        return Sine(**explicit_fields(spec.sine))
    if spec.multisine is not None:
        return Multisine(**explicit_fields(spec.multisine))
    if spec.samples is not None:
        file = spec.samples.file
        return (
            Samples(*read_samples(file, quantity, _UNITS[quantity]))
            if file
            else Samples(**explicit_fields(spec.samples))
        )
    assert spec.constant is not None  # the model of the signal sees to it
    return Constant(spec.constant)


def build_start(plant: JointPlant, spec: StartSpec) -> PlantState:
    """The state at rest to start from."""
    return plant.equilibrium(spec.angle, stiffness=spec.stiffness)


def _geometry(spec: GeometrySpec) -> KneeGeometry:
    numbers = explicit_fields(spec, "base")
    return KneeGeometry(**numbers) if spec.base is None else dataclasses.replace(catalog.geometry(spec.base), **numbers)


def _muscle(spec: MuscleSpec) -> Muscle:
    specimen, friction, creep = catalog.specimen(spec.specimen), build_friction(spec.friction), build_creep(spec.creep)
    if isinstance(spec.law, Path):
        from mckibben.identification import Fit

        law = Fit.from_yaml(spec.law).law
    else:
        law = ChouLaw.of(specimen) if spec.law == "chou" else catalog.law(spec.law)
    return Muscle(specimen, law if spec.strength is None else scaled_law(law, spec.strength), friction, creep)


def _base(spec: BackpropSpec[Any, Any, Any, Any]) -> PID:
    return PID(**{key: value for key, value in explicit_fields(spec).items() if key in PIDSpec.model_fields})
