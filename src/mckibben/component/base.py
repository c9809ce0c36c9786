"""Base of components: fields are checked against their types at construction, and shown with units in notebooks."""

from __future__ import annotations

import dataclasses
import functools
import operator
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from inspect import get_annotations
from numbers import Integral, Real
from types import MethodType, NoneType, SimpleNamespace, UnionType
from typing import (
    TYPE_CHECKING,
    Annotated,
    Any,
    ClassVar,
    Literal,
    TypeVar,
    Union,
    cast,
    get_args,
    get_origin,
    get_type_hints,
)

import equinox as eqx
import jax
import numpy as np

from mckibben.component.calls import CheckedCalls
from mckibben.component.checks import check_kind, in_si, known_numbers
from mckibben.config.model import marks_in
from mckibben.errors import Problem, RangeError, Suggesting, described, printable, quoted, refuse_problems
from mckibben.result import Listing
from mckibben.units import SYMBOLS, BoundedInt, Quantity, factor, show

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

D = TypeVar("D")
_LONGEST = 120  # characters of a value


@dataclass(frozen=True, init=False)
class Units:
    """Quantities for the symbolic units in `SYMBOLS`: metadata of the field that holds a component.

    >>> from mckibben.units import Angle
    >>> Units(signal=Angle).get("signal").shown
    'deg'
    """

    quantities: tuple[tuple[str, Quantity], ...]

    def __init__(self, **types: object) -> None:
        quantities = tuple((name, next(marks_in(kind, Quantity))) for name, kind in types.items())
        object.__setattr__(self, "quantities", quantities)

    def get(self, symbol: str, default: D = None) -> Quantity | D:
        """Return the quantity of a symbol; `default` without one."""
        return next((quantity for name, quantity in self.quantities if symbol == name), default)

    def __bool__(self) -> bool:
        return bool(self.quantities)


_NO_UNITS = Units()


class once(property):  # noqa: N801
    """Property of a component that is computed when it is first asked for, except from traced numbers."""

    def __get__(self, instance: object, owner: type | None = None) -> Any:
        name, known = getattr(self.fget, "__qualname__", ""), getattr(instance, "_once", {})
        if name in known:
            return known[name]
        value = super().__get__(instance, owner)
        if instance is not None and not any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves(value)):
            object.__setattr__(instance, "_once", known | {name: value})
        return value


class Described:
    """Base of classes that define their form in files.

    All attributes have defaults: a class is read from and written to files by its fields alone.

    An object read from a file records its origin and the fields that it inherited. They are slots, so that they are
    not part of the tree, and are lost as soon as the object is changed, as is what is computed `once`.
    """

    __slots__ = ("_inherited", "_once", "_origin")

    def __setstate__(self, state: Any) -> None:  # of `pickle`, which would set slots by a method that is blocked
        fields, marks = state if isinstance(state, tuple) else (state, {})
        marks.pop("_once", None)
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

    @classmethod
    def from_file(cls, value: object) -> object:
        """Return a section that has a special form in the usual form; by default unchanged."""
        return value

    @classmethod
    def unit_of(cls, name: str) -> Quantity | None:
        """Return unit and range of a field that does not state them in its type; None for a plain number."""
        return None


class _TextWithUnits(CheckedCalls):
    """Metaclass of classes whose fields may be given as in files, as text with a unit: ``Pulley("35 mm", 0.25)``."""

    def __call__(cls, *args: object, **named: object) -> Any:  # noqa: N805
        if any(isinstance(value, str | list | tuple) and value for value in (*args, *named.values())):
            names, kind = list(cls.__signature__.parameters), cast("type[Described]", cls)
            args = (*(_in_si(kind, *field) for field in zip(names, args, strict=False)), *args[len(names) :])
            named = {name: _in_si(kind, name, value) for name, value in named.items()}
        return super().__call__(*args, **named)


