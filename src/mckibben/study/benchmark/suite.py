"""Benchmark suites: plants, references, conditions and controllers, and their consistency."""

from __future__ import annotations

import os
import re
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import jax
from pydantic import Field, ValidationInfo, field_validator, model_serializer

from mckibben.config.document import Document, dotted, to_text
from mckibben.config.fields import Part, refuse, suggest
from mckibben.config.reading import parsed, text_of
from mckibben.errors import McKibbenError, ParameterError, Problem, ScenarioError
from mckibben.study.parameters import SweptParameter, parse_sweep, parse_sweeps, sweep_parameters
from mckibben.study.scenario import Scenario
from mckibben.study.scenario.building import build_signal
from mckibben.study.scenario.controller import ControllerSpec
from mckibben.study.scenario.fields import AngularAcceleration, Duration, PositiveTime, Title, Whole
from mckibben.study.scenario.plant import DisturbanceSpec, JointSpec, LoadSpec, SensorsSpec, StartSpec, ValveSpec
from mckibben.study.scenario.reference import ReferenceSpec, SignalSpec
from mckibben.study.scenario.scenario import dividing
from mckibben.study.tune import Cost, gain_ranges, parse_cost, parse_ranges

_OF_PLANT = ("joint", "load", "valve", "sensors", "disturbance")
_LONGEST_NAME = 80


def filename(name: str) -> str:
    """A name as part of a path.

    >>> filename("Sliding mode, 2")
    'sliding-mode-2'
    """
    return re.sub(r"[^A-Za-z0-9]+", "-", name).strip("-").lower() or "controller"


