"""Scalar parameters of a scenario by name, the path to a number in its tree of objects, such as `load.mass2`."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from typing import Any, NamedTuple, Self, get_args

from pydantic.fields import FieldInfo

from mckibben.component.base import Component, Units
from mckibben.component.classes import class_name
from mckibben.component.schema import component_field, declared_fields, field_types, inherited_fields
from mckibben.control import Constant, Signal
from mckibben.errors import ParameterError, closest, quoted
from mckibben.scenario.scenario import Start, StudiedScenario
from mckibben.units import HINGE, BoundedInt, JointType, Quantity, show

Place = tuple[str, ...]
"""Keys from the top of a scenario to a value; of an item of a list its index."""

Mark = Quantity | BoundedInt
"""Annotation of a numeric field."""

_NOT_NUMERIC = "a study varies numbers; write one scenario for each"
_TIMING = "it is one number for all runs of a study"
_COMPILED = "it sets the size of what is compiled"
_IN_FILE = "change it in the file"
_ABSENT = "the scenario has none", "write it in the file"
_ALONE = "one muscle alone has no stiffness of its own choice", "vary its position or its load"
_UNSET = {"strength": 1.0, "command_delay": 0.0}
"""Values that None stands for."""


@dataclass
class _Parameters:
    """Parameters by name, other names of them, parts of the scenario, and the reasons why others cannot be varied."""

    numbers: dict[str, tuple[tuple[Place, ...], Mark, float | int | None]] = field(default_factory=dict)
    listed: list[str] = field(default_factory=list)
    spellings: dict[str, str] = field(default_factory=dict)
    parts: dict[str, object] = field(default_factory=dict)
    refused: dict[str, tuple[str, str]] = field(default_factory=dict)
    joint_type: JointType = HINGE
    follows_stiffness: bool = True

    @classmethod
    def of(cls, scenario: StudiedScenario) -> Self:
        """Walk the fields of a scenario."""
        parameters = cls()
        parameters.joint_type, parameters.follows_stiffness = scenario.joint_type, scenario.follows_stiffness
        for name, info in type(scenario).model_fields.items():
            parameters._add_field(info.alias or name, getattr(scenario, name), info)
        return parameters

    def _add_field(self, key: str, value: Any, info: FieldInfo) -> None:
        mark = next((mark for mark in _marks(info) if isinstance(mark, Mark)), None)
        if isinstance(value, Component):
            self._add_part(_Part(value, Units(), key, ((key,),)))
        elif isinstance(value, dict) and value:  # of a robot, by joint
            for name, part in value.items():
                self._add_part(_Part(part, Units(), f"{key}.{name}", ((key, name),)))
        elif isinstance(value, Start):
            for name, field_info in type(value).model_fields.items():
                mark = next(mark for mark in _marks(field_info) if isinstance(mark, Quantity))
                if name == "stiffness" and not self.follows_stiffness:
                    self.refused[f"{key}.{name}"] = _ALONE
                    continue
                self._add(f"{key}.{self.joint_type.words(name)}", ((key, name),), mark, getattr(value, name))
        elif mark is not None and key == "command_delay":
            self._add(key, ((key,),), mark, _UNSET[key] if value is None else value)
        elif value is None:
            self.refused[key] = _ABSENT
        else:
            self.refused[key] = (_TIMING, _IN_FILE) if mark else ("it is not a number", _NOT_NUMERIC)

    def _add(self, name: str, places: tuple[Place, ...], mark: Mark, nominal: Any, *, listed: bool = True) -> None:
        """Add a parameter; one that is not listed can be varied, too."""
        own = mark.for_joint(self.joint_type) if isinstance(mark, Quantity) else mark
        self.numbers[name] = places, own, nominal
        self.spellings[name] = name
        if listed:
            self.listed.append(name)

    def _add_part(self, part: _Part) -> None:
        """Add the parameters of a component and of those within it; equal muscles under their common alias."""
        self.parts[part.name] = part.component
        shared: set[str] = set()
        for alias, keys in type(part.component).aliases.items():
            first, *others = (getattr(part.component, key) for key in keys)
            if others and all(other == first for other in others):
                shared.update(keys)
                self._add_part(_Part(first, part.units, f"{part.name}.{alias}", part.within(*keys), part.listed))
        for key, form in field_types(type(part.component), part.units).items():
            if (mark := _mark(form)) is not None:
                self._add_number(part, key, mark)
            elif key in inherited_fields(part.component):
                remedy = f"write `{key}:` in the file to vary it alone"
                self.refused[f"{part.name}.{key}"] = "it is not given and follows the plant", remedy
            else:
                self._add_other(part, key, form, listed=part.listed and key not in shared)

    def _add_number(self, part: _Part, key: str, mark: Mark) -> None:
        name, kind, value = f"{part.name}.{self._key_of(part, key)}", type(part.component), getattr(part.component, key)
        if declared_fields(kind)[key].metadata.get("static"):
            self.refused[name] = _COMPILED, _IN_FILE
        elif value is None and (group := next((group for group in kind.together if key in group), ())):
            self.refused[name] = f"it needs {' and '.join({*group} - {key})}", "give both in the file"
        else:
            shown = part.name if kind is Constant else name
            self._add(shown, part.within(key), mark, _nominal(key, value), listed=part.listed)
            self.spellings[name] = shown

    def _key_of(self, part: _Part, key: str) -> str:
        """Key of a field in the file, where a slide has another one: `position` for `angle`."""
        alias = self.joint_type.words(key)
        return alias if type(part.component).aliases.get(alias) == (key,) else key

    def _add_other(self, part: _Part, key: str, form: Any, *, listed: bool) -> None:
        """Add the component, or the list of components or of numbers of a signal, in a field; refuse other fields."""
        name, value, places = f"{part.name}.{self._key_of(part, key)}", getattr(part.component, key), part.within(key)
        inside, items = component_field(form), value if isinstance(value, tuple) else ()
        mark = _mark(get_args(form)[0]) if items and isinstance(part.component, Signal) else None
        if inside is not None and isinstance(value, Component):
            self._add_part(_Part(value, inside.units, name, places, listed))
        elif inside is not None and isinstance(value, tuple):
            for index, component in enumerate(items):
                self._add_part(_Part(component, inside.units, f"{name}.{index}", _below(places, index)))
        elif mark is not None:
            for index, number in enumerate(items):
                self._add(f"{name}.{index}", _below(places, index), mark, number, listed=part.listed)
            self.refused[name] = "it is a list", f"vary an item of it, such as {name}.0"
        else:
            self.refused[name] = _ABSENT if value is None else ("it is not a number", _NOT_NUMERIC)


class _Part(NamedTuple):
    """A component of a scenario: the units of its symbolic fields, its name, its places, and whether it is listed."""

    component: Any
    units: Units
    name: str
    places: tuple[Place, ...]
    listed: bool = True

    def within(self, *keys: str) -> tuple[Place, ...]:
        """Places of some of its fields."""
        return tuple((*place, key) for place in self.places for key in keys)


def _below(places: tuple[Place, ...], index: int) -> tuple[Place, ...]:
    """Places of an item of a list."""
    return tuple((*place, str(index)) for place in places)


def _marks(info: FieldInfo) -> Iterator[Any]:
    """Annotations of a field, also of an optional one."""
    yield from info.metadata
    for choice in get_args(info.annotation):
        yield from getattr(choice, "__metadata__", ())


def _nominal(key: str, value: Any) -> Any:
    """Nominal value of a number; None for one that is unset or unlimited."""
    if value is None:
        return _UNSET.get(key)
    return None if isinstance(value, float) and math.isinf(value) else value


def _mark(form: Any) -> Mark | None:
    """Numeric annotation of a field; None for others."""
    marks = getattr(form, "__metadata__", ())
    return next((mark for mark in marks if isinstance(mark, Mark)), None)


LISTING = "`mckibben sweep SCENARIO.yaml --list` shows all"
"""Hint at the list of parameters."""


@dataclass(frozen=True)
class ScenarioParameter:
    """A scalar parameter of a scenario, such as "controller.position.kp".

    `places` are those of its number, several where equal muscles share it; `mark` has unit, range and text form. Its
    `nominal` value [SI] is None where it is unset, as a minimum tension.
    """

    name: str
    places: tuple[Place, ...]
    mark: Mark
    nominal: float | int | None

    @property
    def part(self) -> str:
        """Key of the part of the scenario that it belongs to."""
        return self.places[0][0]

    @property
    def is_integer(self) -> bool:
        """Whether it is an integer."""
        return isinstance(self.mark, BoundedInt)

    @property
    def unit(self) -> str:
        """SI unit; "1" for a plain number."""
        return self.mark.unit

    @property
    def shown(self) -> str:
        """Unit in files."""
        return self.mark.shown

    @property
    def lower(self) -> float | int:
        """Lower bound [SI]."""
        return self.mark.limits[0]

    @property
    def upper(self) -> float | int:
        """Upper bound [SI]."""
        return self.mark.limits[1]

    @property
    def range(self) -> str:
        """Range as text."""
        return self.mark.range

    def holds(self, value: Any) -> Any:
        """Whether a value [SI], or each of an array, is in the range."""
        return self.mark.holds(value)

    def outside(self, message: str, value: Any) -> ParameterError:
        """Error for a value [SI] outside the range."""
        numbers: dict[str, Any] = {"value": value, "lower": self.lower, "upper": self.upper, "unit": self.unit}
        return ParameterError(message, **numbers, remedy="choose values inside")

    def show(self, value: float | int, digits: int = 6) -> str:
        """Format a value [SI] in the unit of files."""
        return f"{value:.0f}" if self.is_integer else show(float(value), self.shown, digits)

    def write(self, value: float | int) -> str:
        """Format a value [SI] so that a scenario restores it exactly."""
        return self.mark.write(float(value)) if isinstance(self.mark, Quantity) else str(int(value))


def list_parameters(scenario: StudiedScenario) -> list[ScenarioParameter]:
    """All parameters of a scenario that a study can vary, in the order of the file.

    >>> from mckibben.scenario import Scenario
    >>> scenario = Scenario.read("examples/pre-contracted-step-pid.yaml")
    >>> for parameter in list_parameters(scenario)[:3]:
    ...     print(parameter.name, parameter.show(parameter.nominal), parameter.range, sep=", ")
    joint.muscle.specimen.initial_length, 180 mm, above 0, up to 10000 mm
    joint.muscle.specimen.initial_diameter, 10 mm, above 0, up to 500 mm
    joint.muscle.specimen.braid_angle, 25 deg, 0.6 to 54.7 deg
    """
    parameters = _Parameters.of(scenario)
    return [ScenarioParameter(name, *parameters.numbers[name]) for name in parameters.listed]


def find_parameter(scenario: StudiedScenario, name: str) -> ScenarioParameter:
    """Parameter of a scenario by name, or by the end of its name where that is unique.

    Raises `ParameterError` if there is none, or a study cannot vary it.

    Examples
    --------
    >>> from mckibben.scenario import Scenario
    >>> scenario = Scenario.read("examples/pre-contracted-step-pid.yaml")
    >>> find_parameter(scenario, "position.kp").name
    'controller.position.kp'
    >>> find_parameter(scenario, "load.mass3")
    Traceback (most recent call last):
        ...
    mckibben.errors.ParameterError: load, of class knee, has no parameter 'mass3'; did you mean 'load.mass2'? ...
    """
    return find_parameters(scenario, [name])[0]


def find_parameters(scenario: StudiedScenario, names: Iterable[str]) -> list[ScenarioParameter]:
    """Parameters of a scenario by their names, which must be different; raises ParameterError.

    >>> from mckibben.scenario import Scenario
    >>> scenario = Scenario.read("examples/pre-contracted-step-pid.yaml")
    >>> find_parameters(scenario, ["load.mass2", "load.mass2"])
    Traceback (most recent call last):
        ...
    mckibben.errors.ParameterError: 'load.mass2' and 'load.mass2' are the same parameter; keep one of them
    """
    spelt: dict[Place, str] = {}
    several: list[ScenarioParameter] = []
    parameters = _Parameters.of(scenario) if (names := list(names)) else _Parameters()
    for name in names:
        parameter = _resolve(parameters, name)
        if twice := next((spelt[place] for place in parameter.places if place in spelt), None):
            both = f"{quoted(twice)} and {quoted(name)} are the same parameter"
            raise ParameterError(both, value=name, remedy="keep one of them")
        spelt |= dict.fromkeys(parameter.places, name)
        several.append(parameter)
    return several


def _resolve(parameters: _Parameters, name: str) -> ScenarioParameter:
    """Parameter by its name or the unique end of it; `ParameterError` says what is there instead."""
    spelling = name.strip()
    endings = [known for known in parameters.listed if known.endswith(f".{spelling}")]
    canonical = parameters.spellings.get(spelling, endings[0] if len(endings) == 1 else "")
    if canonical:
        return ScenarioParameter(canonical, *parameters.numbers[canonical])
    keys = spelling.split(".")
    starts = [".".join(keys[:depth]) for depth in range(len(keys), 0, -1)]
    if refused := next((start for start in starts if start in parameters.refused), ""):
        reason, remedy = parameters.refused[refused]
        raise ParameterError(f"{quoted(spelling)} cannot be varied: {reason}", value=name, remedy=remedy)
    part = next((start for start in starts if start in parameters.parts), "")
    inside = [known for known in parameters.spellings if known.startswith(f"{part}.")]
    if (part and part == spelling) or endings:
        message = f"{quoted(spelling)} is {'the end of several names' if endings else 'a group of parameters'}"
        raise _unknown(message, name, endings or inside)
    kind = f"{part}, of class {class_name(type(parameters.parts[part]))}," if part else "the scenario"
    message = f"{kind} has no parameter {quoted(spelling.removeprefix(f'{part}.'))}"
    raise _unknown(message, name, _nearest(spelling, inside or list(parameters.spellings)))


def _nearest(name: str, known: list[str]) -> list[str]:
    """Return the names with the same last key, or the closest one."""
    return [other for other in known if other.endswith(f".{name.split('.')[-1]}")] or [closest(name, known)]


def _unknown(message: str, name: str, nearest: list[str]) -> ParameterError:
    """Return the error of a name of no parameter, with those that may be meant."""
    meant = " or ".join(repr(known) for known in nearest[:3] if known)
    return ParameterError(message, value=name, remedy=f"did you mean {meant}? {LISTING}" if meant else LISTING)
