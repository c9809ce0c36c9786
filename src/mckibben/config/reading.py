"""Configuration files to models, and validation errors with file, line and field."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any, TypeVar, get_args, get_origin

from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

from mckibben.config.document import LONGEST_TEXT, Document, Place, dotted, read_document
from mckibben.config.fields import Part, Quantity, quoted, suggest
from mckibben.errors import Problem, ScenarioError


def problems_of(error: ValidationError, document: Document, model: type[BaseModel]) -> list[Problem]:
    """Each of the errors once, in the order of the file.

    A key that is missing only because it is misspelt is not said twice, nor anything about a value that the document
    has refused already.
    """
    details = error.errors(include_url=False)
    misspelt = {
        (*found["loc"][:-1], close)
        for found in details
        if found["type"] == "extra_forbidden"
        for close in _close_keys(found["loc"], document, model)
    }
    problems = []
    for found in details:
        place = tuple(found["loc"])
        if any(place[: len(refused)] == refused for refused in document.refused):
            continue
        if found["type"] == "missing" and place in misspelt:
            continue
        if found.get("ctx", {}).get("parent") and any(key[:-1] == place[:-1] for key in misspelt):
            continue  # what the part seems to lack is probably the key that is misspelt
        problems.append(_problem(found, place, document, model))
    return sorted([*document.problems, *problems], key=lambda problem: problem.line or 0)


def _problem(found: ErrorDetails, place: Place, document: Document, model: type[BaseModel]) -> Problem:
    kind, value, context = found["type"], found["input"], found.get("ctx", {})
    message, remedy = found["msg"], ""
    if kind == "mckibben":
        message, remedy = context["message"], context["remedy"]
        place = place[:-1] if context["parent"] else place
        while place not in document.lines and place:  # a name alone stands for `from`, a quantity for `constant`
            place = place[:-1]
    elif kind == "missing":
        message, remedy = "is missing", f"add it{_example(place, model)}"
    elif kind == "extra_forbidden":
        message, remedy = "is no key of a scenario here", suggest(str(place[-1]), _free_keys(place, document, model))
        if str(place[-1])[:1].isdigit() and value == "":
            message, remedy = "is what follows a comma", "write decimals with a point"
    elif value in ("", None):
        message, remedy = "has no value", "write one, or leave the key out"
    elif kind == "model_type":
        message = f"{quoted(value) if isinstance(value, str) else 'a list'} stands where keys and values belong"
        remedy = f"give a mapping of {', '.join(_keys(place, model))}"
    elif kind == "dict_type":
        message = f"{quoted(value) if isinstance(value, str) else 'a list'} stands where names and parts belong"
        remedy = "give a mapping, each part under a name of its own"
    elif kind == "tuple_type":
        message = f"{quoted(value) if isinstance(value, str) else 'a mapping'} stands where a list belongs"
        remedy = "write [first, second, ...]"
    elif kind == "too_long":
        message = f"has {context['actual_length']} items, more than {context['max_length']}"
        remedy = "put them in a CSV file (samples: {file: wish.csv})"
    elif kind == "too_short":
        message, remedy = "is empty", "give at least one"
    return Problem(message, document.line(place), dotted(place), remedy)


def _example(place: Place, model: type[BaseModel]) -> str:
    parent = _model_at(place[:-1], model)
    if parent is None:
        return ""
    for name, info in parent.model_fields.items():
        if (info.alias or name) == place[-1]:
            if info.examples:
                return f", such as `{place[-1]}: {info.examples[0]}`"
            marks = [mark for mark in info.metadata if isinstance(mark, Quantity)]
            if marks:
                return f", such as `{place[-1]}: {marks[0].example.strip(chr(39))}`"
            inner = _model_in(info.annotation)
            return f", a mapping of {', '.join(_keys((), inner))}" if inner else ""
    return ""


def _close_keys(place: Place, document: Document, model: type[BaseModel]) -> list[str]:
    """The keys that a misspelt one may stand for."""
    keys = _free_keys(place, document, model)
    remedy = suggest(str(place[-1]), keys)
    return [key for key in keys if remedy == f"did you mean {key!r}?"]


def _free_keys(place: Place, document: Document, model: type[BaseModel]) -> list[str]:
    """The keys that could stand in place of an unknown one: those not given yet, or all if all are."""
    keys = _keys(place[:-1], model)
    return [key for key in keys if (*place[:-1], key) not in document.lines] or keys


def _keys(place: Place, model: type[BaseModel]) -> list[str]:
    found = _model_at(place, model)
    return [info.alias or name for name, info in found.model_fields.items()] if found else []


def _model_at(place: Place, model: type[BaseModel]) -> type[BaseModel] | None:
    """The model that validates what stands at a place."""
    annotation: Any = model
    for key in place:
        if isinstance(key, int):  # an item of a list of models
            continue
        if get_origin(annotation) is dict:  # of parts, by names that people choose
            annotation = get_args(annotation)[1]
            continue
        found = _model_in(annotation)
        fields = {info.alias or name: info for name, info in found.model_fields.items()} if found else {}
        if key not in fields:
            return None
        annotation = fields[str(key)].annotation
    return None if get_origin(annotation) is dict else _model_in(annotation)


def _model_in(annotation: Any) -> type[BaseModel] | None:
    """The model in an annotation such as ``Model | None`` or ``tuple[Model, ...]``."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    return next(filter(None, map(_model_in, get_args(annotation))), None)


P = TypeVar("P", bound=Part)


def text_of(path: str | os.PathLike[str], what: str = "a scenario", example: str = "examples/") -> str:
    """The text of a file.

    Parameters
    ----------
    path
        Of the file.
    what, example
        What it should be, in words, and where such a one is: for the error.

    Raises
    ------
    ScenarioError
        If it cannot be read, or is no text.
    """
    source = os.fspath(path)
    try:
        with Path(path).open("rb") as file:
            content = file.read(4 * LONGEST_TEXT + 1)
        return content.decode("utf-8-sig")
    except UnicodeDecodeError:
        raise ScenarioError(source, [Problem("is not text in UTF-8", remedy="give a YAML file")]) from None
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        problem = Problem(f"cannot be read: {reason}", remedy=f"give the path of {what}, see {example}")
        raise ScenarioError(source, [problem]) from None


def parsed(kind: type[P], text: str, *, source: str, folder: str | os.PathLike[str] = ".") -> tuple[P, Document]:
    """A part from YAML with units, and the document with its lines.

    Parameters
    ----------
    kind
        Which part.
    text, source, folder
        The text, what errors call it, and the folder to which paths in it are relative.

    Raises
    ------
    ScenarioError
        With every problem of the text.
    """
    document = read_document(text)
    if not document.readable:
        raise ScenarioError(source, document.problems)
    try:
        part = kind.model_validate(document.data, context={"folder": Path(folder)})
    except ValidationError as error:
        raise ScenarioError(source, problems_of(error, document, kind)) from None
    if document.problems:
        raise ScenarioError(source, document.problems)
    return part, document
