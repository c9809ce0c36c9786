"""Scalar parameters of a scenario by their address in the file, for example `load.mass2`."""

from __future__ import annotations

import difflib
import functools
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from types import UnionType
from typing import Any, Union, get_args, get_origin

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from mckibben.config.fields import LONGEST_VALUE, Part, Quantity, quoted
from mckibben.errors import ParameterError
from mckibben.study.scenario import GeometrySpec, JointSpec, LoadSpec, LoopSpec, PIDSpec, Scenario, SignalSpec
from mckibben.study.scenario.fields import Choice, Entry, Whole
from mckibben.units import show

_ATTRIBUTES = {
    "poles": "feedback",
    "sliding": "feedback",
    "velocity_observer": "observer",
    "disturbance_observer": "observer",
}
"""What parts of the file are called where they are built."""


def defaults_of(scenario: Scenario) -> Callable[[tuple[str, ...]], float | int | None]:
    """The values, in SI, of numbers that a scenario does not give, by all keys on the way to each.

    What has to be built to know them is built once. None for a starting stiffness: it is then amid what the plant can
    hold.
    """
    return functools.partial(_default, scenario, functools.cache(scenario.control))


def _default(scenario: Scenario, control: Callable[[], Any], place: tuple[str, ...]) -> float | int | None:
    from mckibben.study.scenario import building

    key = place[-1]
    if key == "strength":  # of a muscle: that of its law
        return 1.0
    match place[:-1]:
        case ("load",):
            return getattr(building.build_load(scenario.load), key)
        case ("joint", *_):
            return getattr(building.build_geometry(scenario.joint), key)
        case ("controller", "model", *_):
            model = scenario.controller.model or scenario.joint
            return getattr(building.build_geometry(model), key)
        case ("controller", "decoupling" | "predictive", *inner):
            owner = control()
            for name in inner:
                owner = getattr(owner, _ATTRIBUTES.get(name, name))
            return getattr(owner, key)
        case ("controller", "inverse_model", *inner):
            owner = control()
            for name in inner:
                owner = getattr(owner, name)
            return getattr(owner, key)
        case ("controller", name, _):
            loop = building.build_loop(getattr(scenario.controller, name))
            owner = getattr(loop, "base", loop) if key in PIDSpec.model_fields else loop
            return getattr(owner, key)
        case ("reference", name, _):
            return getattr(building.build_signal(getattr(scenario.signals, name), name), key)
        case _:
            return None


Place = tuple[str, ...]
"""Keys of the file, from the top."""

Mark = Quantity | Whole
"""A field that is a number."""

SYMBOLS = {"mass1": "m1", "mass2": "m2", "distance1": "l1", "distance2": "l2"}
"""What the paper calls numbers of the load."""

_LOOKUP = "a study varies numbers; write one scenario for each"
_TIMING = "it is one number for all runs of a study"
_OTHER_FORM = "write the other form in the file"
_COMPILED = "it sets the size of what is compiled"
_FIXED = {
    "name": ("it is a text", _LOOKUP),
    "duration": (_TIMING, "change it in the file"),
    "control_period": (_TIMING, "change it in the file"),
    "substeps": (_TIMING, "change it in the file"),
    "hidden": (_COMPILED, "change it in the file"),
    "stages": (_COMPILED, "change it in the file"),
    "iterations": (_COMPILED, "change it in the file"),
}
_ABSENT = {
    ("valve",): ("the valve is ideal", "write `valve: {time_constant: 20 ms}` in the file"),
    ("joint", "spring"): ("the joint has no spring", "write one in the file, see docs/scenarios.md"),
    ("controller", "model"): (
        "the controller's model is the joint of the plant itself",
        "write `model:` in the file to vary it apart from the plant",
    ),
    ("controller", "decoupling", "load"): (
        "the controller's load is that of the plant itself",
        "write `load:` below `decoupling:` in the file to vary it apart from the plant",
    ),
    ("controller", "predictive", "load"): (
        "the controller's load is that of the plant itself",
        "write `load:` below `predictive:` in the file to vary it apart from the plant",
    ),
    ("controller", "inverse_model", "load"): (
        "the controller's load is that of the plant itself, or none",
        "write `load:` below `inverse_model:` in the file to vary it apart from the plant",
    ),
    ("controller", "model", "spring"): ("the controller's model has no spring", "write one in the file"),
}


