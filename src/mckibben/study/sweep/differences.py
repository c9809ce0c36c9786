"""How two manifests differ, in words."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from itertools import zip_longest
from typing import Any

from mckibben.errors import Problem

_SAME = "give the same again, or choose another folder"
_LEFT_OUT = "leave it out to take what the sweep was begun with, or choose another folder"


def differences(begun: Mapping[str, Any], now: Mapping[str, Any]) -> list[Problem]:
    """What a sweep was begun with that it is not to go on with; where the scenario came from does not count.

    >>> for problem in differences({"seed": 1, "design": "sobol"}, {"seed": 2, "design": "sobol"}):
    ...     print(problem.field, problem.message, sep=": ")
    seed: the sweep was begun with 1, not 2
    """
    found = list(_found(begun, now))
    # The values follow from the rest: they are news only where the rest is the same.
    return found if found else list(_consequences(begun, now))


def _found(begun: Mapping[str, Any], now: Mapping[str, Any]) -> Iterator[Problem]:
    for name, value in now.items():
        before = begun.get(name)
        if name in ("source", "values", "model") or before == value:
            continue
        if name == "scenario":
            yield _first_line(str(before), value)
        elif name == "over":
            for one, other in zip_longest(before if isinstance(before, list) else [], value):
                if one != other:
                    yield Problem(_begun_over(one, other), field="over", remedy=_LEFT_OUT)
        elif name == "software":
            before = before if isinstance(before, Mapping) else {}
            for part, version in value.items():
                if before.get(part) != version:
                    remedy = "go on where it was begun, or begin anew in another folder"
                    yield Problem(_begun(before.get(part), version), field=part, remedy=remedy)
        else:
            yield Problem(_begun(_said(before), _said(value)), field=name, remedy=_LEFT_OUT)


def _consequences(begun: Mapping[str, Any], now: Mapping[str, Any]) -> Iterator[Problem]:
    remedy = "begin anew in another folder"
    if begun.get("values") != now.get("values"):
        yield Problem(
            "the same design gives other values here: another SciPy or processor", field="over", remedy=remedy
        )
    if begun.get("model") != now.get("model"):
        yield Problem("a file that it names has changed since, or the catalog", field="scenario", remedy=remedy)


def _first_line(before: str, now: str) -> Problem:
    for old, new in zip_longest(before.splitlines(), now.splitlines()):
        if old != new:
            told = [None if line is None else repr(line.strip()) for line in (old, new)]
            return Problem(_begun_over(*told), field="scenario", remedy=_SAME)
    return Problem("it is another", field="scenario", remedy=_SAME)


def _begun_over(before: str | None, now: str | None) -> str:
    """The same where one of them may not be there at all."""
    if before is None:
        return f"the sweep was begun without {now}"
    return f"the sweep was begun with {before} too" if now is None else _begun(before, now)


def _begun(before: object, now: object) -> str:
    return f"the sweep was begun with {before}, not {now}"


def _said(value: object) -> object:
    return ", ".join(map(str, value)) if isinstance(value, list) else value
