"""Scenarios with other parameter values, one or a batch, and the rules that they obey."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from typing import Any, Literal, NamedTuple, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import ValidationError

from mckibben.config.document import dotted
from mckibben.config.fields import Part
from mckibben.errors import ParameterError, RangeError
from mckibben.study.parameters.parameter import Place, ScenarioParameter, fields_of, find_parameters
from mckibben.study.scenario import Scenario
from mckibben.study.scenario.controller import BelievingSpec

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


_Attempt = Callable[[Sequence[Any]], str | None]
"""Says of values, one for each number, why they are not allowed."""


class Refusal(NamedTuple):
    """Why a row is not allowed, and the numbers whose values it is about."""

    addresses: tuple[ScenarioParameter, ...]
    reason: str


def refusals(scenario: Scenario, columns: Mapping[ScenarioParameter, NDArray]) -> dict[int, Refusal]:
    """Why rows of a table are not allowed: by row, in order.

    Parameters
    ----------
    scenario
        Into which the values are to be put.
    columns
        Of one length, each in the range of its field.
    """
    groups: dict[Place, list[ScenarioParameter]] = {}
    for address in columns:
        groups.setdefault(_part_of(address.place), []).append(address)
    found: dict[int, Refusal] = {}
    for place, group in groups.items():
        attempt = _attempt(scenario, place, [address.place[len(place) :] for address in group])
        table = [columns[address] for address in group]
        for row, reason in _search(attempt, table, np.arange(len(table[0]))).items():
            found.setdefault(row, Refusal(tuple(group), reason))
    return dict(sorted(found.items()))


def _part_of(place: Place) -> Place:
    """The part within which a number has to do with others."""
    return place[:2] if len(place) > 2 and place[0] in ("controller", "reference") else place[:1]


def _attempt(scenario: Scenario, place: Place, keys: list[Place]) -> _Attempt:
    """What says of values why the part does not allow them; None where it does."""
    part = part_at(scenario, place)
    build = _builder(place)

    def attempt(values: Sequence[Any]) -> str | None:
        try:
            build(validated(part, dict(zip(keys, values, strict=True)), place))
        except (ParameterError, RangeError) as error:
            return str(error)
        return None

    return attempt


def _builder(place: Place) -> Callable[[Any], object]:
    """What makes of a part the object whose constructor has rules of its own."""
    from mckibben.study.scenario import building

    match place:
        case ("load",):
            return building.build_load
        case ("valve",):
            return building.build_valve
        case ("joint",) | ("controller", "model"):
            return lambda spec: (building.build_geometry(spec), building.build_tendon(spec.spring))
        case ("controller", "decoupling"):
            return lambda spec: (building.decoupling_parts(spec), _beliefs(spec))
        case ("controller", "predictive"):
            return lambda spec: (building.observers(spec), _beliefs(spec))
        case ("controller", "inverse_model"):
            return lambda spec: spec.load and building.build_load(spec.load)
        case ("controller", _):
            return building.build_loop
        case ("reference", quantity):
            return lambda spec: building.build_signal(spec, quantity)
        case _:
            return _nothing


def _beliefs(spec: BelievingSpec) -> tuple[object, ...]:
    """What a controller by a model believes, and what corrects it."""
    from mckibben.study.scenario import building

    return spec.load and building.build_load(spec.load), building.build_adaptation(spec.adaptation)


def _nothing(_: Part) -> None:
    """A start is made by the plant."""


def _search(attempt: _Attempt, table: Sequence[NDArray], rows: NDArray[np.int64]) -> dict[int, str]:
    """The rows that are refused, and why, without a look at each of them.

    Each rule compares sums and products of numbers, or their signs: away from zero it is the stricter the further a
    number goes one way. So where all corners of the box around some rows are allowed, its inside is, too; where not,
    the rows are halved.
    """
    ends = [_ends(column[rows]) for column in table]
    corners = math.prod(len(each) for each in ends)
    if corners > 1 and corners >= len(rows):
        tried = {row: attempt([column[row].item() for column in table]) for row in rows.tolist()}
        return {row: reason for row, reason in tried.items() if reason is not None}
    refused = next(filter(None, map(attempt, itertools.product(*ends))), None)
    if refused is None:
        return {}
    if corners == 1:
        return dict.fromkeys(rows.tolist(), refused)
    widths = [np.ptp(column[rows]) / max(np.ptp(column), 1e-300) for column in table]
    widest = table[int(np.argmax(widths))]
    ordered = rows[np.argsort(widest[rows], kind="stable")]
    return {
        **_search(attempt, table, ordered[: len(rows) // 2]),
        **_search(attempt, table, ordered[len(rows) // 2 :]),
    }


def _ends(column: NDArray) -> list[Any]:
    """The lowest and highest of the numbers below, at and above zero."""
    signs = [column[column < 0], column[column == 0], column[column > 0]]
    return sorted({end.item() for part in signs if part.size for end in (part.min(), part.max())})


Known = Collection[str] | Literal["all"]
"""Numbers of the plant, by name, that the controller's model follows when they vary."""

