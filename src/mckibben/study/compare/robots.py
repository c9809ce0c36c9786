"""Suites of a robot: controllers of all its joints, compared on runs with other muscles, bodies, valves and noise."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar, Self

import numpy as np
from jaxtyping import PyTree
from pydantic import Field, SerializationInfo, ValidationError, ValidationInfo, field_serializer, field_validator

from mckibben.config.fields import Title
from mckibben.config.model import located_below
from mckibben.errors import ScenarioError
from mckibben.scenario import batched, find_parameters, with_values
from mckibben.scenario.robot import RobotScenario
from mckibben.simulation import LEAST_DISK_MARGIN
from mckibben.study.compare.checks import check_differs
from mckibben.study.compare.settings import NOMINAL_JOINT, EvaluationSettings, TuningSettings
from mckibben.study.compare.suite import DEFAULTS, ControllerSuite
from mckibben.study.parameters.uncertainty import usual_variation
from mckibben.study.tune import gain_ranges

_CONTROL = ("controller", "controllers")
_OWN = "scenario"


class RobotSuite(ControllerSuite):
    """A suite of a robot: a scenario, and other controllers by name; each has `controller` or `controllers`.

    The controller of the scenario is the first, named "scenario". Models are those of the nominal robot.
    """

    examples = "examples/comparison/"
    plant_sections = ("robot", "valve", "ground", "sensors", "command_delay")
    references: ClassVar[PyTree] = {}  # pyrefly: ignore[bad-override]  # a field of the other suite
    other_joints: ClassVar[PyTree] = {}  # pyrefly: ignore[bad-override]

    name: Title
    base: RobotScenario = Field(alias=_OWN)
    conditions: tuple[str, ...] = ()
    controllers: dict[str, RobotScenario] = Field(default_factory=dict, validate_default=True)
    true_model: tuple[str, ...] = ()
    tuning: TuningSettings = TuningSettings()
    evaluation: EvaluationSettings = EvaluationSettings()

    @classmethod
    def of(cls, scenario: RobotScenario, controllers: Mapping[str, object] | None = None, **settings: PyTree) -> Self:
        """Return the suite of a scenario, with other controllers by name: sections as in a file.

        Default: PID loops, the same with feedforward, and decoupling of each joint, where all have a pair of muscles,
        and computed torque, unless the scenario has that class; their gains are halved until the loop has a disk
        margin. `settings` as for `Suite.of`.
        """
        others = _default_controllers(scenario) if controllers is None else controllers
        usual: dict[str, PyTree] = {"conditions": sum(usual_variation(scenario), ())}
        suite = cls(name=scenario.name, scenario=scenario, controllers=others, **usual | settings)
        check_differs(suite)
        return suite

    @field_validator("controllers", mode="wrap")
    @classmethod
    def _of_the_robot(cls, value: PyTree, handler: PyTree, info: ValidationInfo) -> PyTree:
        base: RobotScenario | None = info.data.get("base")
        if base is None or not isinstance(value, dict):
            return handler(value)
        shared = {name: getattr(base, name) for name in RobotScenario.model_fields if name not in _CONTROL}
        shared = {name: part for name, part in shared.items() if part is not None}
        made = {_OWN: base}
        for name, section in value.items():
            if isinstance(section, RobotScenario):
                made[name] = section
                continue
            try:
                made[name] = RobotScenario.model_validate(shared | dict(section), context=info.context)
            except ValidationError as error:
                raise located_below(error, (name,)) from None
        return made

    @field_serializer("controllers", when_used="json")
    def _sections(self, controllers: dict[str, RobotScenario], info: SerializationInfo) -> dict[str, object]:
        written = {name: own.model_dump(mode="json", context=info.context) for name, own in controllers.items()}
        return {
            name: {key: whole[key] for key in _CONTROL if key in whole}
            for name, whole in written.items()
            if name != _OWN
        }

    @property
    def timing(self) -> dict[str, PyTree]:
        return self.base.timing

    def scenario(self, controller: str, reference: str = "", joint: str = NOMINAL_JOINT) -> RobotScenario:
        own = self.controllers[controller]
        return own.with_model() if controller in self.true_model else own.with_fixed_model()

    def with_substeps(self, substeps: int) -> Self:
        change = {"substeps": substeps}
        controllers = {name: own.model_copy(update=change) for name, own in self.controllers.items()}
        return self.model_copy(update={"base": self.base.model_copy(update=change), "controllers": controllers})


def _default_controllers(scenario: RobotScenario) -> dict[str, RobotScenario]:
    """The controllers that apply to a robot, other than its own."""
    own = [scenario.controller, *scenario.controllers.values()]
    _, decoupling = DEFAULTS["decoupling"]
    sections: dict[str, PyTree] = {"computed torque": {"controller": {**decoupling, "class": "computed_torque"}}}
    joints = scenario.joint_names
    sections |= {name: {"controllers": dict.fromkeys(joints, section)} for name, (_, section) in DEFAULTS.items()}
    found = {}
    for name, section in sections.items():
        try:
            other = RobotSuite(name=scenario.name, scenario=scenario, controllers={name: section}).controllers[name]
        except ScenarioError:  # a joint without a pair of muscles
            continue
        if {type(part) for part in (other.controller, *other.controllers.values())} != set(map(type, own)):
            found[name] = _stable(other)
    return found


def _stable(scenario: RobotScenario) -> RobotScenario:
    """The scenario with gains that are halved until they have the disk margin of tuned ones, or the largest margin."""
    gains, parts = find_parameters(scenario, gain_ranges(scenario)), 0.5 ** np.arange(4)
    margins = batched(scenario, {gain.name: float(gain.nominal or 0) * parts for gain in gains}).disk_margins(4)
    best = np.argmax(np.minimum(np.nan_to_num(margins), LEAST_DISK_MARGIN))
    return with_values(scenario, {gain.name: float(gain.nominal or 0) * parts[best] for gain in gains})
