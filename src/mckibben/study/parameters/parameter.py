"""Scalar parameters of a scenario by name, for example `load.mass2`."""

from __future__ import annotations

import difflib
import functools
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from types import UnionType
from typing import Any, Union, get_args, get_origin

from pydantic.fields import FieldInfo

from mckibben.component.schema import ComponentModel
from mckibben.config.fields import OneOf
from mckibben.config.model import ConfigModel, fields_by_key, model_in
from mckibben.control import Signal
from mckibben.errors import LONGEST_VALUE, ParameterError, quoted
from mckibben.study.scenario import GeometrySpec, JointSpec, LoopSpec, Scenario, SignalSpec
from mckibben.study.scenario.muscle import CatalogName
from mckibben.units import BoundedInt, Quantity, show


def effective_value(scenario: Scenario, part: ConfigModel, place: Place) -> float | int | None:
    """Effective value [SI] of a number, also where it is unset; None for a starting stiffness and a minimum tension."""
    key = fields_by_key(type(part))[place[-1]]
    value = getattr(part, key)
    if value is not None:
        return value
    if key == "strength":  # of a muscle's law
        return 1.0
    if key == "command_delay":
        return 0.0
    if key == "valve_time_constant":  # of the controller's model
        from mckibben.study.scenario.building import valve_time_constant

        return valve_time_constant(scenario.valve, scenario.joint)
    if isinstance(part, JointSpec):
        return part.geometry.effective(key) if key in type(part.geometry).model_fields else None
    return part.effective(key) if isinstance(part, ComponentModel) else None


Place = tuple[str, ...]
"""Keys of a field in the file, from the top; of an item of a list its index."""

Mark = Quantity | BoundedInt
"""Annotation of a numeric field."""

_NOT_NUMERIC = "a study varies numbers; write one scenario for each"
_TIMING = "it is one number for all runs of a study"
_OTHER_FORM = "write the other form in the file"
_COMPILED = "it sets the size of what is compiled"
_FIXED = {
    "name": ("it is a text", _NOT_NUMERIC),
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
    ("controller", "model", "spring"): ("the controller's model has no spring", "write one in the file"),
    **{
        ("controller", key, "load"): (
            "the controller's load is that of the plant itself, or none",
            f"write `load:` below `{key}:` in the file to vary it apart from the plant",
        )
        for key in ("decoupling", "predictive", "inverse_model")
    },
}


@dataclass
class _Parameters:
    """Parameters by name, names that stand for them, and the reasons why others cannot be varied."""

    numbers: dict[str, tuple[Place, Mark, float | int | None]] = field(default_factory=dict)
    spellings: dict[str, str] = field(default_factory=dict)
    refused: dict[str, tuple[str, str]] = field(default_factory=dict)

    def add(self, names: list[Place], place: Place, mark: Mark, nominal: float | int | None) -> None:
        """Add a parameter; the first of its names is the canonical one."""
        canonical = ".".join(names[0])
        self.numbers[canonical] = (place, mark, nominal)
        self.spellings.update({".".join(name): canonical for name in names})

    def refuse(self, names: list[Place], reason: tuple[str, str]) -> None:
        """Add a reason, and a remedy; the first one counts."""
        for name in names:
            self.refused.setdefault(".".join(name), reason)


@functools.lru_cache(maxsize=16)
def _parameters(scenario: Scenario) -> _Parameters:
    """Walk the fields of a scenario."""
    found = _Parameters()
    _walk(scenario, scenario, (), [()], found)
    found.refused = {name: why for name, why in found.refused.items() if name not in found.spellings}
    return found


def _walk(scenario: Scenario, part: ConfigModel, place: Place, names: list[Place], found: _Parameters) -> None:
    for key, info, value in fields_of(part):
        here = (*place, key)
        called = [(*name, key) for name in names]
        mark = mark_of(info)
        if key in _FIXED and not (key == "duration" and place):
            found.refuse(called, _FIXED[key])
        elif mark is not None:
            _add_number(part, key, called, here, mark, effective_value(scenario, part, here), found)
        elif isinstance(value, ConfigModel):
            inner = [*names, *called] if isinstance(part, LoopSpec | SignalSpec) else called
            _walk(scenario, value, here, inner, found)
        elif model_in(info.annotation) is not None:
            _refuse_absent(part, key, info, called, here, names, found)
        elif isinstance(value, tuple) and isinstance(part, ComponentModel) and issubclass(part.runtime, Signal):
            for i, item in enumerate(value):
                found.add([(*name, str(i)) for name in called], (*here, str(i)), item_mark(info), item)
            found.refuse(called, ("it is a list", f"vary an item of it, such as {'.'.join(called[0])}.0"))
        else:
            found.refuse(called, (_what_it_is(info), _NOT_NUMERIC))


