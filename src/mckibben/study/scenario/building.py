"""Runtime objects and runs of a scenario."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np

from mckibben.config.model import explicit_fields
from mckibben.control import (
    Controller,
    DecouplingControl,
    ExtendedStateObserver,
    Feedback,
    FrictionCompensation,
    InverseModelControl,
    Observer,
    PositionStiffnessControl,
    PredictiveControl,
    PressureObserver,
    VelocityObserver,
)
from mckibben.errors import FileError, McKibbenError, Problem, RangeError, ScenarioError
from mckibben.joint import AntagonisticJoint, Geometry, RigidTendon, ScaledArms
from mckibben.notebook import Progress, silent
from mckibben.plant import IdealValve, JointPlant, NoDisturbance, PerfectSensors
from mckibben.simulation import AtRest, Batch, CheckedRun, Metrics, checked_run, simulate_many
from mckibben.study.parameters import Known, Table, batched
from mckibben.study.scenario import Scenario
from mckibben.study.scenario.controller import (
    ADAPTATIONS,
    ControllerSpec,
    DecouplingSpec,
    ModelBasedSpec,
    OwnControllerSpec,
)
from mckibben.study.scenario.plant import (
    DisturbanceSpec,
    JointFrictionSpec,
    JointSpec,
    LoadSpec,
    SensorsSpec,
    ValveSpec,
)

_PARTS = ("poles", "sliding", "velocity_observer", "disturbance_observer", "pressure_observer", "load", *ADAPTATIONS)


def build_plant(
    joint: JointSpec,
    load: LoadSpec,
    valve: ValveSpec | None,
    sensors: SensorsSpec | None = None,
    disturbance: DisturbanceSpec | None = None,
    friction: JointFrictionSpec | None = None,
    command_delay: float | None = None,
) -> JointPlant:
    """The simulated plant."""
    return JointPlant(
        build_joint(joint),
        load.build(),
        IdealValve() if valve is None else valve.build(),
        PerfectSensors() if sensors is None else sensors.build(),
        NoDisturbance() if disturbance is None else disturbance.build(),
        None if friction is None else friction.build(),
        command_delay=command_delay,
    )


def build_joint(spec: JointSpec) -> AntagonisticJoint:
    """A joint: the plant's, or that of a controller's model."""
    muscle1 = spec.return_spring1 or spec.muscle1 or spec.muscle
    muscle2 = spec.return_spring2 or spec.muscle2 or spec.muscle
    tendon = RigidTendon() if spec.spring is None else spec.spring.build()
    assert muscle1 is not None and muscle2 is not None  # the model of the joint sees to it
    return AntagonisticJoint(build_geometry(spec), muscle1.build(), muscle2.build(), tendon)


def build_geometry(spec: JointSpec) -> Geometry:
    """The geometry of a joint; its own connector length replaces the geometry's, its scale is that of the arms."""
    geometry = spec.geometry.build()
    if spec.connector_length is not None:
        geometry = dataclasses.replace(geometry, connector_length=spec.connector_length)
    return geometry if spec.arm_scale is None else ScaledArms(geometry, spec.arm_scale)


def valve_time_constant(valve: ValveSpec | None, joint: JointSpec) -> Any:
    """First-order time constant [s] of the valves in a controller's model, where it is not given; None if unknown.

    For valves with air it is that of small changes in the middle of the first muscle's pressures and contractions.
    """
    if valve is None:
        return 0.0
    spec = joint.muscle1 or joint.muscle2 or joint.muscle
    assert spec is not None
    try:
        found = valve.build().model_lag(spec.build() if valve.runtime.holds_air else None)
    except RangeError:  # of a value that is only tried
        return math.nan
    if found is None or not valve.runtime.holds_air:
        return found
    return np.asarray(found, float) if np.ndim(found) else float(found)


def build_control(spec: ControllerSpec, joint: JointSpec, load: LoadSpec, valve: ValveSpec | None) -> Controller:
    """The controller; its model is never the plant's object, even where the numbers are equal."""
    spec = spec.with_model(joint, load, valve)
    if isinstance(spec, OwnControllerSpec):
        return _own_controller(spec)
    control = _build_control(spec)
    return control if spec.supply_limit is None else spec.supply_limit.build(control)


