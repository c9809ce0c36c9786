"""A scenario's text with other numbers in it, all the rest as it was written."""

from __future__ import annotations

import os
from collections.abc import Mapping

from mckibben.errors import ScenarioError
from mckibben.study.parameters.address import find_all
from mckibben.study.parameters.lanes import with_values
from mckibben.study.parameters.spans import spans
from mckibben.study.parameters.survey import Place
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
    changed = text
    for address, value in zip(find_all(scenario, values), values.values(), strict=True):
        changed = _changed(changed, address.place, address.write(value))
    return changed if _reads_as(changed, wanted, folder) else wanted.dumps(folder=folder)


def _changed(text: str, place: Place, written: str) -> str:
    """The text with one number in it, in place of what stood there or added."""
    found = spans(text)
    *parent, key = place
    here, around = found.get(place), found.get(tuple(parent))
    if here is not None:
        return text[: here.start] + written + text[here.end :]
    if around is None:
        return _changed(text, tuple(parent), f"{{{key}: {written}}}")
    if around.mapping:
        return _added(text, tuple(parent), f"{key}: {written}")
    if key != "constant":  # the name alone stands for `from`
        written = f"{{from: {text[around.start : around.end]}, {key}: {written}}}"
    return text[: around.start] + written + text[around.end :]


def _added(text: str, place: Place, entry: str) -> str:
    """The text with another entry at the end of a mapping."""
    mapping = spans(text)[place]
    before, after = text[: mapping.end], text[mapping.end :]
    if mapping.flow:
        return f"{before}{entry if mapping.start == mapping.end else f', {entry}'}{after}"
    line = f"{' ' * mapping.column}{entry}"
    newline = "\r\n" if "\r\n" in text else "\n"
    if before.endswith("\n"):  # a block of text ends with its line
        return f"{before}{line}{newline}{after}"
    rest, ends, following = after.partition(newline)
    return f"{before}{rest}{newline}{line}{ends}{following}"


def _reads_as(text: str, wanted: Scenario, folder: str | os.PathLike[str]) -> bool:
    try:
        return Scenario.parse(text, folder=folder) == wanted
    except ScenarioError:
        return False
