"""Base of components: fields are checked against their types at construction, and shown with units in notebooks."""

from __future__ import annotations

import dataclasses
import enum
import functools
import operator
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from inspect import get_annotations
from numbers import Integral, Real
from types import NoneType, SimpleNamespace, UnionType
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, Union, get_args, get_origin, get_type_hints

import equinox as eqx
import numpy as np

from mckibben.component.calls import CheckedCalls
from mckibben.component.checks import check_kind, known_numbers
from mckibben.errors import Problem, RangeError, described, no_attribute, printable, quoted, refuse_problems
from mckibben.notebook import html_table
from mckibben.units import SYMBOLS, BoundedInt, Quantity, factor, show

_LONGEST = 120  # characters of a value


@dataclass(frozen=True, init=False)
class Units:
    """Quantities for the symbolic units in `SYMBOLS`: metadata of the field that holds a component.

    >>> from mckibben.units import Angle
    >>> Units(signal=Angle).get("signal").shown
    'deg'
    """

    quantities: tuple[tuple[str, Quantity], ...]

    def __init__(self, **types: Any) -> None:
        found = tuple((name, kind.__metadata__[0]) for name, kind in types.items())
        object.__setattr__(self, "quantities", found)

    def get(self, symbol: str, default: Any = None) -> Any:
        """Return the quantity of a symbol; `default` without one."""
        return next((quantity for name, quantity in self.quantities if symbol == name), default)

    def __bool__(self) -> bool:
        return bool(self.quantities)


_NO_UNITS = Units()


class Described:
    """Base of classes that define their form in files.

    An object read from a file records its origin and the fields that it inherited. They are slots, so that they are
    not part of the tree, and are lost as soon as the object is changed.
    """

    __slots__ = ("_inherited", "_origin")

    def __setstate__(self, state: Any) -> None:  # of `pickle`, which would set slots by a method that is blocked
        fields, marks = state if isinstance(state, tuple) else (state, {})
        self.__dict__.update(fields or {})
        for name, value in marks.items():
            object.__setattr__(self, name, value)

    short_name: ClassVar[str] = ""
    """Name of the class in files, in addition to its own."""
    default_class: ClassVar[str] = ""
    """Name of the class of a section that names none, on the base that a field is declared with."""
    aliases: ClassVar[Mapping[str, tuple[str, ...]]] = {}
    """Keys in files that give several fields one value."""
    together: ClassVar[tuple[tuple[str, ...], ...]] = ()
    """Groups of optional fields of which all are given or none; a study varies them where they are given."""
    suggestions: ClassVar[Mapping[str, str]] = {}
    """Meaning of names that users try on objects of the class; that of ``()`` is a construction without arguments."""

    @classmethod
    def from_file(cls, value: Any) -> Any:
        """Return a section that has a special form in the usual form; by default unchanged."""
        return value

    @classmethod
    def unit_of(cls, name: str) -> Quantity | None:
        """Return unit and range of a field that does not state them in its type; None for a plain number."""
        return None


_ComponentMeta: Any = type("_ComponentMeta", (CheckedCalls, type(eqx.Module)), {})


class Component(Described, eqx.Module, metaclass=_ComponentMeta):  # pyrefly: ignore[invalid-inheritance]
    """Module with fields of the declared types and numbers in range; the check of a subclass begins with this one."""

    def __check_init__(self) -> None:
        check_fields(self)

    if not TYPE_CHECKING:  # an unknown attribute stays an error of the type checker

        def __getattr__(self, name: str) -> Any:
            if isinstance(found := getattr(type(self), name, None), property):
                return found.fget(self)  # raises its own error
            raise no_attribute(self, name, self.suggestions)

    def _repr_html_(self) -> str:
        return html_table(type(self).__name__, ("field", "value, SI if no unit is given"), _rows(self))


class Checked(Described, metaclass=CheckedCalls):
    """Base of dataclasses whose fields are checked as those of components."""

    def __post_init__(self) -> None:
        check_fields(self)