def problems_of_suite(suite: Suite, document: Document, believed: str) -> list[Problem]:
    """What is wrong with parts that have to do with one another.

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
            found.append(Problem(str(error), document.line(place), dotted(place)))

    for key, reserved in (("other_joints", believed), ("wishes", ""), ("controllers", "")):
        for name in getattr(suite, key):
            look((key, name), lambda name=name, reserved=reserved: _check_name(name, reserved))
    for name in suite.controllers:
        look(("controllers", name), lambda name=name: _check_controller(suite, name))
    if found:  # no scenario can be made of it
        return found
    look(("conditions",), lambda: _check_differs(suite))
    look(("tuning", "cost"), lambda: _check_cost(suite))
    for i, text in enumerate(suite.conditions):
        look(("conditions", i), lambda text=text: _about_plant(parse_sweep(text, suite.example())))
    if not found:
        look(("conditions",), suite.conditions_over)
    for name, wish in suite.wishes.items():
        for key in ("angle", "stiffness"):
            place = ("wishes", name, "reference", key)
            look(place, lambda key=key, wish=wish: _plain(getattr(wish.reference, key)))
        before = len(found)
        for i, text in enumerate(wish.over):
            look(("wishes", name, "over", i), lambda name=name, text=text: _about_wish(text, suite.example(name)))
        if len(found) == before:
            look(("wishes", name, "over"), lambda name=name: suite.wish_over(name))
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
    wish, *others = suite.wishes.values()
    if not (others or wish.over or suite.conditions or suite.sensors or suite.other_joints):
        raise ParameterError("nothing differs from run to run", remedy="give conditions, or a wish `over` something")


def _check_cost(suite: Suite) -> None:
    """A metric that a run has no number for would make it a lost one."""
    steps = all(wish.reference.stiffness.step is not None for wish in suite.wishes.values())
    if "coupling" in suite.cost.metrics and not steps:
        raise ParameterError("coupling is of steps of the stiffness", remedy="leave it out, or let all wishes step")


def _check_joint(suite: Suite, name: str) -> None:
    """Runs of all joints are computed together: the same conditions, specimens and kinds of law."""
    scenario, believed = suite.example(joint=name), suite.example()
    parse_sweeps(suite.conditions, scenario)
    if jax.tree.structure(scenario.plant()) != jax.tree.structure(believed.plant()):
        raise ParameterError(
            "differs from the suite's own joint in more than numbers",
            remedy="give both the same specimens, kinds of law and parts",
        )


def _check_known(suite: Suite, name: str) -> None:
    if name not in suite.controllers:
        raise ParameterError(f"there is no controller {name!r}", remedy=suggest(name, list(suite.controllers)))


def _about_plant(one: SweptParameter) -> None:
    if one.name.split(".")[0] not in _OF_PLANT:
        raise ParameterError(
            f"{one.name} is nothing of the plant", remedy=f"a condition is a number of {', '.join(_OF_PLANT)}"
        )


def _about_wish(text: str, scenario: Scenario) -> None:
    one = parse_sweep(text, scenario)
    if not one.name.startswith("reference."):
        raise ParameterError(f"{one.name} is nothing of the wish", remedy="put it among the conditions")


def _about_controller(over: tuple[SweptParameter, ...]) -> None:
    for one in over:
        if not one.name.startswith("controller."):
            raise ParameterError(
                f"{one.name} is nothing of the controller", remedy="tune numbers that begin with `controller.`"
            )


def _plain(signal: SignalSpec[Any]) -> None:
    if signal.samples is not None:
        raise ParameterError("samples cannot be compared on", remedy="give a constant, step, sine or multisine")


_Share = Annotated[int, Whole(1, 1000)]
_Seed = Annotated[int, Whole(0, 2**31 - 1)]
_MOST = 1_000_000

NOMINAL_JOINT = "as believed"
"""The joint that controllers believe in, as the plant of a run."""


def start_of(reference: ReferenceSpec) -> StartSpec:
    """Where a run starts: at rest at the first angle of its wish, amid the attainable stiffness."""
    samples = reference.angle.samples is not None  # which no suite may have; it says so itself
    return StartSpec() if samples else StartSpec(angle=float(build_signal(reference.angle, "angle")(0.0)))


class PlantSpec(Part):
    """A joint that is in place of the one that controllers believe in, in so many parts of the runs."""

    share: _Share = 1
    joint: JointSpec


class WishSpec(Part):
    """A reference, what of it differs from run to run, and in how many parts of the runs it is wished for."""

    share: _Share = 1
    reference: ReferenceSpec
    over: tuple[str, ...] = ()


class TuningSpec(Part):
    """How each controller is tuned: the same search with the same budget for all.

    From each of `starts` points (the gains of the file, then places spread over the ranges) `generations` of
    `population` points are tried by CMA-ES, each on the same `runs` runs. Gains are searched over `decades` powers of
    ten down and up from those of the file. For a controller that `over` names, these numbers and ranges take the place
    of its gains; those in `untuned` are taken as they are.
    """

    cost: str = "angle_rmse/0.1 deg + stiffness_rmse/0.5 N*m/rad"
    runs: Annotated[int, Whole(1, _MOST)] = 32
    seed: _Seed = 99
    starts: Annotated[int, Whole(1, 1000)] = 2
    generations: Annotated[int, Whole(1, 100_000)] = 40
    population: Annotated[int, Whole(4, 10_000)] = 16
    decades: Annotated[int, Whole(1, 6)] = 1
    over: dict[str, tuple[str, ...]] = Field(default_factory=dict)
    untuned: tuple[str, ...] = ()

    @field_validator("cost", mode="after")
    @classmethod
    def _readable(cls, value: str) -> str:
        try:
            parse_cost(value)
        except McKibbenError as error:
            refuse(str(error))
        return value


class UnseenSpec(Part):
    """The runs on which controllers are compared: how many, and their seed, which no tuning has."""

    runs: Annotated[int, Whole(2, _MOST)] = 512
    seed: _Seed = 1


class Suite(Part):
    """What controllers are compared on, and they themselves; `read` and `dumps` know the units.

    Every controller believes in `joint`, `load` and `valve` as they stand here, whatever the plant of a run is: nothing
    of a run's own plant reaches it but what `sensors` tell.

    Attributes
    ----------
    name
        What it is about, in a few words.
    joint, load, valve, sensors, disturbance
        As in a scenario: what controllers believe, and the plant before its `conditions`.
    other_joints
        Joints that are in the place of that one in a share of the runs; of the same make, with the same kind of law.
    joint_share
        The share of `joint` itself beside them.
    conditions
        What differs from run to run, such as ``load.mass2=+-50 %``; see `mckibben.study.parameters.parse_sweep`.
    wishes
        References by name. One among them of which the stiffness steps is needed for the coupling.
    fastest
        The highest angular acceleration [rad/s^2] of a wish; larger sines are made smaller.
    controllers
        By name. The first is what the others are compared with.
    tuning, unseen
        How they are tuned, and on what they are compared.
    duration, control_period, substeps
        Of each run.
    """

    name: Title
    joint: JointSpec
    joint_share: _Share = 1
    other_joints: dict[str, PlantSpec] = Field(default_factory=dict)
    load: LoadSpec
    valve: ValveSpec | None = None
    sensors: SensorsSpec | None = None
    disturbance: DisturbanceSpec | None = None
    conditions: tuple[str, ...] = ()
    wishes: dict[str, WishSpec] = Field(min_length=1)
    fastest: AngularAcceleration | None = None
    controllers: dict[str, ControllerSpec] = Field(min_length=1)
    tuning: TuningSpec = TuningSpec()
    unseen: UnseenSpec = UnseenSpec()
    duration: Duration
    control_period: PositiveTime
    substeps: Annotated[int, Whole(1, 1000)] = 4

    @field_validator("valve", mode="before")
    @classmethod
    def _ideal(cls, value: Any) -> Any:
        return None if value == "ideal" else value

    @field_validator("control_period", mode="after")
    @classmethod
    def _whole_periods(cls, value: float, info: ValidationInfo) -> float:
        return dividing(value, info.data.get("duration"))

    @field_validator("unseen", mode="after")
    @classmethod
    def _unseen(cls, value: UnseenSpec, info: ValidationInfo) -> UnseenSpec:
        tuning = info.data.get("tuning")
        if tuning is not None and tuning.seed == value.seed:
            refuse("has the seed of the tuning", "give another: what was tuned on is not unseen")
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
        return cls.parse(text_of(path, "a suite"), source=os.fspath(path), folder=Path(path).parent)

    @classmethod
    def parse(cls, text: str, *, source: str = "suite", folder: str | os.PathLike[str] = ".") -> Suite:
        """Read a suite from text; arguments and errors as for `Scenario.parse`."""
        suite, document = parsed(cls, text, source=source, folder=folder)
        problems = problems_of_suite(suite, document, NOMINAL_JOINT)
        if problems:
            raise ScenarioError(source, problems)
        return suite

    def dumps(self, *, folder: str | os.PathLike[str] = ".") -> str:
        """The suite as text that `parse` reads back; paths are relative to a folder."""
        return to_text(self.model_dump(mode="json", by_alias=True, context={"folder": Path(folder)}))

    @property
    def cost(self) -> Cost:
        """Of a run."""
        return parse_cost(self.tuning.cost)

    @property
    def joints(self) -> dict[str, tuple[int, JointSpec]]:
        """All joints that a plant may have, by name, each with its share; "as believed" comes first."""
        others = {name: (other.share, other.joint) for name, other in self.other_joints.items()}
        return {NOMINAL_JOINT: (self.joint_share, self.joint), **others}

    def scenario(self, controller: str, wish: str, joint: str = NOMINAL_JOINT) -> Scenario:
        """One run before its conditions: the controller believes in the suite's own joint, load and valve."""
        reference = self.wishes[wish].reference
        return Scenario(
            name=f"{self.name}: {controller}, {wish}"[:200],
            joint=self.joints[joint][1],
            load=self.load,
            valve=self.valve,
            sensors=self.sensors,
            disturbance=self.disturbance,
            controller=self.controllers[controller].with_model(self.joint, self.load, self.valve),
            reference=reference,
            start=start_of(reference),
            duration=self.duration,
            control_period=self.control_period,
            substeps=self.substeps,
        )

    def conditions_over(self) -> tuple[SweptParameter, ...]:
        """What differs from run to run of the plant."""
        return parse_sweeps(self.conditions, self.example())

    def wish_over(self, wish: str) -> tuple[SweptParameter, ...]:
        """What of a wish differs from run to run."""
        return parse_sweeps(self.wishes[wish].over, self.example(wish))

    def tuned_over(self, controller: str) -> tuple[SweptParameter, ...]:
        """What of a controller is tuned, and over what range; nothing where it is taken as it is."""
        if controller in self.tuning.untuned:
            return ()
        scenario = self.scenario(controller, next(iter(self.wishes)))
        if controller in self.tuning.over:
            return parse_ranges(self.tuning.over[controller], scenario)
        gains = gain_ranges(scenario, float(self.tuning.decades))
        if not gains:
            raise ParameterError(
                f"{controller} has no gain that is not zero", remedy="name it in tuning.over or tuning.untuned"
            )
        return sweep_parameters(scenario, gains)

    def example(self, wish: str | None = None, joint: str = NOMINAL_JOINT) -> Scenario:
        """A run of the first controller."""
        return self.scenario(next(iter(self.controllers)), wish or next(iter(self.wishes)), joint)
