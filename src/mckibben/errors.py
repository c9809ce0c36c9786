"""Errors and warnings of mckibben: each carries its message, the offending value, the allowed range and a remedy."""

from __future__ import annotations

import difflib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from numbers import Number
from typing import TYPE_CHECKING, ClassVar

LONGEST_VALUE = 80
"""Maximum number of characters of a value in a message."""

ON_COMMAND_LINE = r"\s+\(command\s+line:\s+((?:'[^']*'|[^)'])*)\)"
"""Pattern of the part of a remedy with command-line options, also wrapped; quoted text may have parentheses."""

_LONGEST_MESSAGE = 1000


def printable(text: str, longest: int | None = None) -> str:
    """Text with unprintable characters except line ends escaped, truncated to a length."""
    if longest is not None and len(text) > longest:
        text = f"{text[: longest - 3]}..."
    if text.isascii() and text.isprintable():
        return text
    keep = "\n\t\u00a0"
    return "".join(c if c.isprintable() or c in keep else c.encode("unicode_escape").decode() for c in text)


def quoted(value: object) -> str:
    """The `repr` of a value, at most `LONGEST_VALUE` characters long.

    >>> quoted("x" * 100)[-5:]
    "x...'"
    """
    text = repr(value)
    return text if len(text) <= LONGEST_VALUE else f"{text[: LONGEST_VALUE - 4]}...{text[-1]}"


def with_article(noun: str) -> str:
    """A noun with its article.

    >>> with_article("Actuator or IdealValve")
    'an Actuator or IdealValve'
    """
    return f"a{'n' * noun.startswith(('A', 'E', 'I', 'O', 'a', 'e', 'i', 'o'))} {noun}"


def described(value: object, *, of_file: bool = False) -> str:
    """Describe a value in a message: numbers and texts are quoted, other objects are named by their class.

    A list of a file may have become a tuple (`of_file`).

        >>> described("3 bar"), described({}), described((1, 2), of_file=True)
        ("'3 bar'", 'a mapping', 'a list')
    """
    if isinstance(value, str | Number | None):
        return quoted(value)
    names: dict[type, str] = {dict: "mapping", **({tuple: "list"} if of_file else {})}
    name = names.get(type(value), type(value).__name__)
    return with_article("array" if name == "ndarray" else name)


def closest(name: str, candidates: Sequence[str]) -> str:
    """Closest known name to an unknown one, or one of which it is the beginning or end; empty if none is close.

    >>> closest("MAS10", ["DMSP-10-250", "MAS-10-180N-AA-MC-O"])
    'MAS-10-180N-AA-MC-O'
    >>> closest("encoder_resolution", ["encoder", "encoder_offset"])
    'encoder'
    """
    word, names = plain_name(name)[:LONGEST_VALUE], {plain_name(other): other for other in reversed(candidates)}
    short = len(word) < 3
    nearest = [
        *sorted((other for other in names if other.startswith(word) and not short), key=len),
        *difflib.get_close_matches(word, names, cutoff=0.8),
        *sorted((other for other in names if word.startswith(other) and len(other) > 3), key=len, reverse=True),
        *difflib.get_close_matches(word, names, cutoff=0.6),
        *(other for other in names if other.endswith(word) and not short),
    ]
    return names[nearest[0]] if nearest else ""


def no_attribute(owner: object, name: str, meant: Mapping[str, str]) -> AttributeError:
    """An error for an unknown attribute, with the call that is meant by it, or the closest public name."""
    hint = ""
    if not name.startswith("_"):  # which copy, JAX and others ask for, often
        nearest = name if name in meant else closest(name, [*meant, *(own for own in dir(owner) if own[0] != "_")])
        hint = f"; did you mean {meant.get(nearest, nearest)}?" if nearest else ""
    return AttributeError(f"{with_article(type(owner).__name__)} has no {name!r}{hint}", name=name, obj=owner)