def _in_si(kind: type[Described], name: str, value: object) -> object:
    mark = field_quantities(kind).get(name) or units_of_part(field_hints(kind).get(name)).get("signal")
    return in_si(kind.__name__, name, value, mark or kind.unit_of(name))


_ComponentMeta: Any = type("_ComponentMeta", (_TextWithUnits, type(eqx.Module)), {})


class Component(Described, Suggesting, eqx.Module, metaclass=_ComponentMeta):  # pyrefly: ignore[invalid-inheritance]
    """Base of all parts of a model: a frozen `equinox.Module` whose fields have the declared types and ranges.

    Numbers are in SI, or texts with a unit. A subclass is a pytree, whose leaves are its parameters. Files, sweeps,
    tuning, export and the contract derive from its annotated fields. A rule between fields stands in
    `__check_init__`, which is called for each class of the hierarchy, beginning with this one.

        >>> from mckibben.joint import PendulumLoad
        >>> PendulumLoad(0.3, length=300.0)
        Traceback (most recent call last):
            ...
        mckibben.errors.RangeError: PendulumLoad: length is 300 m, out of range (above 0, up to 10000 mm); ...
    """

    def __check_init__(self) -> None:
        check_fields(self)

    if not TYPE_CHECKING:

        def __getattribute__(self, name: str) -> Any:
            """Return an attribute: methods by `equinox.Module`, all others without its tests, which take longer."""
            value = object.__getattribute__(self, name)
            return super().__getattribute__(name) if type(value) is MethodType else value

    def _repr_html_(self) -> str:
        tables: dict[str, list[tuple[str, str]]] = {"": []}  # of own fields, and of those of each part, to be opened
        for name, value in _rows(self):
            tables.setdefault(name.rpartition(".")[0].partition(".")[0], []).append((name, value))
        headings = "field", "value, SI if no unit is given"
        first, *others = (Listing.of("", headings, rows).to_html() for rows in tables.values())
        opened = zip(list(tables)[1:], others, strict=True)
        more = (f"<details><summary>{name}</summary>{table}</details>" for name, table in opened)
        return f"<p>{type(self).__name__}</p>{first}{''.join(more)}"


class Checked(Described, Suggesting, metaclass=_TextWithUnits):
    """Base of dataclasses whose fields are checked as those of components, and which are no pytrees.

    For settings that are no part of a model, such as the limits of a rig.
    """

    def __post_init__(self) -> None:
        check_fields(self)


@functools.cache
def field_quantities(kind: type) -> dict[str, Quantity | BoundedInt]:
    """Unit and range of each field of a class that has them, such as ``mass: Mass`` or ``supply: Pressure | None``.

    >>> from mckibben.joint import PendulumLoad
    >>> field_quantities(PendulumLoad)["length"].range
    'above 0, up to 10000 mm'
    """
    marks = {name: {*marks_in(hint, Quantity | BoundedInt)} for name, hint in field_hints(kind).items()}
    return {
        name: found_quantities.pop() for name, found_quantities in marks.items() if len(found_quantities) == 1
    }  # not a tuple of several quantities


@dataclasses.dataclass(frozen=True)
class Inherited:
    """Marks a field that a file may leave out: it is then taken from the scope, the fields around the section.

    `find` raises `KeyError` if the scope lacks the field; then the default applies, or the field is missing.
    """

    find: Callable[[Mapping[str, Any]], Any]


def check_fields(instance: object) -> None:
    """Check the fields of a component against their types and ranges; defaults and tracers pass.

    A number has unit and range from its type, a component its class, a word its alternatives. Parts are checked when
    they are made, except for fields whose unit depends on where the part is.

    Raises
    ------
    RangeError
        For one field of another type, or with a number outside its range: field, value, limits in SI and remedy.
        Several such fields are listed in one error, whose field and value are those of the first.
    """
    errors = list(_errors(instance))
    if len(errors) == 1:
        raise errors[0]
    refuse_problems(type(instance).__name__, [_problem(instance, error) for error in errors])


