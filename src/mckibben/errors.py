"""Every error that mckibben raises on purpose: it says what was wrong, where, and what to do."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass


class McKibbenWarning(UserWarning):
    """Something is legal and probably not meant; the text says why."""


class ReachabilityWarning(McKibbenWarning):
    """A reference asks for what the joint cannot hold; the text says when and by how much."""


class DomainWarning(McKibbenWarning):
    """A muscle was asked for its force outside its domain; the text says where, and what the domain is."""


class McKibbenError(Exception):
    """The root of the family.

    Parameters
    ----------
    message
        What was wrong, and where.
    value, lower, upper
        The offending value and the range it should lie in, in `unit`, where there is one.
    unit
        The unit in which they are given.
    remedy
        What to do about it; printed after the message.
    """

    def __init__(
        self,
        message: str,
        *,
        value: object = None,
        lower: float | None = None,
        upper: float | None = None,
        unit: str = "",
        remedy: str = "",
    ) -> None:
        super().__init__(f"{message}; {remedy}" if remedy else message)
        self.value = value
        self.lower = lower
        self.upper = upper
        self.unit = unit
        self.remedy = remedy


class UnitError(McKibbenError, ValueError):
    """A text is no quantity, or one of the wrong kind."""


class RangeError(McKibbenError, ValueError):
    """A number lies outside the range in which it has a meaning."""


class NotInCatalogError(McKibbenError, KeyError):
    """The catalog has no entry of that name."""

    __str__ = Exception.__str__  # KeyError would print the message quoted


class ParameterError(McKibbenError, ValueError):
    """There is no parameter of that name, or it cannot take such values."""


class IdentificationError(McKibbenError, ValueError):
    """The data cannot determine the law."""


class SimulationError(McKibbenError, ValueError):
    """A simulation was asked for that cannot be run."""


class UnreachableError(McKibbenError, ValueError):
    """No pressures within limits give what was asked of a joint."""


class RigError(McKibbenError, RuntimeError):
    """A test rig cannot do what it was told, or is not there."""


class SilentError(RigError):
    """Samples that were due did not come."""


class StoppedError(RigError):
    """A test was stopped and the muscle vented; the text says why."""


class SignalledError(StoppedError):
    """A test was stopped by a signal, such as Ctrl-C.

    Parameters
    ----------
    message
        As of a `McKibbenError`.
    signal
        Its number.
    """

    def __init__(self, message: str, *, signal: int) -> None:
        super().__init__(message)
        self.signal = signal


@dataclass(frozen=True, slots=True)
class Problem:
    """One thing that is wrong in a file."""

    message: str
    line: int | None = None
    field: str = ""
    remedy: str = ""

    def __str__(self) -> str:
        where = [f"line {self.line}"] if self.line is not None else []
        where += [self.field] if self.field else []
        text = ": ".join([", ".join(where), self.message]) if where else self.message
        return f"{text}; {self.remedy}" if self.remedy else text


class FileError(McKibbenError, ValueError):
    """A file cannot be used. All its problems are listed at once.

    Parameters
    ----------
    source
        The file's name.
    problems
        What is wrong with it, in the order of the file.

    Examples
    --------
    >>> print(FileError("rig.csv", [Problem("'abc' is not a number", line=7, field="force_N")]))
    rig.csv: 1 problem
      line 7, force_N: 'abc' is not a number
    """

    shown = 20

    def __init__(self, source: str, problems: Sequence[Problem]) -> None:
        self.source = source
        self.problems = tuple(problems)
        count = len(self.problems)
        lines = [f"{source}: {count} problem{'s' if count != 1 else ''}"]
        lines += [f"  {problem}" for problem in self.problems[: self.shown]]
        if count > self.shown:
            lines.append(f"  ... and {count - self.shown} more")
        super().__init__("\n".join(lines))

    def __reduce__(self) -> tuple[type[FileError], tuple[str, tuple[Problem, ...]]]:
        return type(self), (self.source, self.problems)


class DatasetError(FileError):
    """A file of measurements cannot be read."""


class ScenarioError(FileError):
    """A scenario, fit or catalog file cannot be read."""