@dataclass
class Survey:
    """What can be varied.

    Attributes
    ----------
    numbers
        By canonical name: where it stands, its kind and its nominal value.
    spellings
        The canonical name of each spelling, itself among them.
    refused
        Why a name cannot be varied, and what to do.
    """

    numbers: dict[str, tuple[Place, Mark, float | int | None]] = field(default_factory=dict)
    spellings: dict[str, str] = field(default_factory=dict)
    refused: dict[str, tuple[str, str]] = field(default_factory=dict)

    def add(self, names: list[Place], place: Place, mark: Mark, nominal: float | int | None) -> None:
        """Take in a number; the first of its names is the canonical one."""
        canonical = ".".join(names[0])
        self.numbers[canonical] = (place, mark, nominal)
        self.spellings.update({".".join(name): canonical for name in names})

    def refuse(self, names: list[Place], reason: tuple[str, str]) -> None:
        """Say why something cannot be varied."""
        self.refused.update({".".join(name): reason for name in names})


def survey(scenario: Scenario) -> Survey:
    """Go through a scenario."""
    found = Survey()
    _walk(scenario, (), [()], found, defaults_of(scenario))
    found.refused = {name: why for name, why in found.refused.items() if name not in found.spellings}
    return found


def _walk(
    part: Part, place: Place, names: list[Place], found: Survey, default: Callable[[Place], float | int | None]
) -> None:
    for key, info, value in fields_of(part):
        here = (*place, key)
        called = [(*name, key) for name in names]
        if key in SYMBOLS and isinstance(part, LoadSpec):
            called += [(*name, SYMBOLS[key]) for name in names]
        mark = mark_of(info)
        if key in _FIXED:
            found.refuse(called, _FIXED[key])
        elif mark is not None:
            _add_number(part, key, called, here, mark, default(here) if value is None else value, found)
        elif isinstance(value, Part):
            inner = [*names, *called] if isinstance(part, LoopSpec | SignalSpec) else called
            _walk(value, here, inner, found, default)
        elif model_in(info) is not None:
            _refuse_absent(part, key, info, called, here, names, found)
        else:
            found.refuse(called, (_what_it_is(info), _LOOKUP))


def _add_number(
    part: Part, key: str, called: list[Place], here: Place, mark: Mark, nominal: float | int | None, found: Survey
) -> None:
    if isinstance(part, SignalSpec):  # a constant; other forms are parts of their own
        if part.constant is None:
            found.refuse(called, (f"{'.'.join(here[:-1])} is given as {_form(part)}, not as constant", _OTHER_FORM))
            return
        called = [called[0][:-1], *called]
    if key != "connector_length":
        found.add(called, here, mark, nominal)
        return
    # One number in two places: the joint's own stands in for the geometry's. It is set where the file has it.
    joint_wide = isinstance(part, JointSpec)
    geometry = part.geometry if joint_wide else part
    assert isinstance(geometry, GeometrySpec)  # the other part with connectors
    if joint_wide == (geometry.connector_length is None):
        other = [(*name[:-1], "geometry", key) if joint_wide else (*name[:-2], key) for name in called]
        found.add([*called, *other], here, mark, nominal)


def _refuse_absent(
    part: Part, key: str, info: FieldInfo, called: list[Place], here: Place, names: list[Place], found: Survey
) -> None:
    if not isinstance(part, LoopSpec | SignalSpec):
        found.refuse(called, _ABSENT.get(here, ("the scenario has none", "write it in the file")))
        return
    reason = (f"{'.'.join(here[:-1])} is given as {_form(part)}, not as {key}", _OTHER_FORM)
    found.refuse(called, reason)
    model = model_in(info)
    inner = [info.alias or name for name, info in model.model_fields.items()] if model else []
    found.refuse([(*name, each) for name in names for each in inner if not _is_number_of(part, each)], reason)


