"""Benchmark suites: plants, references, conditions and controllers, and their consistency."""

from __future__ import annotations

import os
import re
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, ClassVar

import jax
from pydantic import Field, ValidationInfo, field_validator, model_serializer

from mckibben.config.document import Document, dotted, to_text
from mckibben.config.fields import Title
from mckibben.config.model import ConfigModel, fail_validation, parse_model, read_text
from mckibben.errors import McKibbenError, ParameterError, Problem, ScenarioError, suggest
from mckibben.study.parameters import Over, over, read_over, read_overs
from mckibben.study.scenario import Scenario
from mckibben.study.scenario.controller import AnyController
from mckibben.study.scenario.plant import AnyDisturbance, AnyLoad, AnySensors, AnyValve, JointSpec, StartSpec
from mckibben.study.scenario.reference import ReferenceSpec, SignalSpec
from mckibben.study.scenario.scenario import check_divides_duration
from mckibben.study.tune import Cost, around_gains, read_cost, read_ranges
from mckibben.units import AngularAcceleration, BoundedInt, Duration, PositiveTime

_OF_PLANT = ("joint", "load", "valve", "sensors", "disturbance")
_LONGEST_NAME = 80


def filename(name: str) -> str:
    """A name as part of a path.

    >>> filename("Sliding mode, 2")
    'sliding-mode-2'
    """
    return re.sub(r"[^A-Za-z0-9]+", "-", name).strip("-").lower() or "controller"


def problems_of_suite(suite: Suite, document: Document, believed: str) -> list[Problem]:
    """Check the parts of a suite against each other.

    Parameters
    ----------
    suite, document
        The suite, and the document that it was read from.
    believed
        The name of its own joint, which no other may have.
    """
    found: list[Problem] = []

    def look(place: tuple[str | int, ...], check: Callable[[], object]) -> None:
        try:
            check()
        except McKibbenError as error:
            found.append(Problem.of(error, document.line(place), dotted(place)))

    for key, reserved in (("other_joints", believed), ("references", ""), ("controllers", "")):
        for name in getattr(suite, key):
            look((key, name), lambda name=name, reserved=reserved: _check_name(name, reserved))
    for name in suite.controllers:
        look(("controllers", name), lambda name=name: _check_controller(suite, name))
    if found:  # no scenario can be made of it
        return found
    look(("conditions",), lambda: _check_differs(suite))
    look(("tuning", "cost"), lambda: _check_cost(suite))
    for i, text in enumerate(suite.conditions):
        look(("conditions", i), lambda text=text: _about_plant(read_over(text, suite.example())))
    if not found:
        look(("conditions",), suite.conditions_over)
    for name, case in suite.references.items():
        for key in ("angle", "stiffness"):
            place = ("references", name, "reference", key)
            look(place, lambda key=key, case=case: _plain(getattr(case.reference, key)))
        before = len(found)
        for i, text in enumerate(case.over):
            look(
                ("references", name, "over", i),
                lambda name=name, text=text: _about_reference(text, suite.example(name)),
            )
        if len(found) == before:
            look(("references", name, "over"), lambda name=name: suite.reference_over(name))
    for key, names in (("over", list(suite.tuning.over)), ("untuned", suite.tuning.untuned)):
        for i, name in enumerate(names):
            place = ("tuning", key, name if key == "over" else i)
            look(place, lambda name=name: _check_known(suite, name))
    if not found:
        for name in suite.other_joints:
            look(("other_joints", name), lambda name=name: _check_joint(suite, name))
        for name in suite.controllers:
            place = ("tuning", "over", name) if name in suite.tuning.over else ("controllers", name)
            look(place, lambda name=name: _about_controller(suite.tuned_over(name)))
    return found


def _check_name(name: str, reserved: str) -> None:
    if not name.strip() or len(name) > _LONGEST_NAME or not name.isprintable():
        raise ParameterError(f"a name is one line of 1 to {_LONGEST_NAME} characters", remedy="give another")
    if name == reserved:
        raise ParameterError(f"{name!r} is the name of the suite's own joint", remedy="give another")


def _check_controller(suite: Suite, name: str) -> None:
    """Its model has the friction that it is to make up for, and what is kept of it has a file of its own."""
    spec = suite.controllers[name]
    if spec.friction_compensation and not (spec.model or suite.joint).has_friction:
        raise ParameterError(
            "has friction_compensation, but no muscle of its model has friction",
            remedy="give the muscles of the model `friction`, or leave the compensation out",
        )
    same = next(other for other in suite.controllers if filename(other) == filename(name))
    if same != name:
        raise ParameterError(f"would be kept in the same file as {same!r}", remedy="give it another name")


def _check_differs(suite: Suite) -> None:
    first, *others = suite.references.values()
    if not (others or first.over or suite.conditions or suite.sensors or suite.other_joints):
        raise ParameterError("nothing differs from run to run", remedy="give conditions, or `over` of a reference")


def _check_cost(suite: Suite) -> None:
    """A metric that a run has no number for would make it a lost one."""
    steps = all(case.reference.stiffness.step is not None for case in suite.references.values())
    if "coupling" in suite.cost.metrics and not steps:
        raise ParameterError("coupling is of steps of the stiffness", remedy="leave it out, or let all references step")


