"""Scenarios with other parameter values, one or a batch, and the rules that they obey."""

from __future__ import annotations

import contextlib
import itertools
import math
import os
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from typing import Any, Literal, NamedTuple, TypeVar, cast

import numpy as np
from jaxtyping import PyTree
from numpy.typing import ArrayLike, NDArray

from mckibben.component.schema import inherit, replaced
from mckibben.config.document import Document, edit_yaml, read_document
from mckibben.config.model import ConfigModel, fields_by_key
from mckibben.errors import ParameterError, RangeError, ScenarioError
from mckibben.scenario.parameters import Place, ScenarioParameter, find_parameters
from mckibben.scenario.robot import Scenario
from mckibben.scenario.scenario import StudiedScenario
from mckibben.simulation import Batch

P = TypeVar("P")
S = TypeVar("S", bound=StudiedScenario)


def changed(part: P, values: Mapping[Place, Any]) -> P:
    """Scenario or part with other values [SI] by their places within it; `RangeError` where they contradict."""
    if not values:
        return part
    if () in values:
        return values[()]
    groups: dict[str, dict[Place, Any]] = {}
    for (first, *rest), value in values.items():
        groups.setdefault(first, {})[tuple(rest)] = value
    if isinstance(part, dict):
        return cast(P, part | {name: changed(part[name], inner) for name, inner in groups.items()})
    if isinstance(part, tuple):
        return cast(P, tuple(changed(item, groups.get(str(i), {})) for i, item in enumerate(part)))
    if isinstance(part, ConfigModel):
        names = fields_by_key(type(part))
        update = {names[key]: changed(getattr(part, names[key]), inner) for key, inner in groups.items()}
        return part.model_copy(update=update)
    return replaced(part, {name: changed(getattr(part, name), inner) for name, inner in groups.items()})


def part_at(part: Any, place: Place) -> Any:
    """Return the part at a place within another."""
    for key in place:
        name = fields_by_key(type(part))[key] if isinstance(part, ConfigModel) else key
        inside = isinstance(part, tuple | dict)
        part = part[int(key) if isinstance(part, tuple) else key] if inside else getattr(part, name)
    return part


def _with(scenario: S, values: Mapping[ScenarioParameter, Any]) -> S:
    """Return the scenario with other values, and what the controller takes from its plant."""
    scenario.references()  # those of a nominal robot
    varied = changed(scenario, _at_places(values))
    plant = {name: inherit(getattr(varied, name), {}) for name in scenario.plant_parts}  # as the braid of Chou's law
    return varied.model_copy(update=plant).with_model()


def _at_places(values: Mapping[ScenarioParameter, Any]) -> dict[Place, Any]:
    return {place: value for parameter, value in values.items() for place in parameter.places}


_Attempt = Callable[[Sequence[Any]], str | None]
"""Function of values that returns why they are invalid."""


class Violation(NamedTuple):
    """Parameters whose combined values are invalid, and why."""

    parameters: tuple[ScenarioParameter, ...]
    reason: str


def violations(scenario: S, columns: Mapping[ScenarioParameter, NDArray]) -> dict[int, Violation]:
    """Return the invalid rows of a table whose columns are each in range, in order."""
    groups: dict[Place, list[ScenarioParameter]] = {}
    for parameter in columns:
        groups.setdefault(_part_of(parameter.places[0]), []).append(parameter)
    invalid: dict[int, Violation] = {}
    for place, group in groups.items():
        part = part_at(scenario, place[:1])

        def attempt(values: Sequence[Any], part: Any = part, group: Sequence[ScenarioParameter] = group) -> str | None:
            """Return why values are invalid."""
            try:
                changed(part, {at[1:]: x for at, x in _at_places(dict(zip(group, values, strict=True))).items()})
            except RangeError as error:
                return str(error)
            return None

        table = [columns[parameter] for parameter in group]
        _, first, same = np.unique(np.stack(table), axis=1, return_index=True, return_inverse=True)
        for row, reason in _search(attempt, table, first).items():
            for equal in np.flatnonzero(first[same] == row).tolist():
                invalid.setdefault(equal, Violation(tuple(group), reason))
    return dict(sorted(invalid.items()))