def field_problems(instance: object) -> list[Problem]:
    """Problems of the fields, as by `check_fields`."""
    return [_problem(instance, error) for error in _errors(instance)]


def _problem(instance: object, error: RangeError) -> Problem:
    problem, prefix = Problem.of(error, field=error.field), f"{type(instance).__name__}: {error.field} "
    return dataclasses.replace(problem, message=problem.message.removeprefix(prefix))


def _errors(instance: object, units: Units = _NO_UNITS) -> Iterator[RangeError]:
    """Errors of the fields; `units` are those of symbolic ones, which otherwise pass."""
    kind = type(instance)
    for field in dataclasses.fields(cast("DataclassInstance", instance)):
        value = getattr(instance, field.name)
        try:
            _check_field(kind, field, value, units)
        except RangeError as error:
            yield error
        for member in value if isinstance(value, tuple) else (value,):
            if isinstance(member, Component) and (inner := units_of_part(field_hints(kind).get(field.name)) or units):
                yield from _errors(member, inner)
    for group in getattr(kind, "together", ()):
        missing = [name for name in group if getattr(instance, name) is None]
        if 0 < len(missing) < len(group):
            message = f"{kind.__name__}: {missing[0]} is missing, which {' and '.join({*group} - {*missing})} needs"
            yield RangeError(message, field=missing[0], remedy="give all of them, or none")


def _check_field(kind: type, field: dataclasses.Field[object], value: object, units: Units) -> None:
    """Raise `RangeError` for a component of another class, another word, and what `_check_numbers` refuses."""
    owner, name = kind.__name__, field.name
    classes, words = _component_classes(kind).get(name), _words(kind).get(name)
    if classes is not None:
        check_kind(owner, name, value, classes)
    elif words is not None:
        if value not in words:
            remedy = f"give one of {', '.join(map(repr, words))}"
            raise RangeError(f"{owner}: {name} is {quoted(str(value))}", field=name, value=value, remedy=remedy)
    else:
        _check_numbers(owner, field, value, field_hints(kind).get(name), field_quantities(kind).get(name), units)


def _check_numbers(
    owner: str,
    field: dataclasses.Field[object],
    value: object,
    hint: object,
    mark: Quantity | BoundedInt | None,
    units: Units,
) -> None:
    """Raise `RangeError` for a number that is missing, out of range or not whole, or for several in place of one."""
    name = field.name
    if isinstance(value, tuple | list) and (mark or hint is float) and not _is_sequence(hint):
        message, remedy = f"{owner}: {name} is {described(value)}", "give one number"
        raise RangeError(message, field=name, value=value, remedy=remedy)
    if mark is None or (value is None and (NoneType in get_args(hint) or field.default is None)):
        return
    if value is None:
        raise RangeError(f"{owner}: {name} is None", field=name, remedy=f"give {mark.range}")
    whole = isinstance(value, Integral) and not isinstance(value, bool)
    if isinstance(mark, BoundedInt) and isinstance(value, Real) and not whole:
        raise RangeError(f"{owner}: {name} is {value}, not a whole number", field=name, value=value)
    mark = units.get(mark.unit, mark)
    is_symbolic = mark.unit in SYMBOLS
    numbers = known_numbers(owner, name, value, "" if is_symbolic or isinstance(mark, BoundedInt) else mark.shown)
    if isinstance(field.default, Real):  # infinite: no limit
        numbers = numbers[numbers != field.default]
    if not is_symbolic and not (inside := mark.holds(numbers)).all():
        raise _outside(owner, name, float(numbers[~inside][0]), mark)


def units_of_part(hint: object) -> Units:
    """Return the units of the symbolic fields of a part, from the type of the field that holds it.

    >>> from mckibben.units import Angle
    >>> units_of_part(Annotated[float, Units(signal=Angle)] | None).get("signal").shown
    'deg'
    """
    return next(marks_in(hint, Units), _NO_UNITS)