def _is_number_of(part: Part, key: str) -> bool:
    """Whether the form that is given has a field of that name."""
    return any(key in type(value).model_fields for _, _, value in fields_of(part) if isinstance(value, Part))


def _form(part: Part) -> str:
    return next(key for key, _, value in fields_of(part) if value is not None)


def _what_it_is(info: FieldInfo) -> str:
    marks = list(_marks(info))
    if any(isinstance(mark, Entry) for mark in marks) or "Path" in str(info.annotation):
        return "it names an entry of the catalog or a file"
    if any(isinstance(mark, Choice) for mark in marks):
        return "it is a choice of words"
    return "it is a list" if "tuple" in str(info.annotation) else "it is true or false"


def fields_of(part: Part) -> Iterator[tuple[str, FieldInfo, Any]]:
    """Key in the file, field and value of each field."""
    for name, info in type(part).model_fields.items():
        yield info.alias or name, info, getattr(part, name)


def mark_of(info: FieldInfo) -> Mark | None:
    """The kind of a field that is one number; None for others."""
    return next((mark for mark in _marks(info) if isinstance(mark, Quantity | Whole)), None)


def model_in(info: FieldInfo) -> type[BaseModel] | None:
    """The part that a field may hold."""
    for candidate in (info.annotation, *get_args(info.annotation)):
        if isinstance(candidate, type) and issubclass(candidate, BaseModel):
            return candidate
    return None


def _marks(info: FieldInfo) -> Iterator[Any]:
    """What a field is annotated with, also where it is optional; not what the items of a list are."""
    yield from info.metadata
    if get_origin(info.annotation) in (Union, UnionType):
        for choice in get_args(info.annotation):
            yield from getattr(choice, "__metadata__", ())


LISTING = "`mckibben sweep SCENARIO.yaml --list` shows all"
"""How a user sees what there is."""


@dataclass(frozen=True)
class ScenarioParameter:
    """One number of a scenario, and what it may be.

    Attributes
    ----------
    name
        As it is listed, such as "controller.position.kp".
    place
        All keys on the way to it in the file, such as ("controller", "position", "pid", "kp").
    mark
        The kind of field: it reads text, and knows units and range.
    nominal
        What it is in the scenario: a float in SI, or an int. None for a starting stiffness or a minimum tension that is
        not given.
    """

    name: str
    place: Place
    mark: Mark
    nominal: float | int | None

    @property
    def whole(self) -> bool:
        """Whether it is a whole number."""
        return isinstance(self.mark, Whole)

    @property
    def unit(self) -> str:
        """The SI unit; "1" for a plain number."""
        return self.mark.unit if isinstance(self.mark, Quantity) else "1"

    @property
    def shown(self) -> str:
        """The unit in which it is written."""
        return self.mark.shown if isinstance(self.mark, Quantity) else "1"

    @property
    def lower(self) -> float | int:
        """The lower end of what it may be, in SI; a length of 0 is not in its range, nor below."""
        return self.mark.limits[0] if isinstance(self.mark, Quantity) else self.mark.lower

    @property
    def upper(self) -> float | int:
        """The upper end, in SI."""
        return self.mark.limits[1] if isinstance(self.mark, Quantity) else self.mark.upper

    @property
    def range(self) -> str:
        """What it may be, in words."""
        return self.mark.range if isinstance(self.mark, Quantity) else f"{self.mark.lower} to {self.mark.upper}"

    def holds(self, value: Any) -> Any:
        """Whether a number in SI, or each of an array, is in the range."""
        if isinstance(self.mark, Quantity):
            return self.mark.holds(value)
        return (value >= self.mark.lower) & (value <= self.mark.upper) & (value % 1 == 0)

    def show(self, value: float | int, digits: int = 6) -> str:
        """A value in SI as people read it."""
        return f"{value:.0f}" if self.whole else show(float(value), self.shown, digits)

    def write(self, value: float | int) -> str:
        """Text that a scenario reads back to the last bit."""
        return self.mark.write(float(value)) if isinstance(self.mark, Quantity) else str(int(value))