def _check_joint(suite: Suite, name: str) -> None:
    """Runs of all joints are computed together: the same conditions, specimens and kinds of law."""
    scenario, believed = suite.example(joint=name), suite.example()
    read_overs(suite.conditions, scenario)
    if jax.tree.structure(scenario.plant()) != jax.tree.structure(believed.plant()):
        raise ParameterError(
            "differs from the suite's own joint in more than numbers",
            remedy="give both the same specimens, kinds of law and parts",
        )


def _check_known(suite: Suite, name: str) -> None:
    if name not in suite.controllers:
        raise ParameterError(f"there is no controller {name!r}", remedy=suggest(name, list(suite.controllers)))


def _about_plant(one: Over) -> None:
    if one.name.split(".")[0] not in _OF_PLANT:
        raise ParameterError(
            f"{one.name} is not a parameter of the plant", remedy=f"a condition is a number of {', '.join(_OF_PLANT)}"
        )


def _about_reference(text: str, scenario: Scenario) -> None:
    one = read_over(text, scenario)
    if not one.name.startswith("reference."):
        raise ParameterError(f"{one.name} is not a parameter of the reference", remedy="put it among the conditions")


def _about_controller(over: tuple[Over, ...]) -> None:
    for one in over:
        if not one.name.startswith("controller."):
            raise ParameterError(
                f"{one.name} is not a parameter of the controller", remedy="tune numbers that begin with `controller.`"
            )


def _plain(signal: SignalSpec) -> None:
    if signal.samples is not None:
        raise ParameterError("samples cannot be compared on", remedy="give a constant, step, sine or multisine")


_Share = Annotated[int, BoundedInt(1, 1000)]
_Seed = Annotated[int, BoundedInt(0, 2**31 - 1)]
_MOST = 1_000_000

AS_BELIEVED = "as believed"
"""Name of the controllers' own model as the plant of a run."""


def start_of(reference: ReferenceSpec) -> StartSpec:
    """Initial equilibrium of a run: first angle of its reference, middle of the attainable stiffness."""
    samples = reference.angle.samples is not None  # which no suite may have; it says so itself
    return StartSpec() if samples else StartSpec(angle=float(reference.angle.build()(0.0)))


class PlantSpec(ConfigModel):
    """A joint that replaces the nominal one in a share of the runs."""

    share: _Share = 1
    joint: JointSpec


class ReferenceCase(ConfigModel):
    """A reference, its parameters that vary from run to run, and its share of the runs."""

    share: _Share = 1
    reference: ReferenceSpec
    over: tuple[str, ...] = ()


class TuningSpec(ConfigModel):
    """Tuning of each controller: the same search with the same budget.

    From each of `starts` points (the gains of the file, then places spread over the ranges) `generations` of
    `population` points are tried by CMA-ES, each on the same `runs` runs. Gains are searched over `decades` powers of
    ten down and up from those of the file. For a controller that `over` names, these numbers and ranges take the place
    of its gains; those in `untuned` are taken as they are.
    """

    cost: str = "angle_rmse/0.1 deg + stiffness_rmse/0.5 N*m/rad"
    runs: Annotated[int, BoundedInt(1, _MOST)] = 32
    seed: _Seed = 99
    starts: Annotated[int, BoundedInt(1, 1000)] = 2
    generations: Annotated[int, BoundedInt(1, 100_000)] = 40
    population: Annotated[int, BoundedInt(4, 10_000)] = 16
    decades: Annotated[int, BoundedInt(1, 6)] = 1
    over: dict[str, tuple[str, ...]] = Field(default_factory=dict)
    untuned: tuple[str, ...] = ()

    @field_validator("cost", mode="after")
    @classmethod
    def _readable(cls, value: str) -> str:
        try:
            read_cost(value)
        except McKibbenError as error:
            fail_validation(str(error))
        return value


class UnseenSpec(ConfigModel):
    """The runs on which controllers are compared: how many, and their seed, which no tuning has."""

    runs: Annotated[int, BoundedInt(2, _MOST)] = 512
    seed: _Seed = 1