class Suggesting:
    """Base of classes that answer an unknown attribute with the closest one, or with its meaning in `suggestions`."""

    suggestions: ClassVar[Mapping[str, str]] = {}
    """Meaning of names that users try on objects of the class; that of ``()`` is a construction without arguments."""

    if not TYPE_CHECKING:  # an unknown attribute stays an error of the type checker

        def __getattr__(self, name: str) -> object:
            if isinstance(attribute := getattr(type(self), name, None), property):
                return attribute.fget(self)  # raises its own error
            raise no_attribute(self, name, self.suggestions)


def plain_name(name: str) -> str:
    """Return a name in small letters, without hyphens, underscores and spaces."""
    return name.lower().replace("-", "").replace("_", "").replace(" ", "")


def suggest(name: str, names: Sequence[str]) -> str:
    """Remedy for an unknown name: the closest known one, or all.

    >>> suggest("dampnig", ["mass", "damping"]), suggest("x", ["mass", "damping"])
    ("did you mean 'damping'?", 'known are mass, damping')
    """
    close = closest(name, names)
    return f"did you mean {close!r}?" if close else f"known are {', '.join(names)}"


class McKibbenWarning(UserWarning):
    """Input or result that is valid but probably not intended."""

    def __init__(self, message: object) -> None:
        super().__init__(printable(str(message), 20 * _LONGEST_MESSAGE))


class ReachabilityWarning(McKibbenWarning):
    """A reference leaves the attainable set of the joint."""


class DomainWarning(McKibbenWarning):
    """A muscle was evaluated outside its domain."""


class McKibbenError(Exception):
    """Base class of all mckibben errors: a message and the offending `value` of a `field`, with its unit.

    ``str(error)`` is ``"message; remedy"``, each of limited length; `remedy` may be replaced, for example by a
    command-line option, before the error is shown.
    """

    longest = _LONGEST_MESSAGE

    def __init__(
        self,
        message: str,
        *,
        field: str = "",
        value: object = None,
        lower: float | None = None,
        upper: float | None = None,
        unit: str = "",
        remedy: str = "",
    ) -> None:
        super().__init__(message)
        self.message = message
        self.field = field
        self.value = value
        self.lower = lower
        self.upper = upper
        self.unit = unit
        self.remedy = remedy

    def __str__(self) -> str:
        message = printable(self.message, self.longest)
        return f"{message}; {printable(self.remedy, _LONGEST_MESSAGE)}" if self.remedy else message


class UnitError(McKibbenError, ValueError):
    """Text is not a quantity, or its unit has the wrong dimensions."""


class RangeError(McKibbenError, ValueError):
    """A number is outside its allowed range; of several in one object, `problems` has each."""

    problems: tuple[Problem, ...] = ()


class CallError(McKibbenError, TypeError):
    """A function or class is called with unknown, missing or surplus arguments, or with one of the wrong type."""


class NotInCatalogError(McKibbenError, KeyError):
    """The catalog has no entry of that name."""

    __str__ = McKibbenError.__str__  # KeyError would print the message quoted


class ParameterError(McKibbenError, ValueError):
    """A parameter does not exist, or cannot take the given values."""


class IdentificationError(McKibbenError, ValueError):
    """The data cannot determine the force law."""


class SimulationError(McKibbenError, ValueError):
    """A simulation cannot be run as specified."""


class UnreachableError(McKibbenError, ValueError):
    """No pressures within limits give the requested angle, torque or stiffness."""


class ExportError(McKibbenError, ValueError):
    """A model or function cannot be expressed in another language or format."""


class CompilerError(ExportError):
    """The machine's C compiler, or the program that it wrote, does not work."""


class DeviceError(McKibbenError, RuntimeError):
    """A CUDA device, its driver or its compiler is missing or fails."""


class RigError(McKibbenError, RuntimeError):
    """A test rig is missing, or cannot execute a command."""


class SilentError(RigError):
    """Expected samples did not arrive."""


class StoppedError(RigError):
    """A test was stopped and the muscle vented."""


class SignalledError(StoppedError):
    """A test was stopped by a signal, such as Ctrl-C; holds its number."""

    def __init__(self, message: str, *, signal: int) -> None:
        super().__init__(message)
        self.signal = signal