_PLANT = ("joint", "load", "valve")


def with_values(scenario: Scenario, values: Mapping[str, float | int], *, known: Known = "all") -> Scenario:
    """The scenario with other numbers, checked as if they stood in its file.

    Parameters
    ----------
    scenario
        Which stays as it is.
    values
        In SI, by name.
    known
        As for `batched`; all unless given, as in a file.

    Raises
    ------
    ParameterError
        If a name is unknown or there twice, or a value is none for its number.

    Examples
    --------
    >>> scenario = Scenario.read("examples/pre-contracted-step-pid.yaml")
    >>> with_values(scenario, {"load.m2": 0.8}).plant().load.mass2
    0.8
    """
    columns = {address: _column(address, [value]) for address, value in zip(*_named(scenario, values), strict=True)}
    _check_rules(scenario, columns)
    numbers = {address: column[0].item() for address, column in columns.items()}
    fixed = _with_fixed_model(scenario, numbers, known)
    return validated(fixed, {address.place: value for address, value in numbers.items()})


def batched(scenario: Scenario, table: Mapping[str, ArrayLike], *, known: Known = ()) -> Scenario:
    """Many scenarios in one: arrays stand in place of some of its numbers, one element a lane.

    What is built from it (`plant`, `control`, `reference`) has NumPy arrays of shape (n,) among its leaves where a
    number is varied, and what it always has where it is not. Such a scenario can be neither written nor compared.

    Where the controller takes its model of joint, load and valves from the plant, it is that of `scenario` in all
    lanes, whatever numbers of the plant vary.

    Parameters
    ----------
    scenario
        Which stays as it is.
    table
        Values in SI by name, columns of one length n.
    known
        Names of numbers of the plant whose values the controller knows, "all" for all of them: its model varies with
        them wherever it takes them from the plant.

    Raises
    ------
    ParameterError
        If a name is unknown or there twice, or a row has a value, or a combination of values, that the scenario does
        not allow; it names the first such row.

    Examples
    --------
    >>> scenario = Scenario.read("examples/pre-contracted-step-pid.yaml")
    >>> load = batched(scenario, {"load.mass2": [0.5, 0.8]}).plant().load
    >>> load.mass2, load.mass1
    (array([0.5, 0.8]), 0.5)
    >>> load.total_inertia.round(6)
    array([0.045, 0.057])
    >>> batched(scenario, {"joint.connector_length": [0.2, 0.38]})
    Traceback (most recent call last):
        ...
    mckibben.errors.ParameterError: row 1: with joint.connector_length 380 mm: ...
    """
    columns = _columns(scenario, table)
    _check_rules(scenario, columns)
    fixed = _with_fixed_model(scenario, columns, known)
    return replaced(fixed, {address.place: column for address, column in columns.items()})


def known_names(scenario: Scenario, known: Known, varied: Iterable[str]) -> tuple[str, ...]:
    """Canonical names of the numbers that vary in the plant and in the controller's model alike.

    Parameters
    ----------
    scenario
        Whose controller it is.
    known
        As for `batched`.
    varied
        Names of all numbers that vary.

    Raises
    ------
    ParameterError
        If a known number does not vary, or the controller does not take it from the plant.

    Examples
    --------
    >>> scenario = Scenario.read("examples/pre-contracted-step-pid.yaml")
    >>> known_names(scenario, "all", ["load.m2", "joint.connector_length"])
    ('joint.connector_length',)
    """
    followed = {address.name: _follows(scenario, address) for address in find_parameters(scenario, varied)}
    if known == "all":
        return tuple(name for name, follows in followed.items() if follows)
    names = tuple(address.name for address in find_parameters(scenario, known))
    for name in names:
        if name not in followed:
            raise ParameterError(
                f"{name} is known but not varied", value=name, remedy="vary it, or leave it out of known"
            )
        if not followed[name]:
            message = f"the controller's model does not take {name} from the plant"
            raise ParameterError(message, value=name, remedy="leave it out of known")
    return names


