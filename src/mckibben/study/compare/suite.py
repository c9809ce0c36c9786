"""Benchmark suites: plants, references, conditions and controllers, and their consistency."""

from __future__ import annotations

import abc
import os
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Self, TypeVar

from jaxtyping import PyTree
from pydantic import AfterValidator, Field, ValidationInfo, field_validator, model_validator

from mckibben.actuator import IdealValve
from mckibben.component.schema import independent, inherit
from mckibben.config.fields import Title
from mckibben.config.model import ConfigModel, fail_validation, parse_model
from mckibben.control import Controller, DecouplingControl, PositionStiffnessControl, Reference
from mckibben.errors import ParameterError, ScenarioError
from mckibben.plant import NoDisturbance, PerfectSensors
from mckibben.scenario import Scenario, StudiedScenario, list_parameters, with_values
from mckibben.scenario.scenario import (
    ControllerPart,
    DisturbancePart,
    FrictionPart,
    JointPart,
    LoadPart,
    ReferencePart,
    RunSettings,
    SensorsPart,
    Start,
    Substeps,
    ValvePart,
    model_scope,
)
from mckibben.simulation import ACCURACY
from mckibben.study.compare.checks import NOMINAL_JOINT, PLANT, check_differs, problems_of_suite
from mckibben.study.parameters import SweptParameter, parse_sweeps, sweep_parameters
from mckibben.study.parameters.uncertainty import usual_variation
from mckibben.study.tune import Cost, gain_ranges, parse_cost, parse_ranges
from mckibben.units import (
    Accuracy,
    AngularAcceleration,
    AngularVelocity,
    BoundedInt,
    CommandDelay,
    Duration,
    PositiveTime,
)

S = TypeVar("S", bound=StudiedScenario)
_Share = Annotated[int, BoundedInt(1, 1000)]
_Seed = Annotated[int, BoundedInt(0, 2**31 - 1)]
_MOST = 1_000_000