@dataclass(frozen=True, slots=True)
class Problem:
    """One mistake in a file, with its location and remedy.

    >>> print(Problem("'6' has no unit", line=4, field="valve.supply", remedy="write it like '6 bar'"))
    line 4, valve.supply: '6' has no unit; write it like '6 bar'
    """

    message: str
    line: int | None = None
    field: str = ""
    remedy: str = ""
    value: object = None
    lower: float | None = None
    upper: float | None = None
    unit: str = ""

    @classmethod
    def of(cls, error: McKibbenError, line: int | None = None, field: str = "") -> Problem:
        """Problem from a caught error at a location in a file."""
        return cls(error.message, line, field, error.remedy, error.value, error.lower, error.upper, error.unit)

    def __str__(self) -> str:
        return self.text([] if self.line is None else [self.line])

    def text(self, lines: Sequence[int]) -> str:
        """Return the problem as text, at some ascending lines of the file."""
        where = [_lines(lines)] if lines else []
        where += [self.field] if self.field else []
        message = printable(self.message, _LONGEST_MESSAGE)
        text = ": ".join([printable(", ".join(where), _LONGEST_MESSAGE), message]) if where else message
        return f"{text}; {printable(self.remedy, _LONGEST_MESSAGE)}" if self.remedy else text


_MOST_SPANS = 10


def _lines(lines: Sequence[int]) -> str:
    """Lines as text, such as "lines 3, 5-8"."""
    spans: list[list[int]] = []
    for line in lines:
        if spans and line == spans[-1][1] + 1:
            spans[-1][1] = line
        else:
            spans.append([line, line])
    texts = [str(first) if first == last else f"{first}-{last}" for first, last in spans[:_MOST_SPANS]]
    more = ", ..." if len(spans) > _MOST_SPANS else ""
    return f"line{'s' if len(lines) > 1 else ''} {', '.join(texts)}{more}"


class FileError(McKibbenError, ValueError):
    """A file cannot be used; lists all its problems in file order; repeated ones appear once, with their lines.

    >>> print(FileError("rig.csv", [Problem("'abc' is not a number", line=7, field="force_N")]))
    rig.csv: 1 problem
      line 7, force_N: 'abc' is not a number
    """

    shown = 20
    longest = 100_000  # each problem is short

    def __init__(self, source: str, problems: Sequence[Problem]) -> None:
        self.source = source
        self.problems = tuple(problems)
        count = len(self.problems)
        lines = [f"{source}: {count} problem{'s' if count != 1 else ''}"]
        groups: dict[object, list[Problem]] = {}
        for problem in self.problems:
            alike = (problem.field, problem.message, problem.remedy)
            groups.setdefault(alike if problem.line is not None else id(problem), []).append(problem)
        listed = list(groups.values())[: self.shown]
        lines += [
            f"  {group[0].text([problem.line for problem in group if problem.line is not None])}" for group in listed
        ]
        if more := count - sum(map(len, listed)):
            lines.append(f"  ... and {more} more")
        super().__init__("\n".join(lines))

    def __reduce__(self) -> tuple[type[FileError], tuple[str, tuple[Problem, ...]]]:
        return type(self), (self.source, self.problems)


class DatasetError(FileError):
    """A file of measurements cannot be read."""


class ScenarioError(FileError):
    """A scenario, suite, protocol, fit or calibration file cannot be read."""


def refuse_problems(what: str, problems: Sequence[Problem]) -> None:
    """Raise a `RangeError` that lists all problems of `what`, if any; field, value and limits are from the first."""
    if problems:
        heading = f"{what}: {len(problems)} problem{'s' if len(problems) != 1 else ''}"
        text, first = "\n  ".join([heading, *map(str, problems)]), problems[0]
        limits = ("field", "value", "lower", "upper", "unit")
        error = RangeError(text, **{name: getattr(first, name) for name in limits})
        error.problems = tuple(problems)
        raise error