@functools.cache
def field_quantities(kind: type) -> dict[str, Quantity | BoundedInt]:
    """Unit and range of each field of a class that has them, such as ``mass: Mass`` or ``supply: Pressure | None``."""
    marks = {name: {*_marks(hint)} for name, hint in field_hints(kind).items()}
    return {name: found.pop() for name, found in marks.items() if len(found) == 1}  # not a tuple of several quantities


@dataclasses.dataclass(frozen=True)
class Inherited:
    """Marks a field that a file may leave out: it is then taken from the scope, the fields around the component.

    `find` raises `KeyError` if the scope lacks the field; then the default applies, or the field is missing.
    """

    find: Callable[[Mapping[str, Any]], Any]


def check_fields(instance: Any) -> None:
    """Raise `RangeError` for fields of another type, and numbers outside their range; defaults and tracers pass."""
    errors = list(_errors(instance))
    if len(errors) == 1:
        raise errors[0]
    refuse_problems(type(instance).__name__, [_problem(instance, error) for error in errors])


def field_problems(instance: Any) -> list[Problem]:
    """Problems of the fields, as by `check_fields`."""
    return [_problem(instance, error) for error in _errors(instance)]


def _problem(instance: Any, error: RangeError) -> Problem:
    found = Problem.of(error, field=error.field)
    return dataclasses.replace(found, message=found.message.removeprefix(f"{type(instance).__name__}: {error.field} "))


def _errors(instance: Any, units: Units = _NO_UNITS) -> Iterator[RangeError]:
    """Errors of the fields; `units` are those of symbolic ones, which otherwise pass."""
    kind, owner = type(instance), type(instance).__name__
    quantities, kinds, choices, hints = field_quantities(kind), _kinds(kind), _words(kind), field_hints(kind)
    for field in dataclasses.fields(instance):
        name, value, mark = field.name, getattr(instance, field.name), quantities.get(field.name)
        words = choices.get(name)
        try:
            if name in kinds:
                check_kind(owner, name, value, kinds[name])
            elif words and value not in words:
                remedy = f"give one of {', '.join(map(repr, words))}"
                yield RangeError(f"{owner}: {name} is {quoted(str(value))}", field=name, value=value, remedy=remedy)
            elif (
                isinstance(value, tuple | list) and (mark or hints.get(name) is float) and not _is_sequence(hints[name])
            ):
                text, remedy = f"{owner}: {name} is {described(value)}", "give one number"
                yield RangeError(text, field=name, value=value, remedy=remedy)
            elif mark and value is None:
                if NoneType not in get_args(hints[name]) and field.default is not None:
                    yield RangeError(f"{owner}: {name} is None", field=name, remedy=f"give {mark.range}")
            elif isinstance(mark, BoundedInt) and isinstance(value, Real) and not _whole(value):
                yield RangeError(f"{owner}: {name} is {value}, not a whole number", field=name, value=value)
            elif mark:
                mark = units.get(mark.unit, mark)
                shown = mark.shown if isinstance(mark, Quantity) and mark.unit not in SYMBOLS else ""
                numbers = known_numbers(owner, name, value, shown)
                if isinstance(field.default, Real):  # infinite: no limit
                    numbers = numbers[numbers != field.default]
                if mark.unit not in SYMBOLS and not (right := mark.holds(numbers)).all():
                    yield _outside(owner, name, float(numbers[~right][0]), mark)
        except RangeError as error:
            yield error
        for part in value if isinstance(value, tuple) else (value,):
            if isinstance(part, Component) and (inner := units_of_part(hints.get(name)) or units):
                yield from _errors(part, inner)
    for group in getattr(kind, "together", ()):
        missing = [name for name in group if getattr(instance, name) is None]
        if 0 < len(missing) < len(group):
            message = f"{owner}: {missing[0]} is missing, which {' and '.join({*group} - {*missing})} needs"
            yield RangeError(message, field=missing[0], remedy="give all of them, or none")


def units_of_part(hint: Any) -> Units:
    """Return the units of the symbolic fields of a part, from the type of the field that holds it."""
    return next((mark for mark in getattr(hint, "__metadata__", ()) if isinstance(mark, Units)), _NO_UNITS)


def _is_sequence(hint: Any) -> bool:
    origins = (get_origin(one) for one in (hint, *get_args(hint)))
    return any(isinstance(one, type) and issubclass(one, Sequence) for one in origins)