def list_parameters(scenario: Scenario) -> list[ScenarioParameter]:
    """All numbers of a scenario that a study can vary, in the order of the file.

    >>> scenario = Scenario.read("examples/pre-contracted-step-pid.yaml")
    >>> for address in list_parameters(scenario)[:3]:
    ...     print(address.name, address.show(address.nominal), address.range, sep=", ")
    joint.geometry.joint_length, 370 mm, above 0 to 100000 mm
    joint.geometry.joint_radius, 30 mm, above 0 to 100000 mm
    joint.connector_length, 208 mm, 0 to 100000 mm
    """
    found = survey(scenario)
    return [ScenarioParameter(name, *found.numbers[name]) for name in found.numbers]


def find_parameter(scenario: Scenario, name: str) -> ScenarioParameter:
    """The number of a name, in any of its spellings.

    Parameters
    ----------
    scenario
        Which one.
    name
        Such as "load.mass2" or "load.m2"; the level `pid`, `backprop`, `sine`, ... may be left out.

    Raises
    ------
    ParameterError
        If there is none, or it is nothing that a study can vary; it says why.

    Examples
    --------
    >>> scenario = Scenario.read("examples/pre-contracted-step-pid.yaml")
    >>> find_parameter(scenario, "controller.position.pid.kp").name
    'controller.position.kp'
    >>> find_parameter(scenario, "load.mass3")
    Traceback (most recent call last):
        ...
    mckibben.errors.ParameterError: the scenario has no number 'load.mass3'; did you mean ...
    """
    return find_parameters(scenario, [name])[0]


def find_parameters(scenario: Scenario, names: Iterable[str]) -> list[ScenarioParameter]:
    """The numbers of several names, no two of which may be the same number.

    Raises
    ------
    ParameterError
        As for `find_parameter`, and if a number is named twice.

    Examples
    --------
    >>> scenario = Scenario.read("examples/pre-contracted-step-pid.yaml")
    >>> find_parameters(scenario, ["load.m2", "load.mass2"])
    Traceback (most recent call last):
        ...
    mckibben.errors.ParameterError: 'load.m2' and 'load.mass2' are the same number; keep one of them
    """
    found = survey(scenario)
    spelt: dict[str, str] = {}
    several = []
    for name in names:
        address = _resolve(found, name)
        if address.name in spelt:
            both = f"{quoted(spelt[address.name])} and {quoted(name)} are the same number"
            raise ParameterError(both, value=name, remedy="keep one of them")
        spelt[address.name] = name
        several.append(address)
    return several


def _resolve(found: Survey, name: str) -> ScenarioParameter:
    spelling = name.strip()
    canonical = found.spellings.get(spelling)
    if canonical is not None:
        return ScenarioParameter(canonical, *found.numbers[canonical])
    keys = spelling.split(".")
    for depth in range(len(keys), 0, -1):
        reason = found.refused.get(".".join(keys[:depth]))
        if reason is not None:
            raise ParameterError(f"{quoted(spelling)} cannot be varied: {reason[0]}", value=name, remedy=reason[1])
    below = [known for known in found.numbers if known.startswith(f"{spelling}.")]
    if below and spelling:
        raise ParameterError(
            f"{quoted(spelling)} is a group of numbers", value=name, remedy=f"choose one, such as {below[0]}; {LISTING}"
        )
    close = _close(spelling, list(found.spellings))
    remedy = f"did you mean {' or '.join(map(repr, close))}? {LISTING}" if close else LISTING
    raise ParameterError(f"the scenario has no number {quoted(spelling)}", value=name, remedy=remedy)


def _close(name: str, known: list[str]) -> list[str]:
    """What a name may stand for: those that end with it, or one that is spelt like it."""
    ending = [each for each in known if each.endswith(f".{name}")]
    return ending[:2] if ending else difflib.get_close_matches(name[:LONGEST_VALUE], known, 1, cutoff=0.6)
