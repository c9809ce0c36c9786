"""Wrong calls of public functions and classes: the error names the argument and the call that is meant."""

from __future__ import annotations

import inspect
import os
import sys
from abc import ABCMeta
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from functools import wraps
from numbers import Number
from types import NoneType, SimpleNamespace, UnionType
from typing import Annotated, Any, ParamSpec, TypeVar, Union, get_args, get_origin, get_type_hints

from mckibben.component.checks import as_number
from mckibben.errors import CallError, McKibbenError, closest, described, with_article

P = ParamSpec("P")
R = TypeVar("R")
_EXPLAINED = TypeError, AttributeError, ValueError
_CERTAIN = NoneType, str, Mapping, os.PathLike
_READERS = "read", "from_yaml"  # class methods that read a file
_NAMES = {Sequence: "list", Mapping: "mapping", str: "string"}
_OPTIONS = {"keep_outliers": "robust=False"}  # of the command line, with another name in Python
_BY_NAME = inspect.Parameter.POSITIONAL_OR_KEYWORD, inspect.Parameter.KEYWORD_ONLY


def checked_call(function: Callable[P, R]) -> Callable[P, R]:
    """Let a call that fails for a wrong argument, or with a text in place of a flag, raise a `CallError`."""

    @wraps(function)
    def called(*args: P.args, **named: P.kwargs) -> R:
        for name, value in named.items():
            if isinstance(value, str) and _hint(function, name) is bool:  # "no" would count as True
                text = f"{function.__name__}: {name} is {described(value)}"
                raise CallError(text, field=name, value=value, remedy="give True or False")
        try:
            return function(*args, **named)
        except _EXPLAINED as error:
            _explain(function, args, named, error)
            raise

    return called


class CheckedCalls(ABCMeta):
    """Metaclass of classes whose construction raises a `CallError` for missing, unknown and surplus arguments."""

    @property
    def __signature__(cls) -> inspect.Signature:
        """Arguments of the construction; `inspect` would take those of the metaclass."""
        whole = inspect.signature(cls.__init__)
        return whole.replace(parameters=list(whole.parameters.values())[1:])

    def __call__(cls, *args: Any, **named: Any) -> Any:
        try:
            return super().__call__(*args, **named)
        except TypeError as error:
            _explain(cls, args, named, error)
            raise


def _explain(of: Callable[..., Any], args: tuple[Any, ...], named: Mapping[str, Any], error: Exception) -> None:
    """Raise a `CallError` if the arguments explain an error that is none of ours."""
    if isinstance(error, McKibbenError):
        return
    signature = inspect.signature(of)
    bound = next(iter(signature.parameters), "") in ("self", "cls")
    shown = list(signature.parameters.values())[bound:]
    try:
        given = dict(list(signature.bind(*args, **named).arguments.items())[bound:])
    except TypeError as unbound:
        failed = _unbound(of.__name__, shown, args[bound:], named, str(unbound))
        if args[bound:] and (remedy := _reading(of, args[bound])):
            failed.remedy = f"to read a file, write {remedy}"
        elif not args[bound:] and not named and (call := getattr(of, "made_by", "")):
            failed.remedy += f"; {call.format(of.__name__)}"
        raise failed from None
    for name, value in given.items():
        hints = list(_flat(_hint(of, name)))
        checked = [(name, value, hints)]
        if isinstance(value, list | tuple | dict):
            several = Mapping if isinstance(value, dict) else Sequence
            items = [kind for hint in hints if get_origin(hint) is several for kind in _flat(get_args(hint)[-1])]
            each = value.items() if isinstance(value, dict) else enumerate(value)
            checked += [(f"{name}[{place!r}]", one, items) for place, one in each]
        for field, wrong, allowed in checked:
            kinds = _classes(allowed)
            if kinds and _is_wrong(wrong, kinds):
                others = [other for key, other in given.items() if key != name]
                remedy = _remedy(wrong, [one for one in kinds if one is not NoneType], others)
                text = f"{of.__name__}: {field} is {described(wrong)}"
                raise CallError(text, field=field, value=wrong, remedy=remedy) from error