class Suite(ConfigModel):
    """Plants, references and conditions of a comparison, and its controllers; `read` and `dumps` know the units.

    The model of every controller is `joint`, `load` and `valve` as given here, whatever the plant of a run is: only
    the measurements of `sensors` depend on the run's own plant.

    Attributes
    ----------
    name
        One line of text.
    joint, load, valve, sensors, disturbance
        As in a scenario: the controllers' model, and the plant before its `conditions`.
    other_joints
        Joints that replace it in a share of the runs; same specimens, same kind of law.
    joint_share
        The share of `joint` itself beside them.
    conditions
        Parameters that vary from run to run, such as ``load.mass2=+-50 %``; see `mckibben.study.parameters.read_over`.
    references
        References by name. One among them of which the stiffness steps is needed for the coupling.
    fastest
        The highest angular acceleration [rad/s^2] of a reference; larger sines are scaled down.
    controllers
        By name. The first is what the others are compared with.
    tuning, unseen
        How they are tuned, and on what they are compared.
    duration, control_period, substeps
        Of each run.
    """

    renamed: ClassVar = {"wishes": "references"}

    name: Title
    joint: JointSpec
    joint_share: _Share = 1
    other_joints: dict[str, PlantSpec] = Field(default_factory=dict)
    load: AnyLoad
    valve: AnyValve | None = None
    sensors: AnySensors | None = None
    disturbance: AnyDisturbance | None = None
    conditions: tuple[str, ...] = ()
    references: dict[str, ReferenceCase] = Field(min_length=1)
    fastest: AngularAcceleration | None = None
    controllers: dict[str, AnyController] = Field(min_length=1)
    tuning: TuningSpec = TuningSpec()
    unseen: UnseenSpec = UnseenSpec()
    duration: Duration
    control_period: PositiveTime
    substeps: Annotated[int, BoundedInt(1, 1000)] = 4

    @field_validator("valve", mode="before")
    @classmethod
    def _ideal(cls, value: Any) -> Any:
        return None if value == "ideal" else value

    @field_validator("control_period", mode="after")
    @classmethod
    def _whole_periods(cls, value: float, info: ValidationInfo) -> float:
        return check_divides_duration(value, info.data.get("duration"))

    @field_validator("unseen", mode="after")
    @classmethod
    def _unseen(cls, value: UnseenSpec, info: ValidationInfo) -> UnseenSpec:
        tuning = info.data.get("tuning")
        if tuning is not None and tuning.seed == value.seed:
            fail_validation("has the seed of the tuning", "give another: what was tuned on is not unseen")
        return value

    @model_serializer(mode="wrap", when_used="json")
    def _write(self, handler: Any) -> Any:
        written = handler(self)
        return {**written, "valve": written.get("valve") or "ideal"}

    @classmethod
    def read(cls, path: str | os.PathLike[str]) -> Suite:
        """Read a suite file.

        Raises
        ------
        ScenarioError
            With every problem of the file: line, field, value, allowed range and remedy.
        """
        return cls.parse(read_text(path, "a suite"), source=os.fspath(path), folder=Path(path).parent)

    @classmethod
    def parse(cls, text: str, *, source: str = "suite", folder: str | os.PathLike[str] = ".") -> Suite:
        """Read a suite from text; arguments and errors as for `Scenario.parse`."""
        suite, document = parse_model(cls, text, source=source, folder=folder)
        problems = problems_of_suite(suite, document, AS_BELIEVED)
        if problems:
            raise ScenarioError(source, problems)
        return suite

    def dumps(self, *, folder: str | os.PathLike[str] = ".") -> str:
        """The suite as text that `parse` reads back; paths are relative to a folder."""
        return to_text(self.model_dump(mode="json", by_alias=True, context={"folder": Path(folder)}))

    @property
    def cost(self) -> Cost:
        """Cost of a run."""
        return read_cost(self.tuning.cost)

    @property
    def joints(self) -> dict[str, tuple[int, JointSpec]]:
        """All joints that a plant may have, by name, each with its share; "as believed" comes first."""
        others = {name: (other.share, other.joint) for name, other in self.other_joints.items()}
        return {AS_BELIEVED: (self.joint_share, self.joint), **others}

    def scenario(self, controller: str, reference: str, joint: str = AS_BELIEVED) -> Scenario:
        """One run before its conditions; the controller's model is the suite's own joint, load and valve."""
        signals = self.references[reference].reference
        return Scenario(
            name=f"{self.name}: {controller}, {reference}"[:200],
            joint=self.joints[joint][1],
            load=self.load,
            valve=self.valve,
            sensors=self.sensors,
            disturbance=self.disturbance,
            controller=self.controllers[controller].with_model(self.joint, self.load, self.valve),
            reference=signals,
            start=start_of(signals),
            duration=self.duration,
            control_period=self.control_period,
            substeps=self.substeps,
        )

    def conditions_over(self) -> tuple[Over, ...]:
        """Parameters of the plant that vary from run to run."""
        return read_overs(self.conditions, self.example())

    def reference_over(self, reference: str) -> tuple[Over, ...]:
        """Parameters of a reference that vary from run to run."""
        return read_overs(self.references[reference].over, self.example(reference))

    def tuned_over(self, controller: str) -> tuple[Over, ...]:
        """Tuned parameters of a controller with their ranges; empty if it is not tuned."""
        if controller in self.tuning.untuned:
            return ()
        scenario = self.scenario(controller, next(iter(self.references)))
        if controller in self.tuning.over:
            return read_ranges(self.tuning.over[controller], scenario)
        gains = around_gains(scenario, float(self.tuning.decades))
        if not gains:
            raise ParameterError(
                f"{controller} has no gain that is not zero", remedy="name it in tuning.over or tuning.untuned"
            )
        return over(scenario, gains)

    def example(self, reference: str | None = None, joint: str = AS_BELIEVED) -> Scenario:
        """A run of the first controller."""
        return self.scenario(next(iter(self.controllers)), reference or next(iter(self.references)), joint)