def _part_of(place: Place) -> Place:
    """Return the part within which the validity of a parameter depends on others."""
    return place[:2] if len(place) > 2 and place[0] in ("controller", "controllers", "reference") else place[:1]


def _search(attempt: _Attempt, table: Sequence[NDArray], rows: NDArray[np.int64]) -> dict[int, str]:
    """Invalid rows by bisection."""
    # Each rule compares sums, products or signs of values, monotonic on either side of zero: where all corners of the
    # box around some rows are valid, its inside is, too.
    ends = [_ends(column[rows]) for column in table]
    corners = math.prod(len(end) for end in ends)
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
    return {**_search(attempt, table, ordered[: len(rows) // 2]), **_search(attempt, table, ordered[len(rows) // 2 :])}


def _ends(column: NDArray) -> list[Any]:
    """Lowest and highest of the values below, at and above zero."""
    signs = [column[column < 0], column[column == 0], column[column > 0]]
    return sorted({end.item() for part in signs if part.size for end in (part.min(), part.max())})


ModelFollows = Collection[str] | Literal["all"]
"""Plant parameters that the controller's model follows when they vary."""


def with_values(scenario: S, values: Mapping[str, float | int], *, model_follows: ModelFollows = "all") -> S:
    """The scenario with other values [SI] by name, validated as if in its file; `model_follows` as for `batched`.

    Raises `ParameterError` if a name is unknown or repeated, or a value is invalid.

    Examples
    --------
    >>> from mckibben.scenario import Scenario
    >>> scenario = Scenario.read("examples/pre-contracted-step-pid.yaml")
    >>> with_values(scenario, {"load.mass2": 0.8}).plant().load.mass2
    0.8
    """
    columns = _columns(scenario, {name: [value] for name, value in values.items()})
    _check_rules(scenario, columns)
    numbers = {parameter: column[0].item() for parameter, column in columns.items()}
    return _with(_with_fixed_model(scenario, numbers, model_follows), numbers)


def batched(
    scenario: S, table: Mapping[str, ArrayLike], *, model_follows: ModelFollows = (), known_valid: bool = False
) -> S:
    """A batch of scenarios, with arrays of shape (n,) for the varied parameters.

    The objects built from it (`plant`, `control`, `reference`) have these arrays among their leaves. Such a scenario
    can be neither written nor compared. A controller's model that is taken from the plant stays nominal, except
    for the `model_follows` plant parameters ("all": all of them).

    Raises `ParameterError` if a name is unknown or repeated, or a row is invalid; it names the first such row. If all
    are `known_valid`, by `valid_rows`, they are not checked again.

    Examples
    --------
    >>> from mckibben.scenario import Scenario
    >>> scenario = Scenario.read("examples/pre-contracted-step-pid.yaml")
    >>> load = batched(scenario, {"load.mass2": [0.5, 0.8]}).plant().load
    >>> load.mass2, load.mass1
    (array([0.5, 0.8]), 0.5)
    >>> load.total_inertia.round(6)
    array([0.045, 0.057])
    >>> batched(scenario, {"joint.geometry.connector_length": [0.2, 0.38]})
    Traceback (most recent call last):
        ...
    mckibben.errors.ParameterError: row 1: with joint.geometry.connector_length 380 mm: ...
    """
    columns = _columns(scenario, table)
    if not known_valid:
        _check_rules(scenario, columns)
    return _with(_with_fixed_model(scenario, columns, model_follows), columns)


def followed_names(scenario: S, model_follows: ModelFollows, varied: Iterable[str]) -> tuple[str, ...]:
    """Varied parameters that the plant and the controller's model have in common; `model_follows` as for `batched`.

    Raises `ParameterError` if such a parameter is not varied, or the controller does not take it from the plant.

    Examples
    --------
    >>> from mckibben.scenario import Scenario
    >>> scenario = Scenario.read("examples/pre-contracted-step-pid.yaml")
    >>> followed_names(scenario, "all", ["load.mass2", "joint.geometry.connector_length"])
    ('joint.geometry.connector_length',)
    """
    known = {parameter.name: parameter for parameter in find_parameters(scenario, varied)}
    if model_follows == "all":
        return tuple(name for name, parameter in known.items() if _follows(scenario, parameter))
    names = tuple(parameter.name for parameter in find_parameters(scenario, model_follows))
    for name in names:
        if name not in known:
            raise ParameterError(
                f"the model follows {name}, which is not varied",
                value=name,
                remedy="vary it, or leave it out of model_follows",
            )
        if not _follows(scenario, known[name]):
            message = f"the controller's model does not take {name} from the plant"
            raise ParameterError(message, value=name, remedy="leave it out of model_follows")
    return names


def valid_rows(scenario: S, table: Mapping[str, ArrayLike]) -> NDArray[np.bool_]:
    """Mask of the rows of a table that make a valid scenario.

    Raises `ParameterError` if a name is unknown or repeated, or a value is outside the range of its field.

    Examples
    --------
    >>> from mckibben.scenario import Scenario
    >>> scenario = Scenario.read("examples/pre-contracted-step-pid.yaml")
    >>> valid_rows(scenario, {"joint.geometry.connector_length": [0.2, 0.38]})
    array([ True, False])
    """
    columns = _columns(scenario, table)
    mask = np.ones(len(next(iter(columns.values()))), dtype=bool)
    mask[list(violations(scenario, columns))] = False
    return mask


def _with_fixed_model(scenario: S, values: Mapping[ScenarioParameter, Any], model_follows: ModelFollows) -> S:
    """Return the scenario with the controller's model fixed, at the values of the parameters that it follows."""
    plant = {parameter: value for parameter, value in values.items() if parameter.part in scenario.plant_parts}
    names = [
        parameter.name for parameter in (plant if model_follows == "all" else find_parameters(scenario, model_follows))
    ]
    follows = {parameter: value for parameter, value in plant.items() if parameter.name in names}
    if len(follows) == len(plant):
        return scenario
    return _with(scenario, follows).with_fixed_model()


def _follows(scenario: S, parameter: ScenarioParameter) -> bool:
    """Return whether the controller takes a parameter from the plant."""
    if parameter.part not in scenario.plant_parts:
        return False
    nominal, control = parameter.nominal or 0.0, scenario.control()
    nearby = nominal + 1e-6 * (abs(nominal) or 1), nominal - 1e-6 * (abs(nominal) or 1)
    for value in nearby if parameter.nominal is not None else (*nearby, parameter.lower):
        with contextlib.suppress(RangeError):
            return bool(_with(scenario, {parameter: value}).control() != control)
    return False


def _columns(scenario: S, table: Mapping[str, ArrayLike]) -> dict[ScenarioParameter, NDArray]:
    if not table:
        raise ParameterError("no values are given", remedy="give one for each parameter that is to change")
    pairs = zip(find_parameters(scenario, table), table.values(), strict=True)
    columns = {parameter: _column(parameter, values) for parameter, values in pairs}
    lengths = {parameter.name: len(column) for parameter, column in columns.items()}
    if len(set(lengths.values())) > 1:
        shown = ", ".join(f"{name} {length}" for name, length in lengths.items())
        raise ParameterError(f"columns differ in length: {shown}", remedy="give one value per row in each")
    return columns


def _column(parameter: ScenarioParameter, values: ArrayLike) -> NDArray:
    """Column of one parameter: float64 or int64, in range."""
    try:
        column = np.asarray(values)
    except ValueError:  # ragged
        column = np.empty(0)
    if column.ndim != 1 or column.size == 0 or column.dtype.kind not in "fiu":
        remedy = "give one number per row"
        raise ParameterError(f"the values of {parameter.name} are not a column of numbers", value=values, remedy=remedy)
    bad = np.flatnonzero(~np.asarray(parameter.holds(column)))
    if bad.size:
        value = column[bad[0]].item()
        wrong = f"{value:g}, not a whole number in" if parameter.is_integer else f"{parameter.show(value)}, out of"
        message = f"{_row(bad[0], len(column))}{parameter.name} is {wrong} range ({parameter.range})"
        raise parameter.outside(message, value)
    return column.astype(np.int64 if parameter.is_integer else float)


def _check_rules(scenario: S, columns: Mapping[ScenarioParameter, NDArray]) -> None:
    for row, (parameters, reason) in violations(scenario, columns).items():
        values = ", ".join(f"{parameter.name} {parameter.show(columns[parameter][row])}" for parameter in parameters)
        raise ParameterError(f"{_row(row, len(columns[parameters[0]]))}with {values}: {reason}")


def _row(row: int, rows: int) -> str:
    return f"row {row}: " if rows > 1 else ""


def edit_scenario(text: str, values: Mapping[str, float | int], *, folder: str | os.PathLike[str] = ".") -> str:
    """The text of a scenario with other values [SI] by name; comments, order and layout stay.

    Values that are not in the text are added to it, in the units of `Scenario.dumps` and with all digits. Where unusual
    YAML prevents an edit in place, it is written anew without comments.

    Raises `ScenarioError` if the text is not a scenario; `ParameterError` as for `with_values`.

    Examples
    --------
    >>> from pathlib import Path
    >>> text = Path("examples/pre-contracted-step-pid.yaml").read_text()
    >>> changed = edit_scenario(text, {"load.damping": 0.1, "valve.time_constant": 0.03})
    >>> for before, after in zip(text.splitlines(), changed.splitlines()):
    ...     if before != after:
    ...         print(after)
    load: {from: knee-table-2, damping: 0.1 N*m*s/rad}            # or, with ...
    valve: {time_constant: 30 ms}   # or ideal: the pressure equals the command at once
    """
    scenario = Scenario.parse(text, folder=folder)
    wanted = with_values(scenario, values)
    pairs = list(zip(find_parameters(scenario, values), values.values(), strict=True))
    document = read_document(text)
    words = scenario.joint_type.words
    by_name = {_place_in(document, parameter, words): parameter.write(value) for parameter, value in pairs}
    by_place = {
        _named(document, _with_indices(place), words): p.write(value) for p, value in pairs for place in p.places
    }
    for written in (by_name, by_place):  # two equal muscles may stand in the text once or twice
        edited = edit_yaml(text, written)
        try:
            if Scenario.parse(edited, folder=folder) == wanted:
                return edited
        except ScenarioError:
            pass
    anew = wanted.dumps(folder=folder)
    return anew if anew == text else edit_scenario(anew, values, folder=folder)  # which adds defaults among the values


def _place_in(document: Document, parameter: ScenarioParameter, words: Callable[[str], str]) -> tuple[str | int, ...]:
    """Return the place of a parameter in a text; a constant may be a quantity alone."""
    place = _named(document, _with_indices(tuple(parameter.name.split("."))), words)
    is_value = parameter.places[0][-1] == "value" and isinstance(document.value(place), dict)
    return (*place, "value") if is_value else place


def _named(document: Document, place: tuple[str | int, ...], words: Callable[[str], str]) -> tuple[str | int, ...]:
    """A place by the keys of a text, which has those of a hinge or of its joint's type."""
    found: tuple[str | int, ...] = ()
    for key in place:
        around, name = document.value(found), words(key) if isinstance(key, str) else key
        found = (*found, name if isinstance(around, dict) and name in around else key)
    return found


def _with_indices(place: Place) -> tuple[str | int, ...]:
    """A place as in a document, where items of lists are numbered by integers."""
    return tuple(int(key) if key.isdecimal() else key for key in place)


def run_many(
    scenario: StudiedScenario, table: Mapping[str, ArrayLike], *, model_follows: ModelFollows = (), **options: PyTree
) -> Batch:
    """Simulate a scenario for each row of a table of values, with options of `simulate_many`.

    Raises `ParameterError` for an invalid row.
    """
    return batched(scenario, table, model_follows=model_follows).run_many(**options)
