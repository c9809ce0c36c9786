"""Wrong calls of public functions and classes: the error names the argument and the call that is probably meant.

With `mckibben.errors.closest`, this is the only code that answers a mistake in Python with a suggestion. A class may
list names that users try on it, with their meaning, in `suggestions`; the key ``()`` is a construction without
arguments.
"""

from __future__ import annotations

import inspect
import os
import sys
from abc import ABCMeta
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from functools import wraps
from numbers import Number
from types import NoneType, SimpleNamespace, UnionType
from typing import Annotated, Any, NamedTuple, ParamSpec, TypeVar, Union, get_args, get_origin, get_type_hints

from mckibben.component.checks import as_number, in_si
from mckibben.config.model import marks_in
from mckibben.errors import CallError, McKibbenError, described, suggest, with_article
from mckibben.units import Quantity

P = ParamSpec("P")
R = TypeVar("R")
Arguments = tuple[tuple[object, ...], Mapping[str, object]]
"""Arguments of a call by position, and by name."""

_CERTAIN = NoneType, str, Mapping, os.PathLike  # classes for which nothing else stands in
_NAMES = {Sequence: "list", Mapping: "mapping", str: "string"}
_OPTIONS = {"keep_outliers": "robust=False"}  # of the command line, under another name in Python
_BY_POSITION = inspect.Parameter.POSITIONAL_OR_KEYWORD
_BY_NAME = _BY_POSITION, inspect.Parameter.KEYWORD_ONLY


def checked_call(function: Callable[P, R]) -> Callable[P, R]:
    """Let a call that fails because of its arguments raise a `CallError`; a decorator.

    The call itself costs nothing more: arguments are compared with the signature and its types only after it failed
    with a `TypeError`, `AttributeError` or `ValueError`. Only a text in place of a flag is refused before, and one such
    as "35 mm" becomes a number in SI if the type of the argument has a unit, by position, too.

        >>> @checked_call
        ... def pull(muscle: str, pressure: float) -> str:
        ...     return muscle + pressure
        >>> pull("agonist", presure=3e5)
        Traceback (most recent call last):
            ...
        mckibben.errors.CallError: pull has no argument 'presure'; did you mean 'pressure'?
    """
    names = list(inspect.signature(function).parameters)

    def in_place(name: str, value: object) -> object:
        if not isinstance(value, str):
            return value
        if (hint := _hint(function, name)) is bool:  # "no" would count as True
            text = f"{function.__name__}: {name} is {described(value)}"
            raise CallError(text, field=name, value=value, remedy="give True or False")
        return in_si(function.__name__, name, value, next(marks_in(hint, Quantity), None))

    @wraps(function)
    def call(*args: P.args, **named: P.kwargs) -> R:
        told = *map(in_place, names, args), *args[len(names) :]
        given = {name: in_place(name, value) for name, value in named.items()}
        try:
            return function(*told, **given)  # type: ignore[arg-type]
        except (TypeError, AttributeError, ValueError, LookupError) as error:
            _explain(function, (told, given), error)
            raise

    return call


class CheckedCalls(ABCMeta):
    """Metaclass of classes whose construction raises a `CallError` for missing, unknown and surplus arguments."""

    @property
    def __signature__(cls) -> inspect.Signature:
        """Arguments of the construction; `inspect` would take those of the metaclass."""
        whole = inspect.signature(cls.__init__)
        return whole.replace(parameters=list(whole.parameters.values())[1:])

    def __call__(cls, *args: object, **named: object) -> Any:
        try:
            return super().__call__(*args, **named)
        except TypeError as error:
            _explain(cls, (args, named), error)
            raise


def _explain(function: Callable[..., object], arguments: Arguments, error: Exception) -> None:
    """Raise a `CallError` if the arguments explain an error that is not one of ours."""
    if isinstance(error, McKibbenError):
        return
    signature = inspect.signature(function)
    parameters = list(signature.parameters.values())
    bound = int(bool(parameters) and parameters[0].name in ("self", "cls"))
    try:
        values = dict(list(signature.bind(*arguments[0], **arguments[1]).arguments.items())[bound:])
    except TypeError as reason:
        given = arguments[0][bound:], arguments[1]
        raise _unbound(function, parameters[bound:], given, str(reason)) from None
    for name, value in values.items():
        for field, item, hints in _items(name, value, list(_alternatives(_hint(function, name)))):
            kinds = _classes(hints)
            if kinds and _cannot_be(item, kinds):
                others = [other for key, other in values.items() if key != name]
                remedy = _remedy(item, [kind for kind in kinds if kind is not NoneType], others)
                text = f"{function.__name__}: {field} is {described(item)}"
                raise CallError(text, field=field, value=item, remedy=remedy) from error


class _Parameters(NamedTuple):
    """Names of the parameters of a function: all, those that may be given by position, and those without a default."""

    names: list[str]
    places: list[str]
    needed: list[str]

    @classmethod
    def of(cls, parameters: list[inspect.Parameter]) -> _Parameters:
        named = [parameter for parameter in parameters if parameter.kind in _BY_NAME]
        places = [parameter.name for parameter in named if parameter.kind is _BY_POSITION]
        needed = [parameter.name for parameter in named if parameter.default is parameter.empty]
        return cls([parameter.name for parameter in named], places, needed)

    def suggest(self, unknown: str, named: Mapping[str, object]) -> str:
        """Return the remedy for an unknown name: the one in Python of an option, or the closest that is not given."""
        if (option := _OPTIONS.get(unknown, "")) and option.partition("=")[0] in self.names:
            return f"write {option}"
        return suggest(unknown, [name for name in self.names if name not in named])

    def call(self, function: str) -> str:
        """Return the call with the arguments that it needs."""
        arguments = [name if name in self.places else f"{name}=..." for name in self.needed]
        return f"{function}({', '.join([*arguments, '...'] if len(self.names) > len(self.needed) else arguments)})"


