"""Scenarios with other numbers: one of them, or many at once as arrays."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Mapping
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mckibben.errors import ParameterError
from mckibben.study.parameters.address import Address, find_all
from mckibben.study.parameters.putting import replaced, validated
from mckibben.study.parameters.rules import refusals
from mckibben.study.scenario import Scenario

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
        As for `lanes`; all unless given, as in a file.

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


def lanes(scenario: Scenario, table: Mapping[str, ArrayLike], *, known: Known = ()) -> Scenario:
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
    >>> load = lanes(scenario, {"load.mass2": [0.5, 0.8]}).plant().load
    >>> load.mass2, load.mass1
    (array([0.5, 0.8]), 0.5)
    >>> load.total_inertia.round(6)
    array([0.045, 0.057])
    >>> lanes(scenario, {"joint.connector_length": [0.2, 0.38]})
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
        As for `lanes`.
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
    followed = {address.name: _follows(scenario, address) for address in find_all(scenario, varied)}
    if known == "all":
        return tuple(name for name, follows in followed.items() if follows)
    names = tuple(address.name for address in find_all(scenario, known))
    for name in names:
        if name not in followed:
            raise ParameterError(
                f"{name} is known but not varied", value=name, remedy="vary it, or leave it out of known"
            )
        if not followed[name]:
            message = f"the controller's model does not take {name} from the plant"
            raise ParameterError(message, value=name, remedy="leave it out of known")
    return names


def allowed(scenario: Scenario, table: Mapping[str, ArrayLike]) -> NDArray[np.bool_]:
    """Which rows of a table `lanes` would take: those whose values keep to the rules among themselves.

    Raises
    ------
    ParameterError
        If a name is unknown or there twice, or a value is outside the range of its field.

    Examples
    --------
    >>> scenario = Scenario.read("examples/pre-contracted-step-pid.yaml")
    >>> allowed(scenario, {"joint.connector_length": [0.2, 0.38]})
    array([ True, False])
    """
    columns = _columns(scenario, table)
    mask = np.ones(len(next(iter(columns.values()))), dtype=bool)
    mask[list(refusals(scenario, columns))] = False
    return mask


def _with_fixed_model(scenario: Scenario, values: Mapping[Address, Any], known: Known) -> Scenario:
    """The scenario with the controller's model fixed, at these values where they are known and else at its own."""
    plant = {address: value for address, value in values.items() if address.place[0] in _PLANT}
    names = [address.name for address in (plant if known == "all" else find_all(scenario, known))]
    follows = {address.place: value for address, value in plant.items() if address.name in names}
    if len(follows) == len(plant):
        return scenario
    return replaced(scenario, follows).with_fixed_model()


def _follows(scenario: Scenario, address: Address) -> bool:
    """Whether the controller takes a number from the plant."""
    if address.place[0] not in _PLANT:
        return False
    marked = replaced(scenario, {address.place: math.nan})
    return marked.with_fixed_model().controller != scenario.with_fixed_model().controller


def _named(scenario: Scenario, values: Mapping[str, object]) -> tuple[list[Address], list]:
    if not values:
        raise ParameterError("no values are given", remedy="give one for each number that is to change")
    return find_all(scenario, values), list(values.values())


def _columns(scenario: Scenario, table: Mapping[str, ArrayLike]) -> dict[Address, NDArray]:
    columns = {address: _column(address, values) for address, values in zip(*_named(scenario, table), strict=True)}
    lengths = {address.name: len(column) for address, column in columns.items()}
    if len(set(lengths.values())) > 1:
        told = ", ".join(f"{name} {length}" for name, length in lengths.items())
        raise ParameterError(f"columns differ in length: {told}", remedy="give one value a row in each")
    return columns


def _column(address: Address, values: ArrayLike) -> NDArray:
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


def _check_rules(scenario: Scenario, columns: Mapping[Address, NDArray]) -> None:
    for row, (addresses, reason) in refusals(scenario, columns).items():
        values = ", ".join(f"{address.name} {address.show(columns[address][row])}" for address in addresses)
        raise ParameterError(f"{_row(row, len(columns[addresses[0]]))}with {values}: {reason}")


def _row(row: int, rows: int) -> str:
    return f"row {row}: " if rows > 1 else ""
