"""Values put into the parts of a scenario: checked as if they stood in the file, or as they are."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeVar

from pydantic import ValidationError

from mckibben.errors import ParameterError
from mckibben.study.parameters.survey import Place, fields_of
from mckibben.study.scenario.document import dotted
from mckibben.study.scenario.part import Part

P = TypeVar("P", bound=Part)


def validated(part: P, values: Mapping[Place, Any], place: Place = ()) -> P:
    """The part with values in it, checked as if it were read; parts within it that keep their numbers are not.

    Parameters
    ----------
    part
        Of a scenario, or all of it.
    values
        Plain numbers in SI, by their keys within the part.
    place
        Of the part in the file, for errors.

    Raises
    ------
    ParameterError
        If the part does not allow the values; it says which and why.
    """
    if not values:
        return part
    fields = {key: value for key, _, value in fields_of(part)}
    for key, inner in _by_first_key(values).items():
        fields[key] = inner[()] if () in inner else validated(fields[key], inner, (*place, key))
    try:
        return type(part).model_validate(fields)
    except ValidationError as error:
        raise _explained(error, place) from None


def replaced(part: P, values: Mapping[Place, Any]) -> P:
    """The part with values in it, whatever they are."""
    if not values:
        return part
    names = {info.alias or name: name for name, info in type(part).model_fields.items()}
    update = {}
    for key, inner in _by_first_key(values).items():
        name = names[key]
        update[name] = inner[()] if () in inner else replaced(getattr(part, name), inner)
    return part.model_copy(update=update)


def part_at(part: Part, place: Place) -> Part:
    """The part at a place within a part."""
    for key in place:
        part = next(value for name, _, value in fields_of(part) if name == key)
    return part


def _by_first_key(values: Mapping[Place, Any]) -> dict[str, dict[Place, Any]]:
    groups: dict[str, dict[Place, Any]] = {}
    for (first, *rest), value in values.items():
        groups.setdefault(first, {})[tuple(rest)] = value
    return groups


def _explained(error: ValidationError, place: Place) -> ParameterError:
    first = error.errors(include_url=False)[0]
    context = first.get("ctx", {})
    where = (*place, *first["loc"])
    if context.get("parent"):
        where = where[:-1]
    message, remedy = context.get("message", first["msg"]), context.get("remedy", "")
    return ParameterError(f"{dotted(where)} {message}", value=first["input"], remedy=remedy)