def _unbound(
    function: Callable[..., object], parameters: list[inspect.Parameter], arguments: Arguments, reason: str
) -> CallError:
    """Return the error of arguments that are unknown, too many or missing."""
    of, (args, named), signature = function.__name__, arguments, _Parameters.of(parameters)
    write = f"write {signature.call(of)}"
    if args and (reading := _reading(function, args[0])):
        return CallError(f"{of}: {reason}", value=args[0], remedy=f"to read a file, write {reading}")
    if unknown := next((name for name in named if name not in signature.names), ""):
        remedy = signature.suggest(unknown, named) if signature.names else write
        return CallError(f"{of} has no argument {unknown!r}", field=unknown, remedy=remedy)
    if len(args) > len(signature.places):
        others = ", ".join(f"{name}=..." for name in signature.names if name not in signature.places)
        text = f"{of} takes {len(signature.places)} arguments by position, not {len(args)}"
        return CallError(text, value=args, remedy=f"give others by name: {others}" if others else write)
    missing = [name for name in signature.needed if name not in [*signature.places[: len(args)], *named]]
    if not args and not named and (other := getattr(function, "suggestions", {}).get("()", "")):
        write = f"{write}; {other.format(of)}"
    text = f"{of} needs {' and '.join(missing)}" if missing else f"{of}: {reason}"
    return CallError(text, field="".join(missing[:1]), remedy=write)


def _items(name: str, value: object, hints: list[object]) -> Iterator[tuple[str, object, list[object]]]:
    """An argument and each item of a list or mapping: its name, its value and the types that it may have."""
    yield name, value, hints
    if isinstance(value, list | tuple | dict):
        several = Mapping if isinstance(value, dict) else Sequence
        inner = [kind for hint in hints if get_origin(hint) is several for kind in _alternatives(get_args(hint)[-1])]
        for place, item in value.items() if isinstance(value, dict) else enumerate(value):
            yield f"{name}[{place!r}]", item, inner


def _remedy(value: object, kinds: list[type], others: list[object]) -> str:
    """Remedy for an argument of the wrong type."""
    if kinds == [Mapping]:
        return "give values by name, such as {'name': value}"
    if not any(_is_ours(kind) or kind in _CERTAIN for kind in kinds):
        return as_number(value)
    remedy = f"give {with_article(' or '.join(_NAMES.get(kind, kind.__name__) for kind in kinds))}"
    if reading := _reading(kinds[0], value):
        return f"{remedy}: {reading}"
    if callable(getattr(type(value), method := kinds[0].__name__.lower(), None)):
        return f"{remedy}: {type(value).__name__}.{method}() returns one"
    swapped = any(isinstance(other, kind) for other in others for kind in kinds if _is_ours(kind))
    return f"{remedy}; are arguments swapped?" if swapped else remedy


def _reading(kind: Callable[..., object], value: object) -> str:
    """The call that reads an object from a file, if the value is a path; else empty."""
    reader = next((name for name in ("read", "from_yaml") if hasattr(kind, name)), "")
    is_path = isinstance(value, str | os.PathLike)
    return f"{kind.__name__}.{reader}({os.fspath(value)!r:.60})" if reader and is_path else ""


def _hint(function: Callable[..., object], name: str) -> object:
    """Type of an argument; `object` if it is unknown, as those of a class, which checks its fields itself."""
    with suppress(Exception):  # a name that only type checkers import
        written = SimpleNamespace(__annotations__={name: function.__annotations__[name]})
        if not isinstance(function, type):
            return get_type_hints(written, vars(sys.modules[function.__module__]), include_extras=True)[name]
    return object


def _alternatives(hint: object) -> Iterator[object]:
    """Alternatives of a type."""
    origin = get_origin(hint)
    if origin in (Union, UnionType, Annotated):
        for alternative in get_args(hint)[: 1 if origin is Annotated else None]:
            yield from _alternatives(alternative)
    else:
        yield type if origin is type else hint


def _classes(hints: Sequence[Any]) -> list[type]:
    """Classes of alternatives, None included; empty if one of them is not a class."""
    kinds = list(dict.fromkeys(get_origin(hint) or hint for hint in hints))
    plain = (isinstance(kind, type) and kind is not Any and not getattr(kind, "_is_protocol", False) for kind in kinds)
    return kinds if all(plain) else []


def _is_ours(kind: type) -> bool:
    return kind.__module__.partition(".")[0] == "mckibben"


def _cannot_be(value: object, kinds: list[type]) -> bool:
    """Whether a value cannot be an instance of these classes; a number may stand for an array and vice versa."""
    certain = (*_CERTAIN, Sequence) if isinstance(value, Number) else _CERTAIN
    certainly = isinstance(value, NoneType | str | Mapping) or all(_is_ours(kind) or kind in certain for kind in kinds)
    return certainly and not isinstance(value, tuple(kinds))


def user_level() -> int:
    """Return the stack level, counted from the caller, of the first frame outside this package and its wrappers."""
    level, frame = 1, sys._getframe(1)
    while frame.f_back and frame.f_globals.get("__name__", "").partition(".")[0] in ("mckibben", "equinox", "jax"):
        level, frame = level + 1, frame.f_back
    return level
