"""A scenario: everything that one simulated run needs."""

from __future__ import annotations

import abc
import contextlib
import dataclasses
import hashlib
import math
import os
from collections.abc import Iterable, Iterator, Mapping
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, NamedTuple, Self, TypeVar

import numpy as np
from jaxtyping import PyTree
from numpy.typing import NDArray
from pydantic import (
    AfterValidator,
    AliasChoices,
    Field,
    SerializationInfo,
    ValidationInfo,
    field_validator,
    model_serializer,
    model_validator,
)

from mckibben.actuator import Actuator, IdealValve
from mckibben.binding import call
from mckibben.component.calls import checked_call
from mckibben.component.checks import whole_periods
from mckibben.component.schema import ComponentField, independent, inherit, write
from mckibben.config.document import read_document
from mckibben.config.fields import Title
from mckibben.config.model import ConfigModel, DocumentModel, fail_validation
from mckibben.control import Controller, Reference
from mckibben.control.base import DiscreteTimeSystem
from mckibben.errors import FileError, McKibbenError, ParameterError, Problem, RangeError, ScenarioError, no_attribute
from mckibben.joint import AntagonisticJoint, Load
from mckibben.plant import (
    Disturbance,
    JointFriction,
    JointPlant,
    NoDisturbance,
    PerfectSensors,
    Plant,
    PlantState,
    Sensors,
)
from mckibben.plant.robot_plant import RobotStart
from mckibben.result import Remark
from mckibben.simulation import (
    ACCURACY,
    AtRest,
    Batch,
    Margins,
    SimulationResult,
    disk_margins,
    margins,
    needed_substeps,
    simulate,
    simulate_many,
)
from mckibben.units import (
    HINGE,
    Accuracy,
    Angle,
    BoundedInt,
    CommandDelay,
    Duration,
    JointType,
    PositiveTime,
    Stiffness,
)

_MOST_PERIODS = 10_000_000
_MEANT = {
    "stiffness": "joint.stiffness(angle, pressures)",
    "muscle": "joint.muscle1",
    "sweep": "mk.sweep(scenario, ['load.mass2=+-10 %'])",
} | dict.fromkeys(("run", "plot", "result"), "simulate()")
"""What is meant by names that users try."""
Substeps = Annotated[int, BoundedInt(1, 1000)]


def _units_follow(joint: AntagonisticJoint, info: ValidationInfo) -> AntagonisticJoint:
    """Let what is read after a joint have the units of its type."""
    if info.context is not None:
        info.context["joint_type"] = joint.joint_type
    return joint


JointPart = Annotated[AntagonisticJoint, ComponentField(AntagonisticJoint), AfterValidator(_units_follow)]
LoadPart = Annotated[Load, ComponentField(Load)]
ValvePart = Annotated[Actuator, ComponentField(Actuator)]
SensorsPart = Annotated[Sensors, ComponentField(Sensors)]
DisturbancePart = Annotated[Disturbance, ComponentField(Disturbance)]
FrictionPart = Annotated[JointFriction, ComponentField(JointFriction)]
ControllerPart = Annotated[Controller, ComponentField(Controller)]
ReferencePart = Annotated[Reference, ComponentField(Reference)]
T = TypeVar("T")


class RunSettings(DocumentModel):
    """Base of documents with a plant and the timing of its runs."""

    @model_validator(mode="before")
    @classmethod
    def _steps_once(cls, value: Any) -> Any:
        both = isinstance(value, dict) and value.get("substeps") is not None and value.get("accuracy") is not None
        if both and value["accuracy"] != ACCURACY:  # copies have the default
            fail_validation("has an accuracy and substeps, which both set the integration steps", "give one of them")
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
                f"the duration {duration:.12g} s is not a whole number of control periods of {value * 1e3:g} ms "
                f"({periods:.10g})",
                f"choose a duration of {near:.12g} s, or a period that divides {duration:.12g} s",
            )
        return value

    @property
    def timing(self) -> dict[str, Any]:
        """Duration, control period, accuracy and substeps, by the names of arguments of `simulate`."""
        return {name: getattr(self, name) for name in ("duration", "control_period", "accuracy", "substeps")}

    @model_serializer(mode="wrap", when_used="json")
    def _write(self, handler: Any, info: SerializationInfo) -> Any:
        return _with_steps_once(handler(self))