def _build_control(spec: ControllerSpec) -> Controller:
    """The controller, with its model written out and without the limit of the supply."""
    assert spec.model is not None
    model = build_joint(spec.model)
    model_based = spec.decoupling or spec.predictive
    if model_based is not None:
        assert model_based.load is not None
        model_and_load = model, model_based.load.build()
        numbers: dict[str, Any] = {
            "friction_compensation": bool(spec.friction_compensation),
            "stiffness_amplitude": spec.stiffness_amplitude,
            **{name: (part := getattr(model_based, name)) and part.build() for name in ADAPTATIONS},
            **explicit_fields(model_based, *_PARTS),
        }
        if isinstance(model_based, DecouplingSpec):
            return DecouplingControl(*model_and_load, *decoupling_parts(model_based), **numbers)
        return PredictiveControl(*model_and_load, *observers(model_based), **numbers)
    assert spec.position is not None and spec.stiffness is not None  # the model of the controller sees to it
    loops = spec.position.build(), spec.stiffness.build()
    control = PositionStiffnessControl(
        *loops, model=model, minimum_tension=spec.minimum_tension, stiffness_amplitude=spec.stiffness_amplitude
    )
    if spec.inverse_model is not None:
        part = spec.inverse_model
        load_model = None if part.load is None else part.load.build()
        return InverseModelControl(control, load_model, **explicit_fields(part, "alone", "load"))
    return FrictionCompensation(control, model=model) if spec.friction_compensation else control


def _own_controller(spec: OwnControllerSpec) -> Controller:
    assert spec.model is not None and spec.load is not None
    given = {"model": build_joint(spec.model), "load": spec.load.build()}
    return spec.build(**{name: one for name, one in given.items() if name in spec.runtime.__dataclass_fields__})


def decoupling_parts(spec: DecouplingSpec) -> tuple[Feedback, Observer, PressureObserver]:
    """Feedback and observers of a `DecouplingControl`."""
    feedback = spec.poles or spec.sliding
    assert feedback is not None  # the model sees to it
    return feedback.build(), *observers(spec)


def observers(spec: ModelBasedSpec) -> tuple[Observer, PressureObserver]:
    """Observers of a model-based controller."""
    velocity, disturbance, pressure = spec.velocity_observer, spec.disturbance_observer, spec.pressure_observer
    observer = (
        VelocityObserver(velocity.bandwidth) if velocity else ExtendedStateObserver(**explicit_fields(disturbance))
    )
    return observer, PressureObserver(**explicit_fields(pressure))


def initial_state(scenario: Scenario) -> AtRest:
    """Initial state of a scenario, at rest; of a batch with one value a run."""
    stiffness = scenario.start.stiffness
    return AtRest(scenario.start.angle, math.nan if stiffness is None else stiffness)


def run_scenario(scenario: Scenario, *, source: str = "") -> CheckedRun:
    """Simulate a scenario.

    Parameters
    ----------
    scenario
        Scenario.
    source
        File of the scenario, for errors. Default: its name.

    Returns
    -------
    CheckedRun
        Result, with the scenario's text, and the feasibility of its reference.

    Raises
    ------
    ScenarioError
        If its parts do not fit together.
    """

    @contextmanager
    def building(field: str) -> Iterator[None]:
        try:
            yield
        except FileError:
            raise  # has its own file and line
        except McKibbenError as error:
            raise ScenarioError(source or scenario.name, [Problem.of(error, field=field)]) from error

    with building("joint, load or valve"):
        plant = scenario.plant()
    with building("controller"):
        control = scenario.control()
    with building("start"):  # all else has been checked
        return checked_run(
            plant,
            control,
            scenario.reference(),
            duration=scenario.duration,
            control_period=scenario.control_period,
            substeps=scenario.substeps,
            initial=initial_state(scenario),
            scenario=scenario.dumps(),
        )


def run_many(
    scenario: Scenario,
    table: Table,
    *,
    known: Known = (),
    metrics: Sequence[str] = Metrics._fields,
    precision: int = 64,
    chunk: int | None = None,
    workers: int | None = None,
    progress: Progress | None = None,
) -> Batch:
    """Simulate a scenario once for each row of a table of values; raises ParameterError for an invalid row."""
    many = batched(scenario, table, known=known)
    return simulate_many(
        many.plant(),
        many.control(),
        many.reference(),
        duration=scenario.duration,
        control_period=scenario.control_period,
        substeps=scenario.substeps,
        initial=initial_state(many),
        metrics=metrics,
        precision=precision,
        chunk=chunk,
        workers=workers,
        progress=progress or silent,
    )
