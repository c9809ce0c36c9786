"""What a scenario has that can be varied, under which names, and why the rest cannot."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from types import UnionType
from typing import Any, Union, get_args, get_origin

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from mckibben.study.parameters.nominal import defaults_of
from mckibben.study.scenario import GeometrySpec, JointSpec, LoadSpec, LoopSpec, Scenario, SignalSpec
from mckibben.study.scenario.part import Part
from mckibben.study.scenario.quantity import Quantity
from mckibben.study.scenario.words import Choice, Entry, Whole

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