def _with_steps_once(written: dict[str, Any]) -> dict[str, Any]:
    """A written document with its substeps or, without them, its accuracy."""
    left_out = "accuracy" if written.get("substeps") is not None else "substeps"
    return {key: value for key, value in written.items() if key != left_out}


class BatchParts(NamedTuple):
    """Plant, references and start of the runs of a batch."""

    plant: PyTree
    reference: PyTree
    start: PyTree = AtRest(math.nan)


class StudiedScenario(RunSettings):
    """Base of scenarios: what studies use of one, whose parts have numbers, or arrays of shape (runs,)."""

    plant_parts: ClassVar[tuple[str, ...]] = ("valve", "command_delay")
    """Fields that are the plant, which a controller's model may follow."""

    if TYPE_CHECKING:  # fields of each class, in the order of its files
        name: str
        valve: Actuator
        command_delay: float | None
        control_period: float
        accuracy: float
        substeps: int | None

    section: ClassVar[str] = ""
    """Section of a file that makes it one of this class."""

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the joints of a robot, of each of which there are metrics."""
        return ()

    @property
    def muscle_names(self) -> tuple[str, ...]:
        """Names of the muscles of a robot, in the order of commands and pressures."""
        return ()

    @property
    def joint_type(self) -> JointType:
        """How its joints move, on which its units depend."""
        return HINGE

    @property
    def follows_stiffness(self) -> bool:
        """Whether its stiffness has a setpoint: not that of one muscle alone."""
        return True

    @property
    def uncertain(self) -> tuple[str, ...]:
        """Texts of uncertain parameters for which tuned gains keep their margin."""
        return ()

    @property
    def model_remarks(self) -> Iterable[Remark]:
        """Remarks on the models of the muscles."""
        return ()

    @abc.abstractmethod
    def plant(self) -> Plant:
        """Return the simulated plant."""

    @abc.abstractmethod
    def control(self) -> DiscreteTimeSystem:
        """Return the controller; parts of its model that its file does not give are those of this scenario's plant."""

    @abc.abstractmethod
    def references(self) -> PyTree:
        """Return all references over time."""

    @abc.abstractmethod
    def with_model(self, *, fixed: bool = False) -> Self:
        """Return the scenario with all parts of its controllers' models; if `fixed`, they do not follow the plant."""

    def with_fixed_model(self) -> Self:
        """Return the scenario with a controller whose model does not follow changes of the plant."""
        return self.with_model(fixed=True)

    @abc.abstractmethod
    def starts(self) -> AtRest | RobotStart:
        """Return the start of its run, with arrays where runs of a batch differ.

        Raises `McKibbenError` if there is none.
        """

    @abc.abstractmethod
    def initial(self, plant: Any) -> PlantState:
        """Return the state of a plant at the start; raises `McKibbenError` if there is none."""

    @abc.abstractmethod
    def attainable_torques(self) -> dict[str, tuple[float, float]]:
        """Return the attainable torques [N*m] of each joint that moves, by name, at the first setpoints."""

    def reference_remarks(self) -> Iterable[Remark]:
        """Remarks on references that are not exactly those of the file."""
        return ()

    def _parts(self) -> tuple[PyTree, PyTree, PyTree, PyTree]:
        return self.plant(), self.control(), self.references(), self.starts()

    @property
    def _times(self) -> dict[str, Any]:
        return {name: self.timing[name] for name in ("duration", "control_period")}

    def check_start(self) -> None:
        """Raise `McKibbenError` if its run cannot start."""
        plant, control, references, initial = self._parts()
        first = {"duration": self.control_period, "control_period": self.control_period}
        needed_substeps(plant, control, references, initial, **first)

    def needed_substeps(self) -> int:
        """Return the integration steps per control period that its run needs for the accuracy, or the given ones."""
        if self.substeps is not None:
            return self.substeps
        return needed_substeps(*self._parts(), **self._times, accuracy=self.accuracy)

    def run_once(self, *, source: str = "", warn_infeasible: bool = False) -> SimulationResult:
        """Simulate the scenario; `source` is its file, for errors. Raises `ScenarioError` if its parts do not fit."""
        with errors_of(self, source):
            plant, control, references, initial = self._parts()
            options: dict[str, Any] = {"scenario": self, "warn_infeasible": warn_infeasible}
            run = simulate(plant, control, references, **self.timing, initial=initial, **options)
        known = tuple(self.reference_remarks())
        return dataclasses.replace(run, notes=lambda: [*known, *run.notes()]) if known else run

    @checked_call
    def envelope(self) -> Any:
        """Return attainable set and feasibility of the reference, see `mckibben.reachability.envelope`."""
        return call("envelope", self)

    def batch_parts(self) -> BatchParts:
        """Return what is simulated apart from the controller, with arrays where runs of a batch differ."""
        return BatchParts(self.plant(), self.references(), self.starts())

    def run_parts(self, parts: BatchParts, control: PyTree, **options: PyTree) -> Batch:
        """Simulate parts of a batch with a controller, with options of `simulate_many`."""
        return simulate_many(parts.plant, control, parts.reference, initial=parts.start, **self.timing | options)

    @checked_call
    def simulate(self, controller: DiscreteTimeSystem | None = None, **changes: Any) -> SimulationResult:
        """Run the scenario, with another controller or other changes as for `replace`; see `mckibben.simulate`.

        Warns if its reference is not statically feasible.
        """
        changes |= {} if controller is None else self.controlled_by(controller)
        return (self.replace(**changes) if changes else self).run_once(warn_infeasible=True)

    @checked_call
    def margins(self, points: int = 20) -> Margins:
        """Return the stability margins of the loop along the run, see `mckibben.simulation.margins`."""
        return margins(*self._parts(), **self._times, substeps=self.needed_substeps(), points=points)

    def controlled_by(self, controller: DiscreteTimeSystem) -> dict[str, PyTree]:
        """Return the changes, as for `replace`, for another controller."""
        return {"controller": controller}

    def disk_margins(self, points: int) -> NDArray[np.float64]:
        """Return the least disk margin of each run of a batch, see `mckibben.simulation.disk_margins`."""
        return disk_margins(*self._parts(), **self._times, substeps=self.substeps or 1, points=points)

    @checked_call
    def tune(self, over: Any = (), cost: Any = None, **options: Any) -> Any:
        """Tune gains or other parameters, see `mckibben.tune`. Default: all gains, with the cost of `mckibben tune`."""
        return call("tune", self, over, cost, **options)

    @checked_call
    def compare(self, controllers: Mapping[str, Any] | None = None, *, out: Path | None = None, **settings: Any) -> Any:
        """Tune and compare controllers by name with that of the scenario, on its reference and in `conditions`.

        Defaults: as for `mckibben.study.compare.Suite.of`; controllers of a robot are sections as in a file. `settings`
        are attributes of a `Suite`; see `mckibben.study.compare.compare`.
        """
        return call("compare", self.suite(controllers, **settings), out)

    @abc.abstractmethod
    def suite(self, controllers: Mapping[str, object] | None = None, **settings: PyTree) -> PyTree:
        """Return the suite that compares other controllers by name with that of the scenario."""

    @checked_call
    def export(self, target: str, out: str | os.PathLike[str], **options: Any) -> Any:
        """Write controller or plant for another program, see `mckibben.export.export`."""
        return call("export", self, target, out, **options)

    @property
    def digest(self) -> bytes:
        """SHA-256 of the scenario with the absolute paths of its files: the same from whichever folder it is read."""
        return hashlib.sha256(self.dumps(folder=Path.cwd().anchor).encode()).digest()

    def run_many(self, **options: PyTree) -> Batch:
        """Simulate all runs of a batch, with options of `simulate_many`."""
        return self.run_parts(self.batch_parts(), self.control(), **options)


