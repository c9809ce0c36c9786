"""A scenario: everything that one simulated run needs."""

from __future__ import annotations

import os
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from pydantic import Field, ValidationInfo, field_validator, model_serializer

from mckibben.component.checks import whole_periods
from mckibben.config.document import to_text
from mckibben.config.fields import Title
from mckibben.config.model import ConfigModel, fail_validation, parse_model, read_text
from mckibben.storage.files import atomic_write
from mckibben.study.scenario.controller import AnyController, ControllerSpec
from mckibben.study.scenario.plant import (
    AnyDisturbance,
    AnyLoad,
    AnySensors,
    AnyValve,
    JointFrictionSpec,
    JointSpec,
    StartSpec,
)
from mckibben.study.scenario.reference import ReferenceSpec
from mckibben.units import BoundedInt, CommandDelay, Duration, PositiveTime

if TYPE_CHECKING:
    from mckibben.control import Controller, Reference
    from mckibben.plant import JointPlant, PlantState

_MOST_PERIODS = 10_000_000


class RunSpec(ConfigModel):
    """Base of files with a plant and the timing of its runs."""

    @field_validator("valve", mode="before", check_fields=False)
    @classmethod
    def _ideal(cls, value: Any) -> Any:
        if value == "ideal":
            return None
        if isinstance(value, str) and value:
            fail_validation(f"{value[:40]!r} is no valve", "write ideal, or {time_constant: 20 ms}")
        return value

    @field_validator("control_period", mode="after", check_fields=False)
    @classmethod
    def _whole_periods(cls, value: float, info: ValidationInfo) -> float:
        duration = info.data.get("duration")
        if duration is None:
            return value
        periods = duration / value
        if periods > _MOST_PERIODS:
            fail_validation(
                f"{value * 1e3:g} ms divides the duration {duration:.12g} s into more than {_MOST_PERIODS} periods",
                "choose a longer period or a shorter duration",
            )
        if whole_periods(duration, value) is None:
            near = max(round(periods), 1) * value
            fail_validation(
                f"the duration {duration:.12g} s is no whole number of control periods of {value * 1e3:g} ms "
                f"({periods:.10g})",
                f"choose a duration of {near:.12g} s, or a period that divides {duration:.12g} s",
            )
        return value

    @model_serializer(mode="wrap", when_used="json")
    def _write(self, handler: Any) -> Any:
        written = handler(self)
        return {**written, "valve": written.get("valve") or "ideal"}

    def dumps(self, *, folder: str | os.PathLike[str] = ".") -> str:
        """Text that `parse` reads back to the last bit; paths are relative to a folder."""
        return to_text(self.model_dump(mode="json", by_alias=True, context={"folder": Path(folder)}))


class Scenario(RunSpec):
    """Plant, controller, reference and timing of one run, in SI; `read` and `to_yaml` know the units.

    Scenarios compare by value. Paths are absolute here, and relative to the file in the text.

    Attributes
    ----------
    valve, sensors, disturbance, friction
        None for ideal valves and sensors, no disturbance torques, and no friction of the joint itself.
    command_delay
        Time from a command to the valves [s], None for none; in between two multiples of the control period a valve
        gets the mean command over it.
    signals
        The references; ``reference`` in the text and as an argument.
    start
        The initial equilibrium.
    duration, control_period
        [s]; the first is a whole number of the second.
    substeps
        Integration steps a control period.

    Examples
    --------
    >>> scenario = Scenario.read("examples/pre-contracted-step-pid.yaml")
    >>> scenario.control_period
    0.001
    >>> scenario.plant()
    JointPlant(...)
    """

    name: Title = Field(examples=["pre-contracted knee, PID"])
    joint: JointSpec
    load: AnyLoad = Field(examples=["knee-table-2"])
    valve: AnyValve | None = None
    sensors: AnySensors | None = None
    disturbance: AnyDisturbance | None = None
    friction: JointFrictionSpec | None = None
    command_delay: CommandDelay | None = None
    controller: AnyController
    signals: ReferenceSpec = Field(alias="reference")
    start: StartSpec = StartSpec()
    duration: Duration = Field(examples=["10 s"])
    control_period: PositiveTime = Field(examples=["1 ms"])
    substeps: Annotated[int, BoundedInt(1, 1000)] = 4

    @field_validator("controller", mode="after")
    @classmethod
    def _friction_known(cls, value: ControllerSpec, info: ValidationInfo) -> ControllerSpec:
        model = value.model or info.data.get("joint")
        if value.friction_compensation and model is not None and not model.has_friction:
            fail_validation(
                "has friction_compensation, but no muscle of its model has friction",
                "give the muscles of the model `friction`, or leave the compensation out",
            )
        return value

    @field_validator("controller", mode="after")
    @classmethod
    def _commands_fit(cls, value: Any, info: ValidationInfo) -> Any:
        if isinstance(value, ControllerSpec) and getattr(info.data.get("valve"), "direct", None):
            fail_validation(
                "commands pressures, but the valve has `direct` commands, which are openings",
                "leave `direct` out, or name a controller class of your own",
            )
        return value

    @classmethod
    def read(cls, path: str | os.PathLike[str]) -> Scenario:
        """Read a scenario file; raises ScenarioError with every problem: line, field, value, range and remedy."""
        return cls.parse(read_text(path), source=os.fspath(path), folder=Path(path).parent)

    @classmethod
    def parse(cls, text: str, *, source: str = "scenario", folder: str | os.PathLike[str] = ".") -> Scenario:
        """Read a scenario from YAML text; errors as for `read`, with `source`; paths are relative to `folder`."""
        return parse_model(cls, text, source=source, folder=folder)[0]

    def _repr_html_(self) -> str:
        return f"<pre>{escape(self.dumps())}</pre>"

    def to_yaml(self, path: str | os.PathLike[str]) -> None:
        """Write the scenario to a file that `read` reads back to the last bit."""
        with atomic_write(path, overwrite=True) as part:
            part.write_text(self.dumps(folder=Path(path).parent), encoding="utf-8")

    def plant(self) -> JointPlant:
        """The simulated plant."""
        from mckibben.study.scenario.building import build_plant

        parts = self.joint, self.load, self.valve, self.sensors, self.disturbance, self.friction, self.command_delay
        return build_plant(*parts)

    def control(self) -> Controller:
        """The controller, with its own model of the joint."""
        from mckibben.study.scenario.building import build_control

        return build_control(self.controller, self.joint, self.load, self.valve)

    def with_fixed_model(self) -> Scenario:
        """The scenario with the controller's model written out, so that it does not follow changes of the plant."""
        return self.model_copy(update={"controller": self.controller.with_model(self.joint, self.load, self.valve)})

    def reference(self) -> Reference:
        """Angle and stiffness references over time."""
        from mckibben.control import Reference

        return Reference(angle=self.signals.angle.build(), stiffness=self.signals.stiffness.build())

    def initial(self, plant: JointPlant) -> PlantState:
        """The initial equilibrium of a plant; raises UnreachableError if there is none."""
        return plant.equilibrium(self.start.angle, stiffness=self.start.stiffness)
