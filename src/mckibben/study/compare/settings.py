"""Settings of suites: cases of plants and references, tuning and evaluation, and the base of suites."""

from __future__ import annotations

import abc
from collections.abc import Mapping
from typing import TYPE_CHECKING, Annotated, ClassVar, Self, TypeVar

from jaxtyping import PyTree
from pydantic import Field, ValidationInfo, field_validator, model_validator

from mckibben.config.model import ConfigModel, fail_validation
from mckibben.errors import McKibbenError, ParameterError
from mckibben.scenario import StudiedScenario, list_parameters, with_values
from mckibben.scenario.scenario import (
    JointPart,
    ReferencePart,
    RunSettings,
    Substeps,
    ValvePart,
)
from mckibben.study.parameters import SweptParameter, parse_sweeps, sweep_parameters
from mckibben.study.tune import Cost, gain_ranges, parse_cost, parse_ranges
from mckibben.units import (
    HINGE,
    Angle,
    AngularVelocity,
    BoundedInt,
    CommandDelay,
    JointType,
    Length,
    PositiveMass,
    deg,
)

S = TypeVar("S", bound=StudiedScenario)
Share = Annotated[int, BoundedInt(1, 1000)]
Seed = Annotated[int, BoundedInt(0, 2**31 - 1)]
_MOST = 1_000_000

NOMINAL_JOINT = "nominal"
"""Plant name of the suite's own joint, which the controllers' models use."""
PLANT = ("joint", "load", "valve", "sensors", "disturbance", "friction", "command_delay")
"""Sections of a suite that are those of a scenario, and whose parameters conditions can vary."""


class PlantCase(ConfigModel):
    """A joint, valves or both that replace the suite's own, and their share of the runs."""

    share: Share = 1
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

    share: Share = 1
    reference: ReferencePart
    over: tuple[str, ...] = ()


def _usual_cost(kind: JointType) -> str:
    return f"angle_rmse/0.1 {kind.shown('deg')} + stiffness_rmse/0.5 {kind.shown('N*m/rad')}"


class TuningSettings(ConfigModel):
    """Tuning of each controller by CMA-ES, with the same budget.

    A search has ``population * generations`` trials, each simulated in all training runs. After the searches from
    `starts` for least cost, another is for least angle error at the air of the first controller.
    """

    cost: str = _usual_cost(HINGE)
    runs: Annotated[int, BoundedInt(1, _MOST)] = 32  # training runs per point
    seed: Seed = 99
    starts: Annotated[int, BoundedInt(1, 1000)] = 2  # the gains of the file, then random ones
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
    seed: Seed = 1


class ComparedCalibration(ConfigModel):
    """Calibration of the models of all controllers on the plants of the first evaluation runs, before these.

    The experiment is that of `mckibben calibrate` with a weight, whose limb is not weighed, without disturbance; the
    first controller, as in the file, sweeps slowly.
    """

    weight: PositiveMass
    distance: Length = 0.2
    angle: Angle = 10 * deg  # swept to either side
    runs: Annotated[int, BoundedInt(2, _MOST)] = 32


class SuiteSettings(RunSettings):
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

    @property
    def each(self) -> dict[str, Self]:
        """Suites that are compared separately, by the name of their setup; without setups this one."""
        return {"": self}

    @property
    def has_noise(self) -> bool:
        """Whether its sensors have noise."""
        return "sensors.seed" in [parameter.name for parameter in list_parameters(self.example())]

    @property
    def joint_type(self) -> JointType:
        """Joint type of its joints."""
        return HINGE

    @property
    def cost(self) -> Cost:
        """Cost of a run, by default in the units of its joint."""
        text = self.tuning.cost
        return parse_cost(_usual_cost(self.joint_type) if text == _usual_cost(HINGE) else text, self.joint_type)

    @model_validator(mode="after")
    def _cost_fits(self) -> Self:
        try:
            self.cost  # noqa: B018
        except McKibbenError as error:
            fail_validation(error.message, error.remedy, field="tuning.cost")
        return self

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
