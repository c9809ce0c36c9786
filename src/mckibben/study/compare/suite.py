"""Benchmark suites: plants, references, conditions and controllers, and their consistency."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from typing import Any, Self

from pydantic import Field, field_validator

from mckibben.actuator import IdealValve
from mckibben.component.schema import independent, inherit
from mckibben.config.fields import Title
from mckibben.config.model import fail_validation, parse_model
from mckibben.control import Controller, DecouplingControl, InverseModelControl, PositionStiffnessControl, Reference
from mckibben.errors import ScenarioError
from mckibben.joint import AntagonisticJoint
from mckibben.plant import NoDisturbance, PerfectSensors
from mckibben.scenario import Scenario
from mckibben.scenario.scenario import (
    ControllerPart,
    DisturbancePart,
    FrictionPart,
    JointPart,
    LoadPart,
    SensorsPart,
    Start,
    Substeps,
    ValvePart,
    model_scope,
)
from mckibben.simulation import ACCURACY
from mckibben.study.compare.checks import check_differs, problems_of_suite
from mckibben.study.compare.settings import (
    NOMINAL_JOINT,
    PLANT,
    ComparedCalibration,
    EvaluationSettings,
    PlantCase,
    ReferenceCase,
    S,
    Share,
    SuiteSettings,
    TuningSettings,
    ValveSetup,
)
from mckibben.study.parameters import SweptParameter, parse_sweeps
from mckibben.study.parameters.uncertainty import usual_variation
from mckibben.units import (
    HINGE,
    Accuracy,
    AngularAcceleration,
    AngularVelocity,
    CommandDelay,
    Duration,
    JointType,
    PositiveTime,
)

_LOOPS: Mapping[str, object] = {
    "position": {"kp": "2 bar/rad", "ki": "60 bar/(rad*s)", "kd": "0.4 bar*s/rad"},
    "stiffness": {"kp": "0.08 bar/(N*m/rad)", "ki": "5 bar/(N*m*s/rad)", "kd": "0 bar*s/(N*m/rad)"},
}
DEFAULTS: Mapping[str, tuple[type[Controller], Mapping[str, object]]] = {
    "PID": (PositionStiffnessControl, _LOOPS),
    "PID with feedforward": (InverseModelControl, {"class": "inverse_model", "loops": _LOOPS}),
    "decoupling": (
        DecouplingControl,
        {
            "class": "decoupling",
            "feedback": {"bandwidth": "60 rad/s", "damping": 2.5},
            "observer": {"bandwidth": "200 rad/s", "damping": 2.0},
        },
    ),
}
"""Controllers that the suite of a scenario has by default, with the gains at which their tuning starts."""


def start_of(reference: Reference) -> Start:
    """Start at rest at the first angle of a reference, with the middle of the attainable stiffness."""
    return Start(angle=float(reference.angle(0.0)))


def _steps(settings: Scenario | Suite) -> dict[str, Any]:
    """The integration steps of a run, or its accuracy."""
    name = "accuracy" if settings.substeps is None else "substeps"
    return {name: getattr(settings, name)}


def _wrapped(controller: Controller, path: str = "") -> Iterator[tuple[str, Controller]]:
    """Yield the controllers within a controller, each with its path."""
    for name, inner in vars(controller).items():
        if isinstance(inner, Controller):
            yield f"{path}{name}", inner
            yield from _wrapped(inner, f"{path}{name}.")


class ControllerSuite(SuiteSettings):
    """Base of suites that are read from files."""

    @classmethod
    def parse(cls, text: str, *, source: str = "suite", folder: str | os.PathLike[str] = ".") -> Self:
        """Read a suite from text; arguments and errors as for `Scenario.parse`."""
        suite, document = parse_model(cls, text, source=source, folder=folder)
        for name, setup in suite.each.items():
            if problems := problems_of_suite(setup, document):
                raise ScenarioError(f"{source}, {setup.name}" if name else source, problems)
        return suite


class Suite(ControllerSuite):
    """A benchmark suite: plants, references, conditions and controllers.

    All controllers' models are the nominal `joint`, `load` and `valve`, independent of the plant of a run.

    Attributes
    ----------
    other_joints, joint_share
        Joints and valves that replace the suite's own in a share of the runs, and the share of the suite's own.
        Conditions on the `valve` apply to the suite's own valve.
    references
        References by name. The coupling needs one whose stiffness steps.
    max_angular_acceleration, max_angular_velocity
        Largest angular acceleration [rad/s^2] and velocity [rad/s] of a reference; sines are scaled down to them.
    setups
        Valves by name, each compared separately: see `of_setup`.
    calibration
        Whether the controllers are also compared with models that are calibrated on the plants.
    """

    plant_sections = PLANT
    examples = "examples/comparison/"

    name: Title
    joint: JointPart
    joint_share: Share = 1
    other_joints: dict[str, PlantCase] = Field(default_factory=dict)
    load: LoadPart
    valve: ValvePart = IdealValve()
    sensors: SensorsPart = PerfectSensors()
    disturbance: DisturbancePart = NoDisturbance()
    friction: FrictionPart | None = None
    command_delay: CommandDelay | None = None
    conditions: tuple[str, ...] = ()
    references: dict[str, ReferenceCase] = Field(min_length=1)
    max_angular_acceleration: AngularAcceleration | None = None
    max_angular_velocity: AngularVelocity | None = None
    setups: dict[str, ValveSetup] = Field(default_factory=dict)
    controllers: dict[str, ControllerPart] = Field(min_length=1)
    true_model: tuple[str, ...] = ()
    tuning: TuningSettings = TuningSettings()
    evaluation: EvaluationSettings = EvaluationSettings()
    calibration: ComparedCalibration | None = None
    duration: Duration
    control_period: PositiveTime
    accuracy: Accuracy = ACCURACY
    substeps: Substeps | None = None

    @field_validator("joint", mode="after")
    @classmethod
    def _is_a_pair(cls, value: AntagonisticJoint) -> AntagonisticJoint:
        if any(value.springs):
            message = "is one muscle alone, without a stiffness of its own choice at which air can be compared"
            fail_validation(message, "use `mckibben tune`")
        return value

    @property
    def joint_type(self) -> JointType:
        return self.joint.joint_type

    @classmethod
    def of(cls, scenario: Scenario, controllers: Mapping[str, Controller] | None = None, **settings: Any) -> Suite:
        """Return the suite of a scenario: its controller, named "scenario", and others by name on its reference.

        Default controllers: PID loops, the same with feedforward, and decoupling, unless the scenario's is of that
        class; on a slide, for which we know no gains of loops, decoupling alone. `settings` are other attributes, such
        as `tuning` and `evaluation`; default `conditions`: the uncertainty of the scenario, or both muscles' strengths
        by up to 10 %, and the masses of the load by up to 20 %. Raises `ParameterError` if all runs are identical.
        """
        others: Mapping[str, Any] | None = controllers
        if others is None:
            controller_class = type(scenario.controller)
            known = DEFAULTS if scenario.joint_type is HINGE else {"decoupling": DEFAULTS["decoupling"]}
            others = {name: section for name, (kind, section) in known.items() if kind is not controller_class}
        if "conditions" not in settings:
            settings["conditions"] = scenario.uncertainty or sum(usual_variation(scenario), ())
        sections = {name: getattr(scenario, name) for name in (*PLANT, "name", "duration", "control_period")}
        references = {"reference": ReferenceCase(reference=scenario.signals)}
        together = {"scenario": scenario.controller, **others}
        suite = cls(**sections, **_steps(scenario), references=references, controllers=together, **settings)
        check_differs(suite)
        return suite

    def of_setup(self, name: str) -> Self:
        """Return the suite of one of the setups alone; its valves are those of all models too.

        Its conditions are those of the suite and of the setup.
        """
        setup = self.setups[name]
        update = setup.model_dump(exclude_none=True, include={"max_angular_velocity", "substeps"})
        update |= {"valve": setup.valve, "command_delay": setup.command_delay, "setups": {}}
        conditions = (*self.conditions, *setup.conditions)
        return self.model_copy(update=update | {"name": f"{self.name}: {name}", "conditions": conditions})

    @property
    def plants(self) -> dict[str, PlantCase]:
        """Joint and valves of all plants by name, each with its share; the nominal plant comes first."""
        nominal = {"joint": self.joint, "valve": self.valve}
        others = {
            name: other.model_copy(
                update={key: section for key, section in nominal.items() if getattr(other, key) is None}
            )
            for name, other in self.other_joints.items()
        }
        return {NOMINAL_JOINT: PlantCase.model_construct(share=self.joint_share, **nominal), **others}

    def has(self, joint: str, condition: str) -> bool:
        """Whether a condition applies to a plant: other valves are used as given."""
        other = self.other_joints.get(joint)
        return other is None or other.valve is None or not condition.strip().startswith("valve.")

    @property
    def each(self) -> dict[str, Self]:
        return {name: self.of_setup(name) for name in self.setups} or super().each

    def with_substeps(self, substeps: int) -> Self:
        return self.model_copy(update={"substeps": substeps})

    def scenario(self, controller: str, reference: str = "", joint: str = NOMINAL_JOINT) -> Scenario:
        """It starts at rest at the first angle of its reference (default: the first)."""
        reference = reference or next(iter(self.references))
        control = self.controllers[controller]
        if controller not in self.true_model:
            control = independent(inherit(control, model_scope(self)))
        signals, plant = self.references[reference].reference, self.plants[joint]
        shared = {name: getattr(self, name) for name in (*PLANT, "duration", "control_period")}
        return Scenario(
            **(shared | {"joint": plant.joint, "valve": plant.valve} | _steps(self)),
            name=f"{self.name}: {controller}, {reference}"[:200],
            controller=control,
            reference=signals,
            start=start_of(signals),
        )

    def at_rest(self, scenario: S) -> S:
        return scenario.model_copy(update={"start": start_of(scenario.references())})

    def reference_over(self, reference: str) -> tuple[SweptParameter, ...]:
        """Parameters of a reference that vary."""
        return parse_sweeps(self.references[reference].over, self.example(reference))

    def tuned_inside(self, controller: str, tuned: Mapping[str, Mapping[str, float]]) -> dict[str, float]:
        """Tuned values [SI] of other controllers that a controller wraps, by their names in the wrapper."""
        return {
            f"controller.{path}.{name.partition('.')[2]}": value
            for path, inner in _wrapped(self.controllers[controller])
            for other, values in tuned.items()
            if inner == self.controllers[other]
            for name, value in values.items()
        }
