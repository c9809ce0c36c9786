"""Scenario files with other parameter values, edited in place."""

from __future__ import annotations

import os
from collections.abc import Mapping

from mckibben.config.document import edit_yaml
from mckibben.errors import ScenarioError
from mckibben.study.parameters.addresses import find_all
from mckibben.study.parameters.values import with_values
from mckibben.study.scenario import Scenario


def rewritten(text: str, values: Mapping[str, float | int], *, folder: str | os.PathLike[str] = ".") -> str:
    """The text of a scenario with other numbers; comments, order and layout stay.

    A number that was not written is added to its mapping. Numbers come in the units of `Scenario.dumps`, with all the
    digits that it takes to read them back to the last bit; round them before if fewer will do.

    Parameters
    ----------
    text
        Of a scenario.
    values
        In SI, by name.
    folder
        To which paths in the text are relative.

    Returns
    -------
    text
        Which reads as `with_values` of the scenario. Where YAML's stranger forms defeat the change in place, the
        scenario is written anew, without its comments.

    Raises
    ------
    ScenarioError
        If the text is no scenario.
    ParameterError
        As for `with_values`.

    Examples
    --------
    >>> from pathlib import Path
    >>> text = Path("examples/pre-contracted-step-pid.yaml").read_text()
    >>> changed = rewritten(text, {"load.damping": 0.1, "valve.time_constant": 0.03})
    >>> for before, after in zip(text.splitlines(), changed.splitlines()):
    ...     if before != after:
    ...         print(after)
    load: {from: knee-table-2, damping: 0.1 N*m*s/rad}            # or, with a heavier weight, ...
    valve: {time_constant: 30 ms}   # or ideal: the pressure is what is commanded, at once
    """
    scenario = Scenario.parse(text, folder=folder)
    wanted = with_values(scenario, values)
    numbers = zip(find_all(scenario, values), values.values(), strict=True)
    changed = edit_yaml(text, {address.place: address.write(value) for address, value in numbers})
    return changed if _reads_as(changed, wanted, folder) else wanted.dumps(folder=folder)


def _reads_as(text: str, wanted: Scenario, folder: str | os.PathLike[str]) -> bool:
    try:
        return Scenario.parse(text, folder=folder) == wanted
    except ScenarioError:
        return False
