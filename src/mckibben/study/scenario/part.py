"""What all parts of a scenario share: a frozen model, and how a validator says what is wrong."""

from __future__ import annotations

import difflib
from collections.abc import Sequence
from typing import Any, NoReturn

from pydantic import BaseModel, ConfigDict
from pydantic_core import PydanticCustomError

LONGEST = 80
"""Characters of a value that are shown, and that a quantity may have."""


class Part(BaseModel):
    """A part of a scenario: frozen, without unknown keys."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)


def given_fields(part: Part | None, *without: str) -> dict[str, Any]:
    """The fields that were given, by name; what was not takes the default of the class that is built."""
    if part is None:
        return {}
    return {
        name: getattr(part, name)
        for name in type(part).model_fields
        if name not in without and getattr(part, name) is not None
    }


def refuse(message: str, remedy: str = "", *, parent: bool = False) -> NoReturn:
    """Say in a validator what is wrong; with `parent` it is said of the part that the field belongs to."""
    context = {"message": message, "remedy": remedy, "parent": parent}
    raise PydanticCustomError("mckibben", "{message}; {remedy}" if remedy else "{message}", context)


def quoted(value: object) -> str:
    """A value as an error shows it, on one line and not too long."""
    text = repr(value)
    return text if len(text) <= LONGEST else f"{text[: LONGEST - 4]}...{text[-1]}"


def suggest(name: str, known: Sequence[str]) -> str:
    """A remedy for an unknown name.

    >>> suggest("sin", ["step", "sine"])
    "did you mean 'sine'?"
    """
    close = difflib.get_close_matches(name[:LONGEST], known, 1, cutoff=0.6)
    return f"did you mean {close[0]!r}?" if close else f"known are {', '.join(known)}"