def _unbound(
    of: str, shown: list[inspect.Parameter], args: tuple[Any, ...], named: Mapping[str, Any], reason: str
) -> CallError:
    """The error of arguments that are unknown, too many or missing."""
    names = [one.name for one in shown if one.kind in _BY_NAME]
    places = [one.name for one in shown if one.kind is _BY_NAME[0]]
    needed = [one for one in shown if one.default is one.empty and one.kind in _BY_NAME]
    forms = [one.name if one.kind is _BY_NAME[0] else f"{one.name}=..." for one in needed]
    call = f"write {of}({', '.join([*forms, '...'] if len(names) > len(needed) else forms)})"
    if unknown := next((one for one in named if one not in names), ""):
        if (option := _OPTIONS.get(unknown, "")) and option.partition("=")[0] in names:
            return CallError(f"{of} has no argument {unknown!r}", field=unknown, remedy=f"write {option}")
        meant = closest(unknown, [one for one in names if one not in named])
        remedy = f"did you mean {meant!r}?" if meant else f"known are {', '.join(names)}" if names else call
        return CallError(f"{of} has no argument {unknown!r}", field=unknown, remedy=remedy)
    if len(args) > len(places):
        more = [f"{one}=..." for one in names if one not in places]
        remedy = f"give others by name: {', '.join(more)}" if more else call
        return CallError(f"{of} takes {len(places)} arguments by position, not {len(args)}", value=args, remedy=remedy)
    missing = [one.name for one in needed if one.name not in [*places[: len(args)], *named]]
    text = f"{of} needs {' and '.join(missing)}" if missing else f"{of}: {reason}"
    return CallError(text, field="".join(missing[:1]), remedy=call)


def _remedy(value: object, kinds: list[type], others: list[Any]) -> str:
    """Remedy for an argument of the wrong type."""
    if kinds == [Mapping]:
        return "give values by name, such as {'name': value}"
    if not any(_is_ours(one) or one in _CERTAIN for one in kinds):
        return as_number(value)
    remedy = f"give {with_article(' or '.join(_NAMES.get(one, one.__name__) for one in kinds))}"
    if reading := _reading(kinds[0], value):
        return f"{remedy}: {reading}"
    swapped = any(isinstance(other, kind) for other in others for kind in kinds if _is_ours(kind))
    return f"{remedy}; are arguments swapped?" if swapped else remedy


def _reading(kind: Any, value: object) -> str:
    """The call that reads an object from a file, if the value is a path; empty without one."""
    reader = next((one for one in _READERS if hasattr(kind, one)), "")
    return (
        f"{kind.__name__}.{reader}({os.fspath(value)!r:.60})" if reader and isinstance(value, str | os.PathLike) else ""
    )


def _hint(of: Callable[..., Any], name: str) -> Any:
    """Type of an argument; `Any` if unknown."""
    hint = {} if isinstance(of, type) else of.__annotations__
    with suppress(Exception):  # a name that only type checkers import
        one = SimpleNamespace(__annotations__={name: hint[name]})
        return get_type_hints(one, vars(sys.modules[of.__module__]))[name]
    return Any


def _flat(hint: Any) -> Iterator[Any]:
    """Alternatives of a type."""
    origin = get_origin(hint)
    if origin in (Union, UnionType, Annotated):
        for one in get_args(hint)[: 1 if origin is Annotated else None]:
            yield from _flat(one)
    else:
        yield type if origin is type else hint


def _classes(hints: Iterable[Any]) -> list[type]:
    """Classes of alternatives, None included; empty if one of them is not a class."""
    found = list(dict.fromkeys(get_origin(hint) or hint for hint in hints))
    certain = all(isinstance(one, type) and one is not Any and not getattr(one, "_is_protocol", False) for one in found)
    return found if certain else []


def _is_ours(kind: type) -> bool:
    return kind.__module__.partition(".")[0] == "mckibben"


def _is_wrong(value: object, kinds: list[type]) -> bool:
    """Whether a value is certainly of none of these classes; numbers and arrays stand for each other."""
    certain = (*_CERTAIN, Sequence) if isinstance(value, Number) else _CERTAIN
    known = isinstance(value, NoneType | str | Mapping) or all(_is_ours(one) or one in certain for one in kinds)
    return known and not isinstance(value, tuple(kinds))


def user_level() -> int:
    """Return the stack level, counted from the caller, of the first frame outside this package and its wrappers."""
    level, frame = 1, sys._getframe(1)
    while frame.f_back and frame.f_globals.get("__name__", "").partition(".")[0] in ("mckibben", "equinox", "jax"):
        level, frame = level + 1, frame.f_back
    return level