DEFAULTS: Mapping[str, tuple[type[Controller], Mapping[str, object]]] = {
    "PID": (
        PositionStiffnessControl,
        {
            "position": {"kp": "2 bar/rad", "ki": "60 bar/(rad*s)", "kd": "0.4 bar*s/rad"},
            "stiffness": {"kp": "0.08 bar/(N*m/rad)", "ki": "5 bar/(N*m*s/rad)", "kd": "0 bar*s/(N*m/rad)"},
        },
    ),
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


class PlantCase(ConfigModel):
    """A joint, valves or both that replace the suite's own, and their share of the runs."""

    share: _Share = 1
    joint: JointPart | None = None
    valve: ValvePart | None = None

    @model_validator(mode="after")
    def _differs(self) -> Self:
        if self.joint is None and self.valve is None:
            fail_validation("is the suite's own plant", "give a `joint`, a `valve` or both")
        return self


class ValveSetup(ConfigModel):
    """Valves of a lab: the comparison is made for each setup, with controllers that have its valves as their model.

    Its conditions are in addition to those of the suite.
    """

    valve: ValvePart
    command_delay: CommandDelay | None = None
    conditions: tuple[str, ...] = ()
    max_angular_velocity: AngularVelocity | None = None
    substeps: Substeps | None = None


class ReferenceCase(ConfigModel):
    """A reference, the parameters that vary between runs, and its share of the runs."""

    share: _Share = 1
    reference: ReferencePart
    over: tuple[str, ...] = ()


def _checked_cost(text: str) -> str:
    parse_cost(text)
    return text


CostText = Annotated[str, AfterValidator(_checked_cost)]


class TuningSettings(ConfigModel):
    """Tuning of each controller by CMA-ES, with the same budget except for those in `starts_of`.

    A search has ``population * generations`` trials, each simulated in all training runs. After the searches from
    `starts` for least cost, another is for least angle error at the air of the first controller.
    """

    cost: CostText = "angle_rmse/0.1 deg + stiffness_rmse/0.5 N*m/rad"
    runs: Annotated[int, BoundedInt(1, _MOST)] = 32  # training runs per point
    seed: _Seed = 99
    starts: Annotated[int, BoundedInt(1, 1000)] = 2  # the gains of the file, then random ones
    starts_of: dict[str, Annotated[int, BoundedInt(1, 1000)]] = Field(default_factory=dict)  # of individual controllers
    candidates: Annotated[int, BoundedInt(0, 10_000)] = 0  # random gains, of which a search starts at the best
    generations: Annotated[int, BoundedInt(1, 100_000)] = 40
    population: Annotated[int, BoundedInt(4, 10_000)] = 16
    finalists: Annotated[int, BoundedInt(0, 1000)] = 0  # trials of least cost, evaluated again on more runs
    finalist_runs: Annotated[int, BoundedInt(1, _MOST)] = 400
    decades: Annotated[int, BoundedInt(1, 6)] = 1  # powers of ten down and up from the gains in the file
    over: dict[str, tuple[str, ...]] = Field(default_factory=dict)  # other parameters and ranges, by controller
    untuned: tuple[str, ...] = ()  # controllers

    @property
    def finalist_seed(self) -> int:
        """Seed of the runs of the finalists."""
        return self.seed + 1


class EvaluationSettings(ConfigModel):
    """Runs on which controllers are compared, with a seed different from the tuning."""

    runs: Annotated[int, BoundedInt(2, _MOST)] = 512
    seed: _Seed = 1


class ControllerSuite(RunSettings):
    """Base of suites: controllers, their tuning, and the conditions of the runs on which they are compared.

    A suite without cases of `references` has the references of its scenario.

    Attributes
    ----------
    conditions
        Plant parameters that vary, such as ``load.mass2=+-50 %``; see `mckibben.study.parameters.parse_sweep`.
    controllers
        Controllers by name; all are compared with the first.
    true_model
        Controllers whose model is the plant of each run, to show the value of exact plant knowledge.
    tuning, evaluation
        Training runs and budget, and evaluation runs.
    """

    kind = "suite"
    plant_sections: ClassVar[tuple[str, ...]] = ()
    """Sections of a scenario whose parameters conditions can vary."""

    if TYPE_CHECKING:  # fields of each class, in the order of its files
        references: PyTree
        other_joints: PyTree
        name: str
        conditions: tuple[str, ...]
        controllers: dict[str, PyTree]
        true_model: tuple[str, ...]
        tuning: TuningSettings
        evaluation: EvaluationSettings

    @abc.abstractmethod
    def scenario(self, controller: str, reference: str = "", joint: str = NOMINAL_JOINT) -> PyTree:
        """Return the scenario of a run before its conditions.

        The controller has the nominal model, or that of the plant if it is in `true_model`.
        """

    @abc.abstractmethod
    def with_substeps(self, substeps: int) -> Self:
        """Return the suite with a number of integration steps per control period."""

    def at_rest(self, scenario: S) -> S:
        """Return the scenario of a run with the start of its reference."""
        return scenario

    def example(self, reference: str = "", joint: str = NOMINAL_JOINT) -> PyTree:
        """A run of the first controller."""
        return self.scenario(next(iter(self.controllers)), reference, joint)

    def tuned_inside(self, controller: str, tuned: Mapping[str, Mapping[str, float]]) -> dict[str, float]:
        """Tuned values [SI] of other controllers that a controller wraps, by their names in the wrapper."""
        return {}

    @field_validator("evaluation", mode="after", check_fields=False)
    @classmethod
    def _other_seed(cls, value: EvaluationSettings, info: ValidationInfo) -> EvaluationSettings:
        tuning = info.data.get("tuning")
        if tuning is not None and (
            value.seed == tuning.seed or (tuning.finalists and value.seed == tuning.finalist_seed)
        ):
            fail_validation(
                "is a seed of the tuning, or of its finalists", "give another: training runs do not count as evaluation"
            )
        return value

    @classmethod
    def parse(cls, text: str, *, source: str = "suite", folder: str | os.PathLike[str] = ".") -> Self:
        """Read a suite from text; arguments and errors as for `Scenario.parse`."""
        suite, document = parse_model(cls, text, source=source, folder=folder)
        for name, own in suite.each.items():
            if problems := problems_of_suite(own, document):
                raise ScenarioError(f"{source}, {own.name}" if name else source, problems)
        return suite

    @property
    def each(self) -> dict[str, Self]:
        """Suites that are compared separately, by the name of their setup; without setups this one."""
        return {"": self}

    @property
    def has_noise(self) -> bool:
        """Whether its sensors have noise."""
        return "sensors.seed" in [parameter.name for parameter in list_parameters(self.example())]

    @property
    def cost(self) -> Cost:
        """Cost of a run."""
        return parse_cost(self.tuning.cost)

    def tuned_scenario(self, controller: str, values: Mapping[str, float]) -> PyTree:
        """Scenario of the first reference, with the plant of the models, and tuned values [SI] of the controller."""
        scenario = self.scenario(controller)
        return with_values(scenario, values) if values else scenario

    def conditions_over(self) -> tuple[SweptParameter, ...]:
        """Plant parameters that vary."""
        return parse_sweeps(self.conditions, self.example())

    def tuned_over(self, controller: str) -> tuple[SweptParameter, ...]:
        """Tuned parameters of a controller and their ranges, by default `decades` around its gains.

        Raises `ParameterError` if it has no nonzero gain.
        """
        if controller in self.tuning.untuned:
            return ()
        scenario = self.scenario(controller)
        if controller in self.tuning.over:
            return parse_ranges(self.tuning.over[controller], scenario)
        gains = gain_ranges(scenario, float(self.tuning.decades))
        if not gains:
            raise ParameterError(f"{controller} has no nonzero gain", remedy="name it in tuning.over or tuning.untuned")
        return sweep_parameters(scenario, gains)


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
    """

    plant_sections = PLANT
    examples = "examples/comparison/"

    name: Title
    joint: JointPart
    joint_share: _Share = 1
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
    duration: Duration
    control_period: PositiveTime
    accuracy: Accuracy = ACCURACY
    substeps: Substeps | None = None

    @classmethod
    def of(cls, scenario: Scenario, controllers: Mapping[str, Controller] | None = None, **settings: Any) -> Suite:
        """Return the suite of a scenario: its controller, named "scenario", and others by name on its reference.

        Default controllers: PID loops and decoupling, unless the scenario's is of that class. `settings` are other
        attributes, such as `tuning` and `evaluation`; default `conditions`: the uncertainty of the scenario, or both
        muscles' strengths by up to 10 %, and the masses of the load by up to 20 %. Raises `ParameterError` if all runs
        are identical.
        """
        others: Mapping[str, Any] | None = controllers
        if others is None:
            own = type(scenario.controller)
            others = {name: section for name, (kind, section) in DEFAULTS.items() if kind is not own}
        if "conditions" not in settings:
            settings["conditions"] = scenario.uncertainty or sum(usual_variation(scenario), ())
        parts = {name: getattr(scenario, name) for name in (*PLANT, "name", "duration", "control_period")}
        references = {"reference": ReferenceCase(reference=scenario.signals)}
        together = {"scenario": scenario.controller, **others}
        suite = cls(**parts, **_steps(scenario), references=references, controllers=together, **settings)
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
        own = {"joint": self.joint, "valve": self.valve}
        others = {
            name: other.model_copy(update={key: part for key, part in own.items() if getattr(other, key) is None})
            for name, other in self.other_joints.items()
        }
        return {NOMINAL_JOINT: PlantCase.model_construct(share=self.joint_share, **own), **others}

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