class Start(ConfigModel):
    """Initial equilibrium: angle [rad], and stiffness [N*m/rad] (default: the middle of the attainable range)."""

    angle: Angle = Field(default=0.0, validation_alias=AliasChoices("angle", "position"))
    stiffness: Stiffness | None = None


def model_scope(plant: Any) -> dict[str, Any]:
    """Parts of a scenario or suite that are the defaults of a controller's model."""
    return {name: getattr(plant, name) for name in ("joint", "load", "valve", "command_delay")}


class Scenario(StudiedScenario):
    """Plant, controller, reference and timing of one run, in SI; `read` and `to_yaml` know the units.

    `simulate`, `envelope`, `tune`, `compare` and `export` forward to the functions of these names.

    Its parts are the objects that are simulated: read from a file, or made in Python. Parts of a controller's
    model that its file does not give are taken from the plant (`control`). Scenarios compare by value.

    Attributes
    ----------
    joint, load, valve, sensors, disturbance, friction
        The plant; ideal valves and sensors, no disturbance torques and no friction of the joint itself by default.
    command_delay
        Time from a command to the valves [s], None for none; between two multiples of the control period, a valve
        receives the mean of the delayed command over each period.
    uncertainty
        Uncertain parameters of the plant, such as ``load.mass2=normal 3 %``, for which tuned gains keep their margin.
    controller, signals
        Controller, and reference; ``reference`` in the text and as an argument.
    start
        The initial equilibrium.
    duration, control_period
        [s]; the duration is an integer multiple of the control period.
    accuracy
        Accuracy of the angle [rad], for which the number of integration steps is chosen.
    substeps
        Integration steps per control period in place of the accuracy.

    Examples
    --------
    >>> scenario = Scenario.read("examples/pre-contracted-step-pid.yaml")
    >>> scenario.control_period
    0.001
    >>> scenario.load.mass2
    0.5
    """

    plant_parts = ("joint", "load", "valve", "command_delay")

    name: Title = Field(examples=["pre-contracted knee, PID"])
    joint: JointPart
    load: LoadPart = Field(examples=["knee-table-2"])
    valve: ValvePart = IdealValve()
    sensors: SensorsPart = PerfectSensors()
    disturbance: DisturbancePart = NoDisturbance()
    friction: FrictionPart | None = None
    command_delay: CommandDelay | None = None
    uncertainty: tuple[str, ...] | None = None
    controller: ControllerPart
    signals: ReferencePart = Field(alias="reference")
    start: Start = Start()
    duration: Duration = Field(examples=["10 s"])
    control_period: PositiveTime = Field(examples=["1 ms"])
    accuracy: Accuracy = ACCURACY
    substeps: Substeps | None = None

    @field_validator("load", mode="after")
    @classmethod
    def _load_fits(cls, value: Load, info: ValidationInfo) -> Load:
        if joint := info.data.get("joint"):
            joint.check_load(value)
        return value

    @model_validator(mode="after")
    def _stiffness_fits(self) -> Self:
        for field, stiffness in (("reference", self.signals.stiffness), ("start", self.start.stiffness)):
            if field == "reference" or stiffness is not None:
                try:
                    self.joint.check_setpoint(stiffness)
                except RangeError as error:
                    fail_validation(error.message, error.remedy, field=f"{field}.stiffness")
        return self

    @model_validator(mode="after")
    def _uncertainty_fits(self) -> Self:
        if self.uncertainty:
            try:
                call("check_uncertainty", self)
            except ParameterError as error:
                fail_validation(error.message, error.remedy, field="uncertainty")
        return self

    @field_validator("controller", mode="after")
    @classmethod
    def _commands_fit(cls, value: Controller, info: ValidationInfo) -> Controller:
        ours = type(value).__module__.startswith("mckibben.")
        if ours and getattr(info.data.get("valve"), "direct", None):
            fail_validation(
                "commands pressures, but the valve has `direct` commands, which are openings",
                "leave `direct` out, or use a user-defined controller",
            )
        return value

    @model_serializer(mode="wrap", when_used="json")
    def _write(self, handler: Any, info: SerializationInfo) -> Any:
        if info.context is not None:
            info.context["joint_type"] = self.joint.joint_type
        written = _with_steps_once(handler(self))
        if isinstance(written.get("start"), dict):
            written["start"] = {self.joint_type.words(key): value for key, value in written["start"].items()}
        usual = {"sensors": write(PerfectSensors(), ComponentField(Sensors)), "disturbance": "none"}
        return {key: value for key, value in written.items() if usual.get(key) != value}

    @classmethod
    def parse(cls, text: str, *, source: str = "", folder: str | os.PathLike[str] = ".") -> Any:
        """Read the scenario of a joint, or of a robot, whose text has a section `robot`; raises `ScenarioError`."""
        kind = cls.class_of(text)
        parsed: Any = super() if kind is cls else kind
        return parsed.parse(text, source=source, folder=folder)

    @classmethod
    def class_of(cls, text: str) -> type[StudiedScenario]:
        """Return the class of scenarios that a text is read as, by its sections."""
        others = StudiedScenario.__subclasses__() if cls is Scenario else []
        sections = read_document(text).data if others else ()
        return next((kind for kind in others if isinstance(sections, dict) and kind.section in sections), cls)

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_"):
            return super().__getattr__(name)  # type: ignore[misc]  # defined by pydantic
        raise no_attribute(self, name, _MEANT)

    def __repr__(self) -> str:
        parts = type(self.joint.geometry).__name__, type(self.load).__name__, type(self.controller).__name__
        return f"<Scenario {self.name!r}: {', '.join(parts)}, {self.duration:g} s>"

    __str__ = __repr__

    def _repr_html_(self) -> str:
        return f"<pre>{escape(self.dumps())}</pre>"

    @property
    def joint_type(self) -> JointType:
        return self.joint.joint_type

    @property
    def follows_stiffness(self) -> bool:
        return not any(self.joint.springs)

    @property
    def uncertain(self) -> tuple[str, ...]:
        return self.uncertainty or ()

    @property
    def model_remarks(self) -> Iterable[Remark]:
        return self.joint.remarks

    def plant(self) -> JointPlant:
        """Return the simulated plant."""
        names = "sensors", "disturbance", "friction", "command_delay"
        return JointPlant(self.joint, self.load, self.valve, **{name: getattr(self, name) for name in names})

    def control(self) -> Controller:
        """Return the controller; parts of its model that its file does not give are those of this scenario's plant."""
        return inherit(self.controller, model_scope(self))

    def with_model(self, *, fixed: bool = False) -> Scenario:
        control = self.control()
        return self.model_copy(update={"controller": independent(control) if fixed else control})

    def suite(self, controllers: Mapping[str, object] | None = None, **settings: PyTree) -> PyTree:
        return call("joint_suite", self, controllers, **settings)

    def reference(self) -> Reference:
        """Return angle and stiffness references over time."""
        return self.signals

    references = reference

    def attainable_torques(self) -> dict[str, tuple[float, float]]:
        low, high = self.plant().supplied_joint.attainable_torque(float(self.reference()(0.0).angle))
        return {"": (float(low), float(high))}

    def starts(self) -> AtRest:
        stiffness = self.start.stiffness
        return AtRest(self.start.angle, math.nan if stiffness is None else stiffness)

    def initial(self, plant: JointPlant) -> PlantState:
        return plant.equilibrium(self.start.angle, stiffness=self.start.stiffness)


def run_scenario(scenario: StudiedScenario) -> SimulationResult:
    """Return the result of a scenario, as `run_once`."""
    return scenario.run_once()


@contextlib.contextmanager
def errors_of(scenario: StudiedScenario, source: str) -> Iterator[None]:
    """Errors of a run as `ScenarioError` with the field of the scenario; `source` is its file."""
    try:
        yield
    except FileError:
        raise  # has its own file and line
    except McKibbenError as error:
        own = getattr(error, "field", "") or ""
        field = own if own.partition(".")[0] in type(scenario).model_fields else "start"  # all else has been checked
        problem = Problem.of(error, _line_of(source, field), field)
        raise ScenarioError(source or scenario.name, [problem]) from error


def _line_of(source: str, field: str) -> int | None:
    """Line of a field in a file; None without a file or the field."""
    if not Path(source).is_file():
        return None
    document, place = read_document(Path(source).read_text(encoding="utf-8")), tuple(field.split("."))
    return document.line(place) if place[:1] in document.lines else None
