"""Forms from the schema of components: a field for each number, with its unit, range and meaning."""

from __future__ import annotations

import functools
import inspect
import math
import re
from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeAlias, get_args

from nicegui import events, ui

from mckibben.component.schema import field_types
from mckibben.config.model import fields_by_key
from mckibben.scenario import ScenarioParameter, StudiedScenario
from mckibben.scenario.parameters import Mark
from mckibben.units import BoundedInt, factor, quantity
from mckibben.web.layout import NumberField

Value: TypeAlias = float | list[float]
"""Number or numbers of a field [SI]."""

_SECTION = re.compile(r"\n(?:Attributes|Parameters)\n-+\n")
_ENTRY = re.compile(r"^(\w+(?:, \w+)*)\n((?: {4}.+\n?)+)", re.MULTILINE)


@functools.cache
def descriptions(kind: type) -> dict[str, str]:
    """Descriptions of the fields of a class by name, from its docstring and those of its bases.

    >>> from mckibben.control import PID
    >>> descriptions(PID)["filter_time"][:20]
    'Time constants [s] o'
    """
    found: dict[str, str] = {}
    for base in reversed(kind.__mro__):
        for section in _SECTION.split(inspect.cleandoc(base.__doc__ or ""))[1:]:
            for names, words in _ENTRY.findall(section):
                found |= dict.fromkeys(names.split(", "), " ".join(words.replace("`", "").split()))
    return found


def meaning(scenario: StudiedScenario, parameter: ScenarioParameter) -> str:
    """Description of a parameter from the docstring of its component; empty without one."""
    (first, *others), owner = parameter.places[0], scenario
    part: Any = getattr(owner, fields_by_key(type(owner)).get(first, first))
    for key in others[:-1]:
        is_item = isinstance(part, tuple | dict)
        part = part[int(key) if isinstance(part, tuple) else key] if is_item else getattr(part, key)
    return descriptions(type(part)).get(parameter.places[0][-1], "")


def number(label: str, mark: Mark, value: float, changed: Callable[[float], object], words: str = "") -> NumberField:
    """A field for a number, in the unit of files.

    Parameters
    ----------
    label, words
        Text in the field, and meaning, which its tooltip tells.
    mark
        Unit and range.
    value
        First number [SI].
    changed
        Called with each new number [SI].
    """
    whole = isinstance(mark, BoundedInt)
    scale, unit = 1.0 if whole else factor(mark.shown), "" if mark.shown == "1" else mark.shown

    def si(shown: float) -> float:
        return int(shown) if whole and float(shown).is_integer() else shown * scale

    allowed = f"{'a whole number, ' if whole else ''}{mark.range}"
    element = NumberField(
        label,
        float(f"{value / scale:.10g}"),
        lambda shown: mark.holds(si(float(shown))),
        allowed,
        lambda shown: changed(si(float(shown))),
        step=float(f"{abs(value / scale) / 20:.0e}") or 0.1,  # a twentieth, of one digit
        words=words,
    )
    element.props(f'dense debounce=400 suffix="{unit}"').classes("w-full")
    return element


def section_form(kind: type, values: Mapping[str, Any], put: Callable[[str, Mark, Value], object]) -> list[NumberField]:
    """Fields for the numbers and the lists of numbers that a class declares; those of numbers are returned.

    Parameters
    ----------
    kind
        Class whose fields have unit and range.
    values
        Present values [SI], or texts with a unit; of others, the default of the class. An unset one has no field.
    put
        Called with name, mark and new value [SI].
    """
    words, elements = descriptions(kind), []
    for name, form in field_types(kind).items():
        marks = (*getattr(form, "__metadata__", ()), *getattr(next(iter(get_args(form)), None), "__metadata__", ()))
        mark = next((mark for mark in marks if isinstance(mark, Mark)), None)
        value, label = values.get(name, getattr(kind, name, None)), name.replace("_", " ")
        if mark is None or value is None or value == math.inf:
            continue
        changed, help_ = functools.partial(put, name, mark), words.get(name, "")
        if isinstance(value, list | tuple):
            _list(label, mark, [_si(item, mark) for item in value], changed, help_)
        else:
            elements.append(number(label, mark, _si(value, mark), changed, help_))
            elements[-1].mark(name)
    return elements


def _si(value: str | float, mark: Mark) -> float:
    return quantity(value, mark.unit) if isinstance(value, str) else value


def _list(label: str, mark: Mark, values: Sequence[float], changed: Callable[[Value], object], words: str) -> None:
    """A field for numbers with a comma between them, such as pressures."""

    def refused(text: str | None) -> str | None:
        try:
            held = [mark.holds(float(part) * factor(mark.shown)) for part in (text or "").split(",")]
        except ValueError:
            held = [False]
        return None if all(held) else f"give numbers, {mark.range}"

    def take(event: events.ValueChangeEventArguments) -> None:
        if refused(event.value) is None:
            changed([float(part) * factor(mark.shown) for part in event.value.split(",")])

    shown = ", ".join(f"{value / factor(mark.shown):g}" for value in values)
    element = ui.input(label, value=shown, validation=refused, on_change=take).classes("w-full wide").tooltip(words)
    element.props(f'dense debounce=400 suffix="{mark.shown}" hide-bottom-space').mark(label)
