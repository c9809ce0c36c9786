"""Files of calibrations: a JSON object of them, by the names of their channels."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from mckibben.errors import McKibbenError, Problem, ScenarioError
from mckibben.rig.calibration import Calibration


def content_of(path: Path, remedy: str) -> Mapping[str, Any]:
    """What a file of calibrations holds, by the names of the channels.

    Parameters
    ----------
    path
        Of the file.
    remedy
        What to do where it holds something else.

    Raises
    ------
    ScenarioError
        If it cannot be read, or is no JSON object.
    """
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise ScenarioError(str(path), [Problem(f"cannot be read as JSON: {error}")]) from None
    if not isinstance(content, dict):
        raise ScenarioError(str(path), [Problem("is no mapping of calibrations", remedy=remedy)])
    return content


def calibrations_in(content: Mapping[str, Any]) -> tuple[dict[str, Calibration], list[Problem]]:
    """The calibrations that can be read, and what is wrong with the others."""
    found: dict[str, Calibration] = {}
    problems: list[Problem] = []
    for name, form in content.items():
        try:
            found[name] = Calibration.from_json(form)
        except (McKibbenError, TypeError, AttributeError) as error:
            problems.append(Problem(str(error), field=name))
    return found, problems