def _is_sequence(hint: object) -> bool:
    origins = (get_origin(alternative) for alternative in (hint, *get_args(hint)))
    return any(isinstance(origin, type) and issubclass(origin, Sequence) for origin in origins)


@functools.cache
def field_hints(kind: type[DataclassInstance]) -> dict[str, Any]:
    """Return the types of the fields with their marks, except for those with unknown names.

    Names are those of the module of the class that declares the field; a name that only type checkers import leaves
    out the field, not the class.
    """
    hints = {}
    for base in reversed(kind.__mro__):
        for name, hint in get_annotations(base).items():
            hints.pop(name, None)
            with suppress(Exception):  # an annotation may raise anything
                written = SimpleNamespace(__annotations__={name: hint})
                hints |= get_type_hints(written, vars(sys.modules[base.__module__]), include_extras=True)
    return {field.name: hints[field.name] for field in dataclasses.fields(kind) if field.name in hints}


@functools.cache
def _component_classes(kind: type) -> dict[str, type | UnionType]:
    """Classes of the fields that are components: a class, or a union."""
    components = {}
    for name, hint in field_hints(kind).items():
        plain = _without_marks(hint)
        options = get_args(plain) if get_origin(plain) in (Union, UnionType) else (plain,)
        classes = [_without_marks(option) for option in options]
        if all(isinstance(option, type) and issubclass(option, Component | NoneType) for option in classes):
            components[name] = functools.reduce(operator.or_, classes)
    return components


def _without_marks(hint: object) -> object:
    return get_args(hint)[0] if get_origin(hint) is Annotated else hint


@functools.cache
def _words(kind: type) -> dict[str, tuple[object, ...]]:
    """Values of the fields that take one of some words."""
    return {name: get_args(hint) for name, hint in field_hints(kind).items() if get_origin(hint) is Literal}


def _outside(owner: str, name: str, value: float, mark: Quantity | BoundedInt) -> RangeError:
    lower, upper = mark.limits
    scale, unit = factor(mark.shown, mark.unit), "" if mark.unit == "1" else f" {mark.unit}"
    text, remedy = f"{owner}: {name} is {value:g}{unit}, out of range ({mark.range})", "choose a value inside"
    if scale != 1 and mark.holds(value * scale):
        remedy = f"numbers are in SI: {value:g} {mark.shown} is {value * scale:g}{unit}"
    return RangeError(text, field=name, value=value, lower=lower, upper=upper, unit=mark.unit, remedy=remedy)


def _rows(component: Component) -> Iterator[tuple[str, str]]:
    """Name and value of each field that is set, those of parts below them."""
    for field in dataclasses.fields(component):
        value, mark = getattr(component, field.name), field_quantities(type(component)).get(field.name)
        if not field.repr or value is None:
            continue
        if isinstance(value, Component):
            yield field.name, type(value).__name__
            yield from ((f"{field.name}.{name}", text) for name, text in _rows(value))
        elif isinstance(mark, Quantity) and isinstance(value, Real):
            yield field.name, show(float(value), mark.shown)
        else:
            yield field.name, printable(" ".join(repr(value).split()), _LONGEST)


def plain(value: Any) -> object:
    """Value of a field as the model of its class has it: a word, a number or a tuple of numbers.

    >>> plain(np.array([1.0, 2.0])), plain(np.float64(3.0)), plain("left")
    ((1.0, 2.0), 3.0, 'left')
    """
    if hasattr(value, "ndim"):
        return tuple(np.asarray(value, float).tolist()) if value.ndim else value.item()
    return value


def same(value: object, default: object) -> bool:
    """Return whether a value is that of the default; arrays never are.

    >>> same(2, 2.0), same("2", 2), same(np.ones(2), np.ones(2))
    (True, False, False)
    """
    if value is default:
        return True
    if type(value) is not type(default) and not (isinstance(value, int | float) and isinstance(default, int | float)):
        return False
    try:
        return bool(value == default)
    except (ValueError, TypeError):  # arrays
        return False