def _add_number(
    part: ConfigModel,
    key: str,
    called: list[Place],
    here: Place,
    mark: Mark,
    nominal: float | int | None,
    found: _Parameters,
) -> None:
    if isinstance(part, SignalSpec):  # a constant; other forms are parts of their own
        if part.constant is None:
            found.refuse(called, (f"{'.'.join(here[:-1])} is given as {_form(part)}, not as constant", _OTHER_FORM))
            return
        called = [called[0][:-1], *called]
    if key != "connector_length":
        found.add(called, here, mark, nominal)
        return
    # One parameter in two places: the joint's stands in for the geometry's. It is set where the file has it.
    joint_wide = isinstance(part, JointSpec)
    geometry = part.geometry if joint_wide else part
    if not isinstance(geometry, GeometrySpec):  # a class of one's own
        if not joint_wide:
            found.add(called, here, mark, nominal)
        return
    if joint_wide == (geometry.connector_length is None):
        other = [(*name[:-1], "geometry", key) if joint_wide else (*name[:-2], key) for name in called]
        found.add([*called, *other], here, mark, nominal)


def _refuse_absent(
    part: ConfigModel,
    key: str,
    info: FieldInfo,
    called: list[Place],
    here: Place,
    names: list[Place],
    found: _Parameters,
) -> None:
    if not isinstance(part, LoopSpec | SignalSpec):
        found.refuse(called, _ABSENT.get(here, ("the scenario has none", "write it in the file")))
        return
    reason = (f"{'.'.join(here[:-1])} is given as {_form(part)}, not as {key}", _OTHER_FORM)
    found.refuse(called, reason)
    model = model_in(info.annotation)
    inner = list(fields_by_key(model)) if model else []
    found.refuse([(*name, each) for name in names for each in inner if not _is_number_of(part, each)], reason)


def _is_number_of(part: ConfigModel, key: str) -> bool:
    """Whether the form in the file has a field of that name."""
    return any(key in type(value).model_fields for _, _, value in fields_of(part) if isinstance(value, ConfigModel))


def _form(part: ConfigModel) -> str:
    return next(key for key, _, value in fields_of(part) if value is not None)


def _what_it_is(info: FieldInfo) -> str:
    marks = list(_marks(info))
    if any(isinstance(mark, CatalogName) for mark in marks) or "Path" in str(info.annotation):
        return "it names an entry of the catalog or a file"
    if any(isinstance(mark, OneOf) for mark in marks):
        return "it is a choice of words"
    return "it is a list" if "tuple" in str(info.annotation) else "it is true or false"


def fields_of(part: ConfigModel) -> Iterator[tuple[str, FieldInfo, Any]]:
    """Key in the file, field info and value of each field."""
    for name, info in type(part).model_fields.items():
        yield info.alias or name, info, getattr(part, name)


def mark_of(info: FieldInfo) -> Mark | None:
    """Numeric annotation of a field; None for others."""
    return next((mark for mark in _marks(info) if isinstance(mark, Quantity | BoundedInt)), None)


def item_mark(info: FieldInfo) -> Mark:
    """Numeric annotation of the items of a list."""
    lists = [info.annotation, *get_args(info.annotation)]
    item = next(get_args(each)[0] for each in lists if get_origin(each) is tuple)
    return next(mark for mark in item.__metadata__ if isinstance(mark, Quantity | BoundedInt))


def _marks(info: FieldInfo) -> Iterator[Any]:
    """Annotations of a field, also of an optional one; not of the items of a list."""
    yield from info.metadata
    if get_origin(info.annotation) in (Union, UnionType):
        for choice in get_args(info.annotation):
            yield from getattr(choice, "__metadata__", ())


LISTING = "`mckibben sweep SCENARIO.yaml --list` shows all"
"""Hint at the list of parameters."""