def valid_rows(scenario: Scenario, table: Mapping[str, ArrayLike]) -> NDArray[np.bool_]:
    """Which rows of a table `batched` would take: those whose values keep to the rules among themselves.

    Raises
    ------
    ParameterError
        If a name is unknown or there twice, or a value is outside the range of its field.

    Examples
    --------
    >>> scenario = Scenario.read("examples/pre-contracted-step-pid.yaml")
    >>> valid_rows(scenario, {"joint.connector_length": [0.2, 0.38]})
    array([ True, False])
    """
    columns = _columns(scenario, table)
    mask = np.ones(len(next(iter(columns.values()))), dtype=bool)
    mask[list(refusals(scenario, columns))] = False
    return mask


def _with_fixed_model(scenario: Scenario, values: Mapping[ScenarioParameter, Any], known: Known) -> Scenario:
    """The scenario with the controller's model fixed, at these values where they are known and else at its own."""
    plant = {address: value for address, value in values.items() if address.place[0] in _PLANT}
    names = [address.name for address in (plant if known == "all" else find_parameters(scenario, known))]
    follows = {address.place: value for address, value in plant.items() if address.name in names}
    if len(follows) == len(plant):
        return scenario
    return replaced(scenario, follows).with_fixed_model()


def _follows(scenario: Scenario, address: ScenarioParameter) -> bool:
    """Whether the controller takes a number from the plant."""
    if address.place[0] not in _PLANT:
        return False
    marked = replaced(scenario, {address.place: math.nan})
    return marked.with_fixed_model().controller != scenario.with_fixed_model().controller


def _named(scenario: Scenario, values: Mapping[str, object]) -> tuple[list[ScenarioParameter], list]:
    if not values:
        raise ParameterError("no values are given", remedy="give one for each number that is to change")
    return find_parameters(scenario, values), list(values.values())


def _columns(scenario: Scenario, table: Mapping[str, ArrayLike]) -> dict[ScenarioParameter, NDArray]:
    columns = {address: _column(address, values) for address, values in zip(*_named(scenario, table), strict=True)}
    lengths = {address.name: len(column) for address, column in columns.items()}
    if len(set(lengths.values())) > 1:
        told = ", ".join(f"{name} {length}" for name, length in lengths.items())
        raise ParameterError(f"columns differ in length: {told}", remedy="give one value a row in each")
    return columns


def _column(address: ScenarioParameter, values: ArrayLike) -> NDArray:
    """The values of one number: one axis, float64 or int64, in the range of the field."""
    try:
        given = np.asarray(values)
    except ValueError:  # ragged
        given = np.empty(0)
    if given.ndim != 1 or given.size == 0 or given.dtype.kind not in "fiu":
        raise ParameterError(
            f"the values of {address.name} are no column of numbers", value=values, remedy="give one number a row"
        )
    bad = np.flatnonzero(~np.asarray(address.holds(given)))
    if bad.size:
        value = given[bad[0]].item()
        shown = f"{value:g}, no whole number of" if address.whole else f"{address.show(value)}, outside"
        raise ParameterError(
            f"{_row(bad[0], len(given))}{address.name} is {shown} {address.range}",
            value=value,
            lower=address.lower,
            upper=address.upper,
            unit=address.unit,
            remedy="choose a value inside",
        )
    return given.astype(np.int64 if address.whole else float)


def _check_rules(scenario: Scenario, columns: Mapping[ScenarioParameter, NDArray]) -> None:
    for row, (addresses, reason) in refusals(scenario, columns).items():
        values = ", ".join(f"{address.name} {address.show(columns[address][row])}" for address in addresses)
        raise ParameterError(f"{_row(row, len(columns[addresses[0]]))}with {values}: {reason}")


def _row(row: int, rows: int) -> str:
    return f"row {row}: " if rows > 1 else ""
