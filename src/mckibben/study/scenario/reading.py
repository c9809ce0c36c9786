"""From a file, or its text, to a checked part: of scenarios, and of all files that are written like them."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TypeVar

from pydantic import ValidationError

from mckibben.errors import Problem, ScenarioError
from mckibben.study.scenario.document import LONGEST, Document, read_document
from mckibben.study.scenario.part import Part
from mckibben.study.scenario.problems import problems_of

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
            content = file.read(4 * LONGEST + 1)
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