@dataclass(frozen=True)
class ScenarioParameter:
    """A scalar parameter of a scenario, such as "controller.position.kp".

    `place` has its keys in the file, `mark` unit, range and text form; its `nominal` value [SI] is None for a starting
    stiffness or a minimum tension that is unset.
    """

    name: str
    place: Place
    mark: Mark
    nominal: float | int | None

    @property
    def is_integer(self) -> bool:
        """Whether it is an integer."""
        return isinstance(self.mark, BoundedInt)

    @property
    def unit(self) -> str:
        """SI unit; "1" for a plain number."""
        return self.mark.unit if isinstance(self.mark, Quantity) else "1"

    @property
    def shown(self) -> str:
        """Unit in files."""
        return self.mark.shown if isinstance(self.mark, Quantity) else "1"

    @property
    def lower(self) -> float | int:
        """Lower bound [SI]."""
        return self.mark.limits[0] if isinstance(self.mark, Quantity) else self.mark.lower

    @property
    def upper(self) -> float | int:
        """Upper bound [SI]."""
        return self.mark.limits[1] if isinstance(self.mark, Quantity) else self.mark.upper

    @property
    def range(self) -> str:
        """Range as text."""
        return self.mark.range if isinstance(self.mark, Quantity) else f"{self.mark.lower} to {self.mark.upper}"

    def holds(self, value: Any) -> Any:
        """Whether a value [SI], or each of an array, is in the range."""
        if isinstance(self.mark, Quantity):
            return self.mark.holds(value)
        return (value >= self.mark.lower) & (value <= self.mark.upper) & (value % 1 == 0)

    def show(self, value: float | int, digits: int = 6) -> str:
        """Format a value [SI] in the unit of files."""
        return f"{value:.0f}" if self.is_integer else show(float(value), self.shown, digits)

    def write(self, value: float | int) -> str:
        """Format a value [SI] so that a scenario restores it exactly."""
        return self.mark.write(float(value)) if isinstance(self.mark, Quantity) else str(int(value))


def list_parameters(scenario: Scenario) -> list[ScenarioParameter]:
    """All parameters of a scenario that a study can vary, in the order of the file.

    >>> scenario = Scenario.read("examples/pre-contracted-step-pid.yaml")
    >>> for each in list_parameters(scenario)[:3]:
    ...     print(each.name, each.show(each.nominal), each.range, sep=", ")
    joint.geometry.joint_length, 370 mm, above 0 to 10000 mm
    joint.geometry.joint_radius, 30 mm, above 0 to 2000 mm
    joint.connector_length, 208 mm, 0 to 10000 mm
    """
    found = _parameters(scenario)  # type: ignore[arg-type]  # hashable, as it is frozen
    return [ScenarioParameter(name, *found.numbers[name]) for name in found.numbers]


def find_parameter(scenario: Scenario, name: str) -> ScenarioParameter:
    """Parameter of a scenario by name; the level `pid`, `backprop`, `sine`, ... is optional.

    Raises
    ------
    ParameterError
        If there is none, or a study cannot vary it.

    Examples
    --------
    >>> scenario = Scenario.read("examples/pre-contracted-step-pid.yaml")
    >>> find_parameter(scenario, "controller.position.pid.kp").name
    'controller.position.kp'
    >>> find_parameter(scenario, "load.mass3")
    Traceback (most recent call last):
        ...
    mckibben.errors.ParameterError: the scenario has no parameter 'load.mass3'; did you mean ...
    """
    return find_parameters(scenario, [name])[0]


def find_parameters(scenario: Scenario, names: Iterable[str]) -> list[ScenarioParameter]:
    """Parameters of a scenario by their names, which must be different; raises ParameterError.

    >>> scenario = Scenario.read("examples/pre-contracted-step-pid.yaml")
    >>> find_parameters(scenario, ["load.mass2", "load.mass2"])
    Traceback (most recent call last):
        ...
    mckibben.errors.ParameterError: 'load.mass2' and 'load.mass2' are the same parameter; keep one of them
    """
    found = _parameters(scenario)  # type: ignore[arg-type]  # hashable, as it is frozen
    spelt: dict[str, str] = {}
    several = []
    for name in names:
        parameter = _resolve(found, name)
        if parameter.name in spelt:
            both = f"{quoted(spelt[parameter.name])} and {quoted(name)} are the same parameter"
            raise ParameterError(both, value=name, remedy="keep one of them")
        spelt[parameter.name] = name
        several.append(parameter)
    return several


def _resolve(found: _Parameters, name: str) -> ScenarioParameter:
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
            f"{quoted(spelling)} is a group of parameters",
            value=name,
            remedy=f"choose one, such as {below[0]}; {LISTING}",
        )
    close = _close(spelling, list(found.spellings))
    remedy = f"did you mean {' or '.join(map(repr, close))}? {LISTING}" if close else LISTING
    raise ParameterError(f"the scenario has no parameter {quoted(spelling)}", value=name, remedy=remedy)


def _close(name: str, known: list[str]) -> list[str]:
    """Names that end with a name, or the one closest to it."""
    ending = [each for each in known if each.endswith(f".{name}")]
    return ending[:2] if ending else difflib.get_close_matches(name[:LONGEST_VALUE], known, 1, cutoff=0.6)