def _whole(value: Real) -> bool:
    return isinstance(value, Integral) and not isinstance(value, bool)


@functools.cache
def field_hints(kind: type) -> dict[str, Any]:
    """Return the types of the fields with their marks, except for those with unknown names."""
    found = {}
    for base in reversed(kind.__mro__):
        for name, hint in get_annotations(base).items():
            found.pop(name, None)
            with suppress(Exception):  # an annotation may raise anything
                one = SimpleNamespace(__annotations__={name: hint})
                found |= get_type_hints(one, vars(sys.modules[base.__module__]), include_extras=True)
    return {field.name: found[field.name] for field in dataclasses.fields(kind) if field.name in found}


def _marks(hint: Any) -> Iterator[Quantity | BoundedInt]:
    """Metadata of a type or of its parts."""
    for part in (*getattr(hint, "__metadata__", ()), *get_args(hint)):
        if isinstance(part, Quantity | BoundedInt):
            yield part
        else:
            yield from _marks(part)


@functools.cache
def _kinds(kind: type) -> dict[str, Any]:
    """Types of the fields that are components."""
    found = {}
    for name, hint in field_hints(kind).items():
        plain = get_args(hint)[0] if get_origin(hint) is Annotated else hint
        kinds = get_args(plain) if get_origin(plain) in (Union, UnionType) else (plain,)
        kinds = tuple(get_args(one)[0] if get_origin(one) is Annotated else one for one in kinds)
        if all(isinstance(one, type) and issubclass(one, Component | NoneType) for one in kinds):
            found[name] = functools.reduce(operator.or_, kinds)
    return found


@functools.cache
def _words(kind: type) -> dict[str, tuple[Any, ...]]:
    """Values of the fields that take one of some words."""
    return {name: get_args(hint) for name, hint in field_hints(kind).items() if get_origin(hint) is Literal}


def _outside(owner: str, name: str, value: float, mark: Quantity | BoundedInt) -> RangeError:
    lower, upper = mark.limits
    scale, unit = factor(mark.shown, mark.unit), "" if mark.unit == "1" else f" {mark.unit}"
    text, remedy = f"{owner}: {name} is {value:g}{unit}, outside {mark.range}", "choose a value inside"
    if scale != 1 and mark.holds(value * scale):
        remedy = f"numbers are in SI: {value:g} {mark.shown} is {value * scale:g}{unit}"
    return RangeError(text, field=name, value=value, lower=lower, upper=upper, unit=mark.unit, remedy=remedy)


def _rows(component: Any) -> Iterator[tuple[str, str]]:
    for field in dataclasses.fields(component):
        if not field.repr:
            continue
        value, mark = getattr(component, field.name), field_quantities(type(component)).get(field.name)
        if isinstance(value, Component):
            yield field.name, type(value).__name__
            yield from ((f"{field.name}.{name}", text) for name, text in _rows(value))
            continue
        try:
            text = show(float(value), mark.shown) if isinstance(mark, Quantity) else repr(value)
        except TypeError:  # an array, a tracer or None
            text = repr(value)
        yield field.name, printable(" ".join(text.split()), _LONGEST)


def member_of(kind: type, name: str, value: Any) -> Any:
    """Value of a field; the member of an enumeration that a file names."""
    hint = field_hints(kind)[name]
    choices = [hint, *get_args(hint)]
    members = next((one for one in choices if isinstance(one, type) and issubclass(one, enum.Enum)), None)
    return members[value.upper()] if members and isinstance(value, str) else value


def plain(value: Any) -> Any:
    """Value of a field as the model of its class has it: a word, a number or a tuple of numbers."""
    if isinstance(value, enum.Enum):
        return value.name.lower()
    if hasattr(value, "ndim"):
        return tuple(np.asarray(value, float).tolist()) if value.ndim else value.item()
    return value


def same(value: Any, default: Any) -> bool:
    """Return whether a value is that of the default; arrays never are."""
    if value is default:
        return True
    if type(value) is not type(default) and not (isinstance(value, int | float) and isinstance(default, int | float)):
        return False
    try:
        return bool(value == default)
    except (ValueError, TypeError):  # arrays
        return False
